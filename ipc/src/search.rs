//! Looking for writers in a thread of its own, for threads that must not wait for other processes.

use crate::blackboard::Reader;
use crate::error::IpcError;
use crate::node::Node;
use crate::services::Latest;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Pause between two looks; one costs some 0.5 to 1 ms.
const PERIOD: Duration = Duration::from_millis(50);
/// How long to wait for the thread to end. It may hang in iceoryx2 if another process is stopped in the middle of its work.
const PATIENCE: Duration = Duration::from_millis(500);

/// How long to wait for the next value of a writer that is gone, and of one that lives: its machine may have no time for it, or
/// fetch its program from a disk that is busy.
const LOST_AFTER: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(20));

/// Whether a writer for which others wait is lost: `waited` is how long they have, not counting when they could not run
/// themselves, `lives` what [`Search::lives`] says of it.
pub fn is_lost(lives: bool, waited: Duration) -> bool {
    waited > if lives { LOST_AFTER.1 } else { LOST_AFTER.0 }
}

/// Looks for the newest living writer of a channel, again and again, until dropped. Outlives the readers that it hands out:
/// then dropping one only counts down.
pub struct Search<T: Latest> {
    found: Receiver<Result<Option<Reader<T>>, IpcError>>,
    lives: Arc<AtomicBool>,
    done: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl<T: Latest> Search<T> {
    /// Starts the thread.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn start(node: &Node) -> std::io::Result<Self> {
        let (sender, found) = mpsc::channel();
        let done = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&done);
        let lives = Arc::new(AtomicBool::new(false));
        let life = Arc::clone(&lives);
        let node = node.clone();
        let search = move || {
            let wanted = || !ended.load(Ordering::Acquire);
            let mut finder = node.finder::<T>();
            let mut first = true;
            let mut failing = false;
            while wanted() {
                let look = finder.poll_while(&wanted);
                // An error that persists is told once.
                let news = match &look {
                    Ok(found) => first || found.is_some(),
                    Err(_) => first || !failing,
                };
                failing = look.is_err();
                life.store(finder.lives(), Ordering::Relaxed);
                first = false;
                if news && sender.send(look).is_err() {
                    break;
                }
                std::thread::park_timeout(PERIOD);
            }
        };
        let thread = Builder::new().name("search".into()).spawn(search)?;
        Ok(Self { found, lives, done, thread: Some(thread) })
    }

    /// Waits for the first look, and returns what it found.
    ///
    /// # Errors
    /// As [`crate::Finder::poll`].
    pub fn first(&self) -> Result<Option<Reader<T>>, IpcError> {
        self.found.recv().unwrap_or(Ok(None))
    }

    /// Whether the writer found last lives; never waits. Some 50 ms late, or more where others hold up the cleaning up.
    pub fn lives(&self) -> bool {
        self.lives.load(Ordering::Relaxed)
    }

    /// What was found, or went wrong, since the last call; never waits, no system call if that is nothing.
    ///
    /// # Errors
    /// As [`crate::Finder::poll`]; one that persists comes once.
    pub fn take(&self) -> Result<Option<Reader<T>>, IpcError> {
        loop {
            match self.found.try_recv() {
                // Of a first look that found nothing.
                Ok(Ok(None)) => {}
                Ok(news) => return news,
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => return Ok(None),
            }
        }
    }
}

impl<T: Latest> Drop for Search<T> {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Release);
        let Some(thread) = self.thread.take() else { return };
        thread.thread().unpark();
        let begin = Instant::now();
        while !thread.is_finished() && begin.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(1));
        }
        if thread.is_finished() {
            // A panic in it was reported by the panic hook.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::is_lost;
    use std::time::Duration;

    #[test]
    fn who_lives_is_waited_for_longer_than_who_is_gone() {
        for (lives, ms, lost) in
            [(false, 999, false), (false, 1001, true), (true, 19_999, false), (true, 20_001, true)]
        {
            assert_eq!(is_lost(lives, Duration::from_millis(ms)), lost, "{lives}, {ms} ms");
        }
    }
}
