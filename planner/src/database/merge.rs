//! Merge of the shards of one database build.

use super::assemble::{RecordFile, RecordPlace, summary, write};
use super::{BuildError, BuildSummary, DatabaseFile, same_origin};
use std::collections::BTreeSet;
use std::path::PathBuf;
use upswing_process::output::{OutputError, OutputFile};
use upswing_process::shard::Shard;
use upswing_trajectory::{Database, DatabaseHeading, DatabaseSource, RecordScan};

/// Merges the shards of one build into `output` and returns the numbers of poses. The order of the files does not matter; the
/// result has the bytes of an unsharded build. Records stay in the files: memory holds their places and the index of the result. A file
/// of an older version is converted.
///
/// # Errors
/// [`BuildError`] for missing shards, files of different builds, and poses that differ between files.
pub fn merge(inputs: &[PathBuf], output: &OutputFile) -> Result<BuildSummary, BuildError> {
    // An existing output is tolerated here: it may already be the result of this merge.
    if let Err(e @ OutputError::Io { .. }) = output.check() {
        return Err(e.into());
    }
    let mut files = Vec::new();
    let mut records: Vec<RecordPlace> = Vec::new();
    let mut first: Option<DatabaseHeading> = None;
    let mut present = BTreeSet::new();
    for path in inputs {
        let DatabaseFile { source, origin } = DatabaseFile::open(path)?;
        let file = RecordFile { source: checked(source, &origin)?, origin };
        let mut scan = RecordScan::new(&file.source).map_err(file.failed())?;
        let heading = scan.heading();
        let expected = first.get_or_insert_with(|| heading.clone());
        same_origin(path, heading, expected)?;
        if expected.shards != heading.shards {
            let (expected, got) = (expected.shards, heading.shards);
            return Err(BuildError::Foreign { path: path.clone(), what: "number of shards", expected, got });
        }
        present.insert(heading.shard);
        for record in &mut scan {
            let (at, record) = record.map_err(file.failed())?;
            records.push(RecordPlace::new(&record, files.len(), at));
        }
        files.push(file);
    }
    let heading = first.ok_or(BuildError::Nothing)?;
    // Stable: of several records of a pose that of the first file stays.
    records.sort_by_key(|record| record.pose);
    for pair in records.windows(2).filter(|pair| pair[0].pose == pair[1].pose) {
        let [one, other] = [pair[0].read(&files, &heading)?, pair[1].read(&files, &heading)?];
        // Compared as bytes, because NaN differs from itself.
        if one.encode() != other.encode() {
            let [first, second] = [&pair[0], &pair[1]].map(|place| inputs[place.file].clone());
            return Err(BuildError::Disagree { pose: one.pose, first, second });
        }
    }
    records.dedup_by_key(|record| record.pose);
    Shard::check_all(&present, heading.shards)?;
    let (poses, got) = (heading.poses, records.len() as u64);
    if got != poses {
        return Err(BuildError::Incomplete { poses, got });
    }
    let heading = DatabaseHeading { shard: 1, shards: 1, ..heading };
    write(&heading, &files, &records, output)?;
    Ok(summary(&records, records.len(), 0))
}

/// Checks length and index of a finished file; returns the file.
fn checked(source: DatabaseSource, origin: &str) -> Result<DatabaseSource, BuildError> {
    let failed = |cause| BuildError::Database { origin: origin.to_owned(), cause };
    if !RecordScan::new(&source).map_err(failed)?.has_index() {
        return Ok(source);
    }
    Database::load(source).map(Database::into_source).map_err(failed)
}
