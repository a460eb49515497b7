//! Every Markdown file of the project is a page of the site.

use std::path::{Path, PathBuf};
use upswing_tests::repository;

fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if path.is_dir() && !hidden && !path.ends_with("target") {
            pages(&path, found);
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
}

/// Where the links of a page lead, without what is elsewhere and without places within pages.
fn links(text: &str) -> impl Iterator<Item = &str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let files = targets.filter_map(|target| target.split('#').next());
    files.filter(|target| !target.is_empty() && !target.contains("://"))
}

fn read(page: &Path) -> String {
    std::fs::read_to_string(page).unwrap_or_else(|e| panic!("{}: {e}", page.display()))
}

#[test]
fn every_page_is_in_the_site() {
    let summary = read(&repository().join("docs/book/SUMMARY.md"));
    let listed: Vec<_> = links(&summary).map(|link| repository().join(link)).collect();
    let mut all = Vec::new();
    pages(repository(), &mut all);
    for page in all.iter().filter(|page| !page.ends_with("SUMMARY.md")) {
        assert!(listed.contains(page), "docs/book/SUMMARY.md does not list {}", page.display());
    }
}
