//! Field morphing by lines: the reference cases of `tests/beier_neely.json` (40 digits, from the
//! definition), laws for random lines, and what routes say.

use mlswarp::deform::{
    CoefficientTable, Coincident, DeformError, Handle, Handles, Method, NotTaken, Parameters, Pose,
    RestDeformation,
};
use mlswarp::geometry::{Point, Vec2};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::support::server::problem;
use crate::support::{Server, photo};

const NAMES: [&str; 3] = ["beier_neely/a", "beier_neely/b", "beier_neely/p"];

fn parameters(values: [f64; 3]) -> Parameters {
    NAMES
        .iter()
        .zip(values)
        .fold(Parameters::default(), |all, (name, value)| {
            all.with(name, value)
        })
}

fn field(p: Vec<Handle>, values: [f64; 3]) -> Result<RestDeformation, DeformError> {
    RestDeformation::of(
        Handles::new(p, None)?,
        Coincident::default(),
        Method::BeierNeely,
        &parameters(values),
        &|| false,
    )
}

fn posed(
    p: &[Handle],
    q: &[Handle],
    values: [f64; 3],
) -> Result<(RestDeformation, Pose), DeformError> {
    let field = field(p.to_vec(), values)?;
    let pose = field.pose(q)?;
    Ok((field, pose))
}

fn point(v: &Value) -> Point {
    Point::new(v[0].as_f64().unwrap(), v[1].as_f64().unwrap())
}

fn points(list: &Value) -> Vec<Point> {
    list.as_array().unwrap().iter().map(point).collect()
}

fn lines(list: &Value, end: &str) -> Vec<Handle> {
    let line = |line: &Value| Handle::Polyline(points(&line[end]));
    list.as_array().unwrap().iter().map(line).collect()
}

#[test]
fn reference_cases_of_field_morphing_are_met() {
    let file: Value = serde_json::from_str(include_str!("../beier_neely.json")).unwrap();
    let cases = file["cases"].as_array().unwrap();
    for case in cases {
        let values = ["a", "b", "p"].map(|name| case["params"][name].as_f64().unwrap());
        let given = &case["handles"]["lines"];
        let (field, pose) = posed(&lines(given, "p"), &lines(given, "q"), values).unwrap();
        let (places, tolerance) = (
            points(&case["vertices"]),
            case["tolerance"].as_f64().unwrap(),
        );
        let table = CoefficientTable::of_vertices(&field, places.len(), |k| places[k]);
        let (planned, _) = table.displace(&pose, &|| false).unwrap();
        let together = field
            .deformation(&pose)
            .map_all(&places, &|| false)
            .unwrap();
        for (k, want) in points(&case["expected"]).into_iter().enumerate() {
            let (name, v) = (&case["name"], places[k]);
            let exact = field.map(&pose, v);
            assert!(
                exact.distance(want) <= tolerance,
                "{name} at {v:?}: {exact:?}, not {want:?}"
            );
            assert_eq!(exact, together[k], "{name}");
            let d = Vec2::new(planned[k][0].into(), planned[k][1].into());
            assert!((v + d).distance(want) <= 1e-3, "{name} at {v:?}: plan");
        }
    }
    assert_eq!(cases.len(), 10);
    let of = |list: &Value, end: &str| {
        let at = |handle: &Value| Handle::Point(point(&handle[end]));
        list.as_array()
            .map_or_else(Vec::new, |list| list.iter().map(at).collect())
    };
    let mut found = Vec::new();
    for case in file["errors"].as_array().unwrap() {
        let all = |end: &str| match &case["lines"] {
            Value::Null => of(&case["points"], end),
            given => lines(given, end),
        };
        found.push(posed(&all("p"), &all("q"), [1.0, 2.0, 0.0]).unwrap_err());
    }
    let method = "beier_neely";
    assert_eq!(
        found,
        [
            DeformError::DegenerateLine {
                handle: 0,
                segment: 0
            },
            DeformError::NotTaken {
                handle: 0,
                method,
                reason: NotTaken::NoDirection
            },
            DeformError::NotTaken {
                handle: 0,
                method,
                reason: NotTaken::Point
            },
        ]
    );
}

fn place() -> impl Strategy<Value = Point> {
    (0.0..400.0, 0.0..300.0).prop_map(|(x, y)| Point::new(x, y))
}

/// A line at rest and posed, both at least 5 px long.
fn line() -> impl Strategy<Value = [[Point; 2]; 2]> {
    let end = || (place(), 0.0..std::f64::consts::TAU, 5.0..200.0);
    let ends = |(a, angle, length): (Point, f64, f64)| {
        [a, a + Vec2::new(angle.cos(), angle.sin()) * length]
    };
    (end(), end()).prop_map(move |(rest, posed)| [ends(rest), ends(posed)])
}

fn set() -> impl Strategy<Value = (Vec<[[Point; 2]; 2]>, [f64; 3])> {
    let values = (
        prop::sample::select(vec![0.0, 0.5, 1.0, 20.0]),
        0.5..=2.0,
        0.0..=1.0,
    );
    (prop::collection::vec(line(), 1..6), values).prop_map(|(lines, (a, b, p))| (lines, [a, b, p]))
}

