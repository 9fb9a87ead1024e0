//! Errors of reading a file, by what the client can change.

use thiserror::Error;

/// Why a file was not decoded.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum CodecError {
    /// Not a supported format.
    #[error("unsupported image format: {found}; supported: PNG, JPEG, WebP, TIFF, GIF, BMP")]
    Unsupported {
        /// Description of the first bytes.
        found: String,
    },
    /// The header exceeds a limit. Detected before memory is allocated.
    #[error("{}; the limit is {limit}", measured(what, *actual))]
    TooLarge {
        /// Which limit: `image_pixels`, `image_side`, `image_frames`; `image_bytes` if the machine
        /// has too little memory.
        what: &'static str,
        /// The limit.
        limit: u64,
        /// The value in the header.
        actual: u64,
    },
    /// Truncated or conflicting data.
    #[error("the {format} file cannot be decoded: {detail}")]
    Bad {
        /// The format that the first bytes indicate.
        format: &'static str,
        /// The decoder's message.
        detail: String,
    },
    /// Cancelled; nothing is known about the file.
    #[error("cancelled: the result is no longer needed")]
    Cancelled,
}

impl CodecError {
    /// A damaged file, with the decoder's message.
    pub(super) fn bad(format: &'static str, detail: impl ToString) -> Self {
        Self::Bad {
            format,
            detail: detail.to_string(),
        }
    }

    /// A well-formed file of an unsupported kind.
    pub(super) fn unsupported(found: impl Into<String>) -> Self {
        Self::Unsupported {
            found: found.into(),
        }
    }
}

/// Describes the value in the header; `what` as in [`CodecError::TooLarge`].
fn measured(what: &str, actual: u64) -> String {
    match what {
        "image_pixels" => format!("the image has {actual} pixels"),
        "image_side" => format!("the longer side of the image is {actual} px"),
        "image_frames" => format!("the file has {actual} frames or pages"),
        _ => format!("{what}: {actual}"),
    }
}
