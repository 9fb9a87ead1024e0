//! Session tokens: what a browser has instead of an API key, for one session, named operations and
//! a short time. The format is that of a JWT with HS256 (RFC 7519), so that every language can make
//! and look at one; what is accepted is narrower: one header, byte for byte, and claims of whole
//! numbers and texts, none unknown, none twice.
//!
//! Times are arguments, in seconds since 1970; there is no clock here.

use std::fmt;
use std::time::{Duration, SystemTime};

use data_encoding::BASE64URL_NOPAD;
use hmac::{Hmac, KeyInit as _, Mac as _};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use uuid::Uuid;

use crate::client::Owner;
use crate::problem::{Code, Problem};
use crate::wire::{MAX_TOKEN_TTL, TokenOp, TokenRequest};

/// Longest token: it fits a header and, encoded once more, a subprotocol.
const MAX_TOKEN: usize = 512;
/// What the clocks of two replicas may differ by, seconds: at the end of a token, and at its start.
const LEEWAY: u64 = 30;
const MAX_AHEAD: u64 = 60;
const AUDIENCE: &str = "mlswarp";
/// Every token of this form begins so: `{"` in base64url.
const BEGINNING: &str = "eyJ";
/// Lengths of a secret: 32 random bytes in base64 have 43 characters.
const SECRET_LENGTH: std::ops::RangeInclusive<usize> = 43..=512;
const MAX_KID: usize = 16;
const MAX_JTI: usize = 36;
/// Most secrets: every token is compared with all of them.
const MAX_SECRETS: usize = 16;

type Signature = Hmac<Sha256>;

/// Whether a bearer credential is meant to be a token. Only one that is no key is asked.
pub(super) fn is_token(bearer: &str) -> bool {
    bearer.starts_with(BEGINNING)
}

/// A set of operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ops(u16);

impl Ops {
    fn of(ops: impl IntoIterator<Item = TokenOp>) -> Self {
        Self(ops.into_iter().fold(0, |set, op| set | Self::bit(op)))
    }

    const fn bit(op: TokenOp) -> u16 {
        1 << op as u16
    }

    const fn has(self, op: TokenOp) -> bool {
        self.0 & Self::bit(op) != 0
    }
}

/// What a token allows.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Grant {
    session: Uuid,
    ops: Ops,
    /// Seconds since 1970.
    expires: u64,
    /// Largest body of an upload.
    pub(crate) max_bytes: Option<u64>,
    secret: SecretId,
}

impl Grant {
    /// The session that the token is for.
    pub(crate) const fn session(&self) -> [u8; 16] {
        self.session.into_bytes()
    }

    /// When a socket that was opened at `now` closes: at the token's end, or after the leeway if
    /// only that let it in.
    pub(crate) fn ends(&self, now: SystemTime) -> SystemTime {
        let end = SystemTime::UNIX_EPOCH + Duration::from_secs(self.expires);
        if now < end {
            end
        } else {
            end + Duration::from_secs(LEEWAY)
        }
    }

    /// Errors: [`Code::Forbidden`] if the token is for another session or not for the operation.
    pub(super) fn allow(&self, wanted: Wanted<'_>) -> Result<(), Problem> {
        let forbidden = |detail: String| Err(Problem::new(Code::Forbidden, detail));
        let Some(op) = wanted.op else {
            return forbidden(
                "a session token does not open this route: use an API key, on your server"
                    .to_owned(),
            );
        };
        if !wanted
            .session
            .is_some_and(|text| Uuid::try_parse(text) == Ok(self.session))
        {
            return forbidden("the token is for another session".to_owned());
        }
        if !self.ops.has(op) {
            let op = op.as_str();
            return forbidden(format!(
                "the token does not allow the operation `{op}`; mint one with `{op}` in `ops`"
            ));
        }
        Ok(())
    }
}

