//! The origins of other sites whose pages may use this service.

/// A set of origins.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Origins {
    /// None.
    #[default]
    Own,
    /// These.
    Listed(Vec<String>),
    /// Every site.
    Any,
}

impl Origins {
    /// Reads `*` or a comma-separated list of origins as browsers send them: scheme, host, and the port unless it is the default.
    /// Errors: the first entry that is not an origin.
    pub fn parse(text: &str) -> Result<Self, String> {
        let listed: Vec<&str> = text.split(',').map(str::trim).filter(|origin| !origin.is_empty()).collect();
        match listed.as_slice() {
            [] => Ok(Self::Own),
            ["*"] => Ok(Self::Any),
            listed => listed.iter().map(|origin| checked(origin)).collect::<Result<_, _>>().map(Self::Listed),
        }
    }

    /// Whether the origin is in the set.
    pub fn has(&self, origin: &str) -> bool {
        match self {
            Self::Own => false,
            Self::Listed(listed) => listed.iter().any(|known| known == origin),
            Self::Any => true,
        }
    }
}

fn checked(origin: &str) -> Result<String, String> {
    let wrong = || format!("`{origin}` is no origin such as https://bend.example or http://127.0.0.1:3000");
    let (scheme, authority) = origin.split_once("://").ok_or_else(wrong)?;
    let default_port = match scheme {
        "https" => ":443",
        "http" => ":80",
        _ => return Err(wrong()),
    };
    let plain = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b"-._:[]".contains(&b);
    // Origins are compared as text: an entry that a browser never sends is a mistake.
    if authority.is_empty() || !authority.bytes().all(plain) || authority.ends_with(default_port) {
        return Err(wrong());
    }
    Ok(origin.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_compared_exactly() {
        let listed = Origins::parse("https://bend.example, http://127.0.0.1:3000").unwrap();
        assert!(listed.has("https://bend.example") && listed.has("http://127.0.0.1:3000"));
        for other in ["http://bend.example", "https://bend.example.evil", "https://bend.example:8443", "null", ""] {
            assert!(!listed.has(other), "{other}");
        }
        assert!(Origins::parse("*").unwrap().has("null"));
        assert_eq!(Origins::parse("").unwrap(), Origins::Own);
        for wrong in
            ["bend.example", "https://bend.example/", "https://Bend.example", "https://a.example,*", "https://a:443", "ftp://a", "null"]
        {
            assert!(Origins::parse(wrong).is_err(), "{wrong}");
        }
    }
}
