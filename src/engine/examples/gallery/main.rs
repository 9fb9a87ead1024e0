//! The figures of the paper (Schaefer, McPhail, Warren 2006) on free images, and what the paper
//! names as future work: `cargo run --example gallery -- FOLDER` draws each as a strip of panels,
//! and a page with what it shows. Those in the guide are made so.

#![expect(clippy::print_stdout, reason = "a program that shows its result")]

pub(crate) mod figures;
pub(crate) mod strip;

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use figures::{FIGURES, PaperFigure};
use mlswarp::Image;
use mlswarp::codec::ImageLimits;
use mlswarp::render::Source;
use mlswarp::warp::RestMask;
use strip::PanelStrip;

/// A photograph, as it is warped and as it is drawn.
pub(crate) struct Picture {
    pub(crate) image: Image,
    pub(crate) source: Arc<Source>,
    pub(crate) mask: RestMask,
}

impl Picture {
    /// Errors: The file cannot be read.
    pub(crate) fn open(path: &Path) -> Result<Self, Box<dyn Error>> {
        let file = std::fs::read(path)?;
        let pixmap = mlswarp::codec::decode(&file, &ImageLimits::default(), &|| false)?.pixmap;
        let image = Image::decode(&file, &ImageLimits::default(), &|| false)?;
        let mask = RestMask::of_image(&image, None, RestMask::THRESHOLD, &|| false);
        Ok(Self {
            mask: mask.ok_or("nothing cancels it")?,
            source: Arc::new(Source::new(pixmap)),
            image,
        })
    }
}

/// Draws a figure; `images`: the folder of the photographs.
///
/// Errors: A photograph cannot be read; handles that cannot be posed.
pub(crate) fn draw(figure: &PaperFigure, images: &Path) -> Result<PanelStrip, Box<dyn Error>> {
    let picture = Picture::open(&images.join(figure.image))?;
    let mut strip = PanelStrip::new(figure.canvas, figure.panels.len());
    for (index, panel) in figure.panels.iter().enumerate() {
        let mesh = panel.mesh(figure, &picture)?;
        strip.draw(index, &picture.source, &mesh);
        for handle in panel.shown(figure) {
            strip.mark(index, &handle);
        }
    }
    Ok(strip)
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("where to? give a folder")?;
    let images = concat!(env!("CARGO_MANIFEST_DIR"), "/test_files/images");
    let mut page = String::from("<!doctype html>\n<title>The paper's figures</title>\n");
    for figure in &FIGURES {
        let file = format!("{}.jpg", figure.name);
        std::fs::write(
            Path::new(&folder).join(&file),
            draw(figure, Path::new(images))?.jpeg()?,
        )?;
        let captions: Vec<&str> = figure.panels.iter().map(|panel| panel.caption).collect();
        let (title, claim) = (figure.title, figure.claim);
        writeln!(
            page,
            "<h2>{title}</h2>\n<img src=\"{file}\">\n<p>{}</p>\n<p>{claim}</p>",
            captions.join(" · ")
        )?;
        println!("{file}: {title}");
    }
    std::fs::write(Path::new(&folder).join("index.html"), page)?;
    Ok(())
}
