//! Which picture formats a client takes. The request's own `output.format` decides where it is given; `Accept` where it is not.

use mlswarp::codec::Format;

use crate::problem::{Code, Problem};

/// How much a client wants each of [`Format::ALL`]; 0 is not at all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Formats([f32; Format::ALL.len()]);

impl Formats {
    /// Every format alike: the client has not said.
    pub const ANY: Self = Self([1.0; Format::ALL.len()]);

    /// By how much each is wanted.
    /// Errors: 406 when none is.
    pub fn new(wanted: [f32; Format::ALL.len()]) -> Result<Self, Problem> {
        if wanted.iter().any(|q| *q > 0.0) { Ok(Self(wanted)) } else { Err(refused(&Format::ALL)) }
    }

    /// The format to write: `asked` where the request names one, otherwise what the client wants most, the `usual` one among equals.
    /// Errors: 406 when the request names a format that its `Accept` refuses.
    pub fn choose(&self, asked: Option<Format>, usual: Format) -> Result<Format, Problem> {
        let wanted = |format: Format| Format::ALL.iter().zip(self.0).find(|(f, _)| **f == format).map_or(0.0, |(_, q)| q);
        match asked {
            Some(format) if wanted(format) > 0.0 => Ok(format),
            Some(format) => Err(refused(&[format])),
            None => Ok(Format::ALL.into_iter().fold(usual, |best, format| if wanted(format) > wanted(best) { format } else { best })),
        }
    }
}

fn refused(formats: &[Format]) -> Problem {
    let names: Vec<&str> = formats.iter().map(|f| f.media_type()).collect();
    Problem::new(Code::NotAcceptable, format!("the picture is written as {}, and Accept takes none of that", names.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_request_decides_then_accept_then_what_is_usual() {
        let choose = |wanted, asked, usual| Formats::new(wanted).and_then(|f| f.choose(asked, usual)).ok();
        assert_eq!(choose([1.0; 3], None, Format::WebP), Some(Format::WebP));
        assert_eq!(choose([1.0; 3], Some(Format::Jpeg), Format::WebP), Some(Format::Jpeg));
        assert_eq!(choose([0.1, 0.9, 0.9], None, Format::Png), Some(Format::Jpeg));
        assert_eq!(choose([0.1, 0.9, 0.9], None, Format::WebP), Some(Format::WebP));
        assert_eq!(choose([1.0, 0.0, 1.0], Some(Format::Jpeg), Format::Png), None);
        assert_eq!(choose([0.0; 3], None, Format::Png), None);
        assert_eq!(Formats::ANY.choose(None, Format::Png).unwrap(), Format::Png);
    }
}
