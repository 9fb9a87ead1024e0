//! Which landmarks of two files belong together.

use std::collections::HashMap;

use mlswarp::deform::Handle;

use super::bad::Bad;
use super::collect::{LandmarkFile, Unmatched};
use crate::problem::words::quote;
use crate::wire::enum_name::Matching;

/// The indices of landmarks that belong together, and the names that only one side has.
pub(super) struct Pairs {
    pub(super) indices: Vec<(usize, usize)>,
    pub(super) unmatched: Unmatched,
}

type Names = Vec<(usize, String)>;
/// How to match by order, for errors.
const BY_ORDER: &str = "to match them by order send match=order (`--match order`)";

/// Pairs the landmarks as requested. Without a request they are paired by name if both files have
/// names that tell which belong together, and otherwise by order: so are names that are the same in
/// both files, that only say what kind of thing a landmark is, or that are positions.
///
/// Errors: an error, and 0 for the first file or 1 for the second: a name that does not tell
/// landmarks apart, names of which the fewest match, or another number or shape.
pub(super) fn pair(
    files: &[LandmarkFile; 2],
    matching: Option<Matching>,
) -> Result<Pairs, (usize, Bad)> {
    let [p, q] = files;
    let pairs = match (matching, &p.names, &q.names) {
        (Some(Matching::Name), Some(p), Some(q)) => pair_by_name([p, q], true)?,
        (Some(Matching::Name), None, _) => return Err(unnamed(0, p)),
        (Some(Matching::Name), _, None) => return Err(unnamed(1, q)),
        (None, Some(names_p), Some(names_q))
            if !is_same(names_p, names_q) && !files.iter().any(has_positions_as_names) =>
        {
            pair_by_name([names_p, names_q], false)?
        }
        _ => None,
    };
    let pairs = pairs.map_or_else(|| pair_by_order([p, q]), Ok)?;
    // What is written is read again: some landmark of `landmarks_p` needs a position.
    let is_missing = |(index, _): &(usize, usize)| p.p[*index] == Handle::Missing;
    if let Some((first, _)) = pairs
        .indices
        .first()
        .filter(|_| pairs.indices.iter().all(is_missing))
    {
        let detail =
            "expected a position of at least one landmark that the other file has too; found none";
        return Err((0, Bad::new(p.at[*first], detail)));
    }
    for (index_p, index_q) in &pairs.indices {
        let [of_p, of_q] = [&p.p[*index_p], &q.p[*index_q]];
        let is_missing = [of_p, of_q].contains(&&Handle::Missing);
        if of_p.places().len() != of_q.places().len() && !is_missing {
            let detail = format!(
                "expected {}, as landmark {index_p} of `landmarks_p` is; found {}",
                shape(of_p),
                shape(of_q)
            );
            return Err((1, Bad::new(q.at[*index_q], detail)));
        }
    }
    Ok(pairs)
}

fn unnamed(side: usize, file: &LandmarkFile) -> (usize, Bad) {
    let at = file.at.first().copied().unwrap_or_default();
    (
        side,
        Bad::new(
            at,
            format!("expected names, to match two files by name; found none: {BY_ORDER}"),
        ),
    )
}

fn is_same(p: &Names, q: &Names) -> bool {
    p.iter()
        .map(|(_, name)| name)
        .eq(q.iter().map(|(_, name)| name))
}

fn shape(handle: &Handle) -> String {
    match handle {
        Handle::Point(_) => "a point".to_owned(),
        Handle::Polyline(places) => format!("a line of {} positions", places.len()),
        Handle::Missing => "nothing".to_owned(),
    }
}

/// Whether every name is the position of its landmark, as ImageJ names landmarks without a name:
/// `0045-0030` is y 45, x 30, after the slice of a stack, and in its tables after the title of the
/// image (`ij/plugin/frame/RoiManager.java`, `getLabel`).
fn has_positions_as_names(file: &LandmarkFile) -> bool {
    /// Half a pixel of conventions, and rounding.
    const NEAR_PX: f64 = 1.5;
    let is_position = |((_, name), handle): (&(usize, String), &Handle)| {
        let label = name
            .rsplit(':')
            .find(|part| part.contains('-'))
            .unwrap_or(name);
        let mut numbers = label
            .rsplit('-')
            .map(|part| part.parse::<u32>().ok().filter(|_| part.len() >= 4));
        let (Some(Some(x)), Some(Some(y))) = (numbers.next(), numbers.next()) else {
            return false;
        };
        let is_near = |value: f64, label: u32| (value - f64::from(label)).abs() <= NEAR_PX;
        numbers.all(|slice| slice.is_some())
            && handle
                .places()
                .first()
                .is_none_or(|at| is_near(at.x, x) && is_near(at.y, y))
    };
    file.names
        .as_ref()
        .is_some_and(|names| names.iter().zip(&file.p).all(is_position))
}

