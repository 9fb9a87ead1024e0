//! `POST /landmarks`, and the landmark files of uploads: they are read on the pool, in memory that counts for the client.

use bytes::Bytes;
use mlswarp::pixmap::Extent;

use super::App;
use super::json_text::json_unless;
use crate::client::Client;
use crate::limits::memory::{Purpose, Reservation};
use crate::pool::{QueueKey, WorkClass};
use crate::problem::Problem;
use crate::wire::WarpObject;
use crate::wire::landmarks::{LandmarkFiles, Landmarks};

/// Longest text of a number with its punctuation, bytes, and that of the response without numbers and names.
const NUMBER_TEXT: usize = 30;
const EMPTY_TEXT: usize = 256;

/// Landmarks that were read, and their memory.
#[derive(Debug)]
pub struct HeldLandmarks {
    landmarks: Landmarks,
    held: Reservation,
}

impl HeldLandmarks {
    /// Whether a landmark was left out because the other side does not have its name.
    pub(crate) fn has_unmatched(&self) -> bool {
        self.landmarks.has_unmatched()
    }

    /// The longest text of the handles of one side, bytes.
    pub(crate) fn text_length(&self) -> usize {
        NUMBER_TEXT * self.landmarks.numbers()
    }

    /// Errors: As [`Landmarks::require_q`].
    pub(crate) fn require_q(&self) -> Result<(), Problem> {
        self.landmarks.require_q()
    }

    pub(crate) fn place_in(self, object: &mut WarpObject, image: Extent) -> Result<(), Problem> {
        self.landmarks.place_in(object, image)
    }
}

impl App {
    /// Reads landmark files.
    /// Errors: A file that cannot be read, or too little capacity.
    pub async fn read_landmarks(&self, client: Client, files: LandmarkFiles) -> Result<HeldLandmarks, Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let columns = self.0.config.limits().columns;
        let held = self.reserve_for(Purpose::Upload, &self.request_quota(client), files.reading_bytes(columns))?;
        let landmarks = self.0.pool.run(&ticket, move |cancel| files.read(columns, &|| cancel.is_cancelled())).await??;
        Ok(HeldLandmarks { landmarks, held })
    }

    /// Reads landmark files; returns the JSON of the response.
    /// Errors: As [`App::read_landmarks`].
    pub async fn convert_landmarks(&self, client: Client, files: LandmarkFiles) -> Result<Bytes, Problem> {
        let HeldLandmarks { landmarks, held } = self.read_landmarks(client, files).await?;
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let (app, quota) = (self.clone(), self.response_quota(client));
        let write = self.0.pool.run(&ticket, move |cancel| {
            let _held = held;
            let landmarks = landmarks.scale(None)?;
            let length = EMPTY_TEXT + 2 * NUMBER_TEXT * landmarks.numbers() + landmarks.names_length();
            let mut reservation = app.reserve_for(Purpose::Frame, &quota, length as u64)?;
            let mut body = json_unless(cancel, &landmarks, length)?;
            body.shrink_to_fit();
            reservation.shrink_to(body.len() as u64);
            Ok::<_, Problem>(reservation.attach(body))
        });
        write.await?
    }
}
