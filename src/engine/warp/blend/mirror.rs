//! Mirrored images: which landmark is the mirror image of which, and positions on the other side.

use std::fmt;

use crate::deform::{Class, Handle, fitted};
use crate::geometry::Point;

/// Handles whose pairs are looked for by their positions: a round compares each with each.
const MOST_SEARCHED: usize = 2000;
/// Rounds of alignment and search.
const MOST_ROUNDS: usize = 20;
/// How far the mirror image of a shape may be from the shape, as a share of its extent, where
/// neighbours are nearer to each other than that.
const MOST_ASYMMETRY: f64 = 0.12;
/// Handles that are paired the nearest first: with more, the shape is not symmetric.
const MOST_OPEN: usize = 200;
/// Words for the sides in names of landmarks.
const SIDES: [(&str, &str); 4] = [
    ("left", "right"),
    ("Left", "Right"),
    ("LEFT", "RIGHT"),
    ("L", "R"),
];

/// For each handle, the one that is its mirror image: itself for those on the axis. Mirroring twice
/// gives the handle itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MirrorPairs(Vec<usize>);

/// Why the pairs are not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoPairs {
    /// A permutation has another number of entries than there are handles.
    Count {
        /// Its entries.
        found: usize,
        /// The handles.
        expected: usize,
    },
    /// The mirror image of a handle's mirror image is not the handle itself, or has another form.
    NoPair {
        /// Index of the handle.
        handle: usize,
    },
    /// There are too many handles to look for pairs.
    TooMany {
        /// The most of them.
        limit: usize,
    },
}

impl fmt::Display for NoPairs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count { found, expected } => {
                write!(
                    f,
                    "the permutation has {found} entries for {expected} handles"
                )
            }
            Self::NoPair { handle } => write!(
                f,
                "the mirror image of handle {handle} is not known; give a permutation in which \
                 two handles name each other, and one on the axis names itself"
            ),
            Self::TooMany { limit } => write!(
                f,
                "pairs are looked for among at most {limit} handles; give a permutation"
            ),
        }
    }
}

impl std::error::Error for NoPairs {}

impl MirrorPairs {
    /// Pairs as they are given.
    ///
    /// # Errors
    /// Not one entry for each handle, or entries that do not name each other.
    pub fn of_permutation(pairs: &[usize], shape: &[Handle]) -> Result<Self, NoPairs> {
        if pairs.len() != shape.len() {
            let (found, expected) = (pairs.len(), shape.len());
            return Err(NoPairs::Count { found, expected });
        }
        Self::checked(pairs.to_vec(), shape)
    }

    /// Pairs by names with the words left and right; a name without either is on the axis. `None`
    /// if a name lacks its counterpart, or no name has a side.
    #[must_use]
    pub fn of_names(names: &[String], shape: &[Handle]) -> Option<Self> {
        let index: std::collections::HashMap<&str, usize> = names
            .iter()
            .enumerate()
            .map(|(k, name)| (name.as_str(), k))
            .collect();
        let pair = |name: &String| match other_side(name) {
            None => index.get(name.as_str()).copied(),
            Some(others) => others
                .iter()
                .find_map(|other| index.get(other.as_str()).copied()),
        };
        let pairs: Vec<usize> = names.iter().map(pair).collect::<Option<_>>()?;
        let is_sided = pairs.iter().enumerate().any(|(k, pair)| k != *pair);
        (is_sided && pairs.len() == shape.len())
            .then(|| Self::checked(pairs, shape).ok())
            .flatten()
    }

    /// Pairs by position: the shape is mirrored, laid over itself by the best rigid motion, and
    /// each handle's pair is the nearest mirrored one; repeated until nothing changes. Handles that
    /// are not each other's nearest, as of a mouth that smiles on one side, are paired the nearest
    /// first. O(handles^2) a round.
    ///
    /// # Errors
    /// A handle whose pair is far from its mirror image; too many handles.
    pub fn of_positions(shape: &[Handle]) -> Result<Self, NoPairs> {
        if shape.len() > MOST_SEARCHED {
            return Err(NoPairs::TooMany {
                limit: MOST_SEARCHED,
            });
        }
        let centres: Vec<Point> = shape.iter().map(centre).collect();
        let middle = mean(centres.iter().map(|v| v.x));
        let mirrored: Vec<Point> = centres
            .iter()
            .map(|v| Point::new(2.0 * middle - v.x, v.y))
            .collect();
        let points = |places: &[Point]| {
            places
                .iter()
                .copied()
                .map(Handle::Point)
                .collect::<Vec<_>>()
        };
        let mut placed = mirrored.clone();
        let mut pairs: Vec<usize> = Vec::new();
        for _ in 0..MOST_ROUNDS {
            let nearest = |v: &Point| {
                let distances = placed.iter().map(|other| v.distance(*other)).enumerate();
                distances
                    .min_by(|a, b| a.1.total_cmp(&b.1))
                    .map_or(0, |(index, _)| index)
            };
            let next: Vec<usize> = centres.iter().map(nearest).collect();
            if next == pairs {
                break;
            }
            pairs = next;
            let chosen: Vec<Point> = pairs.iter().map(|pair| mirrored[*pair]).collect();
            let Some(best) = fitted(Class::Rigid, &points(&chosen), &points(&centres), None) else {
                break;
            };
            placed = mirrored.iter().map(|v| best.map.map(*v)).collect();
        }
        Self::checked(completed(pairs, &centres, &placed), shape)
    }

