//! Tables of coefficients: what a client poses with them is the mesh of the server; their files and
//! their limits.

use std::ops::{Add, Mul, Sub};

use mlswarp_server::limits::memory::MemoryClass;
use serde_json::{Value, json};

use crate::support::server::{header, problem};
use crate::support::{Server, eventually, photo};

/// A complex number.
#[derive(Clone, Copy, Default)]
struct Z(f64, f64);

impl Add for Z {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

impl Sub for Z {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0, self.1 - other.1)
    }
}

impl Mul for Z {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self(
            self.0 * other.0 - self.1 * other.1,
            self.0 * other.1 + self.1 * other.0,
        )
    }
}

impl Z {
    fn times(self, by: f64) -> Self {
        Self(self.0 * by, self.1 * by)
    }

    fn norm(self) -> f64 {
        self.0.hypot(self.1)
    }

    /// A position of a handle.
    fn of(handles: &Value, handle: usize, place: usize) -> Self {
        let position = if handles[handle][0].is_array() {
            &handles[handle][place]
        } else {
            &handles[handle]
        };
        Self(position[0].as_f64().unwrap(), position[1].as_f64().unwrap())
    }
}

/// The value of a half-precision number.
fn half(bits: u16) -> f64 {
    let (sign, exponent, fraction) = (
        if bits >> 15 == 1 { -1.0 } else { 1.0 },
        i32::from(bits >> 10 & 31),
        f64::from(bits & 1023),
    );
    let size = if exponent == 0 {
        fraction * 2f64.powi(-24)
    } else {
        (1024.0 + fraction) * 2f64.powi(exponent - 25)
    };
    sign * size
}

/// A file as the document describes it.
struct Table {
    family: usize,
    columns: usize,
    rows: usize,
    size: Z,
    revision: [u8; 16],
    /// Column, handle, position, share.
    members: Vec<(usize, usize, usize, f64)>,
    /// By column.
    planes: Vec<Vec<f64>>,
    width: usize,
}

