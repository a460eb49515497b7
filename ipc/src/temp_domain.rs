//! Domains for one test or one demonstration.

use crate::domain::{Domain, DomainError};
use std::ops::Deref;
use std::sync::atomic::{AtomicU32, Ordering};

/// A domain with a name that no other process of the machine uses; its files are removed when it is dropped, unless a process
/// still uses them. Declare it before everything that joins it.
#[derive(Debug)]
pub struct TempDomain(Domain);

impl TempDomain {
    /// A new domain whose name begins with `prefix`.
    ///
    /// # Errors
    /// [`DomainError`] if `prefix` cannot begin a name, or leaves no room for the rest.
    pub fn new(prefix: &str) -> Result<Self, DomainError> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        loop {
            let id = std::process::id();
            let domain = Domain::new(&match COUNT.fetch_add(1, Ordering::Relaxed) {
                0 => format!("{prefix}-{id}"),
                number => format!("{prefix}-{id}-{number}"),
            })?;
            // A process that was killed may have had the same id, and a child of it may live on.
            if !matches!(domain.remove_if_unused(), Ok(false)) {
                return Ok(Self(domain));
            }
        }
    }
}

impl Deref for TempDomain {
    type Target = Domain;

    fn deref(&self) -> &Domain {
        &self.0
    }
}

impl Drop for TempDomain {
    fn drop(&mut self) {
        let _ = self.0.remove_if_unused();
    }
}
