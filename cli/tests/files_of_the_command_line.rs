//! Every option and argument for a file: anything except a regular file is refused at once, without waiting for it;
//! existing files are not overwritten without --force, and are refused before the work.

mod common;

use clap::{Arg, Command, CommandFactory};
use std::any::TypeId;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use upswing::cli::Cli;
use upswing_ipc::TempDomain;
use upswing_process::output::Destination;

const START: &str = "0,-15,0,-95,0,10,0";

/// A file that can be read, and a database.
const SOME_FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/systems/iiwa-pendulum/swing-up.bin");
/// A robot description.
const URDF: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../config/systems/iiwa-pendulum/robot.urdf");

/// What commands need besides the file under test: command, argument, words.
const NEEDED: &[(&str, &str, &[&str])] = &[
    ("plan", "start", &["--start", START]),
    ("optimize", "start", &["--start", START]),
    ("request", "what", &["enable"]),
    ("completions", "shell", &["bash"]),
    ("disturb fault", "kind", &["encoder-nan"]),
    ("disturb push", "impulse", &["--impulse", "1,0,0"]),
    ("config export", "dir", &["exported"]),
    ("bench export", "file", &["benchmark.json"]),
    ("bench score", "file", &[SOME_FILE]),
    ("system new", "dir", &["my-robot"]),
    ("system new", "urdf", &["--urdf", URDF]),
    ("record", "file", &["run.mcap"]),
    ("replay", "file", &["run.mcap"]),
    ("report", "file", &[SOME_FILE]),
    ("export", "file", &["run.mcap"]),
    ("export", "csv", &["--csv", "table.csv"]),
    ("db merge", "output", &["--output", "database.bin"]),
    ("db merge", "shards", &[SOME_FILE]),
    ("montecarlo closed-loop", "only", &["--only", "0"]),
    ("montecarlo robustness", "only", &["--only", "0"]),
    ("montecarlo robustness", "over", &["--over", "friction"]),
];

/// Every command that does something, by its words.
fn leaves() -> Vec<(String, Command)> {
    fn walk(path: &str, command: &Command, all: &mut Vec<(String, Command)>) {
        let children: Vec<_> = command.get_subcommands().filter(|c| c.get_name() != "help").collect();
        if children.is_empty() {
            all.push((path.to_owned(), command.clone()));
        }
        for child in children {
            walk(format!("{path} {}", child.get_name()).trim(), child, all);
        }
    }
    let mut all = Vec::new();
    walk("", &Cli::command(), &mut all);
    all
}

/// Whether it names what is written.
fn is_written(arg: &Arg) -> bool {
    arg.get_value_parser().type_id() == TypeId::of::<Destination>()
}

/// Whether the value is a path, or a name or a path.
fn takes_a_file(arg: &Arg) -> bool {
    let names = arg.get_value_names().unwrap_or_default();
    let of_path = arg.get_value_parser().type_id() == TypeId::of::<PathBuf>();
    of_path || is_written(arg) || names.iter().any(|n| n.contains("FILE")) || arg.get_id() == "system"
}

/// What the name of a file has to end in.
fn extension(path: &str, arg: &Arg) -> &'static str {
    match (path, arg.get_id().as_str()) {
        (_, "scenario" | "condition") => "toml",
        ("metrics", "file") => "prom",
        _ => "bin",
    }
}

/// The words of a command with `file` as the value of `arg`, and what else it needs.
fn line(path: &str, command: &Command, arg: &Arg, file: &Path, domain: &str) -> Vec<String> {
    let mut words: Vec<String> = path.split(' ').map(str::to_owned).collect();
    let conflicts = command.get_arg_conflicts_with(arg);
    for other in command.get_arguments() {
        if conflicts.iter().any(|conflict| conflict.get_id() == other.get_id()) {
            continue;
        }
        let value = file.display().to_string();
        let needed = NEEDED.iter().find(|(of, id, _)| *of == path && other.get_id() == id);
        if other.get_id() == arg.get_id() {
            words.extend(other.get_long().map(|long| format!("--{long}")));
            words.push(value);
        } else if let Some((_, _, needed)) = needed {
            words.extend(needed.iter().map(|word| (*word).to_owned()));
        } else if other.get_id() == "domain" {
            words.extend(["--domain".to_owned(), domain.to_owned()]);
        }
    }
    words
}

