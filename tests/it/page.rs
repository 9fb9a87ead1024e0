//! The page: its files are served whole or not at all, and nothing lets it reach elsewhere.

use crate::support::Server;

#[tokio::test]
async fn its_files_come_with_a_tag_and_a_policy() {
    let server = Server::start(&["--max-body-bytes", "5MiB", "--session-idle", "2m"]).await;
    for (path, media) in [
        ("/", "text/html; charset=utf-8"),
        ("/page/page.css", "text/css; charset=utf-8"),
        ("/page/main.js", "text/javascript; charset=utf-8"),
        ("/page/icon.svg", "image/svg+xml"),
        ("/page/cat.jpg", "image/jpeg"),
        ("/page/horse.webp", "image/webp"),
    ] {
        let whole = server.get(path).send().await.unwrap();
        assert_eq!(whole.status(), 200, "{path}");
        let header = |name: &str| whole.headers()[name].to_str().unwrap().to_owned();
        assert_eq!(header("content-type"), media);
        assert_eq!(header("cache-control"), "no-cache");
        assert_eq!(header("x-content-type-options"), "nosniff");
        assert_eq!(header("referrer-policy"), "no-referrer");
        let policy = header("content-security-policy");
        assert!(
            policy.starts_with("default-src 'none'; ") && !policy.contains("unsafe"),
            "{policy}"
        );
        let tag = header("etag");
        assert!(!whole.bytes().await.unwrap().is_empty(), "{path}");
        for known in [tag.clone(), format!("\"other\", W/{tag}"), "*".to_owned()] {
            let again = server
                .get(path)
                .header("If-None-Match", known)
                .send()
                .await
                .unwrap();
            assert_eq!(
                (
                    again.status().as_u16(),
                    again.headers()["etag"].to_str().unwrap()
                ),
                (304, tag.as_str()),
                "{path}"
            );
            assert!(again.bytes().await.unwrap().is_empty());
        }
        assert_eq!(
            server
                .get(path)
                .header("If-None-Match", "\"other\"")
                .send()
                .await
                .unwrap()
                .status(),
            200,
            "{path}"
        );
    }
    let index = server.get("/").send().await.unwrap().text().await.unwrap();
    assert!(
        index.contains("content=\"body=5242880 pixels=50000000 side=16384 idle=120 memory=1\""),
        "the limits of this server"
    );
}

#[tokio::test]
async fn nothing_else_is_served_beside_it() {
    let server = Server::start(&[]).await;
    for path in [
        "/page/none.js",
        "/page/README.md",
        "/page/index.html",
        "/page/..%2fpage.rs",
        "/page/",
        "/page",
    ] {
        let refused = server.get(path).send().await.unwrap();
        assert_eq!(refused.status(), 404, "{path}");
        assert_eq!(
            refused.headers()["content-type"],
            "application/problem+json",
            "{path}"
        );
    }
    assert_eq!(server.post("/").send().await.unwrap().status(), 405);
}

#[tokio::test]
async fn only_listed_sites_may_show_the_page_in_a_frame() {
    for (options, ancestors) in [
        (&[][..], "'none'"),
        (
            &[
                "--frame-ancestors",
                "https://a.example, http://127.0.0.1:3000",
            ],
            "https://a.example http://127.0.0.1:3000",
        ),
        (&["--frame-ancestors", "*"], "*"),
    ] {
        let server = Server::start(options).await;
        let policy = async |path: &str| {
            let answer = server.get(path).send().await.unwrap();
            let policy = answer.headers()["content-security-policy"].to_str();
            let policy = policy.unwrap().to_owned();
            policy.split("frame-ancestors ").nth(1).unwrap().to_owned()
        };
        assert_eq!(policy("/").await, ancestors);
        // The guide is a page of its own, which nobody has a reason to frame.
        assert_eq!(policy("/docs").await, "'none'");
    }
}
