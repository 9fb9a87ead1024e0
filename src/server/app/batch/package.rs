//! The file of a batch: a zip archive or an animation, written frame by frame into memory.

use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use mlswarp::codec::{Animation, CodecError, Format, GifAnimation};
use zip::result::ZipError;
use zip::write::{PreparedZipFile, SimpleFileOptions, StreamWriter};
use zip::{CompressionMethod, DateTime, System, ZipWriter};

use crate::problem::{Code, Problem};

/// How long an animation shows a frame unless it is requested, ms.
pub(crate) const DEFAULT_DELAY_MS: u16 = 40;
/// The name of the index.
pub(super) const INDEX_NAME: &str = "frames.json";
/// Memory of an entry in the directory of an archive, bytes.
const ENTRY_BYTES: u64 = 512;

/// The kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BatchForm {
    /// Images, annotations and the index.
    Zip,
    /// Images of one size.
    Apng,
    /// Images of one size and few colours.
    Gif,
}

impl BatchForm {
    /// All kinds, the default first.
    pub const ALL: [Self; 3] = [Self::Zip, Self::Apng, Self::Gif];

    /// The media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Zip => "application/zip",
            Self::Apng => "image/apng",
            Self::Gif => "image/gif",
        }
    }

    /// The format of its images; an archive has that of the request.
    pub(crate) const fn frame_format(self) -> Option<Format> {
        match self {
            Self::Zip => None,
            Self::Apng => Some(Format::Png),
            Self::Gif => Some(Format::Gif),
        }
    }

    /// Whether it is an animation: its images have one size, and nothing else is in the file.
    pub(crate) const fn is_animation(self) -> bool {
        matches!(self, Self::Apng | Self::Gif)
    }

    /// Upper bound of the memory for the directory and the index of a file, bytes.
    pub(crate) const fn directory_bytes(self, frames: u32, files_per_frame: u32) -> u64 {
        match self {
            Self::Zip => (frames as u64 * (files_per_frame as u64 + 1) + 1) * ENTRY_BYTES,
            Self::Apng | Self::Gif => 0,
        }
    }

    /// Prepares the files of a frame; all but the first are left out of an animation. CPU work: a
    /// copy and its checksum.
    pub(crate) fn pack(self, files: Vec<(String, Bytes)>) -> Result<PackedFrame, Problem> {
        let bytes = files.iter().map(|(_, bytes)| bytes.len()).sum();
        let packed = match self {
            Self::Zip => {
                let entries = files.into_iter().map(|(name, bytes)| entry(&name, &bytes));
                Packed::Entries(entries.collect::<Result<_, _>>()?)
            }
            Self::Apng | Self::Gif => Packed::Picture(
                files
                    .into_iter()
                    .next()
                    .map(|(_, bytes)| bytes)
                    .unwrap_or_default(),
            ),
        };
        Ok(PackedFrame { bytes, packed })
    }
}

/// A frame that is ready to be appended.
pub(crate) struct PackedFrame {
    bytes: usize,
    packed: Packed,
}

enum Packed {
    Entries(Vec<PreparedZipFile>),
    Picture(Bytes),
}

impl PackedFrame {
    /// Bytes of its files.
    pub(crate) const fn bytes(&self) -> usize {
        self.bytes
    }
}

/// A file that is being written.
pub(crate) struct Package(Writer);

enum Writer {
    Zip {
        writer: Box<ZipWriter<StreamWriter<Written>>>,
        written: Written,
    },
    Apng(Animation),
    Gif(GifAnimation),
}

impl Package {
    /// `delay`: how long an animation shows each frame, ms. `plays`: how often it is played; 0 is
    /// without end.
    pub(crate) fn new(form: BatchForm, frames: u32, delay: u16, plays: u16) -> Self {
        match form {
            BatchForm::Zip => {
                let written = Written::default();
                // Every size is known before its entry is written, so that nothing is sought and no
                // entry needs a data descriptor.
                let writer = Box::new(ZipWriter::new(StreamWriter::new(written.clone())));
                Self(Writer::Zip { writer, written })
            }
            BatchForm::Apng => Self(Writer::Apng(Animation::new(frames, delay, plays))),
            BatchForm::Gif => Self(Writer::Gif(GifAnimation::new(delay, plays))),
        }
    }

    /// Appends a frame; returns the bytes that it adds to the file.
    pub(crate) fn push(&mut self, frame: PackedFrame) -> Result<Vec<u8>, Problem> {
        let mut out = Vec::new();
        let pushed = |pushed: Result<(), CodecError>| {
            pushed.map_err(|error| Problem::new(Code::Internal, error.to_string()))
        };
        match (&mut self.0, frame.packed) {
            (Writer::Zip { writer, written }, Packed::Entries(entries)) => {
                for entry in entries {
                    writer
                        .add_prepared_file(entry)
                        .map_err(|error| not_written(&error))?;
                }
                Ok(written.take())
            }
            (Writer::Apng(animation), Packed::Picture(file)) => {
                pushed(animation.push(&file, &mut out)).map(|()| out)
            }
            (Writer::Gif(animation), Packed::Picture(file)) => {
                pushed(animation.push(&file, &mut out)).map(|()| out)
            }
            _ => Err(Problem::new(
                Code::Internal,
                "a frame of another kind of file",
            )),
        }
    }

