//! `POST /sessions/{id}/tokens`: the request, and the operations that it names.

use super::json::{self, Node, optional};
use super::number::whole;
use super::suggest;
use crate::problem::words::{did_you_mean, list, quote};
use crate::problem::{Code, Problem};

/// How long a token is valid unless the request says it, and at most, seconds.
const DEFAULT_TTL: u64 = 600;
/// See there.
pub const MAX_TOKEN_TTL: u64 = 3600;

/// What a token may allow for its session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TokenOp {
    /// To read the session and its layers.
    Read,
    /// Pictures, meshes, maps, points, reports, fits and the coefficients.
    Warp,
    /// The drag socket.
    Drag,
    /// To replace the handles at rest.
    Handles,
    /// To store and delete layers.
    Layers,
    /// To create or replace the session.
    Upload,
    /// Many frames in one file.
    Batch,
    /// To delete the session.
    Delete,
}

impl TokenOp {
    /// All, in the order of the document.
    pub const ALL: [Self; 8] = [
        Self::Read,
        Self::Warp,
        Self::Drag,
        Self::Handles,
        Self::Layers,
        Self::Upload,
        Self::Batch,
        Self::Delete,
    ];

    /// The name.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Warp => "warp",
            Self::Drag => "drag",
            Self::Handles => "handles",
            Self::Layers => "layers",
            Self::Upload => "upload",
            Self::Batch => "batch",
            Self::Delete => "delete",
        }
    }

    /// The operation of a name.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|op| op.as_str() == text)
    }
}

/// The body of the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TokenRequest {
    /// What the token allows, each once, in the order of [`TokenOp::ALL`].
    pub ops: Vec<TokenOp>,
    /// How long it is valid, seconds.
    pub ttl: u64,
    /// The largest body of an upload.
    pub max_bytes: Option<u64>,
}

impl TokenRequest {
    /// Reads the body: `{"ops"?, "ttl"?, "max_bytes"?}`.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let root = json::root(body)?;
        let [ops, ttl, max_bytes] = root.fields(&["ops", "ttl", "max_bytes"])?;
        let ops = optional(ops, |node| operations(node))?
            .unwrap_or_else(|| vec![TokenOp::Warp, TokenOp::Drag]);
        let has_upload = [TokenOp::Upload, TokenOp::Layers]
            .iter()
            .any(|op| ops.contains(op));
        if let Some(node) = max_bytes.filter(|_| !has_upload) {
            let detail = "`max_bytes` limits uploads: it needs `upload` or `layers` in `ops`";
            return Err(node.problem(Code::BadValue, detail));
        }
        Ok(Self {
            ops,
            ttl: optional(ttl, |node| from_one(node, MAX_TOKEN_TTL, "seconds"))?
                .unwrap_or(DEFAULT_TTL),
            max_bytes: optional(max_bytes, |node| from_one(node, 1 << 53, "bytes"))?,
        })
    }
}

fn operations(node: &Node<'_, '_>) -> Result<Vec<TokenOp>, Problem> {
    let names = TokenOp::ALL.map(TokenOp::as_str);
    let expected = format!("an array of operations, at least one of {}", list(&names));
    let mut ops = node.list(&expected, 6, |_, item| {
        let text = item.string("the name of an operation")?;
        TokenOp::parse(&text).ok_or_else(|| {
            let hint = did_you_mean(suggest::value(&text, &names));
            item.unexpected(
                &format!("one of {}", list(&names)),
                format_args!("{}{hint}", quote(&text)),
            )
        })
    })?;
    ops.sort_unstable();
    ops.dedup();
    if ops.is_empty() {
        return Err(node.unexpected(&expected, "none"));
    }
    Ok(ops)
}

/// A whole number of units, at least one.
fn from_one(node: &Node<'_, '_>, most: u64, units: &str) -> Result<u64, Problem> {
    let expected = format!("a whole number of {units}, 1 to {most}");
    let value = whole(node, &expected)?;
    if (1..=most).contains(&value) {
        Ok(value)
    } else {
        Err(node.unexpected(&expected, value).actual(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_a_set_and_have_defaults() {
        let read = |text: &str| TokenRequest::parse(text.as_bytes());
        let usual = read("{}").unwrap();
        assert_eq!(
            (usual.ops, usual.ttl, usual.max_bytes),
            (vec![TokenOp::Warp, TokenOp::Drag], 600, None)
        );
        let given = read(r#"{"ops": ["upload", "read", "upload"], "ttl": 1, "max_bytes": 9}"#);
        let given = given.unwrap();
        assert_eq!(
            (given.ops, given.ttl, given.max_bytes),
            (vec![TokenOp::Read, TokenOp::Upload], 1, Some(9))
        );
        assert!(read(r#"{"ops": null, "ttl": 3600}"#).is_ok());
    }

    #[test]
    fn every_mistake_names_its_place() {
        for (text, pointer, told) in [
            (r#"{"ops": []}"#, "/ops", "found none"),
            (r#"{"ops": "warp"}"#, "/ops", "found a string"),
            (
                r#"{"ops": ["warp", "darg"]}"#,
                "/ops/1",
                "did you mean `drag`",
            ),
            (r#"{"ops": ["warp", 1]}"#, "/ops/1", "found a number"),
            (r#"{"ttl": 0}"#, "/ttl", "1 to 3600"),
            (r#"{"ttl": 3601}"#, "/ttl", "1 to 3600"),
            (r#"{"ttl": 1.5}"#, "/ttl", "1 to 3600"),
            (r#"{"max_bytes": 10}"#, "/max_bytes", "needs `upload`"),
            (r#"{"op": ["warp"]}"#, "/op", "did you mean `ops`"),
        ] {
            let problem = TokenRequest::parse(text.as_bytes()).unwrap_err();
            assert_eq!(problem.pointer.as_deref(), Some(pointer), "{problem}");
            assert!(problem.detail.contains(told), "{problem}");
        }
    }
}
