//! The front door: handles at rest on an image of some size, poses of them, and drawings of these.

mod cancel;
#[cfg(feature = "codec")]
mod open;
mod posed_warp;
mod rendering;

use std::sync::{Arc, OnceLock};

use crate::deform::{Handle, IsCancelled};
use crate::format::ImageLimits;
use crate::geometry::Point;
use crate::pixmap::{Extent, PixelError};
use crate::warp::{
    Alignment, CompiledRest, Folds, GridSpec, Jitter, Limits, Method, PosedMesh, ResolvedRest,
    RestSpec, Units, WarpError,
};

pub use self::cancel::Cancel;
#[cfg(feature = "codec")]
pub use self::open::FileError;
pub use self::posed_warp::PosedWarp;
use self::posed_warp::SettledPose;
pub use self::rendering::Rendering;

/// The longest side of an image whatever the limits, px: positions up to twice as far are held by
/// the rasteriser.
const LONGEST_SIDE_PX: u32 = 1 << 20;

impl From<[f64; 2]> for Handle {
    /// A point.
    fn from([x, y]: [f64; 2]) -> Self {
        Self::Point(Point::new(x, y))
    }
}

impl From<[[f64; 2]; 2]> for Handle {
    /// A segment.
    fn from(ends: [[f64; 2]; 2]) -> Self {
        Self::Polyline(ends.map(|[x, y]| Point::new(x, y)).to_vec())
    }
}

impl From<&Self> for Handle {
    fn from(handle: &Self) -> Self {
        handle.clone()
    }
}

impl TryFrom<[u32; 2]> for Extent {
    type Error = PixelError;

    /// Width and height.
    fn try_from([width, height]: [u32; 2]) -> Result<Self, PixelError> {
        Self::new(width, height).ok_or(PixelError::Empty { width, height })
    }
}

/// Handles at rest on an image of some size, with everything that does not depend on a pose
/// computed. Cheap to clone, and shared by threads.
///
/// Handles are points (`[x, y]`), segments (`[[x, y], [x, y]]`) or any [`Handle`]. Positions are
/// px; `[0.5, 0.5]` is the centre of the first pixel.
#[derive(Clone, Debug)]
pub struct Warper {
    inner: Arc<Inner>,
    folds: Folds,
    cancel: Cancel,
}

#[derive(Debug)]
struct Inner {
    extent: Extent,
    rest: RestSpec,
    limits: Limits,
    resolved: ResolvedRest,
    compiled: CompiledRest,
    /// The grid on which inverses are searched.
    to_invert: OnceLock<(ResolvedRest, CompiledRest)>,
}

