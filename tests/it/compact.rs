//! Compact meshes on the drag socket: every n-th line of the full mesh, within the error that the
//! server states.

use mlswarp_server::limits::memory::MemoryClass;
use serde_json::{Value, json};

use crate::support::drag_client::Received;
use crate::support::server::problem;
use crate::support::{DragClient, Server, eventually, photo};

/// A lattice as the messages describe it, and a position at each vertex, px.
struct Mesh {
    columns: usize,
    rows: usize,
    size: [f64; 2],
    cell: [f64; 2],
    places: Vec<[f64; 2]>,
}

impl Mesh {
    fn new(shape: &Value) -> Self {
        let number = |name: &str| shape[name].as_f64().unwrap();
        let cell = [0, 1].map(|axis| shape["cell"][axis].as_f64().unwrap());
        let (columns, rows) = (number("columns") as usize, number("rows") as usize);
        Self {
            columns,
            rows,
            size: [number("width"), number("height")],
            cell,
            places: Vec::new(),
        }
    }

    fn line(&self, axis: usize, k: usize) -> f64 {
        if k + 1 == [self.columns, self.rows][axis] {
            self.size[axis]
        } else {
            k as f64 * self.cell[axis]
        }
    }

    fn at_rest(&self) -> Vec<[f64; 2]> {
        (0..self.rows)
            .flat_map(|j| (0..self.columns).map(move |i| [self.line(0, i), self.line(1, j)]))
            .collect()
    }

    /// A frame without its `seq`; also its scale.
    fn of_frame(shape: &Value, frame: &[u8]) -> (Self, f64) {
        let mut mesh = Self::new(shape);
        let (scale, units) = frame.split_first_chunk().unwrap();
        let scale = f64::from(f32::from_le_bytes(*scale));
        let units: Vec<f64> = units
            .as_chunks()
            .0
            .iter()
            .map(|unit| f64::from(i16::from_le_bytes(*unit)))
            .collect();
        assert_eq!(units.len(), 2 * mesh.columns * mesh.rows);
        let moved = |(at, units): ([f64; 2], &[f64; 2])| {
            [at[0] + scale * units[0], at[1] + scale * units[1]]
        };
        mesh.places = mesh
            .at_rest()
            .into_iter()
            .zip(units.as_chunks().0)
            .map(moved)
            .collect();
        (mesh, scale)
    }

    /// The bilinear patch that a rest position is in.
    fn map(&self, p: [f64; 2]) -> [f64; 2] {
        let place = |axis: usize, count: usize| {
            let k = ((p[axis] / self.cell[axis]) as usize).min(count - 2);
            let (a, b) = (self.line(axis, k), self.line(axis, k + 1));
            (k, (p[axis] - a) / (b - a))
        };
        let ((i, s), (j, t)) = (place(0, self.columns), place(1, self.rows));
        let at = |i: usize, j: usize| self.places[j * self.columns + i];
        [0, 1].map(|k| {
            let top = at(i, j)[k] * (1.0 - s) + at(i + 1, j)[k] * s;
            top * (1.0 - t) + (at(i, j + 1)[k] * (1.0 - s) + at(i + 1, j + 1)[k] * s) * t
        })
    }

    /// The largest distance from another mesh, at its vertices and the centres of its cells.
    fn distance(&self, full: &Self) -> f64 {
        let middle = |axis, k| (full.line(axis, k) + full.line(axis, k + 1)) / 2.0;
        let centres = (0..full.rows - 1)
            .flat_map(|j| (0..full.columns - 1).map(move |i| [middle(0, i), middle(1, j)]));
        let apart = |p: [f64; 2]| {
            let (a, b) = (self.map(p), full.map(p));
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        full.at_rest()
            .into_iter()
            .chain(centres)
            .map(apart)
            .fold(0.0, f64::max)
    }
}

/// The mesh of a request, px; `unit`: px in the units of the session.
async fn full(server: &Server, id: &str, q: &Value, unit: [f64; 2]) -> Mesh {
    let response = server
        .post(&format!("/sessions/{id}/mesh"))
        .json(&json!({"q": q}))
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 200);
    let object: Value = response.json().await.unwrap();
    assert!(object.get("mesh").is_none() && object.get("error").is_none());
    let place = |place: &Value| [0, 1].map(|axis| place[axis].as_f64().unwrap() * unit[axis]);
    let places = object["vertices"]
        .as_array()
        .unwrap()
        .iter()
        .map(place)
        .collect();
    Mesh {
        places,
        ..Mesh::new(&object)
    }
}

