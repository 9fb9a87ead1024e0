//! What the service says beside an answer: warnings of a warp, and warnings of the log about
//! secrets.

use std::os::unix::fs::PermissionsExt as _;
use std::time::Duration;

use serde_json::{Value, json};

use crate::support::program::Program;
use crate::support::{DragClient, Scratch, Server, photo};
use crate::tls::Folder;

fn warns(response: &reqwest::Response) -> bool {
    assert_eq!(response.status(), 200);
    let warnings = response
        .headers()
        .get("warp-warning")
        .map_or("", |text| text.to_str().unwrap());
    warnings.split(", ").any(|code| code == "nothing_visible")
}

#[tokio::test]
async fn handles_that_leave_nothing_visible_are_answered_with_a_warning() {
    let server = Server::start(&[]).await;
    let (image, p) = (photo(64, 48), json!([[10, 10], [50, 40]]));
    let by = |x: i32, y: i32| json!([[10 + x, 10 + y], [50 + x, 40 + y]]);
    let id = server.session(&image, &json!({"p": p})).await;
    for (q, nothing) in [
        (by(0, 0), false),
        (by(60, 0), false),
        (by(70, 0), true),
        (by(0, -60), true),
        (by(-500_000, 900_000), true),
    ] {
        for outside in ["transparent", "edge"] {
            let warp = json!({"p": p, "q": q, "output": {"outside": outside}});
            assert_eq!(
                warns(&server.upload("/warp", &image, &warp).await),
                nothing,
                "{q} {outside}"
            );
        }
        let posed = json!({"q": q});
        for path in ["warp", "mesh"] {
            let answer = server
                .post(&format!("/sessions/{id}/{path}"))
                .json(&posed)
                .send()
                .await
                .unwrap();
            assert_eq!(warns(&answer), nothing, "{path} {q}");
        }
    }
    // One cell alone, within which the whole picture lies.
    let enlarged = json!({"p": [[31, 24], [33, 24]], "q": [[-10_000, 24], [10_000, 24]],
        "method": "similarity", "grid": {"columns": 2, "rows": 2}});
    assert!(!warns(&server.upload("/warp", &image, &enlarged).await));
    let mut drag = DragClient::open(server.address, &id, "?report=true").await;
    for (seq, q, nothing) in [(1, by(70, 0), true), (2, by(1, 0), false)] {
        drag.pose(seq, &q).await;
        let report = drag.text().await;
        let warnings = report["warnings"].as_array().unwrap();
        assert_eq!(
            warnings.contains(&Value::from("nothing_visible")),
            nothing,
            "{report}"
        );
        drag.ack_of_next_frame(seq).await;
    }
}

/// The log of a program that is stopped when it has said what is waited for.
fn logged(args: &[&str], meanwhile: impl FnOnce()) -> String {
    let program = Program::start(args);
    meanwhile();
    program.terminate();
    let (status, log) = program.wait();
    assert!(status.success(), "{log}");
    log
}

#[test]
fn secrets_that_other_users_can_read_are_warned_of() {
    const WARNING: &str = "other users can read or write";
    let (scratch, tls) = (Scratch::new(), Folder::new("secrets"));
    let keys = scratch.path("keys");
    std::fs::write(&keys, "ann ann-s-key-0123456789\n").unwrap();
    let mode = |path: &std::path::Path, mode: u32| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap()
    };
    let tls_key = tls.files().key;
    let args: Vec<String> = [
        vec!["--keys-file".to_owned(), keys.clone()],
        tls.options().to_vec(),
    ]
    .concat();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    // A group may read: secrets of Kubernetes are mounted so. Certificates are no secret.
    for (of_keys, of_tls_key, warned) in [
        (0o600, 0o600, [false, false]),
        (0o440, 0o640, [false, false]),
        (0o644, 0o600, [true, false]),
        (0o400, 0o604, [false, true]),
    ] {
        mode(keys.as_ref(), of_keys);
        mode(&tls_key, of_tls_key);
        let log = logged(&args, || ());
        let told = |path: &str| {
            log.lines()
                .any(|line| line.contains("WARN") && line.contains(WARNING) && line.contains(path))
        };
        assert_eq!(
            [told(&keys), told(tls_key.to_str().unwrap())],
            warned,
            "{of_keys:o} {of_tls_key:o}: {log}"
        );
        assert!(!log.contains("0123456789"), "{log}");
    }
    // Also when a file has changed.
    mode(keys.as_ref(), 0o600);
    mode(&tls_key, 0o600);
    let log = logged(&args, || {
        std::fs::write(
            &keys,
            "ann ann-s-key-0123456789\nbob bob-s-key-9876543210\n",
        )
        .unwrap();
        mode(keys.as_ref(), 0o666);
        // Files are looked at every second.
        std::thread::sleep(Duration::from_secs(4));
    });
    assert!(
        log.contains(WARNING) && log.contains("mode 666") && log.contains("chmod o-rwx"),
        "{log}"
    );
}
