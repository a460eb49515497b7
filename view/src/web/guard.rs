//! Who may do what. A page of another site that is open in the same browser must not get through: not by a name that
//! leads here (DNS rebinding), not by a form or script of its own (cross-site request forgery).

use std::net::{IpAddr, SocketAddr};

/// What counts of a request.
#[derive(Clone, Copy, Debug)]
pub struct RequestHead<'a> {
    /// Method GET.
    pub get: bool,
    /// Method POST: it may change something.
    pub post: bool,
    /// Header Host.
    pub host: Option<&'a str>,
    /// Header Origin, which browsers send with every POST.
    pub origin: Option<&'a str>,
    /// Header Authorization.
    pub authorization: Option<&'a str>,
}

/// Why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HttpRefusal {
    /// HTTP status.
    pub status: u16,
    /// For people.
    pub why: &'static str,
}

/// 128 random bits, as text; whoever has them may make requests.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// A new one.
    ///
    /// # Errors
    /// If the system has no random numbers.
    pub fn new() -> std::io::Result<Self> {
        use std::io::Read;
        let mut bits = [0; 16];
        std::fs::File::open("/dev/urandom")?.read_exact(&mut bits)?;
        Ok(Self(format!("{:032x}", u128::from_le_bytes(bits))))
    }

    /// For the one who started the page.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether `other` is the same; takes as long for any text of the same length.
    fn is(&self, other: &str) -> bool {
        let (a, b) = (self.0.as_bytes(), other.as_bytes());
        a.len() == b.len() && a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
    }
}

/// Whether the request may be answered.
///
/// # Errors
/// [`HttpRefusal`]
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

/// A name other than localhost may be somebody else's, and lead here.
fn is_address(host: &str) -> bool {
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    name == "localhost" || host.parse::<SocketAddr>().is_ok() || host.parse::<IpAddr>().is_ok()
}
