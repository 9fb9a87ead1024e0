//! Errors of reading a file, by what the client can change.

use std::fmt;

/// Why a file was not decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CodecError {
    /// Not a supported format.
    Unsupported {
        /// Description of the first bytes.
        found: String,
    },
    /// The header exceeds a limit. Detected before memory is allocated.
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
    Bad {
        /// The format that the first bytes indicate.
        format: &'static str,
        /// The decoder's message.
        detail: String,
    },
    /// Cancelled; nothing is known about the file.
    Cancelled,
}

impl fmt::Display for CodecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unsupported { found } => write!(
                f,
                "unsupported image format: {found}; supported: {}",
                super::source_names()
            ),
            Self::TooLarge {
                what,
                limit,
                actual,
            } => write!(f, "{}; the limit is {limit}", measured(what, *actual)),
            Self::Bad { format, detail } => {
                write!(f, "the {format} file cannot be decoded: {detail}")
            }
            Self::Cancelled => f.write_str("cancelled: the result is no longer needed"),
        }
    }
}

impl std::error::Error for CodecError {}

impl CodecError {
    /// A damaged file, with the decoder's message.
    #[cfg(feature = "codec")]
    pub(crate) fn bad(format: &'static str, detail: impl ToString) -> Self {
        Self::Bad {
            format,
            detail: detail.to_string(),
        }
    }

    /// A well-formed file of an unsupported kind.
    pub(crate) fn unsupported(found: impl Into<String>) -> Self {
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
