//! Log lines, as text or as one flat JSON object each. Lines of a request end with its id, and with
//! its trace's id if there is a collector.

use std::fmt;

use tracing::{Event, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{self, FormatEvent, FormatFields, Writer};
use tracing_subscriber::registry::LookupSpan;

use super::Scope;

/// The format of log lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// Text for people.
    Text,
    /// One JSON object per line.
    Json,
}

/// Starts logging what passes `filter`; a second call changes nothing.
pub fn start(filter: &str, format: LogFormat) {
    let lines = tracing_subscriber::fmt()
        .with_env_filter(EnvFilter::new(filter))
        .with_writer(std::io::stderr);
    // The only error is that logging has been started before.
    let _ = match format {
        LogFormat::Text => {
            let is_terminal = std::io::IsTerminal::is_terminal(&std::io::stderr());
            lines
                .with_ansi(is_terminal)
                .event_format(text(is_terminal))
                .try_init()
        }
        LogFormat::Json => lines
            .fmt_fields(format::JsonFields::new())
            .event_format(json())
            .try_init(),
    };
}

fn text(has_colours: bool) -> WithRequest<format::Format> {
    WithRequest {
        format: format::format().with_ansi(has_colours),
        is_json: false,
    }
}

fn json() -> WithRequest<format::Format<format::Json>> {
    // Without spans of libraries, which would nest.
    let format = format::json()
        .flatten_event(true)
        .with_current_span(false)
        .with_span_list(false);
    WithRequest {
        format,
        is_json: true,
    }
}

/// Adds the ids of the request to a line of `format`.
struct WithRequest<F> {
    format: F,
    is_json: bool,
}

impl<S, N, F> FormatEvent<S, N> for WithRequest<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let mut line = String::new();
        self.format
            .format_event(context, Writer::new(&mut line), event)?;
        let line = line.trim_end_matches('\n');
        writer.write_str(if self.is_json {
            line.strip_suffix('}').unwrap_or(line)
        } else {
            line
        })?;
        // Neither id has characters that JSON escapes.
        let mut write = |name: &str, id: &dyn fmt::Display| {
            if self.is_json {
                write!(writer, r#","{name}":"{id}""#)
            } else {
                write!(writer, " {name}={id}")
            }
        };
        let scope = Scope::current();
        scope.id().map_or(Ok(()), |id| write("id", &id))?;
        scope
            .trace_id()
            .map_or(Ok(()), |id| write("trace_id", &id))?;
        writer.write_str(if self.is_json { "}\n" } else { "\n" })
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
        Scope::untraced("r-1")
            .enter(|| tracing::error!(why = "a \"quoted\" }\nword\u{1b}[31m", "inside"));
    }

    #[test]
    fn a_line_of_text_ends_with_the_id_of_its_request() {
        let paper = Paper::default();
        let told = paper.clone();
        let lines = tracing_subscriber::fmt()
            .with_ansi(false)
            .event_format(text(false));
        tracing::subscriber::with_default(lines.with_writer(move || told.clone()).finish(), talk);
        let text = paper.text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2, "what is told cannot begin a line: {text}");
        assert!(
            lines[0].ends_with("outside") && lines[1].ends_with(" id=r-1"),
            "{text}"
        );
        assert!(!text.contains('\u{1b}'), "{text}");
    }

    #[test]
    fn a_line_of_json_is_one_flat_object() {
        let paper = Paper::default();
        let told = paper.clone();
        let lines = tracing_subscriber::fmt()
            .fmt_fields(format::JsonFields::new())
            .event_format(json());
        tracing::subscriber::with_default(lines.with_writer(move || told.clone()).finish(), || {
            tracing::error_span!("of a library", id = "nested").in_scope(talk);
        });
        let text = paper.text();
        let lines: Vec<serde_json::Value> = text
            .lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect();
        assert_eq!(lines.len(), 2);
        assert_eq!(
            (&lines[0]["message"], &lines[0]["id"]),
            (&"outside".into(), &serde_json::Value::Null)
        );
        assert_eq!(
            (&lines[1]["message"], &lines[1]["id"]),
            (&"inside".into(), &"r-1".into())
        );
        assert_eq!(lines[1]["why"], "a \"quoted\" }\nword\u{1b}[31m");
        for line in lines {
            assert!(
                line.as_object()
                    .unwrap()
                    .values()
                    .all(|value| !value.is_object() && !value.is_array()),
                "{line}"
            );
        }
    }
}
