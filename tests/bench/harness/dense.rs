//! The dense map of a mesh, for rivals that sample a given map: drawn by subdivided triangles, in
//! no hurry, and sharing no code with the renderer.

use mlswarp::geometry::{Mesh, Point};
use mlswarp::pixmap::Extent;

/// A cell is divided into this number of parts along each side; two triangles of a part are its
/// bilinear patch to a few hundredths of a pixel.
const PARTS: u32 = 4;
/// What the map says where nothing is drawn.
pub const OUTSIDE: [f32; 2] = [-1.0; 2];

/// The place of the source that the centre of each target pixel shows, `[height][width]`, px (the
/// centre of pixel 0 is at 1/2), where target and source have one size; `OUTSIDE` where there is
/// none. Under folds the later cell in row order wins.
pub fn map(mesh: &Mesh, extent: Extent) -> Vec<[f32; 2]> {
    let mut map = vec![OUTSIDE; extent.width() as usize * extent.height() as usize];
    let grid = mesh.grid();
    for j in 0..grid.rows() - 1 {
        for i in 0..grid.columns() - 1 {
            let rest = [grid.vertex(i, j), grid.vertex(i + 1, j + 1)];
            let posed =
                [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)].map(|(i, j)| mesh.posed(i, j));
            let corner = |s: u32, t: u32| {
                let (s, t) = (
                    f64::from(s) / f64::from(PARTS),
                    f64::from(t) / f64::from(PARTS),
                );
                let at = Point::new(
                    rest[0].x + s * (rest[1].x - rest[0].x),
                    rest[0].y + t * (rest[1].y - rest[0].y),
                );
                (
                    posed[0]
                        .lerp(posed[1], s)
                        .lerp(posed[2].lerp(posed[3], s), t),
                    at,
                )
            };
            for (s, t) in (0..PARTS).flat_map(|t| (0..PARTS).map(move |s| (s, t))) {
                let [a, b, c, d] = [
                    corner(s, t),
                    corner(s + 1, t),
                    corner(s + 1, t + 1),
                    corner(s, t + 1),
                ];
                triangle(&mut map, extent, [a, b, c]);
                triangle(&mut map, extent, [a, c, d]);
            }
        }
    }
    map
}

/// Writes the places of the pixels whose centre lies in the triangle or on its border. Corners:
/// where they are posed, what they show.
fn triangle(
    map: &mut [[f32; 2]],
    extent: Extent,
    [(a, at_a), (b, at_b), (c, at_c)]: [(Point, Point); 3],
) {
    let area = (b - a).cross(c - a);
    if area == 0.0 {
        return;
    }
    let pixels = |least: f64, most: f64, side: u32| {
        let (first, end) = (
            (least - 0.5).ceil().max(0.0),
            (most + 0.5).floor().clamp(0.0, f64::from(side)),
        );
        first as u32..end as u32
    };
    let (xs, ys) = ([a.x, b.x, c.x], [a.y, b.y, c.y]);
    let least = |v: [f64; 3]| v.into_iter().fold(f64::INFINITY, f64::min);
    let most = |v: [f64; 3]| v.into_iter().fold(f64::NEG_INFINITY, f64::max);
    for y in pixels(least(ys), most(ys), extent.height()) {
        for x in pixels(least(xs), most(xs), extent.width()) {
            let p = Point::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (v, w) = ((p - a).cross(c - a) / area, (b - a).cross(p - a) / area);
            let u = 1.0 - v - w;
            if u >= -1e-9 && v >= -1e-9 && w >= -1e-9 {
                let place = [
                    u * at_a.x + v * at_b.x + w * at_c.x,
                    u * at_a.y + v * at_b.y + w * at_c.y,
                ];
                map[y as usize * extent.width() as usize + x as usize] = place.map(|x| x as f32);
            }
        }
    }
}
