//! What follows from one pose: a mesh, its report, positions both ways, and drawings.

use std::sync::{Arc, OnceLock};

use super::{Cancel, Rendering, Warper};
use crate::deform::{Handle, Pose};
use crate::geometry::{Mesh, Point};
use crate::parallel::prelude::*;
use crate::warp::{
    Alignment, CanvasSpec, Folds, Image, LabelImage, MapDirection, PixelPositions, PosedMesh,
    Quality, RasterSource, Region, Report, Target, Transform, WarpError, reserved,
};

/// The mesh of one pose. Images, labels, points and maps follow from it. Cheap to clone.
#[derive(Clone, Debug)]
pub struct PosedWarp {
    warper: Warper,
    settled: Arc<SettledPose>,
    posed: Arc<PosedMesh>,
    /// The mesh on which inverses are searched, made for the first of them.
    inverse: Arc<OnceLock<PosedMesh>>,
}

/// What a mesh is made of.
#[derive(Debug)]
pub(super) struct SettledPose {
    /// Aligned, and at the strength that was asked for.
    pub(super) q: Vec<Handle>,
    pub(super) alignment: Option<Alignment>,
    pub(super) pose: Pose,
}

impl PosedWarp {
    pub(super) fn new(warper: Warper, settled: SettledPose, posed: PosedMesh) -> Self {
        Self {
            warper,
            settled: Arc::new(settled),
            posed: Arc::new(posed),
            inverse: Arc::default(),
        }
    }

