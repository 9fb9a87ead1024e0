//! Landmark files as large and as crooked as people have them: every format with a face, a pair of
//! tissue sections and a scanned map, read and read again from the answer; and pictures warped by
//! such files.

use reqwest::Response;
use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

use crate::support::server::header;
use crate::support::{Server, photo};

type Place = [f64; 2];

/// Landmarks of both sides, px, the centre of the first pixel at 1/2, 1/2.
struct Set {
    name: &'static str,
    size: [f64; 2],
    p: Vec<Place>,
    q: Vec<Place>,
}

/// To four digits, which all formats write.
fn rounded(place: Place) -> Place {
    place.map(|c| (c * 1e4).round() / 1e4)
}

/// A map that bends by some px.
fn bent([x, y]: Place, [width, height]: [f64; 2]) -> Place {
    let (s, t) = (x / width, y / height);
    rounded([
        1.03 * x - 0.04 * y + 0.012 * width * (5.0 * t).sin(),
        0.97 * y + 0.05 * x + 0.01 * height * (4.0 * s + 1.0).cos(),
    ])
}

/// 68 points of a face: jaw, brows, nose, eyes, mouth.
fn face() -> Vec<Place> {
    let arc = |count: u8, [cx, cy]: Place, [rx, ry]: Place, from: f64, to: f64| {
        (0..count).map(move |k| {
            let angle = from + (to - from) * f64::from(k) / f64::from(count - 1);
            rounded([cx + rx * angle.cos(), cy + ry * angle.sin()])
        })
    };
    let tau = std::f64::consts::TAU;
    let eye = |x: f64| arc(7, [x, 210.0], [28.0, 11.0], 0.0, tau).take(6);
    arc(17, [256.0, 230.0], [130.0, 170.0], 0.0, tau / 2.0)
        .chain(arc(5, [200.0, 190.0], [38.0, 18.0], tau / 2.0, tau))
        .chain(arc(5, [312.0, 190.0], [38.0, 18.0], tau / 2.0, tau))
        .chain((0..4).map(|k| [256.0, 205.0 + 22.5 * f64::from(k)]))
        .chain(arc(5, [256.0, 285.0], [26.0, 9.0], tau / 2.0, 0.0))
        .chain(eye(200.0))
        .chain(eye(312.0))
        .chain(arc(13, [256.0, 335.0], [46.0, 21.0], 0.0, tau).take(12))
        .chain(arc(9, [256.0, 335.0], [32.0, 8.0], 0.0, tau).take(8))
        .collect()
}

fn scattered(count: u32, [width, height]: [f64; 2]) -> Vec<Place> {
    let share = |k: u32, step: f64| (f64::from(k) * step).fract();
    (0..count)
        .map(|k| {
            rounded([
                20.0 + (width - 40.0) * share(k, 0.754_877_67),
                20.0 + (height - 40.0) * share(k, 0.569_840_29),
            ])
        })
        .collect()
}

fn sets() -> Vec<Set> {
    let set = |name, size: [f64; 2], p: Vec<Place>| Set {
        name,
        size,
        q: p.iter().map(|place| bent(*place, size)).collect(),
        p,
    };
    let (tissue, map) = ([1164.0, 787.0], [900.0, 700.0]);
    vec![
        set("face", [512.0, 512.0], face()),
        set("tissue", tissue, scattered(69, tissue)),
        set("map", map, scattered(20, map)),
    ]
}

/// A file, and what it says: the handles at rest, whether it has both sides, and the units.
struct File {
    text: String,
    p: Value,
    has_q: bool,
    normalized: bool,
}

fn lines<T>(places: &[T], line: impl Fn(usize, &T) -> String) -> String {
    places
        .iter()
        .enumerate()
        .map(|(k, place)| line(k, place))
        .collect()
}

