//! The help of every command has an example that the command line accepts, every command prints JSON where asked for,
//! and every number with a fraction names its unit.

use clap::{Arg, Command, CommandFactory};
use std::any::TypeId;
use upswing::cli::Cli;

/// Every command but `help`, with the names that lead to it.
fn commands() -> Vec<(Vec<String>, Command)> {
    fn walk(path: &[String], command: &Command, all: &mut Vec<(Vec<String>, Command)>) {
        let path = [path, &[command.get_name().to_owned()]].concat();
        all.push((path.clone(), command.clone()));
        let children = command.get_subcommands().filter(|c| c.get_name() != "help");
        children.for_each(|child| walk(&path, child, all));
    }
    let mut all = Vec::new();
    walk(&[], &Cli::command(), &mut all);
    all
}

fn help(command: &Command) -> String {
    command.clone().render_long_help().to_string()
}

/// The command lines of upswing in an example, split into words as a shell would.
fn lines(example: &str) -> Vec<Vec<String>> {
    let parts = example.split("&&").flat_map(|part| part.split(" | "));
    let words = parts.map(|part| {
        let part = part.split('>').next().unwrap_or_default();
        part.split_whitespace().map(str::to_owned).collect::<Vec<_>>()
    });
    words.filter(|words| words.first().is_some_and(|w| w == "upswing")).collect()
}

#[test]
fn that_the_command_line_accepts() {
    let all = commands();
    assert!(all.len() > 30, "{}", all.len());
    for (path, command) in &all {
        let help = help(command);
        let example = help.split("Example: ").nth(1).and_then(|rest| rest.lines().next());
        let example = example.unwrap_or_else(|| panic!("{path:?} has no example:\n{help}"));
        let lines = lines(example);
        assert!(lines.iter().any(|l| l.starts_with(path)), "{path:?} is not in its example `{example}`");
        for line in &lines {
            if let Err(e) = Cli::command().try_get_matches_from(line) {
                panic!("{path:?}: `{}`: {e}", line.join(" "));
            }
        }
    }
}

#[test]
fn and_an_option_for_json() {
    /// Run until they are ended, and print nothing.
    const ROLES: [&str; 3] = ["daemon", "planner", "plant"];
    let all = commands();
    let has_json = |path: &[String]| {
        let of = all.iter().find(|(p, _)| p == path);
        of.is_some_and(|(_, c)| c.get_arguments().any(|a| a.get_long() == Some("json")))
    };
    for (path, command) in &all {
        let is_leaf = command.get_subcommands().next().is_none();
        if is_leaf && !ROLES.contains(&path[1].as_str()) {
            // Options of a group stand before the name of its member.
            assert!((2..=path.len()).any(|n| has_json(&path[..n])), "{path:?} has no --json");
        }
    }
}

#[test]
fn and_units() {
    const UNITS: [&str; 7] = [", s", " s ", "deg", "rad", "N s", "Share ", "unit"];
    let is_real = |arg: &&Arg| arg.get_value_parser().type_id() == TypeId::of::<f64>();
    let mut seen = 0;
    for (path, command) in &commands() {
        for arg in command.get_arguments().filter(is_real) {
            let help = format!("{} ", arg.get_long_help().or(arg.get_help()).expect("help"));
            assert!(UNITS.iter().any(|unit| help.contains(unit)), "{path:?} {}: {help}", arg.get_id());
            seen += 1;
        }
    }
    assert!(seen >= 8, "{seen}");
}

#[test]
fn and_exit_codes_are_named() {
    assert!(help(&Cli::command()).contains("Exit codes: 0 success, 1"));
}
