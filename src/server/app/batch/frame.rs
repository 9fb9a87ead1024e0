//! One frame of a batch, on one compute thread: its pose, its image and its annotations.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use mlswarp::deform::Handle;
use mlswarp::render::{Canvas, Outside};
use mlswarp::warp::{
    CanvasSpec, CompiledRest, CoordinateFrame as PictureFrame, Folds, Holes, OutputSpec, Warning,
};
use serde_json::json;

use super::package::{BatchForm, PackedFrame};
use super::poses::{FramePose, Rest};
use crate::app::App;
use crate::app::draw::{DrawJob, Drawn};
use crate::app::drawable::DrawnContent;
use crate::app::json_text::cancellable_json;
use crate::app::parts::plans::Planned;
use crate::app::reading::Held;
use crate::cache::CacheEntry;
use crate::client::Client;
use crate::layer::LayerRef;
use crate::limits::client_quota::ClientQuota;
use crate::limits::memory::{MemoryClass, Reservation};
use crate::observe::stages::Timing;
use crate::pool::Cancel;
use crate::problem::Problem;
use crate::store::Record;
use crate::wire::{AsJson, BatchFrame, BatchObject, BatchPoses, Cursor, in_frame};

/// Time after which a survey gives its worker back, so that other clients do not wait for all of
/// its frames.
const MAX_SURVEY_TIME: Duration = Duration::from_millis(20);
/// Text of an ordinary handle, bytes; longer ones are reserved when they are sent.
const HANDLE_TEXT: u64 = 64;

/// Everything that the frames of a batch have in common.
#[derive(Debug)]
pub(crate) struct BatchJob {
    pub(crate) app: App,
    pub(crate) client: Client,
    pub(crate) quota: ClientQuota,
    pub(crate) record: Arc<Record>,
    pub(crate) content: DrawnContent,
    /// The layers that are drawn, by name.
    pub(crate) layers: Vec<(LayerRef, DrawnContent)>,
    pub(crate) plan: Arc<CacheEntry<CompiledRest>>,
    pub(crate) rest: Rest,
    /// The poses and the annotations.
    pub(crate) object: Held<BatchObject>,
    /// The number of frames: those of the poses, and then the same in the reverse order as far as
    /// they are repeated.
    pub(crate) frames: u32,
    pub(crate) output: OutputSpec,
    pub(crate) form: BatchForm,
    /// See [`mlswarp::warp::Target::force_alpha`].
    pub(crate) force_alpha: bool,
}

/// What the frames that have been posed have in common.
#[derive(Debug)]
pub(crate) struct Survey {
    /// The number of frames that have been posed.
    posed: u32,
    may_be_refused: bool,
    needs_alpha: bool,
    /// Shows what each of them shows.
    canvas: Option<Canvas>,
    has_one_canvas: bool,
}

/// A frame that is ready to be appended, and its memory.
pub(crate) struct FinishedFrame {
    pub(crate) packed: PackedFrame,
    pub(crate) entry: BatchFrame,
    /// Those of its warnings that are about the file, and so about all frames.
    pub(crate) of_file: Vec<Warning>,
    pub(crate) held: Reservation,
}

impl BatchJob {
    /// The pose of a frame, by its number among the poses.
    fn pose_number(&self, frame: u32) -> u32 {
        let last = self.object.poses.count() - 1;
        if frame <= last {
            frame
        } else {
            2 * last - frame
        }
    }

    /// Files of each frame in an archive.
    pub(crate) fn files_per_frame(&self) -> u32 {
        1 + u32::try_from(self.layers.len()).unwrap_or(u32::MAX) + u32::from(self.has_annotations())
    }

    fn has_annotations(&self) -> bool {
        !self.object.annotations.kinds.is_empty()
            || matches!(self.object.poses, BatchPoses::Jitter { .. })
    }

    /// The job of drawing the image or a layer.
    fn draw_job(
        &self,
        content: &DrawnContent,
        q: Arc<Held<Vec<Handle>>>,
        timing: Timing,
    ) -> DrawJob {
        let planned = Planned {
            setup: Arc::clone(&self.rest.setup),
            plan: Arc::clone(&self.plan),
            timing,
            is_built: false,
        };
        let (quota, folds) = (self.quota.clone(), self.record.folds);
        let output = content.output_beside(self.output);
        DrawJob {
            content: content.clone(),
            planned,
            q,
            folds,
            output,
            preview: None,
            force_alpha: self.force_alpha,
            quota,
        }
    }

    /// Memory of a frame besides its images.
    fn reserve(&self, bytes: u64) -> Result<Reservation, Problem> {
        self.app
            .admission
            .reserve_for(MemoryClass::Frame, &self.quota, bytes)
    }

