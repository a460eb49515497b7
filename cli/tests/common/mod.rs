//! Common code of the tests: the program under test, running systems, and Python tools.
#![allow(dead_code, reason = "no test file uses all of it")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use upswing_ipc::TempDomain;

/// Runs `upswing` to its end.
pub fn upswing(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_upswing")).args(args).output().expect("upswing runs")
}

/// As [`upswing`], with `--json`: exit code and document.
pub fn json(args: &[&str]) -> (Option<i32>, serde_json::Value) {
    let output = upswing(&[args, &["--json"]].concat());
    let document = serde_json::from_slice(&output.stdout);
    (output.status.code(), document.unwrap_or_else(|e| panic!("{args:?}: {e}: {output:?}")))
}

/// Removes the computing times of a document, which differ from run to run.
pub fn forget_times(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::Object(map) => {
            map.remove("times");
            map.values_mut().for_each(forget_times);
        }
        serde_json::Value::Array(items) => items.iter_mut().for_each(forget_times),
        _ => {}
    }
}

/// As [`json`], of a command that must succeed.
pub fn success(args: &[&str]) -> serde_json::Value {
    let (code, document) = json(args);
    assert_eq!(code, Some(0), "{args:?}: {document}");
    document
}

/// The program under test in a domain of its own; what it leaves there goes in the end.
pub struct Place {
    pub domain: String,
    processes: Vec<Running>,
    // Declared last: the processes must be gone by then.
    _own: TempDomain,
}

impl Place {
    /// Nothing runs there yet.
    pub fn new() -> Self {
        let own = TempDomain::new("test-cli").expect("a valid name");
        Self { domain: own.name().to_owned(), processes: Vec::new(), _own: own }
    }

    /// Daemon, planner and plant run, and cycles arrive.
    pub fn with_system() -> Self {
        let mut place = Self::new();
        for role in ["plant", "planner", "daemon"] {
            let process = place.command(&[role]).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
            place.processes.push(Running(process.expect("it starts")));
        }
        let began = std::time::Instant::now();
        while !run(&mut place.command(&["request", "enable"])).is_ok_and(|text| text.contains("hold")) {
            assert!(began.elapsed().as_secs() < 60, "the system does not come up");
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        place
    }

    /// `upswing` with these arguments, in the domain.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_upswing"));
        let (first, rest) = args.split_at(1);
        command.args(first).args(["--domain", &self.domain]).args(rest);
        command
    }

    /// A process that prints one JSON document at its start and goes on.
    pub fn begin(&self, args: &[&str]) -> (Running, serde_json::Value) {
        let mut child = self.command(args).stdout(Stdio::piped()).spawn().expect("it starts");
        let mut line = String::new();
        let stdout = child.stdout.take().expect("a pipe");
        BufReader::new(stdout).read_line(&mut line).expect("a line");
        let running = Running(child);
        (running, serde_json::from_str(&line).unwrap_or_else(|e| panic!("{args:?}: {e}: {line}")))
    }
}

/// A process that ends with its owner.
pub struct Running(pub Child);

impl Running {
    /// Asks it to end, and waits.
    pub fn end(mut self) -> std::process::ExitStatus {
        let pid = libc::pid_t::try_from(self.0.id()).expect("an id");
        // SAFETY: plain system call; the child has not been waited for, so that the id is still its own.
        assert_eq!(unsafe { libc::kill(pid, libc::SIGTERM) }, 0);
        self.0.wait().expect("it ends")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A Python with the packages of `python/requirements.txt`, made once, or why there is none.
pub fn python() -> Result<&'static Path, &'static str> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let made = PYTHON.get_or_init(|| {
        // The name changes with the requirements; a folder that was not finished is not used.
        let requirements = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/requirements.txt");
        let text = std::fs::read_to_string(&requirements).map_err(|e| e.to_string())?;
        let name = format!("python-{}", text.split_whitespace().collect::<Vec<_>>().join("-"));
        let venv = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name.replace("==", "-"));
        let (program, done) = (venv.join("bin/python"), venv.join("complete"));
        if !done.exists() {
            let requirements = requirements.to_string_lossy();
            run(Command::new("python3").args(["-m", "venv"]).arg(&venv))?;
            let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", &requirements];
            run(Command::new(&program).args(pip))?;
            std::fs::write(done, "").map_err(|e| e.to_string())?;
        }
        Ok(program)
    });
    made.as_deref().map_err(String::as_str)
}

/// Runs a program; its output, or what it said if it failed.
pub fn run(command: &mut Command) -> Result<String, String> {
    let output = command.output().map_err(|e| format!("{command:?}: {e}"))?;
    let text = [output.stdout, output.stderr].map(|t| String::from_utf8_lossy(&t).into_owned()).concat();
    if output.status.success() { Ok(text) } else { Err(format!("{command:?}: {text}")) }
}

/// Path of Chromium, if it is installed.
pub fn chromium() -> Option<String> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let path = |name: &str| run(Command::new("sh").args(["-c", &format!("command -v {name}")])).ok();
    names.into_iter().find_map(path).map(|path| path.trim().to_owned())
}

/// A script of this folder.
pub fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(name)
}