fn handles(set: &[[[Point; 2]; 2]], side: usize) -> Vec<Handle> {
    set.iter()
        .map(|line| Handle::Polyline(line[side].to_vec()))
        .collect()
}

/// A rotation about the origin and a shift.
fn moved(p: Point, angle: f64, by: Vec2) -> Point {
    let (sin, cos) = angle.sin_cos();
    Point::new(p.x * cos - p.y * sin + by.x, p.x * sin + p.y * cos + by.y)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn field_morphing_leaves_lines_at_rest_bit_for_bit((set, values) in set(), v in place()) {
        let p = handles(&set, 0);
        let (field, pose) = posed(&p, &p, values).unwrap();
        prop_assert_eq!(field.map(&pose, v), v);
    }

    #[test]
    fn field_morphing_meets_its_lines_without_a(
        (set, [_, b, p]) in set(), along in 0.0..=1.0, which in any::<prop::sample::Index>()) {
        let (field, pose) = posed(&handles(&set, 0), &handles(&set, 1), [0.0, b, p]).unwrap();
        let [rest, to] = set[which.index(set.len())];
        let v = rest[0].lerp(rest[1], along);
        // Where another line crosses, the mean of both is meant.
        let off = |line: &[[Point; 2]; 2]| {
            let [a, b] = line[0];
            let t = ((v - a).dot(b - a) / (b - a).norm2()).clamp(0.0, 1.0);
            v.distance(a.lerp(b, t))
        };
        let crossed = set.iter().filter(|line| off(line) < 0.1).count() > 1;
        let want = to[0].lerp(to[1], along);
        // Beside the line by rounding, the others pull by the share of the distances.
        let allowed = if b < 1.0 { 1e-3 } else { 1e-8 };
        prop_assert!(crossed || field.map(&pose, v).distance(want) < allowed,
            "{:?}, not {want:?}", field.map(&pose, v));
    }

    #[test]
    fn field_morphing_follows_rigid_motions_of_either_side(
        (set, values) in set(), v in place(), angle in -3.0..3.0, x in -200.0..200.0) {
        let by = Vec2::new(x, 40.0);
        let (field, pose) = posed(&handles(&set, 0), &handles(&set, 1), values).unwrap();
        let f = field.map(&pose, v);
        let turned = |side: usize| {
            let mut set = set.clone();
            for line in &mut set {
                line[side] = line[side].map(|p| moved(p, angle, by));
            }
            set
        };
        let (q_turned, p_turned) = (turned(1), turned(0));
        let (field, pose) = posed(&handles(&q_turned, 0), &handles(&q_turned, 1), values).unwrap();
        let scale = 1.0 + f.distance(v);
        prop_assert!(field.map(&pose, v).distance(moved(f, angle, by)) < 1e-7 * scale);
        let (field, pose) = posed(&handles(&p_turned, 0), &handles(&p_turned, 1), values).unwrap();
        prop_assert!(field.map(&pose, moved(v, angle, by)).distance(f) < 1e-6 * scale);
    }

    #[test]
    fn field_morphing_knows_no_direction_and_no_order((set, values) in set(), v in place()) {
        let (field, pose) = posed(&handles(&set, 0), &handles(&set, 1), values).unwrap();
        let f = field.map(&pose, v);
        let mut other = set.clone();
        for line in &mut other {
            line.iter_mut().for_each(|ends| ends.reverse());
        }
        other.reverse();
        let (field, pose) = posed(&handles(&other, 0), &handles(&other, 1), values).unwrap();
        prop_assert!(field.map(&pose, v).distance(f) < 1e-8 * (1.0 + f.distance(v)));
    }

    #[test]
    fn field_morphing_is_finite_anywhere((set, values) in set(), x in -1e6..1e6, y in -1e6..1e6) {
        let (field, pose) = posed(&handles(&set, 0), &handles(&set, 1), values).unwrap();
        let mut places = vec![Point::new(x, y)];
        places.extend(set.iter().flat_map(|line| line[0]));
        for v in places {
            let f = field.map(&pose, v);
            prop_assert!(f.x.is_finite() && f.y.is_finite(), "{v:?}");
        }
    }
}

