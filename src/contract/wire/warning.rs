//! Warnings in a report: each has its code, as in the header `Warp-Warning`, and the figures that
//! describe it.

use mlswarp::warp::{Figure, Warning};
use serde::ser::{Serialize, SerializeMap, Serializer};

use super::AsJson;

/// A warning of a report. It may come from the engine, or from what only the server sees, such as
/// landmark files.
#[derive(Clone, Debug, PartialEq)]
pub struct WarningEntry {
    /// As in the header.
    pub code: &'static str,
    /// By name.
    pub figures: Vec<(&'static str, Figure)>,
}

impl WarningEntry {
    /// A warning without figures.
    #[must_use]
    pub const fn of(code: &'static str) -> Self {
        Self {
            code,
            figures: Vec::new(),
        }
    }

    /// Upper bound of its JSON, bytes.
    pub(super) fn text_bytes(&self) -> usize {
        const NUMBER: usize = 26;
        // A character is escaped with at most six bytes.
        let text = |text: &str| 6 * text.len() + 3;
        let figure = |(name, figure): &(&str, Figure)| {
            let figure = match figure {
                Figure::Count(_) | Figure::Number(_) => NUMBER,
                Figure::Indices(indices) => 2 + NUMBER * indices.len(),
                Figure::Names(names) => 2 + names.iter().map(|name| text(name)).sum::<usize>(),
            };
            text(name) + 1 + figure
        };
        16 + text(self.code) + self.figures.iter().map(figure).sum::<usize>()
    }
}

impl From<&Warning> for WarningEntry {
    fn from(warning: &Warning) -> Self {
        Self {
            code: warning.code(),
            figures: warning.figures(),
        }
    }
}

impl Serialize for WarningEntry {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut object = s.serialize_map(Some(1 + self.figures.len()))?;
        object.serialize_entry("code", self.code)?;
        for (name, figure) in &self.figures {
            object.serialize_entry(name, &AsJson(figure))?;
        }
        object.end()
    }
}

impl Serialize for AsJson<&Figure> {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Figure::Count(count) => count.serialize(s),
            Figure::Number(number) => number.serialize(s),
            Figure::Indices(indices) => indices.serialize(s),
            Figure::Names(names) => names.serialize(s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_has_its_code_and_its_figures_by_name() {
        let json = |entry: &WarningEntry| {
            let text = serde_json::to_string(entry).unwrap();
            assert!(text.len() <= entry.text_bytes(), "{text}");
            text
        };
        let bare = WarningEntry::from(&Warning::NothingVisible);
        assert_eq!(json(&bare), r#"{"code":"nothing_visible"}"#);
        let names = Figure::Names(vec!["a\"\u{1}".to_owned(), "\u{e9}".to_owned()]);
        let figures = vec![
            ("cells", Figure::Count(u64::MAX)),
            ("scale", Figure::Number(-f64::MIN_POSITIVE)),
            ("none", Figure::Number(f64::NAN)),
            ("handles", Figure::Indices(vec![0, usize::MAX])),
            ("names", names),
        ];
        let full = json(&WarningEntry {
            code: "a_code",
            figures,
        });
        assert_eq!(
            full,
            r#"{"code":"a_code","cells":18446744073709551615,"scale":-2.2250738585072014e-308,"none":null,"handles":[0,18446744073709551615],"names":["a\"\u0001","é"]}"#
        );
    }
}
