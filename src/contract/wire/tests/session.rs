//! The session object.

use super::*;

#[test]
fn session_object_is_written_in_wire_form() {
    let p = [point(1.0, 2.0), line(&[(0.5, 1.0), (2.0, 3.0)])];
    let output = OutputSpec {
        width: Some(9),
        outside: Outside::Colour([1, 2, 3, 255]),
        ..OutputSpec::default()
    };
    let session = SessionObject {
        id: "0f8fad5b-d9cb-469f-a165-70867728950e",
        image: SessionImage {
            width: 640,
            height: 480,
            digest: AsJson(Digest([0xab; 32])),
        },
        p: AsJson(&p),
        q: None,
        strength: None,
        weights: None,
        depth: None,
        method: AsJson(Method::Rigid),
        alpha: Some(2.0),
        point_mass: Some(2.5),
        smoothing: None,
        own: AsJson(Parameters::default()),
        metric: None,
        mask: None,
        coincident: vec![CoincidentGroup {
            handles: vec![0, 4],
        }],
        coincident_policy: None,
        units: AsJson(Units::Px),
        align: None,
        grid: SessionGrid {
            columns: 129,
            rows: 97,
            cell: [5.0, 5.0],
            requested: AsJson(GridSpec::Auto),
        },
        rest_revision: "0123456789abcdef0123456789abcdef",
        folds: AsJson(Folds::Report),
        output: AsJson(&output),
        layers: [(
            "depth",
            SessionLayer {
                kind: AsJson(LayerKind::Labels),
            },
        )]
        .into(),
        created: "2026-11-20T12:00:00Z",
    };
    let whole = |seq| {
        let mut text = serde_json::to_string(&session).unwrap();
        assert_eq!(text.pop(), Some('}'));
        serde_json::from_str::<Value>(&(text + &session_tail("2026-11-20T12:15:00Z", seq))).unwrap()
    };
    assert_eq!(whole(Some(7))["seq"], json!(7));
    assert_eq!(
        whole(None),
        json!({
            "id": "0f8fad5b-d9cb-469f-a165-70867728950e",
            "image": {"width": 640, "height": 480, "digest": format!("sha256:{}", "ab".repeat(32))},
            "p": [[1.0, 2.0], [[0.5, 1.0], [2.0, 3.0]]],
            "method": "rigid", "alpha": 2.0, "point_mass": 2.5, "coincident": [{"handles": [0, 4]}],
                "units": "px",
            "grid": {"columns": 129, "rows": 97, "cell": [5.0, 5.0], "requested": "auto"},
            "rest_revision": "0123456789abcdef0123456789abcdef",
            "folds": "report",
            "output": {
                "format": "png", "quality": 85, "compression": "fast", "width": 9,
                    "filter": "bilinear", "outside": "#010203ff",
                "canvas": "same", "holes": "keep"
            },
            "layers": {"depth": {"kind": "labels"}},
            "created": "2026-11-20T12:00:00Z", "expires": "2026-11-20T12:15:00Z", "seq": null
        })
    );
}
