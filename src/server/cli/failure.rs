//! Why a subcommand failed, as the program prints it.

use std::fmt;
use std::path::Path;

use mlswarp::warp::WarpError;

use crate::problem::Problem;
use crate::problem::words::is_unseen;

/// Why a subcommand failed.
#[derive(Debug)]
pub enum Failure {
    /// A problem that a server would respond with, and the file or option that it is about, if that
    /// is known; printed as `code: FILE: detail (pointer)`.
    Problem(Problem, Option<String>),
    /// A problem with files or threads of this machine; printed as `error: ...`.
    Local(String),
}

impl Failure {
    /// A problem with a file or option, unless it names another one.
    pub(super) fn about(self, name: impl Into<String>) -> Self {
        match self {
            Self::Problem(problem, None) => Self::Problem(problem, Some(name.into())),
            other => other,
        }
    }
}

/// What messages call a file.
pub(super) fn name_of(path: &Path) -> String {
    if path == Path::new("-") {
        return "standard input".to_owned();
    }
    let name = path.to_string_lossy();
    if name.contains(is_unseen) {
        format!("{path:?}")
    } else {
        name.into_owned()
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Problem(
                Problem {
                    code,
                    detail,
                    pointer,
                    what,
                    ..
                },
                name,
            ) => {
                write!(f, "{}: ", code.as_str())?;
                name.as_ref().map_or(Ok(()), |name| write!(f, "{name}: "))?;
                write!(f, "{detail}")?;
                if let Some(flag) = what.and_then(flag) {
                    write!(f, "; see {flag}")?;
                }
                // An option is its own place.
                let is_option = name.as_ref().is_some_and(|name| name.starts_with("--"));
                pointer
                    .as_ref()
                    .filter(|_| !is_option)
                    .map_or(Ok(()), |pointer| write!(f, " ({pointer})"))
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
        "image_pixels" | "map_pixels" | "output_pixels" | "canvas_pixels" => {
            Some("--max-image-pixels")
        }
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
        Self::Problem(problem, None)
    }
}

impl From<WarpError> for Failure {
    fn from(error: WarpError) -> Self {
        Problem::from(error).into()
    }
}
