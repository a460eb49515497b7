//! An exported folder of settings to edit, and the message that the edit earns.

use std::path::Path;
use upswing_config::Config;

/// Exports the files of the default system to a folder that vanishes with the returned guard.
#[allow(dead_code, reason = "not every test file edits the default system")]
pub fn exported() -> tempfile::TempDir {
    export(&Config::embedded().expect("embedded settings"))
}

/// Exports the files of a system to a folder that vanishes with the returned guard.
pub fn export(config: &Config) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("temporary folder");
    for (name, bytes) in config.files().expect("files") {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("folder");
        std::fs::write(path, bytes).expect("file");
    }
    dir
}

#[allow(dead_code, reason = "not every test file edits a file")]
/// Replaces text, which must occur exactly once, in a file of the folder.
pub fn edit(dir: &Path, file: &str, from: &str, to: &str) {
    let path = dir.join(file);
    let text = std::fs::read_to_string(&path).expect("exported file");
    assert_eq!(text.matches(from).count(), 1, "`{from}` in {file}");
    std::fs::write(&path, text.replace(from, to)).expect("edited file");
}

/// Makes one edit and expects a message that contains the file's path and all of `parts`.
#[allow(dead_code, reason = "not every test file refuses an edit")]
pub fn refused(file: &str, from: &str, to: &str, parts: &[&str]) {
    let dir = exported();
    edit(dir.path(), file, from, to);
    let Err(error) = Config::from_dir(dir.path()) else { panic!("{file}: `{to}` was accepted") };
    let message = error.to_string();
    let path = dir.path().join(file).display().to_string();
    for part in parts.iter().copied().chain([path.as_str()]) {
        assert!(message.contains(part), "{file}: `{to}`: no `{part}` in: {message}");
    }
}
