//! ibug and dlib landmarks, `.pts`: `version: 1`, `n_points: 68`, and the points between braces,
//! one in a line.
//!
//! Source: the annotations of the 300-W challenge, and the reader of menpo
//! (`menpo/io/input/landmark.py`, `PTSImporter`: "Here we make the assumption (as is common) that
//! PTS landmarks are 1-based"). The centre of the first pixel is 1, 1: 1/2 is subtracted.

use super::bad::Bad;
use super::collect::{Collector, Located};
use super::words::Lines;
use super::{Format, FormatReader, SourceText};
use crate::problem::words::quote;

pub(super) const FORMAT: Format = Format {
    name: "pts",
    title: "ibug .pts",
    items: "faces",
    form: FormatReader::Lines(is_pts, read),
};
const FIRST_CENTRE: f64 = 0.5;

/// Whether the first line is that of such a file.
fn is_pts(first: &str) -> bool {
    ["version", "n_points"].iter().any(|name| {
        first
            .split(':')
            .next()
            .is_some_and(|word| word.trim().eq_ignore_ascii_case(name))
    }) && first.contains(':')
}

fn read(source: SourceText<'_>, out: &mut Collector) -> Result<usize, Bad> {
    let mut lines = Lines::new(source, false);
    let mut declared: Option<usize> = None;
    loop {
        let line = lines.line("`{` before the points")?;
        match line
            .text
            .split_once(':')
            .map(|(name, value)| (name.trim().to_ascii_lowercase(), value))
        {
            _ if line.text == "{" => break,
            Some((name, value)) if name == "n_points" => {
                let value = Located {
                    at: line.at + line.text.len() - value.len(),
                    text: value.trim(),
                };
                declared = Some(value.whole("the number of points")?);
            }
            Some((name, _)) if name == "version" => {}
            _ => {
                return Err(Bad::new(
                    line.at,
                    format!(
                        "expected `version:`, `n_points:` or `{{`; found {}",
                        quote(line.text)
                    ),
                ));
            }
        }
    }
    let mut found = 0;
    let end = loop {
        let line = lines.line("a point, or `}` after the last")?;
        if line.text == "}" {
            break line.at;
        }
        let [x, y] = line.place()?;
        out.point(line.at, Some([x - FIRST_CENTRE, y - FIRST_CENTRE]), None)?;
        found += 1;
    };
    if let Some(declared) = declared.filter(|declared| *declared != found) {
        return Err(Bad::new(
            end,
            format!("expected {declared} points, as `n_points` says; found {found}"),
        ));
    }
    lines.end()?;
    Ok(end)
}
