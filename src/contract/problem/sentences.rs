//! What a problem says of an error of a warp or of handles. Where a sentence needs names of JSON
//! members, names of limits, or advice what to send instead, it is made here. Errors of files and
//! of parameters bring their names with them.

use mlswarp::deform::{DeformError, MeshQuantity, unfoldable};
use mlswarp::warp::{GridError, Quantity, Task, WarpError};

/// The name of a limit, the pointer to what exceeds it, and a sentence with `{}` for the value,
/// and `{method}` for the method of `SystemHandles`.
pub(super) fn limit(what: Quantity) -> (&'static str, Option<&'static str>, &'static str) {
    let (width, canvas) = (Some("/output/width"), Some("/output/canvas"));
    match what {
        Quantity::HandleColumns => (
            "handle_columns",
            Some("/p"),
            "the handles need {} columns (1 for each point, 2 for each segment)",
        ),
        Quantity::SystemHandles(method) => {
            let info = method.info();
            let name = match &info.system {
                Some(system) => system.most_handles.0,
                None => "handles",
            };
            (
                name,
                Some("/p"),
                "the method `{method}` would have {} handles",
            )
        }
        Quantity::FitHandles => (
            "fit_handles",
            Some("/p"),
            "methods would be compared on {} handles",
        ),
        Quantity::GridVertices => (
            "grid_vertices",
            Some("/grid"),
            "the grid would have {} vertices",
        ),
        Quantity::GridColumns => (
            "grid_columns",
            Some("/grid"),
            "the grid would have {} columns",
        ),
        Quantity::GridRows => ("grid_rows", Some("/grid"), "the grid would have {} rows"),
        Quantity::OutputSide => (
            "output_side",
            width,
            "the longer side of the output would be {} px",
        ),
        Quantity::OutputPixels => ("output_pixels", width, "the output would have {} pixels"),
        Quantity::ScaledSourceSide => (
            "scaled_source_side",
            width,
            "at this scale the longer side of the whole source would be {} px",
        ),
        Quantity::MapSide => (
            "map_side",
            None,
            "the longer side of the map would be {} px",
        ),
        Quantity::MapPixels => ("map_pixels", None, "the map would have {} pixels"),
        Quantity::CanvasSide => (
            "canvas_side",
            canvas,
            "the longer side of the canvas would be {} px",
        ),
        Quantity::CanvasEdge => (
            "canvas_edge",
            canvas,
            "the canvas would reach {} px from the corner of the image",
        ),
        Quantity::CanvasPixels => ("canvas_pixels", canvas, "the canvas would have {} pixels"),
        Quantity::OutlineSamples => (
            "outline_samples",
            Some("/polygons"),
            "the outlines would be examined at {} positions or more",
        ),
        Quantity::PlanBytes => ("plan_bytes", None, "the coefficients would take {} bytes"),
        Quantity::Memory => ("memory", None, "the pixels would take {} bytes"),
    }
}

/// The name of a limit of a mesh.
pub(super) const fn mesh_limit(what: MeshQuantity) -> &'static str {
    match what {
        MeshQuantity::Positions => "arap_positions",
        MeshQuantity::Bytes => "arap_bytes",
        MeshQuantity::Operations => "arap_operations",
    }
}

/// What to send instead of work that is too much.
fn advice(task: Task) -> String {
    let advice = match task {
        Task::System(method) => {
            let name = method.info().name;
            return format!("send fewer handles, or another method than `{name}`");
        }
        Task::Grid => "send fewer handles or a coarser `grid`",
        Task::Positions => "send fewer positions in a request, or fewer handles",
        Task::Outlines => {
            "send fewer or shorter outlines in a request, `\"refine\": false`, or fewer handles"
        }
        Task::Comparison => "send fewer candidates in a request, or fewer points",
        Task::Quality => "send a coarser `grid`",
        Task::Folds => "send fewer handles, a coarser `grid`, or `\"folds\": \"report\"`",
        Task::Survey => {
            "send fewer frames in a request, fewer handles, or an opaque `output.outside`"
        }
    };
    advice.to_owned()
}

