//! Every dependency has a compatible licence, builds with the oldest supported compiler, and has its reason in Cargo.toml.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Licences that let the programs be given away with their source or without.
const PERMISSIVE: [&str; 10] = [
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "ISC",
    "MIT",
    "Unicode-3.0",
    "Zlib",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the repository")
}

/// All packages that the locked graph needs on this platform.
fn packages() -> Vec<Value> {
    let host = Command::new("rustc").args(["--print", "host-tuple"]).output().expect("rustc runs");
    let host = String::from_utf8(host.stdout).expect("a name");
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version=1", "--locked", "--offline", "--filter-platform", host.trim()])
        .current_dir(root())
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let used: Vec<_> =
        metadata["resolve"]["nodes"].as_array().expect("nodes").iter().map(|node| &node["id"]).collect();
    let packages = metadata["packages"].as_array().expect("packages");
    packages.iter().filter(|package| used.contains(&&package["id"])).cloned().collect()
}

/// Whether one may choose only [`PERMISSIVE`] licences from an SPDX expression (SPDX 2.3, annex D; `/` is its old OR).
fn permits(expression: &str) -> bool {
    let plain = expression.replace(['(', ')'], "").replace('/', " OR ");
    // Without its brackets `(A OR B) AND C` reads `A OR B AND C`: what stands on both sides of an AND must all be fine.
    let mut terms = plain.split(" AND ");
    terms.all(|term| term.split(" OR ").any(|licence| PERMISSIVE.contains(&licence.trim())))
}

/// Major and minor version.
fn version(text: &str) -> (u32, u32) {
    let mut parts = text.split('.').map(|part| part.parse().expect("a number"));
    (parts.next().expect("a major version"), parts.next().unwrap_or(0))
}

#[test]
fn licences() {
    assert!(permits("(MIT OR GPL-3.0) AND Unicode-3.0") && permits("GPL-3.0/MIT"));
    assert!(!permits("GPL-3.0") && !permits("MIT AND GPL-3.0"));
    let packages = packages();
    assert!(packages.len() > 100, "{} packages", packages.len());
    let refused = packages.iter().filter(|package| !package["license"].as_str().is_some_and(permits));
    let refused: Vec<_> = refused.map(|p| format!("{} ({})", p["name"], p["license"])).collect();
    assert!(refused.is_empty(), "not permissive: {}", refused.join(", "));
}

#[test]
fn oldest_compiler() {
    let packages = packages();
    let ours = packages.iter().find(|p| p["name"] == "upswing").expect("the program");
    let ours = version(ours["rust_version"].as_str().expect("rust-version in Cargo.toml"));
    let newer: Vec<_> = packages
        .iter()
        .filter_map(|p| Some((p["name"].as_str()?, p["rust_version"].as_str()?)))
        .filter(|(_, oldest)| version(oldest) > ours)
        .collect();
    assert!(newer.is_empty(), "need a newer compiler than {ours:?}: {newer:?}");
}

#[test]
fn reasons() {
    let text = std::fs::read_to_string(root().join("Cargo.toml")).expect("Cargo.toml");
    let (_, section) = text.split_once("[workspace.dependencies]").expect("the section");
    let section = section.split("\n[").next().unwrap_or_default();
    let lines: Vec<_> = section.lines().collect();
    for (above, line) in lines.iter().zip(&lines[1..]) {
        let foreign = line.contains('=') && !line.starts_with('#') && !line.contains("path =");
        // One reason may serve a group.
        let grouped = above.contains('=') && !above.starts_with('#');
        assert!(!foreign || above.starts_with('#') || grouped, "no reason for: {line}");
    }
}
