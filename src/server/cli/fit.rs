//! `mlswarp fit WARP.json --extent WIDTH,HEIGHT`: `POST /fit` without a server, as a table or as
//! the JSON of the response.

use serde_json::Value;

use super::failure::Failure;
use super::input::{self, Body, require_one_stdin};
use super::options;
use super::output;
use super::service::{Service, summary};
use crate::app::fit;
use crate::config::{Config, FitArgs};
use crate::wire::of_fit;

/// The columns of the table.
const TABLE_HEADS: [&str; 6] = [
    "method",
    "alpha",
    "smoothing",
    "rms px",
    "max px",
    "outliers",
];

/// Compares methods. The result: what a server sends in response headers, if there is any of it.
/// Errors: See [`Failure`].
pub fn run(config: &Config, args: &FitArgs) -> Result<Option<String>, Failure> {
    let FitArgs {
        input,
        extent,
        align,
        out,
    } = args;
    let files = || input.files().into_iter().chain([extent.image.as_ref()]);
    require_one_stdin(files())?;
    if let Some(out) = out {
        output::require_directory(out)?;
        output::require_other(out, files().flatten())?;
    }
    let Body { json, merged } = Body::read(
        config,
        input,
        extent,
        options::align(align.as_ref()).into_iter().collect(),
    )?;
    // The same file is for `mlswarp warp`, which needs a method.
    let json = of_fit(&json)?;
    let names = serde_json::from_slice(&json)
        .map(|body: Value| body["names"].clone())
        .unwrap_or_default();
    let service = Service::start(config)?;
    let compared = service.run(fit::once(&service.app, service.client, json.into()));
    let (answer, warnings) = compared.map_err(|problem| input::located(&merged, problem))?;
    match out {
        Some(out) => output::write_text(out, &answer)?,
        None => output::write("-".as_ref(), |sink| {
            sink.put(table(&answer, &names).as_bytes())
        })?,
    }
    Ok(summary(None, &warnings))
}

/// The candidates as lines of text, the best first. `names`: of the handles, or null.
fn table(answer: &[u8], names: &Value) -> String {
    let answer: Value = serde_json::from_slice(answer).unwrap_or_default();
    let mut candidates: Vec<&Value> = answer["candidates"]
        .as_array()
        .into_iter()
        .flatten()
        .collect();
    // Of those that are alike, the one that `/fit` lists first; one without a number is the last.
    candidates.sort_by(|a, b| {
        a["rms"]
            .as_f64()
            .unwrap_or(f64::MAX)
            .total_cmp(&b["rms"].as_f64().unwrap_or(f64::MAX))
    });
    let mut rows = vec![TABLE_HEADS.map(str::to_owned)];
    rows.extend(
        candidates
            .into_iter()
            .map(|candidate| row(candidate, names)),
    );
    let width = |column: usize| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: [usize; TABLE_HEADS.len()] = std::array::from_fn(width);
    let line = |row: &[String; TABLE_HEADS.len()]| {
        let cells =
            row.iter()
                .zip(widths)
                .enumerate()
                .map(|(column, (cell, width))| match column {
                    // Words on the left, numbers on the right.
                    0 => format!("{cell:<width$}"),
                    1..=4 => format!("{cell:>width$}"),
                    _ => cell.clone(),
                });
        format!("{}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
    };
    rows.iter().map(line).collect()
}

fn row(candidate: &Value, names: &Value) -> [String; TABLE_HEADS.len()] {
    let number = |value: &Value| {
        value
            .as_f64()
            .map_or_else(String::new, |number| number.to_string())
    };
    let length = |value: &Value| {
        value
            .as_f64()
            .map_or_else(String::new, |length| format!("{length:.2}"))
    };
    let outlier = |index: &Value| {
        let name = index
            .as_u64()
            .and_then(|index| names.get(usize::try_from(index).ok()?)?.as_str());
        name.map_or_else(|| index.to_string(), |name| format!("{index} ({name})"))
    };
    let outliers: Vec<String> = candidate["outliers"]
        .as_array()
        .into_iter()
        .flatten()
        .map(outlier)
        .collect();
    [
        candidate["method"].as_str().unwrap_or_default().to_owned(),
        number(&candidate["alpha"]),
        number(&candidate["smoothing"]),
        length(&candidate["rms"]),
        length(&candidate["max"]),
        outliers.join(", "),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_begins_with_the_best_and_names_outliers() {
        let answer = br#"{"best": null, "candidates": [
            {"method": "rigid", "alpha": 1.0, "smoothing": null, "rms": 12.345, "max": 100.0,
              "outliers": [2, 0]},
            {"method": "affine", "alpha": 1.5, "smoothing": null, "rms": null, "max": null,
              "outliers": []},
            {"method": "tps", "alpha": null, "smoothing": 0.01, "rms": 3.0, "max": 4.126,
              "outliers": [1]}]}"#;
        let names = serde_json::json!(["a", "left eye"]);
        let lines = [
            "method  alpha  smoothing  rms px  max px  outliers",
            "tps                 0.01    3.00    4.13  1 (left eye)",
            "rigid       1              12.35  100.00  2, 0 (a)",
            "affine    1.5",
        ];
        assert_eq!(
            table(answer, &names),
            lines.map(|line| format!("{line}\n")).concat()
        );
        assert!(table(answer, &Value::Null).contains("2, 0\n"));
    }
}
