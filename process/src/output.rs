//! Output files of commands. An existing file is not changed unless `--force` is given. A file is written to a temporary file in
//! the same folder and renamed, so that a reader sees the old or the new file, and a failed write loses nothing.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::ops::Deref;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// The option of every command that writes files.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct Overwrite {
    /// Overwrite existing files; without --force the command refuses them before it begins
    #[arg(long)]
    pub force: bool,
}

/// Path of an output file, as the value of an option or argument; paths of input files have another type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Destination(PathBuf);

impl From<OsString> for Destination {
    fn from(path: OsString) -> Self {
        Self(path.into())
    }
}

impl Deref for Destination {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Overwrite {
    /// The output file at `path`, which may replace an existing file if `--force` is given.
    pub fn output(self, path: &Path) -> OutputFile {
        OutputFile { path: path.to_owned(), force: self.force }
    }
}

/// Error of writing an output file.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The file exists already.
    #[error("{} exists already, and is not overwritten: choose another name, or --force", path.display())]
    Exists {
        /// Path of the file.
        path: PathBuf,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {cause}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The error of the operating system.
        cause: io::Error,
    },
}

/// An output file, and whether it may replace an existing file.
#[derive(Clone, Debug)]
pub struct OutputFile {
    path: PathBuf,
    force: bool,
}

/// Kind of the path of an output file.
enum PathState {
    Free,
    Occupied,
    /// A terminal, a null device, or an open descriptor of this process: written to directly.
    Stream,
}

impl OutputFile {
    /// An output file that must not exist yet.
    pub fn new(path: &Path) -> Self {
        Overwrite::default().output(path)
    }

