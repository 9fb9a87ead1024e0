//! A drag of a picture: everything that is made once, and the poses that come one after the other.

use std::ops::ControlFlow;
use std::sync::Arc;

use mlswarp::deform::{self, Falloff, Handle, Handles, Method, Pose, RestDeformation};
use mlswarp::geometry::Grid;
use mlswarp::pixmap::{Channels, Extent, Pixmap};
use mlswarp::warp::{
    CompiledRest, Folds, GridSpec, Image, Limits, OutputSpec, PosedMesh, RasterSource, RenderJob,
    ResolvedRest, RestSpec,
};

use crate::harness::pictures::{VERTICES, bytes, encode, handles};

pub const GRID: GridSpec = GridSpec::Counts {
    columns: VERTICES,
    rows: VERTICES,
};

/// No two drags that follow each other have the same q.
const POSES: u32 = 8;

pub struct Drag {
    image: Arc<Image>,
    setup: ResolvedRest,
    plan: CompiledRest,
    pub rest: Vec<Handle>,
    pub poses: Vec<Vec<Handle>>,
    pub output: OutputSpec,
    turn: usize,
    strips: Vec<Vec<u8>>,
}

impl Drag {
    pub fn new(picture: &Pixmap, handle_count: usize, grid: GridSpec) -> Self {
        Self::of_file(&file(picture), handle_count, grid)
    }

    pub fn of_file(file: &[u8], handle_count: usize, grid: GridSpec) -> Self {
        let limits = Limits::default();
        let extent = Image::decode(file, &limits.image, &|| false)
            .expect("our own picture")
            .extent();
        let (p, _) = handles(handle_count, extent, 1.0);
        let poses = (0..POSES)
            .map(|k| handles(handle_count, extent, 1.0 - 0.02 * f64::from(k)).1)
            .collect();
        Self::of_handles(
            file,
            RestSpec {
                p,
                grid,
                ..RestSpec::default()
            },
            poses,
        )
    }

    pub fn of_handles(file: &[u8], spec: RestSpec, poses: Vec<Vec<Handle>>) -> Self {
        let limits = Limits::default();
        let image =
            Arc::new(Image::decode(file, &limits.image, &|| false).expect("our own picture"));
        let setup = ResolvedRest::new(&spec, image.extent(), &limits, &|| false)
            .expect("handles that can be warped");
        let plan = setup.plan(&|| false).expect("nothing cancels it");
        Self {
            image,
            setup,
            plan,
            rest: spec.p,
            poses,
            output: OutputSpec::default(),
            turn: 0,
            strips: Vec::new(),
        }
    }

    /// Memory of the plan at most, bytes: the table, and exact rows of cells that are halved.
    pub fn plan_bytes(&self) -> u64 {
        self.plan.bytes()
    }

    /// The next q to a mesh that may be drawn.
    pub fn pose(&mut self) {
        self.turn = (self.turn + 1) % self.poses.len();
        let pose = self
            .setup
            .pose(&self.poses[self.turn])
            .expect("a pose of these handles");
        let posed = PosedMesh::new(&self.setup, &self.plan, &pose, Folds::Report, &|| false);
        std::hint::black_box(posed.expect("folds are drawn"));
    }

    /// The next q to the strips of a file, a PNG unless `output` is changed, which stay where the
    /// writer put them: the service sends them as they are.
    pub fn picture(&mut self, helpers: usize) {
        self.turn = (self.turn + 1) % self.poses.len();
        let pose = self
            .setup
            .pose(&self.poses[self.turn])
            .expect("a pose of these handles");
        let limits = Limits::default();
        let posed = PosedMesh::new(&self.setup, &self.plan, &pose, Folds::Report, &|| false)
            .expect("folds are drawn");
        let warp = RenderJob::new(
            RasterSource::Image(&self.image),
            &posed,
            &self.output,
            &limits,
            &|| false,
        );
        self.strips.clear();
        let _ = warp
            .expect("nothing is too large")
            .write(helpers, &(), &mut |bytes| {
                self.strips.push(bytes);
                ControlFlow::Continue(())
            });
    }

    /// The file of one pose.
    pub fn file_of(&mut self, pose: usize) -> Vec<u8> {
        self.turn = (pose + self.poses.len() - 1) % self.poses.len();
        self.picture(0);
        self.strips.concat()
    }

    pub fn extent(&self) -> Extent {
        self.image.extent()
    }
}

/// The plan and a pose of the same handles, for the deformation alone.
pub fn deformation(extent: Extent, handle_count: usize) -> (deform::CoefficientTable, Pose) {
    let (p, q) = handles(handle_count, extent, 1.0);
    let rest = Handles::new(p, None).expect("well-formed handles");
    let falloff = Falloff::new(1.0, rest.has_lines()).expect("alpha in range");
    let field = RestDeformation::new(rest, Method::Rigid, falloff, 1.0).expect("a regular set");
    let pose = field.pose(&q).expect("targets that agree");
    let grid = Grid::with_counts(
        f64::from(extent.width()),
        f64::from(extent.height()),
        VERTICES,
        VERTICES,
    );
    (
        deform::CoefficientTable::of_grid(&field, &grid, &|| false).expect("nothing cancels it"),
        pose,
    )
}

/// A picture as a file, RGBA if it is.
pub fn file(picture: &Pixmap) -> Vec<u8> {
    let mut file = Vec::new();
    encode(
        picture.extent(),
        picture.channels(),
        bytes(picture),
        (png::Compression::Fastest, None),
        &mut file,
    );
    file
}

/// The samples of one of our files, by another decoder.
pub fn samples(file: &[u8]) -> (Channels, Vec<u8>) {
    let picture = image::load_from_memory(file).expect("a PNG");
    if picture.color().has_alpha() {
        (Channels::Rgba, picture.to_rgba8().into_raw())
    } else {
        (Channels::Rgb, picture.to_rgb8().into_raw())
    }
}
