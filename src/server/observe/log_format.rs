//! Log lines, as text or as one flat JSON object each. Whatever is told while a request is worked on ends with the request's id, and with the id of
//! its trace where there is a collector.

use std::fmt;

use tracing::{Event, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{self, FormatEvent, FormatFields, Writer};
use tracing_subscriber::registry::LookupSpan;

use super::Scope;

/// How log lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// Starts logging what passes `filter`; a second call changes nothing.
pub fn start(filter: &str, format: LogFormat) {
    let filter = EnvFilter::new(filter);
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // The only error is that logging has been started before.
    let _ = match format {
        LogFormat::Text => {
            let is_terminal = std::io::IsTerminal::is_terminal(&std::io::stderr());
            lines.with_ansi(is_terminal).event_format(Text(format::format().with_ansi(is_terminal))).try_init()
        }
        LogFormat::Json => lines.fmt_fields(format::JsonFields::new()).event_format(Json(json())).try_init(),
    };
}

/// Spans of libraries would nest: only what is told itself is written.
fn json() -> format::Format<format::Json> {
    format::json().flatten_event(true).with_current_span(false).with_span_list(false)
}

/// A line for people, then what is known of the request.
struct Text<F>(F);

/// A JSON object, with what is known of the request among its members.
struct Json<F>(F);

impl<S, N, F> FormatEvent<S, N> for Text<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(&self, context: &FmtContext<'_, S, N>, mut writer: Writer<'_>, event: &Event<'_>) -> fmt::Result {
        let mut line = String::new();
        self.0.format_event(context, Writer::new(&mut line), event)?;
        writer.write_str(line.trim_end_matches('\n'))?;
        let scope = Scope::current();
        if let Some(id) = scope.id() {
            write!(writer, " id={id}")?;
        }
        if let Some(trace) = scope.trace_id() {
            write!(writer, " trace_id={trace}")?;
        }
        writer.write_char('\n')
    }
}

impl<S, N, F> FormatEvent<S, N> for Json<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(&self, context: &FmtContext<'_, S, N>, mut writer: Writer<'_>, event: &Event<'_>) -> fmt::Result {
        let mut line = String::new();
        self.0.format_event(context, Writer::new(&mut line), event)?;
        let object = line.trim_end_matches('\n');
        writer.write_str(object.strip_suffix('}').unwrap_or(object))?;
        let scope = Scope::current();
        // Neither holds anything that JSON would have to escape.
        if let Some(id) = scope.id() {
            write!(writer, r#","id":"{id}""#)?;
        }
        if let Some(trace) = scope.trace_id() {
            write!(writer, r#","trace_id":"{trace}""#)?;
        }
        writer.write_str("}\n")
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::sync::{Arc, Mutex};

    use super::*;

    #[derive(Clone, Default)]
    struct Paper(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Paper {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl Paper {
        fn text(&self) -> String {
            String::from_utf8(self.0.lock().unwrap().clone()).unwrap()
        }
    }

    fn talk() {
        tracing::warn!("outside");
        Scope::untraced("r-1").enter(|| tracing::error!(why = "a \"quoted\" }\nword\u{1b}[31m", "inside"));
    }

    #[test]
    fn a_line_of_text_ends_with_the_id_of_its_request() {
        let paper = Paper::default();
        let told = paper.clone();
        let lines = tracing_subscriber::fmt().with_ansi(false).event_format(Text(format::format().with_ansi(false)));
        tracing::subscriber::with_default(lines.with_writer(move || told.clone()).finish(), talk);
        let text = paper.text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2, "what is told cannot begin a line: {text}");
        assert!(lines[0].ends_with("outside") && lines[1].ends_with(" id=r-1"), "{text}");
        assert!(!text.contains('\u{1b}'), "{text}");
    }

    #[test]
    fn a_line_of_json_is_one_flat_object() {
        let paper = Paper::default();
        let told = paper.clone();
        let lines = tracing_subscriber::fmt().fmt_fields(format::JsonFields::new()).event_format(Json(json()));
        tracing::subscriber::with_default(lines.with_writer(move || told.clone()).finish(), || {
            tracing::error_span!("of a library", id = "nested").in_scope(talk);
        });
        let text = paper.text();
        let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.len(), 2);
        assert_eq!((&lines[0]["message"], &lines[0]["id"]), (&"outside".into(), &serde_json::Value::Null));
        assert_eq!((&lines[1]["message"], &lines[1]["id"]), (&"inside".into(), &"r-1".into()));
        assert_eq!(lines[1]["why"], "a \"quoted\" }\nword\u{1b}[31m");
        for line in lines {
            assert!(line.as_object().unwrap().values().all(|value| !value.is_object() && !value.is_array()), "{line}");
        }
    }
}