    fn checked(pairs: Vec<usize>, shape: &[Handle]) -> Result<Self, NoPairs> {
        let is_pair = |(handle, pair): (usize, &usize)| {
            pairs.get(*pair) == Some(&handle)
                && shape[handle].places().len() == shape[*pair].places().len()
        };
        match pairs.iter().enumerate().position(|entry| !is_pair(entry)) {
            Some(handle) => Err(NoPairs::NoPair { handle }),
            None => Ok(Self(pairs)),
        }
    }

    /// The shape on the other side of an image of this width, px: handle i is the mirror image of
    /// its pair.
    #[must_use]
    pub fn mirrored(&self, shape: &[Handle], width: f64) -> Vec<Handle> {
        let flip = |v: &Point| Point::new(width - v.x, v.y);
        let handle = |(index, pair): (usize, &usize)| {
            let mut places: Vec<Point> = shape[*pair].places().iter().map(flip).collect();
            if self.is_reversed(shape, index) {
                places.reverse();
            }
            match shape[*pair] {
                Handle::Point(_) => places
                    .first()
                    .copied()
                    .map_or(Handle::Missing, Handle::Point),
                Handle::Polyline(_) => Handle::Polyline(places),
                Handle::Missing => Handle::Missing,
            }
        };
        self.0.iter().enumerate().map(handle).collect()
    }

    /// Whether a line and the mirror image of its pair run in opposite directions, as both halves
    /// of a mouth that is drawn from left to right.
    fn is_reversed(&self, shape: &[Handle], handle: usize) -> bool {
        let (own, pair) = (shape[handle].places(), shape[self.0[handle]].places());
        let along = |places: &[Point]| match places {
            [first, .., last] => *last - *first,
            _ => Point::default() - Point::default(),
        };
        let (own, pair) = (along(own), along(pair));
        own.y * pair.y - own.x * pair.x < 0.0
    }
}

/// Points that name each other stay a pair. The others are paired again, the nearest first, unless
/// they are far apart. `placed`: the mirror images of `centres`, laid over them.
fn completed(mut pairs: Vec<usize>, centres: &[Point], placed: &[Point]) -> Vec<usize> {
    let is_mutual = |(handle, pair): (usize, &usize)| pairs[*pair] == handle;
    let mutual: Vec<bool> = pairs.iter().enumerate().map(is_mutual).collect();
    let mut open: Vec<usize> = (0..pairs.len()).filter(|k| !mutual[*k]).collect();
    if open.len() > MOST_OPEN {
        return pairs;
    }
    let from_first = |v: &Point| v.distance(centres[0]);
    let enough = MOST_ASYMMETRY * centres.iter().map(from_first).fold(0.0, f64::max);
    // Those of the later handle, so that both ways are one entry.
    let mut near = Vec::new();
    for (k, a) in open.iter().enumerate() {
        for b in &open[..=k] {
            let ways = [
                centres[*a].distance(placed[*b]),
                centres[*b].distance(placed[*a]),
            ];
            if ways.iter().all(|way| *way <= enough) {
                near.push((ways[0] + ways[1], *a, *b));
            }
        }
    }
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    for (_, a, b) in near {
        if open.contains(&a) && open.contains(&b) {
            (pairs[a], pairs[b]) = (b, a);
            open.retain(|k| *k != a && *k != b);
        }
    }
    pairs
}

fn centre(handle: &Handle) -> Point {
    let places = handle.places();
    Point::new(
        mean(places.iter().map(|v| v.x)),
        mean(places.iter().map(|v| v.y)),
    )
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// The names that a name could have on the other side; `None` for one without a side.
fn other_side(name: &str) -> Option<Vec<String>> {
    let mut others = Vec::new();
    for (left, right) in SIDES {
        for (from, to) in [(left, right), (right, left)] {
            for (at, _) in name.match_indices(from) {
                let is_word = |c: Option<char>| c.is_none_or(|c| !c.is_ascii_alphanumeric());
                let (before, after) = (&name[..at], &name[at + from.len()..]);
                // A single letter is a side only as a word of its own: `L` in `eye_L`, not in
                // `Lip`.
                let is_side = from.len() > 1
                    || is_word(before.chars().next_back()) && is_word(after.chars().next());
                if is_side {
                    others.push(format!("{before}{to}{after}"));
                }
            }
        }
    }
    (!others.is_empty()).then_some(others)
}
