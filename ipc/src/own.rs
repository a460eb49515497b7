//! Domains of one process' own: of a test, of a demonstration.

use crate::domain::{Domain, DomainError};
use std::ops::Deref;
use std::sync::atomic::{AtomicU32, Ordering};

/// A domain that no other process of this machine has; its traces go when it is dropped, unless somebody still uses it.
/// Declare it before all that joins it.
#[derive(Debug)]
pub struct OwnDomain(Domain);

impl OwnDomain {
    /// A new domain, whose name begins with `what`.
    ///
    /// # Errors
    /// [`DomainError`] if that cannot be a name, or leaves no room for the rest.
    pub fn new(what: &str) -> Result<Self, DomainError> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        loop {
            let id = std::process::id();
            let domain = Domain::new(&match COUNT.fetch_add(1, Ordering::Relaxed) {
                0 => format!("{what}-{id}"),
                number => format!("{what}-{id}-{number}"),
            })?;
            // A process that was killed may have had the same id, and a child of it may live on.
            if !matches!(domain.remove_if_unused(), Ok(false)) {
                return Ok(Self(domain));
            }
        }
    }
}

impl Deref for OwnDomain {
    type Target = Domain;

    fn deref(&self) -> &Domain {
        &self.0
    }
}

impl Drop for OwnDomain {
    fn drop(&mut self) {
        let _ = self.0.remove_if_unused();
    }
}
