//! What can be wrong with an uploaded file, sorted by who has to act.

use thiserror::Error;

/// Why a file was not decoded.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CodecError {
    /// Not a format that is read here. The client sends another format.
    #[error("not an image that is read here: {found}; supported: PNG, JPEG, WebP")]
    Unsupported {
        /// What the first bytes look like.
        found: String,
    },
    /// The header asks for more than is allowed. Decided before memory is taken.
    #[error("{}; at most {limit}", measured(what, *actual))]
    TooLarge {
        /// Which limit: `image_pixels`, `image_side`, `image_frames`; `image_bytes` when the machine itself has no room.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// What the header says.
        actual: u64,
    },
    /// Truncated or contradictory data.
    #[error("the {format} file cannot be decoded: {detail}")]
    Bad {
        /// The format that the first bytes promise.
        format: &'static str,
        /// The decoder's words.
        detail: String,
    },
    /// The picture is no longer wanted; nothing is known about the file.
    #[error("the picture is no longer wanted")]
    Cancelled,
}

impl CodecError {
    /// A damaged file, in the decoder's words.
    pub(super) fn bad(format: &'static str, detail: impl ToString) -> Self {
        Self::Bad { format, detail: detail.to_string() }
    }

    /// A well-formed file of a kind that is not read.
    pub(super) fn unsupported(found: impl Into<String>) -> Self {
        Self::Unsupported { found: found.into() }
    }
}

/// What the header says, in words; `what` as in [`CodecError::TooLarge`].
fn measured(what: &str, actual: u64) -> String {
    match what {
        "image_pixels" => format!("the picture has {actual} pixels"),
        "image_side" => format!("the picture has a side of {actual} px"),
        "image_frames" => format!("the file is an animation of {actual} frames"),
        _ => format!("{what}: {actual}"),
    }
}
