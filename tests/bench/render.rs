//! The renderer, mesh to pixels (preparation included): the photograph at three sizes, a smooth
//! mesh of 100 x 100 vertices and two that fold, each level that the machine has, on 1 and 2
//! threads (bands in parallel); what lies outside painted with the edge; and how time grows with
//! the pixels.
//!
//! `cargo bench --bench render [-- FILTER]`; a filter is a part of a table's title.
//! `render --paired DIR` writes sources, dense maps and our pictures of the cases of `cases` there,
//! `index.json` naming them, and then times our side of each case that is asked for (see
//! `harness/paired.rs`).

#![allow(
    missing_docs,
    missing_debug_implementations,
    unreachable_pub,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    reason = "a program that prints a table"
)]

#[path = "harness/mod.rs"]
mod harness;

use std::path::Path;
use std::sync::Arc;

use harness::pictures::{
    FULL_HD, Folded, SMALL, UHD, VERTICES, bytes, extent, mesh, options, photograph, size, tiles,
};
use harness::{Contender, Goal, Report, dense, inside, paired, pool};
use mlswarp::geometry::{Grid, Mesh};
use mlswarp::level::SimdLevel;
use mlswarp::pixmap::{Channels, Extent};
use mlswarp::render::{Outside, RenderOptions, Renderer, Source};
use rayon::prelude::*;

/// Bands of a picture that two threads share.
const BANDS: u32 = 8;

fn main() {
    match harness::option("--paired") {
        Some(folder) => answer(Path::new(&folder)),
        None => tables(),
    }
}

fn tables() {
    let mut report = Report::new(
        "render",
        "mesh to pixels, 8 bit, bilinear, transparent outside",
    );
    for (sides, channels, folded) in [
        (SMALL, Channels::Rgba, Folded::Nowhere),
        (SMALL, Channels::Rgba, Folded::UnderOnePercent),
        (SMALL, Channels::Rgba, Folded::TenPercent),
        (SMALL, Channels::Rgb, Folded::Nowhere),
        (FULL_HD, Channels::Rgba, Folded::Nowhere),
        (FULL_HD, Channels::Rgb, Folded::Nowhere),
        (UHD, Channels::Rgba, Folded::Nowhere),
        (UHD, Channels::Rgb, Folded::Nowhere),
    ] {
        let extent = extent(sides);
        let title = format!("{} {channels:?}, {}", size(extent), folded.name());
        if harness::wanted(&title) {
            table(&mut report, &title, extent, channels, folded);
        }
    }
    for chaotic in [false, true] {
        let title = format!(
            "outside: edge, {} border",
            if chaotic { "chaotic" } else { "smooth" }
        );
        if harness::wanted(&title) {
            edge(&mut report, &title, chaotic);
        }
    }
    if harness::wanted("growth") {
        growth(&mut report);
    }
}

fn table(report: &mut Report, title: &str, extent: Extent, channels: Channels, folded: Folded) {
    let source = Arc::new(Source::new(photograph(extent, channels)));
    let mesh = mesh(extent, folded);
    let share =
        100.0 * mesh.folded_cells().count() as f64 / f64::from((VERTICES - 1) * (VERTICES - 1));
    let (one, two) = (pool(1), pool(2));
    let mut contenders = Vec::new();
    for &level in SimdLevel::available().iter().rev() {
        for (threads, pool, bands) in [(1, &one, 1), (2, &two, BANDS)] {
            let mut drawing = Drawing::new(&source, &mesh, extent, level, bands);
            contenders.push(inside(
                pool,
                format!("{}, {threads} thread(s)", level.name()),
                move || drawing.draw(),
            ));
        }
    }
    let medians = report.table(title, 41, &mut contenders);
    report.line(&format!(
        "{share:.2} % of the cells fold; {:.2} ns a pixel.\n",
        medians[0] * 1e9 / extent.pixels() as f64
    ));
}

/// Most pixels lie outside of the posed picture and get the colour of its border, which is smooth
/// or jumps to and fro across the target.
fn edge(report: &mut Report, title: &str, chaotic: bool) {
    let extent = extent(SMALL);
    let source = Arc::new(Source::new(photograph(extent, Channels::Rgba)));
    let side = f64::from(SMALL.0);
    let (columns, rows) = (2 * VERTICES, VERTICES);
    let grid = Grid::with_counts(side, side, columns, rows);
    let mut random = 1_u32;
    let mut share = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(random >> 8) / f64::from(1 << 24)
    };
    // Each column is one place: no cell covers anything.
    let places: Vec<[f64; 2]> = (0..columns)
        .map(|_| [side * share(), side * share()])
        .collect();
    let displacement = (0..rows)
        .flat_map(|j| (0..columns).map(move |i| (i, j)))
        .map(|(i, j)| {
            let v = grid.vertex(i, j);
            let to = if chaotic {
                places[i as usize]
            } else {
                [0.3 * v.x, 0.3 * v.y]
            };
            [(to[0] - v.x) as f32, (to[1] - v.y) as f32]
        });
    let mesh = Mesh::new(grid, displacement.collect());
    let one = pool(1);
    let mut drawings = [Outside::Transparent, Outside::Edge].map(|outside| {
        let options = RenderOptions {
            outside,
            ..options(extent)
        };
        Drawing {
            options,
            ..Drawing::new(&source, &mesh, extent, SimdLevel::detect(), 1)
        }
    });
    let bare = drawings[0].bare();
    let [transparent, edge] = &mut drawings;
    let mut contenders = vec![
        inside(&one, "transparent outside, 1 thread", || transparent.draw()),
        inside(&one, "edge outside, 1 thread", || edge.draw()),
    ];
    let medians = report.table(title, 11, &mut contenders);
    let cost = (medians[1] - medians[0]) * 1e9 / bare as f64;
    report.line(&format!(
        "{bare} of {} pixels lie outside; {cost:.0} ns more for each of them than for a \
            transparent one.\n",
        extent.pixels()
    ));
}

