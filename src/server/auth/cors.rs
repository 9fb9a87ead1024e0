//! The origins of other sites whose pages may use this service.

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) enum Origins {
    /// The service's own.
    #[default]
    Own,
    Listed(Vec<String>),
    Any,
}

impl Origins {
    /// Reads `*` or a comma-separated list of origins as browsers send them: scheme, host, and the
    /// port unless it is the default.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let listed: Vec<&str> = text
            .split(',')
            .map(str::trim)
            .filter(|origin| !origin.is_empty())
            .collect();
        match listed.as_slice() {
            [] => Ok(Self::Own),
            ["*"] => Ok(Self::Any),
            listed => match listed.iter().find(|origin| !is_origin(origin)) {
                Some(wrong) => Err(format!(
                    "`{wrong}` is no origin such as https://warp.example or http://127.0.0.1:3000"
                )),
                None => Ok(Self::Listed(
                    listed.iter().map(ToString::to_string).collect(),
                )),
            },
        }
    }

    /// The value of the directive `frame-ancestors` of a content security policy.
    pub(crate) fn frame_ancestors(&self) -> String {
        match self {
            Self::Own => "'none'".to_owned(),
            Self::Listed(listed) => listed.join(" "),
            Self::Any => "*".to_owned(),
        }
    }

    pub(crate) fn has(&self, origin: &str) -> bool {
        match self {
            Self::Own => false,
            Self::Listed(listed) => listed.iter().any(|known| known == origin),
            Self::Any => true,
        }
    }
}

/// Origins are compared as text, so a text that no browser sends is rejected.
fn is_origin(text: &str) -> bool {
    let is_plain = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b"-._:[]".contains(&b);
    let (authority, default_port) = match text.split_once("://") {
        Some(("https", authority)) => (authority, ":443"),
        Some(("http", authority)) => (authority, ":80"),
        _ => return false,
    };
    !authority.is_empty() && authority.bytes().all(is_plain) && !authority.ends_with(default_port)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_compared_exactly() {
        let listed = Origins::parse("https://warp.example, http://127.0.0.1:3000").unwrap();
        assert!(listed.has("https://warp.example") && listed.has("http://127.0.0.1:3000"));
        for other in [
            "http://warp.example",
            "https://warp.example.evil",
            "https://warp.example:8443",
            "null",
            "",
        ] {
            assert!(!listed.has(other), "{other}");
        }
        assert!(Origins::parse("*").unwrap().has("null"));
        assert_eq!(Origins::parse("").unwrap(), Origins::Own);
        for wrong in [
            "warp.example",
            "https://warp.example/",
            "https://Warp.example",
            "https://a.example,*",
            "https://a:443",
            "ftp://a",
            "null",
        ] {
            assert!(Origins::parse(wrong).is_err(), "{wrong}");
        }
    }
}
