//! The scripts that run on the server: each operation on a session is one of them, and atomic. The
//! keys of a session share a hash tag:
//!
//! | key | content | expires after |
//! |---|---|---|
//! | `mlswarp:{NAME}:session` | a hash | one idle period |
//! | `mlswarp:{NAME}:file` | the image's file | one idle period |
//! | `mlswarp:{NAME}:grave` | empty; the tombstone of an expired session | two idle periods |
//! | `mlswarp:{NAME}:deleted` | empty; the session was deleted | one idle period |
//! | `mlswarp:{NAME}:upload` | a file, only inside the transaction of a `put` | |
//!
//! NAME is owner and session in hexadecimal. The fields of the hash are `record`, `revision`,
//! `seq`, `made` (the digest of what the record was made from), `life` (the time at which the
//! session was created) and, for each file of a layer, `layer:DIGEST`. Sequence numbers have twenty
//! digits, so that they compare as strings. A full server refuses the first write of a script if it
//! may take memory; `touch` therefore begins with `PEXPIRE`, which takes none.
//!
//! Scripts are called by their digest (`EVALSHA`) and sent once. Those that follow a file are sent
//! in full each time: inside `MULTI` a missing script would fail after the file has been stored.
//!
//! The file of a layer is set before the script runs that decides whether a record will name it.
//! That script then removes all layers' files that the record does not name, which it would contain
//! in hexadecimal. The image, and the mask that the session was made with, are named by fields of
//! their own: they keep no layer's file, which may be the same file.

use std::sync::LazyLock;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use data_encoding::HEXLOWER;
use mlswarp::warp::Digest;
use redis::{Cmd, Pipeline, Script, ScriptInvocation};

use crate::session::{Revision, SessionId};
use crate::store::record::{made, write};
use crate::store::{NamedFile, Record, StoreError};

/// The first value of each script's reply.
pub(crate) mod status {
    /// There is no such session.
    pub(crate) const ABSENT: i64 = 0;
    /// There was one, and its tombstone is there.
    pub(crate) const EXPIRED: i64 = 1;
    /// The session is there, as it is asked for.
    pub(crate) const FOUND: i64 = 2;
    /// Another revision is there, or a session that was made from something else.
    pub(crate) const OTHER: i64 = 3;
}

/// ARGV: idle, made. Prolongs the session if it was made from the same and its file is there.
/// Returns what is there.
static SAME: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
local is = redis.call('HMGET', KEYS[1], 'made', 'record', 'seq', 'revision')
if not (is[1] or is[2] or is[4]) then return {0, '', '', ''} end
local status = 3
if is[1] == ARGV[2] and redis.call('EXISTS', KEYS[2]) == 1 then
  redis.call('PEXPIRE', KEYS[1], ARGV[1])
  redis.call('PEXPIRE', KEYS[2], ARGV[1])
  redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
  status = 2
end
return {status, is[2] or '', is[3] or '', is[4] or ''}",
    )
});

/// Removes the files of layers that a record does not name.
const KEEP_NAMED: &str = r#"
local function keep_named(record)
  for _, field in ipairs({'image', 'made_with_region'}) do
    record = string.gsub(record, '"' .. field .. '":"%x*"', '', 1)
  end
  for _, field in ipairs(redis.call('HKEYS', KEYS[1])) do
    local digest = string.match(field, '^layer:(%x+)$')
    if digest and not string.find(record, digest, 1, true) then redis.call('HDEL', KEYS[1], field) end
  end
end"#;

/// KEYS[4]: the file, set in the same transaction. ARGV: idle, made, record, revision, life, the
/// revision that may be replaced (empty: no session), and whether its record is readable. Any other
/// revision, and its file, stay as they are.
const PUT: &str = r"
local is = redis.call('HMGET', KEYS[1], 'made', 'seq', 'revision', 'record')
if (is[3] or '') ~= ARGV[6] then
  redis.call('DEL', KEYS[4])
  keep_named(is[4] or '')
  return {3, ''}
end
redis.call('RENAME', KEYS[4], KEYS[2])
if is[1] == ARGV[2] and ARGV[7] == '1' then
  keep_named(is[4])
  redis.call('PEXPIRE', KEYS[1], ARGV[1])
  redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
  return {2, is[2] or ''}
end
redis.call('HDEL', KEYS[1], 'seq')
redis.call('HSET', KEYS[1], 'made', ARGV[2], 'record', ARGV[3], 'revision', ARGV[4], 'life', ARGV[5])
keep_named(ARGV[3])
redis.call('PEXPIRE', KEYS[1], ARGV[1])
redis.call('SET', KEYS[3], '', 'PX', 2 * ARGV[1])
return {0, ''}";

