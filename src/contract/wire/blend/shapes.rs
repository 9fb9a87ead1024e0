//! The landmarks of the images of a blend: matched, mirrored and aligned.

use std::collections::HashMap;

use mlswarp::deform::{Handle, IsCancelled};
use mlswarp::pixmap::Extent;
use mlswarp::warp::WarpError;
use mlswarp::warp::blend::{BlendedShape, MirrorPairs, NoPairs, ShapeError};

use super::super::enum_name::Matching;
use super::super::landmarks::Landmarks;
use super::{BlendEntry, BlendObject};
use crate::problem::{Code, Problem};

/// The landmarks of all images, aligned.
#[derive(Debug)]
pub struct AlignedShapes {
    /// The landmarks of each image that all have, px of the image.
    pub p: Vec<Vec<Handle>>,
    /// Which handles are each other's mirror images, where the mirror image is meant.
    pub pairs: Vec<Option<MirrorPairs>>,
    /// The same in the frame of the reference.
    pub blended: BlendedShape,
}

impl AlignedShapes {
    /// Matches the landmarks, aligns them, and mirrors those of mirrored images about the middle of
    /// the reference frame. `width`: of the first image, px. Errors: landmarks that do not go
    /// together; cancelled.
    pub fn new(
        object: &BlendObject,
        mut shapes: Vec<NamedShape>,
        width: u32,
        cancelled: IsCancelled<'_>,
    ) -> Result<Self, Problem> {
        match_shapes(&mut shapes, object.matching)?;
        let kept = common_handles(&mut shapes);
        let pairs = object.images.iter().zip(&shapes).enumerate();
        let pairs = pairs.map(|(index, (entry, shape))| {
            entry
                .is_mirrored
                .then(|| mirror_pairs(entry, index, shape, kept.as_deref(), cancelled))
                .transpose()
        });
        let pairs = pairs.collect::<Result<Vec<_>, _>>()?;
        let p: Vec<Vec<Handle>> = shapes.into_iter().map(|shape| shape.p).collect();
        let count = p.len();
        let mut blended = BlendedShape::new(p.clone(), object.align, &object.reference)
            .map_err(|error| shape_problem(error, count))?;
        for (index, pairs) in pairs.iter().enumerate() {
            if let Some(pairs) = pairs {
                blended.mirror(index, pairs, f64::from(width));
            }
        }
        Ok(Self { p, pairs, blended })
    }
}

/// The landmarks of an image, px of the image, with their names if they have any.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedShape {
    /// The landmarks.
    pub p: Vec<Handle>,
    /// One name for each.
    pub names: Option<Vec<String>>,
}

impl NamedShape {
    /// What a landmark file has, on an image of the size `extent`.
    /// Errors: as [`Landmarks::scale`].
    pub fn of_file(landmarks: Landmarks, extent: Extent) -> Result<Self, Problem> {
        let (p, names) = landmarks.into_shape(extent)?;
        Ok(Self { p, names })
    }
}

/// Brings shapes to the order of the first one, by names if that was requested, or if all have
/// names of which each occurs once, and their order differs. A landmark that one of them lacks is
/// left out of all. Errors: `bad_value` where names are requested and missing.
fn match_shapes(shapes: &mut [NamedShape], matching: Option<Matching>) -> Result<(), Problem> {
    let Some((first, others)) = shapes.split_first_mut() else {
        return Ok(());
    };
    let index_of = |shape: &NamedShape| {
        let names = shape.names.as_ref()?;
        let index: HashMap<String, usize> = names
            .iter()
            .cloned()
            .enumerate()
            .map(|(k, name)| (name, k))
            .collect();
        (index.len() == shape.p.len()).then_some(index)
    };
    let indices: Option<Vec<_>> = others.iter().map(&index_of).collect();
    let is_same = others.iter().all(|shape| shape.names == first.names);
    let (indices, names) = match (matching, indices, index_of(first).and(first.names.clone())) {
        (Some(Matching::Order), ..) => return Ok(()),
        (None, ..) if is_same => return Ok(()),
        (_, Some(indices), Some(names)) => (indices, names),
        (None, ..) => return Ok(()),
        (Some(Matching::Name), ..) => {
            let detail = "the landmarks are matched by name, but not every image has landmark \
                          names of which each occurs once";
            return Err(Problem::new(Code::BadValue, detail).pointer("/match"));
        }
    };
    let kept: Vec<usize> = (0..names.len())
        .filter(|k| indices.iter().all(|index| index.contains_key(&names[*k])))
        .collect();
    for (shape, index) in others.iter_mut().zip(&indices) {
        shape.p = kept
            .iter()
            .map(|k| shape.p[index[&names[*k]]].clone())
            .collect();
        shape.names = Some(kept.iter().map(|k| names[*k].clone()).collect());
    }
    first.p = kept.iter().map(|k| first.p[*k].clone()).collect();
    first.names = Some(kept.iter().map(|k| names[*k].clone()).collect());
    Ok(())
}

