//! The handles of landmark files as fields of the JSON beside them: `/fit`, `/points`, `/map`,
//! `/report` and the requests of sessions read them as if the client had written them there.

use mlswarp::deform::Handle;
use mlswarp::geometry::Point;
use mlswarp::pixmap::Extent;
use mlswarp::warp::Units;
use serde::Serialize;

use super::Work;
use super::bad::Bad;
use super::files::{Choice, LandmarkFiles, Landmarks, SIDES, each, mismatched};
use crate::problem::{Code, Problem};
use crate::wire::json::{self, At, Node, optional};
use crate::wire::merge::spliced_into;
use crate::wire::rest::require_no_handles;
use crate::wire::{AsJson, size};

/// The handles that landmark files stand for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Both sides of a request that has the size of its image as the field `extent`.
    Request,
    /// The handles at rest of a session with an image of this size, and its pose if the files have
    /// one.
    Session(Extent),
    /// A pose of a session with an image of this size, in its units.
    Pose(Extent, Units),
}

/// The JSON beside landmark files. It may be long: it is checked once, and its scans are counted
/// and end when they are cancelled.
#[derive(Debug)]
pub struct BesideFiles<'j, 'c> {
    object: &'j str,
    pub(super) work: Work<'c>,
}

impl<'j, 'c> BesideFiles<'j, 'c> {
    /// `cancelled` is true when the result is no longer wanted.
    /// Errors: A text that is not a JSON object; cancelled.
    pub fn new(json: &'j [u8], cancelled: &'c dyn Fn() -> bool) -> Result<Self, Problem> {
        let work = Work::new(cancelled);
        let root = json::long_root(json, &work).map(|root| root.text);
        let object = work.believe(root)?;
        Ok(Self { object, work })
    }

    fn root(&self) -> Node<'j, '_> {
        Node {
            work: Some(&self.work),
            ..Node::new(self.object, At::Root)
        }
    }

    /// What it says is read from the files.
    /// Errors: A field with another value; cancelled.
    pub fn choice(&self) -> Result<Choice, Problem> {
        let root = self.root();
        let fields = root.find(&["match", "item"]);
        self.work.believe(fields.and_then(Choice::of_fields))
    }
}

/// What is written. Names say nothing more, and one of each side says that there are unmatched
/// landmarks.
#[derive(Serialize)]
struct LandmarkMembers<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    p: Option<AsJson<&'a [Handle]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    q: Option<AsJson<&'a [Handle]>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    units: Option<AsJson<Units>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    unmatched: Option<UnmatchedMembers<'a>>,
}

#[derive(Serialize)]
struct UnmatchedMembers<'a> {
    p: Option<&'a [String]>,
    q: Option<&'a [String]>,
}

impl LandmarkFiles {
    /// Reads the files. `cancelled` is true when the result is no longer wanted.
    /// Errors: As [`Self::read`]; other files than the target has.
    pub fn read_for(
        &self,
        target: Target,
        max_columns: usize,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Landmarks, Problem> {
        match target {
            Target::Request | Target::Session(_) => self.read(max_columns, cancelled),
            Target::Pose(..) => self.read_pose(max_columns, &Work::new(cancelled)),
        }
    }

    /// Reads the posed positions of a session, which has those at rest.
    fn read_pose(&self, max_columns: usize, work: &Work<'_>) -> Result<Landmarks, Problem> {
        let (None, None, Some(q)) = (&self.both, &self.p, &self.q) else {
            return Err(mismatched(
                "the session has its handles at rest: send the file with the posed positions \
                    alone, as `landmarks_q`",
            ));
        };
        if self.choice.matching.is_some() {
            let detail = "`match` belongs to two files; the handles of a session have no names, \
                and `landmarks_q` has their order";
            return Err(Problem::new(Code::BadValue, detail));
        }
        let file = self.file(SIDES[1], q, max_columns, work)?;
        if file.q.is_some() {
            let detail = "expected posed positions alone, because the session has those at rest; \
                found both sides";
            return Err(
                Bad::new(file.at.first().copied().unwrap_or_default(), detail).problem(SIDES[1], q),
            );
        }
        Ok(Landmarks::of_file(file, [self.extent_q, None]))
    }
}

impl Landmarks {
    /// The text of a JSON object with the handles as fields, in place of those that chose what was
    /// read. Errors: `bad_value` at a field that says the same; as [`Self::scale`]; without `q`
    /// where it is needed; cancelled.
    pub fn into_fields(
        self,
        beside: &BesideFiles<'_, '_>,
        target: Target,
    ) -> Result<Vec<u8>, Problem> {
        let root = beside.root();
        beside.work.believe(self.spliced(&root, target))
    }

    fn spliced(self, root: &Node<'_, '_>, target: Target) -> Result<Vec<u8>, Problem> {
        let [p, q, units, extent] = root.find(&["p", "q", "units", "extent"])?;
        let has = |name: &str| match name {
            "q" => q.is_some(),
            "p" => p.is_some(),
            _ => units.is_some(),
        };
        match target {
            Target::Request | Target::Session(_) => require_no_handles(has)?,
            // The session has the others.
            Target::Pose(..) => require_no_handles(|name| name == "q" && has(name))?,
        }
        let placed = match target {
            Target::Request => {
                self.require_q()?;
                self.scale(optional(extent, size)?)?
            }
            Target::Session(extent) | Target::Pose(extent, _) => self.scale(Some(extent))?,
        };
        let units = placed.units;
        let Self {
            mut p,
            q,
            unmatched,
            ..
        } = placed.landmarks;
        if let Target::Pose(extent, Units::Normalized) = target {
            each(&mut p, |at| {
                Point::new(
                    at.x / f64::from(extent.width()),
                    at.y / f64::from(extent.height()),
                )
            });
        }
        let fields = match target {
            Target::Pose(..) => LandmarkMembers {
                p: None,
                q: Some(AsJson(&p)),
                units: None,
                unmatched: None,
            },
            Target::Request | Target::Session(_) => LandmarkMembers {
                p: Some(AsJson(&p)),
                q: q.as_deref().map(AsJson),
                units: Some(AsJson(units)),
                unmatched: (!unmatched.is_empty()).then(|| UnmatchedMembers {
                    p: unmatched.p.get(..1),
                    q: unmatched.q.get(..1),
                }),
            },
        };
        let fields = serde_json::to_vec(&fields)
            .map_err(|e| Problem::new(Code::Internal, format!("handles as JSON: {e}")))?;
        let others = ["match", "item", "names", "format", "unmatched"];
        Ok(spliced_into(root, &others, &fields))
    }
}