/// ARGV: idle, seq, and of the cached session: revision, life, seq. Returns the record only if its
/// revision is not the cached one.
static TOUCH: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
local is = redis.call('HMGET', KEYS[1], 'revision', 'life', 'seq')
if not is[1] then return {redis.call('EXISTS', KEYS[3]), '', '', 0} end
redis.call('PEXPIRE', KEYS[1], ARGV[1])
redis.call('PEXPIRE', KEYS[2], ARGV[1])
redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
local before = is[3] or ''
local seq = before
if ARGV[2] > seq then seq = ARGV[2] end
if is[2] == ARGV[4] and ARGV[5] > seq then seq = ARGV[5] end
if seq ~= before then redis.call('HSET', KEYS[1], 'seq', seq) end
local left = tonumber(ARGV[1])
if is[1] == ARGV[3] then return {2, '', seq, left} end
return {2, redis.call('HGET', KEYS[1], 'record'), seq, left}",
    )
});

/// ARGV: idle, cached revision. Replies as `TOUCH` does.
static PEEK: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
local is = redis.call('HMGET', KEYS[1], 'revision', 'seq')
if not is[1] then return {redis.call('EXISTS', KEYS[3]), '', '', 0} end
local left = redis.call('PTTL', KEYS[1])
if is[1] == ARGV[2] then return {2, '', is[2] or '', left} end
return {2, redis.call('HGET', KEYS[1], 'record'), is[2] or '', left}",
    )
});

/// ARGV: idle, old revision, made, record, revision. A layer is removed before memory is needed:
/// that works on a full server.
const REVISE: &str = r"
local is = redis.call('HMGET', KEYS[1], 'revision', 'seq', 'record')
local is_old = is[1] == ARGV[2]
keep_named(is_old and ARGV[4] or is[3] or '')
if not is[1] then return {redis.call('EXISTS', KEYS[3]), ''} end
if not is_old then return {3, ''} end
redis.call('HSET', KEYS[1], 'made', ARGV[3], 'record', ARGV[4], 'revision', ARGV[5])
redis.call('PEXPIRE', KEYS[1], ARGV[1])
redis.call('PEXPIRE', KEYS[2], ARGV[1])
redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
return {2, is[2] or ''}";

static REVISE_ALONE: LazyLock<Script> =
    LazyLock::new(|| Script::new(&[KEEP_NAMED, REVISE].concat()));

/// KEYS[4]: says that the session was deleted before. ARGV: idle.
static DELETE: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('EXISTS', KEYS[1]) == 0 then
  if redis.call('EXISTS', KEYS[3]) == 1 then return 1 end
  return 2 * redis.call('EXISTS', KEYS[4])
end
redis.call('DEL', KEYS[1], KEYS[2], KEYS[3])
redis.call('SET', KEYS[4], '', 'PX', ARGV[1])
return 2",
    )
});

/// KEYS[4]: as for `DELETE`.
static WAS_DELETED: LazyLock<Script> = LazyLock::new(|| {
    Script::new(
        r"
if redis.call('EXISTS', KEYS[1]) == 1 then return 0 end
return redis.call('EXISTS', KEYS[4])",
    )
});

/// A call of one of these scripts.
pub(crate) type Call = ScriptInvocation<'static>;

/// Reads a sequence number; an empty text means that there is no number.
pub(crate) fn number(digits: &str) -> Result<Option<u64>, StoreError> {
    if digits.is_empty() {
        Ok(None)
    } else {
        digits.parse().map(Some).map_err(|_| StoreError::Away)
    }
}

/// Writes a sequence number; the empty string sorts before all of them.
fn digits(seq: Option<u64>) -> String {
    seq.map_or_else(String::new, |seq| format!("{seq:020}"))
}

fn revision(revision: Revision) -> String {
    HEXLOWER.encode(revision.as_bytes())
}

fn life(created: SystemTime) -> String {
    created
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
        .as_nanos()
        .to_string()
}

fn millis(idle: Duration) -> u64 {
    // The scripts compute twice as much, in floating point.
    u64::try_from(idle.as_millis())
        .unwrap_or(u64::MAX)
        .clamp(1, 1 << 50)
}

pub(crate) fn key(id: SessionId, part: &str) -> String {
    format!("mlswarp:{{{}}}:{part}", HEXLOWER.encode(&id.to_bytes()))
}

fn keys(id: SessionId) -> [String; 3] {
    ["session", "file", "grave"].map(|part| key(id, part))
}

fn call(script: &'static Script, id: SessionId, idle: Duration) -> Call {
    let mut call = script.key(&keys(id));
    call.arg(millis(idle));
    call
}

pub(crate) fn same(record: &Record, idle: Duration) -> Call {
    let mut call = call(&SAME, record.id, idle);
    call.arg(made(record).to_string());
    call
}

