//! A blend of images in memory, frame by frame: what `POST /blend` makes, without a service. The
//! packages for Python and JavaScript share it.

use std::sync::{Arc, Mutex, PoisonError};

use mlswarp::deform::Handle;
use mlswarp::render::Canvas;
use mlswarp::warp::blend::ImageSum;
use mlswarp::warp::{Limits, RasterSource, RestSpec, Target, WarpError};
use mlswarp::{Cancel, Image, Warper};

use crate::problem::{Code, Problem};
use crate::wire::blend::{AlignedShapes, BlendObject, BlendReport, BlendSource, NamedShape};
use crate::wire::{AsJson, Reserved};

/// Images with landmarks, and how they are added.
#[derive(Debug)]
pub struct Blend {
    object: BlendObject,
    /// In the order in which they are added.
    images: Vec<Arc<Image>>,
    aligned: AlignedShapes,
    canvas: Canvas,
    target: Target,
    limits: Limits,
    /// Of each image, once a frame has needed it.
    warpers: Mutex<Vec<Option<Warper>>>,
}

/// One result of a blend.
#[derive(Debug)]
pub struct BlendFrame {
    /// The sum, with alpha if an image has it or does not cover the result.
    pub image: Image,
    /// Where the landmarks are in it, px of the reference frame.
    pub landmarks: Vec<Handle>,
    /// Its figures.
    pub report: BlendReport,
}

impl Blend {
    /// `images`: what the numbers `image` of the object stand for. `json`: the object of
    /// `POST /blend`, in which every image has its number and its handles.
    /// Errors: a field that the contract does not have, or with another value; handles that do not
    /// go together.
    pub fn new(images: Vec<Arc<Image>>, json: &[u8], limits: Limits) -> Result<Self, Problem> {
        let object = Reserved::<BlendObject, ()>::parse(json, |_| Ok(()))?;
        let object = object.into_parts().0;
        let (mut added, mut shapes) = (Vec::new(), Vec::new());
        for (index, entry) in object.images.iter().enumerate() {
            let image = match entry.source {
                BlendSource::Part(number) => images.get(number),
                BlendSource::Session(_) => None,
            };
            let (Some(image), Some(p)) = (image, &entry.p) else {
                let count = images.len();
                let detail =
                    format!("expected the number of one of {count} images, and its handles");
                let pointer = format!("/images/{index}");
                return Err(Problem::new(Code::BadValue, detail).pointer(pointer));
            };
            added.push(Arc::clone(image));
            shapes.push(NamedShape {
                p: p.clone(),
                names: entry.names.clone(),
            });
        }
        // An object without images was refused.
        let first = added[0].extent();
        let aligned = AlignedShapes::new(&object, shapes, first.width(), &|| false)?;
        let (canvas, target) = object.target(first, &limits)?;
        for image in &added {
            RasterSource::Image(image).check(&object.output)?;
        }
        Ok(Self {
            warpers: Mutex::new(vec![None; added.len()]),
            object,
            images: added,
            aligned,
            canvas,
            target,
            limits,
        })
    }

    /// How many results there are.
    pub fn frames(&self) -> usize {
        self.object.frames
    }

    /// The coefficients of an image. Where there are several frames, they are computed once.
    fn warper(&self, index: usize, cancel: &Cancel) -> Result<Warper, Problem> {
        let known = || self.warpers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(warper) = &known()[index] {
            return Ok(warper.clone().cancelled_by(cancel));
        }
        let (rest, p) = (self.object.rest.clone(), self.aligned.p[index].clone());
        let warper = Warper::builder::<Handle>(&[])
            .with(|spec| *spec = RestSpec { p, ..rest })
            .limits(self.limits)
            .cancelled_by(cancel)
            .build(self.images[index].extent())?;
        if self.object.frames > 1 {
            known()[index] = Some(warper.clone());
        }
        Ok(warper)
    }

    /// One result, from 0. Errors: there is no such frame; handles of an image for which there is
    /// no map; it was cancelled.
    pub fn frame(&self, frame: usize, cancel: &Cancel) -> Result<BlendFrame, Problem> {
        if frame >= self.object.frames {
            let detail = format!(
                "expected a frame below {}; found {frame}",
                self.object.frames
            );
            return Err(Problem::new(Code::BadValue, detail));
        }
        let is_cancelled = || cancel.is_cancelled();
        let shape = self.object.shape_weights(frame);
        let colour = self.object.colour_weights(frame);
        let landmarks = self.aligned.blended.target(&shape);
        let (extent, space) = (self.target.extent, self.object.space);
        let mut sum = ImageSum::new(self.canvas, extent, space, &colour);
        let width = self.images[0].extent().width();
        let mut folds = vec![0; self.images.len()];
        for (index, image) in self.images.iter().enumerate() {
            // An image that adds no colour is needed only for the kind of the result.
            if colour[index] == 0.0 && index > 0 {
                continue;
            }
            let pairs = self.aligned.pairs[index].as_ref();
            let drawn = match pairs {
                Some(pairs) => &pairs.mirrored(&landmarks, f64::from(width)),
                None => &landmarks,
            };
            let q = self.aligned.blended.posed(index, drawn);
            let warper = self
                .warper(index, cancel)
                .map_err(|problem| in_image(index, problem))?;
            let posed = warper.pose_settled(q);
            let posed = posed.map_err(|error| in_image(index, error.into()))?;
            let how = (colour[index], pairs.map(|_| width));
            let output = &self.object.output;
            sum.add(image, posed.posed_mesh(), how, output, &is_cancelled)?;
            folds[index] = posed.report().folds;
        }
        let blended = sum.finish(&is_cancelled)?.ok_or(WarpError::Cancelled)?;
        let report = BlendReport {
            picture: String::new(),
            shape,
            colour,
            clamped: blended.clamped,
            folds,
            width: extent.width(),
            height: extent.height(),
            canvas: AsJson(self.canvas),
            landmarks: self.aligned.blended.kept().to_vec(),
        };
        Ok(BlendFrame {
            image: blended.image,
            landmarks,
            report,
        })
    }
}

/// Names the image in a problem of its handles.
fn in_image(index: usize, mut problem: Problem) -> Problem {
    problem.detail = format!("image {index}: {}", problem.detail);
    problem.pointer = Some(format!("/images/{index}"));
    problem
}
