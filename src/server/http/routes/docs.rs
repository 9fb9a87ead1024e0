//! `GET /docs`: the guide (`src/web/docs`), and `GET /docs/reference`: Scalar with `/openapi.json`.
//! Scalar's crate embeds its script (5 MB), which is compressed at the first request. `notes.md`
//! beside the guide compares it with others.

use std::io::Write as _;
use std::sync::LazyLock;

use axum::Router;
use axum::extract::Path;
use axum::http::header::{CONTENT_ENCODING, CONTENT_SECURITY_POLICY};
use axum::http::{HeaderMap, HeaderValue};
use axum::response::Response;
use axum::routing::get;
use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;

use crate::app::App;
use crate::http::assets::{Asset, CSS, HTML, JS, find};
use crate::http::response::Refusal;
use crate::problem::{Code, Problem};

/// Scalar writes its styles into the page. The page shows only our document, and scripts come from
/// this server only.
const REFERENCE_POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' \
        blob: data:; font-src 'self' data:; connect-src \
     'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);
const JPEG: &str = "image/jpeg";
const TEXT: &str = "text/plain; charset=utf-8";

macro_rules! assets {
    ($($name:literal $media:expr,)+) => {
        [$(($name, Asset::new($media,
            Bytes::from_static(include_bytes!(concat!("../../../web/docs/", $name)))))),+]
    };
}

static INDEX: LazyLock<Asset> = LazyLock::new(|| {
    Asset::new(
        HTML,
        Bytes::from_static(include_bytes!("../../../web/docs/index.html")),
    )
});
static REFERENCE: LazyLock<Asset> = LazyLock::new(|| {
    Asset::new(
        HTML,
        Bytes::from_static(include_bytes!("../../../web/docs/reference.html")),
    )
});
static FILES: LazyLock<[(&str, Asset); 4]> = LazyLock::new(
    || assets!["docs.css" CSS, "docs.js" JS, "reference.css" CSS, "reference.js" JS,],
);
static EXAMPLES: LazyLock<[(&str, Asset); 39]> = LazyLock::new(|| {
    assets![
        "examples/here.js" JS,
        "examples/batch.sh" TEXT, "examples/batch.py" TEXT, "examples/batch.js" JS,
        "examples/caricature.py" TEXT, "examples/caricature.js" JS,
        "examples/errors.sh" TEXT, "examples/errors.py" TEXT, "examples/errors.js" JS,
        "examples/landmarks.sh" TEXT, "examples/landmarks.py" TEXT, "examples/landmarks.js" JS,
        "examples/layers.sh" TEXT, "examples/layers.py" TEXT, "examples/layers.js" JS,
        "examples/lines.sh" TEXT, "examples/lines.py" TEXT, "examples/lines.js" JS,
        "examples/methods.sh" TEXT, "examples/methods.py" TEXT, "examples/methods.js" JS,
        "examples/output.sh" TEXT, "examples/output.py" TEXT, "examples/output.js" JS,
        "examples/points.sh" TEXT, "examples/points.py" TEXT, "examples/points.js" JS,
        "examples/session.sh" TEXT, "examples/session.py" TEXT, "examples/session.js" JS,
        "examples/compact.py" TEXT, "examples/compact.js" JS,
        "examples/drag.py" TEXT, "examples/drag.js" JS,
        "examples/plan.py" TEXT, "examples/plan.js" JS,
        "examples/warp.sh" TEXT, "examples/warp.py" TEXT, "examples/warp.js" JS,
    ]
});
/// The figures that `tests/it/gallery.rs` draws.
static GALLERY: LazyLock<[(&str, Asset); 9]> = LazyLock::new(|| {
    assets![
        "gallery/figure-1.jpg" JPEG,
        "gallery/figure-2.jpg" JPEG,
        "gallery/figure-4.jpg" JPEG,
        "gallery/figure-5.jpg" JPEG,
        "gallery/figure-6.jpg" JPEG,
        "gallery/figure-7.jpg" JPEG,
        "gallery/figure-8.jpg" JPEG,
        "gallery/hoof.jpg" JPEG,
        "gallery/depth.jpg" JPEG,
    ]
});
/// Scalar's script, compressed.
static SCALAR: LazyLock<Option<Asset>> = LazyLock::new(|| {
    let script = scalar_api_reference::get_asset("scalar.js")?;
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(&script).ok()?;
    Some(Asset::new(JS, Bytes::from(gzip.finish().ok()?)))
});

