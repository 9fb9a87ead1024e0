//! The output files of the subcommands. A file appears under its name only when it is complete; an
//! interrupted program leaves none.

use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, IsTerminal as _, Write};
use std::path::{Path, PathBuf, is_separator};
use std::sync::{Mutex, Once, PoisonError};

use super::failure::Failure;
use super::input::is_stdio;
use crate::http::connection::signals::Signals;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

/// The exit code of an interrupted program.
const INTERRUPTED_EXIT_CODE: i32 = 130;
/// The file that is being written. It is created, renamed and removed by the thread that holds the
/// lock.
static UNFINISHED_FILE: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Errors: The directory of the file does not exist.
pub(super) fn require_directory(out: &Path) -> Result<(), Failure> {
    match out.parent() {
        Some(directory) if !directory.as_os_str().is_empty() && !directory.is_dir() => {
            Err(Failure::Local(format!(
                "cannot write {out:?}: there is no directory {directory:?}"
            )))
        }
        _ => Ok(()),
    }
}

/// Whether a path names a folder: one that exists, or any name that ends with a slash.
pub(super) fn is_directory(out: &Path) -> bool {
    out.is_dir() || out.to_string_lossy().ends_with(is_separator)
}

/// Creates a folder unless it exists.
/// Errors: the folder cannot be created.
pub(super) fn create_directory(out: &Path) -> Result<(), Failure> {
    fs::create_dir_all(out).map_err(|e| cannot_write(out, &e))
}

/// Errors: The output is the same file as an input, which it would replace.
pub(super) fn require_other<'a>(
    out: &Path,
    inputs: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), Failure> {
    require_others([out], inputs)
}

/// The same for many outputs and many inputs.
/// Errors: As [`require_other`].
pub(super) fn require_others<'a, 'b>(
    outs: impl IntoIterator<Item = &'a Path>,
    inputs: impl IntoIterator<Item = &'b PathBuf>,
) -> Result<(), Failure> {
    let file = |path: &Path| fs::canonicalize(path).ok().filter(|path| path.is_file());
    let mut written = outs
        .into_iter()
        .filter_map(|out| Some((out, file(out)?)))
        .peekable();
    if written.peek().is_none() {
        return Ok(());
    }
    let read: HashSet<PathBuf> = inputs.into_iter().filter_map(|input| file(input)).collect();
    match written.find(|(_, file)| read.contains(file)) {
        Some((out, _)) => Err(Failure::Local(format!(
            "{out:?} is an input and would be replaced: give another output"
        ))),
        None => Ok(()),
    }
}

/// The value of the file's extension in `known`; `None` without an extension.
/// Errors: An extension that is not known; `more` is appended to the list of those that are.
pub(super) fn by_extension<T: Copy>(
    out: &Path,
    known: &[(&str, T)],
    more: &str,
) -> Result<Option<T>, Problem> {
    let Some(extension) = out.extension() else {
        return Ok(None);
    };
    let extension = extension.to_string_lossy().to_ascii_lowercase();
    if let Some((_, value)) = known.iter().find(|(name, _)| *name == extension) {
        return Ok(Some(*value));
    }
    let extensions: Vec<String> = known.iter().map(|(name, _)| format!(".{name}")).collect();
    let extension = quote(&format!(".{extension}"));
    let detail = format!(
        "cannot write {out:?}: {extension} is not supported; supported: {}{more}",
        extensions.join(", ")
    );
    Err(Problem::new(Code::UnsupportedFormat, detail))
}

/// A file or standard output that is being written.
pub(super) struct OutputFile<'a> {
    out: &'a Path,
    file: BufWriter<Box<dyn Write + Send>>,
}

impl OutputFile<'_> {
    /// Appends bytes.
    /// Errors: the bytes cannot be written.
    pub(super) fn put(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        self.file
            .write_all(bytes)
            .map_err(|e| cannot_write(self.out, &e))
    }

    /// Ends the line of a terminal.
    /// Errors: As [`Self::put`].
    pub(super) fn end_line(&mut self) -> Result<(), Failure> {
        if is_stdio(self.out) && io::stdout().is_terminal() {
            self.put(b"\n")
        } else {
            Ok(())
        }
    }
}

fn cannot_write(out: &Path, e: &io::Error) -> Failure {
    let name = if is_stdio(out) {
        "standard output".to_owned()
    } else {
        format!("{out:?}")
    };
    Failure::Local(format!("cannot write {name}: {e}"))
}

/// Writes text to a file or standard output. Errors: As [`write`].
pub(super) fn write_text(out: &Path, text: &[u8]) -> Result<(), Failure> {
    write(out, |sink| {
        sink.put(text)?;
        sink.end_line()
    })
}

/// Writes a file or standard output by `content`.
/// Errors: the file cannot be written; those of `content`.
pub(super) fn write(
    out: &Path,
    content: impl FnOnce(&mut OutputFile<'_>) -> Result<(), Failure>,
) -> Result<(), Failure> {
    if is_stdio(out) {
        return fill(out, Box::new(io::stdout()), content);
    }
    if out.exists() && !out.is_file() || out.is_symlink() {
        // A device, a pipe or a link that is named is meant, and not replaced.
        let file = File::options()
            .write(true)
            .create(true)
            .truncate(true)
            .open(out);
        return fill(
            out,
            Box::new(file.map_err(|e| cannot_write(out, &e))?),
            content,
        );
    }
    replace(out, content)
}

fn fill(
    out: &Path,
    file: Box<dyn Write + Send>,
    content: impl FnOnce(&mut OutputFile<'_>) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut sink = OutputFile {
        out,
        file: BufWriter::new(file),
    };
    content(&mut sink)?;
    sink.file.flush().map_err(|e| cannot_write(out, &e))
}

/// Writes a file of a folder by `content`. What has its name is replaced, and never written
/// through: who else may write the folder could have put a link there. Errors: the file
/// cannot be written; those of `content`.
pub(super) fn replace(
    out: &Path,
    content: impl FnOnce(&mut OutputFile<'_>) -> Result<(), Failure>,
) -> Result<(), Failure> {
    // A file beside it is renamed when it is complete.
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let path = out.with_file_name(name);
    watch_signals();
    let part = || {
        UNFINISHED_FILE
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    };
    let created = {
        let mut part = part();
        *part = Some(path.clone());
        // One that an earlier process with this number has left; a link that is put there in
        // between is not followed.
        let _ = fs::remove_file(&path);
        File::create_new(&path)
    };
    let written = created
        .map_err(|e| cannot_write(out, &e))
        .and_then(|file| fill(out, Box::new(file), content));
    let mut part = part();
    *part = None;
    let renamed = written.and_then(|()| fs::rename(&path, out).map_err(|e| cannot_write(out, &e)));
    // It may not exist.
    renamed.inspect_err(|_| drop(fs::remove_file(&path)))
}

/// Removes the incomplete file and ends the program at SIGTERM or Ctrl-C. Without signals, the
/// system ends the program.
fn watch_signals() {
    static STARTED: Once = Once::new();
    STARTED.call_once(|| {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
        else {
            return;
        };
        let signals = {
            let _entered = runtime.enter();
            Signals::stop()
        };
        let Ok(mut signals) = signals else { return };
        std::thread::spawn(move || {
            runtime.block_on(signals.recv());
            let part = UNFINISHED_FILE
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            if let Some(path) = &*part {
                let _ = fs::remove_file(path);
            }
            #[expect(
                clippy::exit,
                reason = "this thread has no caller that could end the program"
            )]
            std::process::exit(INTERRUPTED_EXIT_CODE);
        });
    });
}
