//! Writes a database file from records that are in other files: the journal of a build, or shards.

use super::{BuildError, BuildSummary};
use std::io::{self, Read, Write};
use upswing_process::output::{OutputError, OutputFile};
use upswing_trajectory::{
    DatabaseError, DatabaseHeading, DatabaseSource, Index, PoseOutcome, PoseRecord, read_record,
};

/// A file with records.
pub(super) struct RecordFile {
    pub source: DatabaseSource,
    /// Its path, for messages.
    pub origin: String,
}

impl RecordFile {
    /// Converts an error of this file.
    pub fn failed(&self) -> impl Fn(DatabaseError) -> BuildError {
        |cause| BuildError::Database { origin: self.origin.clone(), cause }
    }
}

/// Where the record of a pose is.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordPlace {
    pub pose: u64,
    pub kind: RecordKind,
    /// Number of the file in a list.
    pub file: usize,
    /// Place in the file.
    pub at: u64,
}

/// Outcome of a pose. Entries come first in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum RecordKind {
    Solved,
    Rejected,
    Failed,
}

impl RecordPlace {
    pub fn new(record: &PoseRecord, file: usize, at: u64) -> Self {
        let kind = match record.outcome {
            PoseOutcome::Solved(_) => RecordKind::Solved,
            PoseOutcome::Rejected => RecordKind::Rejected,
            PoseOutcome::Failed => RecordKind::Failed,
        };
        Self { pose: record.pose, kind, file, at }
    }

    /// Reads the record again.
    pub fn read(&self, files: &[RecordFile], heading: &DatabaseHeading) -> Result<PoseRecord, BuildError> {
        let file = &files[self.file];
        read_record(&file.source, heading, (self.pose, self.at)).map_err(file.failed())
    }
}

/// Numbers of the records by their outcome, of `poses` poses, of which `resumed` were there already.
pub(super) fn summary(records: &[RecordPlace], poses: usize, resumed: usize) -> BuildSummary {
    let of = |kind: RecordKind| records.iter().filter(move |record| record.kind == kind);
    BuildSummary {
        poses,
        resumed,
        solved: of(RecordKind::Solved).count(),
        rejected: of(RecordKind::Rejected).count(),
        failed: of(RecordKind::Failed).map(|record| record.pose).collect(),
        left: poses.saturating_sub(records.len()),
    }
}

/// Writes the database of `records`, one per pose and in their order, to `output`. An existing file with the same bytes is not changed.
pub(super) fn write(
    heading: &DatabaseHeading,
    files: &[RecordFile],
    records: &[RecordPlace],
    output: &OutputFile,
) -> Result<(), BuildError> {
    let failed = |cause| OutputError::Io { path: output.path().to_owned(), cause }.into();
    if let Ok(present) = upswing_config::open_file(output.path()) {
        let mut comparison = Comparison { present: io::BufReader::new(present), part: Vec::new() };
        match write_to(&mut comparison, heading, files, records, &failed) {
            Ok(()) if comparison.ends_here() => return Ok(()),
            Ok(()) | Err(BuildError::Output(_)) => {}
            Err(e) => return Err(e),
        }
    }
    let mut pending = output.begin()?;
    write_to(&mut pending, heading, files, records, &failed)?;
    Ok(pending.finish()?)
}

fn write_to(
    out: &mut impl Write,
    heading: &DatabaseHeading,
    files: &[RecordFile],
    records: &[RecordPlace],
    failed: &impl Fn(io::Error) -> BuildError,
) -> Result<(), BuildError> {
    let (entries, others): (Vec<&RecordPlace>, Vec<&RecordPlace>) =
        records.iter().partition(|record| record.kind == RecordKind::Solved);
    out.write_all(&heading.encode(records.len() as u64, entries.len() as u64)).map_err(failed)?;
    let mut index = Index::default();
    for place in entries.into_iter().chain(others) {
        let record = place.read(files, heading)?;
        let bytes = record.encode();
        index.push(&record, &bytes);
        out.write_all(&bytes).map_err(failed)?;
    }
    out.write_all(&index.encode(heading)).map_err(failed)
}

/// Compares what is written with an existing file; the first difference is an error.
struct Comparison<R> {
    present: R,
    part: Vec<u8>,
}

impl<R: Read> Comparison<R> {
    /// Whether the file has no more bytes.
    fn ends_here(mut self) -> bool {
        self.present.read(&mut [0]).is_ok_and(|n| n == 0)
    }
}

impl<R: Read> Write for Comparison<R> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.part.resize(bytes.len(), 0);
        self.present.read_exact(&mut self.part)?;
        if self.part == bytes { Ok(bytes.len()) } else { Err(io::ErrorKind::InvalidData.into()) }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
