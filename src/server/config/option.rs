//! Parsers of option values. clap stops at the first wrong value; [`Checked`] notes each, so that
//! all are reported at once.

use std::cell::RefCell;
use std::ffi::{OsStr, OsString};
use std::time::Duration;

use clap::builder::TypedValueParser;
use clap::error::ErrorKind;
use clap::{Arg, ArgMatches, Command, Error};

/// An optional value that is written as text (`off`, `auto` or nothing stand for `None`); clap
/// takes a plain `Option` for an option without a default.
pub(super) type Maybe<T> = Option<T>;

thread_local! {
    /// The mistakes of the command line that this thread is reading.
    static MISTAKES: RefCell<Vec<Mistake>> = const { RefCell::new(Vec::new()) };
}

#[derive(Clone, Debug)]
struct Mistake {
    flag: String,
    /// The wrong value, which another one may override.
    value: Option<OsString>,
    why: String,
}

fn note(flag: &str, value: Option<&OsStr>, why: String) {
    MISTAKES.with_borrow_mut(|all| {
        all.push(Mistake {
            flag: flag.to_owned(),
            value: value.map(OsStr::to_owned),
            why,
        })
    });
}

/// A clap value parser that notes a mistake and returns the option's default instead.
#[derive(Clone)]
pub(super) struct Checked<F>(pub(super) F);

impl<T, F> TypedValueParser for Checked<F>
where
    T: Clone + Send + Sync + 'static,
    F: Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static,
{
    type Value = T;

    fn parse_ref(&self, _: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, Error> {
        let parse = |value: &OsStr| (self.0)(&value.to_string_lossy());
        match parse(value) {
            Ok(parsed) => return Ok(parsed),
            Err(why) => note(
                arg.and_then(Arg::get_long).unwrap_or_default(),
                Some(value),
                why,
            ),
        }
        let default = arg
            .and_then(|arg| arg.get_default_values().first())
            .ok_or_else(|| Error::new(ErrorKind::InvalidValue))?;
        parse(default).map_err(|mistake| Error::raw(ErrorKind::InvalidValue, mistake))
    }
}

/// The value; or a note of what is wrong with it.
pub(super) fn report<T>(flag: &str, value: Result<T, String>) -> Option<T> {
    value.map_err(|why| note(flag, None, why)).ok()
}

/// Forgets all mistakes.
pub(super) fn clear_mistakes() {
    MISTAKES.take();
}

/// Keeps the mistakes in values that count: clap parses each variable once per subcommand, and
/// values that are overridden.
pub(super) fn keep_final(matches: &ArgMatches, command: &Command) {
    let is_final = |mistake: &Mistake, value: &OsStr| {
        let arg = command
            .get_arguments()
            .find(|arg| arg.get_long() == Some(&mistake.flag));
        arg.and_then(|arg| matches.get_raw(arg.get_id().as_str()))
            .is_some_and(|mut raw| raw.any(|raw| raw == value))
    };
    MISTAKES.with_borrow_mut(|all| {
        all.retain(|mistake| {
            mistake
                .value
                .as_deref()
                .is_none_or(|value| is_final(mistake, value))
        })
    });
}

/// Whether a mistake in this option was noted.
pub(super) fn has_mistake(flag: &str) -> bool {
    MISTAKES.with_borrow(|all| all.iter().any(|mistake| mistake.flag == flag))
}

/// Every mistake, once.
pub(super) fn take_mistakes() -> Vec<String> {
    let mut texts: Vec<String> = Vec::new();
    for Mistake { flag, why, .. } in MISTAKES.take() {
        let text = format!("--{flag} ({}): {why}", variable(&flag));
        if !texts.contains(&text) {
            texts.push(text);
        }
    }
    texts
}

/// The environment variable of an option.
pub(super) fn variable(flag: &str) -> String {
    format!("MLSWARP_{}", flag.to_ascii_uppercase().replace('-', "_"))
}

/// A whole number of `least..=most`.
pub(super) fn whole<T: TryFrom<u64>>(
    least: u64,
    most: u64,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let n = count(text)?;
        let number = T::try_from(n).ok().filter(|_| (least..=most).contains(&n));
        number.ok_or_else(|| format!("`{text}` is not between {least} and {most}"))
    }
}

/// `parse`, or `None` for the word.
pub(super) fn unless<T>(
    word: &'static str,
    parse: impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static,
) -> impl Fn(&str) -> Result<Maybe<T>, String> + Clone + Send + Sync + 'static {
    move |text| {
        if text == word {
            Ok(None)
        } else {
            parse(text).map(Some)
        }
    }
}