/// A pose, its report and its frame.
async fn frame(drag: &mut DragClient, seq: u64, q: &Value) -> (Value, Vec<u8>) {
    drag.pose(seq, q).await;
    let report = drag.text().await;
    assert_eq!(
        (&report["seq"], &report["format"]),
        (&json!(seq), &json!("mesh")),
        "{report}"
    );
    let (of, bytes) = drag.frame().await;
    assert_eq!(of, seq);
    drag.ack(seq).await;
    (report, bytes)
}

/// `handle` moved by an offset along an axis, all its positions.
fn moved(p: &Value, handle: usize, axis: usize, by: f64) -> Value {
    let mut q = p.clone();
    let shift = |place: &mut Value| place[axis] = json!(place[axis].as_f64().unwrap() + by);
    match &mut q[handle] {
        Value::Array(line) if line[0].is_array() => line.iter_mut().for_each(shift),
        point => shift(point),
    }
    q
}

/// Handles that a tenth of the shorter side moves towards the middle, as the reference poses do.
async fn check_reference_poses(
    server: &Server,
    warp: &Value,
    (width, height): (u32, u32),
    tolerance: f64,
) {
    let unit = if warp["units"] == "normalized" {
        [f64::from(width), f64::from(height)]
    } else {
        [1.0; 2]
    };
    let id = server.session(&photo(width, height), warp).await;
    let query = format!("?frames=mesh&mesh=compact&report=true&tolerance={tolerance}");
    let mut drag = DragClient::open(server.address, &id, &query).await;
    let hello = drag.hello.clone();
    assert_eq!(
        (&hello["mesh"], hello["tolerance"].as_f64()),
        (&json!("compact"), Some(tolerance))
    );
    let (error, vertices) = (
        hello["error"].as_f64().unwrap(),
        hello["columns"].as_u64().unwrap() * hello["rows"].as_u64().unwrap(),
    );
    assert!(vertices <= 4997, "{warp}: {vertices} vertices");
    let (p, sides) = (&warp["p"], [f64::from(width), f64::from(height)]);
    let far = sides[0].min(sides[1]) / 10.0;
    let (mut seq, mut worst) = (0, 0.0_f64);
    for handle in 0..p.as_array().unwrap().len() {
        for axis in 0..2 {
            let first = if p[handle][0].is_array() {
                &p[handle][0]
            } else {
                &p[handle]
            };
            let sign = if first[axis].as_f64().unwrap() * unit[axis] > sides[axis] / 2.0 {
                -1.0
            } else {
                1.0
            };
            let q = moved(p, handle, axis, sign * far / unit[axis]);
            let (report, bytes) = frame(&mut drag, seq, &q).await;
            let (compact, scale) = Mesh::of_frame(&hello, &bytes);
            let apart = compact.distance(&full(server, &id, &q, unit).await);
            let rounded = 1e-3 + scale;
            assert!(
                apart <= error + rounded,
                "{warp}, pose {seq}: {apart} px apart, {error} px stated"
            );
            assert!(
                (report["error"].as_f64().unwrap() - apart).abs() < 2e-3,
                "{report}: {apart}"
            );
            worst = worst.max(apart);
            seq += 1;
        }
    }
    assert!(
        (worst - error).abs() < 2e-3 + far / 32767.0,
        "{warp}: the poses differ by {worst} px at most, {error} px stated"
    );
    assert!(
        error <= tolerance || vertices > 2000,
        "{warp}: {error} px, {vertices} vertices"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn compact_meshes_are_as_near_to_the_full_ones_as_stated() {
    let server = Server::start(&[]).await;
    let points = json!([[40, 30], [120, 90], [30, 95], [77, 50]]);
    let lines = json!([
        [[10, 10], [60, 20], [80, 70]],
        [120, 90],
        [[30, 100], [140, 50]]
    ]);
    for method in ["rigid", "similarity", "affine"] {
        check_reference_poses(
            &server,
            &json!({"p": points, "method": method}),
            (160, 120),
            0.5,
        )
        .await;
        check_reference_poses(
            &server,
            &json!({"p": lines, "method": method}),
            (160, 120),
            1.0,
        )
        .await;
    }
    for alpha in [0.5, 1.5, 4.0] {
        check_reference_poses(
            &server,
            &json!({"p": points, "alpha": alpha}),
            (160, 120),
            0.1,
        )
        .await;
    }
    check_reference_poses(
        &server,
        &json!({"p": points, "method": "tps"}),
        (160, 120),
        0.5,
    )
    .await;
    let shares = json!([[0.2, 0.3], [0.9, 0.8], [-0.4, 1.5]]);
    check_reference_poses(
        &server,
        &json!({"p": shares, "units": "normalized"}),
        (160, 120),
        0.5,
    )
    .await;
    for grid in [
        json!({"columns": 3, "rows": 90}),
        json!({"cell": 7}),
        json!("pixel"),
    ] {
        check_reference_poses(
            &server,
            &json!({"p": points, "grid": grid}),
            (161, 119),
            2.0,
        )
        .await;
    }
    // More vertices than a compact mesh may have.
    check_reference_poses(
        &server,
        &json!({"p": points, "grid": {"cell": 2}}),
        (640, 300),
        0.1,
    )
    .await;
    // One map: a single cell.
    let id = server
        .session(
            &photo(160, 120),
            &json!({"p": points, "method": "global_affine"}),
        )
        .await;
    let hello = DragClient::open(server.address, &id, "?mesh=compact")
        .await
        .hello;
    assert_eq!(
        (&hello["columns"], &hello["rows"]),
        (&json!(2), &json!(2)),
        "{hello}"
    );
    eventually("nothing is left of the meshes", || {
        server.app.budget().taken_for(MemoryClass::Frame) == 0
    })
    .await;
}

#[tokio::test]
async fn poses_at_rest_are_exact_and_translations_exact_to_the_scale() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[40, 30], [120, 90], [[30, 95], [77, 50]]]});
    let id = server.session(&photo(160, 120), &warp).await;
    let mut drag =
        DragClient::open(server.address, &id, "?frames=mesh&mesh=compact&report=true").await;
    let (report, bytes) = frame(&mut drag, 0, &warp["p"]).await;
    assert!(
        bytes.iter().all(|byte| *byte == 0),
        "the scale and all displacements are 0"
    );
    assert_eq!(report["error"], 0.0);
    for (seq, x, y) in [(1, 13.25_f64, -7.5_f64), (2, 0.001, 0.0), (3, 5e5, 3e5)] {
        let q = json!([
            [40.0 + x, 30.0 + y],
            [120.0 + x, 90.0 + y],
            [[30.0 + x, 95.0 + y], [77.0 + x, 50.0 + y]]
        ]);
        let (_, bytes) = frame(&mut drag, seq, &q).await;
        let (mesh, scale) = Mesh::of_frame(&drag.hello, &bytes);
        assert!(
            (scale - x.abs().max(y.abs()) / 32767.0).abs() <= 1e-4 * scale,
            "{scale}"
        );
        for (rest, place) in mesh.at_rest().into_iter().zip(mesh.places) {
            assert!(
                (place[0] - rest[0] - x).abs() <= scale && (place[1] - rest[1] - y).abs() <= scale,
                "{rest:?} -> {place:?}"
            );
        }
    }
}

