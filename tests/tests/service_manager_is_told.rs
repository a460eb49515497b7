//! Each process notifies the service manager of readiness, status, watchdog and shutdown; the daemon stops its watchdog
//! notifications when its real-time thread hangs.

use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};
use upswing_ipc::TempDomain;
use upswing_tests::running::{LONG, Running};

const WATCHDOG: Duration = Duration::from_millis(400);
/// A process tells that it lives four times per watchdog time.
const SIGN: Duration = Duration::from_millis(100);

/// The manager's end.
struct Manager {
    socket: UnixDatagram,
    folder: tempfile::TempDir,
}

impl Manager {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let socket = UnixDatagram::bind(folder.path().join("notify")).expect("a socket");
        socket.set_read_timeout(Some(Duration::from_millis(20))).expect("a time");
        Self { socket, folder }
    }

    fn start(&self, program: &str, domain: &str) -> Running {
        Running::start(program, domain, |command| {
            command.env("NOTIFY_SOCKET", self.folder.path().join("notify"));
            command.env("WATCHDOG_USEC", WATCHDOG.as_micros().to_string()).env_remove("WATCHDOG_PID");
        })
    }

    fn next(&self) -> Option<String> {
        let mut buffer = [0; 4096];
        let length = self.socket.recv(&mut buffer).ok()?;
        Some(String::from_utf8_lossy(&buffer[..length]).trim_end().to_owned())
    }

    /// Waits for a message that begins so; those before it.
    fn wait_for(&self, message: &str) -> Vec<String> {
        let begin = Instant::now();
        let mut before = Vec::new();
        while begin.elapsed() < LONG {
            match self.next() {
                Some(got) if got.starts_with(message) => return before,
                Some(got) => before.push(got),
                None => {}
            }
        }
        panic!("no {message} after {before:?}");
    }

    /// Waits until a message has not come for `time`.
    fn wait_for_silence(&self, message: &str, time: Duration) {
        let begin = Instant::now();
        let mut last = begin;
        while last.elapsed() < time {
            if self.next().is_some_and(|got| got == message) {
                last = Instant::now();
            }
            assert!(begin.elapsed() < LONG, "{message} goes on");
        }
    }
}

#[test]
fn by_planner_and_plant() {
    for (program, status) in [("upswing-planner", "STATUS="), ("upswing-plant", "STATUS=clock paced")] {
        let domain = TempDomain::new("test").expect("a name");
        let manager = Manager::new();
        let mut process = manager.start(program, domain.name());
        assert_eq!(manager.wait_for("READY=1"), [""; 0], "{program}");
        assert_eq!(manager.wait_for(status), [""; 0], "{program}");
        manager.wait_for("WATCHDOG=1");
        manager.wait_for("WATCHDOG=1");
        process.signal(libc::SIGTERM);
        manager.wait_for("STOPPING=1");
        assert!(process.wait().success(), "{program}");
    }
}

#[test]
fn by_the_daemon_once_a_plant_is_there() {
    let domain = TempDomain::new("test").expect("a name");
    let manager = Manager::new();
    let mut daemon = manager.start("upswingd", domain.name());
    manager.wait_for("STATUS=waits for a plant");
    let before = manager.wait_for("EXTEND_TIMEOUT_USEC=10000000");
    assert!(!before.contains(&"READY=1".into()), "ready without a plant: {before:?}");

    let _plant = Running::start("upswing-plant", domain.name(), |_| {});
    manager.wait_for("READY=1");
    manager.wait_for("STATUS=idle");
    manager.wait_for("WATCHDOG=1");
    daemon.signal(libc::SIGTERM);
    manager.wait_for("STOPPING=1");
    assert!(daemon.wait().success());
}

/// A thread that is stopped until dropped; the others of its process run on.
struct Frozen(libc::pid_t);

impl Frozen {
    fn new(thread: libc::pid_t) -> Self {
        let none = std::ptr::null_mut::<libc::c_void>();
        let mut state = 0;
        // SAFETY: plain system calls about a thread of our child; the state is a valid place to write to.
        unsafe {
            assert_eq!(libc::ptrace(libc::PTRACE_SEIZE, thread, none, none), 0);
            assert_eq!(libc::ptrace(libc::PTRACE_INTERRUPT, thread, none, none), 0);
            assert_eq!(libc::waitpid(thread, &raw mut state, libc::__WALL), thread);
        }
        assert!(libc::WIFSTOPPED(state));
        Self(thread)
    }
}

impl Drop for Frozen {
    fn drop(&mut self) {
        let none = std::ptr::null_mut::<libc::c_void>();
        // SAFETY: plain system call about the thread that `new` seized.
        unsafe { libc::ptrace(libc::PTRACE_DETACH, self.0, none, none) };
    }
}

#[test]
fn nothing_while_the_real_time_thread_hangs() {
    let domain = TempDomain::new("test").expect("a name");
    let manager = Manager::new();
    let _plant = Running::start("upswing-plant", domain.name(), |command| {
        command.args(["--clock", "wall"]);
    });
    let daemon = manager.start("upswingd", domain.name());
    manager.wait_for("WATCHDOG=1");
    let frozen = Frozen::new(daemon.thread("realtime"));
    // What was told before, or of what the thread did before it stopped, may still come.
    manager.wait_for_silence("WATCHDOG=1", 10 * SIGN);
    drop(frozen);
    manager.wait_for("WATCHDOG=1");
}