impl Warper {
    /// Rigid moving least squares with its defaults. `size`: that of the image, an [`Extent`] or
    /// `[width, height]`.
    ///
    /// # Errors
    /// Invalid handles, or too many; an image that is too large.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// let warper = Warper::new([640, 480], &[[100.0, 100.0], [200.0, 100.0]])?;
    /// let posed = warper.pose(&[[100.0, 100.0], [200.0, 120.0]])?;
    /// assert_eq!(posed.report().folds, 0);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn new<H>(
        size: impl TryInto<Extent, Error = impl Into<WarpError>>,
        p: &[H],
    ) -> Result<Self, WarpError>
    where
        H: Clone + Into<Handle>,
    {
        Self::builder(p).build(size)
    }

    /// For a method or parameters other than the defaults.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// use mlswarp::warp::Method;
    /// let corners = [[0.0, 0.0], [64.0, 0.0], [64.0, 48.0]];
    /// let warper = Warper::builder(&corners)
    ///     .method(Method::Affine)
    ///     .alpha(1.5)
    ///     .build([64, 48])?;
    /// assert_eq!(warper.resolved().alpha(), Some(1.5));
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn builder<H: Clone + Into<Handle>>(p: &[H]) -> WarperBuilder {
        WarperBuilder {
            rest: RestSpec {
                p: handles(p),
                ..RestSpec::default()
            },
            limits: Limits::default(),
            folds: Folds::default(),
            cancel: Cancel::new(),
        }
    }

    /// The mesh of posed handles, as many and of the same kinds as those at rest. CPU work:
    /// milliseconds at most for a photograph.
    ///
    /// # Errors
    /// Handles that do not fit those at rest, or whose positions conflict; a fold, if the builder
    /// rejects them; cancelled.
    pub fn pose<H: Clone + Into<Handle>>(&self, q: &[H]) -> Result<PosedWarp, WarpError> {
        self.pose_at(q, 1.0)
    }

    /// The mesh of a pose at a strength: 0 is at rest, 1 is `q`, 2 is twice as far.
    ///
    /// # Errors
    /// Those of [`Warper::pose`].
    ///
    /// ```
    /// use mlswarp::Warper;
    /// let warper = Warper::new([64, 48], &[[10.0, 10.0]])?;
    /// let half = warper.pose_at(&[[20.0, 10.0]], 0.5)?;
    /// assert_eq!(half.map_points(&[[10.0, 10.0]])?, [[15.0, 10.0]]);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn pose_at<H>(&self, q: &[H], strength: f64) -> Result<PosedWarp, WarpError>
    where
        H: Clone + Into<Handle>,
    {
        let (q, alignment) = self.settled(q, strength);
        self.posed(q, alignment)
    }

    /// A pose whose handles are displaced at random: that of one frame of a series. The same seed
    /// and frame give the same bits everywhere.
    ///
    /// # Errors
    /// Those of [`Warper::pose`].
    ///
    /// ```
    /// use mlswarp::Warper;
    /// use mlswarp::warp::Jitter;
    /// let p = [[10.0, 10.0], [50.0, 40.0]];
    /// let jitter = Jitter { seed: 7, sigma: 2.0 };
    /// let posed = Warper::new([64, 48], &p)?.pose_jittered(&p, 1.0, jitter, 0)?;
    /// assert_ne!(posed.q()[0], p[0].into());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    pub fn pose_jittered<H: Clone + Into<Handle>>(
        &self,
        q: &[H],
        strength: f64,
        jitter: Jitter,
        frame: u32,
    ) -> Result<PosedWarp, WarpError> {
        let (q, alignment) = self.settled(q, strength);
        let (resolved, p) = (&self.inner.resolved, &self.inner.rest.p);
        self.posed(jitter.displace(resolved, p, &q, frame), alignment)
    }

    /// Posed handles in the frame of those at rest, at a strength.
    fn settled<H: Clone + Into<Handle>>(
        &self,
        q: &[H],
        strength: f64,
    ) -> (Vec<Handle>, Option<Alignment>) {
        let inner = &*self.inner;
        inner.rest.posed(handles(q), strength, inner.extent)
    }

    /// The pose of handles that are aligned already: [`PosedWarp::q`] of another pose.
    ///
    /// # Errors
    /// Those of [`Warper::pose`].
    pub fn pose_settled(&self, q: Vec<Handle>) -> Result<PosedWarp, WarpError> {
        self.posed(q, None)
    }

    fn posed(&self, q: Vec<Handle>, alignment: Option<Alignment>) -> Result<PosedWarp, WarpError> {
        let inner = &*self.inner;
        let pose = inner.resolved.pose(&q)?;
        let mesh = self.cancellable(|cancelled| {
            PosedMesh::new(
                &inner.resolved,
                &inner.compiled,
                &pose,
                self.folds,
                cancelled,
            )
        })?;
        let settled = SettledPose { q, alignment, pose };
        Ok(PosedWarp::new(self.clone(), settled, mesh))
    }

    /// The same, whose work ends when `cancel` says so, as does that of its poses.
    #[must_use]
    pub fn cancelled_by(mut self, cancel: &Cancel) -> Self {
        self.cancel = cancel.clone();
        self
    }

    /// The same, with another treatment of folds.
    ///
    /// # Errors
    /// A method or metric whose folds cannot be removed; too much work.
    pub fn with_folds(self, folds: Folds) -> Result<Self, WarpError> {
        self.inner.rest.check_folds(folds)?;
        self.inner.resolved.check_folds(folds)?;
        Ok(Self { folds, ..self })
    }

    /// The size of the image.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.inner.extent
    }

    /// The handles at rest with the parameters that hold for them.
    #[must_use]
    pub fn resolved(&self) -> &ResolvedRest {
        &self.inner.resolved
    }

    /// What depends on the handles at rest alone.
    #[must_use]
    pub fn compiled(&self) -> &CompiledRest {
        &self.inner.compiled
    }

    fn limits(&self) -> &Limits {
        &self.inner.limits
    }

    fn cancellable<T>(&self, work: impl FnOnce(IsCancelled<'_>) -> T) -> T {
        work(&|| self.cancel.is_cancelled())
    }

    /// The same handles on the grid on which inverses are searched.
    fn to_invert(&self) -> Result<&(ResolvedRest, CompiledRest), WarpError> {
        if self.inner.to_invert.get().is_none() {
            let resolved = self.inner.resolved.to_invert(&self.inner.limits)?;
            let compiled = self.cancellable(|cancelled| resolved.plan(cancelled))?;
            // Another thread may have been first, with the same.
            let _ = self.inner.to_invert.set((resolved, compiled));
        }
        Ok(self.inner.to_invert.get().expect("it was just made"))
    }
}

