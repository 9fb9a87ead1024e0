//! Why a subcommand failed, as the program prints it.

use std::fmt;

use mlswarp::warp::WarpError;

use crate::problem::Problem;

/// Why a subcommand failed.
#[derive(Debug)]
pub enum Failure {
    /// A problem that a server would respond with; printed as `code: detail (pointer)`.
    Problem(Problem),
    /// A problem with files or threads of this machine; printed as `error: ...`.
    Local(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Problem(Problem { code, detail, pointer, what, .. }) => {
                write!(f, "{}: {detail}", code.as_str())?;
                if let Some(flag) = what.and_then(flag) {
                    write!(f, "; see {flag}")?;
                }
                pointer.as_ref().map_or(Ok(()), |pointer| write!(f, " ({pointer})"))
            }
            Self::Local(sentence) => write!(f, "error: {sentence}"),
        }
    }
}

/// The option that sets a limit.
fn flag(what: &str) -> Option<&'static str> {
    match what {
        "body_bytes" => Some("--max-body-bytes"),
        "json_bytes" | "warp_json_bytes" => Some("--max-warp-json-bytes"),
        "image_pixels" | "map_pixels" | "output_pixels" | "canvas_pixels" => Some("--max-image-pixels"),
        "image_side" | "map_side" | "output_side" | "canvas_side" => Some("--max-image-side"),
        "handle_columns" => Some("--max-columns"),
        "fit_handles" => Some("--max-fit-handles"),
        "grid_vertices" => Some("--max-plan-bytes"),
        "memory_bytes" | "client_upload_bytes" | "unread_bytes" => Some("--memory-bytes"),
        _ => None,
    }
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

impl From<WarpError> for Failure {
    fn from(error: WarpError) -> Self {
        Self::Problem(error.into())
    }
}
