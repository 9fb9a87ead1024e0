//! Drawing: poses grids in reserved memory, and makes files of them.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use mlswarp::deform::{IsCancelled, Pose};
use mlswarp::warp::{
    CompiledRest, Folds, Limits, PosedMesh, RenderJob, ResolvedRest, StripScheduler, WarpError,
};
use tokio::sync::{mpsc, oneshot};

use super::admission::Admission;
use crate::app::draw::{DrawJob, Drawn, Meter, Observer, Piece};
use crate::app::drawable::DrawnContent;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::observe::metrics::Metrics;
use crate::observe::scope::stage;
use crate::pool::{Cancel, PoolError, Ticket};
use crate::problem::Problem;

/// Images of at most this many bytes are drawn as a whole: the head of the response then has their
/// length and cost.
const MAX_WHOLE: u64 = 256 << 10;

/// Draws images.
#[derive(Debug)]
pub(crate) struct Drawing {
    pub(crate) admission: Arc<Admission>,
    pub(crate) limits: Limits,
    pub(crate) metrics: Arc<Metrics>,
}

type StripSink = Box<dyn FnMut(Vec<u8>, bool) -> ControlFlow<()> + Send>;
/// Who waits for an image.
type DrawnSender = oneshot::Sender<Result<Drawn, Problem>>;

impl Drawing {
    /// Poses and draws; returns when the first piece of the image has been drawn.
    /// Errors: Wrong `q`, rejected folds, too little memory, or a computation that failed.
    pub(crate) async fn draw(
        self: &Arc<Self>,
        ticket: Ticket,
        job: DrawJob,
    ) -> Result<Drawn, Problem> {
        let (answer, result) = oneshot::channel();
        let (drawing, of_job) = (Arc::clone(self), ticket.clone());
        ticket.start(move || drawing.draw_for(answer, &of_job, &job));
        // The task always answers, unless it panics.
        result.await.map_err(|_| PoolError::Panicked)?
    }

    fn draw_for(&self, answer: DrawnSender, ticket: &Ticket, job: &DrawJob) {
        let is_gone = || answer.is_closed();
        let is_over = || ticket.is_over(&is_gone);
        let (warp, drawn, reservation) = match self.prepare(job, &is_over, &is_gone) {
            Ok(prepared) => prepared,
            Err(problem) => {
                let _ = answer.send(Err(problem));
                return;
            }
        };
        self.metrics.prepared(&drawn.timing);
        if warp.is_one_piece() || warp.max_bytes() <= MAX_WHOLE {
            let written = self.write_whole(&warp, reservation, &is_over);
            let _ = answer.send(written.map(|first| Drawn { first, ..drawn }));
        } else {
            let content = job.content.clone();
            self.draw_strips((answer, drawn), ticket, warp, reservation, content);
        }
    }

    /// Poses and draws a whole file on this compute thread alone.
    /// Errors: As of [`Drawing::draw`]; cancelled.
    pub(crate) fn draw_file(&self, job: &DrawJob, cancel: &Cancel) -> Result<Drawn, Problem> {
        let is_cancelled = || cancel.is_cancelled();
        let (warp, drawn, reservation) = self.prepare(job, &is_cancelled, &|| cancel.is_gone())?;
        self.metrics.prepared(&drawn.timing);
        let first = self.write_whole(&warp, reservation, &is_cancelled)?;
        Ok(Drawn { first, ..drawn })
    }

    /// Poses in reserved memory; returns the reservation of the posed grid. The most bytes of
    /// halved cells, or of removing folds, are reserved until the pose is known, and are not in the
    /// client's quota: a client that reads slowly cannot hold them.
    pub(crate) fn reserve_and_pose<T: Send>(
        &self,
        setup: &ResolvedRest,
        quota: &ClientQuota,
        (folds, is_coarse): (Folds, bool),
        pose: impl FnOnce() -> Result<T, WarpError> + Send,
    ) -> Result<(T, Reservation), Problem> {
        let reservation =
            self.admission
                .reserve_for(MemoryClass::Frame, quota, setup.posed_bytes())?;
        let most_extra = setup.most_extra_bytes(folds, is_coarse);
        let extra = (most_extra > 0)
            .then(|| self.admission.reserve(MemoryClass::Frame, most_extra))
            .transpose()?;
        let posed = if setup.uses_thread_pool() || folds == Folds::Remove {
            self.admission.pool.run_parallel(pose)
        } else {
            pose()
        };
        // Most of it was not needed.
        if let Some(extra) = extra {
            extra.release_unused();
        }
        Ok((posed?, reservation))
    }

    /// As [`Drawing::reserve_and_pose`], to map many positions where folds are removed.
    pub(crate) fn pose_to_map(
        &self,
        (setup, plan): (&ResolvedRest, &CompiledRest),
        quota: &ClientQuota,
        (folds, is_coarse): (Folds, bool),
        pose: &Pose,
        is_cancelled: IsCancelled<'_>,
    ) -> Result<(PosedMesh, Reservation), Problem> {
        let pose_as = if is_coarse {
            PosedMesh::coarse
        } else {
            PosedMesh::new
        };
        let posed = || pose_as(setup, plan, pose, folds, is_cancelled);
        let (posed, mut held) = self.reserve_and_pose(setup, quota, (folds, is_coarse), posed)?;
        if posed.is_unfolded() {
            let bytes = posed.extra_bytes() + posed.factor_bytes();
            self.admission.reserve_more(&mut held, bytes)?;
            posed.keep_factors(is_cancelled)?;
        }
        Ok((posed, held))
    }

