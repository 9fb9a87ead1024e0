//! `GET /docs`: Swagger UI with `/openapi.json`. Its crate embeds an archive, of which two files (2 MB) are unpacked at the first request.

use std::io::{Cursor, Read as _};
use std::sync::LazyLock;

use axum::Router;
use axum::extract::Path;
use axum::http::HeaderMap;
use axum::response::Response;
use axum::routing::get;
use bytes::Bytes;
use utoipa_swagger_ui_vendored::SWAGGER_UI_VENDORED;
use zip::ZipArchive;

use crate::app::App;
use crate::http::assets::{Asset, CSS, HTML, JS, find};
use crate::problem::{Code, Problem};

static INDEX: LazyLock<Asset> = LazyLock::new(|| Asset::new(HTML, Bytes::from_static(include_bytes!("docs/index.html"))));
static ASSETS: LazyLock<[(&str, Asset); 4]> = LazyLock::new(|| {
    [
        ("docs.css", Asset::new(CSS, Bytes::from_static(include_bytes!("docs/docs.css")))),
        ("docs.js", Asset::new(JS, Bytes::from_static(include_bytes!("docs/docs.js")))),
        ("swagger-ui.css", Asset::new(CSS, library("/dist/swagger-ui.css"))),
        ("swagger-ui-bundle.js", Asset::new(JS, library("/dist/swagger-ui-bundle.js"))),
    ]
});

/// A file of Swagger UI, by the end of its path, which contains the version.
fn library(end: &str) -> Bytes {
    let read = || {
        let mut archive = ZipArchive::new(Cursor::new(SWAGGER_UI_VENDORED)).ok()?;
        let name = archive.file_names().filter_map(Result::ok).find(|name| name.ends_with(end))?.into_owned();
        let mut bytes = Vec::new();
        archive.by_name(&name).ok()?.read_to_end(&mut bytes).ok()?;
        Some(Bytes::from(bytes))
    };
    read().expect("the archive is compiled in, and a test reads it")
}

/// The page.
pub(crate) async fn page(headers: HeaderMap) -> Response {
    INDEX.response(&headers)
}

/// The page's files, which are not part of the contract.
pub(crate) fn files() -> Router<App> {
    Router::new().route("/docs/{file}", get(file))
}

async fn file(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    // Unpacking takes some milliseconds, once.
    let unpacked = tokio::task::spawn_blocking(|| &*ASSETS).await;
    let assets = unpacked.map_err(|_| Problem::new(Code::Internal, "internal error"))?;
    find(assets, &name, &headers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_the_page_asks_for_is_there_and_nothing_comes_from_elsewhere() {
        let index = include_str!("docs/index.html");
        let asked: Vec<&str> = index.split("\"docs/").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(asked.len(), ASSETS.len());
        for (name, asset) in ASSETS.iter() {
            assert!(asked.contains(name), "{name}");
            assert!(asset.bytes.len() > 100, "{name}");
        }
        assert!(!index.contains("://") && !index.contains("<style") && !index.contains(" style=") && !index.contains("<script>"));
        assert!(!include_str!("docs/docs.js").contains("://") && !include_str!("docs/docs.css").contains("://"));
    }
}