/// What a `put` may replace.
pub(crate) struct Replaces {
    /// The revision, as the server has it; empty: no session.
    pub(crate) revision: String,
    /// This program can read its record.
    pub(crate) is_readable: bool,
}

/// Stores the files and the record in one transaction.
pub(crate) fn put(
    record: &Record,
    files: &[NamedFile],
    replaces: &Replaces,
    idle: Duration,
) -> Pipeline {
    let upload = key(record.id, "upload");
    let mut transaction = redis::pipe();
    transaction.atomic();
    for file in files {
        // To a key of its own: the script moves it to its place or deletes it, so a `put` that
        // loses the race leaves the other one's file alone.
        if file.digest == record.image {
            transaction
                .cmd("SET")
                .arg(&upload)
                .arg(&file.bytes[..])
                .arg("PX")
                .arg(millis(idle))
                .ignore();
        }
        if record
            .layers
            .values()
            .any(|layer| layer.digest == file.digest)
        {
            // The same file may be image and layer; each has its own copy, because they may be
            // replaced one by one.
            set_layer(&mut transaction, record.id, file);
        }
    }
    transaction
        .cmd("EVAL")
        .arg([KEEP_NAMED, PUT].concat())
        .arg(4)
        .arg(&keys(record.id))
        .arg(upload)
        .arg(millis(idle));
    transaction
        .arg(made(record).to_string())
        .arg(write(record))
        .arg(revision(record.revision))
        .arg(life(record.created));
    transaction
        .arg(&replaces.revision)
        .arg(u8::from(replaces.is_readable));
    transaction
}

/// `cached`: the record in this process, and the highest number that it knows of.
pub(crate) fn touch(
    id: SessionId,
    seq: Option<u64>,
    cached: Option<(&Record, Option<u64>)>,
    idle: Duration,
) -> Call {
    let mut call = call(&TOUCH, id, idle);
    call.arg(digits(seq));
    match cached {
        Some((record, seq)) => call
            .arg(revision(record.revision))
            .arg(life(record.created))
            .arg(digits(seq)),
        None => call.arg("").arg("").arg(""),
    };
    call
}

pub(crate) fn peek(id: SessionId, cached: Option<&Record>, idle: Duration) -> Call {
    let mut call = call(&PEEK, id, idle);
    call.arg(cached.map_or_else(String::new, |record| revision(record.revision)));
    call
}

fn set_layer(transaction: &mut Pipeline, id: SessionId, file: &NamedFile) {
    transaction
        .cmd("HSET")
        .arg(key(id, "session"))
        .arg(layer(file.digest))
        .arg(&file.bytes[..])
        .ignore();
}

/// The field of a layer's file.
fn layer(digest: Digest) -> String {
    format!("layer:{digest}")
}

pub(crate) fn revise(old: Revision, new: &Record, idle: Duration) -> Call {
    let mut call = call(&REVISE_ALONE, new.id, idle);
    call.arg(revision(old))
        .arg(made(new).to_string())
        .arg(write(new))
        .arg(revision(new.revision));
    call
}

/// As [`revise`], with the file of a layer.
pub(crate) fn revise_with(
    file: &NamedFile,
    old: Revision,
    new: &Record,
    idle: Duration,
) -> Pipeline {
    let mut transaction = redis::pipe();
    set_layer(transaction.atomic(), new.id, file);
    transaction
        .cmd("EVAL")
        .arg([KEEP_NAMED, REVISE].concat())
        .arg(3)
        .arg(&keys(new.id))
        .arg(millis(idle));
    transaction
        .arg(revision(old))
        .arg(made(new).to_string())
        .arg(write(new))
        .arg(revision(new.revision));
    transaction
}

pub(crate) fn delete(id: SessionId, idle: Duration) -> Call {
    let mut call = call(&DELETE, id, idle);
    call.key(key(id, "deleted"));
    call
}

pub(crate) fn was_deleted(id: SessionId, idle: Duration) -> Call {
    let mut call = call(&WAS_DELETED, id, idle);
    call.key(key(id, "deleted"));
    call
}

/// Bytes of the layer's file of that digest, and of the image's file; 0 if one is not there.
pub(crate) fn file_bytes(id: SessionId, digest: Digest) -> Pipeline {
    let mut both = redis::pipe();
    both.cmd("HSTRLEN")
        .arg(key(id, "session"))
        .arg(layer(digest));
    both.cmd("STRLEN").arg(key(id, "file"));
    both
}

pub(crate) fn picture_file(id: SessionId) -> Cmd {
    redis::cmd("GET").arg(key(id, "file")).take()
}

pub(crate) fn layer_file(id: SessionId, digest: Digest) -> Cmd {
    redis::cmd("HGET")
        .arg(key(id, "session"))
        .arg(layer(digest))
        .take()
}