    /// The same, whose work ends when `cancel` says so.
    ///
    /// ```
    /// use mlswarp::{Cancel, Warper};
    /// let posed = Warper::new([64, 48], &[[9.0, 9.0]])?.pose(&[[12.0, 9.0]])?;
    /// let cancel = Cancel::new();
    /// cancel.cancel();
    /// assert!(posed.clone().cancelled_by(&cancel).render_coverage().pixels().is_err());
    /// assert!(posed.render_coverage().pixels().is_ok());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn cancelled_by(mut self, cancel: &Cancel) -> Self {
        self.warper = self.warper.cancelled_by(cancel);
        self
    }

    /// Folds, the residual, and warnings.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// // The second point is drawn across the first.
    /// let warper = Warper::new([64, 64], &[[30.0, 32.0], [34.0, 32.0]])?;
    /// let posed = warper.pose(&[[30.0, 32.0], [10.0, 32.0]])?;
    /// assert!(posed.report().residual < 0.25);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn report(&self) -> &Report {
        self.posed.report()
    }

    /// The grid at rest with the displacement of every vertex, px, and its subdivided cells.
    #[must_use]
    pub fn mesh(&self) -> &Mesh {
        self.posed.mesh()
    }

    /// The mesh with its report, for the parts below the front door.
    #[must_use]
    pub fn posed_mesh(&self) -> &PosedMesh {
        &self.posed
    }

    /// The posed handles, validated.
    #[must_use]
    pub fn pose(&self) -> &Pose {
        &self.settled.pose
    }

    /// The posed handles in the units of those at rest: aligned, and at the strength that was asked
    /// for.
    #[must_use]
    pub fn q(&self) -> &[Handle] {
        &self.settled.q
    }

    /// How the posed handles were aligned, if the builder asked for that.
    #[must_use]
    pub fn alignment(&self) -> Option<Alignment> {
        self.settled.alignment
    }

    /// The handles at rest that this is a pose of.
    #[must_use]
    pub const fn warper(&self) -> &Warper {
        &self.warper
    }

    /// The same pose, of which only what is white, or opaque, in a mask of the image's size moves.
    ///
    /// # Errors
    /// A mask of another size.
    ///
    /// ```
    /// use mlswarp::{Image, Warper};
    /// let mask = Image::from_grey8(4, 4, [[0_u8; 8], [255; 8]].concat())?;
    /// let warper = Warper::new([4, 4], &[[1.0, 3.0]])?;
    /// let posed = warper.pose(&[[3.0, 3.0]])?.within(&mask)?;
    /// assert!(posed.posed_mesh().region().is_some());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn within(mut self, mask: &Image) -> Result<Self, WarpError> {
        self.check_size(mask.extent())?;
        self.posed = Arc::new(Arc::unwrap_or_clone(self.posed).within(Region::new(mask)));
        Ok(self)
    }

    fn check_size(&self, actual: crate::pixmap::Extent) -> Result<(), WarpError> {
        let expected = self.warper.extent();
        if actual == expected {
            Ok(())
        } else {
            Err(WarpError::OtherSize { expected, actual })
        }
    }

    /// An image in this pose, not drawn yet.
    ///
    /// # Errors
    /// An image of another size than the warper's.
    ///
    /// ```
    /// use mlswarp::{Image, Warper};
    /// let image = Image::from_rgb8(3, 1, vec![1, 1, 1, 2, 2, 2, 3, 3, 3])?;
    /// let warper = Warper::new(image.extent(), &[[0.5, 0.5]])?;
    /// let pixels = warper.pose(&[[1.5, 0.5]])?.render(&image)?.pixels()?;
    /// // One px to the right; what is not covered is black without an alpha channel.
    /// assert_eq!(pixels.into_samples(), vec![0_u8, 0, 0, 1, 1, 1, 2, 2, 2].into());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn render<'a>(&'a self, image: &'a Image) -> Result<Rendering<'a>, WarpError> {
        self.check_size(image.extent())?;
        Ok(Rendering::new(self, RasterSource::Image(image)))
    }

    /// Labels in this pose, not drawn yet. They are never mixed; where nothing is drawn they are 0.
    ///
    /// # Errors
    /// Labels of another size than the warper's.
    ///
    /// ```
    /// use mlswarp::{LabelImage, Warper};
    /// use mlswarp::warp::LabelValues;
    /// let labels = LabelImage::from_labels32(3, 1, &[70_000, 1, 2])?;
    /// let warper = Warper::new(labels.extent(), &[[0.5, 0.5]])?;
    /// let values = warper.pose(&[[1.5, 0.5]])?.render_labels(&labels)?.labels()?;
    /// assert_eq!(values, LabelValues::ThirtyTwo(vec![0, 70_000, 1]));
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn render_labels<'a>(&'a self, labels: &'a LabelImage) -> Result<Rendering<'a>, WarpError> {
        self.check_size(labels.extent())?;
        Ok(Rendering::new(self, RasterSource::Labels(labels)))
    }

    /// How much of each pixel the posed image covers, 0 to 255, as grey of 8 bit; not drawn yet.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// let warper = Warper::new([2, 1], &[[0.5, 0.5]])?;
    /// let posed = warper.pose(&[[1.5, 0.5]])?;
    /// assert_eq!(posed.render_coverage().pixels()?.into_samples(), vec![0_u8, 255].into());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn render_coverage(&self) -> Rendering<'_> {
        Rendering::new(self, RasterSource::Coverage(self.warper.extent()))
    }

    /// Where positions of the image go: f itself, not the mesh.
    ///
    /// # Errors
    /// A coordinate that is not finite or out of range; too much work; cancelled.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// let warper = Warper::new([64, 48], &[[10.0, 10.0]])?;
    /// let posed = warper.pose(&[[15.0, 12.0]])?;
    /// assert_eq!(posed.map_points(&[[10.0, 10.0], [20.0, 30.0]])?, [[15.0, 12.0], [25.0, 32.0]]);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn map_points(&self, points: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, WarpError> {
        let f = self.transform();
        let mapped = self
            .warper
            .cancellable(|cancelled| f.map(&places(points), cancelled))?;
        // Every position has an image.
        Ok(mapped.into_iter().flatten().map(|p| [p.x, p.y]).collect())
    }

    /// f itself, for outlines too; its positions are in the units of the handles.
    #[must_use]
    pub fn transform(&self) -> Transform<'_> {
        self.warper
            .resolved()
            .transform_of(self.pose(), &self.posed)
    }

    /// Which positions of the image go to these ones; `None` where nothing does. Of several, the
    /// one that is drawn.
    ///
    /// # Errors
    /// Those of [`PosedWarp::map_points`].
    ///
    /// ```
    /// use mlswarp::Warper;
    /// let warper = Warper::new([64, 48], &[[10.0, 10.0]])?;
    /// let posed = warper.pose(&[[15.0, 12.0]])?;
    /// let found = posed.unmap_points(&[[15.0, 12.0], [1.0, 1.0]])?;
    /// assert!(found[0].is_some_and(|[x, y]| (x - 10.0).hypot(y - 10.0) < 1e-9));
    /// assert_eq!(found[1], None);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn unmap_points(&self, points: &[[f64; 2]]) -> Result<Vec<Option<[f64; 2]>>, WarpError> {
        let back = self.inverse()?;
        let found = self
            .warper
            .cancellable(|cancelled| back.map(&places(points), cancelled))?;
        Ok(found
            .into_iter()
            .map(|place| place.map(|p| [p.x, p.y]))
            .collect())
    }

    /// The inverse of f, for outlines too; its positions are in the units of the handles.
    ///
    /// # Errors
    /// Cancelled.
    pub fn inverse(&self) -> Result<Transform<'_>, WarpError> {
        let posed = self.to_invert()?;
        Ok(self.warper.to_invert()?.0.inverse(self.pose(), posed))
    }

    fn to_invert(&self) -> Result<&PosedMesh, WarpError> {
        if self.posed.is_unfolded() {
            return Ok(&self.posed);
        }
        let (resolved, compiled) = self.warper.to_invert()?;
        if self.inverse.get().is_none() {
            let posed = self.warper.cancellable(|cancelled| {
                PosedMesh::coarse(resolved, compiled, self.pose(), Folds::Report, cancelled)
            })?;
            // Another thread may have been first, with the same.
            let _ = self.inverse.set(posed);
        }
        Ok(self.inverse.get().expect("it was just made"))
    }

    /// How good the pose is, on the canvas of the image: residuals, folds, distortion, and what is
    /// left of positions that are mapped and back. CPU work, longer than that of a drawing.
    ///
    /// # Errors
    /// More work than the limit; cancelled.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// let posed = Warper::new([64, 48], &[[10.0, 10.0]])?.pose(&[[12.0, 10.0]])?;
    /// assert_eq!(posed.quality()?.residuals, [Some(0.0)]);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn quality(&self) -> Result<Quality, WarpError> {
        let resolved = self.warper.resolved();
        resolved.check_quality()?;
        let is_same = self.warper.to_invert()?.0.plan_key() == resolved.plan_key();
        let inverse = if is_same {
            &self.posed
        } else {
            self.to_invert()?
        };
        self.warper.cancellable(|cancelled| {
            let canvas = CanvasSpec::Same.of(resolved.source(), &self.posed, cancelled)?;
            let (q, pose) = (self.q(), self.pose());
            Quality::of(resolved, q, pose, &self.posed, inverse, canvas, cancelled)
        })
    }

    /// A position for every pixel of the image, row by row, px; NaN where nothing is. Inverse: the
    /// source position that a pixel of the posed image shows. Forward: where the centre of a pixel
    /// of the image is drawn.
    ///
    /// # Errors
    /// Cancelled; too little memory.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// use mlswarp::warp::MapDirection;
    /// let warper = Warper::new([2, 1], &[[0.5, 0.5]])?;
    /// let map = warper.pose(&[[1.5, 0.5]])?.map(MapDirection::Inverse)?;
    /// assert!(map[0][0].is_nan());
    /// assert_eq!(map[1], [0.5, 0.5]);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn map(&self, direction: MapDirection) -> Result<Vec<[f32; 2]>, WarpError> {
        let extent = self.warper.extent();
        let positions = PixelPositions::new(direction, self.mesh(), Target::of(None, extent));
        let mut map = reserved(extent.pixels())?;
        let row = extent.width() as usize;
        let band = positions.band_rows();
        let draw = |(index, out): (usize, &mut [[f32; 2]])| {
            let first = u32::try_from(index)
                .unwrap_or(u32::MAX)
                .saturating_mul(band);
            let last = first.saturating_add(band).min(extent.height());
            self.warper.cancellable(|cancelled| {
                positions.rows(first..last, out, cancelled);
                (!cancelled()).then_some(())
            })
        };
        map.par_chunks_mut(row * band as usize)
            .enumerate()
            .map(draw)
            .collect::<Option<()>>()
            .ok_or(WarpError::Cancelled)?;
        Ok(map)
    }
}

fn places(points: &[[f64; 2]]) -> Vec<Point> {
    points.iter().map(|[x, y]| Point::new(*x, *y)).collect()
}
