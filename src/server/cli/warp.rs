//! `mlswarp warp IMAGE WARP.json -o OUT`, `mlswarp warp IMAGE --landmarks FILE -o OUT`,
//! `mlswarp warp IMAGE... WARP.json -o FOLDER`: `POST /warp` without a server, with the same parser
//! and the same bytes.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use mlswarp::pixmap::Extent;
use mlswarp::warp::{
    CompiledRest, Image, LabelImage, PosedMesh, RasterSource, Region, RenderJob, Report,
    ResolvedRest,
};

use super::failure::{Failure, name_of};
use super::images::{InputFile, Inputs, Outputs, companion};
use super::input::Limit;
use super::options::require_quality_of_jpeg;
use super::{input, output};
use crate::config::{Config, LandmarkInput, WarpArgs, WarpKind};
use crate::layer::check_extent;
use crate::wire::landmarks::Landmarks;
use crate::wire::{Merged, NamedObject, Reserved, WarpObject, WarpPatch};
use crate::wire::{canvas_text, method_text};

/// Warps images. The result: what a server sends in response headers; of several images their
/// number. Errors: See [`Failure`]; an image of several that failed, after the others.
pub fn run(config: &Config, args: &WarpArgs) -> Result<String, Failure> {
    let config = &config.offline();
    let WarpArgs {
        files,
        landmarks,
        region,
        out,
        ..
    } = args;
    input::require_one_stdin(
        files
            .iter()
            .map(Some)
            .chain(landmarks.files())
            .chain([region.as_ref()]),
    )?;
    let inputs = Inputs::of(files, Limit::body(config))?;
    let merged = input::merge(&sources(config, args, &inputs)?)?;
    let located = |problem| input::located(&merged, problem);
    let patch = Reserved::<WarpPatch, _>::parse(&merged.json, |_| Ok(())).map_err(located)?;
    let (mut patch, ()) = patch.into_parts();
    if args.kind == WarpKind::Holes && region.is_none() {
        return Err(no_region());
    }
    let outputs = Outputs::of(out, &inputs, patch.output.format)?;
    require_quality_of_jpeg(
        &args.file,
        outputs.format(),
        "give --format jpeg, or a file that ends in .jpg",
    )?;
    if landmarks.landmarks.is_some() {
        patch.require_no_handles().map_err(located)?;
    }
    let mut object = patch.into_object().map_err(located)?;
    object.output.format = outputs.format();
    let others: Vec<&PathBuf> = landmarks
        .files()
        .into_iter()
        .chain([region.as_ref()])
        .flatten()
        .collect();
    let files = outputs.files(&inputs, &others)?;
    let (shared_landmarks, shared_region) = shared(config, args, &merged.json)?;
    let mut job = WarpJob {
        config,
        args,
        merged: &merged,
        object,
        shared_landmarks,
        shared_region,
        prepared: None,
    };
    let threads = input::threads(config)?;
    let Outputs::Folder(folder, _) = outputs else {
        return threads.install(|| {
            job.draw(&inputs.images[0], |file| {
                output::write(out, |sink| file(sink))
            })
        });
    };
    output::create_directory(&folder)?;
    let mut failed = 0;
    for (image, file) in inputs.images.iter().zip(&files) {
        match threads
            .install(|| job.draw(image, |content| output::replace(file, |sink| content(sink))))
        {
            Ok(summary) => eprintln!("{}: {summary}", name_of(file)),
            Err(failure) => {
                failed += 1;
                eprintln!("{}", failure.about(name_of(&image.path)));
            }
        }
    }
    let (count, folder) = (files.len(), name_of(&folder));
    match failed {
        0 => Ok(format!("{count} images in {folder}")),
        _ => Err(Failure::Local(format!(
            "{failed} of {count} images failed; {} are in {folder}",
            count - failed
        ))),
    }
}

/// The landmarks and the region of all images, unless each has its own in a folder.
fn shared(
    config: &Config,
    args: &WarpArgs,
    warp: &[u8],
) -> Result<(Option<Landmarks>, Option<Region>), Failure> {
    let landmarks = if has_own_landmarks(args) {
        None
    } else {
        args.landmarks.read(config, warp)?
    };
    let region = args
        .region
        .as_deref()
        .filter(|path| !path.is_dir())
        .map(|path| region(config, path))
        .transpose()?;
    Ok((landmarks, region))
}

fn has_own_landmarks(args: &WarpArgs) -> bool {
    args.landmarks
        .files()
        .into_iter()
        .flatten()
        .any(|path| path.is_dir())
}

