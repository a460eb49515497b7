//! Files of runs: a shard of a study appends its runs to one, and the files of all shards together give the result of the whole study.
//!
//! A file is lines of text: 16 hexadecimal digits, the XXH3 checksum of the rest of the line, a space, and JSON. The first line says what
//! study and which shard it is; each of the others is one run. A line that a killed process has left incomplete is not a run.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, HashMap};
use std::fmt::Debug;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use upswing_process::output::OutputFile;
use upswing_process::shard::{JournalError, MissingShards, Shard, open_journal};
use xxhash_rust::xxh3::xxh3_64;

/// What determines the results of a study.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StudyIdentity {
    /// Name of the study, as on the command line.
    pub study: &'static str,
    /// Fingerprint of settings, database and options.
    pub fingerprint: u64,
}

impl StudyIdentity {
    /// The identity of a study with these `options`, shown as text, which determine its results.
    pub fn new(study: &'static str, options: &dyn Debug) -> Self {
        Self { study, fingerprint: xxh3_64(format!("{options:?}").as_bytes()) }
    }
}

/// First line of a file.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Heading {
    /// Version of the format.
    version: u32,
    study: String,
    fingerprint: String,
    shard: u64,
    shards: u64,
}

/// One run.
#[derive(Serialize, Deserialize)]
struct Run<T> {
    part: usize,
    job: u64,
    result: T,
}

/// A run whose result is not looked at.
#[derive(Deserialize)]
struct RunNumber {
    part: usize,
    job: u64,
}

const VERSION: u32 = 1;

/// Error of a file of runs.
#[derive(Debug, thiserror::Error)]
pub enum RunsError {
    /// The file cannot be opened for appending.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The file cannot be read or written.
    #[error("cannot {action} {}: {cause}", path.display())]
    File {
        /// Verb of the operation.
        action: &'static str,
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: std::io::Error,
    },
    /// The file is something else, or damaged.
    #[error("{}, line {line}: expected {expected}", path.display())]
    Damaged {
        /// Path of the file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What the line should be.
        expected: &'static str,
    },
    /// The file belongs to another study, other settings or another shard.
    #[error("{}: {what} is {got}, expected {expected}; use the settings and options that it was made with, or another file", path.display())]
    Foreign {
        /// Path of the file.
        path: PathBuf,
        /// Name of what differs.
        what: &'static str,
        /// Expected value.
        expected: String,
        /// Value in the file.
        got: String,
    },
    /// The output file has other contents.
    #[error("{0}; or --force, which begins anew")]
    Occupied(Box<RunsError>),
    /// Two files are of the same shard.
    #[error("{} and {} are both shard {shard}; name each shard once", first.display(), second.display())]
    Twice {
        /// Path of one file.
        first: PathBuf,
        /// Path of the other file.
        second: PathBuf,
        /// Number of the shard, from 1.
        shard: u64,
    },
    /// Files are missing.
    #[error(transparent)]
    Missing(#[from] MissingShards),
    /// A shard is not finished.
    #[error("shard {shard} of {of} is not finished: run it again, it goes on from where it ended")]
    Unfinished {
        /// Number of the shard, from 1.
        shard: u64,
        /// Number of shards.
        of: u64,
    },
}

/// Runs in files: those of a shard, to which new ones are appended, or those of all shards of a study.
#[derive(Debug)]
pub struct StudyRuns {
    shard: Shard,
    /// JSON of the known runs, by part of the study and number of the job.
    known: HashMap<(usize, u64), String>,
    /// File of the shard, with the error of the last write; `None` for a merge.
    journal: Option<Mutex<Result<File, RunsError>>>,
    path: PathBuf,
}

/// A file of runs that has been read.
struct RunFile {
    heading: Heading,
    runs: HashMap<(usize, u64), String>,
    /// Bytes of its complete lines.
    length: u64,
}

/// Reads the complete lines of a file; `None` without a first line, or with a part of `first` only.
fn read(path: &Path, file: &mut File, first: &str) -> Result<Option<RunFile>, RunsError> {
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(|cause| RunsError::File {
        action: "read",
        path: path.to_owned(),
        cause,
    })?;
    let mut lines = bytes.split_inclusive(|byte| *byte == b'\n').peekable();
    let mut found: Option<RunFile> = None;
    let mut line = 0;
    while let Some(text) = lines.next() {
        line += 1;
        let damaged = |expected| RunsError::Damaged { path: path.to_owned(), line, expected };
        let Some(json) = unseal(text) else {
            // What a killed process was writing.
            let own = found.is_some() || first.as_bytes().starts_with(text);
            if lines.peek().is_none() && !text.ends_with(b"\n") && own {
                break;
            }
            return Err(damaged("a line of a file of runs with its checksum"));
        };
        match &mut found {
            None => {
                let heading = serde_json::from_str(json).map_err(|_| damaged("a study and its shard"))?;
                found = Some(RunFile { heading, runs: HashMap::new(), length: 0 });
            }
            Some(file) => {
                let run: RunNumber = serde_json::from_str(json).map_err(|_| damaged("a run"))?;
                file.runs.insert((run.part, run.job), json.to_owned());
            }
        }
        if let Some(file) = &mut found {
            file.length += text.len() as u64;
        }
    }
    Ok(found)
}

/// A line with its checksum.
fn seal(value: &impl Serialize) -> Result<String, serde_json::Error> {
    let json = serde_json::to_string(value)?;
    Ok(format!("{:016x} {json}\n", xxh3_64(json.as_bytes())))
}

/// The JSON of a complete line.
fn unseal(line: &[u8]) -> Option<&str> {
    let line = std::str::from_utf8(line).ok()?.strip_suffix('\n')?;
    let (sum, json) = line.split_once(' ')?;
    (u64::from_str_radix(sum, 16).ok()? == xxh3_64(json.as_bytes())).then_some(json)
}

impl Heading {
    fn new(identity: &StudyIdentity, shard: Shard) -> Self {
        Self {
            version: VERSION,
            study: identity.study.into(),
            fingerprint: format!("{:016x}", identity.fingerprint),
            shard: shard.number,
            shards: shard.of,
        }
    }

