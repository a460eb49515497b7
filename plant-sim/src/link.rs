//! Commands of the daemon.

use tracing::warn;
use upswing_ipc::{Command, IpcError, Node, Reader, Search};

/// The commands of the newest daemon. Nothing in them is trusted.
pub(crate) struct Link {
    daemon: Option<Daemon>,
    // Outlives the readers.
    search: Search<Command>,
}

struct Daemon {
    reader: Reader<Command>,
    /// `seq` of the last command looked at.
    seq: u64,
}

impl Link {
    /// Waits for the first look. Call it before the first measurement is published: a command that is there already
    /// answers another plant, and is never taken.
    ///
    /// # Errors
    /// If no thread can be started.
    pub(crate) fn new(node: &Node) -> std::io::Result<Self> {
        let search = Search::start(node)?;
        let daemon = warned(search.first()).map(|reader| Daemon { seq: reader.read().seq, reader });
        Ok(Self { daemon, search })
    }

    /// Whether the newest daemon lives.
    pub(crate) fn daemon_lives(&self) -> bool {
        self.search.lives()
    }

    /// The newest command, if it was not looked at before and answers one of the measurements 1..=`newest`. Commands
    /// of older daemons and of older cycles are ignored. No system call unless a new daemon was found.
    pub(crate) fn take(&mut self, newest: u64) -> Option<Command> {
        while let Some(reader) = warned(self.search.take()) {
            self.daemon = Some(Daemon { reader, seq: 0 });
        }
        let daemon = self.daemon.as_mut()?;
        let command = daemon.reader.read();
        if command.seq <= daemon.seq {
            return None;
        }
        daemon.seq = command.seq;
        (1..=newest).contains(&command.measurement_seq).then_some(command)
    }
}

fn warned(found: Result<Option<Reader<Command>>, IpcError>) -> Option<Reader<Command>> {
    found.unwrap_or_else(|e| {
        warn!("cannot look for a daemon: {e}");
        None
    })
}
