//! Every option and argument that takes a file: what is no regular file is refused at once, and nothing waits for it.

mod common;

use clap::{Arg, Command, CommandFactory};
use std::any::TypeId;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use upswing::cli::Cli;
use upswing_ipc::OwnDomain;

const START: &str = "0,-15,0,-95,0,10,0";

/// What commands need besides the file under test: command, argument, words.
const NEEDED: &[(&str, &str, &[&str])] = &[
    ("plan", "start", &["--start", START]),
    ("optimize", "start", &["--start", START]),
    ("request", "what", &["enable"]),
    ("completions", "shell", &["bash"]),
    ("disturb fault", "kind", &["encoder-nan"]),
    ("disturb push", "impulse", &["--impulse", "1,0,0"]),
    ("record", "file", &["run.mcap"]),
    ("replay", "file", &["run.mcap"]),
    ("report", "file", &["run.mcap"]),
    ("export", "file", &["run.mcap"]),
    ("export", "csv", &["--csv", "table.csv"]),
    ("db merge", "output", &["--output", "database.bin"]),
    ("db merge", "shards", &["shard.bin"]),
    ("montecarlo closed-loop", "only", &["--only", "0"]),
    ("montecarlo robustness", "only", &["--only", "0"]),
    ("montecarlo robustness", "over", &["--over", "friction"]),
];

/// Files that are written.
const WRITTEN: [&str; 7] = ["record", "picture", "svg", "csv", "keep", "output", "dir"];

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

/// Whether the value is a path, or a name or a path.
fn takes_a_file(arg: &Arg) -> bool {
    let names = arg.get_value_names().unwrap_or_default();
    arg.get_value_parser().type_id() == TypeId::of::<PathBuf>() || names.iter().any(|n| n.contains("FILE"))
}

/// The words of a command with `file` as the value of `arg`, and what else it needs.
fn line(path: &str, command: &Command, arg: &Arg, file: &Path, domain: &str) -> Vec<String> {
    let mut words: Vec<String> = path.split(' ').map(str::to_owned).collect();
    for other in command.get_arguments() {
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
    let domain = OwnDomain::new("test-files").expect("a valid name");
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
            let written = WRITTEN.contains(&id) || (path == "metrics" && id == "file") || path == "record";
            if written && id != "config" {
                continue;
            }
            let extension = match id {
                "scenario" | "condition" => "toml",
                _ => "bin",
            };
            for kind in ["pipe", "zero"] {
                let file = folder.path().join(format!("{kind}.{extension}"));
                let words = line(&path, &command, arg, &file, domain.name());
                let (code, stderr) = run(&words, folder.path());
                let told = format!("`{}`: {code:?}: {stderr}", words.join(" "));
                assert!(matches!(code, Some(1 | 2)), "{told}");
                assert!(!stderr.contains("Usage:"), "{told}");
                // A client of a system that does not run needs no settings.
                assert!(id == "config" || stderr.contains(&*file.to_string_lossy()), "{told}");
                seen += 1;
            }
        }
    }
    assert!(seen > 80, "{seen}");
}

#[test]
fn of_a_folder_of_settings_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let names = [
        "robot.toml",
        "planner.toml",
        "daemon.toml",
        "plant.toml",
        "grid.toml",
        "robot.urdf",
        "database.bin",
    ];
    for name in names {
        let config = folder.path().join(name.replace('.', "-"));
        upswing_config::Config::export(&config).expect("settings are exported");
        let file = config.join(name);
        assert!(file.exists(), "{name}");
        std::fs::remove_file(&file).expect("removed");
        assert!(std::process::Command::new("mkfifo").arg(&file).status().expect("mkfifo").success());
        let words = ["db", "info", "--config", &config.to_string_lossy()].map(str::to_owned);
        let (code, stderr) = run(&words, folder.path());
        assert!(code == Some(2) && stderr.contains(name), "{name}: {code:?}: {stderr}");
    }
}
