//! Common Data Representation (OMG DDS-XTypes, version 1, little-endian), the encoding of ROS 2 messages.

/// Encapsulation header of a message: CDR, little-endian.
pub const HEADER: [u8; 4] = [0, 1, 0, 0];

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

    pub fn u64(&mut self, value: u64) {
        self.align(8);
        self.0.extend(value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
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

/// Reader of a message of numbers, as [`Cdr`] writes it. Its methods return `None` where the message ends early.
pub struct CdrReader<'a> {
    body: &'a [u8],
    at: usize,
}

impl<'a> CdrReader<'a> {
    /// The reader of a message; `None` if its header differs.
    pub fn new(message: &'a [u8]) -> Option<Self> {
        Some(Self { body: message.strip_prefix(&HEADER)?, at: 0 })
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let from = self.at.next_multiple_of(N);
        let bytes = *self.body.get(from..)?.first_chunk()?;
        self.at = from + N;
        Some(bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    /// Length of a sequence of numbers of eight bytes; `None`, too, if the message is too short for them.
    pub fn length(&mut self) -> Option<usize> {
        let items = usize::try_from(self.take().map(u32::from_le_bytes)?).ok()?;
        (items.checked_mul(size_of::<u64>())? <= self.body.len() - self.at).then_some(items)
    }

    pub fn f64(&mut self) -> Option<f64> {
        self.u64().map(f64::from_bits)
    }

    /// Whether all of the message is read.
    pub fn is_empty(&self) -> bool {
        self.at == self.body.len()
    }
}
