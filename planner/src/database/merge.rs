//! Merge of the shards of one database build.

use super::{BuildError, BuildSummary, read, same_origin, summary};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use upswing_process::output::{OutputError, OutputFile};
use upswing_trajectory::{Database, DatabaseHeading, PoseRecord};

/// Merges the shards of one build into `output` and returns the numbers of poses. The order of the files does not matter; the
/// result has the bytes of an unsharded build.
///
/// # Errors
/// [`BuildError`] for missing shards, files of different builds, and poses that differ between files.
pub fn merge(inputs: &[PathBuf], output: &OutputFile) -> Result<BuildSummary, BuildError> {
    // An existing output is tolerated here: it may already be the result of this merge.
    if let Err(e @ OutputError::Io { .. }) = output.check() {
        return Err(e.into());
    }
    let mut records: BTreeMap<u64, (PoseRecord, PathBuf)> = BTreeMap::new();
    let mut first: Option<DatabaseHeading> = None;
    let mut present = BTreeSet::new();
    for path in inputs {
        let database = read(path)?;
        let expected = first.get_or_insert_with(|| database.heading.clone());
        same_origin(path, &database.heading, expected)?;
        if expected.shards != database.heading.shards {
            let (expected, got) = (expected.shards, database.heading.shards);
            return Err(BuildError::Foreign { path: path.clone(), what: "number of shards", expected, got });
        }
        present.insert(database.heading.shard);
        for record in database.records {
            match records.get(&record.pose) {
                // Compared as bytes, because NaN differs from itself.
                Some((known, file)) if known.encode() != record.encode() => {
                    let (first, second) = (file.clone(), path.clone());
                    return Err(BuildError::Disagree { pose: record.pose, first, second });
                }
                Some(_) => {}
                None => {
                    records.insert(record.pose, (record, path.clone()));
                }
            }
        }
    }
    let heading = first.ok_or(BuildError::Nothing)?;
    let missing: Vec<u64> = (1..=heading.shards).filter(|i| !present.contains(i)).collect();
    if !missing.is_empty() {
        return Err(BuildError::Missing { missing, of: heading.shards });
    }
    let (poses, got) = (heading.poses, records.len() as u64);
    if got != poses {
        return Err(BuildError::Incomplete { poses, got });
    }
    let heading = DatabaseHeading { shard: 1, shards: 1, ..heading };
    let database = Database { heading, records: records.into_values().map(|(r, _)| r).collect() };
    let bytes = database.encode();
    if !upswing_config::read_file(output.path()).is_ok_and(|present| present == bytes) {
        output.write(&bytes)?;
    }
    Ok(summary(&database, database.records.len(), 0))
}