    fn pose_of(&self, pose: u32) -> Result<FramePose, Problem> {
        self.rest
            .pose_of(&self.object.poses, pose, &|bytes| self.reserve(bytes))
    }

    /// Adds the number of a frame to a problem, also to its pointer if the frame has a pose of its
    /// own.
    fn located(&self, frame: u32, mut problem: Problem) -> Problem {
        problem.detail.insert_str(0, &format!("frame {frame}: "));
        let is_pose = problem
            .pointer
            .as_deref()
            .is_some_and(|pointer| pointer.starts_with("/q"));
        if is_pose && matches!(self.object.poses, BatchPoses::Frames(_)) {
            in_frame(frame, problem)
        } else {
            problem
        }
    }

    /// Checks all poses, and whether frames must be posed to find out what all images have in
    /// common. Errors: Those of a frame, or of the output.
    pub(crate) fn check(&self, cancel: &Cancel) -> Result<Survey, Problem> {
        self.rest
            .check(&self.object.poses, &|bytes| self.reserve(bytes), &|| {
                cancel.is_cancelled()
            })?;
        self.output.check(
            self.content.raster_source().extent(),
            &self.app.plans.limits,
        )?;
        let is_fit = self.output.canvas == CanvasSpec::Fit;
        let may_be_refused = is_fit || self.record.folds != Folds::Report;
        Ok(Survey {
            posed: 0,
            may_be_refused,
            needs_alpha: self.may_need_alpha(),
            canvas: None,
            has_one_canvas: true,
        })
    }