/// The set in every form of every format.
fn files(Set { p, q, size, .. }: &Set) -> Vec<(&'static str, &'static str, File)> {
    let places = json!(p);
    let one = |text: String| File {
        text,
        p: places.clone(),
        has_q: false,
        normalized: false,
    };
    let both = |text: String| File {
        has_q: true,
        ..one(text)
    };
    let shares = |text: String| File {
        normalized: true,
        ..one(text)
    };
    let rows = |separator: &str, end: &str| lines(p, |_, [x, y]| format!("{x}{separator}{y}{end}"));
    let pairs: Vec<(Place, Place)> = p.iter().copied().zip(q.iter().copied()).collect();
    let comma = |c: f64| c.to_string().replace('.', ",");
    let bigwarp = |id: bool| {
        let id = |k: usize| {
            if id {
                format!("\"{k}\",")
            } else {
                String::new()
            }
        };
        // Landmarks are set in the moving image first; some are switched off.
        let extra = format!(
            "\"Pt-off\",\"false\",{}\"1.0\",\"2.0\",\"3.0\",\"4.0\"\n",
            id(900)
        );
        extra
            + &lines(&pairs, |k, ([a, b], [c, d])| {
                format!(
                    "\"Pt-{k}\",\"true\",{}\"{}\",\"{}\",\"{}\",\"{}\"\n",
                    id(k),
                    a - 0.5,
                    b - 0.5,
                    c - 0.5,
                    d - 0.5
                )
            })
    };
    let pts = |begin: &str| {
        format!(
            "{begin}n_points: {}\n{{\n{}}}\n",
            p.len(),
            lines(p, |_, [x, y]| format!("{} {}\n", x + 0.5, y + 0.5))
        )
    };
    let tem = format!(
        "{}\n{}",
        p.len(),
        lines(p, |_, [x, y]| format!("{}\t{}\n", x - 0.5, y - 0.5))
    );
    // The first six points are two contours, one of them closed.
    let contours = json!([[p[0], p[1], p[2], p[0]], [p[3], p[4], p[5]]]);
    let of_contours: Vec<Value> = p[6..]
        .iter()
        .map(|place| json!(place))
        .chain(contours.as_array().unwrap().clone())
        .collect();
    let share = |[x, y]: &Place| [x / size[0], y / size[1]];
    let listed = |z: bool| -> Value {
        let object = |place: &Place| {
            let [x, y] = share(place);
            if z {
                json!({"x": x, "y": y, "z": -0.01, "visibility": 0.9})
            } else {
                json!({"x": x, "y": y})
            }
        };
        p.iter().map(object).collect()
    };
    let shape = |k: usize, place: &Place| {
        json!({"label": format!("L{k}"), "points": [place], "group_id": null,
            "shape_type": "point", "flags": {}})
    };
    let labelme: Vec<Value> = p
        .iter()
        .enumerate()
        .map(|(k, place)| shape(k, place))
        .collect();
    let qgis = |names: &str, begin: &str| {
        format!(
            "{begin}mapX,mapY,{names},enable,dX,dY,residual\n{}",
            lines(p, |k, [x, y]| format!(
                "{}.5,48{k},{x},{},1,0,0,0\n",
                1000 + k,
                -y
            ))
        )
    };
    let document = |shapes: Value| {
        json!({
            "version": "5.5.0", "flags": {}, "shapes": shapes, "imagePath": "a.png",
                "imageData": null, "imageHeight": size[1],
            "imageWidth": size[0]
        })
    };
    vec![
        ("csv", "bare", one(rows(",", "\n"))),
        ("csv", "header", one(format!("x,y\n{}", rows(",", "\n")))),
        (
            "csv",
            "BOM, CRLF",
            one(format!("\u{feff}X,Y\r\n{}", rows(",", "\r\n"))),
        ),
        ("csv", "tabs", one(format!("x\ty\n{}", rows("\t", "\n")))),
        (
            "csv",
            "decimal commas",
            one(format!(
                "x;y\n{}",
                lines(p, |_, [x, y]| format!("{};{}\n", comma(*x), comma(*y)))
            )),
        ),
        (
            "csv",
            "names",
            one(format!(
                "name,x,y\n{}",
                lines(p, |k, [x, y]| format!("\"point {k}, left\",{x},{y}\n"))
            )),
        ),
        (
            "csv",
            "pairs",
            both(format!(
                "px,py,qx,qy\n{}",
                lines(&pairs, |_, ([a, b], [c, d])| format!("{a},{b},{c},{d}\n"))
            )),
        ),
        (
            "csv",
            "named pairs",
            both(lines(&pairs, |k, ([a, b], [c, d])| {
                format!("p{k},{a},{b},{c},{d}\n")
            })),
        ),
        ("bigwarp", "6 fields", both(bigwarp(false))),
        ("bigwarp", "7 fields", both(bigwarp(true))),
        ("pts", "300-W", one(pts("version: 1\n"))),
        (
            "pts",
            "without a version",
            one(pts("").replace('\n', "\r\n")),
        ),
        ("tem", "points", one(format!("{tem}0\n"))),
        ("tem", "comments", one(format!("# a template\n\n{tem}"))),
        (
            "tem",
            "contours",
            File {
                p: json!(of_contours),
                ..one(format!("{tem}2\n1\n3\n0 1 2\n0\n3\n3 4 5\n"))
            },
        ),
        ("mediapipe", "objects", shares(listed(true).to_string())),
        (
            "mediapipe",
            "faceLandmarks",
            shares(json!({"faceLandmarks": [listed(false)], "faceBlendshapes": []}).to_string()),
        ),
        (
            "arkit",
            "jointLandmarks",
            shares(json!({"jointLandmarks": p.iter().map(share).collect::<Vec<_>>()}).to_string()),
        ),
        (
            "labelme",
            "points",
            one(document(json!(labelme)).to_string()),
        ),
        (
            "qgis",
            "source",
            one(qgis("sourceX,sourceY", "#CRS: GEOGCRS[\"WGS 84\"]\n")),
        ),
        ("qgis", "pixel", one(qgis("pixelX,pixelY", ""))),
        (
            "json",
            "both sides",
            both(json!({"p": p, "q": q}).to_string()),
        ),
    ]
}

