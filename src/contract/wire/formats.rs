//! The picture formats that a client accepts. `output.format` decides if it is given, otherwise
//! `Accept`.

use mlswarp::format::Format;

use super::enum_name::EnumName as _;
use crate::problem::{Code, Problem};

/// The weight of each of [`Format::ALL`] in `Accept`; 0 is not accepted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Formats([f32; Format::ALL.len()]);

impl Formats {
    /// Without `Accept`.
    pub const ANY: Self = Self([1.0; Format::ALL.len()]);

    /// Formats with these weights.
    /// Errors: 406 if none is accepted.
    pub fn new(weight: [f32; Format::ALL.len()]) -> Result<Self, Problem> {
        if weight.iter().any(|q| *q > 0.0) {
            Ok(Self(weight))
        } else {
            Err(not_acceptable())
        }
    }

    /// The format to write: the `requested` one, otherwise that with the largest weight, among
    /// equals `default`. Errors: 406 if `Accept` excludes the `requested` format.
    pub fn choose(&self, requested: Option<Format>, default: Format) -> Result<Format, Problem> {
        let weight = |format: Format| {
            Format::ALL
                .iter()
                .zip(self.0)
                .find(|(f, _)| **f == format)
                .map_or(0.0, |(_, q)| q)
        };
        match requested {
            Some(format) if weight(format) > 0.0 => Ok(format),
            Some(format) => {
                let detail = format!(
                    "`output.format` is {}, but `Accept` excludes {}",
                    format.as_str(),
                    format.media_type()
                );
                Err(Problem::new(Code::NotAcceptable, detail))
            }
            None => Ok(Format::ALL.into_iter().fold(default, |best, format| {
                if weight(format) > weight(best) {
                    format
                } else {
                    best
                }
            })),
        }
    }
}

fn not_acceptable() -> Problem {
    let names = Format::ALL.map(Format::media_type);
    Problem::new(
        Code::NotAcceptable,
        format!(
            "`Accept` allows none of the image formats: {}",
            names.join(", ")
        ),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_request_decides_then_accept_then_what_is_usual() {
        let choose = |wanted, asked, usual| {
            Formats::new(wanted)
                .and_then(|f| f.choose(asked, usual))
                .ok()
        };
        assert_eq!(choose([1.0; 4], None, Format::WebP), Some(Format::WebP));
        assert_eq!(
            choose([1.0; 4], Some(Format::Jpeg), Format::WebP),
            Some(Format::Jpeg)
        );
        assert_eq!(
            choose([0.1, 0.9, 0.9, 0.5], None, Format::Png),
            Some(Format::Jpeg)
        );
        assert_eq!(
            choose([0.1, 0.9, 0.9, 0.5], None, Format::WebP),
            Some(Format::WebP)
        );
        assert_eq!(
            choose([1.0, 0.0, 1.0, 1.0], Some(Format::Jpeg), Format::Png),
            None
        );
        assert_eq!(choose([0.0; 4], None, Format::Png), None);
        assert_eq!(Formats::ANY.choose(None, Format::Png).unwrap(), Format::Png);
    }
}
