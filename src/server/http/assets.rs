//! `GET /` and `GET /page/{file}`: the embedded drag page. Its content security policy permits
//! nothing from other sites; those of `--frame-ancestors` may show the page in a frame.

use std::sync::LazyLock;

use axum::Router;
use axum::extract::Path;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;
use bytes::Bytes;
use data_encoding::HEXLOWER;
use sha2::{Digest as _, Sha256};

use crate::app::App;
use crate::auth::cors::Origins;
use crate::config::Config;
use crate::http::headers::sends_tag;
use crate::http::response::Refusal;
use crate::problem::words::quote;
use crate::problem::{Code, Problem};
use crate::store::StoreUrl;

const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' \
    blob: data:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// The directive that says which sites may show a page in a frame.
const FRAMES: &str = "frame-ancestors";
pub(crate) const HTML: &str = "text/html; charset=utf-8";
pub(crate) const CSS: &str = "text/css; charset=utf-8";
pub(crate) const JS: &str = "text/javascript; charset=utf-8";
const INDEX: &str = include_str!("../../web/index.html");
/// The placeholder in the index for the server's limits, which the page checks before an upload.
const LIMITS: &str = "{limits}";
/// And for the origins whose pages may show the page in a frame.
const ANCESTORS: &str = "{ancestors}";

macro_rules! assets {
    ($($name:literal $media:expr,)+) => {
        [$(($name, $media, include_bytes!(concat!("../../web/", $name)).as_slice())),+]
    };
}

static ASSETS: LazyLock<Vec<(&str, Asset)>> = LazyLock::new(|| {
    assets![
        "page.css" CSS, "stage.css" CSS,
        "access.js" JS, "actions.js" JS, "align.js" JS, "animationexport.js" JS,
            "annotations.js" JS, "api.js" JS, "blend.js" JS, "canvas.js" JS, "choices.js" JS,
            "depth.js" JS,
        "dom.js" JS, "edits.js" JS, "export.js" JS, "files.js" JS, "fit.js" JS, "frame.js" JS,
            "grid.js" JS,
        "handles.js" JS, "handlesfile.js" JS, "json.js" JS, "keep.js" JS, "keys.js" JS,
            "landmarks.js" JS,
            "live.js" JS, "loupe.js" JS, "main.js" JS, "marks.js" JS,
        "mesh.js" JS, "methods.js" JS, "notices.js" JS, "numbers.js" JS, "open.js" JS,
        "outline.js" JS, "outside.js" JS, "paint.js" JS, "panel.js" JS, "pictures.js" JS,
            "plan.js" JS, "player.js" JS, "pointer.js" JS, "project.js" JS, "region.js" JS,
        "regionpaint.js" JS, "regiontool.js" JS, "samples.js" JS, "service.js" JS, "share.js" JS,
            "slider.js" JS,
        "state.js" JS, "strength.js" JS, "sync.js" JS, "table.js" JS, "twist.js" JS, "view.js" JS,
            "words.js" JS,
        "icon.svg" "image/svg+xml",
        "cat.jpg" "image/jpeg", "portrait.jpg" "image/jpeg", "rocket.jpg" "image/jpeg",
            "horse.webp" "image/webp",
        "cat-before.webp" "image/webp", "cat-after.webp" "image/webp",
            "horse-before.webp" "image/webp", "horse-after.webp" "image/webp",
        "portrait-before.webp" "image/webp", "portrait-after.webp" "image/webp",
        "rocket-before.webp" "image/webp", "rocket-after.webp" "image/webp",
    ]
    .into_iter()
    .map(|(name, media, bytes)| (name, Asset::new(media, Bytes::from_static(bytes))))
    .collect()
});

/// A file of a page.
#[derive(Clone)]
pub(crate) struct Asset {
    media: HeaderValue,
    pub(crate) bytes: Bytes,
    tag: HeaderValue,
    policy: HeaderValue,
}

impl Asset {
    pub(crate) fn new(media: &'static str, bytes: Bytes) -> Self {
        let tag = format!("\"{}\"", HEXLOWER.encode(&Sha256::digest(&bytes)[..16]));
        Self {
            media: HeaderValue::from_static(media),
            bytes,
            tag: HeaderValue::try_from(tag).expect("hex is visible ASCII"),
            policy: HeaderValue::from_static(POLICY),
        }
    }

    /// The same for a page that those may show in a frame.
    fn framed_by(self, ancestors: &Origins) -> Self {
        let framed = format!("{FRAMES} {}", ancestors.frame_ancestors());
        let policy = POLICY.replacen(&format!("{FRAMES} 'none'"), &framed, 1);
        Self {
            policy: HeaderValue::try_from(policy).expect("origins are visible ASCII"),
            ..self
        }
    }

