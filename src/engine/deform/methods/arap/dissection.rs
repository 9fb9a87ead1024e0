//! The order in which the vertices of a lattice are eliminated: nested dissection by position
//! (mathematics 10.6).

use std::ops::Range;

/// Sets of at most this many vertices are not divided.
const LEAF: usize = 24;

/// A set of vertices that are eliminated together.
#[derive(Clone, Debug)]
pub(super) struct Front {
    /// Its vertices, by their place in the order.
    pub(super) own: Range<usize>,
    /// Where the later vertices that its elimination reaches stand in `Dissection::reached`.
    pub(super) reached: Range<usize>,
    /// Where its columns begin in a factor.
    pub(super) values: usize,
    /// Sets that were divided from it.
    pub(super) children: [Option<usize>; 2],
    /// Where its elements stand in `Dissection::elements`.
    pub(super) elements: Range<usize>,
}

impl Front {
    pub(super) fn len(&self) -> usize {
        self.own.len() + self.reached.len()
    }
}

/// An order of elimination, and the fronts that follow from it; the same for all matrices of one
/// set of elements.
#[derive(Debug)]
pub(super) struct Dissection {
    /// Each after its children.
    pub(super) fronts: Vec<Front>,
    /// The place of each vertex in the order.
    pub(super) place: Vec<usize>,
    pub(super) reached: Vec<usize>,
    pub(super) elements: Vec<usize>,
    /// Entries of a factor.
    pub(super) values: usize,
}

/// A set that is yet to be divided, or whose parts have been.
enum Step {
    Divide(Vec<u32>),
    /// The set, and whether its two parts were eliminated before.
    Eliminate(Vec<u32>, bool),
}

/// What the division of sets needs.
struct Divider<'a> {
    positions: &'a [[u32; 2]],
    elements: &'a [[u32; 4]],
    /// Elements of each vertex.
    first: Vec<usize>,
    of_vertex: Vec<usize>,
    /// Side of each vertex in the division that is being made.
    is_lower: Vec<bool>,
}

impl<'a> Divider<'a> {
    fn new(positions: &'a [[u32; 2]], elements: &'a [[u32; 4]]) -> Self {
        let mut first = vec![0; positions.len() + 1];
        for vertex in elements.iter().flatten() {
            first[*vertex as usize + 1] += 1;
        }
        for k in 1..first.len() {
            first[k] += first[k - 1];
        }
        let mut next = first.clone();
        let mut of_vertex = vec![0; 4 * elements.len()];
        for (k, element) in elements.iter().enumerate() {
            for vertex in element {
                of_vertex[next[*vertex as usize]] = k;
                next[*vertex as usize] += 1;
            }
        }
        Self {
            positions,
            elements,
            first,
            of_vertex,
            is_lower: vec![false; positions.len()],
        }
    }

    /// Two sets that no element connects, and the vertices between them; `None` if it is small.
    fn divide(&mut self, set: &[u32]) -> Option<[Vec<u32>; 3]> {
        if set.len() <= LEAF {
            return None;
        }
        let positions = self.positions;
        let along = |axis: usize| set.iter().map(move |v| positions[*v as usize][axis]);
        let extent = [0, 1].map(|axis| {
            let (least, most) = (along(axis).min()?, along(axis).max()?);
            Some((most - least, least))
        });
        let axis = usize::from(extent[1]?.0 > extent[0]?.0);
        let (length, least) = extent[axis]?;
        if length == 0 {
            return None;
        }
        let mut coordinates: Vec<u32> = along(axis).collect();
        let middle = coordinates.len() / 2;
        let median = *coordinates.select_nth_unstable(middle).1;
        // At least one line of vertices stays below, or the upper half would be the whole set.
        let line = median.max(least + 1);
        let (lower, upper): (Vec<u32>, Vec<u32>) = set
            .iter()
            .partition(|v| self.positions[**v as usize][axis] < line);
        lower.iter().for_each(|v| self.is_lower[*v as usize] = true);
        let touches = |v: &u32| {
            let at = self.first[*v as usize]..self.first[*v as usize + 1];
            let mut elements = self.of_vertex[at].iter();
            elements.any(|k| self.elements[*k].iter().any(|w| self.is_lower[*w as usize]))
        };
        let (between, upper): (Vec<u32>, Vec<u32>) = upper.into_iter().partition(touches);
        lower
            .iter()
            .for_each(|v| self.is_lower[*v as usize] = false);
        Some([lower, upper, between])
    }
}