/// What a request does: an operation that tokens can allow, if it is one, and the session of its
/// path.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted<'a> {
    /// `None`: no token allows it.
    pub op: Option<TokenOp>,
    /// The session as the path writes it.
    pub session: Option<&'a str>,
}

/// What logs show of a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TokenName {
    /// Of the secret.
    pub(crate) kid: String,
    /// Of the token.
    pub(crate) jti: String,
}

/// A token whose signature and time are right. Its session, operation and key are still to be
/// checked.
pub(super) struct Signed {
    pub(super) grant: Grant,
    pub(super) owner: Owner,
    pub(super) key: KeyMark,
    pub(super) name: TokenName,
}

/// What a token says of the API key that it was made with: 8 bytes that only who has the secret can
/// compare with a key. A plain digest would let everybody who sees a token guess a short key.
pub(super) type KeyMark = [u8; 8];

/// Names a secret for as long as it is configured.
#[derive(Clone, Copy, PartialEq, Eq)]
struct SecretId([u8; 16]);

/// The claims, in the order in which they are written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Claims {
    aud: String,
    /// Owner and key, in base64url.
    own: String,
    key: String,
    sid: String,
    ops: Vec<String>,
    iat: u64,
    exp: u64,
    // Absent means no limit of its own; `null` is refused, as no server writes it.
    #[serde(
        default,
        deserialize_with = "present",
        skip_serializing_if = "Option::is_none"
    )]
    max_bytes: Option<u64>,
    jti: String,
}

fn present<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    u64::deserialize(from).map(Some)
}

/// One secret. Its text is not kept.
#[derive(Clone)]
struct Secret {
    id: SecretId,
    kid: String,
    /// The header of its tokens, in base64url.
    header: String,
    signature: Signature,
}

impl PartialEq for Secret {
    fn eq(&self, other: &Self) -> bool {
        self.id == other.id
    }
}

/// The configured secrets: the first signs, all verify.
#[derive(Clone, PartialEq)]
pub struct Secrets(Vec<Secret>);

