//! Mirrored images: which landmark is the mirror image of which, and positions on the other side.

use std::fmt;

use crate::deform::{Class, Handle, IsCancelled, fitted};
use crate::geometry::Point;

/// Handles whose pairs are looked for by their positions: a round compares each with each.
const MOST_SEARCHED: usize = 500;
/// Rounds of alignment and search.
const MOST_ROUNDS: usize = 10;
/// The mirror image is laid over a shape with turns of 0 to 4 steps to either side at first: an
/// upright shape needs none, a tilted one twice its tilt. Cosine and sine of a step, 0.2 radians.
const STEP: (f64, f64) = (0.99 / 1.01, 0.2 / 1.01);
const MOST_STEPS: usize = 4;
/// The best start is taken if its squared distances are less than this share of those without a
/// turn.
const CLEARLY_LESS: f64 = 0.5;
/// How far the mirror image of a shape may be from the shape, as a share of its extent, where
/// neighbours are nearer to each other than that.
const MOST_ASYMMETRY: f64 = 0.12;
/// What it is worth that the pairs of neighbours in the list are neighbours, as a share of the mean
/// squared distance from the middle. So the lips of a closed mouth, which are one line but for
/// errors of the landmarks, are not exchanged.
const NEIGHBOUR_SHARE: f64 = 0.003;
/// What is not less, as a share of that.
const ROUNDING: f64 = 1e-9;
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
    /// The search was cancelled.
    Cancelled,
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
            Self::Cancelled => write!(f, "the search for pairs was cancelled"),
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

    /// Pairs by position: the shape is mirrored and laid over itself by the best rigid motion. Of
    /// all ways to make pairs, that with the least sum of squared distances between the handles and
    /// their mirrored pairs is looked for, where pairs of neighbours in the list had better be
    /// neighbours; repeated until nothing changes. O(handles^2) a round.
    ///
    /// # Errors
    /// A handle whose pair is far from its mirror image; too many handles; cancelled.
    pub fn of_positions(shape: &[Handle], cancelled: IsCancelled<'_>) -> Result<Self, NoPairs> {
        if shape.len() > MOST_SEARCHED {
            return Err(NoPairs::TooMany {
                limit: MOST_SEARCHED,
            });
        }
        let mut search = Search::new(shape, cancelled).ok_or(NoPairs::Cancelled)?;
        for _ in 0..MOST_ROUNDS {
            let last = search.pairs.clone();
            search.pair(cancelled).ok_or(NoPairs::Cancelled)?;
            if search.pairs == last {
                break;
            }
            search.place();
        }
        match search.far() {
            Some(handle) => Err(NoPairs::NoPair { handle }),
            None => Self::checked(search.pairs, shape),
        }
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

/// Looks for pairs by position.
struct Search {
    centres: Vec<Point>,
    mirrored: Vec<Point>,
    /// `mirrored`, laid over `centres`.
    placed: Vec<Point>,
    /// Those of the last round; empty before.
    pairs: Vec<usize>,
    /// The worth of a link: of two neighbours whose pairs are neighbours.
    link: f64,
    /// The difference of the indices of such pairs: 1, or -1 where most lists run back.
    along: isize,
}

impl Search {
    /// Lays the mirror image over the shape by nearest handles. `None` when cancelled.
    fn new(shape: &[Handle], cancelled: IsCancelled<'_>) -> Option<Self> {
        let centres: Vec<Point> = shape.iter().map(centre).collect();
        let x = mean(centres.iter().map(|v| v.x));
        let middle = Point::new(x, mean(centres.iter().map(|v| v.y)));
        let flip = |v: &Point| Point::new(2.0 * x - v.x, v.y);
        let mut search = Self {
            mirrored: centres.iter().map(flip).collect(),
            placed: Vec::new(),
            pairs: Vec::new(),
            link: NEIGHBOUR_SHARE * mean(centres.iter().map(|v| square(*v, middle))),
            along: 1,
            centres,
        };
        let mut starts = Vec::new();
        for side in [1.0, -1.0] {
            let (mut cos, mut sin) = (1.0, 0.0);
            for _ in 0..=MOST_STEPS {
                let turn = |v: &Point| {
                    let d = *v - middle;
                    let (x, y) = (cos * d.x - sin * d.y, sin * d.x + cos * d.y);
                    Point::new(middle.x + x, middle.y + y)
                };
                search.placed = search.mirrored.iter().map(turn).collect();
                starts.push((search.settle(cancelled)?, search.placed.clone()));
                (cos, sin) = (
                    cos * STEP.0 - side * sin * STEP.1,
                    sin * STEP.0 + side * cos * STEP.1,
                );
            }
        }
        let upright = CLEARLY_LESS * starts[0].0;
        let best = starts.iter().filter(|start| start.0 < upright);
        let best = best.min_by(|a, b| a.0.total_cmp(&b.0));
        search.placed = best.unwrap_or(&starts[0]).1.clone();
        search.pairs.clear();
        Some(search)
    }

    /// Moves the mirror image until the nearest handles stay the same. The sum of their squared
    /// distances.
    fn settle(&mut self, cancelled: IsCancelled<'_>) -> Option<f64> {
        self.pairs.clear();
        for _ in 0..MOST_ROUNDS {
            if cancelled() {
                return None;
            }
            let nearest = self.of_each(|a| self.nearest(a));
            if nearest == self.pairs {
                break;
            }
            self.pairs = nearest;
            self.place();
        }
        let pairs = self.pairs.iter().zip(&self.centres);
        Some(pairs.map(|(pair, v)| square(*v, self.placed[*pair])).sum())
    }

    fn of_each<T>(&self, of: impl Fn(usize) -> T) -> Vec<T> {
        (0..self.centres.len()).map(of).collect()
    }

    /// The handle whose mirror image is nearest.
    fn nearest(&self, a: usize) -> usize {
        let distances = self.placed.iter().map(|v| square(self.centres[a], *v));
        let least = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        least.map_or(a, |(index, _)| index)
    }

    /// Lays the mirror image over the shape by the pairs.
    fn place(&mut self) {
        let points = |places: &mut dyn Iterator<Item = Point>| -> Vec<Handle> {
            places.map(Handle::Point).collect()
        };
        let chosen = points(&mut self.pairs.iter().map(|pair| self.mirrored[*pair]));
        let centres = points(&mut self.centres.iter().copied());
        if let Some(best) = fitted(Class::Rigid, &chosen, &centres, None) {
            self.placed = self.mirrored.iter().map(|v| best.map.map(*v)).collect();
        }
    }

    /// The mean squared distance between two handles and each other's mirror images.
    fn apart(&self, a: usize, b: usize) -> f64 {
        let ways = [(a, b), (b, a)].map(|(a, b)| square(self.centres[a], self.placed[b]));
        0.5 * (ways[0] + ways[1])
    }

    /// What a pair costs each of its handles: at least [`Search::apart`] less two links.
    fn cost(&self, a: usize, b: usize) -> f64 {
        let links = |a: usize, b: usize| {
            let is_link = |step: isize| {
                let next = a.checked_add_signed(step).and_then(|k| self.pairs.get(k));
                let expected = b.checked_add_signed(step * self.along);
                f64::from(u8::from(next.is_some() && next.copied() == expected))
            };
            is_link(-1) + is_link(1)
        };
        self.apart(a, b) - 0.5 * self.link * (links(a, b) + links(b, a))
    }

    /// Handles that are each other's nearest become pairs, the others are on the axis; then two
    /// handles are made a pair, or divided, where that costs less.
    fn pair(&mut self, cancelled: IsCancelled<'_>) -> Option<()> {
        let steps = |along: isize| {
            let is_step = |pair: &&[usize]| pair[0].checked_add_signed(along) == Some(pair[1]);
            self.pairs.windows(2).filter(is_step).count()
        };
        self.along = if steps(1) > steps(-1) { 1 } else { -1 };
        let nearest = self.of_each(|a| self.nearest(a));
        let own = |a: usize| {
            if nearest[nearest[a]] == a {
                nearest[a]
            } else {
                a
            }
        };
        let mut pairs = self.of_each(own);
        let mut costs = self.of_each(|a| self.cost(a, pairs[a]));
        let count = pairs.len();
        for _ in 0..MOST_ROUNDS {
            if cancelled() {
                return None;
            }
            let before = pairs.clone();
            for (a, c) in (0..count).flat_map(|a| (a + 1..count).map(move |c| (a, c))) {
                let (b, d) = (pairs[a], pairs[c]);
                if b != c && self.apart(a, c) >= costs[a] + costs[c] + 4.0 * self.link {
                    continue;
                }
                // Who is left by `a` and `c` goes together; a handle alone is on the axis.
                let next = match (a == b, c == d) {
                    _ if b == c => [(a, a), (c, c)],
                    (true, true) => [(a, c), (a, c)],
                    (true, false) => [(a, c), (d, d)],
                    (false, true) => [(a, c), (b, b)],
                    (false, false) => [(a, c), (b, d)],
                };
                let handles = |(a, b): (usize, usize)| if a == b { 1.0 } else { 2.0 };
                let old = if b == c {
                    [(a, c), (a, c)]
                } else {
                    [(a, b), (c, d)]
                };
                let total = |ways: [(usize, usize); 2]| {
                    let one = |way: (usize, usize)| handles(way) * self.cost(way.0, way.1);
                    one(ways[0])
                        + if ways[0] == ways[1] {
                            0.0
                        } else {
                            one(ways[1])
                        }
                };
                if total(next) < total(old) - ROUNDING * self.link {
                    for (a, b) in next {
                        (pairs[a], pairs[b]) = (b, a);
                        costs[a] = self.cost(a, b);
                        costs[b] = costs[a];
                    }
                }
            }
            if pairs == before {
                break;
            }
        }
        self.pairs = pairs;
        Some(())
    }

    /// A handle whose pair is neither its nearest nor near.
    fn far(&self) -> Option<usize> {
        let from_first = |v: &Point| square(*v, self.centres[0]);
        let enough = self.centres.iter().map(from_first).fold(0.0, f64::max);
        let enough = MOST_ASYMMETRY * MOST_ASYMMETRY * enough;
        (0..self.pairs.len()).find(|a| {
            let pair = self.pairs[*a];
            let is_nearest = self.nearest(*a) == pair && self.nearest(pair) == *a;
            !is_nearest && square(self.centres[*a], self.placed[pair]) > enough
        })
    }
}

fn square(a: Point, b: Point) -> f64 {
    let d = a - b;
    d.dot(d)
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