    /// Checks that the file is of this study; and, unless it is for a merge, of this shard.
    fn check(&self, path: &Path, expected: &Self, same_shard: bool) -> Result<(), RunsError> {
        let pairs = [
            ("format version", expected.version.to_string(), self.version.to_string()),
            ("study", expected.study.clone(), self.study.clone()),
            ("fingerprint of settings and options", expected.fingerprint.clone(), self.fingerprint.clone()),
            ("number of shards", expected.shards.to_string(), self.shards.to_string()),
            ("shard", expected.shard.to_string(), self.shard.to_string()),
        ];
        let pairs = pairs.into_iter().take(if same_shard { 5 } else { 4 });
        for (what, expected, got) in pairs {
            if expected != got {
                return Err(RunsError::Foreign { path: path.to_owned(), what, expected, got });
            }
        }
        Ok(())
    }
}

impl StudyRuns {
    /// Opens the file of a shard, and reads the runs that are there already. A file with other contents is replaced if it may be.
    ///
    /// # Errors
    /// [`RunsError`] if the file cannot be used, or belongs to another study or shard and may not be replaced.
    pub fn of_shard(identity: &StudyIdentity, shard: Shard, output: &OutputFile) -> Result<Self, RunsError> {
        let path = output.path();
        let failed = |cause| RunsError::File { action: "write", path: path.to_owned(), cause };
        let mut file = open_journal(path)?;
        let heading = Heading::new(identity, shard);
        let first = seal(&heading).map_err(|e| failed(e.into()))?;
        let present = match read(path, &mut file, &first).and_then(|found| match found {
            Some(found) => found.heading.check(path, &heading, true).map(|()| Some(found)),
            None => Ok(None),
        }) {
            Ok(found) => found,
            Err(_) if output.may_replace() => None,
            Err(e) => return Err(RunsError::Occupied(Box::new(e))),
        };
        let known = match present {
            Some(present) => {
                file.set_len(present.length).map_err(failed)?;
                present.runs
            }
            None => {
                file.set_len(0).and_then(|()| file.write_all(first.as_bytes())).map_err(failed)?;
                HashMap::new()
            }
        };
        Ok(Self { shard, known, journal: Some(Mutex::new(Ok(file))), path: path.to_owned() })
    }