/// Leaves out of all shapes the landmarks that one of them lacks; the indices of the others if any
/// was left out.
fn common_handles(shapes: &mut [NamedShape]) -> Option<Vec<usize>> {
    let count = shapes.iter().map(|shape| shape.p.len()).min()?;
    let is_present = |k: &usize| shapes.iter().all(|shape| shape.p[*k] != Handle::Missing);
    let kept: Vec<usize> = (0..count).filter(is_present).collect();
    let is_whole = kept.len() == count || shapes.iter().any(|shape| shape.p.len() != count);
    if is_whole {
        return None;
    }
    for shape in shapes {
        shape.p = kept.iter().map(|k| shape.p[*k].clone()).collect();
        let pick = |names: &Vec<String>| kept.iter().map(|k| names[*k].clone()).collect();
        shape.names = shape.names.as_ref().map(pick);
    }
    Some(kept)
}

/// The pairs of a mirrored image: as given, by name, or by position. `kept`: the indices, among
/// those that the client counts, of the landmarks of the shape; `None` if that has all of them.
/// Errors: `bad_value` at the entry where they are not known.
fn mirror_pairs(
    entry: &BlendEntry,
    index: usize,
    shape: &NamedShape,
    kept: Option<&[usize]>,
    cancelled: IsCancelled<'_>,
) -> Result<MirrorPairs, Problem> {
    let by_name = || {
        let names = shape.names.as_ref()?;
        MirrorPairs::of_names(names, &shape.p)
    };
    let given = entry.pairs.as_ref().map(|pairs| match kept {
        None => pairs.clone(),
        // A pair that was left out is not among the pairs, and is refused.
        Some(kept) => kept
            .iter()
            .filter_map(|k| pairs.get(*k))
            .map(|pair| kept.iter().position(|k| k == pair).unwrap_or(usize::MAX))
            .collect(),
    });
    let found = match &given {
        Some(pairs) => MirrorPairs::of_permutation(pairs, &shape.p),
        None => by_name().map_or_else(|| MirrorPairs::of_positions(&shape.p, cancelled), Ok),
    };
    found.map_err(|error| match error {
        NoPairs::Cancelled => WarpError::Cancelled.into(),
        NoPairs::Count { .. } | NoPairs::NoPair { .. } | NoPairs::TooMany { .. } => {
            Problem::new(Code::BadValue, error.to_string())
                .pointer(format!("/images/{index}/pairs"))
        }
    })
}

/// The problem of shapes that cannot be combined.
fn shape_problem(error: ShapeError, images: usize) -> Problem {
    let at = |shape: usize| {
        if shape < images {
            format!("/images/{shape}")
        } else {
            "/reference".to_owned()
        }
    };
    let detail = error.to_string();
    match error {
        ShapeError::Count { shape, found, .. } => Problem::new(Code::ShapeMismatch, detail)
            .pointer(at(shape))
            .actual(found),
        ShapeError::Form { shape, handle } => Problem::new(Code::ShapeMismatch, detail)
            .pointer(at(shape))
            .handle(handle),
        ShapeError::Empty => Problem::new(Code::BadValue, detail).pointer("/images"),
    }
}
