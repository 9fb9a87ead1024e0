//! The inverse: positions come back, and what nothing maps to has none.

use proptest::prelude::*;

use super::*;
use crate::deform::{CoefficientTable, Falloff, Handle, Handles, Method};
use crate::geometry::Grid;

const NEVER: IsCancelled<'static> = &|| false;

fn set(method: Method, alpha: f64, count: u32, seed: u32, reach: f64) -> (RestDeformation, Pose) {
    let noise = |k: u32, n: u32| {
        f64::from((k * 4 + n + 977 * seed).wrapping_mul(2_654_435_761) >> 8)
            / f64::from(1_u32 << 24)
    };
    let place = |k: u32| Point::new(20.0 + 260.0 * noise(k, 0), 20.0 + 160.0 * noise(k, 1));
    let moved =
        |k: u32| Handle::Point(place(k) + Vec2::new(noise(k, 2) - 0.5, noise(k, 3) - 0.5) * reach);
    let rest = Handles::new((0..count).map(|k| Handle::Point(place(k))).collect(), None).unwrap();
    let field =
        RestDeformation::new(rest, method, Falloff::new(alpha, false).unwrap(), 1.0).unwrap();
    let pose = field
        .pose(&(0..count).map(moved).collect::<Vec<_>>())
        .unwrap();
    (field, pose)
}

fn mesh(field: &RestDeformation, pose: &Pose, cell: f64) -> Mesh {
    let grid = Grid::with_cell(300.0, 200.0, cell);
    CoefficientTable::of_grid(field, &grid, &|| false)
        .unwrap()
        .pose(&grid, pose, &|| false)
        .unwrap()
        .0
}

/// f folds in cells of half a pixel.
fn folds_finely(field: &RestDeformation, pose: &Pose) -> bool {
    mesh(field, pose, 0.5).folded_cells().next().is_some()
}

proptest! {
    /// Where the pose has no folds, every position of the picture is found again. Another
    /// position is found only if f has folds that are smaller than the mesh's cells: beside
    /// handles at alpha 1, where f has a cusp.
    #[test]
    fn the_inverse_of_f_is_its_inverse(
        method in prop::sample::select(&[Method::Affine, Method::Similarity, Method::Rigid][
            ..]),
        alpha in prop::sample::select(&[1.0, 1.5, 2.0][..]),
        (count, seed) in (3..12_u32, 0..1000_u32),
        places in prop::collection::vec((0.0..300.0_f64, 0.0..200.0_f64), 1..40),
    ) {
        let (field, pose) = set(method, alpha, count, seed, 16.0);
        let mesh = mesh(&field, &pose, 5.0);
        prop_assume!(mesh.folded_cells().next().is_none());
        let rest: Vec<Point> = places.iter().map(|&(x, y)| Point::new(x, y)).collect();
        let posed: Vec<Point> = rest.iter().map(|p| field.map(&pose, *p)).collect();
        for ((p, y), found) in rest.iter().zip(&posed).zip(
            Inverse::new(&field, &pose, &mesh).map(&posed, NEVER).unwrap()) {
            let found = found.expect("a position of the picture");
            prop_assert!(field.map(&pose, found).distance(*y) < 2e-6, "{p:?} to {y:?}: \
                {found:?}");
            prop_assert!(found.distance(*p) < 1e-6 || folds_finely(&field, &pose), "{p:?} to \
                {y:?}: {found:?}");
        }
    }

    /// With folds, whatever is found is a solution in the picture.
    #[test]
    fn what_is_found_is_posed_where_it_was_asked_for(
        alpha in prop::sample::select(&[0.5, 1.0, 2.0, 3.0][..]),
        (count, seed) in (3..12_u32, 0..1000_u32),
        places in prop::collection::vec((-50.0..350.0_f64, -50.0..250.0_f64), 1..40),
    ) {
        let (field, pose) = set(Method::Rigid, alpha, count, seed, 120.0);
        let mesh = mesh(&field, &pose, 5.0);
        let posed: Vec<Point> = places.iter().map(|&(x, y)| Point::new(x, y)).collect();
        for (y, found) in posed.iter().zip(Inverse::new(&field, &pose, &mesh).map(&posed,
            NEVER).unwrap()) {
            if let Some(found) = found {
                prop_assert!(field.map(&pose, found).distance(*y) < 2e-6, "{y:?}: {found:?}");
                prop_assert!((0.0..=300.0).contains(&found.x)
                    && (0.0..=200.0).contains(&found.y));
            }
        }
    }
}

