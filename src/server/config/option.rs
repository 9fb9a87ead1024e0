//! Values of options: clap stops at the first wrong value; [`checked`] notes each, so that all are reported at once.

use std::cell::RefCell;
use std::ffi::OsStr;
use std::path::PathBuf;

use clap::builder::TypedValueParser;
use clap::{Arg, Command, Error};

use super::units;

/// An optional value that is written as text (`off`, `auto` or nothing stand for `None`); clap takes a plain `Option` for an option without a default.
pub(super) type Maybe<T> = Option<T>;

thread_local! {
    /// The mistakes of the command line that this thread is reading.
    static MISTAKES: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// A clap value parser that never fails: it notes the mistake and returns the fallback.
#[derive(Clone)]
pub(super) struct Checked<T, F> {
    fallback: T,
    parse: F,
}

/// Parses with `parse`; a wrong value is noted, and becomes the type's default.
pub(super) fn checked<T: Default, F: Fn(&str) -> Result<T, String>>(parse: F) -> Checked<T, F> {
    checked_or(T::default(), parse)
}

/// Parses with `parse`; a wrong value is noted, and becomes `fallback`.
pub(super) const fn checked_or<T, F: Fn(&str) -> Result<T, String>>(fallback: T, parse: F) -> Checked<T, F> {
    Checked { fallback, parse }
}

impl<T, F> TypedValueParser for Checked<T, F>
where
    T: Clone + Send + Sync + 'static,
    F: Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static,
{
    type Value = T;

    fn parse_ref(&self, _: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<T, Error> {
        let flag = arg.and_then(Arg::get_long).unwrap_or_default();
        Ok(report(flag, (self.parse)(&value.to_string_lossy())).unwrap_or_else(|| self.fallback.clone()))
    }
}

/// The value; or a note of what is wrong with it.
pub(super) fn report<T>(flag: &str, value: Result<T, String>) -> Option<T> {
    value.map_err(|mistake| MISTAKES.with_borrow_mut(|all| all.push(format!("--{flag} ({}): {mistake}", variable(flag))))).ok()
}

/// The mistakes since the last call.
pub(super) fn take_mistakes() -> Vec<String> {
    MISTAKES.take()
}

/// The environment variable of an option.
pub(super) fn variable(flag: &str) -> String {
    format!("MLSWARP_{}", flag.to_ascii_uppercase().replace('-', "_"))
}

/// A whole number of `least..=most`.
pub(super) fn whole<T: TryFrom<u64>>(least: u64, most: u64) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let n = units::count(text)?;
        let number = T::try_from(n).ok().filter(|_| (least..=most).contains(&n));
        number.ok_or_else(|| format!("`{text}` is not between {least} and {most}"))
    }
}

/// `parse`, or `None` for the word.
pub(super) fn unless<T>(
    word: &'static str,
    parse: impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static,
) -> impl Fn(&str) -> Result<Maybe<T>, String> + Clone + Send + Sync + 'static {
    move |text| if text == word { Ok(None) } else { parse(text).map(Some) }
}

/// A path; an empty text is none.
#[expect(clippy::unnecessary_wraps, reason = "a parser of options")]
pub(super) fn optional_path(text: &str) -> Result<Maybe<PathBuf>, String> {
    Ok(Some(text).filter(|text| !text.is_empty()).map(PathBuf::from))
}

/// A size of at least one byte: a limit of zero would refuse everything.
pub(super) fn size(text: &str) -> Result<u64, String> {
    units::bytes(text).and_then(|n| if n == 0 { Err("0 would refuse everything".to_owned()) } else { Ok(n) })
}
