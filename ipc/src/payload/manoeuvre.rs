//! A manoeuvre in a request: its name, and the values that the request gives.

use super::chain::PerJoint;
use iceoryx2::prelude::ZeroCopySend;
use std::fmt;
use thiserror::Error;
use upswing_model::MOST_JOINTS;

/// A text that cannot be the name of a manoeuvre.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{got}` is no name of a manoeuvre: expected 1 to {} bytes", Name::CAPACITY)]
pub struct NoName {
    /// The text.
    pub got: String,
}

/// Name of a manoeuvre: UTF-8 of at most [`Name::CAPACITY`] bytes, then zeros.
#[repr(C)]
#[derive(Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("upswing.Name.v1")]
pub struct Name {
    /// The bytes; not to be trusted, read with [`Name::as_str`].
    pub bytes: [u8; Name::CAPACITY],
}

impl Name {
    /// Largest number of bytes.
    pub const CAPACITY: usize = 32;

    /// The name `name`.
    ///
    /// # Errors
    /// [`NoName`] if it is empty or does not fit.
    pub fn new(name: &str) -> Result<Self, NoName> {
        let mut bytes = [0; Self::CAPACITY];
        match bytes.get_mut(..name.len()) {
            Some(room) if !name.is_empty() => room.copy_from_slice(name.as_bytes()),
            _ => return Err(NoName { got: name.to_owned() }),
        }
        Ok(Self { bytes })
    }

    /// The name; empty if the bytes, which may come from another process, are not UTF-8.
    pub fn as_str(&self) -> &str {
        let used = self.bytes.split(|byte| *byte == 0).next().unwrap_or_default();
        std::str::from_utf8(used).unwrap_or_default()
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

/// A manoeuvre of the system's settings as a request names it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.ManoeuvreRequest.v1")]
pub struct ManoeuvreRequest {
    /// Name of the manoeuvre.
    pub name: Name,
    /// Number of values that follow: that of the target's rows with `given`; 0: each keeps its value at the start.
    pub number: u64,
    /// The values of these rows in their order, rad or m; NaN: the value at the start. 0 beyond their number.
    pub given: PerJoint,
}

const _: () = assert!(size_of::<ManoeuvreRequest>() == Name::CAPACITY + 8 + size_of::<PerJoint>());

impl ManoeuvreRequest {
    /// The manoeuvre `name` with `given` values, rad or m; values beyond [`MOST_JOINTS`] are left out.
    ///
    /// # Errors
    /// [`NoName`]
    pub fn new(name: &str, given: &[f64]) -> Result<Self, NoName> {
        let number = given.len().min(MOST_JOINTS);
        let mut values = [0.0; MOST_JOINTS];
        values[..number].copy_from_slice(&given[..number]);
        Ok(Self { name: Name::new(name)?, number: number as u64, given: values })
    }

    /// The values; at most [`MOST_JOINTS`], however many the request states.
    pub fn given(&self) -> &[f64] {
        super::chain::used(&self.given, self.number)
    }
}
