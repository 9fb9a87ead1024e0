//! Networks of addresses (`10.0.0.0/8`, `::1`), and the address that a request counts for.

use std::net::{IpAddr, Ipv6Addr};

/// Addresses with the same first bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network {
    base: u128,
    mask: u128,
    is_v4: bool,
}

impl Network {
    /// Reads an address, or an address and how many of its bits count.
    ///
    /// # Errors
    /// It is neither.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not an address or a network such as 10.0.0.0/8 or fd00::/8");
        let (address, bits) = text.split_once('/').map_or((text, None), |(address, bits)| (address, Some(bits)));
        let address = address.parse::<IpAddr>().map_err(|_| wrong())?;
        let width = if address.is_ipv4() { 32 } else { 128 };
        let bits = bits.map_or(Ok(width), |bits| bits.parse::<u8>().ok().filter(|bits| *bits <= width).ok_or_else(wrong))?;
        let (number, is_v4) = number(address);
        let mask = mask(bits, width);
        Ok(Self { base: number & mask, mask, is_v4 })
    }

    /// Whether an address is of this network. An IPv4 address in IPv6 clothes is an IPv4 address.
    #[must_use]
    pub fn has(&self, address: IpAddr) -> bool {
        let (number, is_v4) = number(address.to_canonical());
        is_v4 == self.is_v4 && number & self.mask == self.base
    }
}

fn number(address: IpAddr) -> (u128, bool) {
    match address {
        IpAddr::V4(v4) => (u128::from(v4.to_bits()), true),
        IpAddr::V6(v6) => (v6.to_bits(), false),
    }
}

const fn mask(bits: u8, width: u8) -> u128 {
    let all = if width == 128 { u128::MAX } else { (1 << width) - 1 };
    if bits == 0 { 0 } else { all & (u128::MAX << (width - bits)) }
}

/// Where a request comes from: the peer, or, where the peer is a trusted proxy, the last address of `forwarded` (a whole `X-Forwarded-For`, first
/// hop first) that is not one. What stands further to the left was written by whoever asked and says nothing.
#[must_use]
pub fn client_ip<'a>(peer: IpAddr, forwarded: impl DoubleEndedIterator<Item = &'a str>, trusted: &[Network]) -> IpAddr {
    let is_trusted = |address: IpAddr| trusted.iter().any(|network| network.has(address));
    let mut at = peer.to_canonical();
    for hop in forwarded.rev() {
        if !is_trusted(at) {
            break;
        }
        // What is no address was not written by a proxy that can be trusted: the one before it is the last that is known.
        let Some(address) = hop_address(hop.trim()) else { break };
        at = address.to_canonical();
    }
    at
}

/// `192.0.2.1`, `192.0.2.1:1234`, `2001:db8::1`, `[2001:db8::1]`, `[2001:db8::1]:1234`.
fn hop_address(text: &str) -> Option<IpAddr> {
    if let Ok(address) = text.parse::<IpAddr>() {
        return Some(address);
    }
    if let Ok(address) = text.parse::<std::net::SocketAddr>() {
        return Some(address.ip());
    }
    text.strip_prefix('[')?.strip_suffix(']')?.parse::<Ipv6Addr>().ok().map(IpAddr::V6)
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
            assert!(network.has(ip(inside)) && !network.has(ip(outside)), "{network:?}");
        }
        for wrong in ["", "10.0.0.0/33", "::/129", "10.0.0", "10.0.0.0/", "10.0.0.0/-1", "here", "10.0.0.0/8/8"] {
            assert!(Network::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn only_what_a_trusted_proxy_wrote_is_believed() {
        let trusted = [Network::parse("10.0.0.0/8").unwrap(), Network::parse("::1").unwrap()];
        let from = |peer: &str, forwarded: &str| {
            let hops: Vec<&str> = if forwarded.is_empty() { Vec::new() } else { forwarded.split(',').collect() };
            client_ip(ip(peer), hops.into_iter(), &trusted)
        };
        // No proxy: whatever is claimed, the peer is meant.
        assert_eq!(from("203.0.113.9", "198.51.100.1"), ip("203.0.113.9"));
        assert_eq!(from("10.0.0.1", "198.51.100.1"), ip("198.51.100.1"));
        // The client's own header stands on the left of what the proxy saw.
        assert_eq!(from("10.0.0.1", "127.0.0.1, 198.51.100.1"), ip("198.51.100.1"));
        assert_eq!(from("10.0.0.1", "1.1.1.1, 198.51.100.1, 10.0.0.2"), ip("198.51.100.1"));
        assert_eq!(from("10.0.0.1", "10.0.0.3"), ip("10.0.0.3"));
        assert_eq!(from("10.0.0.1", ""), ip("10.0.0.1"));
        assert_eq!(from("10.0.0.1", "198.51.100.1, unknown"), ip("10.0.0.1"));
        assert_eq!(from("::1", "[2001:db8::7]:443"), ip("2001:db8::7"));
        assert_eq!(from("::1", "[2001:db8::7]"), ip("2001:db8::7"));
        assert_eq!(from("::ffff:10.0.0.1", "198.51.100.1:1234"), ip("198.51.100.1"));
    }
}
