//! The frames of an animation, an archive or a folder, as `mlswarp batch` and `mlswarp blend` write
//! them.

use std::io::{self, Cursor, IsTerminal as _, Read as _, Write as _};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use mlswarp::codec::Format;
use serde_json::Value;
use zip::read::read_zipfile_from_stream;

use super::failure::Failure;
use super::output;
use crate::app::batch::BatchForm;
use crate::wire::{EnumName as _, Merged};

/// Characters of the progress bar.
const BAR_CHARACTERS: usize = 40;

/// What frames are written to.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum FramesOutput {
    File(BatchForm),
    /// The files of the archive.
    Directory,
}

impl FramesOutput {
    /// What the use case makes; the files of a directory come in an archive.
    pub(super) fn form(self) -> BatchForm {
        match self {
            Self::File(form) => form,
            Self::Directory => BatchForm::Zip,
        }
    }

    /// Writes the file or the folder, part by part. `inputs`: files that must stay. Errors: Those
    /// of `next`; what cannot be written.
    pub(super) fn write(
        self,
        out: &Path,
        (first, mut next): (Bytes, impl FnMut() -> Result<Option<Bytes>, Failure>),
        progress: &ProgressBar,
        inputs: &[PathBuf],
    ) -> Result<(), Failure> {
        let mut each = |take: &mut dyn FnMut(Bytes) -> Result<(), Failure>| {
            let (mut done, mut part) = (0, Some(first.clone()));
            while let Some(bytes) = part {
                take(bytes)?;
                done += 1;
                progress.show(done);
                part = next()?;
            }
            Ok(())
        };
        match self {
            Self::File(_) => output::write(out, |sink| each(&mut |part| sink.put(&part))),
            Self::Directory => {
                output::create_directory(out)?;
                each(&mut |part| extract(out, &part, inputs))
            }
        }
    }
}

/// A number of things: `1 frame`, `7 frames`.
pub(super) fn number_of(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// What was written, and what else is to be said.
pub(super) fn with_summary(what: String, more: Option<String>) -> String {
    more.map_or(what.clone(), |more| format!("{what}, {more}"))
}

/// The format of the images, and how they become JPEG. A wrong name is left to its parser.
pub(super) fn format_of(kind: FramesOutput, merged: &Merged) -> (Format, &'static str) {
    let output: Value = merged
        .value("output")
        .and_then(|text| serde_json::from_str(text).ok())
        .unwrap_or_default();
    let of_name = |name| {
        Format::ALL
            .into_iter()
            .find(|format| format.as_str() == name)
            .unwrap_or(Format::Jpeg)
    };
    let named = output["format"].as_str().map_or(Format::Png, of_name);
    match kind.form().frame_format() {
        Some(format) => (
            format,
            "leave it out, or give a .zip or a folder and --format jpeg",
        ),
        None => (named, "give --format jpeg"),
    }
}

/// Writes the files in a part of an archive, which has whole entries.
fn extract(directory: &Path, part: &[u8], inputs: &[PathBuf]) -> Result<(), Failure> {
    let broken = |e: &dyn std::fmt::Display| Failure::Local(format!("cannot read the batch: {e}"));
    let mut part = Cursor::new(part);
    while part.position() < part.get_ref().len() as u64 {
        let Some(mut entry) = read_zipfile_from_stream(&mut part).map_err(|e| broken(&e))? else {
            return Ok(());
        };
        let (name, mut bytes) = (
            entry.name().map_err(|e| broken(&e))?.into_owned(),
            Vec::new(),
        );
        entry.read_to_end(&mut bytes).map_err(|e| broken(&e))?;
        let file = directory.join(name);
        output::require_other(&file, inputs)?;
        output::replace(&file, |sink| sink.put(&bytes))?;
    }
    Ok(())
}

/// A bar on the terminal.
pub(super) struct ProgressBar {
    frames: u32,
    is_shown: bool,
}

impl ProgressBar {
    /// `is_quiet`: whether it is never shown.
    pub(super) fn new(frames: u32, is_quiet: bool) -> Self {
        Self {
            frames,
            is_shown: !is_quiet && io::stderr().is_terminal(),
        }
    }

    /// The last part of the file is not a frame.
    pub(super) fn show(&self, done: u32) {
        let done = done.min(self.frames);
        if self.is_shown {
            let full = BAR_CHARACTERS * done as usize / self.frames.max(1) as usize;
            let _ = write!(
                io::stderr(),
                "\r[{}{}] {done} of {} frames",
                "=".repeat(full),
                " ".repeat(BAR_CHARACTERS - full),
                self.frames
            );
        }
    }
}

impl Drop for ProgressBar {
    fn drop(&mut self) {
        if self.is_shown {
            // Erases the line.
            let _ = write!(io::stderr(), "\r\x1b[K");
        }
    }
}
