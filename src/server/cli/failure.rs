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
            Self::Problem(Problem { code, detail, pointer, .. }) => {
                write!(f, "{}: {detail}", code.as_str())?;
                pointer.as_ref().map_or(Ok(()), |pointer| write!(f, " ({pointer})"))
            }
            Self::Local(sentence) => write!(f, "error: {sentence}"),
        }
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