/// The sentence about a warp.
pub(super) fn of_warp(error: &WarpError) -> String {
    match error {
        WarpError::Rest(error) | WarpError::Posed(error) => of_handles(error),
        WarpError::Cancelled => {
            "cancelled: the client has disconnected or the deadline has passed".to_owned()
        }
        WarpError::TooLarge {
            what,
            limit: most,
            actual,
        } => {
            let (_, _, sentence) = limit(*what);
            let mut measured = sentence.replace("{}", &actual.to_string());
            if let Quantity::SystemHandles(method) = what {
                measured = measured.replace("{method}", method.info().name);
            }
            format!("{measured}; the limit is {most}")
        }
        WarpError::TooMuchWork { task, .. } => format!("{error}; {}", advice(*task)),
        WarpError::UnusedMask => {
            "`mask` does not apply: it belongs to the metric `geodesic` and the method `arap`"
                .to_owned()
        }
        WarpError::NoImage => {
            "the metric `geodesic` needs an image: send one, or use a session".to_owned()
        }
        WarpError::CutBorder => "`outside` cannot continue an image beyond its outline, which the \
            metric `geodesic` and the method `arap` follow; use `transparent` or a colour"
            .to_owned(),
        WarpError::CutGrid { what } => {
            format!("{what} is not supported with the metric `geodesic`; use `euclidean` for it")
        }
        WarpError::BadGrid(error) => of_grid(*error),
        WarpError::OutsideBeyondDepth { value, most } => format!(
            "the value {value} of `outside` exceeds {most}, the largest of an image of {} bits",
            if *most > 255 { 16 } else { 8 }
        ),
        WarpError::OutsideOfLabels => {
            "outside, labels are 0: `outside` with a value does not apply to them".to_owned()
        }
        WarpError::NotUnfolded => format!(
            "`folds` can be `remove` with the methods {}, and with the metric `euclidean`; use \
                `report` or `reject` here",
            unfoldable("`")
        ),
        WarpError::NotCompared { method } => format!(
            "the method `{method}` is no candidate: methods are compared on points, without an \
                image; leave it out"
        ),
        WarpError::Unreachable { .. } => {
            format!("{error}; move them otherwise, or send `\"folds\": \"report\"`")
        }
        WarpError::NothingVisible => {
            "the posed picture has no area, so the canvas `fit` would be empty".to_owned()
        }
        WarpError::Codec(_)
        | WarpError::Pixels(_)
        | WarpError::BadPlace { .. }
        | WarpError::ForeignParameter { .. }
        | WarpError::LineInFit { .. }
        | WarpError::TooFewPoints { .. }
        | WarpError::NoTable { .. }
        | WarpError::LabelFormat { .. }
        | WarpError::WideLabels
        | WarpError::OtherSize { .. }
        | WarpError::Folded { .. } => error.to_string(),
    }
}

fn of_grid(error: GridError) -> String {
    match error {
        GridError::OwnMesh(method) => {
            let name = method.info().name;
            format!(
                "the method `{name}` draws its own mesh, which is exact: leave `grid` out, or \
                    send `auto`; `{name}.cell` is the side of its cells"
            )
        }
        GridError::CutCells { most } => format!(
            "with the metric `geodesic`, the grid is `auto`, `pixel`, or cells of 1 to {most} \
                whole px"
        ),
        GridError::Tolerance(_) | GridError::Cell(_) | GridError::Counts { .. } => {
            error.to_string()
        }
    }
}

/// The sentence about handles.
pub(super) fn of_handles(error: &DeformError) -> String {
    match error {
        DeformError::EmptyMask => "no pixel of the image is inside the mask: lower its threshold, \
            or send another image or region"
            .to_owned(),
        DeformError::OutsideMask { .. } => {
            format!("{error}: place it, and a line as a whole, on what the image shows")
        }
        DeformError::MaskTooLarge { limit, bytes } => format!(
            "distances inside the mask would take {bytes} bytes, and the limit is {limit}; send \
                fewer handles, or a mask of fewer pieces"
        ),
        DeformError::MaskTooWinding { limit, operations } => format!(
            "distances inside the mask would take {operations} operations, and the limit is \
                {limit}; send fewer handles, or a mask that is less winding"
        ),
        DeformError::NoMetric { method } => format!(
            "the method `{method}` has no metric; `geodesic` needs `rigid`, `similarity` or \
                `affine`"
        ),
        DeformError::TooManyVertices { .. } => format!("{error}; send a larger `arap.cell`"),
        DeformError::MeshTooLarge {
            what,
            limit,
            actual,
        } => {
            let (amount, advice) = match what {
                MeshQuantity::Positions => (
                    format!("hold {actual} positions, which lines have at each cell"),
                    "fewer or shorter handles, or a larger `arap.cell`",
                ),
                MeshQuantity::Bytes => (
                    format!("take {actual} bytes, because many pieces lie in its cells"),
                    "a smaller `arap.cell`, or an image of fewer pieces",
                ),
                MeshQuantity::Operations => (
                    format!("take {actual} operations"),
                    "fewer handles, or a larger `arap.cell`",
                ),
            };
            format!(
                "the mesh of what the image shows would {amount}; the limit is {limit}; send \
                    {advice}"
            )
        }
        DeformError::NeedsMask { method } => format!(
            "the method `{method}` needs an image, whose outline its mesh follows; plans of the \
                package for npm without an outline, blends, and requests without an image have none"
        ),
        DeformError::NotFinite { .. }
        | DeformError::OutOfRange { .. }
        | DeformError::TooFewPlaces { .. }
        | DeformError::CountMismatch { .. }
        | DeformError::ShapeMismatch { .. }
        | DeformError::MissingInPose { .. }
        | DeformError::WeightCount { .. }
        | DeformError::BadWeight { .. }
        | DeformError::DepthCount { .. }
        | DeformError::BadDepth { .. }
        | DeformError::BadWithin { .. }
        | DeformError::DegenerateLine { .. }
        | DeformError::Contradictory { .. }
        | DeformError::TooManyMeetings { .. }
        | DeformError::TooManyNeighbours { .. }
        | DeformError::Cancelled
        | DeformError::NotTaken { .. }
        | DeformError::BadParameter { .. }
        | DeformError::AlphaOutOfRange { .. } => error.to_string(),
    }
}
