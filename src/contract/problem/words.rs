//! Parts of sentences: names and values of the client, quoted so that they are short and show no
//! control characters, and the known name that was probably meant. The work is bounded: only the
//! beginning of hostile input is quoted, and long names are not compared.

use std::fmt::Write as _;
use std::time::Duration;

use strsim::normalized_damerau_levenshtein;

/// Longest name or value of the client that a problem quotes, characters.
pub const LONGEST_QUOTE: usize = 60;
/// Longest name that is compared with known names, bytes.
const LONGEST_COMPARED: usize = 40;
/// How similar two names must be (1: equal) to suppose that one is a misspelling of the other.
const MIN_SIMILARITY: f64 = 0.6;

/// A name or value of the client in backticks, shortened.
pub fn quote(text: &str) -> String {
    let mut quoted = "`".to_owned();
    for c in text.chars().take(LONGEST_QUOTE) {
        if is_unseen(c) {
            // Writing to a string does not fail.
            let _ = write!(quoted, "{}", c.escape_unicode());
        } else {
            if c == '`' {
                quoted.push('\\');
            }
            quoted.push(c);
        }
    }
    quoted.push_str(if text.chars().nth(LONGEST_QUOTE).is_some() {
        "...`"
    } else {
        "`"
    });
    quoted
}

/// Control characters, zero-width characters and those that change the direction of text: a reader
/// would not see what was sent.
pub fn is_unseen(c: char) -> bool {
    let is_format = matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}'
        | '\u{2028}'..='\u{202e}'
        | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
            | '\u{e0000}'..='\u{e007f}');
    c.is_control() || is_format
}

/// Names in backticks, with commas.
pub fn list(names: &[&str]) -> String {
    names
        .iter()
        .map(|n| format!("`{n}`"))
        .collect::<Vec<_>>()
        .join(", ")
}

/// `a`, `a and b`, `a, b and c`; `conjunction`: `and` or `or`.
pub fn series(words: &[&str], conjunction: &str) -> String {
    match words.split_last() {
        Some((end, [])) => (*end).to_owned(),
        Some((end, others)) => format!("{} {conjunction} {end}", others.join(", ")),
        None => String::new(),
    }
}

/// The known name that is most similar to `name`, if one is similar enough; upper and lower case
/// are equal.
pub fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let scored = known
        .into_iter()
        .map(|other| (similarity(name, other), other))
        .filter(|(score, _)| *score >= MIN_SIMILARITY);
    // Of equally similar names the first wins.
    scored
        .reduce(|best, next| if next.0 > best.0 { next } else { best })
        .map(|(_, other)| other)
}

/// How similar two names are: 1 if they are equal except for case, 0 if they are not alike or too
/// long to compare.
pub fn similarity(name: &str, other: &str) -> f64 {
    if name.eq_ignore_ascii_case(other) {
        return 1.0;
    }
    if name.len() > LONGEST_COMPARED {
        return 0.0;
    }
    let score = normalized_damerau_levenshtein(&name.to_ascii_lowercase(), other);
    if score >= MIN_SIMILARITY { score } else { 0.0 }
}

/// A question that names what was probably meant, to follow the description of what was sent.
pub fn did_you_mean(meant: Option<&str>) -> String {
    meant.map_or_else(String::new, |meant| format!("; did you mean `{meant}`?"))
}

/// A hint if there is one, and then `more`, to follow the description of what was sent.
pub fn advice(hint: Option<String>, more: &str) -> String {
    let Some(hint) = hint else {
        return format!("; {more}");
    };
    let end = if hint.ends_with('?') { "" } else { "." };
    let (first, rest) = more.split_at_checked(1).unwrap_or((more, ""));
    format!("; {hint}{end} {}{rest}", first.to_ascii_uppercase())
}

/// A period of time in whole minutes if it is one, otherwise in seconds.
pub fn period(time: Duration) -> String {
    match time.as_secs() {
        seconds if seconds > 0 && seconds % 60 == 0 && time.subsec_nanos() == 0 => {
            format!("{} min", seconds / 60)
        }
        _ => format!("{} s", time.as_secs_f64()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_are_short_and_show_no_control_characters() {
        assert_eq!(quote("warp"), "`warp`");
        assert_eq!(
            quote("a\u{1b}[31m\n\u{202e}b"),
            "`a\\u{1b}[31m\\u{a}\\u{202e}b`"
        );
        for unseen in "\u{ad}\u{61c}\u{180e}\u{200b}\u{2066}\u{feff}\u{fff9}\u{e0041}".chars() {
            assert_eq!(
                quote(&unseen.to_string()),
                format!("`{}`", unseen.escape_unicode())
            );
        }
        assert_eq!(quote("a`b"), "`a\\`b`");
        assert_eq!(
            quote(&"\u{e9}".repeat(1_000_000)).chars().count(),
            LONGEST_QUOTE + 5
        );
        assert_eq!(quote(&"x".repeat(LONGEST_QUOTE)).len(), LONGEST_QUOTE + 2);
    }

    #[test]
    fn misspellings_find_the_name_that_was_meant() {
        let known = [
            "p", "q", "weights", "method", "alpha", "units", "grid", "output",
        ];
        for (name, meant) in [
            ("metod", Some("method")),
            ("Method", Some("method")),
            ("weight", Some("weights")),
            ("ouptut", Some("output")),
            ("P", Some("p")),
            ("colour", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(nearest(name, known), meant, "{name}");
        }
        assert_eq!(nearest("jpg", ["png", "jpeg", "webp"]), Some("jpeg"));
        assert_eq!(nearest(&"method".repeat(100_000), known), None);
    }

    #[test]
    fn advice_is_one_sentence_or_two() {
        assert_eq!(advice(None, "known: `p`"), "; known: `p`");
        assert_eq!(
            advice(Some("did you mean `p`?".to_owned()), "known: `p`"),
            "; did you mean `p`? Known: `p`"
        );
        assert_eq!(
            advice(Some("put it in `output`".to_owned()), "known: `p`"),
            "; put it in `output`. Known: `p`"
        );
    }

    #[test]
    fn words_are_joined_and_times_are_round() {
        assert_eq!(series(&["GET"], "or"), "GET");
        assert_eq!(
            series(&["GET", "PUT", "DELETE"], "or"),
            "GET, PUT or DELETE"
        );
        assert_eq!(series(&[], "or"), "");
        for (millis, text) in [
            (900_000, "15 min"),
            (90_000, "90 s"),
            (1_500, "1.5 s"),
            (3_600_000, "60 min"),
            (0, "0 s"),
        ] {
            assert_eq!(period(Duration::from_millis(millis)), text);
        }
    }
}
