//! What is asked of the server, each as one script that happens as a whole. The keys of a session carry its name as their hash tag, so they lie
//! together:
//!
//! | key | what | lives |
//! |---|---|---|
//! | `mlswarp:{NAME}:session` | hash: `record`, `made` (digest of what it was made from), `revision`, `life` (when), `seq` | one idle period |
//! | `mlswarp:{NAME}:file` | its picture's file | one idle period |
//! | `mlswarp:{NAME}:grave` | nothing: a session of that name was there | two idle periods |
//! | `mlswarp:{NAME}:deleted` | nothing: a session of that name was deleted | one idle period |
//! | `mlswarp:{NAME}:upload` | a file, inside of the transaction that puts it | |
//!
//! NAME is owner and session as hexadecimal digits. Numbers (`seq`) have twenty digits, so that they compare as texts. A server that is full
//! refuses a script's first write when that could take memory; a script that only prolongs a life begins with what takes none.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use redis::{Cmd, Pipeline};

use crate::session::{Revision, SessionId};
use crate::store::record::{hex, made, write};
use crate::store::{Record, StoreError};

/// What a script says first.
pub(crate) mod status {
    pub(crate) const NOTHING: i64 = 0;
    pub(crate) const EXPIRED: i64 = 1;
    pub(crate) const HERE: i64 = 2;
    pub(crate) const OTHER: i64 = 3;
}

/// ARGV idle, made. Uses a session that was made from the same and is whole. Says also what is there otherwise.
const SAME: &str = r"
local is = redis.call('HMGET', KEYS[1], 'made', 'record', 'seq', 'revision')
if not (is[1] or is[2] or is[4]) then return {0, '', '', ''} end
local said = 3
if is[1] == ARGV[2] and redis.call('EXISTS', KEYS[2]) == 1 then
  redis.call('PEXPIRE', KEYS[1], ARGV[1])
  redis.call('PEXPIRE', KEYS[2], ARGV[1])
  redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
  said = 2
end
return {said, is[2] or '', is[3] or '', is[4] or ''}";

/// KEYS[4]: the file, set in the same transaction. ARGV idle, made, record, revision, life; the revision that may be replaced (none: no session), and
/// whether its record can be read. Another revision may be one that this program cannot read: it stays, and so does its file.
const PUT: &str = r"
local is = redis.call('HMGET', KEYS[1], 'made', 'seq', 'revision')
if (is[3] or '') ~= ARGV[6] then
  redis.call('DEL', KEYS[4])
  return {3, ''}
end
redis.call('RENAME', KEYS[4], KEYS[2])
if is[1] == ARGV[2] and ARGV[7] == '1' then
  redis.call('PEXPIRE', KEYS[1], ARGV[1])
  redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
  return {2, is[2] or ''}
end
redis.call('DEL', KEYS[1])
redis.call('HSET', KEYS[1], 'made', ARGV[2], 'record', ARGV[3], 'revision', ARGV[4], 'life', ARGV[5])
redis.call('PEXPIRE', KEYS[1], ARGV[1])
redis.call('SET', KEYS[3], '', 'PX', 2 * ARGV[1])
return {0, ''}";

/// ARGV idle, seq, and what is known already: revision, life, seq. A record that is known is not sent again.
const TOUCH: &str = r"
local is = redis.call('HMGET', KEYS[1], 'revision', 'life', 'seq')
if not is[1] then return {redis.call('EXISTS', KEYS[3]), '', ''} end
redis.call('PEXPIRE', KEYS[1], ARGV[1])
redis.call('PEXPIRE', KEYS[2], ARGV[1])
redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
local before = is[3] or ''
local seq = before
if ARGV[2] > seq then seq = ARGV[2] end
if is[2] == ARGV[4] and ARGV[5] > seq then seq = ARGV[5] end
if seq ~= before then redis.call('HSET', KEYS[1], 'seq', seq) end
if is[1] == ARGV[3] then return {2, '', seq} end
return {2, redis.call('HGET', KEYS[1], 'record'), seq}";

/// ARGV idle, known revision.
const PEEK: &str = r"
local is = redis.call('HMGET', KEYS[1], 'revision', 'seq')
if not is[1] then return {redis.call('EXISTS', KEYS[3]), '', '', 0} end
local left = redis.call('PTTL', KEYS[1])
if is[1] == ARGV[2] then return {2, '', is[2] or '', left} end
return {2, redis.call('HGET', KEYS[1], 'record'), is[2] or '', left}";

/// ARGV idle, old revision, made, record, revision.
const REVISE: &str = r"
local is = redis.call('HMGET', KEYS[1], 'revision', 'seq')
if not is[1] then return {redis.call('EXISTS', KEYS[3]), ''} end
if is[1] ~= ARGV[2] then return {3, ''} end
redis.call('HSET', KEYS[1], 'made', ARGV[3], 'record', ARGV[4], 'revision', ARGV[5])
redis.call('PEXPIRE', KEYS[1], ARGV[1])
redis.call('PEXPIRE', KEYS[2], ARGV[1])
redis.call('PEXPIRE', KEYS[3], 2 * ARGV[1])
return {2, is[2] or ''}";

