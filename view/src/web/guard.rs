//! Access control of the live page: refuses requests from pages of other sites in the same browser, whether they come through
//! a host name that resolves to this server (DNS rebinding) or from a foreign form or script (cross-site request forgery).

use std::net::{IpAddr, SocketAddr};

/// Method and headers of an HTTP request on which access depends.
#[derive(Clone, Copy, Debug)]
pub struct RequestHead<'a> {
    /// Method GET or HEAD.
    pub get: bool,
    /// Method POST, by which operators make requests.
    pub post: bool,
    /// Header Host.
    pub host: Option<&'a str>,
    /// Header Origin, which browsers send with every POST.
    pub origin: Option<&'a str>,
    /// Header Authorization.
    pub authorization: Option<&'a str>,
}

/// Refusal of an HTTP request: status and reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HttpRefusal {
    /// HTTP status.
    pub status: u16,
    /// Reason, one sentence.
    pub why: &'static str,
}

/// Token of 128 random bits, as hexadecimal text; its holder may make requests.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Draws a new token.
    ///
    /// # Errors
    /// If `/dev/urandom` cannot be read.
    pub fn new() -> std::io::Result<Self> {
        use std::io::Read;
        let mut bits = [0; 16];
        std::fs::File::open("/dev/urandom")?.read_exact(&mut bits)?;
        Ok(Self(format!("{:032x}", u128::from_le_bytes(bits))))
    }

    /// The token as 32 hexadecimal digits, to be printed where the server is started.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether `other` equals the token, in a time that depends on the length of `other` only.
    fn is(&self, other: &str) -> bool {
        let (a, b) = (self.0.as_bytes(), other.as_bytes());
        a.len() == b.len() && a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
    }
}

/// Checks whether the request is allowed.
///
/// # Errors
/// [`HttpRefusal`] with the status 401, 403 or 405.
pub fn check(head: &RequestHead<'_>, token: Option<&Token>) -> Result<(), HttpRefusal> {
    let refuse = |status, why| Err(HttpRefusal { status, why });
    if !head.host.is_some_and(is_address) {
        return refuse(403, "expected an address or localhost as host: open the page as it was printed");
    }
    if head.get {
        return Ok(());
    }
    if !head.post {
        return refuse(405, "expected GET or POST");
    }
    let Some(token) = token else {
        return refuse(403, "read-only: start the monitor with --allow-control");
    };
    let own = head.host.map(|host| format!("http://{host}"));
    if head.origin.is_some() && head.origin != own.as_deref() {
        return refuse(403, "the request comes from another site");
    }
    match head.authorization.and_then(|text| text.strip_prefix("Bearer ")) {
        Some(text) if token.is(text) => Ok(()),
        _ => refuse(401, "expected the token that was printed at the start, as Authorization: Bearer TOKEN"),
    }
}

/// Whether `host` is an IP address or localhost: any other name may belong to another site and resolve to this server.
fn is_address(host: &str) -> bool {
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    name == "localhost" || host.parse::<SocketAddr>().is_ok() || host.parse::<IpAddr>().is_ok()
}
