//! Handles that coincide at rest: points are grouped, crossing lines share the mean, and what is
//! conflicting is reported.

use mlswarp::deform::{
    CoefficientTable, Coincident, DeformError, Falloff, Handle, Handles, Method, Parameters,
    RestDeformation, Warning,
};
use mlswarp::geometry::{Grid, Point, Vec2};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::support::{DragClient, Server, photo};

const METHODS: [Method; 3] = [Method::Affine, Method::Similarity, Method::Rigid];

fn dot(x: f64, y: f64) -> Handle {
    Handle::Point(Point::new(x, y))
}

fn line(places: &[(f64, f64)]) -> Handle {
    Handle::Polyline(places.iter().map(|&(x, y)| Point::new(x, y)).collect())
}

fn field(
    p: Vec<Handle>,
    weights: Option<Vec<f64>>,
    within: f64,
    method: Method,
    alpha: f64,
) -> Result<RestDeformation, DeformError> {
    let handles = Handles::new(p, weights)?;
    let falloff = Falloff::new(alpha, handles.has_lines())?;
    let coincident = Coincident {
        within,
        ..Coincident::default()
    };
    let given = Parameters::default()
        .with("alpha", falloff.alpha())
        .with("point_mass", 30.0);
    RestDeformation::of(handles, coincident, method, &given, &|| false)
}

fn near(found: Point, expected: Point, tolerance: f64) {
    assert!(
        found.distance(expected) <= tolerance,
        "{found:?}, expected {expected:?}"
    );
}

#[test]
fn points_within_a_distance_are_one_handle_at_the_weighted_mean() {
    let p = vec![
        dot(20.0, 30.0),
        dot(90.0, 40.0),
        dot(22.0, 30.0),
        dot(50.0, 90.0),
        dot(23.5, 30.0),
    ];
    let q = vec![
        dot(24.0, 30.0),
        dot(95.0, 40.0),
        dot(26.0, 34.0),
        dot(50.0, 80.0),
        dot(27.5, 30.0),
    ];
    let weights = vec![1.0, 1.0, 2.0, 1.0, 1.0];
    for (method, alpha) in METHODS
        .iter()
        .flat_map(|method| [0.75, 1.0, 2.0].map(|alpha| (*method, alpha)))
    {
        let grouped = field(p.clone(), Some(weights.clone()), 2.0, method, alpha).unwrap();
        let pose = grouped.pose(&q).unwrap();
        assert_eq!(grouped.groups(), [vec![0, 2, 4]], "0 and 4 are joined by 2");
        // By hand: the same set with one handle in their place.
        let (rest, moved) = (Point::new(21.875, 30.0), Point::new(25.875, 32.0));
        let by_hand = vec![Handle::Point(rest), p[1].clone(), p[3].clone()];
        let by_hand = field(by_hand, Some(vec![4.0, 1.0, 1.0]), 0.0, method, alpha).unwrap();
        let pose_by_hand = by_hand
            .pose(&[Handle::Point(moved), q[1].clone(), q[3].clone()])
            .unwrap();
        near(grouped.map(&pose, rest), moved, 1e-9);
        for (x, y) in [(0.0, 0.0), (21.0, 30.0), (60.0, 50.0), (300.0, -20.0)] {
            near(
                grouped.map(&pose, Point::new(x, y)),
                by_hand.map(&pose_by_hand, Point::new(x, y)),
                1e-9,
            );
        }
        assert!(
            grouped
                .warnings(&pose)
                .contains(&Warning::CoincidentHandles)
        );
        assert!(
            grouped.warnings(&grouped.pose(&p).unwrap()).is_empty(),
            "at rest nothing contradicts"
        );
        let [listed] = pose.conflicts().listed.as_slice() else {
            panic!("{:?}", pose.conflicts())
        };
        assert_eq!(
            (listed.handles.as_slice(), listed.spread),
            (&[0, 2, 4][..], 2.0)
        );
    }
}

proptest! {
    /// Without a distance, every handle that does not contradict another is met exactly, whatever
    /// the others do.
    #[test]
    fn a_handle_that_nothing_contradicts_is_met(
        places in proptest::collection::vec((0..12_i32, 0..12_i32, -5..5_i32, -5..5_i32), 3..30),
        method in proptest::sample::select(&METHODS[..]),
        alpha in proptest::sample::select(&[0.75, 1.0, 1.5, 2.0, 3.0][..]),
    ) {
        let at = |k: i32| f64::from(k) * 7.0 + 0.5;
        let p: Vec<Handle> = places.iter().map(|&(x, y, ..)| dot(at(x), at(y))).collect();
        let q: Vec<Handle> = places.iter().map(|&(x, y, dx, dy)| dot(at(x) + f64::from(dx), at(y)
            + f64::from(dy))).collect();
        let field = field(p.clone(), None, 0.0, method, alpha).unwrap();
        let pose = field.pose(&q).unwrap();
        let contradicts = |i: usize| pose.conflicts().listed.iter().any(
            |group| group.handles.contains(&i));
        for (i, &(x, y, dx, dy)) in places.iter().enumerate() {
            let alike = places.iter().all(|other| (other.0, other.1) != (x, y)
                || (other.2, other.3) == (dx, dy));
            prop_assert_eq!(contradicts(i), !alike);
            if alike {
                let (p, q) = (Point::new(at(x), at(y)), Point::new(at(x) + f64::from(dx),
                    at(y) + f64::from(dy)));
                prop_assert!(field.map(&pose, p).distance(q) < 1e-9, "{:?}: {:?}", q,
                    field.map(&pose, p));
            }
        }
    }
}

