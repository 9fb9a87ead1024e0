//! Parts of meshes against dense solutions of the two steps in 40 digits.

use serde_json::Value;

use super::part::{OrderedPart, PoseSpace, QuadAnchor};
use super::turn::{QuadMesh, QuadShape};
use crate::geometry::Vec2;

const NEVER: &dyn Fn() -> bool = &|| false;

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn vector(value: &Value) -> Vec2 {
    Vec2::new(number(&value[0]), number(&value[1]))
}

fn indices<const N: usize>(value: &Value) -> Vec<[usize; N]> {
    let index = |row: &Value, k: usize| usize::try_from(row[k].as_u64().unwrap()).unwrap();
    let rows = value.as_array().unwrap().iter();
    rows.map(|row| std::array::from_fn(|k| index(row, k)))
        .collect()
}

/// A mesh of a reference case: all of its parts.
struct MeshCase {
    vertices: Vec<Vec2>,
    spacing: f64,
    quads: Vec<[usize; 4]>,
    part_of: Vec<u64>,
    triangles: Vec<[usize; 3]>,
    /// Corners and weights of each handle, and its displacement.
    held: Vec<([(usize, f64); 4], Vec2)>,
}

impl MeshCase {
    fn of(case: &Value) -> Self {
        let quads = indices::<4>(&case["quads"]);
        let handles = case["handles"]["points"].as_array().unwrap().iter();
        let held = handles
            .zip(case["rows"].as_array().unwrap())
            .map(|(handle, row)| {
                let row: Vec<(usize, f64)> = row
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|entry| {
                        let vertex = usize::try_from(entry[0].as_u64().unwrap()).unwrap();
                        (vertex, number(&entry[1]))
                    })
                    .collect();
                let has_all =
                    |quad: &&[usize; 4]| row.iter().all(|(vertex, _)| quad.contains(vertex));
                let quad = quads.iter().find(has_all).unwrap();
                let weight = |vertex| {
                    row.iter()
                        .find(|entry| entry.0 == vertex)
                        .map_or(0.0, |e| e.1)
                };
                let moved = vector(&handle["q"]) - vector(&handle["p"]);
                (quad.map(|vertex| (vertex, weight(vertex))), moved)
            });
        Self {
            vertices: case["vertices"]
                .as_array()
                .unwrap()
                .iter()
                .map(vector)
                .collect(),
            spacing: number(&case["spacing"]),
            part_of: case["quad_parts"]
                .as_array()
                .unwrap()
                .iter()
                .map(|part| part.as_u64().unwrap())
                .collect(),
            triangles: indices::<3>(&case["triangles"]),
            held: held.collect(),
            quads,
        }
    }

    /// The displacements of a part's vertices after the first step and after both, and what the
    /// smallest triangle keeps of itself.
    fn pose(&self, part: u64, u: &mut [[Vec2; 2]]) -> f64 {
        let per_quad = self.triangles.len() / self.quads.len();
        let mut vertices = Vec::new();
        let (mut quads, mut shapes, mut kinds) = (Vec::new(), Vec::new(), Vec::new());
        for (k, quad) in self
            .quads
            .iter()
            .enumerate()
            .filter(|(k, _)| self.part_of[*k] == part)
        {
            let local = quad.map(|vertex| {
                let at = vertices.iter().position(|other| *other == vertex);
                at.unwrap_or_else(|| {
                    vertices.push(vertex);
                    vertices.len() - 1
                })
            });
            let triangles = self.triangles[k * per_quad..][..per_quad].iter();
            let corner = |vertex| quad.iter().position(|corner| *corner == vertex).unwrap();
            let kind: Vec<[usize; 3]> = triangles.map(|three| three.map(corner)).collect();
            let known = kinds.iter().position(|other| *other == kind);
            let shape = known.unwrap_or_else(|| {
                shapes.push(QuadShape::new(
                    quad.map(|vertex| self.vertices[vertex]),
                    &kind,
                ));
                kinds.push(kind);
                kinds.len() - 1
            });
            quads.push((
                local.map(|k| u32::try_from(k).unwrap()),
                u8::try_from(shape).unwrap(),
            ));
        }
        let (mut anchors, mut targets) = (Vec::new(), Vec::new());
        for (corners, moved) in &self.held {
            let local = corners.map(|(vertex, _)| vertices.iter().position(|v| *v == vertex));
            if local.iter().all(Option::is_some) {
                anchors.push(QuadAnchor {
                    vertices: local.map(|k| u32::try_from(k.unwrap()).unwrap()),
                    weights: corners.map(|(_, weight)| weight),
                });
                targets.push(*moved);
            }
        }
        if targets.len() < 2 {
            // What the map does without a linear system.
            let moved = targets.first().copied().unwrap_or_default();
            vertices.iter().for_each(|vertex| u[*vertex] = [moved; 2]);
            return 1.0;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "lines of a lattice"
        )]
        let line = |c: f64| (c / self.spacing) as u32;
        let of_vertex = |vertex: &usize| {
            let at = self.vertices[*vertex];
            [line(at.x), line(at.y)]
        };
        let mesh = QuadMesh {
            shapes,
            quads,
            positions: vertices.iter().map(of_vertex).collect(),
        };
        let solved = OrderedPart::new(mesh, anchors, NEVER)
            .unwrap()
            .solve(NEVER)
            .unwrap();
        assert!(!solved.is_soft());
        let mut space = PoseSpace::default();
        let first = solved.similar(&targets, &mut space, NEVER).unwrap();
        let (both, least) = solved.pose(&targets, &mut space, NEVER).unwrap();
        for (k, vertex) in vertices.iter().enumerate() {
            u[*vertex] = [first[k], both[k]];
        }
        least
    }
}