    /// The file, or 304 if the client has it.
    pub(crate) fn response(&self, request: &HeaderMap) -> Response {
        let headers = [
            (ETAG, self.tag.clone()),
            (CACHE_CONTROL, HeaderValue::from_static("no-cache")),
            (CONTENT_SECURITY_POLICY, self.policy.clone()),
        ];
        if self.tag.to_str().is_ok_and(|tag| sends_tag(request, tag)) {
            return (StatusCode::NOT_MODIFIED, headers).into_response();
        }
        (
            headers,
            [(CONTENT_TYPE, self.media.clone())],
            self.bytes.clone(),
        )
            .into_response()
    }
}

/// The page's routes, which are not part of the contract.
pub(crate) fn routes(app: &App) -> Router<App> {
    let ancestors = &app.config().auth.frame_ancestors;
    let index = Asset::new(
        HTML,
        Bytes::from(INDEX.replacen(LIMITS, &limits(app.config()), 1).replacen(
            ANCESTORS,
            &ancestors.frame_ancestors(),
            1,
        )),
    )
    .framed_by(ancestors);
    Router::new()
        .route(
            "/",
            get(async move |headers: HeaderMap| index.response(&headers)),
        )
        .route("/page/{file}", get(file))
}

async fn file(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Refusal> {
    Ok(find(&ASSETS, &name, &headers)?)
}

/// Serves one of a page's files.
pub(crate) fn find(
    files: &[(&str, Asset)],
    name: &str,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    match files.iter().find(|(known, _)| *known == name) {
        Some((_, asset)) => Ok(asset.response(headers)),
        None => Err(Problem::new(
            Code::NotFound,
            format!("there is no file {} here; see /docs", quote(name)),
        )),
    }
}

/// `name=number ...`: bytes, pixels, pixels, seconds, and 1 if pictures are kept in memory only.
fn limits(config: &Config) -> String {
    let image = config.limits().image;
    format!(
        "body={} pixels={} side={} idle={} memory={}",
        config.max_body_bytes,
        image.max_pixels,
        image.max_side,
        config.store.bounds().idle.as_secs(),
        u8::from(config.store.url == StoreUrl::Memory)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(name: &str) -> &'static str {
        let (_, asset) = ASSETS.iter().find(|(known, _)| *known == name).expect(name);
        std::str::from_utf8(&asset.bytes).expect("text is UTF-8")
    }

    #[test]
    fn whatever_the_page_asks_for_is_there() {
        let named = |text: &'static str, before: &'static str| {
            text.split(before).skip(1).map(|rest| {
                rest.split(['"', '#'])
                    .next()
                    .expect("split gives one piece at least")
            })
        };
        let scripts = ASSETS.iter().filter(|(name, _)| name.ends_with(".js"));
        let imported: Vec<&str> = scripts
            .flat_map(|(name, _)| named(text(name), "from \"./"))
            .collect();
        let linked: Vec<&str> = named(INDEX, "=\"page/")
            .chain(named(text("samples.js"), "\"page/"))
            .collect();
        assert!(
            imported.len() > 30 && linked.len() > 10,
            "{} {}",
            imported.len(),
            linked.len()
        );
        for name in imported.iter().chain(&linked) {
            assert!(ASSETS.iter().any(|(known, _)| known == name), "{name}");
        }
        // And every file that is there is asked for.
        for (name, _) in ASSETS.iter() {
            assert!(imported.contains(name) || linked.contains(name), "{name}");
        }
    }

    #[test]
    fn nothing_comes_from_elsewhere_and_nothing_is_inline() {
        assert_eq!(INDEX.matches(LIMITS).count(), 1);
        assert_eq!(INDEX.matches(ANCESTORS).count(), 1);
        for (name, asset) in ASSETS.iter().filter(|(_, asset)| {
            asset
                .media
                .to_str()
                .is_ok_and(|media| media.starts_with("text"))
        }) {
            let text = std::str::from_utf8(&asset.bytes)
                .expect("text is UTF-8")
                .replace("http://www.w3.org/2000/svg", "");
            assert!(!text.contains("://"), "{name}");
        }
        assert!(
            !INDEX.contains("://")
                && !INDEX.contains(" style=")
                && !INDEX.contains(" onclick=")
                && !INDEX.contains("<style")
        );
        assert!(
            INDEX
                .split("<script")
                .skip(1)
                .all(|script| script.contains("src=\"page/"))
        );
    }
}
