//! The program as a user starts it: options, health, signals.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use crate::support::photo;
use crate::support::program::{Program, mlswarp};
use crate::support::server::form;

#[test]
fn mistakes_in_flags_and_variables_are_told_all_at_once() {
    let output = mlswarp(&["--workers", "many", "--body-timeout", "30"])
        .env("MLSWARP_MAX_BODY_BYTES", "huge")
        .env("MLSWARP_LISTEN", "nowhere")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8(output.stderr).unwrap();
    for (option, value) in [
        ("--workers (MLSWARP_WORKERS)", "many"),
        ("--body-timeout", "30"),
        ("MLSWARP_MAX_BODY_BYTES", "huge"),
        ("MLSWARP_LISTEN", "nowhere"),
    ] {
        assert!(
            said.lines()
                .any(|line| line.contains(option) && line.contains(&format!("`{value}`"))),
            "{option} in {said}"
        );
    }
    for (args, similar) in [
        (["--workrs", "3"], "'--workers'"),
        (["helth", "--listen=127.0.0.1:1"], "'health'"),
    ] {
        let output = mlswarp(&args).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(2) && said.contains(similar),
            "{said}"
        );
    }
}

#[test]
fn a_flag_wins_over_its_variable() {
    let output = mlswarp(&["--listen", "wrong-flag"])
        .env("MLSWARP_LISTEN", "wrong-variable")
        .output()
        .unwrap();
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("wrong-flag")
    );
}

#[test]
fn help_names_every_default_and_variable() {
    let output = mlswarp(&["serve", "--help"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    let help = String::from_utf8(output.stdout).unwrap();
    for word in [
        "MLSWARP_LISTEN",
        "127.0.0.1:8080",
        "MLSWARP_MAX_BODY_BYTES",
        "32MiB",
        "MLSWARP_SESSION_IDLE",
        "15m",
    ] {
        assert!(help.contains(word), "{word} in {help}");
    }
    let version = mlswarp(&["--version"]).output().unwrap();
    assert_eq!(
        String::from_utf8(version.stdout).unwrap().trim(),
        concat!("mlswarp ", env!("CARGO_PKG_VERSION"))
    );
}

/// What the options of a subcommand are, as its help shows them: its own, then its limits.
fn shown(subcommand: &str) -> Vec<String> {
    let limits = if ["serve", "health"].contains(&subcommand) {
        vec![]
    } else {
        listed(subcommand, "--help-limits")
    };
    [listed(subcommand, "--help"), limits].concat()
}

fn listed(subcommand: &str, help: &str) -> Vec<String> {
    let output = mlswarp(&[subcommand, help]).output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    // Continued texts are indented further.
    let flags = help
        .lines()
        .filter(|line| line.starts_with("  -") || line.starts_with("      --"))
        .map(|line| line.split_once("--").unwrap().1);
    let flags = flags.map(|flag| flag.split([' ', '[']).next().unwrap().to_owned());
    flags
        .filter(|flag| !["help", "help-limits"].contains(&&**flag))
        .collect()
}

#[test]
fn help_of_a_subcommand_shows_what_has_an_effect_on_it_and_the_rest_is_rejected() {
    let limits = [
        "max-body-bytes",
        "max-warp-json-bytes",
        "max-image-pixels",
        "max-image-side",
        "max-columns",
        "max-fit-handles",
        "max-plan-bytes",
    ];
    let handles = [
        "landmarks",
        "landmarks-q",
        "extent-p",
        "extent-q",
        "item",
        "match",
    ];
    let (pose, frame) = (
        ["align", "alpha", "method", "strength"],
        ["canvas", "width"],
    );
    assert_eq!(
        shown("warp"),
        [
            &handles[..],
            &["kind", "region"],
            &pose,
            &frame,
            &["format", "quality", "out"],
            &limits,
            &["workers"]
        ]
        .concat()
    );
    let rest = [&["out"][..], &limits, &["workers", "memory-bytes"]].concat();
    assert_eq!(
        shown("points"),
        [
            &handles[..],
            &["extent", "image", "inverse"],
            &pose,
            &frame,
            &rest
        ]
        .concat()
    );
    assert_eq!(
        shown("report"),
        [
            &handles[..],
            &["extent", "image"],
            &pose,
            &["canvas"],
            &rest
        ]
        .concat()
    );
    assert_eq!(
        shown("map"),
        [
            &handles[..],
            &["direction", "extent", "image"],
            &pose,
            &frame,
            &rest
        ]
        .concat()
    );
    assert_eq!(
        shown("fit"),
        [&handles[..], &["extent", "image", "align"], &rest].concat()
    );
    let own = [
        "and-back", "delay", "easing", "layer", "loop", "region", "steps",
    ];
    let files = ["format", "quality", "out", "quiet"];
    assert_eq!(
        shown("batch"),
        [
            &handles[..],
            &own,
            &pose,
            &frame,
            &files,
            &limits,
            &["workers", "memory-bytes"]
        ]
        .concat()
    );
    assert_eq!(
        shown("blend"),
        [
            &["landmarks", "colour", "shape", "space", "steps"][..],
            &["align", "alpha", "method"],
            &frame,
            &files,
            &limits,
            &["workers", "memory-bytes"]
        ]
        .concat()
    );
    assert_eq!(
        shown("health"),
        ["listen", "tls-cert", "tls-key", "metrics-listen"]
    );
    assert!(shown("serve").len() > 40);
    for args in [
        [
            "warp",
            "a.png",
            "b.json",
            "-o",
            "c.png",
            "--listen",
            "127.0.0.1:1",
        ],
        ["--log", "off", "warp", "a.png", "b.json", "-o", "c.png"],
    ] {
        let output = mlswarp(&args).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(2) && said.contains("has no effect on `mlswarp warp`"),
            "{said}"
        );
    }
    // A variable may be meant for the server.
    let output = mlswarp(&["warp", "missing.png", "missing.json", "-o", "c.png"])
        .env("MLSWARP_LISTEN", "127.0.0.1:1")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn limits_apply_offline() {
    let image = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/images/chelsea.png"
    );
    for (option, value, told) in [
        ("--max-image-pixels", "1000", "too_large"),
        ("--max-image-side", "100", "too_large"),
        ("--max-body-bytes", "1000", "too_large"),
        ("--max-warp-json-bytes", "10", "too_large"),
        ("--max-columns", "1", "too_large"),
    ] {
        let warp = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../api/examples/stretched-cat.json"
        );
        let output = mlswarp(&["warp", image, warp, "-o", "/dev/null", option, value])
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(1) && said.starts_with(told),
            "{option}: {said}"
        );
    }
}