impl Table {
    fn read(file: &[u8]) -> Self {
        let word = |at: usize| file[at..at + 4].try_into().unwrap();
        let int = |at: usize| u32::from_le_bytes(word(at)) as usize;
        assert_eq!(&file[..8], b"MLSPLAN1");
        let [family, bytes, columns, rows, width, count, w, h] =
            [8, 12, 16, 20, 24, 28, 32, 36].map(int);
        let table = 64 + 16 * count;
        let member = |k| {
            (
                int(k),
                int(k + 4),
                int(k + 8),
                f64::from(f32::from_le_bytes(word(k + 12))),
            )
        };
        let number = |number: &[u8]| match *number {
            [a, b] => half(u16::from_le_bytes([a, b])),
            [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => panic!("{bytes} bytes"),
        };
        let numbers: Vec<f64> = file[table..].chunks_exact(bytes).map(number).collect();
        assert_eq!(numbers.len(), (family + 1) * width * columns * rows);
        let planes = numbers
            .chunks_exact(columns * rows)
            .map(<[f64]>::to_vec)
            .collect();
        let (size, revision) = (Z(w as f64, h as f64), file[40..56].try_into().unwrap());
        Self {
            family,
            columns,
            rows,
            size,
            revision,
            members: (64..table).step_by(16).map(member).collect(),
            planes,
            width,
        }
    }

    fn pose(&self, p: &Value, q: &Value) -> Vec<Z> {
        let (mut rest, mut posed) = (
            vec![Z::default(); self.width],
            vec![Z::default(); self.width],
        );
        for &(column, handle, place, share) in &self.members {
            rest[column] = rest[column] + Z::of(p, handle, place).times(share);
            posed[column] = posed[column] + Z::of(q, handle, place).times(share);
        }
        let sum = |term: &dyn Fn(usize) -> Z| (0..self.width).map(term).fold(Z::default(), Z::add);
        let plane =
            |column: usize, k: usize, at: usize| self.planes[(self.family + 1) * column + k][at];
        let vertex = |at: usize| {
            let share = |k: usize, count: usize| k as f64 / (count - 1) as f64;
            let v = Z(
                self.size.0 * share(at % self.columns, self.columns),
                self.size.1 * share(at / self.columns, self.rows),
            );
            let moved = |c: usize| posed[c] - rest[c];
            match self.family {
                0 => v + sum(&|c| moved(c).times(plane(c, 0, at))),
                1 => v + sum(&|c| Z(plane(c, 0, at), plane(c, 1, at)) * moved(c)),
                _ => {
                    let e = v - sum(&|c| rest[c].times(plane(c, 2, at)));
                    let f = e + sum(&|c| Z(plane(c, 0, at), plane(c, 1, at)) * moved(c));
                    let turned = if f.norm() > 1e-5 * e.norm() {
                        f.times(e.norm() / f.norm())
                    } else {
                        e
                    };
                    turned + sum(&|c| posed[c].times(plane(c, 2, at)))
                }
            }
        };
        (0..self.columns * self.rows).map(vertex).collect()
    }
}

async fn table(server: &Server, id: &str, query: &str) -> Table {
    let response = server
        .get(&format!("/sessions/{id}/plan?{query}"))
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    assert_eq!(
        (
            header(&response, "content-type"),
            header(&response, "cache-control")
        ),
        ("application/octet-stream", "no-store")
    );
    Table::read(&response.bytes().await.unwrap())
}

/// The vertices of the server.
async fn mesh(server: &Server, id: &str, body: &Value) -> Vec<Z> {
    let request = server
        .post(&format!("/sessions/{id}/mesh"))
        .header("accept", "application/octet-stream");
    let response = request.json(body).send().await.unwrap();
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    let number = |bytes: &[u8; 4]| f64::from(f32::from_le_bytes(*bytes));
    response
        .bytes()
        .await
        .unwrap()
        .as_chunks::<4>()
        .0
        .as_chunks::<2>()
        .0
        .iter()
        .map(|[x, y]| Z(number(x), number(y)))
        .collect()
}

fn sets() -> [(Value, Value, Value); 6] {
    let points = (
        json!([[40, 30], [120, 90], [30, 95], [77, 50]]),
        json!([[47, 26], [112, 95], [33, 88], [70, 61]]),
    );
    let lines = json!([
        [[10, 10], [60, 20], [80, 70]],
        [120, 90],
        [[30, 100], [140, 20]]
    ]);
    let moved = json!([
        [[16, 4], [55, 30], [80, 70]],
        [100, 95],
        [[30, 110], [150, 33]]
    ]);
    let pairs = json!([[40, 30], [120, 90], [40, 30], [30, 95]]);
    let apart = json!([[47, 26], [112, 95], [51, 28], [33, 88]]);
    [
        (points.0.clone(), points.1.clone(), json!({})),
        (points.0, points.1, json!({"weights": [1, 3, 0.5, 2]})),
        (lines, moved, json!({"point_mass": 30})),
        (pairs, apart, json!({"weights": [1, 3, 2, 1]})),
        (
            json!([[40, 30], [120, 90]]),
            json!([[47, 26], [112, 95]]),
            json!({}),
        ),
        (json!([[40, 30]]), json!([[47, 26]]), json!({})),
    ]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_posed_table_is_the_mesh() {
    let server = Server::start(&[]).await;
    let image = photo(160, 120);
    for (p, q, more) in sets() {
        for (method, alpha) in ["affine", "similarity", "rigid"]
            .iter()
            .flat_map(|method| [1.0, 1.3, 2.0].map(|alpha| (method, alpha)))
        {
            let mut rest = json!({"p": p, "method": method, "alpha": alpha,
                "grid": {"columns": 19, "rows": 13}});
            rest.as_object_mut()
                .unwrap()
                .extend(more.as_object().unwrap().clone());
            let id = server.session(&image, &rest).await;
            for (precision, tolerance) in [("f32", 1e-4), ("f16", 0.05)] {
                let table = table(
                    &server,
                    &id,
                    &format!("columns=19&rows=13&precision={precision}"),
                )
                .await;
                let (posed, want) = (
                    table.pose(&p, &q),
                    mesh(&server, &id, &json!({"q": q})).await,
                );
                assert_eq!(posed.len(), want.len());
                let worst = posed
                    .iter()
                    .zip(&want)
                    .map(|(a, b)| (*a - *b).norm())
                    .fold(0.0, f64::max);
                assert!(
                    worst <= tolerance,
                    "{method} {alpha} {precision} {p}: {worst}"
                );
                // At rest nothing moves, whatever the precision.
                let still = table.pose(&p, &p);
                assert!(
                    still
                        .iter()
                        .zip(mesh(&server, &id, &json!({"q": p})).await)
                        .all(|(a, b)| (*a - b).norm() < 1e-4)
                );
            }
            let strong = mesh(&server, &id, &json!({"q": q, "strength": 0.5})).await;
            let half = |a: &Value, b: &Value| (a.as_f64().unwrap() + b.as_f64().unwrap()) / 2.0;
            let posed = table(&server, &id, "columns=19&rows=13")
                .await
                .pose(&p, &between(&p, &q, &half));
            assert!(
                posed
                    .iter()
                    .zip(&strong)
                    .all(|(a, b)| (*a - *b).norm() <= 1e-4),
                "{method} {alpha} {p}: strength"
            );
        }
    }
}

/// Applies a function to the numbers of two sets.
fn between(p: &Value, q: &Value, of: &impl Fn(&Value, &Value) -> f64) -> Value {
    match (p.as_array(), q.as_array()) {
        (Some(p), Some(q)) => p.iter().zip(q).map(|(p, q)| between(p, q, of)).collect(),
        _ => json!(of(p, q)),
    }
}

#[tokio::test]
async fn splines_and_global_maps_have_tables_and_normalized_handles_are_in_px() {
    let server = Server::start(&[]).await;
    let (p, q, _) = &sets()[0];
    for rest in [
        json!({"method": "tps"}),
        json!({"method": "tps", "smoothing": 0.1}),
        json!({"method": "global_affine"}),
    ] {
        let mut warp = json!({"p": p, "grid": {"columns": 9, "rows": 7}});
        warp.as_object_mut()
            .unwrap()
            .extend(rest.as_object().unwrap().clone());
        let id = server.session(&photo(160, 120), &warp).await;
        let posed = table(&server, &id, "columns=9&rows=7").await.pose(p, q);
        let want = mesh(&server, &id, &json!({"q": q})).await;
        assert!(
            posed
                .iter()
                .zip(&want)
                .all(|(a, b)| (*a - *b).norm() <= 1e-4),
            "{rest}"
        );
    }
    let size = |of: &Value| between(of, of, &|a, _| a.as_f64().unwrap() / 64.0);
    let warp = json!({"p": size(p), "units": "normalized", "grid": {"columns": 9, "rows": 7}});
    let id = server.session(&photo(64, 64), &warp).await;
    let posed = table(&server, &id, "columns=9&rows=7").await.pose(p, q);
    let want = mesh(&server, &id, &json!({"q": size(q)})).await;
    assert!(
        posed
            .iter()
            .zip(&want)
            .all(|(a, b)| (*a - b.times(64.0)).norm() <= 1e-4)
    );
}

#[tokio::test]
async fn a_table_is_of_the_handles_that_its_revision_names() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(64, 48), &json!({"p": [[10, 10], [40, 30]]}))
        .await;
    let revision = async || {
        let object: Value = server
            .get(&format!("/sessions/{id}"))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        object["rest_revision"].as_str().unwrap().to_owned()
    };
    let change = async |body: Value| {
        let request = server
            .client
            .put(server.url(&format!("/sessions/{id}/handles")))
            .json(&body);
        assert_eq!(request.send().await.unwrap().status(), 200);
        revision().await
    };
    let first = revision().await;
    let default = table(&server, &id, "").await;
    assert_eq!((default.columns, default.rows, default.width), (50, 50, 2));
    assert_eq!(data_encoding::HEXLOWER.encode(&default.revision), first);
    assert_eq!(
        change(
            json!({"p": [[10, 10], [40, 30]], "grid": {"cell": 9}, "output": {"outside": "edge"}})
        )
        .await,
        first
    );
    let mut seen = vec![first];
    for body in [
        json!({"p": [[10, 10], [40, 31]]}),
        json!({"p": [[10, 10], [40, 31]], "weights": [1, 2]}),
        json!({"p": [[10, 10], [40, 31]], "alpha": 1.5}),
        json!({"p": [[10, 10], [40, 31]], "method": "similarity"}),
        json!({"p": [[10, 10], [40, 31], [41, 31]]}),
        json!({"p": [[10, 10], [40, 31], [41, 31]], "coincident": {"within": 2}}),
        json!({"p": []}),
    ] {
        let next = change(body.clone()).await;
        assert!(!seen.contains(&next), "{body}");
        assert_eq!(
            data_encoding::HEXLOWER.encode(&table(&server, &id, "columns=2&rows=3").await.revision),
            next
        );
        seen.push(next);
    }
    // Without handles nothing moves.
    let identity = table(&server, &id, "columns=2&rows=3")
        .await
        .pose(&json!([]), &json!([]));
    assert!((identity[5] - Z(64.0, 48.0)).norm() == 0.0);
}

