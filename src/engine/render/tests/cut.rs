//! Cut grids: quads that share no vertex, of which each draws some texels of its cell.

use super::*;
use crate::geometry::{CutCell, CutCells, CutMesh};

/// The quads of a mesh, one for each cell, with the same vertices.
fn whole(mesh: &Mesh, side: u32) -> Mesh {
    let grid = *mesh.grid();
    let columns = grid.columns();
    let cells = (0..grid.rows() - 1).flat_map(|j| {
        (0..columns - 1).map(move |i| {
            let at = j * columns + i;
            CutCell {
                cell: [i, j],
                vertices: [at, at + 1, at + columns + 1, at + columns],
                texels: None,
                is_loose: false,
            }
        })
    });
    let vertices = (0..grid.rows()).flat_map(|j| (0..columns).map(move |i| [i, j]));
    let cut = CutCells::new(grid, side, cells.collect(), vertices.collect(), Vec::new());
    Mesh::cut(CutMesh::new(Arc::new(cut), mesh.displacement().to_vec()))
}

#[test]
fn quads_that_share_all_vertices_are_the_plain_mesh() {
    let size = extent(150, 110);
    let samples = (0..110_u16)
        .flat_map(|y| (0..150_u16).map(move |x| [x + 40, y + 60, (x + y) / 2 + 10]))
        .flatten()
        .map(|sample| sample as u8);
    let pixmap = Pixmap::new(size, Channels::Rgb, Samples::Eight(samples.collect()));
    let source = Arc::new(Source::new(pixmap));
    for (seed, strength) in [(1, 0.3), (2, 0.8), (3, 2.0)] {
        let mesh = waves(Grid::with_cell(150.0, 110.0, 6.0), seed, strength);
        let cut = whole(&mesh, 6);
        assert_eq!(
            cut.folding(&|| false).unwrap(),
            mesh.folding(&|| false).unwrap()
        );
        assert_eq!(cut.bounds(&|| false), mesh.bounds(&|| false));
        let options = RenderOptions {
            force_alpha: true,
            ..options(size)
        };
        let draw = |mesh: &Mesh| banded(&Renderer::new(source.clone(), mesh, options), 37);
        let (plain, quads) = (draw(&mesh), draw(&cut));
        // Where cells fold, rows are drawn by crossings or by cells: the same cell wins.
        let differ = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 1);
        let pixels = plain.chunks_exact(4).zip(quads.chunks_exact(4));
        let wrong = pixels.filter(|pair| differ(*pair)).count();
        assert!(wrong <= 3, "{wrong} pixels of waves {seed}");
    }
}

/// Two halves of one cell of 8 px: each has its own quad and draws its own texels.
fn halves(right: [f32; 2]) -> Mesh {
    let grid = Grid::with_counts(8.0, 8.0, 2, 2);
    let half = |is_right: bool| {
        let row = if is_right { 0xf0_u64 } else { 0x0f };
        (0..8).fold(0, |set, y| set | row << (8 * y))
    };
    let cell = |first: u32, texels| CutCell {
        cell: [0, 0],
        vertices: [first, first + 1, first + 2, first + 3],
        texels: Some(texels),
        is_loose: false,
    };
    let corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
    let cut = CutCells::new(
        grid,
        8,
        vec![cell(0, 0), cell(4, 1)],
        [corners, corners].concat(),
        vec![half(false), half(true)],
    );
    let moved = [[[0.0; 2]; 4], [right; 4]].concat();
    Mesh::cut(CutMesh::new(Arc::new(cut), moved))
}

#[test]
fn a_quad_draws_its_own_texels_only() {
    let size = extent(8, 8);
    let samples = (0..64).flat_map(|k| [k as u8, 0, 0, 255]).collect();
    let source = Arc::new(Source::new(Pixmap::new(
        size,
        Channels::Rgba,
        Samples::Eight(samples),
    )));
    let options = RenderOptions {
        filter: Filter::Nearest,
        ..options(size)
    };
    let mesh = halves([3.0, 0.0]);
    let out = banded(&Renderer::new(source.clone(), &mesh, options), 3);
    for (k, pixel) in out.chunks_exact(4).enumerate() {
        let (x, y) = (k % 8, k / 8);
        // The left half stays, the right one moves by 3 px and leaves nothing behind.
        let expected = match x {
            0..4 => [(8 * y + x) as u8, 0, 0, 255],
            7 => [(8 * y + 4) as u8, 0, 0, 255],
            _ => [0; 4],
        };
        assert_eq!(pixel, expected, "{x}, {y}");
    }
    assert_eq!(mesh.map(Point::new(1.0, 2.0)), Some(Point::new(1.0, 2.0)));
    assert_eq!(mesh.map(Point::new(5.0, 2.0)), Some(Point::new(8.0, 2.0)));
    // Over each other, the later one wins.
    let mesh = halves([-4.0, 0.0]);
    let out = banded(&Renderer::new(source.clone(), &mesh, options), 8);
    let first: Vec<u8> = out.chunks_exact(4).take(4).map(|pixel| pixel[0]).collect();
    assert_eq!(first, [4, 5, 6, 7]);
    // What belongs to nothing is below.
    let mut cut = halves([-4.0, 0.0]).cut_mesh().unwrap().clone();
    let [left, mut right] = [0, 1].map(|k| cut.cells().cells()[k]);
    right.is_loose = true;
    let corners = [[0, 0], [1, 0], [1, 1], [0, 1]];
    let texels = [0x0f, 0xf0].map(|row: u64| (0..8).fold(0, |set, y| set | row << (8 * y)));
    let (grid, vertices) = (*mesh.grid(), [corners, corners].concat());
    let loose = CutCells::new(grid, 8, vec![left, right], vertices, texels.to_vec());
    cut = CutMesh::new(Arc::new(loose), cut.displacement().to_vec());
    let out = banded(&Renderer::new(source.clone(), &Mesh::cut(cut), options), 8);
    let first: Vec<u8> = out.chunks_exact(4).take(4).map(|pixel| pixel[0]).collect();
    assert_eq!(first, [0, 1, 2, 3]);
    assert!(halves([0.0; 2]).is_identity());
}

#[test]
fn every_level_and_division_of_a_cut_mesh_gives_the_same_bytes() {
    let size = extent(96, 72);
    let source = Arc::new(Source::new(noise(size, Channels::Rgba, Depth::Eight)));
    let mesh = whole(&waves(Grid::with_cell(96.0, 72.0, 8.0), 5, 1.5), 8);
    let draw = |level, rows| {
        let renderer = Renderer::with_level(source.clone(), &mesh, options(size), level);
        banded(&renderer, rows)
    };
    let expected = draw(SimdLevel::Scalar, 72);
    for level in [SimdLevel::Scalar, SimdLevel::Avx2, SimdLevel::Avx512] {
        for rows in [1, 7, 32, 72] {
            assert!(draw(level, rows) == expected, "{level:?} {rows}");
        }
    }
}