#[test]
fn a_port_in_use_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let output = mlswarp(&["--listen", &address]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains(&format!("cannot listen on {address}")),
        "{said}"
    );
}

#[test]
fn health_asks_the_server() {
    let program = Program::start(&[]);
    let port = program.address.port();
    for listen in [format!("127.0.0.1:{port}"), format!("0.0.0.0:{port}")] {
        assert!(
            mlswarp(&["health", "--listen", &listen])
                .status()
                .unwrap()
                .success(),
            "{listen}"
        );
    }
    program.terminate();
    assert!(program.wait().0.success());
    for (variable, option) in [
        ("MLSWARP_LISTEN", "--listen"),
        ("MLSWARP_METRICS_LISTEN", "--metrics-listen"),
    ] {
        let output = mlswarp(&["health"])
            .env(variable, format!("127.0.0.1:{port}"))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(1));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            said.contains(&format!("no server answers at 127.0.0.1:{port}: ")),
            "{said}"
        );
        assert!(said.contains(&format!("{option} ({variable})")), "{said}");
    }
}

#[tokio::test]
async fn a_terminated_server_finishes_what_it_has_begun() {
    let program = Program::start(&["--log-format", "json"]);
    let url = format!("http://{}/warp", program.address);
    let warp = r#"{"p": [[100, 100], [900, 700]], "q": [[140, 130], [900, 700]],
      "output": {"compression": "best"}}"#;
    let mut response = reqwest::Client::new()
        .post(url)
        .multipart(form(&photo(2000, 1500), warp))
        .send()
        .await
        .unwrap();
    assert_eq!(response.status(), 200);
    let mut file = response.chunk().await.unwrap().unwrap().to_vec();
    program.terminate();
    while let Some(chunk) = response.chunk().await.unwrap() {
        file.extend_from_slice(&chunk);
    }
    let read = crate::support::picture::decoded(&file);
    assert_eq!((read.width, read.height), (2000, 1500));
    drop(response);
    let (status, log) = program.wait();
    assert_eq!(status.code(), Some(0), "{log}");
    let lines: Vec<serde_json::Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let answered = lines
        .iter()
        .find(|line| line["message"] == "answered")
        .unwrap();
    assert_eq!(
        (&answered["route"], &answered["status"]),
        (&"/warp".into(), &200.into())
    );
    assert!(lines.iter().any(|line| line["message"] == "stopped"));
}

#[test]
fn silent_and_slow_connections_are_closed() {
    let program = Program::start(&["--header-timeout", "300ms"]);
    for said in [
        "",
        "P",
        "PRI * HTTP/2.0\r\n\r\nSM",
        "GET /hea",
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\n",
    ] {
        let mut stream = TcpStream::connect(program.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        stream.write_all(said.as_bytes()).unwrap();
        let mut rest = Vec::new();
        // An end or a reset: either is a closed connection, a timeout is not.
        match stream.read_to_end(&mut rest) {
            Ok(_) => {}
            Err(e) => assert_eq!(e.kind(), std::io::ErrorKind::ConnectionReset, "{said:?}"),
        }
    }
}