/// `HEAD` says how long the file is without the system of a spline, and so without its table; and
/// the session is shown without it.
#[tokio::test]
async fn a_session_and_the_length_of_its_file_need_no_coefficients() {
    let server = Server::start(&[]).await;
    let builds = async || {
        let text = server.get("/metrics").send().await.unwrap().text().await;
        let text = text.unwrap();
        let of_setups = r#"mlswarp_cache_builds_total{cache="setups"} "#;
        let built = text.lines().find_map(|line| line.strip_prefix(of_setups));
        built.unwrap().parse::<u64>().unwrap()
    };
    let lines = json!([[[2, 2], [9, 9]], [[12, 3], [3, 10]]]);
    let points = json!([[2, 2], [9, 9], [9, 9], [3, 10]]);
    for warp in [
        json!({"p": points, "method": "tps"}),
        json!({"p": points, "method": "similarity"}),
        json!({"p": lines, "method": "affine"}),
        json!({"p": []}),
    ] {
        let id = server.session(&photo(16, 12), &warp).await;
        for query in [
            "",
            "?columns=7&rows=9&precision=f16",
            "?columns=5000&rows=5000",
        ] {
            let path = format!("/sessions/{id}/plan{query}");
            server.app.clear_caches();
            let before = builds().await;
            let head = server.client.head(server.url(&path)).send().await.unwrap();
            let shown = server.get(&format!("/sessions/{id}")).send().await.unwrap();
            assert_eq!(shown.status(), 200);
            assert_eq!(builds().await, before, "{warp} {query}");
            let get = server.get(&path).send().await.unwrap();
            assert_eq!(builds().await, before + 1, "{warp} {query}");
            let of = |response: &reqwest::Response| {
                let named = |name| response.headers().get(name).cloned();
                (response.status(), named("etag"), named("content-length"))
            };
            assert_eq!(of(&head), of(&get), "{warp} {query}");
        }
    }
}