impl Dissection {
    /// The order of vertices at these positions of a lattice. Entries of a matrix connect vertices
    /// of one element. `None` when cancelled.
    pub(super) fn new(
        positions: &[[u32; 2]],
        elements: &[[u32; 4]],
        cancelled: &dyn Fn() -> bool,
    ) -> Option<Self> {
        let mut divider = Divider::new(positions, elements);
        let mut all = Self {
            fronts: Vec::new(),
            place: vec![usize::MAX; positions.len()],
            reached: Vec::new(),
            elements: Vec::new(),
            values: 0,
        };
        let count = u32::try_from(positions.len()).ok()?;
        let mut steps = vec![Step::Divide((0..count).collect())];
        let (mut done, mut ordered) = (Vec::new(), 0);
        while let Some(step) = steps.pop() {
            if cancelled() {
                return None;
            }
            match step {
                Step::Divide(set) => match divider.divide(&set) {
                    Some([lower, upper, between]) => {
                        // A stack: the halves are taken off, and done, before what is between them.
                        steps.push(Step::Eliminate(between, true));
                        steps.push(Step::Divide(upper));
                        steps.push(Step::Divide(lower));
                    }
                    None => steps.push(Step::Eliminate(set, false)),
                },
                Step::Eliminate(set, is_divided) => {
                    let children: [Option<usize>; 2] = if is_divided {
                        [done.pop(), done.pop()]
                    } else {
                        [None; 2]
                    };
                    for vertex in &set {
                        all.place[*vertex as usize] = ordered;
                        ordered += 1;
                    }
                    done.push(all.fronts.len());
                    all.fronts.push(Front {
                        own: ordered - set.len()..ordered,
                        reached: 0..0,
                        values: 0,
                        children,
                        elements: 0..0,
                    });
                }
            }
        }
        all.find_reached(elements, cancelled)?;
        Some(all)
    }

    /// Which later vertices the elimination of each front reaches, and which elements begin in it.
    /// `None` when cancelled.
    fn find_reached(&mut self, elements: &[[u32; 4]], cancelled: &dyn Fn() -> bool) -> Option<()> {
        let mut front_of = vec![0; self.place.len()];
        for (k, front) in self.fronts.iter().enumerate() {
            front_of[front.own.clone()].fill(k);
        }
        let mut of_front = vec![Vec::new(); self.fronts.len()];
        for (k, element) in elements.iter().enumerate() {
            let places = element.map(|v| self.place[v as usize]);
            of_front[front_of[places[0].min(places[1]).min(places[2]).min(places[3])]].push(k);
        }
        for (k, own_elements) in of_front.iter().enumerate() {
            if cancelled() {
                return None;
            }
            let end = self.fronts[k].own.end;
            let of_elements = own_elements.iter().flat_map(|k| elements[*k]);
            let mut reached: Vec<usize> = of_elements.map(|v| self.place[v as usize]).collect();
            for child in self.fronts[k].children.into_iter().flatten() {
                reached.extend(&self.reached[self.fronts[child].reached.clone()]);
            }
            reached.retain(|place| *place >= end);
            reached.sort_unstable();
            reached.dedup();
            let front = &mut self.fronts[k];
            front.reached = self.reached.len()..self.reached.len() + reached.len();
            front.elements = self.elements.len()..self.elements.len() + own_elements.len();
            front.values = self.values;
            self.values += front.own.len() * front.len();
            self.reached.extend(reached);
            self.elements.extend(own_elements);
        }
        Some(())
    }

    /// Multiplications of a factorisation, and entries that it needs for a while.
    pub(super) fn cost(&self) -> (u64, u64) {
        let mut all = (0_u64, 0_u64);
        let mut waiting = 0;
        for front in &self.fronts {
            let (own, len) = (front.own.len() as u64, front.len() as u64);
            all.0 += own * len * len / 2;
            all.1 = all.1.max(waiting + len * len);
            let of = |k: usize| (self.fronts[k].reached.len() as u64).pow(2);
            waiting += (len - own).pow(2);
            waiting -= front.children.into_iter().flatten().map(of).sum::<u64>();
        }
        all
    }

    /// Memory, bytes.
    pub(super) fn bytes(&self) -> u64 {
        (size_of_val(&*self.fronts)
            + size_of_val(&*self.place)
            + size_of_val(&*self.reached)
            + size_of_val(&*self.elements)) as u64
    }
}
