//! The mathematics: moving-least-squares deformation after Schaefer, McPhail, Warren 2006, in an
//! anchored form that computes ratios first and keeps full precision next to handles and on the
//! extension of segments; the other methods (`methods` has a file or folder for each); and what all
//! of them share: poses, subdivision, the inverse.

#[forbid(unsafe_code)]
mod carried;
#[forbid(unsafe_code)]
mod coefficient_table;
#[forbid(unsafe_code)]
mod coincidences;
#[forbid(unsafe_code)]
mod columns;
#[forbid(unsafe_code)]
mod conflicts;
#[forbid(unsafe_code)]
mod curvature;
#[forbid(unsafe_code)]
mod demand;
#[forbid(unsafe_code)]
mod error;
#[forbid(unsafe_code)]
mod fold_free;
#[forbid(unsafe_code)]
mod form;
#[forbid(unsafe_code)]
mod groups;
#[forbid(unsafe_code)]
mod handles;
#[forbid(unsafe_code)]
mod interpolated;
#[forbid(unsafe_code)]
mod interpolated_block;
#[forbid(unsafe_code)]
mod inverse;
mod kernel;
#[forbid(unsafe_code)]
mod lanes;
#[forbid(unsafe_code)]
mod leave_one_out;
#[forbid(unsafe_code)]
mod measured;
#[forbid(unsafe_code)]
mod members;
#[forbid(unsafe_code)]
mod mesh_solver;
#[forbid(unsafe_code)]
mod methods;
#[forbid(unsafe_code)]
mod moving_map;
#[forbid(unsafe_code)]
mod overall;
#[forbid(unsafe_code)]
mod parameters;
#[forbid(unsafe_code)]
mod point_map;
#[forbid(unsafe_code)]
mod posed_cells;
#[forbid(unsafe_code)]
mod posed_map;
#[forbid(unsafe_code)]
mod rest_deformation;
#[forbid(unsafe_code)]
mod rest_mesh;
#[forbid(unsafe_code)]
mod samples;
#[forbid(unsafe_code)]
mod subdivide;
#[forbid(unsafe_code)]
mod subdivision_cache;
#[forbid(unsafe_code)]
mod tiles;
#[forbid(unsafe_code)]
mod workspace;

pub use coefficient_table::{CoefficientTable, IsCancelled, PoseQuality};
pub use conflicts::{Conflict, ConflictingHandles};
pub use demand::Demand;
pub use error::{DeformError, MeshQuantity, NotTaken, Warning};
pub use fold_free::{FoldFree, FoldFreeError, ProductFactor, ProductWork};
pub use form::CoefficientForm;
pub use groups::{Coincident, CoincidentPolicy};
pub use handles::{Handle, Handles, MAX_COORDINATE, Pose};
pub use inverse::Inverse;
pub use members::ColumnMember;
#[doc(hidden)]
pub use methods::arap::factorisation;
pub use methods::mls::falloff::Falloff;
pub use methods::{
    AcceptedHandles, Interpolation, METHODS, Method, MethodInfo, MethodSystem, unfoldable,
};
pub use overall::{Class, Fitted, PlaneMap, fitted};
pub use parameters::{Parameter, Parameters};
pub use point_map::{Identity, MeshMethod};
pub use posed_map::{PosedMap, pose_without_table};
pub use rest_deformation::RestDeformation;
pub use subdivide::{SubdividedMesh, Subdivider};
pub use subdivision_cache::SubdivisionCache;
