use super::*;

const KEYED: (Owner, &[u8; 32]) = (Owner::from_bytes([7; 16]), &[9; 32]);
const NOW: u64 = 1_800_000_000;

fn secret(n: u8) -> String {
    format!("k{n} {}", HEX[usize::from(n)].repeat(64))
}

const HEX: [&str; 5] = ["0", "1", "2", "3", "4"];

fn secrets(of: &[u8]) -> Secrets {
    let lines: Vec<String> = of.iter().copied().map(secret).collect();
    Secrets::parse(&lines.join("\n")).unwrap()
}

fn asked() -> TokenRequest {
    TokenRequest::parse(br#"{"ops": ["warp", "drag"]}"#).unwrap()
}

/// Secrets with the right one in every place, and without it.
#[test]
fn every_signature_is_compared_with_all_secrets() {
    let all = secrets(&[0, 1, 2, 3]);
    for by in 0..=4 {
        let (token, ..) = secrets(&[by]).mint(KEYED, [1; 16], &asked(), NOW);
        let (signed, tag) = token.rsplit_once('.').unwrap();
        let tag = BASE64URL_NOPAD.decode(tag.as_bytes()).unwrap();
        let search = all.search(signed.as_bytes(), &tag);
        assert_eq!(search.visited, 4, "{by}");
        assert_eq!(
            search.found.map(|found| &*found.kid),
            ["k0", "k1", "k2", "k3"].get(usize::from(by)).copied()
        );
        for wrong in [&tag[..31], &[], &[tag.clone(), vec![0]].concat()] {
            let search = all.search(signed.as_bytes(), wrong);
            assert!(search.visited == 4 && search.found.is_none());
        }
    }
}

#[test]
fn the_longest_token_fits() {
    let text = format!("{} {}", "K".repeat(MAX_KID), "s".repeat(43));
    let all = TokenRequest {
        ops: TokenOp::ALL.to_vec(),
        ttl: MAX_TOKEN_TTL,
        max_bytes: Some(1 << 53),
    };
    let secrets = Secrets::parse(&text).unwrap();
    let (token, _, ends) = secrets.mint(KEYED, [0xff; 16], &all, NOW);
    assert!(token.len() <= MAX_TOKEN, "{}", token.len());
    assert_eq!(ends, NOW + 3600);
    let signed = secrets.check(&token, NOW).unwrap();
    assert_eq!(
        (signed.owner, signed.key),
        (KEYED.0, secrets.0[0].mark(KEYED.1))
    );
    assert_eq!(signed.grant.max_bytes, Some(1 << 53));
    assert!(TokenOp::ALL.iter().all(|op| signed.grant.ops.has(*op)));
}

#[test]
fn clocks_may_differ_by_half_a_minute() {
    let secrets = secrets(&[0]);
    let (token, ..) = secrets.mint(KEYED, [1; 16], &asked(), NOW);
    let code = |now: u64| secrets.check(&token, now).err().map(|problem| problem.code);
    for (now, expected) in [
        (NOW, None),
        (NOW - 25, None),
        (NOW - 59, None),
        (NOW - 60, Some(Code::Unauthorized)),
        (NOW - 90, Some(Code::Unauthorized)),
        (NOW + 600 + 25, None),
        (NOW + 600 + 29, None),
        (NOW + 600 + 30, Some(Code::TokenExpired)),
        (NOW + 600 + 90, Some(Code::TokenExpired)),
        (0, Some(Code::Unauthorized)),
        (u64::MAX, Some(Code::TokenExpired)),
    ] {
        assert_eq!(code(now), expected, "{now}");
    }
}

/// The mark tells a key only to who has the secret, and another one with another secret.
#[test]
fn a_mark_is_of_key_and_secret() {
    let (one, two) = (secrets(&[0]), secrets(&[1]));
    let mark = |secrets: &Secrets, digest: &[u8; 32]| secrets.0[0].mark(digest);
    assert_eq!(mark(&one, KEYED.1), mark(&one, KEYED.1));
    assert_ne!(mark(&one, KEYED.1), mark(&two, KEYED.1));
    assert_ne!(mark(&one, KEYED.1), mark(&one, &[8; 32]));
}

#[test]
fn a_mistake_in_the_file_names_its_line_and_never_the_secret() {
    let good = "0123456789abcdef".repeat(4);
    for (text, told) in [
        (String::new(), "there is no secret"),
        ("# k1 x\n\n".to_owned(), "there is no secret"),
        ("k1".to_owned(), "line 1: a KID and a secret"),
        (format!("k1 {good} more"), "line 1: a KID and a secret"),
        (
            format!("\nk1 {}", &good[..42]),
            "line 2: the secret has 42 characters",
        ),
        (
            format!("k1 {good}\u{e4}"),
            "line 1: the secret has 65 characters",
        ),
        (format!("k/1 {good}"), "line 1: a KID has"),
        (format!("{} {good}", "k".repeat(17)), "line 1: a KID has"),
        (
            format!("k1 {good}\nk1 {good}0"),
            "line 2: the KID or the secret",
        ),
        (
            format!("k1 {good}\nk2 {good}"),
            "line 2: the KID or the secret",
        ),
    ] {
        let mistake = Secrets::parse(&text).unwrap_err();
        assert!(mistake.starts_with(told), "{mistake}");
        assert!(!mistake.contains("0123456789"), "{mistake}");
    }
    let many: String = (0..17).map(|n| format!("k{n} {n:0>43}\n")).collect();
    assert!(Secrets::parse(&many).unwrap_err().starts_with("17 secrets"));
    let shown = format!("{:?}", Secrets::parse(&format!("k1 {good}")).unwrap());
    assert_eq!(shown, "1 secrets");
}