#[tokio::test]
async fn a_client_that_has_the_file_gets_304() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(16, 12), &json!({"p": [[2, 2], [9, 9]]}))
        .await;
    let ask = |query: &str, tag: &str| {
        server
            .get(&format!("/sessions/{id}/plan{query}"))
            .header("if-none-match", tag)
            .send()
    };
    let first = ask("", "").await.unwrap();
    let tag = header(&first, "etag").to_owned();
    for known in [tag.clone(), format!("\"x\", W/{tag}"), "*".to_owned()] {
        let again = ask("", &known).await.unwrap();
        assert_eq!(
            (again.status().as_u16(), header(&again, "etag")),
            (304, tag.as_str())
        );
        assert!(again.bytes().await.unwrap().is_empty());
    }
    for other in ["?columns=49", "?rows=49", "?precision=f16"] {
        assert_eq!(ask(other, &tag).await.unwrap().status(), 200, "{other}");
    }
}

#[tokio::test]
async fn wrong_lattices_are_refused_before_memory_is_taken() {
    let server = Server::start(&[]).await;
    let far: Vec<[f64; 2]> = (0..300)
        .map(|k| [f64::from(k % 20) * 30.0, f64::from(k / 20) * 30.0])
        .collect();
    let id = server.session(&photo(16, 12), &json!({"p": far})).await;
    let refused = async |query: &str, status: u16, code: &str| {
        problem(
            server
                .get(&format!("/sessions/{id}/plan?{query}"))
                .send()
                .await
                .unwrap(),
            status,
            code,
        )
        .await
    };
    for query in [
        "columns=0",
        "columns=1",
        "rows=-5",
        "rows=NaN",
        "rows=1e9",
        "columns=",
        "columns=+9",
        "columns=4294967296",
        "rows=5.0",
    ] {
        let name = query.split('=').next().unwrap();
        let document = refused(query, 422, "bad_value").await;
        assert!(
            document["detail"]
                .as_str()
                .unwrap()
                .starts_with(&format!("`{name}` in the query")),
            "{document}"
        );
    }
    for query in ["precision=f64", "precision=", "precision=F16"] {
        refused(query, 422, "bad_value").await;
    }
    refused("precison=f16", 422, "unknown_field").await;
    refused("rows=5&rows=5", 400, "malformed_request").await;
    for (query, limit) in [
        ("columns=1000000000", "grid_columns"),
        ("rows=4294967295", "grid_rows"),
        ("columns=4097&rows=4097", "plan_bytes"),
        ("columns=250&rows=250", "plan_file_bytes"),
    ] {
        let document = refused(query, 413, "too_large").await;
        assert_eq!(
            (
                document["limit_name"].as_str(),
                document["pointer"].as_str()
            ),
            (Some(limit), None),
            "{document}"
        );
        assert!(
            document["actual"].as_u64() > document["limit"].as_u64(),
            "{document}"
        );
    }
    eventually("nothing is kept", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
    // A coefficient of nearly collinear handles that half precision cannot hold.
    let thin = json!({"p": [[0, 0], [10, 0.00001], [20, 0], [30, 0]], "method": "affine"});
    let thin = server.session(&photo(160, 120), &thin).await;
    let ask = |precision: &str| {
        server
            .get(&format!("/sessions/{thin}/plan?precision={precision}"))
            .send()
    };
    assert_eq!(ask("f32").await.unwrap().status(), 200);
    let document = problem(ask("f16").await.unwrap(), 422, "bad_value").await;
    assert!(
        document["detail"]
            .as_str()
            .unwrap()
            .starts_with("`precision` in the query must be `f32`"),
        "{document}"
    );
}
