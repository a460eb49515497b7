//! The index of the paper's equations (docs/mathematics.md) is complete, and the named functions exist.

use std::collections::BTreeSet;
use std::path::Path;
use upswing_tests::repository;

fn read(path: impl AsRef<Path>) -> String {
    let path = repository().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Cells of each row of the tables of a page.
fn rows(page: &str) -> Vec<Vec<String>> {
    let cells = |line: &str| line.trim_matches('|').split(" | ").map(|c| c.trim().to_owned()).collect();
    page.lines().filter(|line| line.starts_with("| ")).map(cells).collect()
}

/// Whether a file defines something of this name.
fn defines(text: &str, name: &str) -> bool {
    let word = |w: &&str| !w.is_empty();
    let words: Vec<_> = text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(word).collect();
    words.windows(2).any(|pair| ["fn", "struct"].contains(&pair[0]) && pair[1] == name)
}

/// `a`, `b` in [path](../path): the names and the path, for all places in a text.
fn named(text: &str) -> Vec<(Vec<&str>, &str)> {
    let mut found = Vec::new();
    for part in text.split("](../").collect::<Vec<_>>().windows(2) {
        let path = part[1].split(')').next().expect("the end of a link");
        let before = part[0].rsplit(';').next().unwrap_or_default();
        let before = before.rsplit(')').next().unwrap_or_default();
        if path.ends_with(".rs") {
            found.push((before.split('`').skip(1).step_by(2).collect(), path));
        }
    }
    found
}

#[test]
fn no_equation_is_missing() {
    let page = read("docs/mathematics.md");
    let first: BTreeSet<String> = rows(&page).into_iter().map(|mut row| row.remove(0)).collect();
    let parts = [(3, "ab"), (6, "abcd"), (16, "abc"), (23, "ab")];
    let mut expected: Vec<String> = vec!["Table I".into(), "Table II".into()];
    for number in 1..=24 {
        match parts.iter().find(|(n, _)| *n == number) {
            Some((_, letters)) => expected.extend(letters.chars().map(|c| format!("({number}{c})"))),
            None => expected.push(format!("({number})")),
        }
    }
    let missing: Vec<_> = expected.iter().filter(|e| !first.contains(*e)).collect();
    assert!(missing.is_empty(), "docs/mathematics.md has no row for {missing:?}");
}

#[test]
fn every_named_function_is_in_its_file() {
    let page = read("docs/mathematics.md");
    let mut checked = 0;
    for row in rows(&page).iter().filter(|row| row[0].starts_with('(') || row[0].starts_with("Table")) {
        let places = named(row.last().expect("cells"));
        assert!(!places.is_empty(), "{}: names no function in a file", row[0]);
        for (names, path) in places {
            assert!(!names.is_empty(), "{}: names nothing in {path}", row[0]);
            let text = read(path);
            for name in names {
                assert!(defines(&text, name), "{}: {path} defines no `{name}`", row[0]);
                checked += 1;
            }
        }
    }
    assert!(checked > 30, "only {checked} functions named");
    let (text, other) = (read("daemon/src/law.rs"), "no_such_function");
    assert!(defines(&text, "torque") && !defines(&text, other), "the check itself");
}
