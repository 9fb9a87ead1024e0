//! Session tokens: what each opens, what each mistake is answered, and when they end.

use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv4Addr};
use std::time::{Duration, Instant, SystemTime};

use data_encoding::BASE64URL_NOPAD;
use hmac::{Hmac, KeyInit as _, Mac as _};
use mlswarp_server::auth::tokens::Wanted;
use mlswarp_server::http::{Access, paths, token_routes};
use mlswarp_server::wire::TokenOp;
use reqwest::{Method, RequestBuilder, Response};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};
use tokio::net::TcpStream;
use tokio_tungstenite::client_async;
use tokio_tungstenite::tungstenite::client::IntoClientRequest as _;

use crate::keys::asked;
use crate::support::drag_client::Received;
use crate::support::program::Program;
use crate::support::redis::Redis;
use crate::support::server::{form, problem};
use crate::support::{DragClient, Scratch, Server, eventually, photo};

const ANN: &str = "ann-s-key-0123456789";
const BOB: &str = "bob-s-key-9876543210";
const NAME: &str = "3e6cbb0e-5b4f-4f0c-9b7e-0a8f2c6a1d11";
const OTHER: &str = "8f3b1c1e-6f0a-4c8e-9d53-0f1a2b3c4d5e";
const HEADER: &str = r#"{"alg":"HS256","kid":"k1","typ":"mlswarp+jwt"}"#;

/// The secret of a KID.
fn secret(kid: &str) -> String {
    kid.repeat(32)
}

/// A server with two keys and a file of secrets.
struct Site {
    folder: Scratch,
    server: Server,
}

impl Site {
    async fn start(more: &[&str]) -> Self {
        let folder = Scratch::new();
        let site = |name: &str| folder.path(name);
        write(&folder, "secrets", &format!("k1 {}\n", secret("k1")));
        write(&folder, "keys", &format!("ann {ANN}\nbob {BOB}\n"));
        let (keys, secrets) = (site("keys"), site("secrets"));
        let options = ["--keys-file", &keys, "--token-secrets-file", &secrets];
        let server = Server::start(&[&options, more].concat()).await;
        Self { folder, server }
    }

    async fn open(&self, id: &str) {
        let opened = self
            .server
            .client
            .put(self.server.url(&format!("/sessions/{id}")))
            .bearer_auth(ANN)
            .multipart(upload())
            .send()
            .await
            .unwrap();
        assert!(opened.status().is_success(), "{:?}", opened.text().await);
    }

    async fn mint(&self, id: &str, body: &Value) -> Response {
        self.server
            .post(&format!("/sessions/{id}/tokens"))
            .bearer_auth(ANN)
            .json(body)
            .send()
            .await
            .unwrap()
    }

    async fn token(&self, id: &str, body: &Value) -> String {
        let minted = self.mint(id, body).await;
        assert_eq!(minted.status(), 201, "{:?}", minted.text().await);
        let minted: Value = minted.json().await.unwrap();
        minted["token"].as_str().unwrap().to_owned()
    }

    async fn read(&self, token: &str) -> Response {
        let request = self.server.get(&format!("/sessions/{NAME}"));
        request.bearer_auth(token).send().await.unwrap()
    }

    /// What a token that may read the session is answered: nothing, or a code.
    fn code(&self, token: &str) -> Option<&'static str> {
        let wanted = Wanted {
            op: Some(TokenOp::Read),
            session: Some(NAME),
        };
        let here = IpAddr::from(Ipv4Addr::LOCALHOST);
        let admitted = self.server.app.access().admit(here, Some(token), wanted);
        admitted.err().map(|problem| problem.code.as_str())
    }
}

fn write(folder: &Scratch, name: &str, text: &str) {
    std::fs::write(folder.path("new"), text).unwrap();
    std::fs::rename(folder.path("new"), folder.path(name)).unwrap();
}

fn upload() -> reqwest::multipart::Form {
    let rest = json!({"p": [[4, 4], [12, 8], [3, 9], [13, 2]]});
    form(&photo(16, 12), rest.to_string())
}

fn pose() -> Value {
    json!([[5, 4], [12, 8], [3, 9], [13, 2]])
}

fn now() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.unwrap().as_secs()
}

