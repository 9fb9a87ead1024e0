//! Names that the program does not have: variables of the environment, and options of the command
//! line. The message names the one that was probably meant for each, of those that have an effect
//! there.

use clap::error::{ContextKind, ContextValue, Error, ErrorKind};
use clap::{Arg, Command};

use super::option::variable;
use crate::problem::words::nearest;

/// Variables that are no options: the engine's level of instructions, and those of the tests.
const OTHER_VARIABLES: [&str; 2] = ["MLSWARP_LEVEL", "MLSWARP_TESTS_FULL"];

/// A sentence for each variable of this environment that begins like those of the program and is
/// none of them. It has no effect: a misspelt limit would be no limit.
pub fn unknown_variables() -> Vec<String> {
    let mut names: Vec<String> = std::env::vars_os()
        .filter_map(|(name, _)| name.into_string().ok())
        .collect();
    names.sort_unstable();
    unknown_of(&names, &super::command())
}

fn unknown_of(names: &[String], command: &Command) -> Vec<String> {
    let flags: Vec<&str> = command.get_arguments().filter_map(Arg::get_long).collect();
    // Kubernetes sets these for a service with the name `mlswarp`.
    let is_linked = names.iter().any(|name| name == "MLSWARP_SERVICE_HOST");
    let is_link = |name: &str| {
        is_linked
            && ["MLSWARP_SERVICE_", "MLSWARP_PORT"]
                .iter()
                .any(|link| name.starts_with(link))
    };
    let is_known = |name: &str| {
        OTHER_VARIABLES.contains(&name) || flags.iter().any(|flag| variable(flag) == name)
    };
    let unknown = names
        .iter()
        .filter_map(|name| Some((name, name.strip_prefix("MLSWARP_")?)));
    let unknown = unknown.filter(|(name, _)| !is_known(name) && !is_link(name));
    let sentence = |(name, own): (&String, &str)| {
        let meant = nearest(&own.replace('_', "-"), flags.iter().copied());
        let meant = meant.map_or_else(String::new, |flag| {
            format!("; did you mean {}?", variable(flag))
        });
        format!("the variable {name} is not known and has no effect{meant}")
    };
    unknown.map(sentence).collect()
}

/// Replaces the suggestion of clap, which also knows the options that have no effect on the
/// subcommand. `flags`: those that have one.
pub(super) fn suggest_effective(mut error: Error, flags: &[String]) -> Error {
    let Some(ContextValue::String(given)) = error
        .get(ContextKind::InvalidArg)
        .filter(|_| error.kind() == ErrorKind::UnknownArgument)
    else {
        return error;
    };
    let name = given
        .trim_start_matches('-')
        .split('=')
        .next()
        .unwrap_or_default()
        .to_owned();
    let meant = nearest(&name, flags.iter().map(String::as_str))
        .map(|flag| ContextValue::String(format!("--{flag}")));
    // How to pass a word that begins with `--` as a value: that is not meant.
    error.remove(ContextKind::Suggested);
    error.remove(ContextKind::SuggestedArg);
    if let Some(meant) = meant {
        error.insert(ContextKind::SuggestedArg, meant);
    }
    error
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, command};

    #[test]
    fn unknown_variables_are_named_with_the_nearest_known_one() {
        let told = |names: &[&str]| {
            unknown_of(
                &names.iter().map(ToString::to_string).collect::<Vec<_>>(),
                &command(),
            )
        };
        for known in [
            "MLSWARP_LISTEN",
            "MLSWARP_MAX_SESSIONS",
            "MLSWARP_LEVEL",
            "PATH",
            "mlswarp_x",
            "XMLSWARP_LISTEN",
        ] {
            assert_eq!(told(&[known]), [""; 0], "{known}");
        }
        for (name, meant) in [
            ("MLSWARP_MAX_SESION", Some("MLSWARP_MAX_SESSIONS")),
            ("MLSWARP_MEMORY_BYTE", Some("MLSWARP_MEMORY_BYTES")),
            ("MLSWARP_KEY_FILE", Some("MLSWARP_KEYS_FILE")),
            ("MLSWARP_listen", Some("MLSWARP_LISTEN")),
            ("MLSWARP_PORT", None),
            ("MLSWARP_FROBNICATE", None),
            ("MLSWARP_", None),
        ] {
            let meant = meant.map_or_else(String::new, |meant| format!("; did you mean {meant}?"));
            assert_eq!(
                told(&[name]),
                [format!(
                    "the variable {name} is not known and has no effect{meant}"
                )]
            );
        }
        let links = [
            "MLSWARP_PORT",
            "MLSWARP_PORT_8080_TCP",
            "MLSWARP_SERVICE_HOST",
            "MLSWARP_SERVICE_PORT_HTTP",
            "MLSWARP_STOER",
        ];
        assert_eq!(
            told(&links),
            [
                "the variable MLSWARP_STOER is not known and has no effect; did you mean \
                    MLSWARP_STORE?"
            ]
        );
    }

    #[test]
    fn only_options_with_an_effect_are_suggested() {
        for (line, meant) in [
            (
                &["mlswarp", "map", "a", "--canvsa", "fit"][..],
                Some("--canvas"),
            ),
            (
                &["mlswarp", "warp", "a", "--strenth", "2"],
                Some("--strength"),
            ),
            (&["mlswarp", "report", "a", "--wdith", "2"], None),
            (&["mlswarp", "points", "a", "--stor", "x"], None),
            (
                &["mlswarp", "points", "a", "--extnt", "4,3"],
                Some("--extent"),
            ),
            (
                &["mlswarp", "points", "a", "--max-colums=9"],
                Some("--max-columns"),
            ),
            (&["mlswarp", "health", "--lisen", "x"], Some("--listen")),
            (&["mlswarp", "serve", "--stor", "x"], Some("--store")),
            (&["mlswarp", "--stor", "x"], Some("--store")),
            (&["mlswarp", "--frobnicate"], None),
        ] {
            let told = Config::read(line).unwrap_err().to_string();
            let tip = told
                .lines()
                .find(|text| text.contains("tip:"))
                .unwrap_or_default();
            assert_eq!(
                tip.contains("similar argument"),
                meant.is_some(),
                "{line:?}: {told}"
            );
            assert!(
                tip.contains(meant.unwrap_or_default()) && !told.contains("as a value"),
                "{line:?}: {told}"
            );
        }
    }
}