#[test]
fn the_position_that_lines_share_moves_by_the_weighted_mean() {
    let p = vec![
        line(&[(0.0, 0.0), (64.0, 64.0)]),
        line(&[(0.0, 64.0), (32.0, 32.0), (64.0, 0.0)]),
        dot(48.0, 48.0),
    ];
    // The second line moves 8 px to the right, the point 6 px down; the weights are 1, 3 and 2.
    let q = vec![
        p[0].clone(),
        line(&[(8.0, 64.0), (40.0, 32.0), (72.0, 0.0)]),
        dot(48.0, 54.0),
    ];
    let weights = Some(vec![1.0, 3.0, 2.0]);
    for (method, alpha) in METHODS
        .iter()
        .flat_map(|method| [1.0, 2.0, 3.0].map(|alpha| (*method, alpha)))
    {
        let field = field(p.clone(), weights.clone(), 0.0, method, alpha).unwrap();
        let pose = field.pose(&q).unwrap();
        near(
            field.map(&pose, Point::new(32.0, 32.0)),
            Point::new(38.0, 32.0),
            1e-12,
        );
        near(
            field.map(&pose, Point::new(48.0, 48.0)),
            Point::new(48.0, 52.0),
            1e-12,
        );
        near(
            field.map(&pose, Point::new(16.0, 16.0)),
            Point::new(16.0, 16.0),
            1e-9,
        );
        let groups: Vec<_> = pose
            .conflicts()
            .listed
            .iter()
            .map(|group| (group.handles.clone(), group.position.x.round()))
            .collect();
        assert_eq!(groups, [(vec![0, 1], 32.0), (vec![0, 2], 48.0)]);
        // The table has the same rows.
        let grid = Grid::with_counts(64.0, 64.0, 5, 5);
        let (mesh, _) = CoefficientTable::of_grid(&field, &grid, &|| false)
            .unwrap()
            .pose(&grid, &pose, &|| false)
            .unwrap();
        near(mesh.posed(2, 2), Point::new(38.0, 32.0), 1e-5);
        assert!((0..25).all(|k| mesh.posed(k % 5, k / 5).is_finite()));
    }
}

#[test]
fn groups_that_meet_only_at_their_means_are_handles_of_one_position() {
    // A ring of points within 8 px of their neighbours, and a point at its centre.
    let angle = |k: i32| std::f64::consts::TAU * f64::from(k) / 12.0;
    let mut p: Vec<Handle> = (0..12)
        .map(|k| dot(100.0 + 12.0 * angle(k).cos(), 80.0 + 12.0 * angle(k).sin()))
        .collect();
    p.extend([dot(100.0, 80.0), dot(200.0, 20.0), dot(10.0, 20.0)]);
    let moved = |by: Vec2| move |h: &Handle| Handle::Point(h.places()[0] + by);
    let q: Vec<Handle> = p
        .iter()
        .enumerate()
        .map(|(k, h)| {
            moved(if k == 12 {
                Vec2::new(0.0, 9.0)
            } else {
                Vec2::ZERO
            })(h)
        })
        .collect();
    let field = field(p, None, 8.0, Method::Rigid, 1.0).unwrap();
    assert_eq!(field.groups(), [(0..12).collect::<Vec<_>>()]);
    let pose = field.pose(&q).unwrap();
    let [group] = pose.conflicts().listed.as_slice() else {
        panic!("{:?}", pose.conflicts())
    };
    assert_eq!((group.handles.len(), group.total), (13, 13));
    near(
        field.map(&pose, Point::new(100.0, 80.0)),
        Point::new(100.0, 80.0 + 9.0 / 13.0),
        1e-9,
    );
}

#[tokio::test]
async fn points_of_a_tiny_set_far_from_the_origin_are_two() {
    let server = Server::start(&[]).await;
    let warp = json!({"p": [[999_999, 0], [999_999.000_002, 0]],
        "q": [[999_999, 0], [999_999.000_01, 5]]});
    let answer = server.upload("/warp", &photo(20, 10), &warp).await;
    assert_eq!(answer.status(), 200, "{:?}", answer.text().await);
}

