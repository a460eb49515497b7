//! The messages explained in docs/troubleshooting.md occur in the source of the programs.

use std::path::{Path, PathBuf};
use upswing_tests::repository;

/// All sources of a kind under a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if path.is_dir() && !hidden && !path.ends_with("target") && !path.ends_with("tests") {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs" || e == "py") {
            found.push(path);
        }
    }
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn every_message_in_the_tables_is_one_of_the_code() {
    let mut files = Vec::new();
    sources(repository(), &mut files);
    // A message that spans lines in its source is one line here.
    let code: String = files.iter().map(|f| read(f).replace("\\\n", " ")).collect();
    let code = code.split_whitespace().collect::<Vec<_>>().join(" ").replace('`', "");
    let page = read(&repository().join("docs/troubleshooting.md"));
    let mut checked = 0;
    for row in page.lines().filter(|line| line.starts_with("| `")) {
        let first = row.split(" | ").next().unwrap_or_default();
        for quoted in first.split('`').skip(1).step_by(2).filter(|q| !q.ends_with(".py")) {
            for part in quoted.split("...").map(|p| p.trim().trim_end_matches([':', ','])) {
                let fixed: Vec<_> = part.split(" N ").collect();
                for fixed in fixed.iter().map(|f| f.trim()).filter(|f| f.len() > 3) {
                    assert!(code.contains(fixed), "docs/troubleshooting.md: nothing says `{fixed}`");
                    checked += 1;
                }
            }
        }
    }
    assert!(checked > 25, "only {checked} messages checked");
}
