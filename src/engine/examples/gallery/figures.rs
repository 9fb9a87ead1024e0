//! What is drawn: handles, methods and what shall be seen.

use std::error::Error;

use mlswarp::Warper;
use mlswarp::deform::{Handle, Method};
use mlswarp::geometry::{Grid, Mesh};
use mlswarp::warp::{Folds, GridSpec, Metric, Report};

use super::Picture;

/// A strip of panels.
pub(crate) struct PaperFigure {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    pub(crate) claim: &'static str,
    pub(crate) image: &'static str,
    /// The part of the plane that is shown: x, y, width, height.
    pub(crate) canvas: [i32; 4],
    /// The handles at rest, and where they go.
    pub(crate) rest: Placed,
    pub(crate) posed: Placed,
    pub(crate) panels: &'static [Panel],
}

/// Positions of handles.
pub(crate) enum Placed {
    Points(&'static [[f64; 2]]),
    Lines(&'static [[[f64; 2]; 2]]),
}

impl Placed {
    pub(crate) fn handles(&self) -> Vec<Handle> {
        match self {
            Self::Points(points) => points.iter().copied().map(Handle::from).collect(),
            Self::Lines(lines) => lines.iter().copied().map(Handle::from).collect(),
        }
    }
}

/// One drawing.
pub(crate) struct Panel {
    pub(crate) caption: &'static str,
    pub(crate) drawn: Drawn,
}

/// What a panel shows.
pub(crate) enum Drawn {
    /// The image, and the handles at rest.
    AtRest,
    /// A method, with its alpha.
    By(Method, Option<f64>),
    /// The same with handles that act inside the outline.
    Inside(Method, Option<f64>),
    /// A puppet, with the depth of one handle.
    Puppet(Option<usize>),
    /// Rigid inside the outline, with the depth of one handle.
    InFront(usize),
    /// Rigid on a grid of this many columns and rows of vertices.
    OnGrid(u32),
    /// Rigid, without folds.
    FoldFree,
}

impl Panel {
    const fn new(caption: &'static str, drawn: Drawn) -> Self {
        Self { caption, drawn }
    }

    /// The handles as the panel shows them.
    pub(crate) fn shown(&self, figure: &PaperFigure) -> Vec<Handle> {
        match self.drawn {
            Drawn::AtRest => figure.rest.handles(),
            _ => figure.posed.handles(),
        }
    }

    /// The mesh that is drawn.
    ///
    /// Errors: The handles cannot be posed.
    pub(crate) fn mesh(
        &self,
        figure: &PaperFigure,
        picture: &Picture,
    ) -> Result<Mesh, Box<dyn Error>> {
        Ok(match self.drawn {
            Drawn::AtRest => Mesh::identity(of_picture(picture)),
            Drawn::FoldFree => fold_free(figure, picture)?,
            _ => self.posed(figure, picture)?.0,
        })
    }

    /// The mesh of a method, and its report.
    ///
    /// Errors: The handles cannot be posed.
    pub(crate) fn posed(
        &self,
        figure: &PaperFigure,
        picture: &Picture,
    ) -> Result<(Mesh, Report), Box<dyn Error>> {
        let (p, q) = (figure.rest.handles(), figure.posed.handles());
        let (method, alpha) = match self.drawn {
            Drawn::By(method, alpha) | Drawn::Inside(method, alpha) => (method, alpha),
            Drawn::Puppet(_) => (Method::AsRigidAsPossible, None),
            Drawn::AtRest | Drawn::InFront(_) | Drawn::OnGrid(_) | Drawn::FoldFree => {
                (Method::Rigid, None)
            }
        };
        let is_inside = matches!(self.drawn, Drawn::Inside(..) | Drawn::InFront(_));
        let front = match self.drawn {
            Drawn::Puppet(front) => front,
            Drawn::InFront(front) => Some(front),
            _ => None,
        };
        let depth = front.map(|front| {
            let depth = |handle| f64::from(u8::from(handle == front));
            (0..p.len()).map(depth).collect()
        });
        let warper = Warper::builder(&p).method(method).with(|rest| {
            rest.alpha = alpha;
            rest.depth = depth;
            rest.mask = Some(picture.mask.clone());
            if is_inside {
                rest.metric = Metric::Geodesic;
            }
            if let Drawn::OnGrid(lines) = self.drawn {
                rest.grid = GridSpec::Counts {
                    columns: lines,
                    rows: lines,
                };
            }
        });
        let posed = warper.build(picture.image.extent())?.pose(&q)?;
        Ok((posed.mesh().clone(), posed.report().clone()))
    }
}

fn of_picture(picture: &Picture) -> Grid {
    let extent = picture.image.extent();
    Grid::with_cell(extent.width().into(), extent.height().into(), 5.0)
}

/// Rigid with cells of 5 px, and its folds removed.
fn fold_free(figure: &PaperFigure, picture: &Picture) -> Result<Mesh, Box<dyn Error>> {
    let warper = Warper::builder(&figure.rest.handles())
        .grid(GridSpec::Cell(5.0))
        .folds(Folds::Remove)
        .build(picture.image.extent())?;
    let posed = warper.pose(&figure.posed.handles())?;
    Ok(posed.mesh().clone())
}

const TOY: [[f64; 2]; 7] = [
    [250.0, 70.0],
    [75.0, 205.0],
    [425.0, 205.0],
    [250.0, 215.0],
    [250.0, 290.0],
    [178.0, 435.0],
    [322.0, 435.0],
];
const TOY_POSED: [[f64; 2]; 7] = [
    [292.0, 58.0],
    [48.0, 62.0],
    [478.0, 262.0],
    [250.0, 215.0],
    [250.0, 292.0],
    [118.0, 430.0],
    [362.0, 420.0],
];
const TOY_FOLDED: [[f64; 2]; 7] = [
    [250.0, 70.0],
    [75.0, 205.0],
    [300.0, 340.0],
    [250.0, 215.0],
    [250.0, 290.0],
    [178.0, 435.0],
    [322.0, 435.0],
];
const HORSE: [[f64; 2]; 11] = [
    [122.0, 606.0],
    [248.0, 600.0],
    [512.0, 604.0],
    [562.0, 614.0],
    [150.0, 240.0],
    [330.0, 215.0],
    [545.0, 300.0],
    [600.0, 120.0],
    [700.0, 70.0],
    [752.0, 180.0],
    [62.0, 470.0],
];
const HORSE_LEAPING: [[f64; 2]; 11] = [
    [97.0, 606.0],
    [278.0, 600.0],
    [582.0, 484.0],
    [657.0, 519.0],
    [150.0, 240.0],
    [330.0, 207.0],
    [540.0, 265.0],
    [570.0, 60.0],
    [630.0, 15.0],
    [697.0, 160.0],
    [22.0, 380.0],
];
/// One hoof is moved.
const HORSE_DRAGGED: [[f64; 2]; 11] = {
    let mut q = HORSE;
    q[3] = [614.0, 584.0];
    q
};
/// The front legs cross.
const HORSE_CROSSED: [[f64; 2]; 11] = {
    let mut q = HORSE;
    (q[2], q[3]) = ([585.0, 590.0], [470.0, 575.0]);
    q
};
const TOWER: [[[f64; 2]; 2]; 7] = [
    [[322.0, 128.0], [322.0, 402.0]],
    [[20.0, 418.0], [250.0, 418.0]],
    [[395.0, 418.0], [620.0, 418.0]],
    [[66.0, 10.0], [20.0, 390.0]],
    [[586.0, 10.0], [606.0, 390.0]],
    [[110.0, 8.0], [290.0, 8.0]],
    [[350.0, 8.0], [540.0, 8.0]],
];
const TOWER_LEANING: [[[f64; 2]; 2]; 7] = {
    let mut q = TOWER;
    q[0][0] = [391.11, 228.97];
    q
};
const SIDES: [[[f64; 2]; 2]; 6] = [
    [[310.0, 150.0], [310.0, 400.0]],
    [[334.0, 150.0], [334.0, 400.0]],
    [[20.0, 418.0], [240.0, 418.0]],
    [[400.0, 418.0], [620.0, 418.0]],
    [[66.0, 10.0], [20.0, 390.0]],
    [[586.0, 10.0], [606.0, 390.0]],
];
const SIDES_LEANING: [[[f64; 2]; 2]; 6] = {
    let mut q = SIDES;
    q[0] = [[484.88, 145.67], [315.48, 393.27]];
    q[1] = [[504.68, 159.22], [335.29, 406.82]];
    q
};

const TOY_CANVAS: [i32; 4] = [-20, -10, 540, 520];
const HORSE_CANVAS: [i32; 4] = [-20, -10, 840, 676];
const ROCKET_CANVAS: [i32; 4] = [0, 0, 640, 427];

const fn classes(alpha: Option<f64>) -> [Panel; 4] {
    [
        Panel::new("at rest", Drawn::AtRest),
        Panel::new("affine", Drawn::By(Method::Affine, alpha)),
        Panel::new("similarity", Drawn::By(Method::Similarity, alpha)),
        Panel::new("rigid", Drawn::By(Method::Rigid, alpha)),
    ]
}

static POINT_CLASSES: [Panel; 4] = classes(None);
static LINE_CLASSES: [Panel; 4] = classes(Some(2.0));

/// All of them, in the order of the paper; figure 3 has the layout of figure 1.
pub(crate) static FIGURES: [PaperFigure; 9] = [
    PaperFigure {
        name: "figure-1",
        title: "Figures 1 and 3: three classes of maps",
        claim: "Affine stretches and shears the arms and the body, similarity makes the limbs \
            larger and smaller, and rigid keeps their lengths and widths.",
        image: "toy.png",
        canvas: TOY_CANVAS,
        rest: Placed::Points(&TOY),
        posed: Placed::Points(&TOY_POSED),
        panels: &POINT_CLASSES,
    },
    PaperFigure {
        name: "figure-2",
        title: "Figure 2: other methods with the same handles",
        claim: "The thin-plate spline is smooth, but shears and scales. As rigid as possible keeps \
            lengths, on a mesh that follows the outline.",
        image: "toy.png",
        canvas: TOY_CANVAS,
        rest: Placed::Points(&TOY),
        posed: Placed::Points(&TOY_POSED),
        panels: &[
            Panel::new("tps", Drawn::By(Method::ThinPlateSpline, None)),
            Panel::new("arap", Drawn::Puppet(None)),
            Panel::new("rigid", Drawn::By(Method::Rigid, None)),
        ],
    },
    PaperFigure {
        name: "figure-4",
        title: "Figure 4: a horse and eleven points",
        claim: "Affine shears most, which the front hooves show; similarity swells the hind hoof. \
            Between similarity and rigid the difference is small here.",
        image: "horse-cutout.png",
        canvas: [-60, -90, 920, 760],
        rest: Placed::Points(&HORSE),
        posed: Placed::Points(&HORSE_LEAPING),
        panels: &POINT_CLASSES,
    },
    PaperFigure {
        name: "figure-5",
        title: "Figure 5: line segments",
        claim: "The rocket leans and becomes shorter: affine shears it, similarity turns it and \
            shrinks its width with its length, and rigid turns it and keeps its width.",
        image: "rocket.jpg",
        canvas: ROCKET_CANVAS,
        rest: Placed::Lines(&TOWER),
        posed: Placed::Lines(&TOWER_LEANING),
        panels: &LINE_CLASSES,
    },
    PaperFigure {
        name: "figure-6",
        title: "Figure 6: beside Beier and Neely",
        claim: "Field morphing pulls the surroundings of a line that becomes longer, and folds in \
            many more cells than rigid lines with alpha 1. With alpha 2 rigid folds as much, which \
            the paper does not say.",
        image: "rocket.jpg",
        canvas: ROCKET_CANVAS,
        rest: Placed::Lines(&SIDES),
        posed: Placed::Lines(&SIDES_LEANING),
        panels: &[
            Panel::new("at rest", Drawn::AtRest),
            Panel::new("beier_neely", Drawn::By(Method::BeierNeely, None)),
            Panel::new("rigid, alpha 1", Drawn::By(Method::Rigid, Some(1.0))),
            Panel::new("rigid, alpha 2", Drawn::By(Method::Rigid, Some(2.0))),
        ],
    },
    PaperFigure {
        name: "figure-7",
        title: "Figure 7: a grid instead of every pixel",
        claim: "On 50 x 50 cells the grain is smooth across their borders; grid: auto divides \
            cells until the picture is within a quarter of a pixel of the exact map.",
        image: "toy.png",
        canvas: TOY_CANVAS,
        rest: Placed::Points(&TOY),
        posed: Placed::Points(&TOY_POSED),
        panels: &[
            Panel::new("5 x 5 cells", Drawn::OnGrid(6)),
            Panel::new("50 x 50 cells", Drawn::OnGrid(51)),
            Panel::new("grid: auto", Drawn::By(Method::Rigid, None)),
        ],
    },
    PaperFigure {
        name: "figure-8",
        title: "Figure 8: folds",
        claim: "An arm that is dragged across the body folds the plane. A map without folds \
            (folds: remove) takes all handles to the same places, and no cell folds.",
        image: "toy.png",
        canvas: TOY_CANVAS,
        rest: Placed::Points(&TOY),
        posed: Placed::Points(&TOY_FOLDED),
        panels: &[
            Panel::new("at rest", Drawn::AtRest),
            Panel::new("rigid", Drawn::By(Method::Rigid, None)),
            Panel::new("without folds", Drawn::FoldFree),
        ],
    },
    PaperFigure {
        name: "hoof",
        title: "Beyond the paper: inside the outline",
        claim: "One hoof is dragged by 60 px. In the plane the three others are dragged along, \
            by up to 16 px; inside the outline they move by at most 1 px, and by at most 5.3 px \
            on a puppet's mesh.",
        image: "horse-cutout.png",
        canvas: HORSE_CANVAS,
        rest: Placed::Points(&HORSE),
        posed: Placed::Points(&HORSE_DRAGGED),
        panels: &[
            Panel::new("at rest", Drawn::AtRest),
            Panel::new("rigid, euclidean", Drawn::By(Method::Rigid, Some(2.0))),
            Panel::new("rigid, geodesic", Drawn::Inside(Method::Rigid, None)),
            Panel::new("arap", Drawn::Puppet(None)),
        ],
    },
    PaperFigure {
        name: "depth",
        title: "Beyond the paper: depth",
        claim: "The front legs cross. The handle of more depth brings its leg to the front, up to \
            the knee.",
        image: "horse-cutout.png",
        canvas: HORSE_CANVAS,
        rest: Placed::Points(&HORSE),
        posed: Placed::Points(&HORSE_CROSSED),
        panels: &[
            Panel::new("geodesic, left hoof in front", Drawn::InFront(2)),
            Panel::new("geodesic, right hoof in front", Drawn::InFront(3)),
            Panel::new("arap, left hoof in front", Drawn::Puppet(Some(2))),
            Panel::new("arap, right hoof in front", Drawn::Puppet(Some(3))),
        ],
    },
];
