//! Directories, file names and permission bits that iceoryx2 0.10 uses for the files of one domain.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{Error, ErrorKind};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Directory of all shared memory of the machine.
const SHM: &str = "/dev/shm";
/// Digits of the hash (SHA-1 of a type name) that follows the prefix in the name of a shared-memory file.
pub(crate) const TYPE_HASH_DIGITS: usize = 40;
/// Age from which an unfinished connection, node or tag counts as left over. iceoryx2 creates connections while it sends
/// and receives, and programs in other languages create nodes: both without the creation lock, within milliseconds.
const LEFTOVER_AGE: Duration = Duration::from_secs(2);
/// Permission bits of a file's owner.
const OWNER_READ: u32 = 0o400;
const OWNER_WRITE: u32 = 0o200;

/// Paths of one domain: directory `/dev/shm/upswing.<name>.iox/`, shared memory `/dev/shm/upswing_<name>_*`.
#[derive(Clone, PartialEq, Eq)]
pub(crate) struct Layout {
    /// The directory of the domain; iceoryx2's `global.root_path`.
    pub(crate) root: PathBuf,
    /// How the names of all its shared memory begin; iceoryx2's `global.prefix`.
    pub(crate) prefix: String,
}

impl Layout {
    /// The paths of the domain `name`.
    pub(crate) fn new(name: &str) -> Self {
        Self { root: format!("{SHM}/upswing.{name}.iox").into(), prefix: format!("upswing_{name}_") }
    }

    /// Names of all domains that have a directory, in no order.
    pub(crate) fn names() -> impl Iterator<Item = String> {
        let entries = std::fs::read_dir(SHM).into_iter().flatten().flatten();
        entries.filter_map(|entry| {
            let file = entry.file_name().into_string().ok()?;
            Some(file.strip_prefix("upswing.")?.strip_suffix(".iox")?.to_owned())
        })
    }

    /// Path of the file that [`super::CreationLock`] locks.
    pub(crate) fn creation_lock(&self) -> PathBuf {
        self.root.join("creation.lock")
    }

    /// Path of the settings that iceoryx2 reads in every process of the domain.
    pub(crate) fn settings(&self) -> PathBuf {
        self.root.join("iceoryx2.toml")
    }

    /// Directory in which iceoryx2 keeps the nodes of the domain.
    pub(crate) fn nodes(&self) -> PathBuf {
        self.root.join("nodes")
    }

    /// The descriptions of the services of the domain, one file each.
    pub(crate) fn descriptions(&self) -> impl Iterator<Item = PathBuf> + use<> {
        files(&self.root.join("services"))
    }

    /// The shared-memory files of the domain.
    pub(crate) fn memory(&self) -> impl Iterator<Item = PathBuf> {
        let entries = std::fs::read_dir(SHM).into_iter().flatten().flatten();
        // Nothing else is opened: a pipe would block.
        let files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
        let owned = files.filter(|entry| entry.file_name().to_str().is_some_and(|file| self.owns(file)));
        owned.map(|entry| entry.path())
    }

    /// Whether the file `file` in [`SHM`] belongs to this domain. The prefix alone does not tell: that of `a` also begins
    /// the files of `a_b`. The hash that follows it does: it is longer than any name of a domain.
    fn owns(&self, file: &str) -> bool {
        file.strip_prefix(&self.prefix).and_then(|rest| rest.split_once('_')).is_some_and(|(hash, _)| {
            hash.len() == TYPE_HASH_DIGITS && hash.bytes().all(|b| b.is_ascii_hexdigit())
        })
    }
}

/// Entries of a directory; none if it cannot be read.
pub(super) fn files(directory: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    std::fs::read_dir(directory).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// Opens the file at `path` for writing, and creates it if it is missing.
///
/// # Errors
/// Of the operating system, and if it is not a regular file: a pipe without a reader would block for good.
pub(crate) fn open_regular_file(path: &Path) -> std::io::Result<File> {
    let odd = || Error::new(ErrorKind::InvalidInput, "it is not a regular file");
    if path.symlink_metadata().is_ok_and(|state| !state.is_file()) {
        return Err(odd());
    }
    // It may have been replaced since.
    let flags = libc::O_NONBLOCK | libc::O_NOFOLLOW;
    let file = OpenOptions::new().create(true).truncate(false).write(true).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(odd()) }
}

/// Whether a shared-memory file is unfinished: iceoryx2 lets the owner read it only once it is complete.
pub(super) fn is_unfinished_memory(path: &Path, state: &Metadata) -> bool {
    !is_readable(state) && (!is_connection(path) || is_old(state))
}

/// Whether the description of a service, or a tag, is unfinished: iceoryx2 makes it read-only once it is complete.
pub(super) fn is_unfinished_text(state: &Metadata) -> bool {
    state.mode() & OWNER_WRITE != 0
}

/// Whether the owner may read a file.
pub(super) fn is_readable(state: &Metadata) -> bool {
    state.mode() & OWNER_READ != 0
}

/// Whether a shared-memory file is a connection between two ports, `*_<sender>_<receiver>.connection`.
pub(super) fn is_connection(path: &Path) -> bool {
    has_suffix(path, "connection")
}

/// Ids of the two ports of a connection.
pub(super) fn ports_of_connection(path: &Path) -> Option<[&str; 2]> {
    let mut parts = path.file_stem()?.to_str()?.rsplit('_');
    is_connection(path).then_some(())?;
    Some([parts.next()?, parts.next()?])
}

/// The id with which iceoryx2 ends the name of a file that belongs to one node or port.
pub(super) fn id(path: &Path) -> Option<String> {
    let number = path.file_stem()?.to_str()?.rsplit('_').next()?;
    number.bytes().all(|b| b.is_ascii_digit()).then(|| number.to_owned())
}

/// Whether the name of a file ends in `.suffix`.
pub(super) fn has_suffix(path: &Path, suffix: &str) -> bool {
    path.extension().is_some_and(|found| found == suffix)
}

/// Whether nobody has worked at a file for [`LEFTOVER_AGE`].
pub(super) fn is_old(state: &Metadata) -> bool {
    state.modified().ok().and_then(|t| t.elapsed().ok()).is_some_and(|age| age > LEFTOVER_AGE)
}
