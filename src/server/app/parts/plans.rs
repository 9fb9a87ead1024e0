//! Handles that were resolved on an image, and the coefficients of its grid: built on the pool, and
//! cached.

use std::sync::Arc;
use std::time::Instant;

use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    CompiledRest, Digest, Limits, OrderOfCells, ResolvedRest, RestMask, RestSpec, WarpError,
};

use super::admission::Admission;
use super::images::Images;
use crate::app::MIN_WEIGHT;
use crate::app::drawable::DrawnContent;
use crate::cache::{Cache, CacheEntry, CacheKey, Fetched};
use crate::client::{Client, Owner};
use crate::limits::memory::{MemoryClass, Reservation};
use crate::observe::scope::stage;
use crate::observe::stages::Timing;
use crate::pool::{Cancel, QueueKey, Ticket};
use crate::problem::Problem;
use crate::store::Record;

/// A setup and its memory, as it is cached.
pub(crate) type HeldSetup = Arc<CacheEntry<ResolvedRest>>;

/// A plan, and its cost so far.
#[derive(Debug)]
pub(crate) struct Planned {
    pub(crate) setup: HeldSetup,
    pub(crate) plan: Arc<CacheEntry<CompiledRest>>,
    pub(crate) timing: Timing,
    /// Whether the plan was built for this request.
    pub(crate) is_built: bool,
}

/// Setups and plans.
#[derive(Debug)]
pub(crate) struct Plans {
    pub(crate) admission: Arc<Admission>,
    /// For masks.
    pub(crate) images: Arc<Images>,
    pub(crate) limits: Limits,
    pub(crate) compiled: Cache<CompiledRest>,
    /// Setups keep what is built here.
    pub(crate) orders: Cache<OrderOfCells>,
    pub(crate) setups: Cache<ResolvedRest>,
}

impl Plans {
    /// Resolves rest handles in memory that is reserved before. `content`: the image that they lie
    /// on, for those that need its mask. Runs on the pool. Errors: Wrong handles, or too little
    /// memory.
    pub(crate) fn new_setup(
        &self,
        rest: &RestSpec,
        extent: Extent,
        content: Option<&DrawnContent>,
        cancel: &Cancel,
    ) -> Result<CacheEntry<ResolvedRest>, Problem> {
        let is_cancelled = || cancel.is_cancelled();
        let mut held = self.reserve_unsolved(rest)?;
        let of_handles = held.bytes();
        let with_mask = match content.and_then(DrawnContent::shape) {
            Some((image, region)) if rest.needs_mask() => {
                let threshold = rest.mask_threshold.unwrap_or(RestMask::THRESHOLD);
                let bytes = RestMask::bytes_for(image, region, threshold, &is_cancelled);
                let bytes = bytes.ok_or(WarpError::Cancelled)?;
                self.admission.reserve_more(&mut held, bytes)?;
                let mut rest = rest.clone();
                rest.make_mask(image, region, &is_cancelled)?;
                Some(rest)
            }
            _ => None,
        };
        let rest = with_mask.as_ref().unwrap_or(rest);
        let bytes = rest.field_bytes(&self.limits, &is_cancelled)?;
        self.admission.reserve_more(&mut held, bytes.peak)?;
        let new = || ResolvedRest::new(rest, extent, &self.limits, &is_cancelled);
        let setup = if with_mask.is_some() {
            // Distances inside the mask are computed for many handles at once.
            self.admission.pool.run_parallel(new)?
        } else {
            new()?
        };
        held.shrink_to(of_handles + bytes.kept);
        self.admission
            .reserve_more(&mut held, setup.order_bytes())?;
        Ok(CacheEntry::new(setup, held))
    }

    /// Reserves the memory in which rest handles are resolved without the system of a spline.
    pub(crate) fn reserve_unsolved(&self, rest: &RestSpec) -> Result<Reservation, Problem> {
        // A few copies of each column's position and weight.
        let bytes = 1024 + 256 * columns_of(rest);
        self.admission.reserve(MemoryClass::Plan, bytes)
    }

