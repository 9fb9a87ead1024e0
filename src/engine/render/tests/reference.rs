//! The slow reference: for each pixel centre the cell whose bilinear patch contains it (Newton's
//! method, later cells win, or those of a higher rank), and float samples, premultiplied. It shares
//! only the mesh and the box reduction with the rasteriser.

use super::*;

/// Source positions, px, of the target's pixel centres; `[height][width]`.
pub(super) fn places(mesh: &Mesh, target: Extent) -> Vec<Option<Point>> {
    let grid = mesh.grid();
    let (width, height) = (target.width() as usize, target.height() as usize);
    let (sx, sy) = (width as f64 / grid.width(), height as f64 / grid.height());
    let mut places = vec![None; width * height];
    let cells = (0..grid.rows() - 1).flat_map(|j| (0..grid.columns() - 1).map(move |i| (i, j)));
    let mut cells: Vec<_> = cells.collect();
    cells.sort_by_key(|(i, j)| mesh.rank(*i, *j, 0));
    for (i, j) in cells {
        let corner = |di, dj| {
            let p = mesh.posed(i + di, j + dj);
            Point::new(p.x * sx, p.y * sy)
        };
        let (p00, p10, p01, p11) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
        let low = |a: f64, b: f64, c: f64, d: f64| {
            (a.min(b).min(c).min(d) - 0.5).floor().max(0.0) as usize
        };
        let high = |a: f64, b: f64, c: f64, d: f64, n: usize| {
            ((a.max(b).max(c).max(d) + 0.5).ceil().max(0.0) as usize).min(n)
        };
        for y in low(p00.y, p10.y, p01.y, p11.y)..high(p00.y, p10.y, p01.y, p11.y, height) {
            for x in low(p00.x, p10.x, p01.x, p11.x)..high(p00.x, p10.x, p01.x, p11.x, width) {
                let centre = Point::new(x as f64 + 0.5, y as f64 + 0.5);
                if let Some((s, t)) = invert(p00, p10, p01, p11, centre) {
                    let (x0, x1, y0, y1) = (grid.x(i), grid.x(i + 1), grid.y(j), grid.y(j + 1));
                    places[y * width + x] =
                        Some(Point::new(x0 + s * (x1 - x0), y0 + t * (y1 - y0)));
                }
            }
        }
    }
    places
}

/// Parameters of a position in a bilinear patch, by Newton's method.
fn invert(p00: Point, p10: Point, p01: Point, p11: Point, place: Point) -> Option<(f64, f64)> {
    let (e, f) = (p10 - p00, p01 - p00);
    let d = (p11 - p10) - f;
    let (mut s, mut t) = (0.5, 0.5);
    for _ in 0..30 {
        let rest = p00 + e * s + f * t + d * (s * t) - place;
        let (ps, pt) = (e + d * t, f + d * s);
        let det = ps.cross(pt);
        s -= rest.cross(pt) / det;
        t -= ps.cross(rest) / det;
    }
    let inside = |x: f64| (-1e-9..=1.0 + 1e-9).contains(&x);
    (inside(s) && inside(t)).then_some((s, t))
}

/// A float sample of a picture reduced by `scale`: straight RGBA, 0 to 255 at any depth.
pub(super) fn sample(picture: &Pixmap, place: Point, scale: f64) -> [f64; 4] {
    let (width, height) = (
        picture.extent().width() as usize,
        picture.extent().height() as usize,
    );
    let channels = picture.channels().count();
    let texel = |x: f64, y: f64| {
        let (x, y) = (
            x.clamp(0.0, (width - 1) as f64) as usize,
            y.clamp(0.0, (height - 1) as f64) as usize,
        );
        let at = (y * width + x) * channels;
        let mut texel = [255.0; 4];
        for (k, texel) in texel.iter_mut().enumerate().take(channels) {
            *texel = match picture.samples() {
                Samples::Eight(s) => f64::from(s[at + k]),
                Samples::Sixteen(s) => f64::from(s[at + k]) / 257.0,
            };
        }
        texel
    };
    let (u, v) = (place.x / scale - 0.5, place.y / scale - 0.5);
    let (x, y) = (u.floor(), v.floor());
    let (fx, fy) = (u - x, v - y);
    let mut sum = [0.0; 4];
    for (weight, texel) in [
        ((1.0 - fx) * (1.0 - fy), texel(x, y)),
        (fx * (1.0 - fy), texel(x + 1.0, y)),
        ((1.0 - fx) * fy, texel(x, y + 1.0)),
        (fx * fy, texel(x + 1.0, y + 1.0)),
    ] {
        for k in 0..3 {
            sum[k] += weight * texel[3] * texel[k];
        }
        sum[3] += weight * texel[3];
    }
    if sum[3] == 0.0 {
        [0.0; 4]
    } else {
        [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], sum[3]]
    }
}
