//! Long computations: they release the interpreter, end on Ctrl-C, and report their progress.

use pyo3::prelude::*;
use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Time between two looks for a signal, and between two calls of a progress function.
const EVERY: Duration = Duration::from_millis(100);

/// Runs `work` on this thread without the interpreter. `work` gets a function that tells whether to stop, for a solver that asks before each
/// iteration: after Ctrl-C, whose exception this function returns.
pub fn cancellable<T: Send>(py: Python<'_>, work: impl FnOnce(&dyn Fn() -> bool) -> T + Send) -> PyResult<T> {
    let (result, interrupt) = py.detach(|| {
        let interrupt = RefCell::new(None);
        let looked = RefCell::new(Instant::now());
        let stop = || {
            if interrupt.borrow().is_some() {
                return true;
            }
            if looked.borrow().elapsed() < EVERY {
                return false;
            }
            looked.replace(Instant::now());
            interrupt.replace(Python::attach(|py| py.check_signals()).err());
            interrupt.borrow().is_some()
        };
        (work(&stop), interrupt.into_inner())
    });
    interrupt.map_or(Ok(result), Err)
}

/// Runs `work`, which uses other threads, without the interpreter. `work` gets the flag that tells it to stop, and the counter of what it has
/// finished; `progress` is called with the finished and the total number about every 0.1 s. After Ctrl-C, or an exception of `progress`, `work`
/// stops and the exception is returned.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    total: usize,
    work: impl FnOnce(&AtomicBool, &AtomicUsize) -> T + Send,
) -> PyResult<T> {
    let (stop, done) = (AtomicBool::new(false), AtomicUsize::new(0));
    let progress = progress.map(|progress| progress.clone().unbind());
    let report = |py: Python<'_>| -> PyResult<()> {
        py.check_signals()?;
        if let Some(progress) = &progress {
            progress.call1(py, (done.load(Ordering::Relaxed), total))?;
        }
        Ok(())
    };
    py.detach(|| {
        std::thread::scope(|scope| {
            let (finished, wait) = channel();
            let worker = {
                let (stop, done) = (&stop, &done);
                scope.spawn(move || {
                    // Dropped at the end, also by a panic.
                    let _finished = finished;
                    work(stop, done)
                })
            };
            let mut raised: PyResult<()> = Ok(());
            while wait.recv_timeout(EVERY) == Err::<(), _>(RecvTimeoutError::Timeout) {
                if raised.is_ok() {
                    raised = Python::attach(report);
                    stop.store(raised.is_err(), Ordering::Release);
                }
            }
            let result = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            raised?;
            // The last call has the whole number.
            Python::attach(report)?;
            Ok(result)
        })
    })
}
