//! Which landmarks of two files belong together.

use std::collections::HashMap;

use mlswarp::deform::Handle;

use super::File;
use super::bad::Bad;
use crate::problem::words::quote;

/// Names that only one side has; their landmarks are left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Unmatched {
    pub(super) p: Vec<String>,
    pub(super) q: Vec<String>,
}

impl Unmatched {
    /// Whether every landmark has two sides.
    pub(super) fn is_empty(&self) -> bool {
        self.p.is_empty() && self.q.is_empty()
    }
}

/// The indices of landmarks that belong together, and the names that only one side has.
pub(super) struct Pairs {
    pub(super) indices: Vec<(usize, usize)>,
    pub(super) unmatched: Unmatched,
}

type Names = Vec<(usize, String)>;

/// Pairs the landmarks by name if both files have names, except where the names are the same in both or only say what kind of thing a
/// landmark is: then, and without names, by order.
/// Errors: An error, and 0 for the first file or 1 for the second: a name that does not tell landmarks apart, or another number or shape.
pub(super) fn pair([p, q]: &[File; 2]) -> Result<Pairs, (usize, Bad)> {
    let by_name = match (&p.names, &q.names) {
        (Some(names_p), Some(names_q)) if !is_same(names_p, names_q) => pair_by_name([names_p, names_q])?,
        _ => None,
    };
    let pairs = by_name.map_or_else(|| pair_by_order([p, q]), Ok)?;
    for (index_p, index_q) in &pairs.indices {
        let [of_p, of_q] = [&p.p[*index_p], &q.p[*index_q]];
        if of_p.places().len() != of_q.places().len() {
            let detail = format!("expected {}, as landmark {index_p} of `landmarks_p` is; found {}", shape(of_p), shape(of_q));
            return Err((1, Bad::new(q.at[*index_q], detail)));
        }
    }
    Ok(pairs)
}

fn is_same(p: &Names, q: &Names) -> bool {
    p.iter().map(|(_, name)| name).eq(q.iter().map(|(_, name)| name))
}

fn shape(handle: &Handle) -> String {
    match handle {
        Handle::Point(_) => "a point".to_owned(),
        Handle::Polyline(places) => format!("a line of {} positions", places.len()),
    }
}

fn pair_by_order(files: [&File; 2]) -> Result<Pairs, (usize, Bad)> {
    let [count_p, count_q] = files.map(|file| file.p.len());
    let shorter = count_p.min(count_q);
    if let Some((side, at)) = files.iter().enumerate().find_map(|(side, file)| Some((side, *file.at.get(shorter)?))) {
        let detail = format!(
            "expected {shorter} landmark{}, as the other file has; found {}: without names in both files they are matched by order",
            if shorter == 1 { "" } else { "s" },
            count_p.max(count_q)
        );
        return Err((side, Bad::new(at, detail)));
    }
    Ok(Pairs { indices: (0..shorter).map(|index| (index, index)).collect(), unmatched: Unmatched::default() })
}

/// `None` if the names have nothing in common and some are repeated, as those of classes.
fn pair_by_name(sides: [&Names; 2]) -> Result<Option<Pairs>, (usize, Bad)> {
    let firsts = sides.map(|names| {
        let mut first = HashMap::with_capacity(names.len());
        for (index, (_, name)) in names.iter().enumerate() {
            first.entry(name.as_str()).or_insert(index);
        }
        first
    });
    let [names_p, names_q] = sides;
    let [first_p, first_q] = &firsts;
    if !first_p.keys().any(|name| first_q.contains_key(name)) {
        if first_p.len() < names_p.len() || first_q.len() < names_q.len() {
            return Ok(None);
        }
        let detail = format!("expected a name that `landmarks_p` has too; found none of its {}", names_p.len());
        return Err((1, Bad::new(names_q[0].0, detail)));
    }
    for (side, (first, other)) in [(first_p, first_q), (first_q, first_p)].into_iter().enumerate() {
        for (index, (at, name)) in sides[side].iter().enumerate() {
            let earlier = first[name.as_str()];
            if earlier < index && other.contains_key(name.as_str()) {
                let name = quote(name);
                let detail =
                    format!("expected each name once, to match two files by name; {name} is the name of landmark {earlier} already");
                return Err((side, Bad::new(*at, detail)));
            }
        }
    }
    let indices = names_p.iter().enumerate().filter_map(|(index, (_, name))| Some((index, *first_q.get(name.as_str())?))).collect();
    let missing = |names: &Names, other: &HashMap<&str, usize>| {
        names.iter().filter(|(_, name)| !other.contains_key(name.as_str())).map(|(_, name)| name.clone()).collect()
    };
    Ok(Some(Pairs { indices, unmatched: Unmatched { p: missing(names_p, first_q), q: missing(names_q, first_p) } }))
}
