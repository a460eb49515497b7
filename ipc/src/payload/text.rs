//! Text of fixed size in shared memory.

use iceoryx2::prelude::ZeroCopySend;
use std::fmt;
use thiserror::Error;

/// Why the bytes of a [`Text`] are not a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum TextError {
    /// The stated length is larger than the capacity.
    #[error("text states {got} bytes but holds at most {max}", max = Text::CAPACITY)]
    Length {
        /// The stated length, bytes.
        got: u64,
    },
    /// The bytes are not UTF-8.
    #[error("text is not UTF-8 after byte {valid_up_to}")]
    Encoding {
        /// How many bytes from the start are valid UTF-8.
        valid_up_to: usize,
    },
}

/// UTF-8 text of at most [`Text::CAPACITY`] bytes, for reasons that people read.
#[repr(C)]
#[derive(Clone, Copy, ZeroCopySend)]
#[type_name("upswing.Text.v1")]
pub struct Text {
    /// Bytes in use, 0..=[`Text::CAPACITY`]; not to be trusted, read with [`Text::as_str`].
    pub len: u64,
    /// The bytes, UTF-8 up to `len`, zero after it.
    pub bytes: [u8; Text::CAPACITY],
}

const _: () = assert!(size_of::<Text>() == 256);

impl Text {
    /// Largest number of bytes: with the length, 256 bytes in all.
    pub const CAPACITY: usize = 248;

    /// Copies `text`; what does not fit is cut off at a character boundary.
    pub fn new(text: &str) -> Self {
        let len = floor_char_boundary(text, Self::CAPACITY);
        let mut bytes = [0; Self::CAPACITY];
        bytes[..len].copy_from_slice(&text.as_bytes()[..len]);
        Self { len: len as u64, bytes }
    }

    /// The text, if length and encoding hold; it may come from another process and is checked at every call.
    ///
    /// # Errors
    /// [`TextError`] with the stated length or the place of the first invalid byte.
    pub fn as_str(&self) -> Result<&str, TextError> {
        let used = usize::try_from(self.len)
            .ok()
            .and_then(|len| self.bytes.get(..len))
            .ok_or(TextError::Length { got: self.len })?;
        std::str::from_utf8(used).map_err(|e| TextError::Encoding { valid_up_to: e.valid_up_to() })
    }
}

/// The largest character boundary of `text` that is not above `limit` (the one of `str` needs Rust 1.91).
fn floor_char_boundary(text: &str, limit: usize) -> usize {
    (0..=limit.min(text.len())).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(0)
}

impl Default for Text {
    /// No text.
    fn default() -> Self {
        Self { len: 0, bytes: [0; Self::CAPACITY] }
    }
}

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.as_str() {
            Ok(text) => f.pad(text),
            Err(error) => write!(f, "<{error}>"),
        }
    }
}

impl fmt::Debug for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.as_str() {
            Ok(text) => fmt::Debug::fmt(text, f),
            Err(error) => write!(f, "<{error}>"),
        }
    }
}
