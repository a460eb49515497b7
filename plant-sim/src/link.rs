//! Commands of the daemon: found in one thread, taken in the other.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender};
use std::time::Duration;
use tracing::warn;
use upswing_ipc::{Command, Node, Reader};

/// How often a daemon is looked for; one look costs some 0.5 ms.
const SEARCH_PERIOD: Duration = Duration::from_millis(20);

/// Looks for daemons until `done` and hands over each one found; first, at once, what the first look found.
///
/// It has a thread of its own because a look takes several control periods. Unpark the thread to end it soon.
pub(crate) fn search(node: &Node, found: &Sender<Option<Reader<Command>>>, done: &AtomicBool) {
    let mut finder = node.finder::<Command>();
    let mut first = true;
    let mut failing = false;
    while !done.load(Ordering::Acquire) {
        let reader = finder.poll();
        if let Err(e) = &reader
            && !failing
        {
            warn!("cannot look for a daemon: {e}");
        }
        failing = reader.is_err();
        let reader = reader.ok().flatten();
        if (first || reader.is_some()) && found.send(reader).is_err() {
            break;
        }
        first = false;
        std::thread::park_timeout(SEARCH_PERIOD);
    }
}

/// The commands of the newest daemon. Nothing in them is trusted.
pub(crate) struct Link {
    found: Receiver<Option<Reader<Command>>>,
    daemon: Option<Daemon>,
}

struct Daemon {
    reader: Reader<Command>,
    /// `seq` of the last command looked at.
    seq: u64,
}

impl Link {
    /// Waits for the first look of [`search`]. Call it before the first measurement is published: a command that is
    /// there already answers another plant, and is never taken.
    pub(crate) fn new(found: Receiver<Option<Reader<Command>>>) -> Self {
        let daemon = found.recv().ok().flatten().map(|reader| Daemon { seq: reader.read().seq, reader });
        Self { found, daemon }
    }

    /// The newest command, if it was not looked at before and answers one of the measurements 1..=`newest`. Commands
    /// of older daemons and of older cycles are ignored. No system call unless a new daemon was found.
    pub(crate) fn take(&mut self, newest: u64) -> Option<Command> {
        while let Ok(reader) = self.found.try_recv() {
            if let Some(reader) = reader {
                self.daemon = Some(Daemon { reader, seq: 0 });
            }
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