/// Rigid, alpha 1, eight handles: no cell of 5 px is folded, and f is folded beside a handle.
#[test]
fn a_position_in_a_fold_smaller_than_a_cell_has_another_inverse() {
    let (field, pose) = set(Method::Rigid, 1.0, 8, 53, 16.0);
    let mesh = mesh(&field, &pose, 5.0);
    assert!(mesh.folded_cells().next().is_none() && folds_finely(&field, &pose));
    let rest = Point::new(215.095_558_834_529_53, 77.372_808_486_161_86);
    let posed = field.map(&pose, rest);
    let found = Inverse::new(&field, &pose, &mesh)
        .map(&[posed], NEVER)
        .unwrap()[0]
        .expect("a position of the picture");
    assert!(
        field.map(&pose, found).distance(posed) < 2e-6 && found.distance(rest) > 1.0,
        "{found:?}"
    );
}

#[test]
fn handles_are_found_and_what_nothing_shows_is_none() {
    let (field, pose) = set(Method::Rigid, 1.0, 7, 3, 20.0);
    let mesh = mesh(&field, &pose, 5.0);
    let inverse = Inverse::new(&field, &pose, &mesh);
    let rest: Vec<Point> = field
        .handles()
        .handles()
        .iter()
        .map(|handle| handle.places()[0])
        .collect();
    let posed: Vec<Point> = rest
        .iter()
        .zip(pose.displacements())
        .map(|(p, d)| *p + *d)
        .collect();
    for (p, found) in rest.iter().zip(inverse.map(&posed, NEVER).unwrap()) {
        assert!(
            found.is_some_and(|found| found.distance(*p) < 1e-6),
            "{p:?}: {found:?}"
        );
    }
    let outside = [
        Point::new(-200.0, 10.0),
        Point::new(1e6, 1e6),
        Point::new(150.0, -90.0),
    ];
    assert_eq!(inverse.map(&outside, NEVER).unwrap(), [None; 3]);
}

/// Whatever the folds, a position where f puts something of the picture has an inverse.
#[test]
fn no_position_of_the_picture_is_lost_in_folds() {
    let rest: Vec<Point> = (0..100)
        .map(|k| {
            Point::new(
                f64::from(k * 37 % 101) * 2.97,
                f64::from(k * 53 % 103) * 1.94,
            )
        })
        .collect();
    for (seed, reach) in [
        (9, 240.0),
        (12, 120.0),
        (12, 240.0),
        (26, 120.0),
        (28, 60.0),
    ] {
        for alpha in [1.0, 2.0] {
            let (field, pose) = set(Method::Rigid, alpha, 4 + seed % 6, seed, reach);
            let posed: Vec<Point> = rest.iter().map(|p| field.map(&pose, *p)).collect();
            for cell in [4.0, 5.0, 8.0] {
                let grid = Grid::with_cell(300.0, 200.0, cell);
                let mesh = CoefficientTable::of_grid(&field, &grid, &|| false)
                    .unwrap()
                    .pose(&grid, &pose, &|| false)
                    .unwrap()
                    .0;
                let found = Inverse::new(&field, &pose, &mesh)
                    .map(&posed, NEVER)
                    .unwrap();
                let lost = found.iter().filter(|found| found.is_none()).count();
                assert_eq!(
                    lost, 0,
                    "seed {seed}, reach {reach}, alpha {alpha}, cells of {cell} px"
                );
            }
        }
    }
}