/// KEYS[4]: the session was deleted before. ARGV idle.
const DELETE: &str = r"
if redis.call('EXISTS', KEYS[1]) == 0 then
  if redis.call('EXISTS', KEYS[3]) == 1 then return 1 end
  return 2 * redis.call('EXISTS', KEYS[4])
end
redis.call('DEL', KEYS[1], KEYS[2], KEYS[3])
redis.call('SET', KEYS[4], '', 'PX', ARGV[1])
return 2";

/// What is known here of a session, and may not be known there.
#[derive(Clone, Copy)]
pub(crate) struct Given {
    /// Of its record: one that is known is not sent again.
    pub(crate) revision: Revision,
    /// Its life: numbers of another one do not count.
    pub(crate) created: SystemTime,
    /// The highest number.
    pub(crate) seq: Option<u64>,
}

/// Numbers as texts that compare like numbers; nothing is below every number.
pub(crate) fn digits(seq: Option<u64>) -> String {
    seq.map_or_else(String::new, |seq| format!("{seq:020}"))
}

/// The number that the text is.
pub(crate) fn number(digits: &str) -> Result<Option<u64>, StoreError> {
    if digits.is_empty() { Ok(None) } else { digits.parse().map(Some).map_err(|_| StoreError::Away) }
}

fn key(id: SessionId, what: &str) -> String {
    format!("mlswarp:{{{}}}:{what}", hex(&id.to_bytes()))
}

fn life(created: SystemTime) -> String {
    created.duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos().to_string()
}

fn script(script: &str, id: SessionId, idle: Duration) -> Cmd {
    script_with(script, id, None, idle)
}

/// `fourth`: the script has this key too.
fn script_with(script: &str, id: SessionId, fourth: Option<&str>, idle: Duration) -> Cmd {
    let mut command = redis::cmd("EVAL");
    command.arg(script).arg(3 + usize::from(fourth.is_some())).arg(key(id, "session")).arg(key(id, "file")).arg(key(id, "grave"));
    if let Some(fourth) = fourth {
        command.arg(key(id, fourth));
    }
    command.arg(millis(idle));
    command
}

fn millis(idle: Duration) -> u64 {
    // Twice as much is still a number to the server.
    u64::try_from(idle.as_millis()).unwrap_or(u64::MAX).clamp(1, 1 << 50)
}

pub(crate) fn same(record: &Record, idle: Duration) -> Cmd {
    let mut command = script(SAME, record.id, idle);
    command.arg(hex(&made(record).0));
    command
}

/// What a record may replace: nothing, or this revision.
pub(crate) struct Replaces {
    /// As the server has it; empty for nothing.
    pub(crate) revision: String,
    /// Its record can be read.
    pub(crate) is_whole: bool,
}

/// The file and the record, both or neither.
pub(crate) fn put(record: &Record, file: &[u8], replaces: &Replaces, idle: Duration) -> Pipeline {
    let mut command = script_with(PUT, record.id, Some("upload"), idle);
    command.arg(hex(&made(record).0)).arg(write(record)).arg(hex(record.revision.as_bytes())).arg(life(record.created));
    command.arg(&replaces.revision).arg(u8::from(replaces.is_whole));
    let mut transaction = redis::pipe();
    transaction.atomic().cmd("SET").arg(key(record.id, "upload")).arg(file).arg("PX").arg(millis(idle)).ignore();
    transaction.add_command(command);
    transaction
}

pub(crate) fn touch(id: SessionId, seq: Option<u64>, known: Option<Given>, idle: Duration) -> Cmd {
    let mut command = script(TOUCH, id, idle);
    command.arg(digits(seq));
    match known {
        Some(Given { revision, created, seq }) => command.arg(hex(revision.as_bytes())).arg(life(created)).arg(digits(seq)),
        None => command.arg("").arg("").arg(""),
    };
    command
}

pub(crate) fn peek(id: SessionId, known: Option<&Record>, idle: Duration) -> Cmd {
    let mut command = script(PEEK, id, idle);
    command.arg(known.map_or_else(String::new, |known| hex(known.revision.as_bytes())));
    command
}

pub(crate) fn revise(old: &str, new: &Record, idle: Duration) -> Cmd {
    let mut command = script(REVISE, new.id, idle);
    command.arg(old).arg(hex(&made(new).0)).arg(write(new)).arg(hex(new.revision.as_bytes()));
    command
}

pub(crate) fn delete(id: SessionId, idle: Duration) -> Cmd {
    script_with(DELETE, id, Some("deleted"), idle)
}

/// How long the file is; 0 when it is not there.
pub(crate) fn file_bytes(id: SessionId) -> Cmd {
    let mut command = redis::cmd("STRLEN");
    command.arg(key(id, "file"));
    command
}

pub(crate) fn file(id: SessionId) -> Cmd {
    let mut command = redis::cmd("GET");
    command.arg(key(id, "file"));
    command
}