#[tokio::test]
async fn landmarks_that_were_rounded_are_warped_and_the_groups_are_named() {
    let server = Server::start(&[]).await;
    let image = photo(120, 90);
    let p = json!([[20, 30], [90, 40], [20, 30], [50, 80]]);
    let q = json!([[24, 30], [95, 40], [28, 30], [50, 70]]);
    let response = server
        .upload("/warp", &image, &json!({"p": p, "q": q}))
        .await;
    assert_eq!(
        (
            response.status().as_u16(),
            &response.headers()["warp-warning"]
        ),
        (200, &"coincident_handles".parse().unwrap())
    );
    // The drawn position is measured against the mean.
    let residual: f64 = response.headers()["warp-residual"]
        .to_str()
        .unwrap()
        .parse()
        .unwrap();
    assert!(residual < 1.0, "{residual}");

    let session: Value = server
        .upload("/sessions", &image, &json!({"p": p}))
        .await
        .json()
        .await
        .unwrap();
    assert_eq!(session["coincident"], json!([{"handles": [0, 2]}]));
    assert_eq!(session.get("coincident_policy"), None, "the default");
    let id = session["id"].as_str().unwrap();
    let mut drag = DragClient::open(server.address, id, "?report=true").await;
    drag.pose(1, &q).await;
    let report = drag.text().await;
    assert_eq!(report["warnings"], json!(["coincident_handles"]));
    assert_eq!(
        report["coincident"],
        json!([{"handles": [0, 2], "position": [20.0, 30.0], "spread": 2.0}])
    );
    drag.ack_of_next_frame(1).await;
    drag.pose(2, &p).await;
    while drag.text().await["seq"] != 2 {}

    // The policy belongs to the session, and stays when only the handles are replaced.
    let put = async |body: Value| {
        server
            .client
            .put(server.url(&format!("/sessions/{id}/handles")))
            .json(&body)
            .send()
            .await
            .unwrap()
    };
    assert_eq!(
        put(json!({"coincident": {"policy": "reject"}}))
            .await
            .status(),
        200
    );
    let near = json!([[20, 30], [90, 40], [21, 30], [50, 80]]);
    let replaced: Value = put(json!({"p": near})).await.json().await.unwrap();
    assert_eq!(replaced.get("coincident"), None, "nothing coincides");
    assert_eq!(
        replaced["coincident_policy"],
        json!({"policy": "reject", "within": 0.0}),
        "kept"
    );
    assert_eq!(put(json!({"p": p, "q": q})).await.status(), 422);
    let within: Value = put(json!({"coincident": {"within": 1}}))
        .await
        .json()
        .await
        .unwrap();
    assert_eq!(within["coincident"], json!([{"handles": [0, 2]}]));
    assert_eq!(
        put(json!({"p": p, "q": q})).await.status(),
        200,
        "the whole policy was replaced"
    );
}

#[tokio::test]
async fn a_distance_that_joins_everything_takes_no_list_of_pairs() {
    let server = Server::start(&[]).await;
    let image = photo(64, 48);
    let p: Vec<[u32; 2]> = (0..9_999).map(|k| [k % 64, k / 64 % 48]).collect();
    let warp = json!({"p": p, "q": p, "coincident": {"within": 1e6}});
    let response = server.upload("/warp", &image, &warp).await;
    assert_eq!(
        (
            response.status().as_u16(),
            &response.headers()["warp-warning"]
        ),
        (200, &"translation_only".parse().unwrap())
    );
}

/// f takes the mean of grouped points to the mean of their targets; how far it misses them at their
/// own positions is reported.
#[tokio::test]
async fn the_residual_counts_grouped_points_where_they_are() {
    let server = Server::start(&[]).await;
    let p = [(60.0, 60.0), (80.0, 60.0), (70.0, 110.0), (150.0, 60.0)];
    let q = [(60.0, 70.0), (80.0, 70.0), (70.0, 100.0), (150.0, 60.0)];
    let dots = |at: &[(f64, f64)]| at.iter().map(|&(x, y)| dot(x, y)).collect::<Vec<_>>();
    let field = field(dots(&p), None, 25.0, Method::Rigid, 1.0).unwrap();
    let pose = field.pose(&dots(&q)).unwrap();
    let miss = |(p, q): (&(f64, f64), &(f64, f64))| {
        field
            .map(&pose, Point::new(p.0, p.1))
            .distance(Point::new(q.0, q.1))
    };
    let want = p.iter().zip(&q).map(miss).fold(0.0, f64::max);
    assert!(want > 1.0, "{want}");
    let warp = json!({"p": p, "q": q, "coincident": {"within": 25}});
    let answer = server.upload("/warp", &photo(200, 150), &warp).await;
    let header = |name: &str| {
        answer
            .headers()
            .get(name)
            .map(|value| value.to_str().unwrap().to_owned())
    };
    let residual: f64 = header("warp-residual").unwrap().parse().unwrap();
    assert!((residual - want).abs() <= 0.25, "{residual} {want}");
    assert_eq!(header("warp-warning"), None, "the targets agree");
}
