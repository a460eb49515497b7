//! Completions and man pages know every command that `upswing help` lists.

mod common;

fn upswing(args: &[&str]) -> String {
    let output = common::upswing(args);
    assert!(output.status.success(), "{args:?}: {output:?}");
    String::from_utf8(output.stdout).expect("text")
}

/// The commands in the list of `upswing help`.
fn commands() -> Vec<String> {
    let help = upswing(&["help"]);
    let list = help.split("Commands:").nth(1).and_then(|t| t.split("Options:").next()).expect("a list");
    let names = list.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names.filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
}

#[test]
fn completions() {
    let commands = commands();
    assert!(commands.len() > 10, "{commands:?}");
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = upswing(&["completions", shell]);
        for command in &commands {
            assert!(script.contains(command.as_str()), "{shell}: {command}");
        }
        // These two complete no values of options.
        for clock in ["paced", "lockstep"].iter().filter(|_| !matches!(shell, "elvish" | "powershell")) {
            assert!(script.contains(clock), "{shell}: --clock {clock}");
        }
    }
}

#[test]
fn man_pages() {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::write(dir.path().join("other.1"), "a page of something else").expect("written");
    let said = upswing(&["man", dir.path().to_str().expect("a plain path")]);
    let written = std::fs::read_dir(dir.path()).expect("the folder").count() - 1;
    assert!(said.starts_with(&format!("{written} pages in ")), "{said}");
    for command in commands().iter().filter(|c| *c != "help") {
        let page = dir.path().join(format!("upswing-{command}.1"));
        let text = std::fs::read_to_string(&page).unwrap_or_else(|e| panic!("{}: {e}", page.display()));
        assert!(text.contains(".SH"), "{command}");
    }
    assert!(dir.path().join("upswing.1").exists());
}

/// Every page is good mdoc or man, where there is a judge.
#[test]
fn man_pages_are_well_formed() {
    let dir = tempfile::tempdir().expect("a folder");
    upswing(&["man", dir.path().to_str().expect("a plain path")]);
    let mut pages: Vec<_> =
        std::fs::read_dir(dir.path()).expect("the folder").map(|e| e.expect("a page").path()).collect();
    pages.sort();
    let Ok(judged) =
        std::process::Command::new("mandoc").args(["-T", "lint", "-W", "warning"]).args(&pages).output()
    else {
        eprintln!("mandoc is not installed");
        return;
    };
    assert!(judged.status.success(), "{}", String::from_utf8_lossy(&judged.stdout));
}
