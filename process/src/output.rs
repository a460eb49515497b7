//! Files that commands write, and the one rule for those that exist already: they are left as they are unless `--force` is
//! given. A file is written beside its place and renamed, so that a reader sees the old one or the new one, and a write that
//! fails loses nothing.

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

/// Path of an output file, as the value of an option or argument; input files have another type.
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
    /// The file at `path` under this rule.
    pub fn output(self, path: &Path) -> Output {
        Output { path: path.to_owned(), force: self.force }
    }
}

/// Why a file cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The file exists already.
    #[error("{} exists already, and is not overwritten: choose another name, or --force", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        cause: io::Error,
    },
}

/// A file to be written, and whether it may replace one.
#[derive(Clone, Debug)]
pub struct Output {
    path: PathBuf,
    force: bool,
}

/// Kind of an output file.
enum Place {
    Free,
    Occupied,
    /// A terminal, a null device, or what this process has open: written to as it is.
    Stream,
}

impl Output {
    /// A file that must not exist yet.
    pub fn new(path: &Path) -> Self {
        Overwrite::default().output(path)
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file beside it, under the same rule.
    pub fn beside(&self, name: &str) -> Self {
        Self { path: self.path.with_file_name(name), force: self.force }
    }

    fn io(&self, cause: io::Error) -> OutputError {
        OutputError::Io { path: self.path.clone(), cause }
    }

    fn place(&self) -> io::Result<Place> {
        let opened = ["/dev/stdout", "/dev/stderr", "/dev/fd/", "/proc/self/fd/"];
        if self.path.to_str().is_some_and(|path| opened.iter().any(|open| path.starts_with(open))) {
            return Ok(Place::Stream);
        }
        match self.path.metadata() {
            Ok(state) if state.is_file() => Ok(Place::Occupied),
            Ok(state) if state.file_type().is_char_device() => Ok(Place::Stream),
            Ok(state) if state.is_dir() => Err(ErrorKind::IsADirectory.into()),
            // Opening a pipe could wait for ever.
            Ok(_) => Err(io::Error::other("it is not a regular file")),
            Err(e) if e.kind() == ErrorKind::NotFound => match self.path.symlink_metadata() {
                Ok(_) => Err(io::Error::other("it is a link to a file that does not exist")),
                Err(_) => Ok(Place::Free),
            },
            Err(e) => Err(e),
        }
    }

    /// The folder to write in; where the path is a link, that of the file behind it.
    fn folder(&self) -> io::Result<PathBuf> {
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        Ok(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned())
    }

    /// Whether it can be written, without changing anything: to know it before a long run, not after it.
    ///
    /// # Errors
    /// [`OutputError`]
    pub fn check(&self) -> Result<(), OutputError> {
        match self.place().map_err(|e| self.io(e))? {
            Place::Stream => Ok(()),
            Place::Occupied if !self.force => Err(OutputError::Exists { path: self.path.clone() }),
            Place::Occupied | Place::Free => {
                self.folder().and_then(tempfile::tempfile_in).map(drop).map_err(|e| self.io(e))
            }
        }
    }

    /// Makes room for a file that is written piece by piece in its place, such as a recording: what may be replaced is removed.
    ///
    /// # Errors
    /// [`OutputError`]
    pub fn clear(&self) -> Result<(), OutputError> {
        self.check()?;
        match self.place().map_err(|e| self.io(e))? {
            Place::Occupied => std::fs::remove_file(&self.path).map_err(|e| self.io(e)),
            Place::Free => Ok(()),
            Place::Stream => Err(self.io(io::Error::other("it is not a regular file"))),
        }
    }

    /// Begins to write; nothing is at the path before [`Pending::finish`].
    ///
    /// # Errors
    /// [`OutputError`]
    pub fn begin(&self) -> Result<Pending, OutputError> {
        self.check()?;
        let open = || -> io::Result<Sink> {
            if !matches!(self.place()?, Place::Stream) {
                let file = tempfile::Builder::new()
                    .prefix(".upswing-")
                    // As any other new file, less the umask.
                    .permissions(std::fs::Permissions::from_mode(0o666))
                    .tempfile_in(self.folder()?)?;
                return Ok(Sink::Whole(BufWriter::new(file)));
            }
            // Through the descriptor that is open already: what is printed later comes behind.
            if self.path == Path::new("/dev/stdout") {
                return Ok(Sink::Stream(Box::new(BufWriter::new(io::stdout()))));
            }
            let file = File::options().append(true).open(&self.path)?;
            Ok(Sink::Stream(Box::new(BufWriter::new(file))))
        };
        let sink = open().map_err(|e| self.io(e))?;
        Ok(Pending { output: self.clone(), sink })
    }

    /// Writes all of it.
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

/// A file that is being written. Dropped before its end it leaves nothing behind.
pub struct Pending {
    output: Output,
    sink: Sink,
}

impl Write for Pending {
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

impl Pending {
    /// Completes the file and puts it in its place.
    ///
    /// # Errors
    /// [`OutputError`], also if somebody else has made the file meanwhile.
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
    use super::{Output, OutputError, Overwrite, Path};
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
        Output::new(&path).write(b"one").unwrap();
        for refused in
            [Output::new(&path).check(), Output::new(&path).write(b"two"), Output::new(&path).clear()]
        {
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
        // Made by somebody else meanwhile.
        let other = folder.path().join("b");
        let mut pending = Output::new(&other).begin().unwrap();
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
        Output::new(Path::new("/dev/null")).write(b"one").unwrap();
        let full = Output::new(Path::new("/dev/full"));
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
        // A link stays one.
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::fs::write(&file, b"one").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert!(Output::new(&link).check().is_err());
        Overwrite { force: true }.output(&link).write(b"two").unwrap();
        assert!(link.is_symlink() && std::fs::read(&file).unwrap() == b"two");
    }
}
