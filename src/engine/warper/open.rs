//! Image files: opened, and written in any format.

use std::fs::File;
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::{error, fmt};

use super::Rendering;
use crate::deform::IsCancelled;
use crate::format::Format;
use crate::parallel::current_num_threads;
use crate::warp::{Image, LabelImage, Limits, RenderJob, Stage, WarpError, WriteObserver};

/// Why a file was not read or written.
#[derive(Debug)]
pub enum FileError {
    /// The file system, or whatever the bytes are written to.
    Io(io::Error),
    /// The end of the name is that of no format that is written.
    Extension(PathBuf),
    /// What is in the file, or the warp.
    Warp(WarpError),
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => error.fmt(f),
            Self::Warp(error) => error.fmt(f),
            Self::Extension(path) => write!(
                f,
                "{} has no ending of a format that is written: {}",
                path.display(),
                Format::ALL.map(Format::extension).join(", ")
            ),
        }
    }
}

impl error::Error for FileError {}

impl From<io::Error> for FileError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<WarpError> for FileError {
    fn from(error: WarpError) -> Self {
        Self::Warp(error)
    }
}

impl Image {
    /// Reads an image file of any format, within the default limits.
    ///
    /// # Errors
    /// A file that cannot be read; one that is damaged or too large.
    ///
    /// ```
    /// let image = mlswarp::Image::open("test_files/images/chelsea.png")?;
    /// assert_eq!(image.extent().width(), 451);
    /// # Ok::<(), mlswarp::FileError>(())
    /// ```
    pub fn open(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let file = std::fs::read(path)?;
        Ok(Self::decode(&file, &Limits::default().image, &|| false)?)
    }
}

impl LabelImage {
    /// Reads a file of labels, within the default limits.
    ///
    /// # Errors
    /// Those of [`Image::open`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let file = std::fs::read(path)?;
        Ok(Self::decode(&file, &Limits::default(), &|| false)?)
    }
}

/// Stops a writer.
struct Watch<'a>(IsCancelled<'a>);

impl WriteObserver for Watch<'_> {
    fn around(&self, _stage: Stage, work: &mut dyn FnMut()) {
        work();
    }

    fn is_wanted(&self) -> bool {
        !(self.0)()
    }
}

impl Rendering<'_> {
    /// Writes a file of the format that the end of its name says. After an error, the file may be
    /// there in part.
    ///
    /// # Errors
    /// An unknown ending; a file that cannot be written; those of [`Rendering::file`].
    ///
    /// ```
    /// # use mlswarp::{Image, Warper};
    /// let image = Image::from_grey8(64, 48, vec![128; 64 * 48])?;
    /// let posed = Warper::new(image.extent(), &[[9.0, 9.0]])?.pose(&[[12.0, 9.0]])?;
    /// let path = std::env::temp_dir().join(format!("mlswarp-{}.webp", std::process::id()));
    /// posed.render(&image)?.save(&path)?;
    /// assert_eq!(Image::open(&path)?.extent(), image.extent());
    /// assert!(posed.render(&image)?.save("grey.xcf").is_err());
    /// # std::fs::remove_file(path)?;
    /// # Ok::<(), mlswarp::FileError>(())
    /// ```
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), FileError> {
        let path = path.as_ref();
        let format = path
            .extension()
            .and_then(|extension| Format::of_extension(extension.to_str()?))
            .ok_or_else(|| FileError::Extension(path.to_owned()))?;
        // What cannot be drawn leaves an existing file as it was.
        let job = self.job(format)?;
        self.write_job(&job, &mut File::create(path)?)
    }

    /// Writes a file to a stream, strip by strip.
    ///
    /// # Errors
    /// Those of [`Rendering::file`], and of the stream.
    ///
    /// ```
    /// # use mlswarp::{Image, Warper};
    /// use mlswarp::format::Format;
    /// let image = Image::from_rgba16(1, 1, vec![1, 2, 3, 65_535])?;
    /// let posed = Warper::new(image.extent(), &[[0.5, 0.5]])?.pose(&[[0.5, 0.5]])?;
    /// let mut tiff = Vec::new();
    /// posed.render(&image)?.write(Format::Tiff, &mut tiff)?;
    /// assert_eq!(tiff, posed.render(&image)?.file(Format::Tiff)?);
    /// # Ok::<(), mlswarp::FileError>(())
    /// ```
    pub fn write(&self, format: Format, out: &mut (dyn Write + Send)) -> Result<(), FileError> {
        self.write_job(&self.job(format)?, out)
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// Labels in a format that would change them; a value outside that the samples cannot have; a
    /// size over the limits; cancelled.
    pub fn file(&self, format: Format) -> Result<Vec<u8>, WarpError> {
        let mut file = Vec::new();
        match self.write(format, &mut file) {
            Ok(()) => Ok(file),
            Err(FileError::Warp(error)) => Err(error),
            // A vector takes all bytes.
            Err(FileError::Io(_) | FileError::Extension(_)) => Err(WarpError::Cancelled),
        }
    }

    fn job(&self, format: Format) -> Result<RenderJob, WarpError> {
        let output = crate::warp::OutputSpec {
            format,
            ..*self.output()
        };
        let (source, posed) = (self.source(), self.posed().posed_mesh());
        let warper = self.posed().warper();
        warper.cancellable(|cancelled| {
            RenderJob::new(source, posed, &output, warper.limits(), cancelled)
        })
    }

    fn write_job(&self, job: &RenderJob, out: &mut (dyn Write + Send)) -> Result<(), FileError> {
        let mut failed = None;
        let mut sink = |bytes: Vec<u8>| match out.write_all(&bytes) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(error);
                ControlFlow::Break(())
            }
        };
        let helpers = current_num_threads() - 1;
        let written = self
            .posed()
            .warper()
            .cancellable(|cancelled| job.write(helpers, &Watch(cancelled), &mut sink));
        match (written, failed) {
            (ControlFlow::Continue(()), _) => Ok(()),
            (ControlFlow::Break(()), Some(error)) => Err(error.into()),
            (ControlFlow::Break(()), None) => Err(WarpError::Cancelled.into()),
        }
    }
}
