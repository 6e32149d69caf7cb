//! Access rules of the page: a pure function of a request's claims. Each refusal has a reason.
//!
//! A server on 127.0.0.1 is exposed to two attacks.
//! A page of another site can open a WebSocket, because browsers permit WebSockets to other origins.
//! A foreign DNS name can also be pointed at 127.0.0.1 (DNS rebinding).
//! The requested host must therefore be an address or `localhost`, and the requesting page must be ours.
//! For passive access, pages with one of the configured origins are also permitted.

use std::net::{IpAddr, SocketAddr};

/// Shortest token.
pub const TOKEN_MIN: usize = 16;
/// Minimum number of different characters in a token.
const DIFFERENT_MIN: usize = 6;

/// The claims of a request. A missing header is `None`, and one that is not text counts as empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct Claims<'a> {
    /// `Host`, if it occurs exactly once.
    pub host: Option<&'a str>,
    /// `Origin`.
    pub origin: Option<&'a str>,
    /// `token` of the query.
    pub token: Option<&'a str>,
}

/// The reason for a refusal, as a text for the user who sent the request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// A foreign name.
    #[error(
        "this page answers only to its address: open it as http://ADDRESS:PORT/ with numbers, or localhost"
    )]
    Host,
    /// A foreign page.
    #[error("another site's page may not look at the robot")]
    Origin,
    /// The request has a wrong token or none.
    #[error("this page needs the token that --web-token gave: open it with ?token=… at its end")]
    Token,
}

/// The access rules of one server.
#[derive(Clone, Debug)]
pub struct Gate {
    address: SocketAddr,
    token: Option<String>,
}

/// Returns whether the token is long enough, has enough different characters, and needs no escaping in an address.
pub fn is_fit_as_token(token: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_';
    let mut different: Vec<u8> = token.bytes().collect();
    different.sort_unstable();
    different.dedup();
    (TOKEN_MIN..=128).contains(&token.len()) && token.bytes().all(plain) && different.len() >= DIFFERENT_MIN
}

impl Gate {
    /// Creates the rules for a server on this address.
    pub fn new(address: SocketAddr, token: Option<String>) -> Self {
        Gate { address, token }
    }

    /// Checks whether this request may read a file. The files contain no secrets.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn file(&self, claims: &Claims<'_>) -> Result<(), Refused> {
        self.check_host(claims)?;
        match claims.origin {
            Some(_) => self.check_origin(claims),
            None => Ok(()),
        }
    }

    /// Checks whether this request may load the page. The page then uses the same token for its WebSocket.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn page(&self, claims: &Claims<'_>) -> Result<(), Refused> {
        self.file(claims)?;
        self.check_token(claims)
    }

    /// Checks whether this request may observe and stop the robot. Browsers always send the origin of a WebSocket.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn live(&self, claims: &Claims<'_>) -> Result<(), Refused> {
        self.check_host(claims)?;
        self.check_origin(claims)?;
        self.check_token(claims)
    }

    /// Checks whether this request may observe without being able to stop anything.
    /// Programs other than browsers send no origin.
    /// A browser's page must be ours or have one of these `origins`.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn look(&self, claims: &Claims<'_>, origins: &[String]) -> Result<(), Refused> {
        self.check_host(claims)?;
        let named = claims.origin.is_none_or(|origin| origins.iter().any(|known| known == origin));
        if !named {
            self.check_origin(claims)?;
        }
        self.check_token(claims)
    }

    fn check_host(&self, claims: &Claims<'_>) -> Result<(), Refused> {
        let (name, port) = claims.host.and_then(split_host).ok_or(Refused::Host)?;
        let known = match name {
            Name::Localhost => true,
            Name::Address(ip) => ip.is_loopback() || !self.address.ip().is_loopback(),
        };
        if known && port == self.address.port() { Ok(()) } else { Err(Refused::Host) }
    }

    fn check_origin(&self, claims: &Claims<'_>) -> Result<(), Refused> {
        let same = claims.origin.zip(claims.host).is_some_and(|(origin, host)| {
            let authority = origin.strip_prefix("http://").unwrap_or_default();
            authority.eq_ignore_ascii_case(host)
        });
        if same { Ok(()) } else { Err(Refused::Origin) }
    }

    fn check_token(&self, claims: &Claims<'_>) -> Result<(), Refused> {
        let Some(token) = &self.token else { return Ok(()) };
        let given = claims.token.unwrap_or_default();
        // Compares all bytes in constant time, so that the duration reveals nothing.
        let differing = token.bytes().zip(given.bytes()).fold(0, |sum, (a, b)| sum | (a ^ b));
        if given.len() == token.len() && differing == 0 { Ok(()) } else { Err(Refused::Token) }
    }
}

enum Name {
    Localhost,
    Address(IpAddr),
}

