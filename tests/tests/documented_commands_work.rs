//! The commands in README and docs run, page by page and in their order, as a reader would enter them in an empty folder.
//!
//! A block marked `sh` runs. One with a second word (`sh long`, `sh host`, `sh install`, ...) does not: it takes minutes, needs
//! root, hardware or packages; of its commands, and of indented ones, only names and options are checked.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use upswing_ipc::TempDomain;
use upswing_tests::{programs, repository};

/// Runs `upswing` in a domain of the test's own. Demos run as fast as they can. A request that comes too early for a machine
/// under load is repeated.
const UPSWING: &str = r#"#!/usr/bin/env bash
case "$1" in
demo) [[ " $* " == *" --clock "* ]] && exec PROGRAM "$@" || exec PROGRAM "$@" --clock lockstep ;;
plant | planner | daemon | status | disturb) exec PROGRAM "$1" --domain DOMAIN "${@:2}" ;;
request | record)
    for _ in {1..300}; do
        PROGRAM "$1" --domain DOMAIN "${@:2}" && exit
        sleep 0.2
    done
    exit 1
    ;;
*) exec PROGRAM "$@" ;;
esac
"#;
/// `cargo run --release -- X` is `upswing X`.
const CARGO: &str = r#"#!/usr/bin/env bash
[[ "$1 $2 $3" == "run --release --" ]] && exec upswing "${@:4}"
echo "not in a test: cargo $*" >&2
exit 1
"#;

/// How a documented command of `upswing` begins.
const BEGINS: [&str; 2] = ["upswing ", "cargo run --release -- "];

struct Block {
    runs: bool,
    text: String,
}

/// README and every page of docs, and those of other folders with commands.
fn pages() -> Vec<PathBuf> {
    let docs = std::fs::read_dir(repository().join("docs")).expect("docs");
    let mut pages: Vec<_> = docs.map(|entry| entry.expect("an entry").path()).collect();
    pages.retain(|path| path.extension().is_some_and(|e| e == "md"));
    pages.extend(
        ["README.md", "examples/python/README.md", "systemd/README.md"].map(|page| repository().join(page)),
    );
    pages.sort();
    pages
}

fn blocks(page: &Path) -> Vec<Block> {
    let text = std::fs::read_to_string(page).expect("a page");
    let mut blocks = Vec::new();
    let mut open = false;
    for line in text.lines() {
        if let Some(info) = line.strip_prefix("```") {
            open = !open && info.split(' ').next() == Some("sh");
            if open {
                blocks.push(Block { runs: info == "sh", text: String::new() });
            }
        } else if open {
            let block = blocks.last_mut().expect("an open block");
            let _ = writeln!(block.text, "{line}");
        } else {
            // A line of text that shows how a command is called.
            let shown = line.strip_prefix("    ").unwrap_or_default();
            if BEGINS.iter().any(|begin| shown.starts_with(begin)) {
                blocks.push(Block { runs: false, text: shown.to_owned() });
            }
        }
    }
    blocks
}

fn install(folder: &Path, name: &str, text: &str) {
    let path = folder.join(name);
    std::fs::write(&path, text).expect("a program");
    std::fs::set_permissions(path, PermissionsExt::from_mode(0o755)).expect("executable");
}

#[test]
fn every_block_that_runs() {
    let mut commands = 0;
    for page in pages() {
        let script: String = blocks(&page).iter().filter(|b| b.runs).map(|b| b.text.as_str()).collect();
        commands += script.lines().count();
        if script.is_empty() {
            continue;
        }
        println!("{}", page.display());
        let folder = tempfile::tempdir().expect("a folder");
        let (bin, scratch) = (folder.path().join("bin"), folder.path().join("scratch"));
        std::fs::create_dir(&bin).expect("bin");
        std::fs::create_dir(&scratch).expect("scratch");
        let domain = TempDomain::new("test").expect("a name");
        let program = programs().join("upswing");
        let wrapper =
            UPSWING.replace("PROGRAM", program.to_str().expect("a path")).replace("DOMAIN", domain.name());
        install(&bin, "upswing", &wrapper);
        install(&bin, "cargo", CARGO);
        // What runs in the background ends with the page, and is waited for.
        let end = "trap 'kill $(jobs -p) 2>/dev/null || true; wait' EXIT";
        let path = format!("{}:{}", bin.display(), std::env::var("PATH").expect("PATH"));
        let output = Command::new("bash")
            .args(["-euo", "pipefail", "-c", &format!("{end}\nset -x\n{script}")])
            .current_dir(&scratch)
            .env("PATH", path)
            .env("REPOSITORY", repository())
            .output()
            .expect("bash");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{}: {}\n{said}", page.display(), output.status);
    }
    assert!(commands > 40, "only {commands} lines of commands: are blocks still marked sh?");
}

/// Words that name a subcommand, then the options of one documented command.
fn parts(command: &str) -> (Vec<&str>, BTreeSet<&str>) {
    let words: Vec<_> = command.split_whitespace().take_while(|w| !w.starts_with('#')).collect();
    let plain =
        |word: &&&str| word.bytes().all(|b| b.is_ascii_lowercase() || b == b'-') && !word.starts_with('-');
    let names = words.iter().take_while(plain).take(2).copied().collect();
    (names, words.iter().filter(|w| w.starts_with("--")).map(|w| w.split('=').next().unwrap_or(w)).collect())
}

#[test]
fn the_others_have_names_and_options_that_exist() {
    let mut checked = 0;
    for page in pages() {
        for block in blocks(&page).iter().filter(|b| !b.runs) {
            for line in block.text.replace("\\\n", " ").lines() {
                let line = line.trim_end_matches(" &");
                let Some(command) = BEGINS.iter().find_map(|begin| line.strip_prefix(begin)) else {
                    continue;
                };
                let (names, options) = parts(command);
                // The second word may be an argument instead of a name.
                let help = (1..=names.len()).rev().find_map(|n| {
                    let output =
                        Command::new(programs().join("upswing")).args(&names[..n]).arg("--help").output();
                    let output = output.expect("upswing runs");
                    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
                });
                let help = help.unwrap_or_else(|| panic!("{}: no such command: {line}", page.display()));
                for option in options {
                    assert!(help.contains(option), "{}: {line}: no option {option}", page.display());
                }
                checked += 1;
            }
        }
    }
    assert!(checked > 5, "only {checked} commands checked");
}
