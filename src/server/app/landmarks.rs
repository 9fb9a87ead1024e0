//! `POST /landmarks`, and the landmark files of uploads: they are read on the pool, in memory that counts for the client.

use bytes::Bytes;

use super::App;
use super::json_text::json_unless;
use super::reading::Held;
use crate::client::Client;
use crate::limits::memory::Purpose;
use crate::pool::{Cancel, QueueKey, WorkClass};
use crate::problem::Problem;
use crate::wire::Reserved;
use crate::wire::landmarks::{LandmarkFiles, Landmarks};

/// Longest text of a number with its punctuation, bytes, and that of the response without numbers and names.
const NUMBER_TEXT: usize = 30;
const EMPTY_TEXT: usize = 256;

impl App {
    /// Reads landmark files.
    /// Errors: A file that cannot be read, or too little capacity.
    pub(crate) async fn read_landmarks(&self, client: Client, files: LandmarkFiles) -> Result<Held<Landmarks>, Problem> {
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let columns = self.0.config.limits().columns;
        let reserve = self.reserving(Purpose::Upload, client);
        let read = move |cancel: &Cancel| Reserved::of_files(&files, columns, &|| cancel.is_cancelled(), reserve);
        self.0.pool.run(&ticket, read).await?
    }

    /// Reads landmark files; returns the JSON of the response.
    /// Errors: As [`App::read_landmarks`].
    pub async fn convert_landmarks(&self, client: Client, files: LandmarkFiles) -> Result<Bytes, Problem> {
        let landmarks = self.read_landmarks(client, files).await?;
        let ticket = self.0.pool.admit(WorkClass::Upload, QueueKey::client(client)).await?;
        let (app, quota) = (self.clone(), self.response_quota(client));
        let write = self.0.pool.run(&ticket, move |cancel| {
            let landmarks = landmarks.try_map(|landmarks| landmarks.scale(None))?;
            let length = EMPTY_TEXT + 2 * NUMBER_TEXT * landmarks.numbers() + landmarks.names_length();
            let mut reservation = app.reserve_for(Purpose::Frame, &quota, length as u64)?;
            let mut body = json_unless(cancel, &*landmarks, length)?;
            body.shrink_to_fit();
            reservation.shrink_to(body.len() as u64);
            Ok::<_, Problem>(reservation.attach(body))
        });
        write.await?
    }
}
