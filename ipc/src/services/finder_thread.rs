//! A finder of writers in a thread of its own, for threads that must not wait for other processes.

use super::blackboard::{BlackboardPayload, Reader};
use crate::error::IpcError;
use crate::node::Node;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Pause between two looks for a writer; one takes 0.5 to 1 ms.
const PERIOD: Duration = Duration::from_millis(50);
/// How long a drop waits for the thread to end. The thread may hang in iceoryx2 if another process is stopped in the middle
/// of its work.
const PATIENCE: Duration = Duration::from_millis(500);

/// Looks for the newest living writer of a channel every 50 ms, in a thread of its own, until dropped. Keep it longer than the
/// readers that it returns: then dropping a reader unmaps no memory.
pub struct FinderThread<T: BlackboardPayload> {
    found: Receiver<Result<Option<Reader<T>>, IpcError>>,
    writer_is_alive: Arc<AtomicBool>,
    done: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl<T: BlackboardPayload> FinderThread<T> {
    /// Starts the thread.
    ///
    /// # Errors
    /// Of the operating system.
    pub fn start(node: &Node) -> std::io::Result<Self> {
        let (sender, found) = mpsc::channel();
        let done = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&done);
        let writer_is_alive = Arc::new(AtomicBool::new(false));
        let alive = Arc::clone(&writer_is_alive);
        let node = node.clone();
        let look = move || {
            let keep_waiting = || !ended.load(Ordering::Acquire);
            let mut finder = node.finder::<T>();
            let mut first = true;
            let mut failing = false;
            while keep_waiting() {
                let outcome = finder.poll_while(&keep_waiting);
                // An error that persists is reported once.
                let news = match &outcome {
                    Ok(found) => first || found.is_some(),
                    Err(_) => first || !failing,
                };
                failing = outcome.is_err();
                alive.store(finder.writer_is_alive(), Ordering::Relaxed);
                first = false;
                if news && sender.send(outcome).is_err() {
                    break;
                }
                std::thread::park_timeout(PERIOD);
            }
        };
        let thread = Builder::new().name("finder".into()).spawn(look)?;
        Ok(Self { found, writer_is_alive, done, thread: Some(thread) })
    }

    /// Waits for the first look and returns the reader of the writer that it found, if any.
    ///
    /// # Errors
    /// As [`crate::Finder::poll`].
    pub fn first(&self) -> Result<Option<Reader<T>>, IpcError> {
        self.found.recv().unwrap_or(Ok(None))
    }

    /// Whether the writer found last is alive; never waits. Up to about 50 ms late, more while another process holds the
    /// creation lock.
    pub fn writer_is_alive(&self) -> bool {
        self.writer_is_alive.load(Ordering::Relaxed)
    }

    /// Returns a reader of the newest writer if one was found since the last call; never waits, makes no system call if none
    /// was.
    ///
    /// # Errors
    /// As [`crate::Finder::poll`]; an error that persists is returned once.
    pub fn poll(&self) -> Result<Option<Reader<T>>, IpcError> {
        loop {
            match self.found.try_recv() {
                // The first look found nothing.
                Ok(Ok(None)) => {}
                Ok(news) => return news,
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => return Ok(None),
            }
        }
    }
}

impl<T: BlackboardPayload> Drop for FinderThread<T> {
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
