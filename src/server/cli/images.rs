//! The images of `mlswarp warp` and their output files. Everything that can be known before the
//! first image is drawn is checked here.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use mlswarp::codec::{Format, SourceFormat};

use super::failure::{Failure, name_of};
use super::input::{Limit, is_stdio, read};
use super::output::{by_extension, is_directory, require_directory, require_others};

/// Bytes in which the beginning of JSON is sought.
const JSON_HEAD_BYTES: usize = 1024;

/// A file of the command line.
#[derive(Debug)]
pub(super) struct InputFile {
    pub(super) path: PathBuf,
    /// Its content, if that can be read only once: of standard input, a pipe or a device.
    content: Option<Vec<u8>>,
}

impl InputFile {
    fn open(path: &Path, limit: Limit) -> Result<Self, Failure> {
        let is_stream = is_stdio(path) || path.exists() && !path.is_file();
        let content = is_stream.then(|| read("file", path, limit)).transpose()?;
        Ok(Self {
            path: path.to_owned(),
            content,
        })
    }

    /// Whether this is the warp object rather than an image.
    fn is_json(&self) -> bool {
        if self
            .path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("json"))
        {
            return true;
        }
        let mut head = Vec::new();
        match &self.content {
            Some(content) => head.extend(content.iter().take(JSON_HEAD_BYTES)),
            None => drop(
                File::open(&self.path)
                    .and_then(|file| file.take(JSON_HEAD_BYTES as u64).read_to_end(&mut head)),
            ),
        }
        let head = head.strip_prefix("\u{feff}".as_bytes()).unwrap_or(&head);
        head.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'{')
    }

    /// Reads all of it.
    /// Errors: As [`read`].
    pub(super) fn read(&self, what: &str, limit: Limit) -> Result<Vec<u8>, Failure> {
        self.content
            .clone()
            .map_or_else(|| read(what, &self.path, limit), Ok)
    }
}

/// The files of the command line.
#[derive(Debug)]
pub(super) struct Inputs {
    pub(super) images: Vec<InputFile>,
    pub(super) warp: Option<InputFile>,
}

impl Inputs {
    /// Tells the warp object from the images, and opens folders. `limit`: of a stream, bytes.
    /// Errors: Two warp objects, or no image.
    pub(super) fn of(files: &[PathBuf], limit: Limit) -> Result<Self, Failure> {
        let mut inputs = Self {
            images: Vec::new(),
            warp: None,
        };
        for path in files {
            if path.is_dir() {
                inputs
                    .images
                    .extend(images_in(path)?.into_iter().map(|path| InputFile {
                        path,
                        content: None,
                    }));
                continue;
            }
            let file = InputFile::open(path, limit)?;
            if !file.is_json() {
                inputs.images.push(file);
            } else if let Some(other) = inputs.warp.replace(file) {
                let both = [&other.path, path].map(|path| name_of(path));
                return Err(Failure::Local(format!(
                    "both {} and {} are JSON; give one warp object for all images",
                    both[0], both[1]
                )));
            }
        }
        if inputs.images.is_empty() {
            return Err(Failure::Local(
                "no image is given: all files are JSON, or the folder has no image files"
                    .to_owned(),
            ));
        }
        Ok(inputs)
    }
}

/// The image files of a folder, by name; not those of its folders.
fn images_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let cannot =
        |e: std::io::Error| Failure::Local(format!("cannot read the folder {folder:?}: {e}"));
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        let is_image = path.extension().is_some_and(|own| {
            mlswarp::format::source_extensions().any(|known| own.eq_ignore_ascii_case(known))
        });
        let is_hidden = path
            .file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with('.'));
        files.extend((is_image && !is_hidden && path.is_file()).then_some(path));
    }
    files.sort();
    Ok(files)
}