fn pair_by_order(files: [&LandmarkFile; 2]) -> Result<Pairs, (usize, Bad)> {
    let [count_p, count_q] = files.map(|file| file.p.len());
    let shorter = count_p.min(count_q);
    if let Some((side, at)) = files
        .iter()
        .enumerate()
        .find_map(|(side, file)| Some((side, *file.at.get(shorter)?)))
    {
        let detail = format!(
            "expected {shorter} landmark{}, as the other file has; found {}: without names in \
                both files they are matched by order",
            if shorter == 1 { "" } else { "s" },
            count_p.max(count_q)
        );
        return Err((side, Bad::new(at, detail)));
    }
    Ok(Pairs {
        indices: (0..shorter).map(|index| (index, index)).collect(),
        unmatched: Unmatched::default(),
    })
}

/// Names as they are compared: without case, where that leaves those of each file different.
fn keys(sides: [&Names; 2]) -> [Vec<String>; 2] {
    let exact = sides.map(|names| {
        names
            .iter()
            .map(|(_, name)| name.clone())
            .collect::<Vec<_>>()
    });
    let folded = exact.each_ref().map(|names| {
        names
            .iter()
            .map(|name| name.to_lowercase())
            .collect::<Vec<_>>()
    });
    let count = |names: &[String]| names.iter().collect::<std::collections::HashSet<_>>().len();
    let is_clear = exact
        .iter()
        .zip(&folded)
        .all(|(exact, folded)| count(exact) == count(folded));
    if is_clear { folded } else { exact }
}

/// `None` if the names have nothing in common and some are repeated, as those of classes.
/// `is_wanted`: however few match.
fn pair_by_name(sides: [&Names; 2], is_wanted: bool) -> Result<Option<Pairs>, (usize, Bad)> {
    let keys = keys(sides);
    let firsts = keys.each_ref().map(|keys| {
        let mut first = HashMap::with_capacity(keys.len());
        for (index, key) in keys.iter().enumerate() {
            first.entry(key.as_str()).or_insert(index);
        }
        first
    });
    let [first_p, first_q] = &firsts;
    let [names_p, names_q] = sides;
    let common = first_p
        .keys()
        .filter(|name| first_q.contains_key(**name))
        .count();
    let fewest = first_p.len().min(first_q.len());
    if common == 0 {
        if !is_wanted && (first_p.len() < names_p.len() || first_q.len() < names_q.len()) {
            return Ok(None);
        }
        let detail = format!(
            "expected a name that `landmarks_p` has too; found none of its {}: {BY_ORDER}",
            names_p.len()
        );
        return Err((1, Bad::new(names_q[0].0, detail)));
    }
    for (side, (first, other)) in [(first_p, first_q), (first_q, first_p)]
        .into_iter()
        .enumerate()
    {
        for (index, (at, name)) in sides[side].iter().enumerate() {
            let key = keys[side][index].as_str();
            let earlier = first[key];
            if earlier < index && other.contains_key(key) {
                let name = quote(name);
                let detail = format!(
                    "expected each name once, to match two files by name; {name} is the name of \
                        landmark {earlier} already: {BY_ORDER}"
                );
                return Err((side, Bad::new(*at, detail)));
            }
        }
    }
    if !is_wanted && 2 * common < fewest {
        let at = keys[1]
            .iter()
            .position(|key| !first_p.contains_key(key.as_str()))
            .unwrap_or_default();
        let detail = format!(
            "{common} of {fewest} names match: {BY_ORDER}, or match=name to leave out all others"
        );
        return Err((1, Bad::new(names_q[at].0, detail)));
    }
    let indices = keys[0]
        .iter()
        .enumerate()
        .filter_map(|(index, key)| Some((index, *first_q.get(key.as_str())?)))
        .collect();
    let missing = |side: usize, other: &HashMap<&str, usize>| {
        let pairs = sides[side].iter().zip(&keys[side]);
        pairs
            .filter(|(_, key)| !other.contains_key(key.as_str()))
            .map(|((_, name), _)| name.clone())
            .collect()
    };
    Ok(Some(Pairs {
        indices,
        unmatched: Unmatched {
            p: missing(0, first_q),
            q: missing(1, first_p),
        },
    }))
}