    /// Poses frames until it is known what all images have in common, alpha and the canvas of an
    /// animation: none if nothing depends on it, all of them if one of them may be refused. It ends
    /// earlier after [`MAX_SURVEY_TIME`]. Errors: Those of a frame.
    pub(crate) fn survey(&mut self, survey: &mut Survey, cancel: &Cancel) -> Result<(), Problem> {
        let began = Instant::now();
        // Any content that may gain alpha shows whether a frame needs it.
        let content = self
            .contents()
            .find(|content| content.may_gain_alpha())
            .unwrap_or(&self.content)
            .clone();
        while !self.is_surveyed(survey) {
            // The last in-between first: it moves the most, and is the likeliest to need alpha.
            let frame = if survey.posed == 0 {
                self.object.poses.count() - 1
            } else {
                survey.posed - 1
            };
            let q = Arc::new(self.pose_of(frame)?.q);
            let job = self.draw_job(&content, q, Timing::default());
            let (is_cancelled, is_gone) = (|| cancel.is_cancelled(), || cancel.is_gone());
            let prepared = self.app.drawing.prepare(&job, &is_cancelled, &is_gone);
            let (warp, ..) = prepared.map_err(|problem| self.located(frame, problem))?;
            self.force_alpha |= warp.adds_alpha();
            if let Some(shown) = warp.target().canvas {
                survey.has_one_canvas &= survey.canvas.is_none_or(|canvas| canvas == shown);
                survey.canvas = Some(survey.canvas.map_or(shown, |canvas| canvas.union(shown)));
            }
            survey.posed += 1;
            if !self.is_surveyed(survey) {
                self.rest
                    .setup
                    .check_frames((self.object.poses.count() - survey.posed).into())?;
            }
            if began.elapsed() >= MAX_SURVEY_TIME {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Whether no more frames need to be posed.
    pub(crate) fn is_surveyed(&self, survey: &Survey) -> bool {
        survey.posed == self.object.poses.count()
            || !survey.may_be_refused && (self.force_alpha || !survey.needs_alpha)
    }

    /// Decides on the canvas of all images of an animation.
    /// Errors: the canvas is too large.
    pub(crate) fn decide(&mut self, survey: &Survey) -> Result<(), Problem> {
        let is_fit = self.output.canvas == CanvasSpec::Fit;
        if let Some(canvas) = survey.canvas.filter(|_| is_fit && self.form.is_animation()) {
            self.output.canvas = CanvasSpec::Box(canvas);
            self.output.check(
                self.content.raster_source().extent(),
                &self.app.plans.limits,
            )?;
            // A frame that is smaller than all together does not cover them.
            self.force_alpha |= survey.needs_alpha && !survey.has_one_canvas;
        }
        Ok(())
    }

    /// The image and the layers.
    fn contents(&self) -> impl Iterator<Item = &DrawnContent> {
        std::iter::once(&self.content).chain(self.layers.iter().map(|(_, content)| content))
    }

    /// Whether images have alpha if the posed image does not cover them, or has holes, and none
    /// otherwise.
    fn may_need_alpha(&self) -> bool {
        let is_opaque = match self.output.outside {
            Outside::Transparent => false,
            Outside::Colour([.., alpha]) => alpha == u8::MAX,
            Outside::Edge | Outside::Reflect | Outside::Value(_) => true,
        };
        let has_holes = self.output.holes == Holes::Transparent;
        (!is_opaque || has_holes)
            && self.contents().any(DrawnContent::may_gain_alpha)
            && self.output.format.info().has_alpha
    }

    /// Draws a frame and maps its annotations.
    pub(crate) fn draw(
        &self,
        frame: u32,
        timing: Timing,
        cancel: &Cancel,
    ) -> Result<FinishedFrame, Problem> {
        let pose = self.pose_number(frame);
        let located = |problem| self.located(pose, problem);
        let FramePose { q, position } = self.pose_of(pose)?;
        let q = Arc::new(q);
        let (mut layers, mut layer_files) = (BTreeMap::new(), Vec::new());
        for (layer, content) in &self.layers {
            let job = self.draw_job(content, Arc::clone(&q), Timing::default());
            let name = format!(
                "{frame:04}.{}.{}",
                layer.as_str(),
                job.output.format.extension()
            );
            layer_files.push((
                name.clone(),
                self.app
                    .drawing
                    .draw_file(&job, cancel)
                    .map_err(located)?
                    .first
                    .bytes,
            ));
            layers.insert(layer.as_str().to_owned(), name);
        }
        let job = self.draw_job(&self.content, q, timing);
        let Drawn {
            report,
            target,
            first,
            ..
        } = self.app.drawing.draw_file(&job, cancel).map_err(located)?;
        let picture = self.rest.setup.frame_of(target);
        let annotations = if self.has_annotations() && self.form == BatchForm::Zip {
            Some((
                format!("{frame:04}.json"),
                self.annotate(&job.q, picture, cancel).map_err(located)?,
            ))
        } else {
            None
        };
        let mut warnings = report.warnings;
        self.object
            .annotations
            .add_warnings(&self.rest.setup.source_frame(), &mut warnings);
        let entry = BatchFrame {
            layers,
            picture: format!("{frame:04}.{}", self.output.format.extension()),
            annotations: annotations.as_ref().map(|(name, _)| name.clone()),
            position,
            width: target.extent.width(),
            height: target.extent.height(),
            canvas: AsJson(picture.canvas()),
            scale: picture.scale(),
            folds: report.folds,
            residual: report.residual,
            warnings: warnings.iter().map(|warning| warning.code()).collect(),
            exceeded: (report.exceeded > 0).then_some(report.exceeded),
        };
        let files: Vec<(String, Bytes)> = std::iter::once((entry.picture.clone(), first.bytes))
            .chain(layer_files)
            .chain(annotations)
            .collect();
        // The packed copy of each file, and then the bytes that are sent.
        let length: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
        let held =
            self.app
                .admission
                .reserve_for(MemoryClass::Frame, &self.quota, 2 * length as u64)?;
        let of_file = warnings.into_iter().filter(Warning::is_of_file).collect();
        Ok(FinishedFrame {
            packed: self.form.pack(files)?,
            entry,
            of_file,
            held,
        })
    }

    /// The annotations of a frame as JSON, as `/points` returns them, in the frame of its image;
    /// with jitter, also the handles.
    fn annotate(
        &self,
        q: &[Handle],
        picture: PictureFrame,
        cancel: &Cancel,
    ) -> Result<Bytes, Problem> {
        let (setup, is_cancelled) = (&self.rest.setup, || cancel.is_cancelled());
        let pose = setup.pose(q)?;
        let mut reservation = self.reserve(HANDLE_TEXT * q.len() as u64)?;
        let kind = (self.record.folds, true);
        let pose_to_map = |_| {
            let (drawing, of) = (&self.app.drawing, (&***setup, &**self.plan));
            drawing.pose_to_map(of, &self.quota, kind, &pose, &is_cancelled)
        };
        // Where folds are removed, the posed grid is the map.
        let removes = (kind.0 == Folds::Remove).then_some(());
        let unfolded = removes.map(pose_to_map).transpose()?;
        let transform = match &unfolded {
            Some((posed, _)) => setup.transform_of(&pose, posed),
            None => setup.transform(&pose),
        };
        let transform = transform.onto(picture);
        let (mut cursor, mut body) = (Cursor::default(), Vec::new());
        if matches!(self.object.poses, BatchPoses::Jitter { .. }) {
            body = cancellable_json(cancel, &json!({"q": AsJson(q)}), 0)?;
            body.pop();
            cursor = Cursor::after_fields();
        }
        let mut reserve = |bytes| self.app.admission.reserve_more(&mut reservation, bytes);
        while self.object.annotations.map_part(
            &mut cursor,
            &transform,
            &is_cancelled,
            &mut reserve,
            &mut body,
        )? {}
        Ok(reservation.attach_exact(body))
    }
}