fn encoded(bytes: impl AsRef<[u8]>) -> String {
    BASE64URL_NOPAD.encode(bytes.as_ref())
}

fn hmac(secret: &str, signed: &[u8]) -> Vec<u8> {
    let key = Hmac::<Sha256>::new_from_slice(secret.as_bytes()).unwrap();
    key.chain_update(signed).finalize().into_bytes().to_vec()
}

/// What the server says of a key, made here from the description alone.
fn mark(kid: &str, key: &str) -> String {
    let signed = [b"mlswarp key\0", &Sha256::digest(key)[..]].concat();
    encoded(&hmac(&secret(kid), &signed)[..8])
}

fn owner(name: &str) -> String {
    encoded(&Sha256::digest([b"mlswarp owner\0", name.as_bytes()].concat())[..16])
}

fn claims() -> Value {
    json!({"aud": "mlswarp", "own": owner("ann"), "key": mark("k1", ANN), "sid": NAME,
        "ops": ["read"], "iat": now(), "exp": now() + 600, "jti": "one"})
}

/// A token of these texts, with a right signature.
fn signed(header: &str, claims: &str) -> String {
    let signed = format!("{}.{}", encoded(header), encoded(claims));
    format!(
        "{signed}.{}",
        encoded(hmac(&secret("k1"), signed.as_bytes()))
    )
}

/// The claims with one of them changed; removed by null.
fn with(name: &str, value: Value) -> String {
    let mut claims = claims();
    if value.is_null() {
        claims.as_object_mut().unwrap().remove(name);
    } else {
        claims[name] = value;
    }
    signed(HEADER, &claims.to_string())
}

/// Replaced once in the text of the claims.
fn edited(from: &str, to: &str) -> String {
    let text = claims().to_string();
    assert_eq!(text.matches(from).count(), 1, "{text}");
    signed(HEADER, &text.replace(from, to))
}

const BAD: Option<&str> = Some("unauthorized");

