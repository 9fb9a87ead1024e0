//! `deploy/env.example` is the program's own declaration of its variables, written as a file of the
//! environment. `MLSWARP_BLESS=1` rewrites it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Arg;
use mlswarp_server::config::{Config, command};

use crate::support::program::{Program, mlswarp};

const HEAD: &str = "\
# All settings with their defaults. To change one, remove the # in front of it and edit the value \
after the =.
#
# systemd reads this file by EnvironmentFile= (systemd/mlswarp.service), Docker by --env-file, \
Compose by env_file. All of them accept one
# variable per line, comments on lines of their own, and values without quotes and without ${...}.
# MLSWARP_KEYS, and MLSWARP_STORE with a password, are secrets: if you set them, make this file \
unreadable for other users.
# Generated from the options of the program; tests/it/environment.rs compares.
";

fn path() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../deploy/env.example")
}

/// Every option that has a variable.
fn options() -> Vec<Arg> {
    command()
        .get_arguments()
        .filter(|option| option.get_env().is_some())
        .cloned()
        .collect()
}

fn variable(option: &Arg) -> &str {
    option.get_env().unwrap().to_str().unwrap()
}

fn default(option: &Arg) -> &str {
    let [value] = option.get_default_values() else {
        panic!("{} has one default", variable(option))
    };
    value.to_str().unwrap()
}

fn expected() -> String {
    let mut text = HEAD.to_owned();
    for option in options() {
        let kinds: Vec<_> = option
            .get_value_names()
            .unwrap()
            .iter()
            .map(|name| name.as_str())
            .collect();
        write!(
            text,
            "\n# {} ({})\n#{}={}\n",
            option.get_help().unwrap(),
            kinds.join(" "),
            variable(&option),
            default(&option)
        )
        .unwrap();
    }
    text
}

/// The variables of a text whose every `#NAME=` has lost its `#`, by the rules that all readers
/// share.
fn uncommented(text: &str) -> BTreeMap<&str, &str> {
    let mut variables = BTreeMap::new();
    for line in text.lines().filter(|line| line.starts_with("#MLSWARP_")) {
        let (name, value) = line[1..].split_once('=').unwrap();
        assert!(
            name.bytes().all(|b| b.is_ascii_uppercase() || b == b'_'),
            "{name}"
        );
        assert!(
            !value.contains([' ', '\t', '"', '\'', '\\', '$', '`', '#', ';']),
            "not every reader takes it as it is: {line}"
        );
        assert!(variables.insert(name, value).is_none(), "{name} twice");
    }
    variables
}

#[test]
fn environment_example_is_what_the_program_declares() {
    let expected = expected();
    if std::env::var_os("MLSWARP_BLESS").is_some() {
        std::fs::write(path(), &expected).unwrap();
    }
    let written = std::fs::read_to_string(path()).unwrap();
    assert!(
        written == expected,
        "deploy/env.example is not what the program declares; MLSWARP_BLESS=1 rewrites it"
    );
    assert!(written.lines().all(|line| line.is_empty()
        || line.starts_with("# ")
        || line == "#"
        || line.starts_with("#MLSWARP_")));
    assert_eq!(uncommented(&written).len(), options().len());
}

#[test]
fn environment_example_uncommented_is_the_default_configuration() {
    let written = expected();
    let variables = uncommented(&written);
    let flags = options().into_iter().map(|option| {
        format!(
            "--{}={}",
            option.get_long().unwrap(),
            variables[variable(&option)]
        )
    });
    let config = Config::read(std::iter::once("mlswarp".to_owned()).chain(flags)).unwrap();
    assert_eq!(config, Config::default());
}

#[test]
fn environment_example_uncommented_starts_the_program() {
    let written = expected();
    let mut variables = uncommented(&written);
    // The only one that another program of this machine may contradict.
    variables.insert("MLSWARP_LISTEN", "127.0.0.1:0");
    let mut command = mlswarp(&["serve"]);
    command.envs(variables);
    let program = Program::spawn(command);
    program.terminate();
    assert!(program.wait().0.success());
}

/// A limit whose name is misspelt would be no limit.
#[test]
fn unknown_variables_are_named_at_the_start() {
    let mut command = mlswarp(&["serve", "--listen", "127.0.0.1:0"]);
    command
        .env("MLSWARP_MAX_SESION", "3")
        .env("MLSWARP_FROBNICATE", "1");
    let program = Program::spawn(command);
    program.terminate();
    let (_, log) = program.wait();
    for said in [
        "the variable MLSWARP_MAX_SESION is not known and has no effect; did you mean \
            MLSWARP_MAX_SESSIONS?",
        "the variable MLSWARP_FROBNICATE is not known and has no effect",
    ] {
        assert!(
            log.lines()
                .any(|line| line.contains("WARN") && line.contains(said)),
            "{said} in {log}"
        );
    }
    assert_eq!(log.matches("is not known").count(), 2, "{log}");
    let offline = mlswarp(&["report", "none.json", "--extent", "4,3"])
        .env("MLSWARP_MAX_COLUMS", "9")
        .output()
        .unwrap();
    let said = String::from_utf8(offline.stderr).unwrap();
    assert!(
        said.starts_with("warning: the variable MLSWARP_MAX_COLUMS is not known")
            && said.contains("MLSWARP_MAX_COLUMNS?"),
        "{said}"
    );
}

#[test]
fn a_flag_takes_precedence_over_a_wrong_variable() {
    let code = |args: &[&str]| {
        mlswarp(args)
            .env("MLSWARP_METRICS_LISTEN", "none")
            .env("MLSWARP_LISTEN", "127.0.0.1:1")
            .output()
            .unwrap()
    };
    for args in [
        ["health", "--metrics-listen", "127.0.0.1:2"],
        ["--metrics-listen", "127.0.0.1:2", "health"],
    ] {
        assert_eq!(
            code(&args).status.code(),
            Some(1),
            "{args:?}: nobody listens there"
        );
    }
    let wrong = code(&["health"]);
    let text = String::from_utf8(wrong.stderr).unwrap();
    assert_eq!(
        (
            wrong.status.code(),
            text.matches("MLSWARP_METRICS_LISTEN").count()
        ),
        (Some(2), 1),
        "{text}"
    );
}
