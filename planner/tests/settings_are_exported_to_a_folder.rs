//! `export` writes the embedded settings to a folder, and replaces no file unless it is told to.

use std::path::Path;
use upswing_config::Config;
use upswing_planner::{ExportError, export as export_system};
use upswing_process::output::{OutputError, Overwrite};

fn export(dir: &Path, overwrite: Overwrite) -> Result<(), ExportError> {
    export_system(&Config::embedded().expect("embedded settings"), dir, overwrite)
}

#[test]
fn nothing_is_overwritten() {
    for present in ["robot.urdf", "plant.toml", "swing-up.bin"] {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = dir.path().join(present);
        std::fs::write(&path, "mine").expect("write");
        let error = export(dir.path(), Overwrite::default()).expect_err("a file is there");
        assert!(matches!(error, ExportError::Output(OutputError::Exists { .. })), "{error}");
        assert!(error.to_string().contains(present), "{error}");
        assert_eq!(std::fs::read_to_string(&path).expect("read"), "mine");
        assert_eq!(std::fs::read_dir(dir.path()).expect("folder").count(), 1, "nothing else was written");
        export(dir.path(), Overwrite { force: true }).expect("it may be replaced");
        assert_ne!(std::fs::read(&path).expect("read"), b"mine");
    }
}

#[test]
fn a_new_folder_is_created() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let nested = dir.path().join("a/b");
    export(&nested, Overwrite::default()).expect("export");
    Config::from_dir(&nested).expect("exported settings");

    let file = nested.join("robot.toml");
    let error = export(&file.join("c"), Overwrite::default()).expect_err("below a file");
    assert!(matches!(error, ExportError::Output(OutputError::Io { .. })), "{error}");
}
