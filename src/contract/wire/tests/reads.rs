//! What a warp object reads: every field, defaults, numbers.

use super::*;

#[test]
fn warp_reads_the_example_of_the_contract() {
    let text = br##"{
      "p": [[120, 80], [[40, 200], [300, 210]]],
      "q": [[130, 60], [[40, 220], [300, 190]]],
      "weights": [1, 2.5], "method": "similarity", "alpha": 1.0, "point_mass": 12,
        "smoothing": 0.5, "units": "normalized", "align": "affine",
      "coincident": {"policy": "reject", "within": 0.5},
      "grid": {"columns": 100, "rows": 50}, "folds": "reject", "metric": "euclidean",
      "output": {"format": "png", "compression": "best", "width": 800, "filter": "nearest",
        "outside": "#0180fF40",
        "canvas": "same", "holes": "transparent"}
    }"##;
    let expected = WarpObject {
        rest: RestSpec {
            p: vec![point(120.0, 80.0), line(&[(40.0, 200.0), (300.0, 210.0)])],
            depth: None,
            weights: Some(vec![1.0, 2.5]),
            method: Method::Similarity,
            alpha: Some(1.0),
            point_mass: Some(12.0),
            smoothing: Some(0.5),
            own: Parameters::default(),
            metric: Metric::Euclidean,
            mask_threshold: None,
            mask: None,
            coincident: Coincident {
                policy: CoincidentPolicy::Reject,
                within: 0.5,
            },
            units: Units::Normalized,
            grid: GridSpec::Counts {
                columns: 100,
                rows: 50,
            },
            align: Align::Affine,
            has_unmatched: false,
        },
        q: Some(vec![
            point(130.0, 60.0),
            line(&[(40.0, 220.0), (300.0, 190.0)]),
        ]),
        folds: Folds::Reject,
        output: OutputSpec {
            format: Format::Png,
            quality: 85,
            subsampling: None,
            compression: Compression::Best,
            canvas: CanvasSpec::Same,
            width: Some(800),
            filter: Filter::Nearest,
            outside: Outside::Colour([1, 128, 255, 64]),
            holes: Holes::Transparent,
        },
        strength: 1.0,
        is_auto: false,
    };
    assert_eq!(WarpObject::parse(text), Ok(expected));
}

#[test]
fn warp_has_defaults_for_everything() {
    assert_eq!(WarpObject::parse(b" {} "), Ok(WarpObject::default()));
    let defaults = br#"{"p": [], "method": "rigid", "units": "px", "align": "none", "grid": "auto",
          "folds": "report", "metric": "euclidean",
        "output": {"format": "png", "quality": 85, "compression": "fast", "filter": "bilinear",
          "outside": "transparent",
            "canvas": "same"}}"#;
    assert_eq!(WarpObject::parse(defaults), Ok(WarpObject::default()));
    assert_eq!(
        WarpObject::parse(br#"{"output": {}}"#),
        Ok(WarpObject::default())
    );
}

#[test]
fn warp_reads_every_form_of_grid_and_outside() {
    let grid = |text: &str| {
        WarpObject::parse(format!("{{\"grid\": {text}}}").as_bytes()).map(|w| w.rest.grid)
    };
    assert_eq!(grid("\"pixel\""), Ok(GridSpec::Pixel));
    assert_eq!(grid("{\"tolerance\": 0.05}"), Ok(GridSpec::Tolerance(0.05)));
    assert_eq!(grid("{\"cell\": 5}"), Ok(GridSpec::Cell(5.0)));
    assert_eq!(
        grid("{\"rows\": 2, \"columns\": 3.0}"),
        Ok(GridSpec::Counts {
            columns: 3,
            rows: 2
        })
    );
    let outside = |text: &str| {
        WarpObject::parse(format!("{{\"output\": {{\"outside\": {text}}}}}").as_bytes())
            .map(|w| w.output.outside)
    };
    assert_eq!(outside("\"edge\""), Ok(Outside::Edge));
    assert_eq!(outside("\"reflect\""), Ok(Outside::Reflect));
    assert_eq!(outside("{\"value\": 300}"), Ok(Outside::Value([300; 3])));
    assert_eq!(
        outside("{\"value\": [0, 256.0, 65535]}"),
        Ok(Outside::Value([0, 256, 65_535]))
    );
    assert_eq!(
        outside("\"#0a141e\""),
        Ok(Outside::Colour([10, 20, 30, 255]))
    );
    assert_eq!(outside("\"\\u0065dge\""), Ok(Outside::Edge));
}

#[test]
fn numbers_are_read_to_the_nearest_double() {
    let text = "{\"p\": [[1.0000000000000002e0, 122.416294033786585]], \"alpha\": 5e-324}";
    let warp = WarpObject::parse(text.as_bytes()).unwrap();
    assert_eq!(
        warp.rest.p,
        [point(1.0 + f64::EPSILON, 122.416_294_033_786_58)]
    );
    assert_eq!(warp.rest.alpha, Some(f64::from_bits(1)));
}