/// Exit code and stderr of a process that must end by itself.
fn run(words: &[String], folder: &Path) -> (Option<i32>, String) {
    /// Far more than any of them takes on a machine that does much else.
    const PATIENCE: Duration = Duration::from_secs(120);
    let child = std::process::Command::new(env!("CARGO_BIN_EXE_upswing"))
        .args(words)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = child.expect("upswing runs");
    let begin = Instant::now();
    while child.try_wait().expect("a child").is_none() {
        if begin.elapsed() > PATIENCE {
            let _ = child.kill();
            panic!("`{}` does not end", words.join(" "));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().expect("its output");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn that_are_pipes_or_devices_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let domain = TempDomain::new("test-files").expect("a valid name");
    let mut seen = 0;
    for extension in ["toml", "prom", "bin"] {
        let pipe = folder.path().join(format!("pipe.{extension}"));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
        let zero = folder.path().join(format!("zero.{extension}"));
        std::os::unix::fs::symlink("/dev/zero", zero).expect("a link");
    }
    for (path, command) in leaves() {
        for arg in command.get_arguments().filter(|arg| takes_a_file(arg)) {
            let id = arg.get_id().as_str();
            let extension = extension(&path, arg);
            // Devices are written to.
            let kinds = if is_written(arg) { &["pipe"][..] } else { &["pipe", "zero"] };
            for kind in kinds {
                let file = folder.path().join(format!("{kind}.{extension}"));
                let words = line(&path, &command, arg, &file, domain.name());
                let (code, stderr) = run(&words, folder.path());
                let told = format!("`{}`: {code:?}: {stderr}", words.join(" "));
                // Some commands have no use for settings.
                let refused = matches!(code, Some(1 | 2));
                assert!(refused || (id == "system" && code == Some(0)), "{told}");
                assert!(!stderr.contains("Usage:"), "{told}");
                // A client of a system that does not run needs no settings.
                assert!(id == "system" || stderr.contains(&*file.to_string_lossy()), "{told}");
                seen += 1;
            }
        }
    }
    assert!(seen > 90, "{seen}");
}

#[test]
fn of_a_folder_of_settings_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let names = [
        "robot.toml",
        "planner.toml",
        "daemon.toml",
        "plant.toml",
        "manoeuvres.toml",
        "robot.urdf",
        "swing-up.bin",
    ];
    for name in names {
        let config = folder.path().join(name.replace('.', "-"));
        upswing_planner::export(
            &upswing_config::Config::embedded().expect("embedded settings"),
            &config,
            Default::default(),
        )
        .expect("settings are exported");
        let file = config.join(name);
        assert!(file.exists(), "{name}");
        std::fs::remove_file(&file).expect("removed");
        assert!(std::process::Command::new("mkfifo").arg(&file).status().expect("mkfifo").success());
        let words = ["db", "info", "--system", &config.to_string_lossy()].map(str::to_owned);
        let (code, stderr) = run(&words, folder.path());
        assert!(code == Some(2) && stderr.contains(name), "{name}: {code:?}: {stderr}");
    }
}

/// Names and contents of the files of a folder.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let files = std::fs::read_dir(folder).expect("the folder").map(|e| e.expect("a file").path());
    let mut files: Vec<_> =
        files.filter(|f| f.is_file()).map(|f| (f.clone(), std::fs::read(f).expect("read"))).collect();
    files.sort();
    files
}

