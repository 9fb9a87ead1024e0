//! Image resources of Photoshop (segment APP13 of JPEG, tag 34377 of TIFF).

use super::{Dropped, DroppedKind};
use crate::codec::StepCounter;

/// What of the resources is dropped: IPTC-IIM, and paths. The others are a thumbnail, settings of
/// the program, and copies of metadata.
pub(in crate::codec) fn resources(mut data: &[u8], dropped: &mut Dropped, work: &StepCounter<'_>) {
    while let Some((id, content, rest)) = resource(data) {
        if work.step(1).is_err() {
            return;
        }
        dropped.add_if(id == 0x0404 && !content.is_empty(), DroppedKind::Iptc);
        dropped.add_if((2000..2998).contains(&id), DroppedKind::Paths);
        data = rest;
    }
}

/// The first resource: its number, its content, and what follows.
fn resource(data: &[u8]) -> Option<(u16, &[u8], &[u8])> {
    let data = data.strip_prefix(b"8BIM")?;
    let (id, data) = data.split_first_chunk()?;
    // A name, as long as its first byte says, padded.
    let name = 1 + usize::from(*data.first()?);
    let (length, data) = data.get(name.next_multiple_of(2)..)?.split_first_chunk()?;
    let length = u32::from_be_bytes(*length) as usize;
    let content = data.get(..length)?;
    Some((
        u16::from_be_bytes(*id),
        content,
        data.get(length.next_multiple_of(2)..).unwrap_or_default(),
    ))
}