/// One picture, drawn again and again into one buffer.
struct Drawing<'a> {
    source: &'a Arc<Source>,
    mesh: &'a Mesh,
    extent: Extent,
    options: RenderOptions,
    level: SimdLevel,
    bands: u32,
    out: Vec<u8>,
}

impl<'a> Drawing<'a> {
    fn new(
        source: &'a Arc<Source>,
        mesh: &'a Mesh,
        extent: Extent,
        level: SimdLevel,
        bands: u32,
    ) -> Self {
        Self {
            source,
            mesh,
            extent,
            options: options(extent),
            level,
            bands,
            out: Vec::new(),
        }
    }

    /// Pixels that nothing is painted on.
    fn bare(&mut self) -> usize {
        self.draw();
        self.out
            .chunks_exact(4)
            .filter(|pixel| pixel[3] == 0)
            .count()
    }

    fn draw(&mut self) {
        let renderer =
            Renderer::with_level(Arc::clone(self.source), self.mesh, self.options, self.level);
        let row = self.extent.width() as usize * renderer.channels().count();
        self.out.resize(row * self.extent.height() as usize, 0);
        if self.bands == 1 {
            return renderer.band(0..self.extent.height(), &mut self.out, &|| false);
        }
        let rows = self.extent.height().div_ceil(self.bands);
        self.out
            .par_chunks_mut(row * rows as usize)
            .enumerate()
            .for_each(|(k, band)| {
                let first = k as u32 * rows;
                renderer.band(first..first + (band.len() / row) as u32, band, &|| false);
            });
    }
}

/// The photograph side by side with itself: the same kind of pixels, ever more of them.
fn growth(report: &mut Report) {
    let sides = [250, 500, 1000, 2000];
    let extents = sides.map(|side| extent((side, side)));
    let drawn = extents.map(|e| (Arc::new(Source::new(tiles(e))), mesh(e, Folded::Nowhere)));
    let one = pool(1);
    let drawings = extents.iter().zip(&drawn).map(|(&e, (source, mesh))| {
        let mut drawing = Drawing::new(source, mesh, e, SimdLevel::detect(), 1);
        inside(&one, size(e), move || drawing.draw())
    });
    let mut contenders: Vec<Contender<'_>> = drawings.collect();
    let medians = report.table("growth, RGBA, smooth, 1 thread", 41, &mut contenders);
    let slopes = (1..sides.len()).map(|k| {
        let pixels = [extents[k - 1], extents[k]].map(|e| e.pixels() as f64);
        (k, harness::slope(pixels, [medians[k - 1], medians[k]]))
    });
    for (k, slope) in slopes {
        report.line(&format!(
            "Slope in pixels, {} to {}: {slope:.2}",
            sides[k - 1],
            sides[k]
        ));
        if sides[k] == 1000 {
            report.goal(
                "slope in pixels, 500^2 to 1000^2",
                slope,
                Goal::Between(0.9, 1.1),
            );
        }
    }
    report.line("");
}

/// The cases that rivals in other processes draw too.
fn cases() -> [(&'static str, Extent, Folded); 5] {
    [
        ("500x500", extent(SMALL), Folded::Nowhere),
        ("1920x1080", extent(FULL_HD), Folded::Nowhere),
        ("3840x2160", extent(UHD), Folded::Nowhere),
        ("500x500-folded-1", extent(SMALL), Folded::UnderOnePercent),
        ("500x500-folded-10", extent(SMALL), Folded::TenPercent),
    ]
}

fn answer(folder: &Path) {
    let drawn: Vec<_> = cases()
        .into_iter()
        .map(|(name, extent, folded)| {
            (
                name,
                extent,
                folded,
                Arc::new(Source::new(photograph(extent, Channels::Rgba))),
                mesh(extent, folded),
            )
        })
        .collect();
    let one = pool(1);
    let (mut index, mut contenders) = (Vec::new(), Vec::new());
    for (name, extent, folded, source, mesh) in &drawn {
        let map: Vec<u8> = dense::map(mesh, *extent)
            .iter()
            .flatten()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        let mut drawing = Drawing::new(source, mesh, *extent, SimdLevel::detect(), 1);
        drawing.draw();
        let files = [
            ("source.rgba", bytes(source.pixmap())),
            ("map.f32", &map),
            ("ours.rgba", &drawing.out),
        ];
        let [source, map, ours] = files.map(|(kind, bytes)| {
            let file = format!("{name}.{kind}");
            paired::write(folder, &file, bytes);
            file
        });
        index.push(serde_json::json!({
            "case": name, "what": format!("{}, {}", size(*extent), folded.name()),
                "width": extent.width(), "height": extent.height(),
            "source": source, "map": map, "ours": ours, "level": SimdLevel::detect().name(),
        }));
        contenders.push(inside(&one, *name, move || drawing.draw()));
    }
    paired::write(
        folder,
        "index.json",
        serde_json::Value::from(index).to_string().as_bytes(),
    );
    paired::serve(&mut contenders);
}