fn region(config: &Config, path: &Path) -> Result<Region, Failure> {
    let mask = input::read("region", path, Limit::body(config))?;
    let mask = Image::decode(&mask, &config.limits().image, &|| false)
        .map_err(|error| Failure::from(error).about(name_of(path)))?;
    Ok(Region::new(&mask))
}

/// The warp object and the options.
fn sources(config: &Config, args: &WarpArgs, inputs: &Inputs) -> Result<Vec<NamedObject>, Failure> {
    let WarpArgs {
        landmarks,
        pose,
        frame,
        file,
        ..
    } = args;
    let mut sources = Vec::new();
    match &inputs.warp {
        Some(warp) => {
            let json = warp.read("warp object", Limit::json(config))?;
            sources.push(NamedObject {
                name: name_of(&warp.path),
                json,
                is_option: false,
            });
        }
        None if landmarks.landmarks.is_none() => {
            let missing = "the handles are missing: give a warp object, a file that ends in .json \
                or begins with `{`, or --landmarks FILE";
            return Err(Failure::Local(missing.to_owned()));
        }
        None => {}
    }
    sources.extend(pose.sources());
    sources.extend(frame.sources()?);
    sources.extend(file.sources());
    Ok(sources)
}

fn no_region() -> Failure {
    Failure::Local("--kind holes needs a --region".to_owned())
}

/// What all images have in common.
struct WarpJob<'a> {
    config: &'a Config,
    args: &'a WarpArgs,
    merged: &'a Merged,
    /// Without the handles of landmark files.
    object: WarpObject,
    shared_landmarks: Option<Landmarks>,
    shared_region: Option<Region>,
    /// The handles on the last image: images of one size share them.
    prepared: Option<PreparedHandles>,
}

/// Handles on an image of one size.
struct PreparedHandles {
    extent: Extent,
    object: WarpObject,
    setup: ResolvedRest,
    plan: CompiledRest,
}

