//! The target shape t: every shape is aligned to one frame, and the aligned shapes are added with
//! their weights.

use std::fmt;

use crate::deform::{Class, Handle, fitted};
use crate::geometry::Point;

use super::super::Align;
use super::MirrorPairs;

/// Positions this near to those of an image, as a share of the extent of its handles, are those of
/// the image: what is left is rounding, and the image is then drawn without a warp.
const SAME_SHARE: f64 = 1e-9;
/// The mean shape is found when a round moves no position by more than this share of its extent.
const CONVERGED_SHARE: f64 = 1e-13;
/// Rounds for the mean shape. Faces need 5 to 15; each divides the error by how alike the shapes
/// are.
const MOST_ROUNDS: u32 = 500;

/// The frame that shapes are aligned to.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum ShapeReference {
    /// The Procrustes mean of all shapes, placed over the first of them.
    #[default]
    Mean,
    /// The shape of one of the images.
    Image(usize),
    /// This shape, px.
    Shape(Vec<Handle>),
}

/// Why shapes cannot be combined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShapeError {
    /// A shape has another number of handles than the first one.
    Count {
        /// Index of the shape; one more than the last one for a given reference.
        shape: usize,
        /// Its handles.
        found: usize,
        /// The handles of the first shape.
        expected: usize,
    },
    /// A handle has another form than in the first shape: a line in place of a point, or a line
    /// with another number of positions.
    Form {
        /// Index of the shape, as in [`ShapeError::Count`].
        shape: usize,
        /// Index of the handle.
        handle: usize,
    },
    /// No handle is present in all shapes.
    Empty,
}

impl fmt::Display for ShapeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count {
                found, expected, ..
            } => write!(
                f,
                "this shape has {found} handles, but the first one has {expected}"
            ),
            Self::Form { handle, .. } => write!(
                f,
                "handle {handle} of this shape has another form than in the first one"
            ),
            Self::Empty => write!(f, "no handle is present in all shapes"),
        }
    }
}

impl std::error::Error for ShapeError {}

/// The weighted sum of aligned shapes.
#[derive(Clone, Debug, PartialEq)]
pub struct BlendedShape {
    /// The shapes without the handles that one of them lacks, px of their images.
    shapes: Vec<Vec<Handle>>,
    /// The indices of the handles that all shapes have.
    kept: Vec<usize>,
    /// Each shape in the frame of the reference.
    aligned: Vec<Vec<Handle>>,
}

impl BlendedShape {
    /// Aligns shapes, each in px of its image. O(handles x shapes) for each of at most 500 rounds;
    /// one round unless the reference is the mean. `align`: the class of maps that place a shape
    /// over the reference.
    ///
    /// # Errors
    /// Shapes of different forms; no handle that all have.
    ///
    /// ```
    /// use mlswarp::deform::Handle;
    /// use mlswarp::geometry::Point;
    /// use mlswarp::warp::Align;
    /// use mlswarp::warp::blend::{BlendedShape, ShapeReference};
    /// let point = |(x, y)| Handle::Point(Point::new(x, y));
    /// let shapes = vec![
    ///     [(0.0, 0.0), (10.0, 0.0), (0.0, 10.0)].map(point).to_vec(),
    ///     [(0.0, 0.0), (30.0, 0.0), (0.0, 10.0)].map(point).to_vec(),
    /// ];
    /// let blend = BlendedShape::new(shapes, Align::None, &ShapeReference::Image(0))?;
    /// assert_eq!(blend.target(&[0.5, 0.5])[1], point((20.0, 0.0)));
    /// # Ok::<(), mlswarp::warp::blend::ShapeError>(())
    /// ```
    pub fn new(
        mut shapes: Vec<Vec<Handle>>,
        align: Align,
        reference: &ShapeReference,
    ) -> Result<Self, ShapeError> {
        let mut given = match reference {
            ShapeReference::Shape(shape) => Some(shape.clone()),
            ShapeReference::Mean | ShapeReference::Image(_) => None,
        };
        let kept = in_common(&shapes, given.as_ref())?;
        for shape in shapes.iter_mut().chain(given.as_mut()) {
            *shape = kept.iter().map(|index| shape[*index].clone()).collect();
        }
        let aligned = match align.class() {
            None => shapes.clone(),
            Some(class) => {
                let reference = match reference {
                    ShapeReference::Image(index) => shapes
                        .get(*index)
                        .or(shapes.first())
                        .cloned()
                        .unwrap_or_default(),
                    ShapeReference::Shape(_) => given.unwrap_or_default(),
                    ShapeReference::Mean => mean_of(class, &shapes),
                };
                let align = |shape: &Vec<Handle>| aligned(class, shape, &reference);
                shapes.iter().map(align).collect()
            }
        };
        Ok(Self {
            shapes,
            kept,
            aligned,
        })
    }

    /// Replaces an aligned shape by its mirror image in a reference frame of this width, px. So the
    /// mean of a shape and of its mirror image is symmetric about the middle of that frame,
    /// whatever the tilt of the shape.
    pub fn mirror(&mut self, shape: usize, pairs: &MirrorPairs, width: f64) {
        self.aligned[shape] = pairs.mirrored(&self.aligned[shape], width);
    }

    /// The indices of the handles that all shapes have, of those that were given.
    #[must_use]
    pub fn kept(&self) -> &[usize] {
        &self.kept
    }

    /// The handles at rest of a shape: those that all shapes have, px of its image.
    #[must_use]
    pub fn rest(&self, shape: usize) -> &[Handle] {
        &self.shapes[shape]
    }