/// Tokens that differ from a good one in their form, and what is answered.
fn damaged(good: &str) -> Vec<(&'static str, String, Option<&'static str>)> {
    let parts: Vec<&str> = good.split('.').collect();
    let [header, body, tag] = parts[..] else {
        panic!("three parts")
    };
    let text = claims().to_string();
    let none = encoded(r#"{"alg":"none","typ":"JWT"}"#);
    let mut flipped = BASE64URL_NOPAD.decode(tag.as_bytes()).unwrap();
    flipped[31] ^= 1;
    let jti = |length: usize| with("jti", json!("j".repeat(length)));
    // Of more than 512 characters, and right otherwise.
    let spaces = |count: usize| signed(HEADER, &format!("{text}{}", " ".repeat(count)));
    let long = (0..400)
        .map(spaces)
        .find(|token| token.len() > 512)
        .unwrap();
    assert!(long.len() <= 514);
    let other = |header: &str| signed(header, &text);
    vec![
        ("no signature", format!("{header}.{body}."), BAD),
        ("two parts", format!("{header}.{body}"), BAD),
        ("one part", header.to_owned(), BAD),
        ("four parts", format!("{good}.{tag}"), BAD),
        ("alg none, unsigned", format!("{none}.{body}."), BAD),
        (
            "alg none, signed",
            other(r#"{"alg":"none","kid":"k1","typ":"mlswarp+jwt"}"#),
            BAD,
        ),
        (
            "alg HS384",
            other(r#"{"alg":"HS384","kid":"k1","typ":"mlswarp+jwt"}"#),
            BAD,
        ),
        (
            "alg hs256",
            other(r#"{"alg":"hs256","kid":"k1","typ":"mlswarp+jwt"}"#),
            BAD,
        ),
        (
            "typ JWT",
            other(r#"{"alg":"HS256","kid":"k1","typ":"JWT"}"#),
            BAD,
        ),
        (
            "no kid",
            other(r#"{"alg":"HS256","typ":"mlswarp+jwt"}"#),
            BAD,
        ),
        (
            "another kid",
            other(r#"{"alg":"HS256","kid":"k2","typ":"mlswarp+jwt"}"#),
            BAD,
        ),
        (
            "another order",
            other(r#"{"alg":"HS256","typ":"mlswarp+jwt","kid":"k1"}"#),
            BAD,
        ),
        (
            "a space in the header",
            other(&HEADER.replace(',', ", ")),
            BAD,
        ),
        (
            "one member more",
            other(&HEADER.replace('}', r#","crit":["exp"]}"#)),
            BAD,
        ),
        (
            "a key of its own",
            other(&HEADER.replace('}', r#","jwk":{"kty":"oct","k":"YQ"}}"#)),
            BAD,
        ),
        (
            "a bit of the signature",
            format!("{header}.{body}.{}", encoded(&flipped)),
            BAD,
        ),
        (
            "a byte less",
            format!("{header}.{body}.{}", encoded(&flipped[..31])),
            BAD,
        ),
        ("its last character", good[..good.len() - 1].to_owned(), BAD),
        ("padding", format!("{good}="), BAD),
        ("a line break", format!("{good}\n"), BAD),
        (
            "the standard alphabet",
            format!("{header}.{body}.{}", "+/".repeat(21) + "A"),
            BAD,
        ),
        ("swapped parts", format!("{body}.{header}.{tag}"), BAD),
        (
            "other claims",
            format!("{header}.{}.{tag}", encoded(text.replace("read", "drag"))),
            BAD,
        ),
        ("513 characters", long, BAD),
        ("a list", signed(HEADER, "[\"mlswarp\"]"), BAD),
        ("no JSON", signed(HEADER, "mlswarp"), BAD),
        ("not UTF-8", signed(HEADER, "\u{feff}{}"), BAD),
        (
            "twice exp",
            edited("\"exp\":", &format!("\"exp\":{},\"exp\":", now() + 9)),
            BAD,
        ),
        (
            "twice ops",
            edited("\"ops\":", "\"ops\":[\"read\"],\"ops\":"),
            BAD,
        ),
        ("no jti", jti(0), BAD),
        ("a long jti", jti(37), BAD),
    ]
}

/// Tokens with one wrong claim.
fn claimed() -> Vec<(&'static str, String, Option<&'static str>)> {
    let at = |iat: u64, exp: u64| {
        let mut claims = claims();
        (claims["iat"], claims["exp"]) = (iat.into(), exp.into());
        signed(HEADER, &claims.to_string())
    };
    let (now, late) = (now(), Some("token_expired"));
    let other = Some("forbidden");
    vec![
        (
            "float exp",
            edited(&format!("{}", now + 600), &format!("{}.0", now + 600)),
            BAD,
        ),
        ("exponent", with("exp", json!(1.9e9)), BAD),
        ("text exp", with("exp", json!((now + 600).to_string())), BAD),
        ("negative exp", with("exp", json!(-1)), BAD),
        ("missing exp", with("exp", Value::Null), BAD),
        ("huge exp", with("exp", json!(u64::MAX)), BAD),
        ("missing iat", with("iat", Value::Null), BAD),
        ("missing aud", with("aud", Value::Null), BAD),
        ("another aud", with("aud", json!("other")), BAD),
        ("a list as aud", with("aud", json!(["mlswarp"])), BAD),
        ("missing sid", with("sid", Value::Null), BAD),
        ("no UUID", with("sid", json!("session")), BAD),
        (
            "a UUID without hyphens",
            with("sid", json!(NAME.replace('-', ""))),
            BAD,
        ),
        ("another session", with("sid", json!(OTHER)), other),
        ("missing ops", with("ops", Value::Null), BAD),
        ("no ops", with("ops", json!([])), BAD),
        ("ops as text", with("ops", json!("read")), BAD),
        ("an unknown op", with("ops", json!(["read", "admin"])), BAD),
        ("an op twice", with("ops", json!(["read", "read"])), BAD),
        (
            "another op",
            with("ops", json!(["warp", "drag", "delete"])),
            other,
        ),
        ("an unknown claim", with("nbf", json!(now)), BAD),
        (
            "null max_bytes",
            edited("{\"aud\"", "{\"max_bytes\":null,\"aud\""),
            BAD,
        ),
        ("float max_bytes", with("max_bytes", json!(1.5)), BAD),
        ("another owner", with("own", json!(owner("bob"))), BAD),
        ("a short owner", with("own", json!("AAAA")), BAD),
        ("another key", with("key", json!(mark("k1", BOB))), BAD),
        (
            "the mark of another secret",
            with("key", json!(mark("k2", ANN))),
            BAD,
        ),
        ("expired 25 s ago", at(now - 625, now - 25), None),
        ("expired 90 s ago", at(now - 690, now - 90), late),
        ("made in 25 s", at(now + 25, now + 625), None),
        ("made in 90 s", at(now + 90, now + 690), BAD),
        ("for an hour", at(now, now + 3600), None),
        ("for more", at(now, now + 3601), BAD),
        ("for no time", at(now + 5, now + 5), BAD),
        ("backwards", at(now + 20, now + 5), BAD),
    ]
}

#[tokio::test]
async fn every_mutated_token_is_answered_the_right_code() {
    let site = Site::start(&[]).await;
    site.open(NAME).await;
    let good = signed(HEADER, &claims().to_string());
    assert_eq!(site.code(&good), None);
    // Without the server's own writer: the order of claims and spaces are free.
    let pretty = serde_json::to_string_pretty(&json!({"sid": NAME, "jti": "a.b_c-1",
        "ops": ["read"], "exp": now() + 9, "iat": now(), "key": mark("k1", ANN),
        "own": owner("ann"), "aud": "mlswarp"}));
    assert_eq!(site.code(&signed(HEADER, &pretty.unwrap())), None);
    let table = [damaged(&good), claimed()].concat();
    assert!(table.iter().filter(|(.., code)| code.is_some()).count() >= 40);
    for (what, token, code) in table {
        assert_eq!(site.code(&token), code, "{what}: {token}");
    }
    // Over HTTP, with the header that says what to send.
    let expired = with("exp", json!(now() - 90));
    let answer = site.read(&expired).await;
    assert_eq!(answer.headers()["www-authenticate"], "Bearer");
    problem(answer, 401, "token_expired").await;
    assert_eq!(site.read(&good).await.status(), 200);
    let told = problem(site.read(&format!("{good}A")).await, 401, "unauthorized").await;
    assert!(
        told["detail"].as_str().unwrap().contains("session token"),
        "{told}"
    );
    // In an address it is nothing.
    let query = site.server.get(&format!("/sessions/{NAME}?token={good}"));
    problem(query.send().await.unwrap(), 401, "unauthorized").await;
}

/// Every keyed route of the document has a row, and no row is of another route.
#[tokio::test]
async fn every_route_says_which_tokens_open_it() {
    let site = Site::start(&[]).await;
    let document: Value = site
        .server
        .get("/openapi.json")
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let keyed = paths(&site.server.app)
        .into_iter()
        .filter(|(_, access)| *access == Access::Keyed);
    let methods = |path: &'static str| {
        let item = document["paths"][path].as_object().unwrap();
        let methods = item
            .iter()
            .filter(|(_, operation)| operation["responses"].is_object());
        methods
            .map(move |(method, _)| (method.to_uppercase(), path))
            .collect::<Vec<_>>()
    };
    let documented: BTreeSet<(String, &str)> = keyed.flat_map(|(path, _)| methods(path)).collect();
    let rows = token_routes().iter();
    let rows: BTreeSet<(String, &str)> = rows
        .map(|(method, path, _)| ((*method).to_owned(), *path))
        .collect();
    assert_eq!(rows.len(), token_routes().len(), "a route has one row");
    assert_eq!(
        rows, documented,
        "say in token_routes.rs which tokens open a new route"
    );
    // And the document says the same to its readers.
    let table = document["paths"]["/sessions/{id}/tokens"]["post"]["description"].to_string();
    for op in TokenOp::ALL {
        assert!(table.contains(&format!("| `{}` |", op.as_str())), "{op:?}");
    }
    let schema = &document["components"]["schemas"]["TokenOperation"]["enum"];
    assert_eq!(*schema, json!(TokenOp::ALL.map(TokenOp::as_str)));
}

#[tokio::test]
async fn a_token_opens_exactly_the_routes_of_its_operation() {
    let site = Site::start(&[]).await;
    let server = &site.server;
    let mut opened = 0;
    for op in TokenOp::ALL {
        let token = {
            site.open(NAME).await;
            site.token(NAME, &json!({"ops": [op.as_str()]})).await
        };
        for (method, path, needed) in token_routes() {
            site.open(NAME).await;
            let layer = server
                .client
                .put(server.url(&format!("/sessions/{NAME}/layers/depth")));
            let layer = layer
                .bearer_auth(ANN)
                .body(photo(16, 12))
                .send()
                .await
                .unwrap();
            assert!(layer.status().is_success());
            let method: Method = method.parse().unwrap();
            let request = asked(server, &method, path, NAME).bearer_auth(&token);
            let answer = request.send().await.unwrap();
            let status = answer.status().as_u16();
            if *needed == Some(op) {
                assert!(
                    matches!(status, 101 | 200..=204),
                    "{op:?} {method} {path}: {status}"
                );
                opened += 1;
            } else {
                problem(answer, 403, "forbidden").await;
            }
            // Nor does it open anything of another session, whether there is one or not.
            if path.contains("{id}") {
                let request = asked(server, &method, path, OTHER).bearer_auth(&token);
                problem(request.send().await.unwrap(), 403, "forbidden").await;
            }
        }
    }
    let rows = token_routes()
        .iter()
        .filter(|(.., op)| op.is_some())
        .count();
    assert_eq!(opened, rows);
}

#[tokio::test]
async fn minting_says_what_is_wrong() {
    let site = Site::start(&[]).await;
    site.open(NAME).await;
    let minted = site.mint(NAME, &json!({})).await;
    assert_eq!(minted.status(), 201);
    assert_eq!(minted.headers()["cache-control"], "no-store");
    let minted: Value = minted.json().await.unwrap();
    assert_eq!(minted["ops"], json!(["warp", "drag"]));
    let token = minted["token"].as_str().unwrap();
    let parts: Vec<&str> = token.split('.').collect();
    assert_eq!(parts[0], encoded(HEADER));
    let claims: Value =
        serde_json::from_slice(&BASE64URL_NOPAD.decode(parts[1].as_bytes()).unwrap()).unwrap();
    assert_eq!(
        (&claims["own"], &claims["key"], &claims["sid"]),
        (&json!(owner("ann")), &json!(mark("k1", ANN)), &json!(NAME))
    );
    assert_eq!(
        claims["exp"].as_u64().unwrap() - claims["iat"].as_u64().unwrap(),
        600
    );
    // No session, unless it is to be uploaded; then a name that `PUT` takes.
    problem(site.mint(OTHER, &json!({})).await, 404, "no_such_session").await;
    problem(site.mint("mine", &json!({})).await, 404, "no_such_session").await;
    let upload = json!({"ops": ["upload"]});
    assert_eq!(site.mint(OTHER, &upload).await.status(), 201);
    problem(site.mint("mine", &upload).await, 422, "bad_value").await;
    for (body, pointer) in [
        (json!({"ops": ["admin"]}), "/ops/0"),
        (json!({"ttl": 3601}), "/ttl"),
        (json!({"max_bytes": 1}), "/max_bytes"),
    ] {
        let told = problem(site.mint(NAME, &body).await, 422, "bad_value").await;
        assert_eq!(told["pointer"], pointer);
    }
    // Bob's session of that name is another one.
    let bob = site
        .server
        .post(&format!("/sessions/{NAME}/tokens"))
        .bearer_auth(BOB);
    problem(
        bob.json(&json!({})).send().await.unwrap(),
        404,
        "no_such_session",
    )
    .await;
    // Where there are no keys, there is nothing that a token could stand for.
    let open = Server::start(&[]).await;
    let id = open.session(&photo(16, 12), &json!({"p": [[1, 1]]})).await;
    let request = open
        .post(&format!("/sessions/{id}/tokens"))
        .json(&json!({}));
    problem(request.send().await.unwrap(), 403, "forbidden").await;
}

#[tokio::test]
async fn an_upload_is_as_large_as_its_token_says() {
    let site = Site::start(&[]).await;
    let token = site
        .token(NAME, &json!({"ops": ["upload", "read"], "max_bytes": 2000}))
        .await;
    let put = |id: &str| {
        let request = site
            .server
            .client
            .put(site.server.url(&format!("/sessions/{id}")));
        request.bearer_auth(&token)
    };
    let small = put(NAME).multipart(upload()).send().await.unwrap();
    assert_eq!(small.status(), 201, "{:?}", small.text().await);
    assert_eq!(site.read(&token).await.status(), 200);
    problem(
        put(OTHER).multipart(upload()).send().await.unwrap(),
        403,
        "forbidden",
    )
    .await;
    let rest = json!({"p": [[4, 4]]}).to_string();
    let large = || form(&photo(320, 240), rest.clone());
    let told = problem(
        put(NAME).multipart(large()).send().await.unwrap(),
        413,
        "too_large",
    )
    .await;
    assert_eq!(
        (&told["limit_name"], &told["limit"]),
        (&json!("token_max_bytes"), &json!(2000))
    );
    // Of a body without a length, as many bytes are read.
    let (kind, bytes) = multipart(&photo(320, 240), &rest);
    let stream = futures_util::stream::iter(
        bytes
            .chunks(500)
            .map(|chunk| Ok::<_, std::io::Error>(chunk.to_vec()))
            .collect::<Vec<_>>(),
    );
    let request = put(NAME).header("content-type", kind);
    let streamed = request
        .body(reqwest::Body::wrap_stream(stream))
        .send()
        .await
        .unwrap();
    let told = problem(streamed, 413, "too_large").await;
    assert_eq!(told["limit_name"], "token_max_bytes");
    // The session is as it was.
    assert_eq!(site.read(&token).await.status(), 200);
    // Its end is that of the token, which could make it again.
    let gone = site
        .server
        .client
        .delete(site.server.url(&format!("/sessions/{NAME}")));
    assert_eq!(gone.bearer_auth(ANN).send().await.unwrap().status(), 204);
    problem(
        put(NAME).multipart(upload()).send().await.unwrap(),
        401,
        "unauthorized",
    )
    .await;
    site.open(NAME).await;
    assert_eq!(
        put(NAME).multipart(upload()).send().await.unwrap().status(),
        200
    );
}

/// Limits below those of the key, and the key's own above them.
#[tokio::test]
async fn a_visitor_has_rates_and_shares_of_its_own() {
    let options = [
        "--rate-per-visitor",
        "5",
        "--max-sockets",
        "8",
        "--max-visitor-share",
        "25",
    ];
    let site = Site::start(&options).await;
    let token = async |id: &str| {
        site.open(id).await;
        site.token(id, &json!({"ops": ["read", "drag"]})).await
    };
    let (one, other) = (token(NAME).await, token(OTHER).await);
    let first = [
        socket(&site, &one).await.unwrap(),
        socket(&site, &one).await.unwrap(),
    ];
    assert_eq!(socket(&site, &one).await.err(), Some(429));
    let mut refused = 0;
    for _ in 0..30 {
        let answer = site.read(&one).await;
        if answer.status() == 429 {
            problem(answer, 429, "rate_limited").await;
            refused += 1;
        }
    }
    assert!(refused >= 10, "{refused}");
    let read = site.server.get(&format!("/sessions/{OTHER}"));
    assert_eq!(read.bearer_auth(&other).send().await.unwrap().status(), 200);
    let read = site.server.get(&format!("/sessions/{NAME}"));
    assert_eq!(read.bearer_auth(ANN).send().await.unwrap().status(), 200);
    drop(first);
}

/// A body of two parts, and its media type.
fn multipart(image: &[u8], warp: &str) -> (&'static str, Vec<u8>) {
    let head = "--x\r\nContent-Disposition: form-data; name=\"image\"; filename=\"a\"\r\n\r\n";
    let part = "\r\n--x\r\nContent-Disposition: form-data; name=\"warp\"\r\n\r\n";
    let bytes = [
        head.as_bytes(),
        image,
        part.as_bytes(),
        warp.as_bytes(),
        b"\r\n--x--\r\n",
    ];
    ("multipart/form-data; boundary=x", bytes.concat())
}

async fn socket(site: &Site, token: &str) -> Result<DragClient, u16> {
    let mut request = format!("ws://{}/sessions/{NAME}/drag", site.server.address)
        .into_client_request()
        .unwrap();
    let offered = format!("mlswarp, mlswarp.bearer.{}", encoded(token));
    request
        .headers_mut()
        .insert("Sec-WebSocket-Protocol", offered.parse().unwrap());
    let stream = TcpStream::connect(site.server.address).await.unwrap();
    match client_async(request, stream).await {
        Ok((socket, _)) => {
            let mut client = DragClient {
                socket,
                hello: Value::Null,
            };
            client.hello = client.text().await;
            Ok(client)
        }
        Err(tokio_tungstenite::tungstenite::Error::Http(refused)) => Err(refused.status().as_u16()),
        Err(error) => panic!("{error}"),
    }
}

/// The end of a socket: the problem, and the close frame after it.
async fn ended(socket: &mut DragClient, code: &str) {
    socket.problem(code).await;
    assert_eq!(socket.closed().await, 1008);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_socket_ends_when_its_token_does() {
    let site = Site::start(&[]).await;
    site.open(NAME).await;
    let clock = site.server.app.access().clock();
    let token = site
        .token(NAME, &json!({"ops": ["drag"], "ttl": 600}))
        .await;
    let later = site
        .token(NAME, &json!({"ops": ["drag"], "ttl": 3600}))
        .await;
    let (mut ends, mut stays) = (
        socket(&site, &token).await.unwrap(),
        socket(&site, &later).await.unwrap(),
    );
    ends.pose(1, &pose()).await;
    ends.ack_of_next_frame(1).await;
    clock.advance(Duration::from_secs(595));
    assert!(
        ends.next_within(Duration::from_millis(200)).await.is_none(),
        "before its end"
    );
    clock.advance(Duration::from_secs(6));
    ended(&mut ends, "token_expired").await;
    stays.pose(1, &pose()).await;
    stays.ack_of_next_frame(1).await;
    // Whom the leeway lets in stays for the leeway.
    let mut leeway = socket(&site, &token).await.unwrap();
    clock.advance(Duration::from_secs(40));
    ended(&mut leeway, "token_expired").await;
    assert_eq!(socket(&site, &token).await.err(), Some(401));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sockets_end_with_the_key_the_secret_and_the_session() {
    let site = Site::start(&[]).await;
    site.open(NAME).await;
    let ops = json!({"ops": ["read", "drag"]});
    // The secret, while another one is there.
    let old = site.token(NAME, &ops).await;
    let mut ends = socket(&site, &old).await.unwrap();
    let (one, two) = (
        format!("k1 {}\n", secret("k1")),
        format!("k2 {}\n", secret("k2")),
    );
    write(&site.folder, "secrets", &format!("{two}{one}"));
    eventually("the new secret signs", || {
        site.code(&signed(HEADER, "x")) == BAD
    })
    .await;
    let new = loop {
        let token = site.token(NAME, &ops).await;
        assert_eq!(
            (site.code(&old), site.code(&token)),
            (None, None),
            "rotation has no gap"
        );
        if token.split('.').next() != old.split('.').next() {
            break token;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    write(&site.folder, "secrets", &two);
    let began = Instant::now();
    ended(&mut ends, "forbidden").await;
    assert!(
        began.elapsed() < Duration::from_secs(2),
        "{:?}",
        began.elapsed()
    );
    assert_eq!((site.code(&old), site.code(&new)), (BAD, None));
    // A broken file changes nothing.
    write(&site.folder, "secrets", "k3 short\n");
    let mut ends = socket(&site, &new).await.unwrap();
    assert!(
        ends.next_within(Duration::from_millis(1500))
            .await
            .is_none()
    );
    // The key.
    write(&site.folder, "keys", &format!("bob {BOB}\n"));
    let began = Instant::now();
    ended(&mut ends, "forbidden").await;
    assert!(
        began.elapsed() < Duration::from_secs(2),
        "{:?}",
        began.elapsed()
    );
    assert_eq!(site.code(&new), BAD);
    // The session.
    write(&site.folder, "keys", &format!("bob {BOB}\nann {ANN}\n"));
    eventually("the key is back", || site.code(&new).is_none()).await;
    let mut ends = socket(&site, &new).await.unwrap();
    let gone = site
        .server
        .client
        .delete(site.server.url(&format!("/sessions/{NAME}")));
    assert_eq!(gone.bearer_auth(ANN).send().await.unwrap().status(), 204);
    ends.pose(1, &pose()).await;
    let Received::Text(told) = ends.next().await else {
        panic!("a problem")
    };
    assert_eq!(told["code"], "no_such_session");
    problem(site.read(&new).await, 404, "no_such_session").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replicas_on_one_store_accept_each_others_tokens() {
    let redis = Redis::start(&[]);
    let (store, keys) = (redis.address(), format!("ann {ANN}"));
    let shared = ["--store", &store];
    let (one, two) = (Site::start(&shared).await, Site::start(&shared).await);
    one.open(NAME).await;
    for (from, to) in [(&one, &two), (&two, &one)] {
        let token = from.token(NAME, &json!({"ops": ["read", "drag"]})).await;
        assert_eq!(to.read(&token).await.status(), 200);
        assert!(socket(to, &token).await.is_ok());
    }
    // Without a file each would have a secret of its own: none is made.
    let without = Server::start(&["--store", &store, "--keys", &keys]).await;
    let mint = |server: &Server| {
        let request = server
            .post(&format!("/sessions/{NAME}/tokens"))
            .bearer_auth(ANN);
        request.json(&json!({}))
    };
    let told = problem(mint(&without).send().await.unwrap(), 422, "not_supported").await;
    assert!(
        told["detail"]
            .as_str()
            .unwrap()
            .contains("--token-secrets-file")
    );
    let token = one.token(NAME, &json!({"ops": ["read"]})).await;
    let read = without
        .get(&format!("/sessions/{NAME}"))
        .bearer_auth(&token);
    problem(read.send().await.unwrap(), 401, "unauthorized").await;
    // Alone, a process has one of its own, which nobody else accepts.
    let alone = Server::start(&["--keys", &keys]).await;
    let opened: RequestBuilder = alone.client.put(alone.url(&format!("/sessions/{NAME}")));
    assert_eq!(
        opened
            .bearer_auth(ANN)
            .multipart(upload())
            .send()
            .await
            .unwrap()
            .status(),
        201
    );
    let minted: Value = mint(&alone).send().await.unwrap().json().await.unwrap();
    assert_eq!(one.code(minted["token"].as_str().unwrap()), BAD);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_log_names_a_token_and_shows_nothing_of_it() {
    let program = Program::start(&["--log", "trace", "--keys", &format!("ann {ANN}")]);
    let client = reqwest::Client::new();
    let url = |path: &str| format!("http://{}{path}", program.address);
    let opened = client
        .put(url(&format!("/sessions/{NAME}")))
        .bearer_auth(ANN);
    assert_eq!(
        opened.multipart(upload()).send().await.unwrap().status(),
        201
    );
    let mint = client
        .post(url(&format!("/sessions/{NAME}/tokens")))
        .bearer_auth(ANN);
    let minted: Value = mint
        .json(&json!({"ops": ["read"]}))
        .send()
        .await
        .unwrap()
        .json()
        .await
        .unwrap();
    let token = minted["token"].as_str().unwrap();
    let read = client
        .get(url(&format!("/sessions/{NAME}")))
        .bearer_auth(token);
    assert_eq!(read.send().await.unwrap().status(), 200);
    program.terminate();
    let (_, log) = tokio::task::spawn_blocking(move || program.wait())
        .await
        .unwrap();
    let parts: Vec<&str> = token.split('.').collect();
    let claims: Value =
        serde_json::from_slice(&BASE64URL_NOPAD.decode(parts[1].as_bytes()).unwrap()).unwrap();
    let jti = claims["jti"].as_str().unwrap();
    let named: Vec<&str> = log.lines().filter(|line| line.contains(jti)).collect();
    assert!(
        named.len() == 2 && named[0].contains("token made") && named[1].contains("answered"),
        "{named:?}"
    );
    assert!(
        named.iter().all(|line| line.contains("process")),
        "{named:?}"
    );
    for secret in [
        token,
        parts[1],
        parts[2],
        ANN,
        NAME,
        claims["own"].as_str().unwrap(),
    ] {
        assert!(!log.contains(secret), "{secret} is in the log");
    }
}