/// A size of at least one byte: a limit of zero would refuse everything.
pub(super) fn size(text: &str) -> Result<u64, String> {
    bytes(text).and_then(|n| {
        if n == 0 {
            Err("0 would reject every request; the least is 1".to_owned())
        } else {
            Ok(n)
        }
    })
}

/// A size: K, M, G and KiB, MiB, GiB are powers of 1024 alike; KB, MB, GB are powers of 1000.
pub(super) fn bytes(text: &str) -> Result<u64, String> {
    let (number, unit) = split(text);
    let scale: u64 = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1,
        "k" | "ki" | "kib" => 1 << 10,
        "m" | "mi" | "mib" => 1 << 20,
        "g" | "gi" | "gib" => 1 << 30,
        "kb" => 1_000,
        "mb" => 1_000_000,
        "gb" => 1_000_000_000,
        _ => 0,
    };
    scaled(&number, scale)
        .ok_or_else(|| format!("`{text}` is not a size such as 32MiB, 512K or 1048576"))
}

/// A number of things: `50M` is fifty million.
fn count(text: &str) -> Result<u64, String> {
    let (number, unit) = split(text);
    let scale: u64 = match unit {
        "" => 1,
        "k" | "K" => 1_000,
        "m" | "M" => 1_000_000,
        "g" | "G" => 1_000_000_000,
        _ => 0,
    };
    scaled(&number, scale)
        .ok_or_else(|| format!("`{text}` is not a whole number such as 10000 or 50M"))
}

/// A span of time, longer than nothing and at most a year.
pub(super) fn span(text: &str) -> Result<Duration, String> {
    let wrong = || format!("`{text}` is not a time such as 500ms, 30s, 15m or 2h");
    let (number, unit) = split(text);
    let seconds = match unit {
        "ms" => 0.001,
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        "d" => 86400.0,
        _ => return Err(wrong()),
    } * number.parse::<f64>().map_err(|_| wrong())?;
    if !(0.001..=366.0 * 86400.0).contains(&seconds) {
        return Err(format!("`{text}` is not between 1ms and 366d"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// A span of time that may also be nothing.
pub(super) fn pause(text: &str) -> Result<Duration, String> {
    if text.trim() == "0s" {
        Ok(Duration::ZERO)
    } else {
        span(text)
    }
}

/// The number and the unit of `1_000 KiB`.
fn split(text: &str) -> (String, &str) {
    let text = text.trim();
    let end = text
        .find(|c: char| !(c.is_ascii_digit() || c == '.' || c == '_'))
        .unwrap_or(text.len());
    (text[..end].replace('_', ""), text[end..].trim_start())
}

/// Exact; a fraction is rounded down. A scale of 0 is an unknown unit.
fn scaled(number: &str, scale: u64) -> Option<u64> {
    let (whole, fraction) = number.split_once('.').unwrap_or((number, "0"));
    let digits = u32::try_from(fraction.len())
        .ok()
        .filter(|digits| (1..=9).contains(digits) && scale > 0)?;
    let part = fraction.parse::<u64>().ok()? * scale / 10_u64.pow(digits);
    whole
        .parse::<u64>()
        .ok()?
        .checked_mul(scale)?
        .checked_add(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_as_people_write_them() {
        for (text, value) in [
            ("0", 0),
            ("1_000", 1000),
            ("32MiB", 32 << 20),
            ("512M", 512 << 20),
            ("64 KiB", 64 << 10),
            ("1.5g", 3 << 29),
        ] {
            assert_eq!(bytes(text), Ok(value), "{text}");
        }
        assert_eq!(bytes("2MB"), Ok(2_000_000));
        for text in [
            "",
            "MiB",
            "-1",
            "1e6",
            "12x",
            "1.",
            "99999999999G",
            "1.2.3M",
        ] {
            assert!(bytes(text).is_err(), "{text}");
        }
    }

    #[test]
    fn counts_are_decimal() {
        assert_eq!(count("50M"), Ok(50_000_000));
        assert_eq!(count("10_000"), Ok(10_000));
        assert!(count("50MiB").is_err());
    }

    #[test]
    fn spans_need_a_unit() {
        assert_eq!(
            (pause("0s"), pause("5s")),
            (Ok(Duration::ZERO), Ok(Duration::from_secs(5)))
        );
        assert_eq!(span("15m"), Ok(Duration::from_secs(900)));
        assert_eq!(span("2.5s"), Ok(Duration::from_millis(2500)));
        assert_eq!(span("500ms"), Ok(Duration::from_millis(500)));
        for text in ["30", "", "s", "-1s", "0s", "1e9s", "9999999d"] {
            assert!(span(text).is_err(), "{text}");
        }
    }
}