    /// The setup of rest handles that differ from those of a record in their depths alone, if that
    /// of the record is cached; `None` if it is not, or they differ otherwise.
    pub(crate) fn with_depth(
        &self,
        rest: &RestSpec,
        before: &Record,
    ) -> Result<Option<CacheEntry<ResolvedRest>>, Problem> {
        let depth = before.rest.depth.clone();
        let otherwise = RestSpec {
            depth,
            ..rest.clone()
        };
        if *before.rest != otherwise {
            return Ok(None);
        }
        let Some(setup) = self.setups.peek(revision_key(before)) else {
            return Ok(None);
        };
        // It shares most of its memory with the other one, and may outlive it. If both do not fit,
        // the other one must be free to go.
        let shared = setup.bytes().saturating_sub(setup.order_bytes());
        let Ok(mut held) = self.admission.reserve(MemoryClass::Plan, shared) else {
            return Ok(None);
        };
        let with = setup.with_depth(rest)?;
        let has_room = self.admission.reserve_more(&mut held, with.order_bytes());
        Ok(has_room.is_ok().then(|| CacheEntry::new(with, held)))
    }

    /// The resolved setup of a session.
    /// Errors: Too little capacity; the files of the mask are gone.
    pub(crate) async fn setup_of(
        self: &Arc<Self>,
        client: Client,
        record: &Arc<Record>,
    ) -> Result<HeldSetup, Problem> {
        let (plans, of_session) = (Arc::clone(self), Arc::clone(record));
        let build = async move {
            let content = plans.content_of(client, &of_session).await?;
            let key = QueueKey::session(client, of_session.id);
            let ticket = plans.admission.upload(key).await?;
            let new = move |cancel: &Cancel| {
                let Record { rest, extent, .. } = &*of_session;
                plans.new_setup(rest, *extent, content.as_ref(), cancel)
            };
            ticket.run(new).await?
        };
        let key = revision_key(record);
        let setup = self.setups.get(key, client.payer(), build);
        Ok(setup.await?.value)
    }

    /// The image and the region of a session, if its handles need their mask.
    /// Errors: Too little capacity; the files are gone.
    pub(crate) async fn content_of(
        &self,
        client: Client,
        record: &Record,
    ) -> Result<Option<DrawnContent>, Problem> {
        if record.rest.needs_mask() {
            self.images.content(client, record).await.map(Some)
        } else {
            Ok(None)
        }
    }

    /// The setup whose grid shows where to look for the inverse.
    pub(crate) async fn to_invert(
        self: &Arc<Self>,
        ticket: &Ticket,
        setup: &HeldSetup,
    ) -> Result<HeldSetup, Problem> {
        let (plans, setup) = (Arc::clone(self), Arc::clone(setup));
        let resolve = move |_: &_| {
            // It shares most of its memory with the other one, and may outlive it.
            let held = plans.admission.reserve(MemoryClass::Plan, setup.bytes())?;
            let inverted = setup.to_invert(&plans.limits)?;
            Ok(Arc::new(CacheEntry::new(inverted, held)))
        };
        ticket.run(resolve).await?
    }

    /// The plan of a setup, from the cache or built now; adds its cost to `timing`.
    pub(crate) async fn plan(
        &self,
        client: Client,
        ticket: &Ticket,
        setup: &HeldSetup,
        mut timing: Timing,
    ) -> Result<Planned, Problem> {
        let began = Instant::now();
        let (admission, build_setup) = (Arc::clone(&self.admission), Arc::clone(setup));
        let (ticket, of_order) = (ticket.clone(), ticket.clone());
        let build = async move {
            let bytes = build_setup.plan_bytes().unwrap_or_default().max(MIN_WEIGHT);
            let reservation = admission
                .reserve_aside(|budget| budget.take(MemoryClass::Plan, bytes))
                .await?;
            let threads = admission.pool.clone();
            let fill = move |cancel: &Cancel| {
                threads.run_parallel(|| build_setup.plan(&|| cancel.is_cancelled()))
            };
            let plan = ticket.run(fill).await??;
            tracing::debug!("a plan was built");
            Ok(CacheEntry::new(plan, reservation))
        };
        let key = CacheKey::new(client.owner, setup.plan_key());
        let Fetched { value: plan, built } = self.compiled.get(key, client.payer(), build).await?;
        self.order(client, of_order, setup, &plan).await?;
        timing.plan = began.elapsed();
        stage("plan", began);
        Ok(Planned {
            setup: Arc::clone(setup),
            plan,
            timing,
            is_built: built,
        })
    }

