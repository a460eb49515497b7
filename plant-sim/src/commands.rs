//! Reader of the daemon's commands in shared memory.

use tracing::warn;
use upswing_ipc::{Command, Commands, FinderThread, IpcError, Node, Reader};

/// Reader of the commands of the newest daemon; their contents are not trusted.
pub(crate) struct DaemonCommands {
    daemon: Option<FoundDaemon>,
    // Declared last, so that it outlives the reader.
    finder: FinderThread<Command>,
}

/// Commands of a daemon that was found.
struct FoundDaemon {
    reader: Reader<Command>,
    /// `seq` of the newest command that was read.
    seq: u64,
}

impl DaemonCommands {
    /// Starts the search for daemons and waits for its first result. To be called before the first measurement is published: a
    /// command that exists already answers another plant, and is never taken.
    ///
    /// # Errors
    /// If the thread of the search cannot be started.
    pub(crate) fn new(node: &Node) -> std::io::Result<Self> {
        let finder = FinderThread::start(node)?;
        let daemon = logged(finder.first()).map(|reader| FoundDaemon { seq: reader.read().seq, reader });
        Ok(Self { daemon, finder })
    }
}

impl Commands for DaemonCommands {
    /// No system call unless a new daemon was found.
    fn take(&mut self, newest: u64) -> Option<Command> {
        while let Some(reader) = logged(self.finder.poll()) {
            self.daemon = Some(FoundDaemon { reader, seq: 0 });
        }
        let daemon = self.daemon.as_mut()?;
        let command = daemon.reader.read();
        if command.seq <= daemon.seq {
            return None;
        }
        daemon.seq = command.seq;
        (1..=newest).contains(&command.measurement_seq).then_some(command)
    }

    fn daemon_lives(&self) -> bool {
        self.finder.writer_is_alive()
    }
}

/// The reader of the commands of a daemon, if one was found; an error is logged.
fn logged(found: Result<Option<Reader<Command>>, IpcError>) -> Option<Reader<Command>> {
    found.unwrap_or_else(|e| {
        warn!("cannot look for a daemon: {e}");
        None
    })
}
