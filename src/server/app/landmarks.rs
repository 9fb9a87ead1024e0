//! `POST /landmarks`, and the landmark files of uploads: they are read on the pool, in memory that
//! counts for the client.

use std::sync::Arc;

use bytes::Bytes;

use super::App;
use super::json_text::cancellable_json;
use super::reading::Held;
use crate::client::Client;
use crate::limits::memory::MemoryClass;
use crate::pool::{Cancel, QueueKey};
use crate::problem::Problem;
use crate::wire::Reserved;
use crate::wire::landmarks::{BesideFiles, Choice, LandmarkFiles, Landmarks, Target};

/// Longest text of a number with its punctuation, bytes, and that of the response without numbers
/// and names.
const NUMBER_TEXT: usize = 30;
const EMPTY_TEXT: usize = 256;

/// Reads landmark files. `warp`: the warp object of the request, which may choose what is read
/// of them. Errors: A file that cannot be read, or too little capacity.
pub(crate) async fn read(
    app: &App,
    client: Client,
    mut files: LandmarkFiles,
    warp: Bytes,
) -> Result<Held<Landmarks>, Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let columns = app.plans.limits.columns;
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let read = move |cancel: &Cancel| {
        files.choice.add(Choice::of_warp(&warp)?)?;
        Reserved::of_files(&files, columns, &|| cancel.is_cancelled(), reserve)
    };
    ticket.run(read).await?
}

/// The JSON of a request with the handles of its landmark files as fields.
/// Errors: As [`read`]; a field that the files give, too.
pub(crate) async fn fields(
    app: &App,
    client: Client,
    mut files: LandmarkFiles,
    json: Bytes,
    target: Target,
) -> Result<Bytes, Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let (admission, quota, columns) = (
        Arc::clone(&app.admission),
        app.admission.request_quota(client),
        app.plans.limits.columns,
    );
    let reserve = app.admission.reserving(MemoryClass::Upload, client);
    let write = move |cancel: &Cancel| {
        let is_cancelled = || cancel.is_cancelled();
        let beside = BesideFiles::new(&json, &is_cancelled)?;
        files.choice.add(beside.choice()?)?;
        let landmarks = Reserved::of_files_for(&files, target, columns, &is_cancelled, reserve)?;
        // The handles alone, and among the other fields.
        let length = json.len()
            + EMPTY_TEXT
            + 4 * NUMBER_TEXT * landmarks.numbers()
            + landmarks.names_length();
        let reservation = admission.reserve_for(MemoryClass::Upload, &quota, length as u64)?;
        let (landmarks, _held) = landmarks.into_parts();
        let body = landmarks.into_fields(&beside, target)?;
        Ok::<_, Problem>(reservation.attach_exact(body))
    };
    ticket.run(write).await?
}

/// Reads landmark files; returns the JSON of the response.
/// Errors: As [`read`].
pub(crate) async fn convert(
    app: &App,
    client: Client,
    files: LandmarkFiles,
) -> Result<Bytes, Problem> {
    let landmarks = read(app, client, files, Bytes::from_static(b"{}")).await?;
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let (admission, quota) = (
        Arc::clone(&app.admission),
        app.admission.response_quota(client),
    );
    let write = ticket.run(move |cancel| {
        let length = EMPTY_TEXT + 2 * NUMBER_TEXT * landmarks.numbers() + landmarks.names_length();
        let landmarks = landmarks.try_map(|landmarks| landmarks.scale(None))?;
        let reservation = admission.reserve_for(MemoryClass::Frame, &quota, length as u64)?;
        let body = cancellable_json(cancel, &*landmarks, length)?;
        Ok::<_, Problem>(reservation.attach_exact(body))
    });
    write.await?
}
