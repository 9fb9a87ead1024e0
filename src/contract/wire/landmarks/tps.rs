//! Landmarks of tpsDig, `.tps`: for each specimen `LM=` with the number of landmarks and one in a
//! line, then `CURVES=` with `POINTS=` for each curve, and `IMAGE=`, `ID=` and `SCALE=` in any
//! order. A specimen is an item, named by its image and its id. Curves become polylines, after the
//! landmarks. Two negative coordinates are a landmark that is missing.
//!
//! Source: geomorph (`scanTPS` in `R/geomorph.support.code.r`; `readland.tps`: "software packages
//! that record missing values as negative coordinates (e.g. tpsDig)") and ml-morph (`utils.py`,
//! which turns y over as H - y). The origin is the lower left corner of the image and y points up,
//! so the height of the image is needed. Positions are pixels; `SCALE` is not applied.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;

use super::bad::Bad;
use super::collect::{Collector, CoordinateConvention, Landmark, Located};
use super::words::Lines;
use super::{Format, FormatReader, SourceText};
use crate::problem::words::quote;

pub(super) const FORMAT: Format = Format {
    name: "tps",
    title: "tpsDig .tps",
    items: "specimens",
    form: FormatReader::Lines(is_tps, read),
};

/// `LM=12` as its name in capitals and its value.
fn setting<'t>(line: Located<'t>) -> Option<(String, Located<'t>)> {
    let (name, value) = line.text.split_once('=')?;
    let at = line.at + line.text.len() - value.len();
    Some((
        name.trim().to_ascii_uppercase(),
        Located {
            at,
            text: value.trim(),
        },
    ))
}

fn is_tps(first: &str) -> bool {
    let name = first
        .split_once('=')
        .map(|(name, _)| name.trim().to_ascii_uppercase());
    name.is_some_and(|name| name == "LM" || name == "LM3")
}

/// One specimen: where it and each of its handles begin, and its names.
#[derive(Default)]
struct Specimen {
    at: usize,
    handles: Vec<(usize, Handle)>,
    names: [String; 2],
}

fn read(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    out.set_frame(CoordinateConvention::PxUp);
    let mut lines = Lines::new(source, false);
    let mut specimen: Option<Specimen> = None;
    let mut positions = 0;
    while let Some(line) = lines.next_line()? {
        let Some((name, value)) = setting(line) else {
            return Err(Bad::new(
                line.at,
                format!(
                    "expected `LM=` or another setting; found {}",
                    quote(line.text)
                ),
            ));
        };
        if name == "LM3" {
            return Err(Bad::new(
                line.at,
                "expected landmarks in 2 dimensions, `LM=`; found 3: project them onto the image \
                    first",
            ));
        }
        if name == "LM" {
            if let Some(before) = specimen.replace(Specimen {
                at: line.at,
                ..Specimen::default()
            }) {
                add(before, out)?;
            }
            positions = 0;
        }
        let Some(current) = &mut specimen else {
            return Err(Bad::new(
                line.at,
                format!("expected `LM=` first; found {}", quote(line.text)),
            ));
        };
        match name.as_str() {
            "LM" => {
                for _ in 0..value.whole("the number of landmarks")? {
                    let (at, place) = next(&mut lines)?;
                    positions += 1;
                    out.require_below(at, positions)?;
                    let handle = if place.x < 0.0 && place.y < 0.0 {
                        Handle::Missing
                    } else {
                        Handle::Point(place)
                    };
                    current.handles.push((at, handle));
                }
            }
            "POINTS" => {
                let mut line = Vec::new();
                for _ in 0..value.whole("the number of points of a curve")? {
                    let (at, place) = next(&mut lines)?;
                    positions += 1;
                    out.require_below(at, positions)?;
                    line.push(place);
                }
                match line[..] {
                    [] => {}
                    [only] => current.handles.push((value.at, Handle::Point(only))),
                    _ => current.handles.push((value.at, Handle::Polyline(line))),
                }
            }
            "IMAGE" => current.names[0] = value.text.to_owned(),
            "ID" => current.names[1] = value.text.to_owned(),
            _ => {}
        }
    }
    specimen.map_or(Ok(()), |last| add(last, out))?;
    Ok(source.text.len())
}

fn next(lines: &mut Lines<'_>) -> Result<(usize, Point), Bad> {
    let line = lines.line("a position, two numbers")?;
    let [x, y] = line.place()?;
    Ok((line.at, Point::new(x, y)))
}

fn add(specimen: Specimen, out: &mut Collector) -> Result<(), Bad> {
    let Specimen {
        at,
        handles,
        names: [image, id],
    } = specimen;
    if out.item(at, &[&image, &id])? {
        for (at, p) in handles {
            out.count(at, p.places().len())?;
            out.push(Landmark {
                at,
                p,
                q: None,
                name: None,
            })?;
        }
    }
    Ok(())
}
