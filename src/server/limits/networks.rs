//! Networks of IP addresses (`10.0.0.0/8`, `::1`), and the address of a client behind proxies.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};

use ipnet::IpNet;

/// A range of addresses with a common prefix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network(IpNet);

impl Network {
    /// Reads an address, or a network in CIDR notation.
    /// Errors: the text is neither.
    pub fn parse(text: &str) -> Result<Self, String> {
        let network = match text.split_once('/') {
            Some((address, bits)) => address
                .parse()
                .ok()
                .zip(bits.parse().ok())
                .and_then(|(address, bits)| IpNet::new(address, bits).ok()),
            None => text.parse::<IpAddr>().ok().map(IpNet::from),
        };
        network.map(Self).ok_or_else(|| {
            format!("`{text}` is not an address or a network such as 10.0.0.0/8 or fd00::/8")
        })
    }

    /// Whether the network contains an address. An IPv4-mapped IPv6 address is an IPv4 address.
    pub fn contains(&self, address: IpAddr) -> bool {
        self.0.contains(&address.to_canonical())
    }
}

/// The client's address: the peer's, or behind trusted proxies the last one in `forwarded`
/// (`X-Forwarded-For`, first hop first) that is no trusted proxy. The client may have written those
/// before it, so they are ignored.
pub fn client_ip<'a>(
    peer: IpAddr,
    forwarded: impl DoubleEndedIterator<Item = &'a str>,
    trusted: &[Network],
) -> IpAddr {
    let is_trusted = |address: IpAddr| trusted.iter().any(|network| network.contains(address));
    let mut at = peer.to_canonical();
    for hop in forwarded.rev() {
        if !is_trusted(at) {
            break;
        }
        // A trusted proxy writes addresses only.
        let Some(address) = hop_address(hop.trim()) else {
            break;
        };
        at = address.to_canonical();
    }
    at
}

/// Reads `192.0.2.1`, `192.0.2.1:1234`, `2001:db8::1`, `[2001:db8::1]`, `[2001:db8::1]:1234`.
fn hop_address(text: &str) -> Option<IpAddr> {
    let bracketed = || {
        text.strip_prefix('[')?
            .strip_suffix(']')?
            .parse::<Ipv6Addr>()
            .ok()
    };
    let address = text
        .parse::<IpAddr>()
        .or_else(|_| text.parse::<SocketAddr>().map(|address| address.ip()));
    address.ok().or_else(|| bracketed().map(IpAddr::V6))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn networks_hold_what_their_bits_say() {
        for (network, inside, outside) in [
            ("10.0.0.0/8", "10.255.1.2", "11.0.0.1"),
            ("192.168.7.9", "192.168.7.9", "192.168.7.8"),
            ("192.168.7.9/24", "192.168.7.200", "192.168.8.1"),
            ("0.0.0.0/0", "203.0.113.5", "::1"),
            ("127.0.0.0/8", "::ffff:127.0.0.1", "::1"),
            ("fd00::/8", "fd12::1", "fe80::1"),
            ("::1", "::1", "::2"),
            ("::/0", "2001:db8::1", "10.0.0.1"),
        ] {
            let network = Network::parse(network).unwrap();
            assert!(
                network.contains(ip(inside)) && !network.contains(ip(outside)),
                "{network:?}"
            );
        }
        for wrong in [
            "",
            "10.0.0.0/33",
            "::/129",
            "10.0.0",
            "10.0.0.0/",
            "10.0.0.0/-1",
            "here",
            "10.0.0.0/8/8",
        ] {
            assert!(Network::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn only_what_a_trusted_proxy_wrote_is_believed() {
        let trusted = [
            Network::parse("10.0.0.0/8").unwrap(),
            Network::parse("::1").unwrap(),
        ];
        let from = |peer: &str, forwarded: &str| {
            let hops: Vec<&str> = if forwarded.is_empty() {
                Vec::new()
            } else {
                forwarded.split(',').collect()
            };
            client_ip(ip(peer), hops.into_iter(), &trusted)
        };
        // No proxy: whatever is claimed, the peer is meant.
        assert_eq!(from("203.0.113.9", "198.51.100.1"), ip("203.0.113.9"));
        assert_eq!(from("10.0.0.1", "198.51.100.1"), ip("198.51.100.1"));
        // The client's own header stands on the left of what the proxy saw.
        assert_eq!(
            from("10.0.0.1", "127.0.0.1, 198.51.100.1"),
            ip("198.51.100.1")
        );
        assert_eq!(
            from("10.0.0.1", "1.1.1.1, 198.51.100.1, 10.0.0.2"),
            ip("198.51.100.1")
        );
        assert_eq!(from("10.0.0.1", "10.0.0.3"), ip("10.0.0.3"));
        assert_eq!(from("10.0.0.1", ""), ip("10.0.0.1"));
        assert_eq!(from("10.0.0.1", "198.51.100.1, unknown"), ip("10.0.0.1"));
        assert_eq!(from("::1", "[2001:db8::7]:443"), ip("2001:db8::7"));
        assert_eq!(from("::1", "[2001:db8::7]"), ip("2001:db8::7"));
        assert_eq!(
            from("::ffff:10.0.0.1", "198.51.100.1:1234"),
            ip("198.51.100.1")
        );
    }
}
