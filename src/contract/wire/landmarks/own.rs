//! Our own JSON, which `POST /landmarks` writes too: `{"p", "q"?, "names"?, "units"?}`, in the
//! coordinates of the contract.

use mlswarp::deform::Handle;
use mlswarp::warp::Units;

use super::bad::{Bad, BadJson};
use super::collect::{Collector, CoordinateConvention, Landmark, Located};
use super::json::ObjectMembers;
use super::{Format, FormatReader, offset};
use crate::wire::enum_name::enum_name;
use crate::wire::handles::handle;
use crate::wire::json::{Kind, Node, optional};

pub(super) const FORMAT: Format = Format {
    name: "json",
    title: "JSON",
    items: "objects",
    form: FormatReader::Json(is_own, read),
};
/// `format` and `unmatched` are in what the server has written; they say nothing about the handles.
const FIELDS: [&str; 6] = ["p", "q", "names", "units", "format", "unmatched"];
const HANDLES: &str = "an array of handles";

fn is_own(fields: &ObjectMembers<'_>) -> bool {
    !fields.is_list && (fields.has("p") || fields.has("q"))
}

fn read(text: &str, root: &Node<'_, '_>, out: &mut Collector) -> Result<usize, BadJson> {
    let [p, q, names, units, _, _] = root.fields(&FIELDS)?;
    let p = p.ok_or_else(|| root.missing("p", HANDLES))?;
    if optional(units, enum_name::<Units>)? == Some(Units::Normalized) {
        out.set_frame(CoordinateConvention::Normalized);
    }
    let (mut rest, mut at) = (Vec::new(), Vec::new());
    p.items::<BadJson>(HANDLES, |_, item| {
        out.count(offset(text, &item), positions(&item))?;
        rest.push(handle(&item)?);
        at.push(offset(text, &item));
        Ok(())
    })?;
    let mut posed = q
        .map(|q| read_posed(text, &q, &rest))
        .transpose()?
        .map(Vec::into_iter);
    let mut names = names
        .map(|names| read_names(text, &names, rest.len()))
        .transpose()?
        .map(Vec::into_iter);
    for (p, at) in rest.into_iter().zip(at) {
        let name = names.as_mut().and_then(Iterator::next);
        let name = name.as_ref().map(|(at, name)| Located {
            at: *at,
            text: name,
        });
        out.push(Landmark {
            at,
            p,
            q: posed.as_mut().and_then(Iterator::next),
            name,
        })?;
    }
    Ok(offset(text, &p))
}

/// The number of positions of a handle: an upper limit if it is not well-formed.
fn positions(item: &Node<'_, '_>) -> usize {
    let brackets = item.text.bytes().filter(|byte| *byte == b'[').count();
    brackets.saturating_sub(1).max(1)
}

/// Reads `q`, whose handles have the shape of those in `p`.
fn read_posed(text: &str, q: &Node<'_, '_>, rest: &[Handle]) -> Result<Vec<Handle>, BadJson> {
    let mut posed = Vec::with_capacity(rest.len());
    q.items::<BadJson>(HANDLES, |index, item| {
        let bad = |detail: String| Bad::new(offset(text, &item), detail);
        let Some(p) = rest.get(index) else {
            return Err(bad(format!(
                "expected {} handles in `q`, as in `p`; found more",
                rest.len()
            ))
            .into());
        };
        let (expected, found) = (p.places().len(), positions(&item));
        let is_missing = *p == Handle::Missing || item.kind() == Kind::Null;
        if expected != found && !is_missing {
            return Err(bad(format!(
                "expected a handle of {expected} positions, as in `p`; found {found}"
            ))
            .into());
        }
        posed.push(handle(&item)?);
        Ok(())
    })?;
    if posed.len() < rest.len() {
        return Err(q
            .unexpected(
                &format!("{} handles in `q`, as in `p`", rest.len()),
                posed.len(),
            )
            .into());
    }
    Ok(posed)
}

/// Reads names with their places in the file, one for each handle.
pub(super) fn read_names(
    text: &str,
    names: &Node<'_, '_>,
    handles: usize,
) -> Result<Vec<(usize, String)>, BadJson> {
    let mut read = Vec::with_capacity(handles);
    names.items::<BadJson>("an array of names", |index, item| {
        if index == handles {
            return Err(Bad::new(
                offset(text, &item),
                format!("expected {handles} names, one for each handle; found more"),
            )
            .into());
        }
        read.push((offset(text, &item), item.string("a name")?));
        Ok(())
    })?;
    if read.len() < handles {
        return Err(names
            .unexpected(&format!("{handles} names, one for each handle"), read.len())
            .into());
    }
    Ok(read)
}