/// Seven handles on 512 x 512 px, moved as in `cargo bench --bench drag`.
#[tokio::test]
async fn frames_of_seven_handles_are_small() {
    let server = Server::start(&[]).await;
    let (p, d): (Vec<[f64; 2]>, Vec<[f64; 2]>) = [
        ([0.2, 0.2], [0.05, 0.04]),
        ([0.8, 0.25], [-0.06, 0.03]),
        ([0.5, 0.5], [0.04, -0.06]),
        ([0.25, 0.75], [-0.05, -0.04]),
        ([0.75, 0.8], [0.05, 0.06]),
        ([0.5, 0.1], [0.0, 0.05]),
        ([0.1, 0.5], [0.06, 0.0]),
    ]
    .into_iter()
    .unzip();
    let id = server
        .session(
            &photo(512, 512),
            &json!({"p": p.iter().map(|p| p.map(|c| c * 512.0)).collect::<Vec<_>>()}),
        )
        .await;
    for (tolerance, most) in [(0.5, 12_000), (2.0, 8_000)] {
        let mut drag = DragClient::open(
            server.address,
            &id,
            &format!("?mesh=compact&report=true&tolerance={tolerance}"),
        )
        .await;
        assert!(
            drag.hello["error"].as_f64().unwrap() <= tolerance,
            "{}",
            drag.hello
        );
        for seq in 0..20 {
            let strength = f64::from(u32::try_from(seq).unwrap()) / 19.0;
            let q: Vec<_> = p
                .iter()
                .zip(&d)
                .map(|(p, d)| [0, 1].map(|k| 512.0 * (p[k] + strength * d[k])))
                .collect();
            let (report, bytes) = frame(&mut drag, seq, &json!(q)).await;
            assert!(8 + bytes.len() <= most, "{} bytes", 8 + bytes.len());
            assert!(report["error"].as_f64().unwrap() <= tolerance, "{report}");
        }
    }
}

