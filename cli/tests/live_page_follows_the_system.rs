//! Chromium shows a running system live, also one without a measurement of the rod, and operates it with the page's
//! buttons.
//!
//! Needs Python 3.10 or newer with the package index, and Chromium; without them the test says so and does nothing.

mod common;

use common::{Place, chromium, python, run, script};
use std::process::Command;

#[test]
fn in_chromium() {
    let (python, chromium) = match (python(), chromium()) {
        (Ok(python), Some(chromium)) => (python, chromium),
        (Err(why), _) => return eprintln!("skipped: no Python with the packages needed: {why}"),
        (_, None) => return eprintln!("skipped: no Chromium (on Debian: apt install chromium)"),
    };
    let place = Place::with_system();
    let dir = tempfile::tempdir().expect("a folder");
    let (page, begun) = place.begin(&["monitor", "--web", "127.0.0.1:0", "--allow-control", "--json"]);
    let text = |key: &str| begun[key].as_str().expect("a text").to_owned();
    let mut look = Command::new(python);
    look.arg(script("look_at_live.py")).args([&chromium, &text("url"), &text("token")]).arg(dir.path());
    let blind = place.command(&["disturb", "fault", "encoder-nan", "--joint", "pendulum_2"]);
    look.arg(blind.get_program()).args(blind.get_args());
    let found = run(&mut look).unwrap_or_else(|e| panic!("{e}"));
    assert!(found.contains("as it should be"), "{found}");
    assert!(page.end().success());
}