    /// The last bytes of the file. `name`, `index`: the JSON of all frames, which an animation does
    /// not have.
    pub(crate) fn finish(self, name: &str, index: &[u8]) -> Result<Vec<u8>, Problem> {
        match self.0 {
            Writer::Zip {
                mut writer,
                written,
            } => {
                writer
                    .add_prepared_file(entry(name, index)?)
                    .and_then(|()| writer.finish())
                    .map_err(|error| not_written(&error))?;
                Ok(written.take())
            }
            Writer::Apng(_) => Ok(Animation::tail()),
            Writer::Gif(_) => Ok(GifAnimation::tail()),
        }
    }
}

/// An entry that is stored as it is, because images do not compress. Its metadata are the same on
/// every machine and at every time.
fn entry(name: &str, bytes: &[u8]) -> Result<PreparedZipFile, Problem> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::DEFAULT);
    PreparedZipFile::from_data(
        name,
        options.unix_permissions(0o644).system(System::Unix),
        bytes,
    )
    .map_err(|error| not_written(&error))
}

fn not_written(error: &ZipError) -> Problem {
    Problem::new(
        Code::Internal,
        format!("the archive could not be written: {error}"),
    )
}

/// The bytes that an archive's writer has written and that have not been taken yet.
#[derive(Clone, Default)]
struct Written(Arc<Mutex<Vec<u8>>>);

impl Written {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Write for Written {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Read as _};

    use super::*;

    fn file(frames: u32) -> Vec<u8> {
        let mut package = Package::new(BatchForm::Zip, frames, DEFAULT_DELAY_MS, 0);
        let mut out = Vec::new();
        for k in 0..frames {
            let files = vec![
                (format!("{k:04}.png"), Bytes::from(vec![7; 100])),
                (format!("{k:04}.json"), Bytes::from_static(b"{}")),
            ];
            let bytes = package.push(BatchForm::Zip.pack(files).unwrap()).unwrap();
            assert!(
                bytes.len() > 102 && bytes.len() < 400,
                "an entry appears when its frame is done: {}",
                bytes.len()
            );
            out.extend(bytes);
        }
        out.extend(package.finish(INDEX_NAME, b"{\"frames\": []}").unwrap());
        out
    }

    #[test]
    fn an_archive_has_stored_entries_with_their_sizes_before_them() {
        let out = file(3);
        assert_eq!(out, file(3));
        let mut archive = zip::ZipArchive::new(Cursor::new(&out)).unwrap();
        let names: Vec<String> = (0..archive.len())
            .map(|k| archive.by_index(k).unwrap().name().unwrap().into_owned())
            .collect();
        assert_eq!(
            names,
            [
                "0000.png",
                "0000.json",
                "0001.png",
                "0001.json",
                "0002.png",
                "0002.json",
                "frames.json"
            ]
        );
        for k in 0..archive.len() {
            let mut entry = archive.by_index(k).unwrap();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            let header = usize::try_from(entry.header_start()).unwrap();
            // Flags without bit 3; the length before the bytes; 1980-01-01.
            assert_eq!(
                u16::from_le_bytes([out[header + 6], out[header + 7]]) & 8,
                0
            );
            assert_eq!(
                u32::from_le_bytes(out[header + 18..header + 22].try_into().unwrap()) as usize,
                bytes.len()
            );
            assert_eq!(
                (entry.compression(), entry.last_modified()),
                (CompressionMethod::Stored, Some(DateTime::DEFAULT))
            );
        }
    }

    #[test]
    fn more_entries_than_16_bits_count_are_an_archive_too() {
        let mut package = Package::new(BatchForm::Zip, 10_000, DEFAULT_DELAY_MS, 0);
        let mut out = Vec::new();
        for k in 0..10_000 {
            let files = (0..7)
                .map(|layer| (format!("{k:04}.{layer}.png"), Bytes::from_static(b"x")))
                .collect();
            out.extend(package.push(BatchForm::Zip.pack(files).unwrap()).unwrap());
        }
        out.extend(package.finish(INDEX_NAME, b"{}").unwrap());
        let mut archive = zip::ZipArchive::new(Cursor::new(&out)).unwrap();
        assert_eq!(archive.len(), 70_001);
        assert_eq!(archive.by_name("9999.6.png").unwrap().size(), 1);
    }
}