/// The file that belongs to an image: in a folder, the one with the name of the image and another
/// extension, which is no image. Errors: None, or several.
pub(super) fn companion(
    what: &str,
    path: &Path,
    image: &Path,
    is_image: bool,
) -> Result<PathBuf, Failure> {
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let cannot =
        |e: std::io::Error| Failure::Local(format!("cannot read the folder {path:?}: {e}"));
    let mut found = Vec::new();
    for entry in fs::read_dir(path).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        if path.file_stem() == image.file_stem()
            && path != image
            && path.is_file()
            && is_image_file(&path) == is_image
        {
            found.push(path);
        }
    }
    found.sort();
    match &found[..] {
        [file] => Ok(file.clone()),
        [] => Err(Failure::Local(format!(
            "the folder {path:?} has no {what} for {}",
            name_of(image)
        ))),
        [one, other, ..] => Err(Failure::Local(format!(
            "two {what}s for {}: {} and {}",
            name_of(image),
            name_of(one),
            name_of(other)
        ))),
    }
}

fn is_image_file(path: &Path) -> bool {
    let mut head = [0; 16];
    File::open(path)
        .and_then(|mut file| file.read(&mut head))
        .is_ok_and(|length| SourceFormat::of(&head[..length]).is_ok())
}

/// Where the images are written.
#[derive(Debug)]
pub(super) enum Outputs {
    /// One file.
    File(PathBuf, Format),
    /// One file of a folder for each image.
    Folder(PathBuf, Format),
}

impl Outputs {
    /// `format`: the one that is requested; otherwise the extension of a file selects it.
    /// Errors: An extension that is not known; a file for several images.
    pub(super) fn of(out: &Path, inputs: &Inputs, format: Option<Format>) -> Result<Self, Failure> {
        let of_format = |format: Format| {
            format
                .info()
                .extensions
                .iter()
                .map(move |end| (*end, format))
        };
        let known: Vec<_> = Format::ALL.into_iter().flat_map(of_format).collect();
        let count = inputs.images.len();
        let is_folder = is_directory(out)
            || count > 1 && !is_stdio(out) && !out.exists() && out.extension().is_none();
        if is_folder {
            return Ok(Self::Folder(out.to_owned(), format.unwrap_or_default()));
        }
        if count > 1 {
            let out = name_of(out);
            return Err(Failure::Local(format!(
                "{count} images cannot be written to {out}: give a folder, such as -o warped/"
            )));
        }
        // The file name takes the place of `Accept`.
        let format = format.map_or_else(
            || Ok(by_extension(out, &known, ", or a folder")?.unwrap_or_default()),
            Ok::<_, Failure>,
        )?;
        require_directory(out)?;
        Ok(Self::File(out.to_owned(), format))
    }

    pub(super) const fn format(&self) -> Format {
        match self {
            Self::File(_, format) | Self::Folder(_, format) => *format,
        }
    }

    /// The file of an image.
    /// Errors: Standard input has no name.
    fn file_of(&self, image: &Path) -> Result<PathBuf, Failure> {
        match self {
            Self::File(out, _) => Ok(out.clone()),
            Self::Folder(folder, format) => match image.file_stem().filter(|_| !is_stdio(image)) {
                Some(stem) => {
                    let mut name = stem.to_owned();
                    name.push(format!(".{}", format.extension()));
                    Ok(folder.join(name))
                }
                None => Err(Failure::Local(format!(
                    "{} has no name for a file in {folder:?}: give -o FILE",
                    name_of(image)
                ))),
            },
        }
    }

    /// The output file of each image. `others`: further files that are read. Errors: Two images
    /// have one output file, also where upper and lower case are not told apart; an output would
    /// replace an input.
    pub(super) fn files(
        &self,
        inputs: &Inputs,
        others: &[&PathBuf],
    ) -> Result<Vec<PathBuf>, Failure> {
        let mut images: HashMap<String, &Path> = HashMap::new();
        let mut files = Vec::new();
        let read: Vec<&PathBuf> = inputs
            .images
            .iter()
            .chain(&inputs.warp)
            .map(|file| &file.path)
            .chain(others.iter().copied())
            .collect();
        for InputFile { path, .. } in &inputs.images {
            let file = self.file_of(path)?;
            if let Some(other) = images.insert(file.to_string_lossy().to_lowercase(), path) {
                let detail = format!(
                    "{} and {} would both be written to {}",
                    name_of(other),
                    name_of(path),
                    name_of(&file)
                );
                return Err(Failure::Local(format!(
                    "{detail}: rename one, or write them to different folders"
                )));
            }
            files.push(file);
        }
        require_others(files.iter().map(PathBuf::as_path), read)?;
        Ok(files)
    }
}