/// `127.0.0.1:8042`, `[::1]:8042`, `localhost` (port 80).
fn split_host(host: &str) -> Option<(Name, u16)> {
    if let Ok(address) = host.parse::<SocketAddr>() {
        return Some((Name::Address(address.ip()), address.port()));
    }
    let (name, port) = match host.rsplit_once(':') {
        Some((name, port)) if !host.ends_with(']') => (name, port.parse().ok()?),
        _ => (host, 80),
    };
    if name.eq_ignore_ascii_case("localhost") {
        return Some((Name::Localhost, port));
    }
    let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
    bare.parse().ok().map(|ip| (Name::Address(ip), port))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECRET: &str = "0123456789abcdef";

    fn gate(address: &str, token: Option<&str>) -> Gate {
        Gate::new(address.parse().unwrap(), token.map(str::to_owned))
    }

    fn claims<'a>(host: &'a str, origin: Option<&'a str>) -> Claims<'a> {
        Claims { host: Some(host), origin, token: None }
    }

    #[test]
    fn only_an_address_or_localhost_with_the_own_port_is_a_host() {
        let gate = gate("127.0.0.1:8042", None);
        for host in ["127.0.0.1:8042", "localhost:8042", "LOCALHOST:8042", "[::1]:8042"] {
            assert_eq!(gate.page(&claims(host, None)), Ok(()), "{host}");
        }
        for host in [
            "evil.example:8042",
            "127.0.0.1.evil.example:8042",
            "localhost.evil.example:8042",
            "127.0.0.1",
            "127.0.0.1:8043",
            "192.168.1.7:8042",
            "2130706433:8042",
            "127.0.0.1:8042:8042",
            "127.0.0.1:",
            "[::1]",
            "",
        ] {
            assert_eq!(gate.page(&claims(host, None)), Err(Refused::Host), "{host}");
        }
        assert_eq!(gate.page(&Claims::default()), Err(Refused::Host));
    }

    #[test]
    fn only_a_page_from_here_may_look_at_the_robot() {
        let gate = gate("127.0.0.1:8042", None);
        let host = "127.0.0.1:8042";
        assert_eq!(gate.live(&claims(host, Some("http://127.0.0.1:8042"))), Ok(()));
        for origin in [
            "http://evil.example",
            "https://127.0.0.1:8042",
            "http://127.0.0.1:8043",
            "http://localhost:8042",
            "http://127.0.0.1:8042.evil.example",
            "null",
            "",
        ] {
            assert_eq!(gate.live(&claims(host, Some(origin))), Err(Refused::Origin), "{origin}");
            assert_eq!(gate.file(&claims(host, Some(origin))), Err(Refused::Origin), "{origin}");
        }
        assert_eq!(gate.live(&claims(host, None)), Err(Refused::Origin), "a browser always says");
        assert_eq!(gate.file(&claims(host, None)), Ok(()), "an address typed in has no origin");
    }

    #[test]
    fn where_others_can_come_in_page_and_robot_need_the_token() {
        let gate = gate("0.0.0.0:8042", Some(SECRET));
        let (host, origin) = (Some("192.168.1.7:8042"), Some("http://192.168.1.7:8042"));
        for token in
            [None, Some(""), Some("0123456789abcdeg"), Some("0123456789abcde"), Some("0123456789abcdef0")]
        {
            let claims = Claims { host, origin, token };
            assert_eq!(gate.page(&claims), Err(Refused::Token), "{token:?}");
            assert_eq!(gate.live(&claims), Err(Refused::Token), "{token:?}");
            assert_eq!(gate.file(&claims), Ok(()));
        }
        let known = Claims { host, origin, token: Some(SECRET) };
        assert_eq!((gate.page(&known), gate.live(&known)), (Ok(()), Ok(())));
        let renamed = Claims { host: Some("robot.example:8042"), ..known };
        assert_eq!(gate.page(&renamed), Err(Refused::Host), "a name may be anybody's");
    }

    #[test]
    fn whoever_only_looks_on_is_no_browser_or_a_named_page() {
        let origins = ["https://viewer.example".to_owned()];
        let host = "127.0.0.1:8765";
        let open = gate(host, None);
        for origin in [None, Some("https://viewer.example"), Some("http://127.0.0.1:8765")] {
            assert_eq!(open.look(&claims(host, origin), &origins), Ok(()), "{origin:?}");
        }
        for origin in ["http://viewer.example", "https://viewer.example.evil", "null", "", "file://"] {
            assert_eq!(open.look(&claims(host, Some(origin)), &origins), Err(Refused::Origin), "{origin}");
        }
        assert_eq!(open.look(&claims("evil.example:8765", None), &origins), Err(Refused::Host));
        let closed = gate("0.0.0.0:8765", Some(SECRET));
        let stranger = claims("192.168.1.7:8765", Some("https://viewer.example"));
        assert_eq!(closed.look(&stranger, &origins), Err(Refused::Token));
        let known = Claims { token: Some(SECRET), ..stranger };
        assert_eq!(closed.look(&known, &origins), Ok(()));
    }

    #[test]
    fn tokens_are_long_and_plain() {
        assert!(is_fit_as_token(SECRET) && is_fit_as_token("abcd-efgh_ijkl-0123"));
        for token in [
            "",
            "0123456789abcde",
            "0123456789abcde f",
            "0123456789abcde&",
            "0123456789abcdeé",
            "aaaaaaaaaaaaaaaabcd",
        ] {
            assert!(!is_fit_as_token(token), "{token}");
        }
        assert!(!is_fit_as_token(&"a".repeat(129)));
    }
}
