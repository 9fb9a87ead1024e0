//! Any bytes as a landmark file, or as two with a zero byte between them if the first byte is odd.
//! What is read has as many handles as names, and its JSON is read again to the same; what is
//! refused is refused by a whole problem document, with line and column.

use bytes::Bytes;
use mlswarp::pixmap::Extent;
use mlswarp_server::problem::Problem;
use mlswarp_server::wire::Reserved;
use mlswarp_server::wire::landmarks::{BesideFiles, LandmarkFiles, Landmarks, Target};
use serde_json::{Value, json};

use super::assert_is_problem;

const MAX_COLUMNS: usize = 64;

fn landmarks(files: &LandmarkFiles) -> Result<Landmarks, Problem> {
    Reserved::of_files(files, MAX_COLUMNS, &|| false, |_| Ok(())).map(|read| read.into_parts().0)
}

pub(super) fn read(bytes: &[u8]) {
    let Some((first, files)) = bytes.split_first() else {
        return;
    };
    let part = |part: &[u8]| Some(Bytes::copy_from_slice(part));
    let files = match files
        .iter()
        .position(|byte| *byte == 0)
        .filter(|_| first % 2 == 1)
    {
        Some(zero) => LandmarkFiles {
            p: part(&files[..zero]),
            q: part(&files[zero + 1..]),
            ..LandmarkFiles::default()
        },
        None => LandmarkFiles {
            both: part(files),
            ..LandmarkFiles::default()
        },
    };
    let files = LandmarkFiles {
        extent_p: if first & 2 == 0 {
            None
        } else {
            Extent::new(640, 480)
        },
        ..files
    };
    let read = match landmarks(&files).and_then(|landmarks| landmarks.scale(None)) {
        Ok(landmarks) => json!(landmarks),
        Err(problem) => {
            let document = problem.to_json("", None);
            assert_is_problem(&document);
            let is_placed = ["line", "column"]
                .iter()
                .all(|name| document[name].as_u64().is_some_and(|number| number > 0));
            assert_eq!(
                is_placed,
                ["bad_landmarks", "too_large"]
                    .iter()
                    .any(|code| document["code"] == **code),
                "{document}"
            );
            return;
        }
    };
    as_fields(&files, &read);
    let count = |name: &str| read[name].as_array().map(Vec::len);
    let handles = count("p").expect("handles");
    assert!((1..=MAX_COLUMNS).contains(&handles), "{read}");
    assert!(
        [count("q"), count("names")]
            .into_iter()
            .flatten()
            .all(|count| count == handles),
        "{read}"
    );
    let again = LandmarkFiles {
        both: part(read.to_string().as_bytes()),
        ..LandmarkFiles::default()
    };
    let again = landmarks(&again).and_then(|landmarks| landmarks.scale(None));
    let mut again = json!(again.expect("what is written is read again"));
    for varying in ["format", "unmatched"] {
        again[varying] = read.get(varying).cloned().unwrap_or(Value::Null);
    }
    assert!(
        read.as_object()
            .is_some_and(|read| read.iter().all(|(name, value)| again[name] == *value)),
        "{read} {again}"
    );
}

/// As fields of the JSON beside the files, the handles are the ones that were read.
fn as_fields(files: &LandmarkFiles, read: &Value) {
    let options = br#"{"extent": [640, 480], "method": "affine", "item": null}"#;
    let options = BesideFiles::new(options, &|| false).expect("an object");
    let target = Target::Session(Extent::new(640, 480).expect("a size"));
    let Ok(fields) = landmarks(files)
        .expect("what was read")
        .into_fields(&options, target)
    else {
        return;
    };
    let fields: Value = serde_json::from_slice(&fields).expect("JSON");
    assert_eq!(
        (&fields["method"], fields["p"].as_array().map(Vec::len)),
        (&json!("affine"), read["p"].as_array().map(Vec::len))
    );
}
