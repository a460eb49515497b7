//! A folder without one of the files that every system has is refused with the file's name and the way to get a full copy; a file
//! that is no text is refused with the place of the first bad byte.

mod common;
use common::exported;
use upswing_config::{Config, ConfigError};

/// Files that every folder has.
const NEEDED: [&str; 3] = ["robot.urdf", "robot.toml", "manoeuvres.toml"];
/// Files that are read if they are there.
const OTHERS: [&str; 3] = ["planner.toml", "daemon.toml", "plant.toml"];

fn files() -> impl Iterator<Item = &'static str> {
    NEEDED.into_iter().chain(OTHERS)
}

#[test]
fn each_file() {
    for file in NEEDED {
        let dir = exported();
        let path = dir.path().join(file);
        let _ = std::fs::remove_file(&path);
        let error = Config::from_dir(dir.path()).expect_err("incomplete folder");
        assert!(matches!(error, ConfigError::Unreadable { .. }), "{error}");
        let message = error.to_string();
        for part in [path.display().to_string().as_str(), "upswing config export DIR"] {
            assert!(message.contains(part), "no `{part}` in: {message}");
        }
    }
}

#[test]
fn pipes_and_devices_in_place_of_files() {
    for file in files() {
        let dir = exported();
        let path = dir.path().join(file);
        for replace in [["mkfifo"].as_slice(), &["ln", "-s", "/dev/zero"]] {
            let _ = std::fs::remove_file(&path);
            let made = std::process::Command::new(replace[0]).args(&replace[1..]).arg(&path).status();
            assert!(made.expect("coreutils").success());
            // A hang would be the end of the thread, too late for the test.
            let (tell, told) = std::sync::mpsc::channel();
            let folder = dir.path().to_owned();
            std::thread::spawn(move || tell.send(Config::from_dir(&folder).map(drop)));
            let outcome = told.recv_timeout(std::time::Duration::from_secs(60)).expect("no hang");
            let message = outcome.expect_err("no file").to_string();
            for part in [path.display().to_string().as_str(), "regular file"] {
                assert!(message.contains(part), "no `{part}` in: {message}");
            }
        }
    }
}

#[test]
fn a_folder_that_does_not_exist() {
    let dir = exported();
    let message = Config::from_dir(&dir.path().join("none")).expect_err("no folder").to_string();
    assert!(message.contains("none") && message.contains("upswing config export DIR"), "{message}");
}

#[test]
fn bytes_that_are_no_text() {
    for file in files().filter(|file| *file != "swing-up.bin") {
        let dir = exported();
        std::fs::write(dir.path().join(file), b"# caf\xe9\n").expect("write");
        let message = Config::from_dir(dir.path()).expect_err("Latin-1").to_string();
        assert!(
            message.contains(file) && message.contains("UTF-8") && message.contains("offset 5"),
            "{message}"
        );
    }
}
