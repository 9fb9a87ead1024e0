//! The methods: one file or folder for each, and one row in [`METHODS`]. A row says what everybody
//! else must know of a method; no other code asks which one it is. CONTRIBUTING.md says how to add
//! one.

pub(super) mod arap;
pub(super) mod beier_neely;
pub(super) mod global_affine;
pub(super) mod mls;
pub(super) mod thin_plate_spline;

use super::form::CoefficientForm;
use super::point_map::{MakeMap, MeshMethod};
use super::{DeformError, Handle, Handles, NotTaken, Parameter, Parameters};

/// How the image follows the handles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Method {
    /// Moving least squares: rotations, eq. (8).
    #[default]
    Rigid,
    /// Moving least squares: rotations with a uniform scale, eqs. (6), (7).
    Similarity,
    /// Moving least squares: affine maps `xM + T`, eq. (5).
    Affine,
    /// The thin-plate spline; points only.
    ThinPlateSpline,
    /// One affine map, of least squares; it does not interpolate the handles.
    GlobalAffine,
    /// Field morphing by lines; lines only.
    BeierNeely,
    /// As rigid as possible, on a mesh of the image's outline.
    AsRigidAsPossible,
}

/// All methods, in the order of [`Method`].
pub static METHODS: [&MethodInfo; 7] = [
    &mls::RIGID,
    &mls::SIMILARITY,
    &mls::AFFINE,
    &thin_plate_spline::INFO,
    &global_affine::INFO,
    &beier_neely::INFO,
    &arap::INFO,
];

/// The handles that a method takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AcceptedHandles {
    /// Points and lines.
    All,
    /// Points only.
    Points,
    /// Lines only.
    Lines,
}

/// Whether f takes the handles to their targets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Always.
    Always,
    /// Only if this parameter is 0.
    IfZero(&'static str),
    /// Never, except by chance.
    Never,
}

/// A linear system that a method solves once for its handles.
#[derive(Debug)]
pub struct MethodSystem {
    /// In a sentence: "the spline of the handles".
    pub name: &'static str,
    /// Name of the limit on handles, in problems, and the limit.
    pub most_handles: (&'static str, u64),
    /// Bytes for this number of handles, which is within the limit.
    pub bytes: fn(u64) -> u64,
    /// Operations for this number of handles.
    pub operations: fn(u64) -> u64,
    /// The same for leaving out each in turn.
    pub operations_of_comparison: fn(u64) -> u64,
}

/// What is known of a method before there are handles.
#[derive(Debug)]
pub struct MethodInfo {
    /// Which one it is.
    pub method: Method,
    /// Its name in requests.
    pub name: &'static str,
    /// Its name on a button.
    pub title: &'static str,
    /// What it does, in a sentence or two for people.
    pub sentence: &'static str,
    /// The handles that it takes.
    pub handles: AcceptedHandles,
    /// Its parameters.
    pub parameters: &'static [Parameter],
    /// Whether they stand in an object of the name of the method.
    pub has_object: bool,
    /// Whether f takes the handles to their targets.
    pub interpolation: Interpolation,
    /// Whether folds can be removed where f takes the handles to their targets.
    pub can_unfold: bool,
    /// Whether a pose can mirror the image as a whole.
    pub can_mirror: bool,
    /// Whether a pose can give the image as a whole another size.
    pub can_scale: bool,
    /// What is tried where methods are compared: parameters of each candidate. A method without one
    /// is not compared.
    pub candidates: &'static [&'static [(&'static str, f64)]],
    /// Of candidates that predict equally well, those of the least number win.
    pub candidate_order: u8,
    /// Its linear system, if it has one.
    pub system: Option<MethodSystem>,
    /// Its mesh, if it is known on a mesh of what the image shows only.
    pub mesh: Option<MeshMethod>,
    /// The form of its coefficients where distances are measured inside a mask, if they can be.
    pub(super) geodesic: Option<CoefficientForm>,
    /// The values of its parameters for handles.
    pub(super) resolve: fn(&Handles, &Parameters) -> Result<Parameters, DeformError>,
    /// Its map.
    pub(super) map: MakeMap,
}

/// The methods whose folds can be removed, as a sentence lists them. `mark`: around each name.
#[must_use]
pub fn unfoldable(mark: &str) -> String {
    let marked = |name: &str| format!("{mark}{name}{mark}");
    let with = |info: &&MethodInfo| match info.interpolation {
        Interpolation::IfZero(path) => format!("{} without {}", marked(info.name), marked(path)),
        Interpolation::Always | Interpolation::Never => marked(info.name),
    };
    let methods = METHODS.iter().copied().filter(|info| info.can_unfold);
    let mut names: Vec<String> = methods.map(|info| with(&info)).collect();
    let last = names.pop().unwrap_or_default();
    format!("{}, and {last}", names.join(", "))
}

impl Method {
    /// What is known of it.
    ///
    /// ```
    /// use mlswarp::deform::{METHODS, Method};
    /// assert_eq!(Method::ThinPlateSpline.info().name, "tps");
    /// // Everything that lists methods reads one table.
    /// assert!(METHODS.iter().all(|info| std::ptr::eq(info.method.info(), *info)));
    /// ```
    #[must_use]
    pub fn info(self) -> &'static MethodInfo {
        METHODS[self as usize]
    }
}

impl MethodInfo {
    /// One of its parameters.
    #[must_use]
    pub fn parameter(&self, path: &str) -> Option<&'static Parameter> {
        self.parameters
            .iter()
            .find(|parameter| parameter.path == path)
    }

    /// Whether both have the same parameters.
    #[must_use]
    pub fn has_parameters_of(&self, other: &Self) -> bool {
        let paths = |info: &Self| {
            let all = info.parameters.iter().map(|parameter| parameter.path);
            all.collect::<Vec<_>>()
        };
        paths(self) == paths(other)
    }

    /// The effective values of its parameters.
    ///
    /// # Errors
    /// A value out of range.
    pub fn resolve(
        &self,
        handles: &Handles,
        given: &Parameters,
    ) -> Result<Parameters, DeformError> {
        (self.resolve)(handles, given)
    }

    /// Whether f takes the handles to their targets with these parameters.
    #[must_use]
    pub fn interpolates(&self, parameters: &Parameters) -> bool {
        match self.interpolation {
            Interpolation::Always => true,
            Interpolation::IfZero(path) => parameters.get(path).is_none_or(|value| value == 0.0),
            Interpolation::Never => false,
        }
    }

    /// Errors: The first handle of a kind that it does not take.
    pub(super) fn check(&self, handles: &Handles) -> Result<(), DeformError> {
        let is_wrong = |handle: &Handle| match handle {
            Handle::Point(_) => self.handles == AcceptedHandles::Lines,
            Handle::Polyline(_) => self.handles == AcceptedHandles::Points,
            Handle::Missing => false,
        };
        match handles.handles().iter().position(is_wrong) {
            Some(handle) => Err(DeformError::NotTaken {
                handle,
                method: self.name,
                reason: match self.handles {
                    AcceptedHandles::Lines => NotTaken::Point,
                    AcceptedHandles::All | AcceptedHandles::Points => NotTaken::Line,
                },
            }),
            None => Ok(()),
        }
    }
}