#[test]
fn a_position_beside_a_patch_without_a_root_is_not_in_it() {
    let patch = [(0.0, 0.0), (2.0, 0.0), (1.0, 5.0), (0.0, 2.0)].map(|(x, y)| Point::new(x, y));
    // The middle of both roots, which are complex, is the share (0.10, 0.25): 15.7 px away.
    assert_eq!(in_patch(patch, Point::new(-6.0, 15.0)), None);
    let [a, b, d, c] = patch;
    let at = |s: f64, t: f64| a.lerp(b, s).lerp(c.lerp(d, s), t);
    for (s, t) in [(0.0, 0.0), (0.25, 0.5), (1.0, 0.75), (0.5, 1.0)] {
        let [found_s, found_t] = in_patch(patch, at(s, t)).unwrap();
        assert!(
            (found_s - s).abs() < 1e-12 && (found_t - t).abs() < 1e-12,
            "{s} {t}"
        );
    }
}

/// Cancelled in the middle: the step that asked is the last one.
#[test]
fn nothing_follows_a_step_at_which_an_inverse_is_cancelled() {
    let (field, pose) = set(Method::Rigid, 1.0, 9, 12, 240.0);
    let mesh = mesh(&field, &pose, 5.0);
    let posed: Vec<Point> = (0..400_u32)
        .map(|k| Point::new(f64::from(k % 20) * 15.0, f64::from(k / 20) * 10.0))
        .collect();
    let (all, looks) = (Inverse::new(&field, &pose, &mesh), AtomicU64::new(0));
    let count = || looks.fetch_add(1, Ordering::Relaxed) + 1;
    let _ = all.map(&posed, &|| count() == 0).unwrap();
    let of_all = looks.swap(0, Ordering::Relaxed);
    assert!(all.steps() > 100, "{}", all.steps());
    // The first looks are those of the tree.
    let before = of_all - all.steps();
    for last in [before + 1, before + 2, of_all / 2, of_all - 1] {
        looks.store(0, Ordering::Relaxed);
        let inverse = Inverse::new(&field, &pose, &mesh);
        let cancelled = || count() >= last;
        assert_eq!(inverse.map(&posed, &cancelled), None);
        assert_eq!(looks.load(Ordering::Relaxed), last);
        assert_eq!(inverse.steps(), last - before);
    }
}

/// The patches of a mesh whose cells all lie on one line are beside the position, and their boxes
/// are not: every cell is tried, in vain.
#[test]
fn a_search_that_tries_every_cell_is_counted_and_can_be_cancelled() {
    let grid = Grid::with_counts(300.0, 300.0, 301, 301);
    let to_line = |k: usize| {
        let [i, j] = [k % 301, k / 301].map(|line| u16::try_from(line).unwrap());
        let share = f32::from((i + j) % 2) * 100.0;
        [share - f32::from(i), share - f32::from(j)]
    };
    let mesh = Mesh::new(grid, (0..grid.len()).map(to_line).collect());
    let posed = [Point::new(20.0, 80.0); 40];
    let (all, looks) = (Inverse::of_mesh(&mesh), AtomicU64::new(0));
    let count = || looks.fetch_add(1, Ordering::Relaxed) + 1;
    assert_eq!(all.map(&posed, &|| count() == 0).unwrap(), [None; 40]);
    let of_all = looks.swap(0, Ordering::Relaxed);
    assert!(all.boxes() > 40 * 90_000, "{}", all.boxes());
    assert!(of_all >= 40 * 90_000 / BOXES_PER_LOOK, "{of_all}");
    let (cut, last) = (Inverse::of_mesh(&mesh), of_all / 2);
    assert_eq!(cut.map(&posed, &|| count() >= last), None);
    assert_eq!(looks.load(Ordering::Relaxed), last);
    assert!(cut.boxes() < all.boxes(), "{}", cut.boxes());
}