    /// Poses, and reserves the memory that drawing needs: what is to be drawn, and all of the
    /// answer but its pieces. `is_gone`: whether the result is no longer needed, without giving way
    /// to other jobs, which may wait for the copies that this one makes.
    pub(crate) fn prepare(
        &self,
        job: &DrawJob,
        is_cancelled: IsCancelled<'_>,
        is_gone: IsCancelled<'_>,
    ) -> Result<(RenderJob, Drawn, Reservation), Problem> {
        let (began, mut timing) = (Instant::now(), job.planned.timing);
        let setup = &job.planned.setup;
        let kind = (job.folds, job.preview.is_some());
        let pose = || job.pose(&self.limits, is_cancelled);
        let ((posed, target), mut reservation) =
            self.reserve_and_pose(setup, &job.quota, kind, pose)?;
        let source = job.content.raster_source();
        let bytes =
            posed.extra_bytes() + target.window_bytes(&posed) + source.prepared_bytes(&posed);
        self.admission.reserve_more(&mut reservation, bytes)?;
        if source.lacks_copies(target, &posed, &job.output) {
            let began = Instant::now();
            source.make_copies(target, &posed, &job.output, is_gone)?;
            timing.reduce = began.elapsed();
            stage("reduce", began);
        }
        let warp = RenderJob::onto(target, source, &posed, &job.output);
        let report = posed.into_report_on(source, (&target, &job.output), is_cancelled)?;
        self.admission
            .reserve_more(&mut reservation, warp.work_bytes())?;
        timing.deform = began.elapsed().saturating_sub(timing.reduce);
        stage("deform", began);
        let drawn = Drawn {
            report,
            etag: warp.etag(),
            target: warp.target(),
            format: warp.format(),
            timing,
            plan_built: job.planned.is_built,
            first: Piece::default(),
            rest: None,
        };
        Ok((warp, drawn, reservation))
    }

    /// Draws a whole file on this thread.
    fn write_whole(
        &self,
        warp: &RenderJob,
        mut reservation: Reservation,
        is_cancelled: IsCancelled<'_>,
    ) -> Result<Piece, Problem> {
        let (meter, mut pieces) = (Meter::new(&self.metrics), Vec::new());
        let observer = Observer {
            meter: &meter,
            is_cancelled,
            helps: None,
        };
        let flow = warp.write(0, &observer, &mut |bytes| {
            pieces.push(bytes);
            if is_cancelled() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        if flow.is_break() {
            return Err(WarpError::Cancelled.into());
        }
        meter.finish();
        let length = pieces.iter().map(Vec::len).sum::<usize>() as u64;
        let file = if pieces.len() == 1 {
            pieces.swap_remove(0)
        } else {
            self.admission.reserve_more(&mut reservation, length)?;
            pieces.concat()
        };
        reservation.shrink_to(length);
        Ok(Piece {
            bytes: reservation.attach(file),
            end: Some(meter.cost()),
        })
    }

    /// Draws strips on this thread and on helpers.
    fn draw_strips(
        &self,
        (answer, drawn): (DrawnSender, Drawn),
        ticket: &Ticket,
        warp: RenderJob,
        mut reservation: Reservation,
        content: DrawnContent,
    ) {
        let (pieces, rest) = mpsc::unbounded_channel();
        let rest = Some(rest);
        let (meter, mut head) = (
            Arc::new(Meter::new(&self.metrics)),
            Some((answer, Drawn { rest, ..drawn })),
        );
        let sink: StripSink = Box::new({
            let (meter, pieces) = (Arc::clone(&meter), pieces.clone());
            move |bytes, is_last| {
                if is_last && !pieces.is_closed() {
                    meter.finish();
                }
                let piece = Piece {
                    bytes: reservation.split(bytes.len() as u64).attach(bytes),
                    // With the last strip, so that its end is sent with it; all strips are drawn by
                    // then.
                    end: is_last.then(|| meter.cost()),
                };
                // The head of the response is sent with the first strip: one wake-up instead of
                // two.
                let is_sent = match head.take() {
                    Some((answer, drawn)) => {
                        let first = piece;
                        answer.send(Ok(Drawn { first, ..drawn })).is_ok()
                    }
                    None => pieces.send(piece).is_ok(),
                };
                if is_sent {
                    ControlFlow::Continue(())
                } else {
                    ControlFlow::Break(())
                }
            }
        });
        let strips = StripScheduler::new(Box::new(warp), sink);
        let helpers = self.admission.pool.helpers().min(strips.strips() - 1);
        // The memory of the content stays reserved while strips are drawn from it.
        let strips = Arc::new((strips, content));
        let draw = {
            let ticket = ticket.clone();
            move |helps: bool| {
                let is_closed = || pieces.is_closed();
                let is_over = || ticket.is_over(&is_closed);
                strips.0.work(&Observer {
                    meter: &meter,
                    is_cancelled: if helps { &is_closed } else { &is_over },
                    helps: helps.then_some(&ticket),
                });
            }
        };
        let help = draw.clone();
        ticket.offer(helpers, move || help(true));
        draw(false);
    }
}
