//! Any bytes as a session token. Those with an odd first byte have the server's header and a right
//! signature made for what follows, so that the claims behind it are met. Who is let in has claims
//! that a server could have written; who is not is told one of three codes.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::LazyLock;
use std::time::Duration;

use data_encoding::BASE64URL_NOPAD;
use hmac::{Hmac, KeyInit as _, Mac as _};
use mlswarp_server::app::App;
use mlswarp_server::auth::tokens::Wanted;
use mlswarp_server::config::Config;
use mlswarp_server::wire::TokenOp;
use serde_json::Value;
use sha2::Sha256;

use super::assert_is_problem;

const KEY: &str = "ann-s-key-0123456789";
/// When the seeds are valid, seconds since 1970.
const NOW: u64 = 1_795_701_000;
const SESSION: &str = "3e6cbb0e-5b4f-4f0c-9b7e-0a8f2c6a1d11";
const SECRET: &str = "k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1k1";
const HEADER: &str = r#"{"alg":"HS256","kid":"k1","typ":"mlswarp+jwt"}"#;

static APP: LazyLock<App> = LazyLock::new(|| {
    let file = std::env::temp_dir().join(format!("mlswarp-fuzz-secrets-{}", std::process::id()));
    std::fs::write(&file, format!("k1 {SECRET}\n")).expect("a file for the secret");
    let path = file.to_str().expect("a plain path");
    let keys = format!("ann {KEY}");
    let options = ["mlswarp", "--keys", &keys, "--token-secrets-file", path];
    let app = App::new(Config::read(options).expect("options")).expect("a server");
    let _ = std::fs::remove_file(&file);
    app.access().clock().set(Duration::from_secs(NOW));
    app
});

pub(super) fn check(bytes: &[u8]) {
    let Some((first, rest)) = bytes.split_first() else {
        return;
    };
    let token = if first % 2 == 1 {
        signed(rest)
    } else {
        String::from_utf8_lossy(rest).into_owned()
    };
    let wanted = Wanted {
        op: Some(TokenOp::Warp),
        session: Some(SESSION),
    };
    let here = IpAddr::from(Ipv4Addr::LOCALHOST);
    match APP.access().admit(here, Some(&token), wanted) {
        Ok(_) if token == KEY => {}
        Ok(_) => {
            assert!(token.len() <= 512);
            let claims = token.split('.').nth(1).expect("three parts");
            let claims = BASE64URL_NOPAD
                .decode(claims.as_bytes())
                .expect("base64url");
            let claims: Value = serde_json::from_slice(&claims).expect("claims are JSON");
            assert_eq!(
                claims["sid"].as_str().map(str::to_lowercase).as_deref(),
                Some(SESSION)
            );
            let ops = claims["ops"].as_array().expect("a list");
            assert!(ops.iter().any(|op| op == "warp"));
            let [begins, ends] = ["iat", "exp"].map(|name| claims[name].as_u64().expect("whole"));
            assert!(begins < ends && ends - begins <= 3600);
        }
        Err(problem) => {
            let codes = ["unauthorized", "token_expired", "forbidden"];
            assert!(codes.contains(&problem.code.as_str()), "{problem}");
            assert_is_problem(&problem.to_json("", None));
        }
    }
}

fn signed(claims: &[u8]) -> String {
    let parts = [HEADER.as_bytes(), claims].map(|part| BASE64URL_NOPAD.encode(part));
    let signed = parts.join(".");
    let key = Hmac::<Sha256>::new_from_slice(SECRET.as_bytes()).expect("any key");
    let tag = key.chain_update(&signed).finalize().into_bytes();
    format!("{signed}.{}", BASE64URL_NOPAD.encode(&tag))
}