/// The guide.
pub(crate) async fn page(headers: HeaderMap) -> Response {
    INDEX.response(&headers)
}

/// The reference, and the files of both pages, which are not part of the contract.
pub(crate) fn files() -> Router<App> {
    Router::new()
        .route("/docs/reference", get(reference))
        .route("/docs/scalar.js", get(scalar))
        .route("/docs/{file}", get(file))
        .route("/docs/examples/{file}", get(example))
        .route("/docs/gallery/{file}", get(picture))
}

async fn reference(headers: HeaderMap) -> Response {
    let mut response = REFERENCE.response(&headers);
    response
        .headers_mut()
        .insert(CONTENT_SECURITY_POLICY, REFERENCE_POLICY);
    response
}

async fn file(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Refusal> {
    Ok(find(&*FILES, &name, &headers)?)
}

async fn example(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Refusal> {
    Ok(find(&*EXAMPLES, &format!("examples/{name}"), &headers)?)
}

async fn picture(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Refusal> {
    Ok(find(&*GALLERY, &format!("gallery/{name}"), &headers)?)
}

/// Always compressed: without `Accept-Encoding` any coding is acceptable, browsers accept gzip, and
/// nothing else reads this file.
async fn scalar(headers: HeaderMap) -> Result<Response, Refusal> {
    // Compressing takes some tenths of a second, once.
    let asset = tokio::task::spawn_blocking(|| SCALAR.as_ref())
        .await
        .ok()
        .flatten();
    let mut response = asset
        .ok_or_else(|| Problem::new(Code::Internal, "internal error"))?
        .response(&headers);
    response
        .headers_mut()
        .insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
    Ok(response)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(asset: &Asset) -> &str {
        std::str::from_utf8(&asset.bytes).expect("text is UTF-8")
    }

    #[test]
    fn the_guide_has_the_examples_that_are_served_and_no_others() {
        let mut named = vec!["examples/here.js".to_owned()];
        for example in text(&INDEX).split("data-name=\"").skip(1) {
            let mut quoted = example.split('"');
            let (name, languages) = (quoted.next().unwrap(), quoted.nth(1).unwrap());
            named.extend(
                languages
                    .split(' ')
                    .map(|language| format!("examples/{name}.{language}")),
            );
        }
        let mut served: Vec<_> = EXAMPLES
            .iter()
            .map(|(name, _)| (*name).to_owned())
            .collect();
        named.sort_unstable();
        served.sort_unstable();
        assert_eq!(named, served);
    }

    #[test]
    fn the_guide_shows_the_pictures_that_are_served_and_no_others() {
        let shown = text(&INDEX).split("src=\"docs/gallery/").skip(1);
        let shown = shown.map(|rest| rest.split('"').next().unwrap());
        let served = GALLERY.iter().map(|(name, _)| *name);
        let served = served.filter_map(|name| name.strip_prefix("gallery/"));
        assert_eq!(shown.collect::<Vec<_>>(), served.collect::<Vec<_>>());
    }

    #[test]
    fn both_pages_ask_for_files_that_are_served_and_for_nothing_from_elsewhere() {
        for (page, place) in [(&INDEX, "docs/"), (&REFERENCE, "")] {
            let html = text(page);
            assert!(
                !html.contains("://")
                    && !html.contains("<style")
                    && !html.contains(" style=")
                    && !html.contains("<script>")
            );
            for link in html
                .split(['"', '\''])
                .filter(|part| part.ends_with(".css") || part.ends_with(".js"))
                // In an example for a site of one's own.
                .filter(|part| !part.starts_with("./node_modules/"))
            {
                let name = link.strip_prefix(place).expect(link);
                assert!(
                    name == "scalar.js" || FILES.iter().any(|(known, _)| *known == name),
                    "{link}"
                );
            }
        }
        for (name, asset) in FILES.iter() {
            let outside = text(asset).replace("http://127.0.0.1:8080", "");
            assert!(!outside.contains("://"), "{name}");
        }
        assert!(
            SCALAR
                .as_ref()
                .is_some_and(|script| script.bytes.len() > 100_000)
        );
    }
}
