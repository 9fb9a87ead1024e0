//! A photograph against the slow reference, to 1/255 on 99.9 % of the samples.

use super::*;

/// The share of samples of `out` that differ by more than 1/255 from the reference.
fn deviating(
    source: &Source,
    mesh: &Mesh,
    target: Extent,
    k: u32,
    channels: usize,
    out: &[u8],
) -> f64 {
    let picture = source.pixmap().reduced(k, &|| false).unwrap();
    let mut deviating = 0;
    for (place, drawn) in reference::places(mesh, target)
        .into_iter()
        .zip(out.chunks_exact(channels))
    {
        let expected = place.map_or([0.0; 4], |place| {
            reference::sample(&picture, place, f64::from(k).exp2())
        });
        // Colours of a nearly transparent pixel are invisible.
        let seen = expected[3] > 8.0;
        deviating += (0..channels)
            .filter(|&c| (c == 3 || seen) && (expected[c] - f64::from(drawn[c])).abs() > 1.5)
            .count();
    }
    deviating as f64 / out.len() as f64
}

fn check(picture: Pixmap, mesh: &Mesh, target: Extent, k: u32) {
    let source = Arc::new(Source::new(picture));
    assert_eq!(source.level_for(target), k);
    let (renderer, out) = draw(&source, mesh, options(target));
    let share = deviating(&source, mesh, target, k, renderer.channels().count(), &out);
    assert!(
        share <= 0.001,
        "{:.4} % of the samples deviate",
        100.0 * share
    );
    // The test can fail: an offset of half a pixel is detected.
    let shifted = posed(*mesh.grid(), |p| mesh.map(p).unwrap() + Vec2::new(0.5, 0.5));
    let (_, other) = draw(&source, &shifted, options(target));
    if other.len() == out.len() {
        assert!(
            deviating(
                &source,
                mesh,
                target,
                k,
                renderer.channels().count(),
                &other
            ) > 0.05
        );
    }
}

fn warped(counts: u32) -> Mesh {
    waves(Grid::with_counts(512.0, 512.0, counts, counts), 5, 0.7)
}

#[test]
fn photograph_equals_the_reference() {
    check(astronaut(), &warped(100), extent(512, 512), 0);
}

#[test]
fn photograph_on_coarse_cells_equals_the_reference() {
    check(astronaut(), &warped(17), extent(512, 512), 0);
}

#[test]
fn photograph_at_half_width_equals_the_reference() {
    check(astronaut(), &warped(100), extent(256, 256), 1);
}

#[test]
fn photograph_with_alpha_equals_the_reference() {
    check(cut_out(&astronaut()), &warped(100), extent(512, 512), 0);
    check(cut_out(&astronaut()), &warped(60), extent(200, 200), 1);
}