fn of(p: &Value, more: &Value) -> Value {
    let mut warp = json!({"p": p, "method": "beier_neely"});
    let fields = warp.as_object_mut().unwrap();
    fields.extend(more.as_object().unwrap().clone());
    warp
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn field_morphing_is_offered_by_every_route() {
    let server = Server::start(&[]).await;
    let (p, q) = (
        json!([[[20, 20], [140, 30]], [[40, 100], [60, 60], [130, 95]]]),
        json!([[[26, 34], [133, 22]], [[30, 104], [66, 70], [138, 88]]]),
    );
    let rest = of(
        &p,
        &json!({"beier_neely": {"a": 0, "b": 1.25}, "grid": {"columns": 19, "rows": 13}}),
    );
    let id = server.session(&photo(160, 120), &rest).await;
    let session: Value = server
        .get(&format!("/sessions/{id}"))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert_eq!(session["method"], "beier_neely");
    assert_eq!(
        session["beier_neely"],
        json!({"a": 0.0, "b": 1.25, "p": 0.0})
    );
    assert_eq!(session["alpha"], Value::Null);

    // Three real coefficients for each segment.
    let plan = server.get(&format!(
        "/sessions/{id}/plan?columns=19&rows=13&precision=f32"
    ));
    let plan = plan.send().await.unwrap().bytes().await.unwrap();
    let int = |at: usize| u32::from_le_bytes(plan[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!([8, 16, 20, 24, 28].map(int), [3, 19, 13, 6, 6]);
    let number = |at: usize| f64::from(f32::from_le_bytes(plan[at..at + 4].try_into().unwrap()));
    let (planes, vertices) = (64 + 16 * 6, 19 * 13);
    assert_eq!(plan.len(), planes + 4 * vertices * 9);
    let ends = |handles: &Value| -> Vec<[Point; 2]> {
        let all = handles.as_array().unwrap().iter().map(points);
        all.flat_map(|line| line.windows(2).map(|ab| [ab[0], ab[1]]).collect::<Vec<_>>())
            .collect()
    };
    let normal = |d: Vec2| Vec2::new(-d.y, d.x) * (1.0 / d.norm());
    let vectors: Vec<Vec2> = ends(&p)
        .into_iter()
        .zip(ends(&q))
        .flat_map(|([a, b], [c, e])| [c - a, (e - c) - (b - a), normal(e - c) - normal(b - a)])
        .collect();
    let mesh = server
        .post(&format!("/sessions/{id}/mesh"))
        .json(&json!({"q": q}));
    let mesh: Value = mesh.send().await.unwrap().json().await.unwrap();
    for (k, want) in points(&mesh["vertices"]).into_iter().enumerate() {
        let v = Point::new(
            160.0 / 18.0 * (k % 19) as f64,
            120.0 / 12.0 * (k / 19) as f64,
        );
        let d = vectors
            .iter()
            .enumerate()
            .fold(Vec2::ZERO, |sum, (n, vector)| {
                sum + *vector * number(planes + 4 * (n * vertices + k))
            });
        assert!((v + d).distance(want) < 1e-3, "vertex {k}");
    }

    // There and back; the lines are met.
    let there = server.post(&format!("/sessions/{id}/points"));
    let there: Value = there
        .json(&json!({"q": q, "points": [[80, 25], [50, 80], [77, 50]]}))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert!(
        point(&there["points"][0]).distance(Point::new(79.5, 28.0)) < 1e-6,
        "{there}"
    );
    let back = server.post(&format!("/sessions/{id}/points"));
    let back: Value = back
        .json(&json!({"q": q, "points": there["points"], "inverse": true}))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    assert!(
        point(&back["points"][2]).distance(Point::new(77.0, 50.0)) < 1e-4,
        "{back}"
    );

    let report = server
        .post(&format!("/sessions/{id}/report"))
        .json(&json!({"q": q}));
    assert_eq!(report.send().await.unwrap().status(), 200);
    let fit = server
        .post(&format!("/sessions/{id}/fit"))
        .json(&json!({"q": q}));
    assert_eq!(
        fit.send().await.unwrap().status(),
        422,
        "methods are compared on points"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_field_morphing_does_not_take_is_named() {
    let server = Server::start(&[]).await;
    let (p, q) = (
        json!([[[20, 20], [140, 30]]]),
        json!([[[26, 34], [133, 22]]]),
    );
    let image = photo(160, 120);
    let cases = [
        (
            json!({"p": [[1, 2]], "q": [[3, 4]]}),
            "not_supported",
            "/p/0",
        ),
        (json!({"q": [[[5, 5], [5, 5]]]}), "degenerate_line", "/q/0"),
        (json!({"alpha": 1}), "bad_value", "/alpha"),
        (json!({"point_mass": 1}), "bad_value", "/point_mass"),
        (
            json!({"beier_neely": {"a": -1}}),
            "bad_value",
            "/beier_neely/a",
        ),
        (
            json!({"beier_neely": {"b": 2.5}}),
            "bad_value",
            "/beier_neely/b",
        ),
        (
            json!({"beier_neely": {"p": 1.5}}),
            "bad_value",
            "/beier_neely/p",
        ),
        (
            json!({"beier_neely": {"p": "1"}}),
            "bad_value",
            "/beier_neely/p",
        ),
        (
            json!({"beier_neely": {"alpha": 1}}),
            "unknown_field",
            "/beier_neely/alpha",
        ),
        (json!({"beier_neely": 1}), "bad_value", "/beier_neely"),
        (
            json!({"method": "rigid", "beier_neely": {"a": 1}}),
            "bad_value",
            "/beier_neely",
        ),
        (
            json!({"method": "auto", "beier_neely": {"a": 1}}),
            "bad_value",
            "/beier_neely",
        ),
    ];
    for (more, code, pointer) in cases {
        let mut warp = of(&p, &json!({"q": q}));
        warp.as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        let response = server.upload("/warp", &image, &warp).await;
        let problem = problem(response, 422, code).await;
        assert_eq!(problem["pointer"], pointer, "{more}: {problem}");
    }
}