/// Whether two lists of handles are the same but for the last digits.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b))
        }
        _ => {
            (a.as_f64().unwrap() - b.as_f64().unwrap()).abs()
                < 1e-9 * (1.0 + a.as_f64().unwrap().abs())
        }
    }
}

async fn read(server: &Server, text: String, query: &str) -> Value {
    let response = server
        .post(&format!("/landmarks{query}"))
        .header("content-type", "application/octet-stream")
        .body(text)
        .send()
        .await
        .unwrap();
    let (status, answer) = (response.status(), response.text().await.unwrap());
    assert_eq!(status, 200, "{answer}");
    serde_json::from_str(&answer).unwrap()
}

#[tokio::test]
async fn every_format_is_read_and_its_answer_is_read_again() {
    let server = Server::start(&[]).await;
    let mut tried = 0;
    for set in sets() {
        for (
            format,
            form,
            File {
                text,
                p,
                has_q,
                normalized,
            },
        ) in files(&set)
        {
            let what = format!("{}, {format}, {form}", set.name);
            let query = if normalized {
                format!("?extent_p={},{}", set.size[0], set.size[1])
            } else {
                String::new()
            };
            let answer = read(&server, text, &query).await;
            assert_eq!(
                (&answer["format"], &answer["units"]),
                (&json!(format), &json!("px")),
                "{what}"
            );
            assert!(same(&answer["p"], &p), "{what}: {}", answer["p"]);
            assert_eq!(answer.get("q").is_some(), has_q, "{what}");
            assert!(
                !has_q || same(&answer["q"], &json!(set.q)),
                "{what}: {}",
                answer["q"]
            );
            let mut again = read(&server, answer.to_string(), "").await;
            again["format"] = answer["format"].clone();
            assert_eq!(again, answer, "{what}");
            tried += 1;
        }
    }
    assert!(tried >= 60, "{tried}");
}

