//! Common Data Representation (OMG DDS-XTypes, version 1, little-endian), the encoding of ROS 2 messages.

/// Encapsulation header of a message: CDR, little-endian.
pub const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Encodes a message that consists of words of 8 bytes, which need no padding.
pub fn of_words(words: impl Iterator<Item = u64>) -> Vec<u8> {
    HEADER.into_iter().chain(words.flat_map(u64::to_le_bytes)).collect()
}

/// Decodes the words of a message; `None` if the header differs or the length is no multiple of 8 bytes.
pub fn words(message: &[u8]) -> Option<Vec<u64>> {
    let (words, rest) = message.strip_prefix(&HEADER)?.as_chunks();
    rest.is_empty().then(|| words.iter().map(|word| u64::from_le_bytes(*word)).collect())
}

/// Writer of a message. Numbers are aligned to their size, counted from the end of the header.
pub struct Cdr(Vec<u8>);

impl Cdr {
    pub fn new() -> Self {
        Self(HEADER.to_vec())
    }

    fn align(&mut self, size: usize) {
        let body = self.0.len() - HEADER.len();
        self.0.resize(HEADER.len() + body.next_multiple_of(size), 0);
    }

    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend(value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend(value.to_le_bytes());
    }

    /// Writes the length of a sequence, before its items.
    pub fn length(&mut self, items: usize) {
        self.u32(u32::try_from(items).unwrap_or(u32::MAX));
    }

    /// Writes a string; its length includes the final zero byte.
    pub fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    pub fn sequence(&mut self, values: &[f64]) {
        self.length(values.len());
        values.iter().for_each(|v| self.f64(*v));
    }

    pub fn bytes(self) -> Vec<u8> {
        self.0
    }
}
