//! `POST /blend`: several images in one.

use axum::extract::Request;
use axum::response::Response;
use futures_util::stream::unfold;

use crate::app::batch::BatchForm;
use crate::app::blend::{self, BlendAnswer};
use crate::http::accept::{choose, formats};
use crate::http::middleware::authentication::Caller;
use crate::http::response::{Refusal, blend_headers, picture, streamed, takes_trailers};
use crate::http::upload;
use crate::wire::formats::Formats;

/// What the response may be: images first, then files of several.
const OFFERS: [&str; 7] = [
    "image/png",
    "image/jpeg",
    "image/webp",
    "image/tiff",
    BatchForm::Zip.media_type(),
    BatchForm::Apng.media_type(),
    BatchForm::Gif.media_type(),
];

pub(crate) async fn once(caller: Caller, request: Request) -> Result<Response, Refusal> {
    let chosen = choose(request.headers(), OFFERS)?;
    let form = chosen
        .checked_sub(OFFERS.len() - BatchForm::ALL.len())
        .map(|index| BatchForm::ALL[index]);
    let takes_archive = choose(request.headers(), [BatchForm::Zip.media_type()]).is_ok();
    let formats = formats(request.headers()).unwrap_or(Formats::ANY);
    let trailers = takes_trailers(request.headers());
    let upload = upload::read_blend(&caller, request).await?;
    let Caller { app, client } = caller;
    let answer = blend::once(&app, client, upload, formats, (form, takes_archive)).await?;
    Ok(match answer {
        BlendAnswer::Picture(drawn) => picture(*drawn, trailers),
        BlendAnswer::Package(form, first, rest) => {
            let headers = blend_headers(form, rest.frames());
            let rest = unfold(rest, async |mut rest| Some((rest.next().await?, rest)));
            streamed(headers, first, rest)
        }
    })
}