fn handles<H: Clone + Into<Handle>>(handles: &[H]) -> Vec<Handle> {
    handles.iter().cloned().map(Into::into).collect()
}

/// The parameters of a [`Warper`].
#[derive(Clone, Debug)]
pub struct WarperBuilder {
    rest: RestSpec,
    limits: Limits,
    folds: Folds,
    cancel: Cancel,
}

impl WarperBuilder {
    /// How the image follows the handles.
    #[must_use]
    pub fn method(mut self, method: Method) -> Self {
        self.rest.method = method;
        self
    }

    /// The fall-off of moving least squares.
    #[must_use]
    pub fn alpha(mut self, alpha: f64) -> Self {
        self.rest.alpha = Some(alpha);
        self
    }

    /// One weight per handle.
    #[must_use]
    pub fn weights(mut self, weights: impl Into<Vec<f64>>) -> Self {
        self.rest.weights = Some(weights.into());
        self
    }

    /// Of a thin-plate spline: 0 goes through the posed handles.
    #[must_use]
    pub fn smoothing(mut self, smoothing: f64) -> Self {
        self.rest.smoothing = Some(smoothing);
        self
    }

    /// The unit of all handles.
    #[must_use]
    pub fn units(mut self, units: Units) -> Self {
        self.rest.units = units;
        self
    }

    /// The grid on which the map is computed.
    #[must_use]
    pub fn grid(mut self, grid: GridSpec) -> Self {
        self.rest.grid = grid;
        self
    }

    /// Every other parameter of the handles at rest.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// use mlswarp::warp::Align;
    /// let p = [[10.0, 10.0], [50.0, 10.0], [30.0, 40.0]];
    /// let shifted = p.map(|[x, y]| [x + 500.0, y]);
    /// let warper = Warper::builder(&p)
    ///     .with(|rest| rest.align = Align::Rigid)
    ///     .build([64, 48])?;
    /// // Only the shape counts: nothing moves.
    /// assert!(warper.pose(&shifted)?.mesh().is_identity());
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn with(mut self, change: impl FnOnce(&mut RestSpec)) -> Self {
        change(&mut self.rest);
        self
    }

    /// Whether a pose that folds over itself is drawn, is an error, or has its folds removed.
    ///
    /// ```
    /// use mlswarp::Warper;
    /// use mlswarp::warp::Folds;
    /// let corners = [[20.0, 20.0], [180.0, 20.0], [20.0, 180.0], [180.0, 180.0]];
    /// let p = [&corners[..], &[[50.0, 100.0]]].concat();
    /// let q = [&corners[..], &[[150.0, 100.0]]].concat();
    /// let warper = Warper::builder(&p).folds(Folds::Remove).build([200, 200])?;
    /// assert_eq!(warper.pose(&q)?.report().folds, 0);
    /// # Ok::<(), mlswarp::warp::WarpError>(())
    /// ```
    #[must_use]
    pub fn folds(mut self, folds: Folds) -> Self {
        self.folds = folds;
        self
    }

    /// The largest images, and the most memory and work.
    #[must_use]
    pub fn limits(mut self, limits: Limits) -> Self {
        self.limits = limits;
        self
    }

    /// Ends this and the work of the result when it says so.
    #[must_use]
    pub fn cancelled_by(mut self, cancel: &Cancel) -> Self {
        self.cancel = cancel.clone();
        self
    }

    /// Computes what does not depend on a pose, in parallel. CPU work.
    ///
    /// # Errors
    /// Invalid handles or parameters; more than a limit; cancelled.
    pub fn build(
        self,
        size: impl TryInto<Extent, Error = impl Into<WarpError>>,
    ) -> Result<Warper, WarpError> {
        let Self {
            rest,
            limits,
            folds,
            cancel,
        } = self;
        let extent = size.try_into().map_err(Into::into)?;
        ImageLimits {
            max_side: limits.image.max_side.min(LONGEST_SIDE_PX),
            ..limits.image
        }
        .check(extent)?;
        let is_cancelled = || cancel.is_cancelled();
        rest.check_folds(folds)?;
        let resolved = ResolvedRest::new(&rest, extent, &limits, &is_cancelled)?;
        resolved.check_folds(folds)?;
        let compiled = resolved.plan(&is_cancelled)?;
        let inner = Inner {
            extent,
            rest,
            limits,
            resolved,
            compiled,
            to_invert: OnceLock::new(),
        };
        Ok(Warper {
            inner: Arc::new(inner),
            folds,
            cancel,
        })
    }
}