    /// Computes the order in which the cells of a setup are drawn, once for all requests that need
    /// it at the same time.
    async fn order(
        &self,
        client: Client,
        ticket: Ticket,
        setup: &HeldSetup,
        plan: &Arc<CacheEntry<CompiledRest>>,
    ) -> Result<(), Problem> {
        let Some(key) = setup.lacks_order() else {
            return Ok(());
        };
        let (admission, of_setup, plan) = (
            Arc::clone(&self.admission),
            Arc::clone(setup),
            Arc::clone(plan),
        );
        let build = async move {
            let bytes = of_setup.order_peak_bytes();
            let reservation = admission
                .reserve_aside(|budget| budget.take(MemoryClass::Plan, bytes))
                .await?;
            let threads = admission.pool.clone();
            let order = move |cancel: &Cancel| {
                let is_cancelled = || cancel.is_cancelled();
                threads.run_parallel(|| of_setup.order(&plan, &is_cancelled))
            };
            Ok(CacheEntry::new(ticket.run(order).await??, reservation))
        };
        let key = CacheKey::new(client.owner, key);
        let order = self.orders.get(key, client.payer(), build).await?.value;
        setup.keep_order(&order);
        Ok(())
    }

    /// Whether the plan of a setup is cached, and counts as used.
    pub(crate) fn touch(&self, owner: Owner, setup: &ResolvedRest) -> bool {
        self.compiled.touch(CacheKey::new(owner, setup.plan_key()))
    }

    /// Makes the plan of a setup the first that gives way.
    pub(crate) fn demote(&self, owner: Owner, setup: &ResolvedRest) {
        self.compiled.demote(CacheKey::new(owner, setup.plan_key()));
    }

    /// Keeps the setup of a record for the next drag.
    pub(crate) fn keep_setup(&self, client: Client, record: &Record, setup: &HeldSetup) {
        self.setups.put(revision_key(record), client.payer(), setup);
    }

    /// Evicts the setup of a revision that no session has any more, and returns it.
    pub(crate) fn forget_setup(&self, record: &Record) -> Option<HeldSetup> {
        self.setups.remove(revision_key(record))
    }

    /// Evicts the plan of a setup.
    pub(crate) fn forget_plan(&self, owner: Owner, setup: &ResolvedRest) {
        self.compiled
            .drop_value(CacheKey::new(owner, setup.plan_key()));
    }
}

/// The cache key of what belongs to one revision of a session: its setup. Records never change.
pub(crate) fn revision_key(record: &Record) -> CacheKey {
    CacheKey::new(
        record.id.owner(),
        Digest::of(&[&record.id.to_bytes()[..], record.revision.as_bytes()].concat()),
    )
}

/// The number of columns of a session's plan, which limits the size of its drags.
pub(crate) fn columns(record: &Record) -> u64 {
    columns_of(&record.rest)
}