    /// The sum of the aligned shapes with these weights, px of the reference frame.
    ///
    /// # Panics
    /// If there is not one weight for each shape.
    #[must_use]
    pub fn target(&self, weights: &[f64]) -> Vec<Handle> {
        assert_eq!(
            weights.len(),
            self.shapes.len(),
            "one weight for each shape"
        );
        sum(&self.aligned, weights)
    }

    /// A target, in the frame where the shape is drawn, as its posed handles: positions that differ
    /// from those at rest by rounding are at rest.
    #[must_use]
    pub fn posed(&self, shape: usize, target: &[Handle]) -> Vec<Handle> {
        let rest = &self.shapes[shape];
        let near = SAME_SHARE * extent_of(rest);
        let settle = |(p, q): (&Point, &Point)| if p.distance(*q) <= near { *p } else { *q };
        let handles = rest.iter().zip(target);
        handles
            .map(|(p, q)| like(q, p.places().iter().zip(q.places()).map(settle)))
            .collect()
    }
}

/// The handles that are present everywhere.
fn in_common(
    shapes: &[Vec<Handle>],
    reference: Option<&Vec<Handle>>,
) -> Result<Vec<usize>, ShapeError> {
    let first = shapes.first().ok_or(ShapeError::Empty)?;
    let all = || shapes.iter().chain(reference);
    for (shape, handles) in all().enumerate() {
        let (found, expected) = (handles.len(), first.len());
        if found != expected {
            return Err(ShapeError::Count {
                shape,
                found,
                expected,
            });
        }
    }
    let is_present = |index: &usize| all().all(|shape| shape[*index] != Handle::Missing);
    let kept: Vec<usize> = (0..first.len()).filter(is_present).collect();
    for (shape, handles) in all().enumerate() {
        let differs = |index: &&usize| !is_like(&first[**index], &handles[**index]);
        if let Some(handle) = kept.iter().find(differs) {
            return Err(ShapeError::Form {
                shape,
                handle: *handle,
            });
        }
    }
    if kept.is_empty() {
        Err(ShapeError::Empty)
    } else {
        Ok(kept)
    }
}

fn is_like(a: &Handle, b: &Handle) -> bool {
    match (a, b) {
        (Handle::Point(_), Handle::Point(_)) => true,
        (Handle::Polyline(a), Handle::Polyline(b)) => a.len() == b.len(),
        (Handle::Point(_) | Handle::Polyline(_) | Handle::Missing, _) => false,
    }
}

/// A handle of the form of `form` with these positions.
fn like(form: &Handle, mut places: impl Iterator<Item = Point>) -> Handle {
    match form {
        Handle::Point(_) => places.next().map_or(Handle::Missing, Handle::Point),
        Handle::Polyline(_) => Handle::Polyline(places.collect()),
        Handle::Missing => Handle::Missing,
    }
}

/// A shape in the frame of another one, by the best map of a class.
fn aligned(class: Class, shape: &[Handle], reference: &[Handle]) -> Vec<Handle> {
    // The best map of a shape to itself would round its positions.
    let best = (shape != reference)
        .then(|| fitted(class, shape, reference, None))
        .flatten();
    let Some(best) = best else {
        return shape.to_vec();
    };
    let place = |handle: &Handle| like(handle, handle.places().iter().map(|v| best.map.map(*v)));
    shape.iter().map(place).collect()
}

fn sum(shapes: &[Vec<Handle>], weights: &[f64]) -> Vec<Handle> {
    let Some(first) = shapes.first() else {
        return Vec::new();
    };
    // About the first shape: the weights add up to 1, so what all shapes share stays exact.
    let position = |handle: usize, place: usize| {
        let origin = first[handle].places()[place];
        let terms = shapes.iter().zip(weights).skip(1);
        terms.fold(origin, |sum, (shape, weight)| {
            sum + (shape[handle].places()[place] - origin) * *weight
        })
    };
    let handle = |(index, form): (usize, &Handle)| {
        like(
            form,
            (0..form.places().len()).map(|place| position(index, place)),
        )
    };
    first.iter().enumerate().map(handle).collect()
}

/// The Procrustes mean: the shape that is the mean of all shapes when each is aligned to it. For
/// similarities a round is a step of the power iteration for the dominant eigenvector of
/// `sum z z* / (z* z)` (z: a centred shape as complex numbers), which is that mean. A mean is
/// determined up to a map of its class: it is placed over the first shape after every round, which
/// also keeps its size from drifting to zero.
fn mean_of(class: Class, shapes: &[Vec<Handle>]) -> Vec<Handle> {
    let Some(first) = shapes.first() else {
        return Vec::new();
    };
    #[expect(clippy::cast_precision_loss, reason = "a few hundred shapes")]
    let equal = vec![1.0 / shapes.len() as f64; shapes.len()];
    let enough = CONVERGED_SHARE * extent_of(first);
    let mut mean = first.clone();
    for _ in 0..MOST_ROUNDS {
        let placed: Vec<_> = shapes
            .iter()
            .map(|shape| aligned(class, shape, &mean))
            .collect();
        let next = aligned(class, &sum(&placed, &equal), first);
        let moved = farthest(&mean, &next);
        mean = next;
        if moved <= enough {
            break;
        }
    }
    mean
}

fn positions(shape: &[Handle]) -> impl Iterator<Item = Point> + '_ {
    shape.iter().flat_map(Handle::places).copied()
}

fn farthest(a: &[Handle], b: &[Handle]) -> f64 {
    let distances = positions(a).zip(positions(b)).map(|(a, b)| a.distance(b));
    distances.fold(0.0, f64::max)
}

/// The largest distance of a position from the first one, px.
fn extent_of(shape: &[Handle]) -> f64 {
    let Some(first) = positions(shape).next() else {
        return 0.0;
    };
    positions(shape)
        .map(|v| v.distance(first))
        .fold(0.0, f64::max)
}