#[test]
fn both_steps_are_those_of_the_reference_cases() {
    let file: Value =
        serde_json::from_str(include_str!("../../../test_files/rivals.json")).unwrap();
    let cases = file["arap_cases"].as_array().unwrap();
    assert!(cases.len() > 10);
    for case in cases {
        let name = &case["name"];
        let mesh = MeshCase::of(case);
        let mut u = vec![[Vec2::ZERO; 2]; mesh.vertices.len()];
        let mut least = 1.0_f64;
        for part in 0..=*mesh.part_of.iter().max().unwrap() {
            least = least.min(mesh.pose(part, &mut u));
        }
        for (step, key) in ["expected_step1", "expected"].into_iter().enumerate() {
            for (k, expected) in case[key].as_array().unwrap().iter().enumerate() {
                let off = mesh.vertices[k] + u[k][step] - vector(expected);
                assert!(off.norm() < 1e-12, "{name} {key} {k}: {off:?}");
            }
        }
        if let Some(expected) = case["min_abs_m"].as_f64().filter(|m| *m < 1.0) {
            assert!((least - expected).abs() < 1e-9, "{name}: {least}");
        }
    }
}

/// A square lattice of `side` x `side` quads.
fn square(side: u32) -> QuadMesh {
    let columns = side + 1;
    let corners = [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)];
    let quad = |k: u32| {
        let at = k / side * columns + k % side;
        ([at, at + 1, at + columns + 1, at + columns], 0)
    };
    QuadMesh {
        shapes: vec![QuadShape::new(
            corners.map(|(x, y)| Vec2::new(x, y)),
            &QuadShape::ALL,
        )],
        quads: (0..side * side).map(quad).collect(),
        positions: (0..columns * columns)
            .map(|k| [k % columns, k / columns])
            .collect(),
    }
}

fn anchor(mesh: &QuadMesh, quad: usize, s: f64, t: f64) -> QuadAnchor {
    QuadAnchor {
        vertices: mesh.quads[quad].0,
        weights: [(1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t],
    }
}

/// More anchors than responses are kept for, and fewer: the same map.
#[test]
fn many_anchors_are_solved_for_as_few_are() {
    let mesh = square(12);
    let anchors: Vec<QuadAnchor> = (0..40).map(|k| anchor(&mesh, k * 3, 0.3, 0.6)).collect();
    let of = |anchors: &[QuadAnchor]| {
        let ordered = OrderedPart::new(square(12), anchors.to_vec(), NEVER).unwrap();
        ordered.solve(NEVER).unwrap()
    };
    let turned = |anchor: &QuadAnchor| {
        // Nearly a rotation, so that further anchors that follow the map change little.
        let at = anchor.vertices.iter().zip(anchor.weights);
        let at = at.fold(Vec2::ZERO, |sum, (vertex, weight)| {
            let [x, y] = mesh.positions[*vertex as usize];
            sum + Vec2::new(f64::from(x), f64::from(y)) * (5.0 * weight)
        });
        at.complex_mul(Vec2::new(0.8, 0.6)) - at
    };
    let targets: Vec<Vec2> = anchors.iter().map(turned).collect();
    let mut space = PoseSpace::default();
    let (many, _) = of(&anchors).pose(&targets, &mut space, NEVER).unwrap();
    let (few, _) = of(&anchors[..20])
        .pose(&targets[..20], &mut space, NEVER)
        .unwrap();
    assert!(many.iter().zip(&few).all(|(a, b)| (*a - *b).norm() < 1e-9));
}

/// Anchors that determine each other are held softly: similarities stay exact.
#[test]
fn anchors_of_one_quad_are_held_less_strictly() {
    let mesh = square(10);
    let mut anchors: Vec<QuadAnchor> = (0..6_u8)
        .map(|k| anchor(&mesh, 44, 0.1 + 0.15 * f64::from(k), 0.3))
        .collect();
    anchors.push(anchor(&mesh, 7, 0.5, 0.5));
    let ordered = OrderedPart::new(mesh, anchors.clone(), NEVER).unwrap();
    let solved = ordered.solve(NEVER).unwrap();
    assert!(solved.is_soft());
    let mut space = PoseSpace::default();
    let shift = vec![Vec2::new(30.0, -20.0); anchors.len()];
    let (moved, _) = solved.pose(&shift, &mut space, NEVER).unwrap();
    assert!(
        moved.iter().all(|u| (*u - shift[0]).norm() < 1e-4),
        "{:?}",
        moved[0]
    );
    let zero = vec![Vec2::ZERO; anchors.len()];
    assert!(
        solved
            .pose(&zero, &mut space, NEVER)
            .unwrap()
            .0
            .iter()
            .all(|u| *u == Vec2::ZERO)
    );
}
