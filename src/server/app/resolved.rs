//! A warp object that was settled on an image of one size.

use std::sync::Arc;

use mlswarp::deform::Handle;
use mlswarp::pixmap::Extent;
use mlswarp::warp::{Alignment, ResolvedRest, RestSpec};

use super::App;
use super::drawable::DrawnContent;
use super::fit::choose_method;
use super::parts::plans::HeldSetup;
use super::reading::{Held, part};
use crate::cache::CacheEntry;
use crate::pool::{Cancel, Ticket};
use crate::problem::Problem;
use crate::store::NamedFile;
use crate::wire::{Pose, WarpObject, method_text};

/// A resolved warp object without its posed handles, and those; none of them if there were none.
#[derive(Debug)]
pub(crate) struct Resolved {
    pub(crate) object: Held<WarpObject>,
    /// The pose as it was sent, if there are handles, in the memory of the object.
    pub(crate) pose: Option<Pose>,
    pub(crate) q: Arc<Held<Vec<Handle>>>,
    /// How q was aligned, if that was requested.
    pub(crate) alignment: Option<Alignment>,
    pub(crate) setup: HeldSetup,
    /// The files of an upload: the image's, and the mask's of a region.
    pub(crate) files: Vec<NamedFile>,
}

impl Resolved {
    /// The method that was chosen, if that was requested, as a header shows it.
    pub(crate) fn chosen_method(&self) -> Option<String> {
        self.object.is_auto.then(|| method_text(&self.object.rest))
    }
}

/// Resolves a warp object on the pool: see [`resolve`].
pub(crate) async fn resolve_on(
    app: &App,
    ticket: &Ticket,
    object: Held<WarpObject>,
    extent: Extent,
) -> Result<Resolved, Problem> {
    let app = app.clone();
    ticket
        .run(move |cancel| resolve(&app, object, extent, None, cancel))
        .await?
}

/// Settles the pose, chooses the method if that was requested, resolves the handles on an image of
/// this extent, and checks `q` if it was sent. `content`: the image, if there is one. Runs on the
/// pool. Errors: Wrong handles, or too little memory.
pub(crate) fn resolve(
    app: &App,
    object: Held<WarpObject>,
    extent: Extent,
    content: Option<&DrawnContent>,
    cancel: &Cancel,
) -> Result<Resolved, Problem> {
    let new_setup = |rest: &RestSpec| app.plans.new_setup(rest, extent, content, cancel);
    resolve_by(app, object, extent, new_setup, cancel)
}

/// Like [`resolve`], with a setup that `setup_of` makes.
pub(crate) fn resolve_by(
    app: &App,
    mut object: Held<WarpObject>,
    extent: Extent,
    setup_of: impl FnOnce(&RestSpec) -> Result<CacheEntry<ResolvedRest>, Problem>,
    cancel: &Cancel,
) -> Result<Resolved, Problem> {
    object.output.check(extent, &app.plans.limits)?;
    object.leave_out_missing();
    let q = object.q.clone().filter(|_| !object.rest.p.is_empty());
    let pose = q.map(|q| Pose {
        q,
        strength: object.strength,
    });
    let alignment = object.settle_pose(extent)?;
    choose_method(app, &mut object, extent, cancel)?;
    object.rest.check_folds(object.folds)?;
    let setup = setup_of(&object.rest)?;
    setup.check_folds(object.folds)?;
    object.q.as_deref().map(|q| setup.pose(q)).transpose()?;
    let q = part(&mut object, |object| object.q.take().unwrap_or_default());
    Ok(Resolved {
        object,
        pose,
        q: Arc::new(q),
        alignment,
        setup: Arc::new(setup),
        files: Vec::new(),
    })
}