async fn warped(server: &Server, image: Vec<u8>, parts: &[(&'static str, String)]) -> Response {
    let form = Form::new().part("image", Part::bytes(image).file_name("a.png"));
    let form = parts
        .iter()
        .fold(form, |form, (name, text)| form.text(*name, text.clone()));
    let response = server.post("/warp").multipart(form).send().await.unwrap();
    assert_eq!(response.status(), 200, "{:?}", response.text().await);
    response
}

fn residual(response: &Response) -> f64 {
    header(response, "warp-residual").parse().unwrap()
}

fn warnings(response: &Response) -> &str {
    response
        .headers()
        .get("warp-warning")
        .map_or("", |text| text.to_str().unwrap())
}

/// The default grid draws every handle within this, px.
const TOLERANCE: f64 = 0.25;

#[tokio::test]
async fn a_face_of_478_rounded_landmarks_is_warped_although_some_coincide() {
    // Rings of a face mesh, rounded to whole pixels, two of them at one place with other targets.
    let mut p: Vec<Place> = (0..478u32)
        .map(|k| {
            let (ring, angle) = (
                f64::from(k / 40),
                f64::from(k % 40) / 40.0 * std::f64::consts::TAU + f64::from(k / 40),
            );
            [
                256.0 + (10.0 + 12.0 * ring) * angle.cos(),
                250.0 + (12.0 + 15.0 * ring) * angle.sin(),
            ]
            .map(f64::round)
        })
        .collect();
    p[477] = p[100];
    let q: Vec<Place> = p
        .iter()
        .enumerate()
        .map(|(k, place)| {
            let [x, y] = bent(*place, [512.0, 512.0]);
            [x.round() + if k == 477 { 3.0 } else { 0.0 }, y.round()]
        })
        .collect();
    let server = Server::start(&[]).await;
    let text = lines(&p.iter().zip(&q).collect::<Vec<_>>(), |_, (p, q)| {
        format!("{},{},{},{}\n", p[0], p[1], q[0], q[1])
    });
    let drawn = warped(&server, photo(512, 512), &[("landmarks", text)]).await;
    assert!(
        warnings(&drawn).contains("coincident_handles"),
        "{}",
        warnings(&drawn)
    );
    assert!(
        residual(&drawn) <= TOLERANCE || warnings(&drawn).contains("tolerance_exceeded"),
        "{} {}",
        residual(&drawn),
        warnings(&drawn)
    );
}

/// 44 contours on 189 points, some of which cross others.
fn template(places: &[Place]) -> String {
    let count = places.len();
    let contours = lines(&[(); 44], |k, ()| {
        let indices: Vec<String> = (0..5)
            .map(|n| ((k * 4 + n * (1 + k % 3)) % count).to_string())
            .collect();
        format!("0\n5\n{}\n", indices.join(" "))
    });
    format!(
        "{count}\n{}44\n{contours}",
        lines(places, |_, [x, y]| format!("{}\t{}\n", x - 0.5, y - 0.5))
    )
}

#[tokio::test]
async fn a_template_of_crossing_contours_is_moved_to_another() {
    let p = scattered(189, [512.0, 512.0]);
    let q: Vec<Place> = p.iter().map(|place| bent(*place, [512.0, 512.0])).collect();
    let server = Server::start(&[]).await;
    let drawn = warped(
        &server,
        photo(512, 512),
        &[("landmarks_p", template(&p)), ("landmarks_q", template(&q))],
    )
    .await;
    assert!(
        warnings(&drawn).contains("coincident_handles"),
        "{}",
        warnings(&drawn)
    );
}

#[tokio::test]
async fn a_section_is_registered_into_the_frame_of_another() {
    let Set { p, q, .. } = sets().remove(1);
    let text = lines(&p.iter().zip(&q).collect::<Vec<_>>(), |k, (p, q)| {
        format!(
            "\"Pt-{k}\",\"true\",\"{}\",\"{}\",\"{}\",\"{}\"\n",
            p[0] - 0.5,
            p[1] - 0.5,
            q[0] - 0.5,
            q[1] - 0.5
        )
    });
    let frame = json!({"method": "tps",
        "output": {"canvas": {"x": 0, "y": 0, "width": 1123, "height": 724}}});
    let server = Server::start(&[]).await;
    let drawn = warped(
        &server,
        photo(1164, 787),
        &[("landmarks", text), ("warp", frame.to_string())],
    )
    .await;
    assert_eq!(
        (header(&drawn, "warp-canvas"), warnings(&drawn)),
        ("0,0,1123,724", "")
    );
    assert!(residual(&drawn) <= TOLERANCE, "{}", residual(&drawn));
    let picture = image::load_from_memory(&drawn.bytes().await.unwrap()).unwrap();
    assert_eq!((picture.width(), picture.height()), (1123, 724));
}

#[tokio::test]
async fn a_scanned_map_gets_the_method_that_fits_its_control_points() {
    let Set { p, q, .. } = sets().remove(2);
    let control = format!(
        "mapX,mapY,sourceX,sourceY,enable\n{}",
        lines(&p, |k, [x, y]| format!("{k},{k},{x},{},1\n", -y))
    );
    let target = format!("x,y\n{}", lines(&q, |_, [x, y]| format!("{x},{y}\n")));
    let server = Server::start(&[]).await;
    let parts = [
        ("landmarks_p", control),
        ("landmarks_q", target),
        ("warp", json!({"method": "auto"}).to_string()),
    ];
    let drawn = warped(&server, photo(900, 700), &parts).await;
    let method = header(&drawn, "warp-method").to_owned();
    assert!(
        method.starts_with("tps") || method.starts_with("affine"),
        "{method}: a map that bends smoothly"
    );
}
