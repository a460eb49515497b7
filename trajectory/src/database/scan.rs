//! Records of a file one after the other, without an index: of journals, of files of older versions, and of all files that are merged.

use super::{DatabaseError, DatabaseHeading, DatabaseSource, Header, OPEN_END, PoseRecord};

/// Bytes that are read at once.
const WINDOW: usize = 1 << 20;

/// Reads the records of a finished file or of a journal in the order in which they are in the file.
#[derive(Debug)]
pub struct RecordScan<'a> {
    source: &'a DatabaseSource,
    header: Header,
    /// Bytes of the file.
    size: u64,
    /// Number of the next record.
    number: u64,
    /// Place of the next record.
    at: u64,
    window: Vec<u8>,
    window_at: u64,
}

impl<'a> RecordScan<'a> {
    /// Begins with the header.
    ///
    /// # Errors
    /// [`DatabaseError`] if it is damaged.
    pub fn new(source: &'a DatabaseSource) -> Result<Self, DatabaseError> {
        let header = Header::read(source)?;
        let (size, at) = (source.length()?, header.length);
        Ok(Self { source, header, size, number: 0, at, window: Vec::new(), window_at: 0 })
    }

    /// The robot, settings and grid of the records.
    pub fn heading(&self) -> &DatabaseHeading {
        &self.header.heading
    }

    /// Place of the next record in the file: the bytes before it are whole.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Whether the file has an index, which [`super::Database::load`] checks.
    pub fn has_index(&self) -> bool {
        self.header.has_index()
    }

    fn read(&mut self) -> Result<PoseRecord, DatabaseError> {
        let longest = self.header.heading.long_record() as u64;
        // A record may be shorter than the bytes that are left, never longer than `longest`.
        let end = self.size.min(self.at + longest);
        let window_end = self.window_at + self.window.len() as u64;
        if self.at < self.window_at || end > window_end {
            let length = (self.size - self.at).min(longest.max(WINDOW as u64));
            self.window.resize(length as usize, 0);
            let number = self.number;
            self.window_at = self.at;
            self.source.read(self.at, &mut self.window, || format!("record {number}"))?;
        }
        let bytes = &self.window[(self.at - self.window_at) as usize..(end - self.window_at) as usize];
        let (record, length) = PoseRecord::decode(bytes, self.number, &self.header.heading)?;
        self.at += length as u64;
        self.number += 1;
        Ok(record)
    }
}

/// Each record with its place in the file; after the first error there is no use in going on.
impl Iterator for RecordScan<'_> {
    type Item = Result<(u64, PoseRecord), DatabaseError>;

    fn next(&mut self) -> Option<Self::Item> {
        let records = self.header.records;
        let at = self.at;
        match records {
            // Journals end with the file.
            OPEN_END if at == self.size => None,
            _ if self.number < records => Some(self.read().map(|record| (at, record))),
            // A file without an index ends with its last record.
            _ if !self.header.has_index() && at != self.size => {
                let (what, got) = (format!("{records} records"), std::mem::replace(&mut self.size, at));
                Some(Err(DatabaseError::Length { what, expected: at, got }))
            }
            _ => None,
        }
    }
}

/// Reads the record at a place that a scan of the same file has found.
///
/// # Errors
/// [`DatabaseError`] if it cannot be read or has been damaged since.
pub fn read_record(
    source: &DatabaseSource,
    heading: &DatabaseHeading,
    (number, at): (u64, u64),
) -> Result<PoseRecord, DatabaseError> {
    let left = source.length()?.saturating_sub(at);
    let mut bytes = vec![0; left.min(heading.long_record() as u64) as usize];
    source.read(at, &mut bytes, || format!("record {number}"))?;
    PoseRecord::decode(&bytes, number, heading).map(|(record, _)| record)
}
