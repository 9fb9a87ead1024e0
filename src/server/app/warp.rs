//! `POST /warp`: draws an uploaded image by a warp object.

use super::App;
use super::draw::Drawn;
use super::drawable::DrawnContent;
use super::resolved::Resolved;
use super::upload::{Upload, prepare};
use crate::client::Client;
use crate::pool::QueueKey;
use crate::problem::Problem;
use crate::wire::formats::Formats;

/// Draws an image from a file and a warp object with `q`. The other results: what a session of the
/// upload is made from. Errors: A wrong file or object, or too little capacity.
pub(crate) async fn once(
    app: &App,
    client: Client,
    upload: Upload,
    formats: Formats,
) -> Result<(Drawn, Resolved, DrawnContent), Problem> {
    let ticket = app.admission.upload(QueueKey::client(client)).await?;
    let (resolved, job) = prepare(app, client, &ticket, upload, Some(formats)).await?;
    let content = job.content.clone();
    Ok((app.drawing.draw(ticket, job).await?, resolved, content))
}