#[test]
fn that_exist_are_not_overwritten_and_that_is_told_before_the_work() {
    let domain = TempDomain::new("test-files").expect("a valid name");
    let mut seen = 0;
    for (path, command) in leaves() {
        for arg in command.get_arguments().filter(|arg| is_written(arg)) {
            let folder = tempfile::tempdir().expect("a folder");
            let file = folder.path().join(format!("mine.{}", extension(&path, arg)));
            let (value, file) = match path.as_str() {
                "man" => (folder.path().to_owned(), folder.path().join("upswing-demo.1")),
                "config export" => (folder.path().to_owned(), folder.path().join("plant.toml")),
                _ => (file.clone(), file),
            };
            std::fs::write(&file, "mine").expect("written");
            let before = contents(folder.path());
            let words = line(&path, &command, arg, &value, domain.name());
            let (code, stderr) = run(&words, folder.path());
            let told = format!("`{}`: {code:?}: {stderr}", words.join(" "));
            assert_eq!(code, Some(2), "{told}");
            // A new system never mixes with other files.
            let (force, way_out) =
                if path == "system new" { (false, "new or empty folder") } else { (true, "--force") };
            assert!(stderr.contains(&*file.to_string_lossy()) && stderr.contains(way_out), "{told}");
            assert!(contents(folder.path()) == before, "{told}");
            assert_eq!(command.get_arguments().any(|a| a.get_long() == Some("force")), force, "{path}");
            seen += 1;
        }
    }
    assert!(seen > 14, "{seen}");
}

#[test]
fn that_exist_may_be_replaced() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let words = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let demo = "demo --clock lockstep --seconds 2 --record run.mcap";
    for (line, files) in [
        (demo, &["run.mcap", "upswing-demo.svg"][..]),
        ("export run.mcap --csv run.csv", &["run.csv"]),
        ("report run.mcap --svg", &["run.html", "run-trajectories.svg", "run-modes.svg"]),
        ("replay run.mcap --keep kept.mcap", &["kept.mcap"]),
        ("plan --start 0,-15,0,-95,0,10,0 --svg plan.svg", &["plan.svg"]),
        ("man .", &["upswing.1", "upswing-demo.1"]),
        ("config export .", &["robot.toml", "swing-up.bin"]),
    ] {
        let (code, stderr) = run(&words(line), folder.path());
        assert_eq!(code, Some(0), "{line}: {stderr}");
        for file in files {
            let (code, stderr) = run(&words(line), folder.path());
            if (line, *file) != (demo, "upswing-demo.svg") {
                assert!(code == Some(2) && stderr.contains("--force"), "{line}: {code:?}: {stderr}");
            }
            std::fs::write(path(file), "mine").expect("written");
        }
        let (code, stderr) = run(&words(&format!("{line} --force")), folder.path());
        assert_eq!(code, Some(0), "{line}: {stderr}");
        assert!(files.iter().all(|file| std::fs::read(path(file)).expect("read") != b"mine"), "{line}");
    }
    let strays =
        contents(folder.path()).into_iter().filter(|(f, _)| f.to_string_lossy().contains(".upswing-"));
    assert_eq!(strays.count(), 0);

    // Another demo needs no name for its picture.
    let (code, stderr) = run(&words("demo --clock lockstep --seconds 2"), folder.path());
    assert!(code == Some(0) && path("upswing-demo-2.svg").exists(), "{stderr}");
}

#[test]
fn that_are_the_standard_output_get_all_of_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let words = ["plan", "--start", START, "--svg", "/dev/stdout"];
    let file = folder.path().join("out");
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_upswing"))
        .args(words)
        .stdout(std::fs::File::create(&file).expect("made"))
        .status();
    assert!(output.expect("upswing runs").success());
    let text = std::fs::read_to_string(&file).expect("read");
    assert!(text.starts_with("<svg") && text.contains("</svg>") && text.contains("t_F"), "{text}");
}