#[tokio::test]
async fn the_lattice_is_that_of_the_handles_at_rest() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(128, 96), &json!({"p": [[20, 20], [100, 24]]}))
        .await;
    let mut drag = DragClient::open(server.address, &id, "?frames=mesh&mesh=compact").await;
    let first = drag.hello.clone();
    drag.pose(1, &json!([[25, 20], [100, 30]])).await;
    drag.ack_of_next_frame(1).await;
    let body = json!({"p": [[20, 20], [100, 70], [40, 60]], "grid": {"columns": 13, "rows": 9}});
    let put = server
        .client
        .put(server.url(&format!("/sessions/{id}/handles")))
        .json(&body)
        .send()
        .await
        .unwrap();
    assert_eq!(put.status(), 200);
    let q = json!([[22, 20], [100, 72], [40, 66]]);
    drag.pose(2, &q).await;
    let hello = drag.text().await;
    assert!(
        hello["columns"].as_u64().unwrap() <= 13 && hello["mesh"] == "compact" && hello != first,
        "{hello}"
    );
    let Received::Frame(2, bytes) = drag.next().await else {
        panic!("the frame follows")
    };
    drag.ack(2).await;
    let (mesh, _) = Mesh::of_frame(&hello, &bytes);
    assert!(mesh.distance(&full(&server, &id, &q, [1.0; 2]).await) <= 0.5);
    // The message comes once, and is the first one of a new socket.
    drag.pose(3, &q).await;
    let (seq, again) = drag.frame().await;
    assert!(seq == 3 && again == bytes);
    let mut other = DragClient::open(server.address, &id, "?mesh=compact&tolerance=0.5").await;
    assert_eq!(other.hello, hello);
    other.pose(7, &q).await;
    assert!(other.frame().await == (7, bytes));
}

/// Handles that coincide move together in the reference poses; where all of those contradict each
/// other, the finest lattice is used.
#[tokio::test]
async fn handles_that_must_not_contradict_each_other_have_a_lattice() {
    let server = Server::start(&[]).await;
    let reject = json!({"policy": "reject"});
    let pairs = json!({"p": [[20, 20], [100, 24], [20, 20], [60, 80]], "coincident": reject});
    let id = server.session(&photo(128, 96), &pairs).await;
    let hello = DragClient::open(server.address, &id, "?mesh=compact")
        .await
        .hello;
    assert!(hello["error"].as_f64().unwrap() > 0.0, "{hello}");
    let crossing =
        json!({"p": [[[20, 20], [100, 80]], [[20, 80], [100, 20]]], "coincident": reject});
    let id = server.session(&photo(128, 96), &crossing).await;
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let hello = DragClient::open(server.address, &id, "?mesh=compact")
        .await
        .hello;
    assert_eq!(
        (&hello["error"], &hello["columns"]),
        (&Value::Null, &session["grid"]["columns"]),
        "{hello}"
    );
    // Without handles nothing moves.
    let id = server.session(&photo(128, 96), &json!({"p": []})).await;
    let mut drag = DragClient::open(server.address, &id, "?mesh=compact").await;
    assert_eq!(
        (
            &drag.hello["error"],
            &drag.hello["columns"],
            &drag.hello["rows"]
        ),
        (&json!(0.0), &json!(2), &json!(2))
    );
    drag.pose(0, &json!([])).await;
    assert_eq!(drag.frame().await, (0, vec![0; 4 + 4 * 4]));
}

#[tokio::test]
async fn only_meshes_are_compact_and_only_compact_meshes_have_a_tolerance() {
    let server = Server::start(&[]).await;
    let id = server
        .session(&photo(32, 24), &json!({"p": [[20, 20]]}))
        .await;
    for query in [
        "frames=png&mesh=compact",
        "frames=mesh&mesh=i16",
        "frames=mesh&tolerance=1",
        "mesh=compact&tolerance=17",
        "mesh=compact&width=9",
    ] {
        let request = server
            .get(&format!("/sessions/{id}/drag?{query}"))
            .header("connection", "upgrade")
            .header("upgrade", "websocket");
        let request = request
            .header("sec-websocket-version", "13")
            .header("sec-websocket-key", "dGhlIHNhbXBsZSBub25jZQ==");
        let refused = problem(request.send().await.unwrap(), 422, "bad_value").await;
        assert!(
            refused["detail"].as_str().unwrap().contains("query"),
            "{query}: {refused}"
        );
    }
}