impl Secrets {
    /// Reads `KID SECRET` lines. Empty lines and `#` lines are ignored.
    /// Errors: sentences that never hold the secret.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut secrets: Vec<Secret> = Vec::new();
        for (line, text) in (1..).zip(text.lines().map(str::trim)) {
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            let secret = parse_secret(text).map_err(|cause| format!("line {line}: {cause}"))?;
            let is_known = |known: &Secret| known.kid == secret.kid || known.same_text(&secret);
            if secrets.iter().any(is_known) {
                return Err(format!(
                    "line {line}: the KID or the secret is there already"
                ));
            }
            secrets.push(secret);
        }
        match secrets.len() {
            0 => Err("there is no secret in it".to_owned()),
            1..=MAX_SECRETS => Ok(Self(secrets)),
            many => Err(format!("{many} secrets; at most {MAX_SECRETS}")),
        }
    }

    /// A secret of this process, 244 bits from the operating system: its tokens end with it.
    pub(crate) fn random() -> Self {
        let bytes = [Uuid::new_v4(), Uuid::new_v4()].map(Uuid::into_bytes);
        Self(vec![Secret::new("process", &bytes.concat())])
    }

    pub(crate) const fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether the grant's secret is still configured.
    pub(super) fn have(&self, grant: &Grant) -> bool {
        self.0.iter().any(|secret| secret.id == grant.secret)
    }

    /// The mark of an API key's digest by the secret of a grant.
    pub(super) fn mark(&self, grant: &Grant, digest: &[u8; 32]) -> Option<KeyMark> {
        let secret = self.0.iter().find(|secret| secret.id == grant.secret)?;
        Some(secret.mark(digest))
    }

    /// A new token, its name, and when it ends (seconds since 1970).
    pub(crate) fn mint(
        &self,
        (owner, digest): (Owner, &[u8; 32]),
        session: [u8; 16],
        request: &TokenRequest,
        now: u64,
    ) -> (String, TokenName, u64) {
        let secret = &self.0[0];
        let jti = BASE64URL_NOPAD.encode(Uuid::new_v4().as_bytes());
        let claims = Claims {
            aud: AUDIENCE.to_owned(),
            own: BASE64URL_NOPAD.encode(&owner.to_bytes()),
            key: BASE64URL_NOPAD.encode(&secret.mark(digest)),
            sid: Uuid::from_bytes(session).to_string(),
            ops: request
                .ops
                .iter()
                .map(|op| op.as_str().to_owned())
                .collect(),
            iat: now,
            exp: now + request.ttl,
            max_bytes: request.max_bytes,
            jti: jti.clone(),
        };
        let claims = serde_json::to_vec(&claims).expect("texts and whole numbers");
        let signed = format!("{}.{}", secret.header, BASE64URL_NOPAD.encode(&claims));
        let tag = secret.signature.clone().chain_update(&signed).finalize();
        let token = format!("{signed}.{}", BASE64URL_NOPAD.encode(&tag.into_bytes()));
        let name = TokenName {
            kid: secret.kid.clone(),
            jti,
        };
        (token, name, now + request.ttl)
    }

    /// Checks everything of a token that it says itself.
    /// Errors: [`Code::Unauthorized`]; [`Code::TokenExpired`].
    pub(super) fn check(&self, token: &str, now: u64) -> Result<Signed, Problem> {
        let (secret, claims) = self.open(token).map_err(invalid)?;
        let claims: Claims = serde_json::from_slice(&claims)
            .ok()
            .filter(|_| claims.starts_with(b"{"))
            .ok_or_else(|| invalid("its claims are not those of a session token"))?;
        let Claims { iat, exp, jti, .. } = &claims;
        let is_plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.".contains(&b);
        let ops: Option<Vec<TokenOp>> = claims.ops.iter().map(|op| TokenOp::parse(op)).collect();
        let ops = ops.filter(|ops| {
            !ops.is_empty() && Ops::of(ops.iter().copied()).0.count_ones() as usize == ops.len()
        });
        let (Some(ops), Some(owner), Some(key), Some(session), true) = (
            ops,
            bytes(&claims.own),
            bytes(&claims.key),
            Uuid::try_parse(&claims.sid)
                .ok()
                .filter(|_| claims.sid.len() == 36),
            claims.aud == AUDIENCE
                && (1..=MAX_JTI).contains(&jti.len())
                && jti.bytes().all(is_plain),
        ) else {
            return Err(invalid(
                "a claim has another value than those of session tokens",
            ));
        };
        if now >= exp.saturating_add(LEEWAY) {
            let detail = "the session token has expired: get a new one from the site that gave it";
            return Err(Problem::new(Code::TokenExpired, detail));
        }
        if *iat >= now.saturating_add(MAX_AHEAD) {
            return Err(invalid("it was made in the future: compare the clocks"));
        }
        if !exp
            .checked_sub(*iat)
            .is_some_and(|ttl| (1..=MAX_TOKEN_TTL).contains(&ttl))
        {
            return Err(invalid("it is valid for no time, or for more than an hour"));
        }
        Ok(Signed {
            grant: Grant {
                session,
                ops: Ops::of(ops),
                expires: *exp,
                max_bytes: claims.max_bytes,
                secret: secret.id,
            },
            owner: Owner::from_bytes(owner),
            key,
            name: TokenName {
                kid: secret.kid.clone(),
                jti: claims.jti,
            },
        })
    }

    /// The claims of a token that one of the secrets has signed, and that secret.
    fn open(&self, token: &str) -> Result<(&Secret, Vec<u8>), &'static str> {
        if token.len() > MAX_TOKEN {
            return Err("it has more than 512 characters");
        }
        let mut parts = token.split('.');
        let (Some(header), Some(claims), Some(tag), None) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err("it has not three parts with dots between");
        };
        let tag = BASE64URL_NOPAD
            .decode(tag.as_bytes())
            .map_err(|_| "its signature is not base64url without padding")?;
        let signed = &token[..header.len() + 1 + claims.len()];
        let secret = self.search(signed.as_bytes(), &tag).found.ok_or(
            "none of the server's secrets has signed it; a secret may have been removed since",
        )?;
        if header != secret.header {
            return Err("its header is not that of session tokens, byte for byte");
        }
        let claims = BASE64URL_NOPAD
            .decode(claims.as_bytes())
            .map_err(|_| "its claims are not base64url without padding")?;
        Ok((secret, claims))
    }

    /// Compares a tag with the signatures by all secrets, each in constant time, so that the time
    /// tells neither how much of a tag is right nor by which secret.
    fn search(&self, signed: &[u8], tag: &[u8]) -> SecretSearch<'_> {
        let mut search = SecretSearch {
            found: None,
            visited: 0,
        };
        for secret in &self.0 {
            let signature = secret.signature.clone().chain_update(signed);
            if signature.verify_slice(tag).is_ok() {
                search.found = Some(secret);
            }
            search.visited += 1;
        }
        search
    }
}

