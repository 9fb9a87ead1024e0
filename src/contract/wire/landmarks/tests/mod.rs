//! Files in the form in which programs write them, good ones and bad ones.

mod annotations;
mod good;
mod hostile;
mod pairs;
mod work;

use serde_json::{Value, json};

use super::LandmarkFiles;
use crate::problem::Problem;

const MAX_COLUMNS: usize = 100;

/// What `POST /landmarks` answers to one file.
fn read(file: impl AsRef<[u8]>) -> Result<Value, Problem> {
    convert(&both(file.as_ref().to_vec()))
}

fn both(file: impl Into<bytes::Bytes>) -> LandmarkFiles {
    LandmarkFiles {
        both: Some(file.into()),
        ..LandmarkFiles::default()
    }
}

/// What it answers to two.
fn read_two(p: &str, q: &str) -> Result<Value, Problem> {
    convert(&two(p, q))
}

fn two(p: &str, q: &str) -> LandmarkFiles {
    LandmarkFiles {
        p: Some(p.to_owned().into()),
        q: Some(q.to_owned().into()),
        ..LandmarkFiles::default()
    }
}

fn convert(files: &LandmarkFiles) -> Result<Value, Problem> {
    Ok(json!(files.read(MAX_COLUMNS, &|| false)?.scale(None)?))
}

/// The line and the column of a problem, and its text.
fn place(problem: &Problem) -> (u64, u64, String) {
    let document = problem.to_json("", None);
    (
        document["line"].as_u64().unwrap_or_default(),
        document["column"].as_u64().unwrap_or_default(),
        problem.detail.clone(),
    )
}