fn columns_of(rest: &RestSpec) -> u64 {
    rest.p.iter().map(|h| h.columns() as u64).sum()
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use mlswarp::deform::Handle;
    use mlswarp::geometry::Point;

    use super::*;
    use crate::app::App;
    use crate::cache::AnyCache as _;
    use crate::config::Config;
    use crate::session::{Revision, SessionId};
    use crate::wire::WarpObject;

    fn rest(depth: f64) -> RestSpec {
        let place = |k: i32| Point::new(f64::from(k) * 90.0 + 20.0, f64::from(k * k) * 50.0 + 20.0);
        RestSpec {
            p: (0..3).map(|k| Handle::Point(place(k))).collect(),
            depth: Some(vec![0.0, 0.0, depth]),
            ..RestSpec::default()
        }
    }

    fn extent() -> Extent {
        Extent::new(300, 300).unwrap()
    }

    async fn setup(app: &App, ticket: &Ticket) -> HeldSetup {
        let plans = Arc::clone(&app.plans);
        let new = move |cancel: &Cancel| plans.new_setup(&rest(1.0), extent(), None, cancel);
        Arc::new(ticket.run(new).await.unwrap().unwrap())
    }

    #[tokio::test]
    async fn an_order_of_drawing_is_computed_once_for_all_that_need_it_at_the_same_time() {
        let (app, client) = (App::new(Config::default()).unwrap(), Client::default());
        let ticket = app.admission.upload(QueueKey::client(client)).await;
        let ticket = ticket.unwrap();
        let setups = [setup(&app, &ticket).await, setup(&app, &ticket).await];
        assert!(setups.iter().all(|setup| setup.lacks_order().is_some()));
        let planned = setups
            .each_ref()
            .map(|setup| app.plans.plan(client, &ticket, setup, Timing::default()));
        let [one, other] = planned;
        let (one, other) = tokio::join!(one, other);
        assert!(one.unwrap().is_built && !other.unwrap().is_built);
        assert!(setups.iter().all(|setup| setup.lacks_order().is_none()));
        assert_eq!(app.plans.orders.usage().built, 1);
        // Nothing of it is left but what the setups hold.
        assert_eq!(app.plans.orders.usage().bytes, 0);
        let taken = app.budget().taken();
        app.plans
            .plan(client, &ticket, &setups[0], Timing::default())
            .await
            .unwrap();
        assert_eq!(
            (app.plans.orders.usage().built, app.budget().taken()),
            (1, taken)
        );
    }

    #[tokio::test]
    async fn an_old_setup_is_not_held_while_there_is_no_memory_for_another_one() {
        let (app, client) = (App::new(Config::default()).unwrap(), Client::default());
        let ticket = app.admission.upload(QueueKey::client(client)).await;
        let setup = setup(&app, &ticket.unwrap()).await;
        let base = WarpObject::default();
        let record = Record {
            id: SessionId::random(client.owner),
            revision: Revision::random(),
            image: Digest::of(b"an image"),
            layers: std::collections::BTreeMap::new(),
            made_with_region: None,
            extent: extent(),
            rest: rest(1.0).into(),
            pose: None,
            folds: base.folds,
            output: base.output,
            created: SystemTime::now(),
        };
        app.plans.keep_setup(client, &record, &setup);
        let (bytes, of_order) = (setup.bytes(), setup.order_bytes());
        drop(setup);
        let with = |depth: f64| app.plans.with_depth(&rest(depth), &record).unwrap();
        // The order of the old one is not that of the new one, which has none without depths.
        assert_eq!(with(2.0).unwrap().bytes(), bytes);
        assert_eq!(with(0.0).unwrap().bytes(), bytes - of_order);
        // Handles that differ otherwise hold nothing.
        let mut other = rest(2.0);
        other.p.pop();
        assert!(app.plans.with_depth(&other, &record).unwrap().is_none());
        // The old setup goes, so that there is room for one that is computed again.
        let mut taken = app.budget().take(MemoryClass::Plan, 0).unwrap();
        while taken.grow(256).is_ok() {}
        assert!(with(3.0).is_none());
        // There is room for what both share, but not for the order.
        taken.shrink_to(taken.bytes() - (bytes - of_order));
        assert!(of_order > 256 && with(0.0).is_some() && with(3.0).is_none());
        assert!(app.plans.setups.is_any_idle());
        assert!(app.admission.evict_idle() && !app.plans.setups.is_any_idle());
    }
}
