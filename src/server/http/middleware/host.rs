//! The check of a request's host: exactly one, well-formed (RFC 9112, section 3.2; RFC 9113,
//! section 8.3.1), and served by this listener.

use axum::extract::Request;
use axum::http::Version;
use axum::http::header::HOST;

use crate::auth::hosts::{Authority, Host, Hosts};
use crate::problem::words::quote;
use crate::problem::{Code, Problem};

/// Health checks send any host, and the responses hold no user data.
const EXEMPT_PATHS: [&str; 2] = ["/healthz", "/readyz"];

/// Checks the host. `served`: the hosts that the listener serves; none: any host.
/// Errors: [`Code::MalformedRequest`], [`Code::Misdirected`].
pub(crate) fn check(request: &Request, served: Option<&Hosts>) -> Result<(), Problem> {
    let host = host(request)?;
    let Some(served) = served.filter(|_| !EXEMPT_PATHS.contains(&request.uri().path())) else {
        return Ok(());
    };
    if host.as_ref().is_some_and(|host| served.allow(host)) {
        return Ok(());
    }
    let host = match host {
        Some(Host::Name(name)) => quote(&name),
        _ => "of a request that names none".to_owned(),
    };
    let detail = format!(
        "this server does not serve the host {host}; --allowed-hosts adds names to localhost and \
            IP addresses"
    );
    Err(Problem::new(Code::Misdirected, detail))
}

/// The host of the target if it has one, otherwise of the `Host` header.
fn host(request: &Request) -> Result<Option<Host>, Problem> {
    let malformed = |detail: &str| Problem::new(Code::MalformedRequest, detail);
    let parse = |text: Option<&str>, name: &str| {
        text.and_then(Authority::parse)
            .ok_or_else(|| malformed(&format!("the {name} is not `host` or `host:port`")))
    };
    let mut fields = request.headers().get_all(HOST).iter();
    let field = fields
        .next()
        .map(|field| parse(field.to_str().ok(), "Host header"))
        .transpose()?;
    if fields.next().is_some() {
        return Err(malformed("the request has more than one Host header"));
    }
    let target = request
        .uri()
        .authority()
        .map(|target| parse(Some(target.as_str()), "target's host"))
        .transpose()?;
    match (request.version(), &target, &field) {
        (Version::HTTP_11, _, None) => {
            return Err(malformed("an HTTP/1.1 request needs a Host header"));
        }
        (Version::HTTP_2, None, None) => {
            return Err(malformed(
                "an HTTP/2 request needs :authority or a Host header",
            ));
        }
        (Version::HTTP_2, Some(target), Some(field)) => {
            let default_port = if request.uri().scheme_str() == Some("https") {
                443
            } else {
                80
            };
            let port = |authority: &Authority| authority.port.unwrap_or(default_port);
            if target.host != field.host || port(target) != port(field) {
                return Err(malformed(":authority and the Host header differ"));
            }
        }
        _ => {}
    }
    Ok(target.or(field).map(|authority| authority.host))
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn checked(
        version: Version,
        target: &str,
        fields: &[&str],
        served: Option<&str>,
    ) -> Result<(), Code> {
        let mut request = Request::builder().version(version).uri(target);
        for field in fields {
            request = request.header(HOST, *field);
        }
        let served = served.map(|list| Hosts::parse(list).unwrap());
        check(&request.body(Body::empty()).unwrap(), served.as_ref())
            .map_err(|problem| problem.code)
    }

    #[test]
    fn a_request_names_one_well_formed_host() {
        let malformed = Err(Code::MalformedRequest);
        let (old, one, two) = (Version::HTTP_10, Version::HTTP_11, Version::HTTP_2);
        assert_eq!(checked(one, "/warp", &["a.example"], None), Ok(()));
        assert_eq!(checked(old, "/warp", &[], None), Ok(()));
        for fields in [
            &[][..],
            &[""],
            &["a.example", "a.example"],
            &["a b"],
            &["a:x"],
        ] {
            assert_eq!(checked(one, "/warp", fields, None), malformed, "{fields:?}");
            assert_eq!(
                checked(one, "/healthz", fields, None),
                malformed,
                "{fields:?}"
            );
        }
        assert_eq!(
            checked(one, "http://user@a.example/warp", &["a.example"], None),
            malformed
        );
        assert_eq!(checked(two, "/warp", &[], None), malformed);
        assert_eq!(checked(two, "/warp", &["a.example"], None), Ok(()));
        for (target, field, same) in [
            ("http://a.example/warp", "A.example.:80", true),
            ("https://a.example/warp", "a.example:443", true),
            ("https://a.example:8443/warp", "a.example:8443", true),
            ("https://a.example/warp", "a.example:80", false),
            ("http://a.example/warp", "b.example", false),
            ("http://127.0.0.1/warp", "localhost", false),
        ] {
            assert_eq!(
                checked(two, target, &[field], None),
                if same { Ok(()) } else { malformed },
                "{target} {field}"
            );
        }
    }

    #[test]
    fn the_targets_host_counts_before_the_header_and_health_is_exempt() {
        let (old, one, two) = (Version::HTTP_10, Version::HTTP_11, Version::HTTP_2);
        let misdirected = Err(Code::Misdirected);
        for (version, target, fields, answer) in [
            (one, "/warp", &["localhost:8080"][..], Ok(())),
            (one, "/warp", &["warp.example"], Ok(())),
            (one, "/warp", &["evil.example"], misdirected),
            (one, "http://evil.example/warp", &["localhost"], misdirected),
            (one, "http://localhost/warp", &["evil.example"], Ok(())),
            (two, "http://evil.example/warp", &[], misdirected),
            (two, "http://[::1]:8080/warp", &[], Ok(())),
            (two, "/warp", &["evil.example"], misdirected),
            (old, "/warp", &[], misdirected),
            (one, "/healthz", &["evil.example"], Ok(())),
            (one, "/readyz", &["evil.example"], Ok(())),
            (one, "/metrics", &["evil.example"], misdirected),
        ] {
            assert_eq!(
                checked(version, target, fields, Some("warp.example")),
                answer,
                "{version:?} {target} {fields:?}"
            );
        }
    }
}