/// Writes a file by its content.
type WriteContent<'a> = &'a mut dyn FnMut(&mut output::OutputFile<'_>) -> Result<(), Failure>;

impl WarpJob<'_> {
    /// Draws one image. `write`: to its output file. The result: what a server sends in response
    /// headers.
    fn draw(
        &mut self,
        image: &InputFile,
        write: impl FnOnce(WriteContent<'_>) -> Result<(), Failure>,
    ) -> Result<String, Failure> {
        let (config, args) = (self.config, self.args);
        let about = |failure: Failure| failure.about(name_of(&image.path));
        let landmarks = self.landmarks_of(&image.path)?;
        let file = image.read("image", Limit::body(config))?;
        let limits = &config.limits().image;
        let decode = |file: &[u8]| Image::decode(file, limits, &|| false).map_err(Failure::from);
        let region = self.region_of(&image.path)?;
        if let Some((region, name)) = &region {
            let extent = input::extent_of(config, &file).map_err(|error| about(error.into()))?;
            check_extent(region.extent(), extent)
                .map_err(|problem| Failure::from(problem).about(&**name))?;
        }
        let region = region.map(|(region, _)| region);
        let (picture, labels);
        let source = match (args.kind, &region) {
            (WarpKind::Image, _) => {
                picture = decode(&file).map_err(about)?;
                RasterSource::Image(&picture)
            }
            (WarpKind::Labels, _) => {
                labels = LabelImage::decode(&file, &config.limits(), &|| false)
                    .map_err(|error| about(error.into()))?;
                RasterSource::Labels(&labels)
            }
            (WarpKind::Coverage, _) => RasterSource::Coverage(
                input::extent_of(config, &file).map_err(|error| about(error.into()))?,
            ),
            (WarpKind::Holes, Some(region)) => RasterSource::Holes(region),
            (WarpKind::Holes, None) => return Err(no_region()),
        };
        let shape;
        let image = match source {
            RasterSource::Image(image) => Some(image),
            RasterSource::Labels(_) => None,
            RasterSource::Coverage(_) | RasterSource::Holes(_) if self.object.rest.needs_mask() => {
                shape = decode(&file).map_err(about)?;
                Some(&shape)
            }
            RasterSource::Coverage(_) | RasterSource::Holes(_) => None,
        };
        let image = image.map(|image| (image, region.as_ref()));
        self.prepare(source.extent(), image, landmarks)?;
        self.render(source, region.as_ref(), write)
    }

    /// The landmarks of an image, if they are in files.
    fn landmarks_of(&self, image: &Path) -> Result<Option<Landmarks>, Failure> {
        if !has_own_landmarks(self.args) {
            return Ok(self.shared_landmarks.clone());
        }
        let own = |path: Option<&PathBuf>| {
            path.map(|path| companion("landmark file", path, image, false))
                .transpose()
        };
        let [p, q] = self.args.landmarks.files();
        LandmarkInput {
            landmarks: own(p)?,
            landmarks_q: own(q)?,
            ..self.args.landmarks.clone()
        }
        .read(self.config, &self.merged.json)
    }

    /// The region of an image, and the name of its file.
    fn region_of(&self, image: &Path) -> Result<Option<(Region, String)>, Failure> {
        let Some(path) = &self.args.region else {
            return Ok(None);
        };
        if let Some(shared) = &self.shared_region {
            return Ok(Some((shared.clone(), name_of(path))));
        }
        let path = companion("mask", path, image, true)?;
        Ok(Some((region(self.config, &path)?, name_of(&path))))
    }

    /// Resolves the handles on an image of this size, unless they are those of the last one.
    /// `image`: itself and its region, for handles that need its mask.
    fn prepare(
        &mut self,
        extent: Extent,
        image: Option<(&Image, Option<&Region>)>,
        landmarks: Option<Landmarks>,
    ) -> Result<(), Failure> {
        if !has_own_landmarks(self.args)
            && !self.object.rest.needs_mask()
            && self
                .prepared
                .as_ref()
                .is_some_and(|prepared| prepared.extent == extent)
        {
            return Ok(());
        }
        let located = |problem| input::located(self.merged, problem);
        let mut object = self.object.clone();
        if let Some((image, region)) = image {
            object.rest.make_mask(image, region, &|| false)?;
        }
        let (limits, most) = (self.config.limits(), self.config.max_fit_handles as u64);
        let setup = object
            .resolve(landmarks, extent, &limits, most, &|| false)
            .map_err(located)?;
        object.posed().map_err(located)?;
        let plan = setup.plan(&|| false)?;
        self.prepared = Some(PreparedHandles {
            extent,
            object,
            setup,
            plan,
        });
        Ok(())
    }

    fn render(
        &self,
        source: RasterSource<'_>,
        region: Option<&Region>,
        write: impl FnOnce(WriteContent<'_>) -> Result<(), Failure>,
    ) -> Result<String, Failure> {
        let limits = self.config.limits();
        let located = |problem| input::located(self.merged, problem);
        let Some(PreparedHandles {
            object,
            setup,
            plan,
            ..
        }) = &self.prepared
        else {
            return Ok(String::new());
        };
        let pose = setup
            .pose(object.posed()?)
            .map_err(|error| located(error.into()))?;
        source
            .check(&object.output)
            .map_err(|error| located(error.into()))?;
        object
            .output
            .check(source.extent(), &limits)
            .map_err(|error| located(error.into()))?;
        let posed = PosedMesh::new(setup, plan, &pose, object.folds, &|| false)?;
        let posed = match region {
            Some(region) => posed.within(region.clone()),
            None => posed,
        };
        let warp = RenderJob::new(source, &posed, &object.output, &limits, &|| false)?;
        write(&mut |sink| {
            let mut written = Ok(());
            let _ = warp.write(
                self.config.work.workers.saturating_sub(1),
                &(),
                &mut |bytes| {
                    written = sink.put(&bytes);
                    if written.is_ok() {
                        ControlFlow::Continue(())
                    } else {
                        ControlFlow::Break(())
                    }
                },
            );
            written
        })?;
        let target = warp.target();
        let Report {
            warnings,
            folds,
            residual,
            exceeded,
            ..
        } = posed.into_report_on(source, (&target, &object.output), &|| false)?;
        let (width, height) = (target.extent.width(), target.extent.height());
        let canvas = target.canvas.map_or_else(String::new, |canvas| {
            format!(", canvas {}", canvas_text(canvas))
        });
        let method = if object.is_auto {
            format!(", method {}", method_text(&object.rest))
        } else {
            String::new()
        };
        let summary = format!(
            "{width} x {height} px{canvas}{method}, {folds} folded cells, residual {residual:.4} px"
        );
        let summary = if exceeded > 0 {
            format!("{summary}, {exceeded} cells over the tolerance")
        } else {
            summary
        };
        let warnings = warnings.iter().map(|warning| warning.code());
        Ok(warnings.fold(summary, |summary, warning| format!("{summary}, {warning}")))
    }
}