    /// Reads the files of all shards of a study.
    ///
    /// # Errors
    /// [`RunsError`] if one of them cannot be used, belongs to another study, is there twice or missing.
    pub fn merged(identity: &StudyIdentity, paths: &[PathBuf]) -> Result<Self, RunsError> {
        let mut of = 1;
        let mut known = HashMap::new();
        let mut present: HashMap<u64, &Path> = HashMap::new();
        for path in paths {
            let opened = upswing_config::open_file(path);
            let mut file =
                opened.map_err(|cause| RunsError::File { action: "read", path: path.clone(), cause })?;
            let RunFile { heading, runs, .. } = read(path, &mut file, "")?.ok_or(RunsError::Damaged {
                path: path.clone(),
                line: 1,
                expected: "a study and its shard",
            })?;
            if present.is_empty() {
                of = heading.shards;
            }
            heading.check(path, &Heading::new(identity, Shard { number: 1, of }), false)?;
            let shard = heading.shard;
            if shard == 0 || shard > of {
                let (expected, got) = (format!("1 to {of}"), shard.to_string());
                return Err(RunsError::Foreign { path: path.clone(), what: "shard", expected, got });
            }
            if let Some(first) = present.insert(shard, path) {
                let (first, second) = (first.to_owned(), path.clone());
                return Err(RunsError::Twice { first, second, shard });
            }
            known.extend(runs);
        }
        Shard::check_all(&present.keys().copied().collect::<BTreeSet<_>>(), of)?;
        let path = paths.first().cloned().unwrap_or_default();
        Ok(Self { shard: Shard { number: 1, of }, known, journal: None, path })
    }

    /// Number of runs that were in the files.
    pub fn known(&self) -> usize {
        self.known.len()
    }

    /// Whether job number `job` is not to be run: it belongs to another shard.
    pub(super) fn skips(&self, job: u64) -> bool {
        self.journal.is_some() && !self.shard.contains(job)
    }

    /// The result of a known run.
    ///
    /// # Errors
    /// [`RunsError`] if it is damaged, or if a merge lacks it.
    pub(super) fn result<T: DeserializeOwned>(&self, part: usize, job: u64) -> Result<Option<T>, RunsError> {
        match self.known.get(&(part, job)) {
            Some(json) => match serde_json::from_str::<Run<T>>(json) {
                Ok(run) => Ok(Some(run.result)),
                Err(_) => Err(RunsError::Damaged {
                    path: self.path.clone(),
                    line: 0,
                    expected: "runs of this study",
                }),
            },
            None if self.journal.is_none() => {
                let of = self.shard.of;
                Err(RunsError::Unfinished { shard: job % of + 1, of })
            }
            None => Ok(None),
        }
    }

    /// Appends a run. Errors are kept for [`Self::finish`], and end the study.
    pub(super) fn append<T: Serialize>(&self, part: usize, job: u64, result: &T) {
        let Some(Ok(mut journal)) = self.journal.as_ref().map(Mutex::lock) else { return };
        let Ok(file) = &mut *journal else { return };
        let written = seal(&Run { part, job, result }).map_err(std::io::Error::from);
        if let Err(cause) = written.and_then(|line| file.write_all(line.as_bytes())) {
            *journal = Err(RunsError::File { action: "write", path: self.path.clone(), cause });
        }
    }

    /// Whether an append has failed.
    pub(super) fn failed(&self) -> bool {
        self.journal.as_ref().is_some_and(|journal| journal.lock().map_or(true, |journal| journal.is_err()))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// That of the append which failed.
    pub fn finish(self) -> Result<(), RunsError> {
        let Some(journal) = self.journal else { return Ok(()) };
        let file = journal.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)?;
        file.sync_all().map_err(|cause| RunsError::File { action: "write", path: self.path, cause })
    }
}
