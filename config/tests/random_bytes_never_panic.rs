//! For any file contents, loading returns settings or an error that names the file.

mod common;
use common::exported;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use std::path::Path;
use upswing_config::{Config, ConfigError};

const FILES: [&str; 6] =
    ["robot.urdf", "robot.toml", "planner.toml", "daemon.toml", "plant.toml", "manoeuvres.toml"];

fn cases() -> ProptestConfig {
    ProptestConfig { failure_persistence: None, ..ProptestConfig::default() }
}

/// Loads the folder with other contents in one file, then restores it.
fn load_with(dir: &Path, file: &str, contents: impl AsRef<[u8]>) -> Result<Config, ConfigError> {
    let path = dir.join(file);
    let original = std::fs::read(&path).expect("exported file");
    std::fs::write(&path, contents).expect("write");
    let result = Config::from_dir(dir);
    std::fs::write(&path, original).expect("restore");
    if let Err(error) = &result {
        // Other names of joints are an error where settings name them.
        let named = |name: &str| error.to_string().contains(name);
        assert!(
            named(file) || file == "robot.urdf" && (named("robot.toml") || named("manoeuvres.toml")),
            "{error}"
        );
    }
    result
}

fn text(dir: &Path, file: &str) -> String {
    std::fs::read_to_string(dir.join(file)).expect("exported text")
}

#[test]
fn in_place_of_a_file() {
    let dir = exported();
    let bytes = prop::collection::vec(any::<u8>(), 0..300);
    proptest!(cases(), |(file in select(&FILES[..]), bytes in bytes)| {
        // Those with defaults may be empty.
        let needed = ["robot.urdf", "robot.toml", "manoeuvres.toml"].contains(&file);
        prop_assert!(load_with(dir.path(), file, bytes).is_err() || !needed);
    });
}

#[test]
fn inside_a_file() {
    let dir = exported();
    proptest!(cases(), |(file in select(&FILES[..]), at in any::<Index>(), noise in "[\\PC\n]{1,8}")| {
        let mut text = text(dir.path(), file);
        // The originals are ASCII: every byte is a boundary.
        text.insert_str(at.index(text.len()), &noise);
        let _either = load_with(dir.path(), file, text);
    });
}

#[test]
fn any_number_in_place_of_a_value() {
    let dir = exported();
    proptest!(cases(), |(file in select(&FILES[1..]), nth in any::<Index>(), number in any::<f64>())| {
        let text = text(dir.path(), file);
        let values: Vec<usize> = text.match_indices(" = ").map(|(at, _)| at + 3).collect();
        let start = values[nth.index(values.len())];
        let end = start + text[start..].find(['\n', ',']).expect("a line ends");
        let _either = load_with(dir.path(), file, format!("{}{number:?}{}", &text[..start], &text[end..]));
    });
}