    /// Whether an existing file may be replaced.
    pub fn may_replace(&self) -> bool {
        self.force
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The output file `name` in the same folder, which may replace an existing file if this one may.
    pub fn beside(&self, name: &str) -> Self {
        Self { path: self.path.with_file_name(name), force: self.force }
    }

    fn io(&self, cause: io::Error) -> OutputError {
        OutputError::Io { path: self.path.clone(), cause }
    }

    fn state(&self) -> io::Result<PathState> {
        let opened = ["/dev/stdout", "/dev/stderr", "/dev/fd/", "/proc/self/fd/"];
        if self.path.to_str().is_some_and(|path| opened.iter().any(|open| path.starts_with(open))) {
            return Ok(PathState::Stream);
        }
        match self.path.metadata() {
            Ok(state) if state.is_file() => Ok(PathState::Occupied),
            Ok(state) if state.file_type().is_char_device() => Ok(PathState::Stream),
            Ok(state) if state.is_dir() => Err(ErrorKind::IsADirectory.into()),
            // Opening a pipe could block for ever.
            Ok(_) => Err(io::Error::other("it is not a regular file")),
            Err(e) if e.kind() == ErrorKind::NotFound => match self.path.symlink_metadata() {
                Ok(_) => Err(io::Error::other("it is a link to a file that does not exist")),
                Err(_) => Ok(PathState::Free),
            },
            Err(e) => Err(e),
        }
    }

    /// The folder to write to; if the path is a link, the folder of its target.
    fn folder(&self) -> io::Result<PathBuf> {
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        Ok(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned())
    }

    /// Checks that the file can be written, without changing it: before a long run, not after it.
    ///
    /// # Errors
    /// [`OutputError`] if the file exists and may not be replaced, or cannot be written.
    pub fn check(&self) -> Result<(), OutputError> {
        match self.state().map_err(|e| self.io(e))? {
            PathState::Stream => Ok(()),
            PathState::Occupied if !self.force => Err(OutputError::Exists { path: self.path.clone() }),
            PathState::Occupied | PathState::Free => {
                self.folder().and_then(tempfile::tempfile_in).map(drop).map_err(|e| self.io(e))
            }
        }
    }

    /// Removes an existing file that may be replaced, for a file that is written in place, such as a recording.
    ///
    /// # Errors
    /// [`OutputError`] if the file exists and may not be replaced, or cannot be written.
    pub fn clear(&self) -> Result<(), OutputError> {
        self.check()?;
        match self.state().map_err(|e| self.io(e))? {
            PathState::Occupied => std::fs::remove_file(&self.path).map_err(|e| self.io(e)),
            PathState::Free => Ok(()),
            PathState::Stream => Err(self.io(io::Error::other("it is not a regular file"))),
        }
    }

    /// Begins to write; the file appears at its path with [`PendingFile::finish`].
    ///
    /// # Errors
    /// [`OutputError`] if the file exists and may not be replaced, or cannot be written.
    pub fn begin(&self) -> Result<PendingFile, OutputError> {
        self.check()?;
        let open = || -> io::Result<Sink> {
            if !matches!(self.state()?, PathState::Stream) {
                let file = tempfile::Builder::new()
                    .prefix(".upswing-")
                    // As for any other new file, less the umask.
                    .permissions(std::fs::Permissions::from_mode(0o666))
                    .tempfile_in(self.folder()?)?;
                return Ok(Sink::Whole(BufWriter::new(file)));
            }
            // Through the open descriptor, so that later output is appended.
            if self.path == Path::new("/dev/stdout") {
                return Ok(Sink::Stream(Box::new(BufWriter::new(io::stdout()))));
            }
            let file = File::options().append(true).open(&self.path)?;
            Ok(Sink::Stream(Box::new(BufWriter::new(file))))
        };
        let sink = open().map_err(|e| self.io(e))?;
        Ok(PendingFile { output: self.clone(), sink })
    }

    /// Writes `bytes` as the whole file.
    ///
    /// # Errors
    /// [`OutputError`], for example if the disk is full.
    pub fn write(&self, bytes: &[u8]) -> Result<(), OutputError> {
        let mut pending = self.begin()?;
        pending.write_all(bytes).map_err(|e| self.io(e))?;
        pending.finish()
    }
}

enum Sink {
    Stream(Box<dyn Write>),
    Whole(BufWriter<NamedTempFile>),
}

/// An output file being written. Dropped before [`PendingFile::finish`], it leaves no file.
pub struct PendingFile {
    output: OutputFile,
    sink: Sink,
}

impl Write for PendingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.sink {
            Sink::Stream(sink) => sink.write(bytes),
            Sink::Whole(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.sink {
            Sink::Stream(sink) => sink.flush(),
            Sink::Whole(file) => file.flush(),
        }
    }
}

impl PendingFile {
    /// Completes the file and moves it to its path.
    ///
    /// # Errors
    /// [`OutputError`], also if another process has created the file meanwhile.
    pub fn finish(self) -> Result<(), OutputError> {
        let Self { output, sink } = self;
        let file = match sink {
            Sink::Stream(mut sink) => return sink.flush().map_err(|e| output.io(e)),
            Sink::Whole(file) => file.into_inner().map_err(|e| output.io(e.into_error()))?,
        };
        file.as_file().sync_all().map_err(|e| output.io(e))?;
        if output.force {
            let place = output.path.canonicalize().unwrap_or_else(|_| output.path.clone());
            file.persist(place).map(drop).map_err(|e| output.io(e.error))
        } else {
            file.persist_noclobber(&output.path).map(drop).map_err(|e| match e.error.kind() {
                ErrorKind::AlreadyExists => OutputError::Exists { path: output.path.clone() },
                _ => output.io(e.error),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{OutputError, OutputFile, Overwrite, Path};
    use std::io::Write;

    fn names(folder: &Path) -> Vec<String> {
        let name = |e: std::fs::DirEntry| e.file_name().to_string_lossy().into_owned();
        let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().flatten().map(name).collect();
        names.sort();
        names
    }

    #[test]
    fn an_existing_file_stays_unless_it_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        OutputFile::new(&path).write(b"one").unwrap();
        for refused in [
            OutputFile::new(&path).check(),
            OutputFile::new(&path).write(b"two"),
            OutputFile::new(&path).clear(),
        ] {
            assert!(matches!(refused, Err(OutputError::Exists { .. })), "{refused:?}");
        }
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        let forced = Overwrite { force: true }.output(&path);
        forced.check().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        forced.write(b"two").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"two");
        forced.clear().unwrap();
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn what_is_not_finished_loses_nothing_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let forced = Overwrite { force: true }.output(&path);
        forced.write(b"one").unwrap();
        let mut pending = forced.begin().unwrap();
        pending.write_all(b"two").unwrap();
        drop(pending);
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
        assert_eq!(names(folder.path()), ["a"]);
        // Another process creates the file meanwhile.
        let other = folder.path().join("b");
        let mut pending = OutputFile::new(&other).begin().unwrap();
        pending.write_all(b"two").unwrap();
        std::fs::write(&other, b"theirs").unwrap();
        assert!(matches!(pending.finish(), Err(OutputError::Exists { .. })));
        assert_eq!(
            (std::fs::read(&other).unwrap(), names(folder.path())),
            (b"theirs".to_vec(), vec!["a".into(), "b".into()])
        );
    }

    #[test]
    fn devices_are_written_and_pipes_and_folders_refused() {
        OutputFile::new(Path::new("/dev/null")).write(b"one").unwrap();
        let full = OutputFile::new(Path::new("/dev/full"));
        full.check().unwrap();
        assert!(full.write(b"one").unwrap_err().to_string().contains("/dev/full"));
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let nowhere = folder.path().join("nowhere");
        std::os::unix::fs::symlink(folder.path().join("c"), &nowhere).unwrap();
        for path in [&pipe, &nowhere, &folder.path().to_owned(), &folder.path().join("none/a")] {
            for force in [false, true] {
                let output = Overwrite { force }.output(path);
                assert!(matches!(output.check(), Err(OutputError::Io { .. })), "{}", path.display());
                assert!(output.write(b"one").is_err() && output.clear().is_err());
            }
        }
        // A link remains a link.
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::fs::write(&file, b"one").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert!(OutputFile::new(&link).check().is_err());
        Overwrite { force: true }.output(&link).write(b"two").unwrap();
        assert!(link.is_symlink() && std::fs::read(&file).unwrap() == b"two");
    }
}