struct SecretSearch<'a> {
    found: Option<&'a Secret>,
    /// The number of compared signatures, for a test.
    visited: usize,
}

impl Secret {
    fn new(kid: &str, secret: &[u8]) -> Self {
        let digest = Sha256::new()
            .chain_update(b"mlswarp secret\0")
            .chain_update(secret)
            .finalize();
        // In the order of the alphabet, in which many libraries write it.
        let header = format!(r#"{{"alg":"HS256","kid":"{kid}","typ":"mlswarp+jwt"}}"#);
        Self {
            id: SecretId(digest[..16].try_into().expect("16 of 32 bytes")),
            kid: kid.to_owned(),
            header: BASE64URL_NOPAD.encode(header.as_bytes()),
            signature: Signature::new_from_slice(secret).expect("a key of any length"),
        }
    }

    fn same_text(&self, other: &Self) -> bool {
        self.id == other.id
    }

    fn mark(&self, digest: &[u8; 32]) -> KeyMark {
        let mark = self
            .signature
            .clone()
            .chain_update(b"mlswarp key\0")
            .chain_update(digest)
            .finalize();
        *mark.into_bytes().first_chunk().expect("8 of 32 bytes")
    }
}

fn bytes<const N: usize>(text: &str) -> Option<[u8; N]> {
    BASE64URL_NOPAD
        .decode(text.as_bytes())
        .ok()?
        .try_into()
        .ok()
}

fn invalid(why: &str) -> Problem {
    let detail = format!("neither an API key nor a valid session token: {why}");
    Problem::new(Code::Unauthorized, detail)
}

/// The problem of a token whose API key is no longer configured.
pub(super) fn revoked() -> Problem {
    invalid("the API key that it was made with was removed")
}

fn parse_secret(text: &str) -> Result<Secret, String> {
    let mut words = text.split_whitespace();
    let (Some(kid), Some(secret), None) = (words.next(), words.next(), words.next()) else {
        return Err("a KID and a secret were expected, with a space between".to_owned());
    };
    let is_plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.".contains(&b);
    if kid.len() > MAX_KID || !kid.bytes().all(is_plain) {
        return Err(format!("a KID has at most {MAX_KID} of A-Z a-z 0-9 - _ ."));
    }
    if !SECRET_LENGTH.contains(&secret.len()) || !secret.bytes().all(|b| b.is_ascii_graphic()) {
        return Err(format!(
            "the secret has {} characters; {} to {} of visible ASCII were expected: make it by \
                `openssl rand -hex 32`",
            secret.chars().count(),
            SECRET_LENGTH.start(),
            SECRET_LENGTH.end()
        ));
    }
    Ok(Secret::new(kid, secret.as_bytes()))
}

impl fmt::Debug for Secrets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} secrets", self.0.len())
    }
}

impl fmt::Debug for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a session token")
    }
}

#[cfg(test)]
mod tests;
