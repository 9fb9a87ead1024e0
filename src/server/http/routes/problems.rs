//! `GET /problems/{code}`: a section of `api/problems.md` as HTML or JSON. Only the Markdown that
//! the file uses is converted (tested): paragraphs, code, bold and blocks of JSON.

use std::fmt::Write as _;

use axum::extract::{Path, State};
use axum::http::header::VARY;
use axum::http::{HeaderMap, HeaderValue};
use axum::response::{IntoResponse as _, Response};
use bytes::Bytes;
use serde_json::{Value, json};

use crate::app::App;
use crate::http::accept;
use crate::http::assets::{Asset, HTML};
use crate::http::response::Refusal;
use crate::problem::words::{did_you_mean, nearest, quote};
use crate::problem::{Code, Problem};

const TEXT: &str = include_str!("../../../../api/problems.md");
const PAGE: &str = include_str!("problems/page.html");
const ADVICE: &str = "**What to do.** ";
const JSON: &str = "application/json";
const BLOCK: &str = "```";

/// The media types of a section; the first is the default.
const FORMS: [&str; 3] = ["text/html", JSON, Problem::MEDIA_TYPE];

/// One section.
pub(crate) async fn section(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    let Some(&code) = Code::ALL.iter().find(|code| code.as_str() == name) else {
        let meant = nearest(&name, Code::ALL.iter().map(|code| code.as_str()));
        return Err(Problem::new(
            Code::NotFound,
            format!(
                "there is no problem with the code {}{}",
                quote(&name),
                did_you_mean(meant)
            ),
        )
        .into());
    };
    let form = FORMS[accept::choose(&headers, FORMS)?];
    Ok((
        [(VARY, HeaderValue::from_static("accept"))],
        asset(code, form, &app.config().public_path).response(&headers),
    )
        .into_response())
}

fn asset(code: Code, form: &'static str, public_path: &str) -> Asset {
    let section = TEXT
        .split("\n## ")
        .find_map(|section| section.strip_prefix(code.as_str())?.strip_prefix('\n'));
    let section = section
        .expect("every code has a section, and a test reads it")
        .trim();
    // Of the example.
    let section = &section.replace(
        code.type_uri(),
        &format!("{public_path}{}", code.type_uri()),
    );
    if form == FORMS[0] {
        let page = PAGE
            .replace("{title}", code.title())
            .replace("{code}", code.as_str())
            .replace("{section}", &html(section));
        return Asset::new(HTML, Bytes::from(page));
    }
    Asset::new(form, Bytes::from(document(code, section).to_string()))
}

/// The paragraphs and blocks of code of a section.
fn blocks(section: &str) -> impl Iterator<Item = &str> {
    section
        .split("\n\n")
        .map(str::trim)
        .filter(|block| !block.is_empty())
}

/// The content of a block of code.
fn code_of(block: &str) -> Option<&str> {
    block
        .strip_prefix(BLOCK)?
        .strip_suffix(BLOCK)?
        .split_once('\n')
        .map(|(_, code)| code)
}

fn html(section: &str) -> String {
    let mut html = String::new();
    for block in blocks(section) {
        // Writing to a string does not fail.
        let _ = match code_of(block) {
            Some(code) => writeln!(
                html,
                "<pre tabindex=\"0\"><code>{}</code></pre>",
                escaped(code)
            ),
            None => writeln!(html, "<p>{}</p>", paragraph(block)),
        };
    }
    html
}

fn paragraph(text: &str) -> String {
    let bold = |text: &str| marked(text, "**", "strong", str::to_owned);
    marked(&escaped(text), "`", "code", bold)
}

/// Puts every other piece between `mark`s into an element, and converts the rest.
fn marked(text: &str, mark: &str, element: &str, rest: impl Fn(&str) -> String) -> String {
    let piece = |(n, piece)| {
        if n % 2 == 1 {
            format!("<{element}>{piece}</{element}>")
        } else {
            rest(piece)
        }
    };
    text.split(mark).enumerate().map(piece).collect()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// The section as JSON, with the members that all problems of the code share.
fn document(code: Code, section: &str) -> Value {
    let example = blocks(section)
        .find_map(code_of)
        .and_then(|text| serde_json::from_str(text).ok())
        .unwrap_or(Value::Null);
    let paragraphs = || {
        blocks(section)
            .filter(|block| code_of(block).is_none())
            .map(|block| block.replace('\n', " "))
    };
    let of_status = format!("Status {}. ", code.status());
    let description: Vec<String> = paragraphs()
        .filter(|text| !text.starts_with(ADVICE))
        .collect();
    let advice: Vec<String> = paragraphs()
        .filter_map(|text| text.strip_prefix(ADVICE).map(str::to_owned))
        .collect();
    json!({
        "type": &example["type"],
        "title": code.title(),
        "status": code.status(),
        "code": code.as_str(),
        "detail": description.join("\n\n").trim_start_matches(&of_status),
        "advice": advice.join("\n\n"),
        "example": example,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_section_is_written_whole_and_uses_no_other_markup() {
        for &code in Code::ALL {
            let [page, json, problem] = FORMS.map(|form| asset(code, form, ""));
            let page = std::str::from_utf8(&page.bytes).unwrap();
            let (_, main) = page.split_once("<main class=\"problem\">").unwrap();
            assert!(
                main.contains(&format!("<h1>{}</h1>", code.title()))
                    && main.contains("<strong>What to do.</strong>"),
                "{page}"
            );
            assert!(
                main.contains(&format!("\"code\": \"{}\"", code.as_str())),
                "{page}"
            );
            let text: String = main
                .split("<pre tabindex=\"0\">")
                .filter_map(|piece| piece.split("</pre>").last())
                .collect();
            for mark in [
                "`",
                "**",
                "](",
                "\n- ",
                "\n* ",
                "\n1. ",
                "\n|",
                "\n#",
                "\n>",
                "{section}",
                "{title}",
                "{code}",
            ] {
                assert!(!text.contains(mark), "{mark:?} in {page}");
            }
            assert!(
                !page.contains("=\"http")
                    && !page.contains("=\"//")
                    && !page.contains("<script")
                    && !page.contains(" style="),
                "{page}"
            );
            assert_eq!(json.bytes, problem.bytes);
            let document: Value = serde_json::from_slice(&json.bytes).unwrap();
            assert_eq!(document["example"]["code"], code.as_str());
            assert_eq!(
                (&document["type"], &document["status"]),
                (&code.type_uri().into(), &code.status().into())
            );
            for text in ["detail", "advice"] {
                let text = document[text].as_str().unwrap();
                assert!(
                    text.len() > 15 && !text.starts_with("Status") && !text.contains("**"),
                    "{text}"
                );
            }
        }
    }

    #[test]
    fn text_is_escaped_before_it_is_marked() {
        assert_eq!(
            paragraph("**Do.** `a<b> & c`, `**`"),
            "<strong>Do.</strong> <code>a&lt;b&gt; &amp; c</code>, <code>**</code>"
        );
        assert_eq!(
            html("One.\n\n```json\n{\"a\": \"<b>\"}\n```"),
            "<p>One.</p>\n<pre tabindex=\"0\"><code>{\"a\": \"&lt;b&gt;\"}\n</code></pre>\n"
        );
    }
}
