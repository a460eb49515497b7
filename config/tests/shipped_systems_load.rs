//! Every shipped system loads, and its exported files load to the same settings.

mod common;
use common::export;
use std::collections::BTreeSet;
use std::path::Path;
use upswing_config::{Config, System};

fn load(name: &str) -> Config {
    let system: System = name.parse().expect("a shipped system");
    Config::load(&system).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn with_the_same_settings_after_an_export() {
    for system in System::shipped() {
        let shipped = load(system.name());
        let dir = export(&shipped);
        let exported = Config::from_dir(dir.path()).unwrap_or_else(|e| panic!("{}: {e}", system.name()));
        assert_eq!(exported.urdf, shipped.urdf);
        assert_eq!(exported.robot, shipped.robot, "{}", system.name());
        assert_eq!(exported.manoeuvres, shipped.manoeuvres);
        assert_eq!(exported.planner, shipped.planner);
        assert_eq!(exported.daemon, shipped.daemon);
        assert_eq!(exported.plant, shipped.plant);
        assert_eq!(exported.plant_model.fingerprint(), shipped.plant_model.fingerprint());
        // An export of the export changes nothing.
        let texts = |config: &Config| config.texts().expect("texts");
        assert_eq!(texts(&exported), texts(&shipped));
    }
}

#[test]
fn and_contain_every_file_of_their_folders() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("systems");
    let names = |dir: &Path| -> BTreeSet<String> {
        let entries = std::fs::read_dir(dir).expect("a folder").map(|entry| entry.expect("an entry"));
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    };
    let shipped: BTreeSet<_> = System::shipped().map(|system| system.name().to_owned()).collect();
    assert_eq!(names(&folder), shipped);
    for name in shipped {
        let dir = folder.join(&name);
        let embedded: BTreeSet<_> =
            load(&name).files().expect("files").into_iter().map(|(name, _)| name).collect();
        let mut expected = names(&dir);
        expected.retain(|file| !file.ends_with(".bin"));
        if expected.remove("scenarios") {
            expected
                .extend(names(&dir.join("scenarios")).into_iter().map(|file| format!("scenarios/{file}")));
        }
        for file in expected {
            assert!(
                embedded.contains(&file),
                "{name}/{file} is not embedded: add it to config/src/system.rs"
            );
        }
    }
}

#[test]
fn by_name_or_folder() {
    assert_eq!(System::default().to_string(), "iiwa-pendulum");
    for text in ["cart-pole", "./cart-pole", "/etc/upswing"] {
        let system: System = text.parse().expect("a system");
        assert_eq!(system.to_string().parse(), Ok(system));
    }
    let message = "cart-poel".parse::<System>().expect_err("no system").to_string();
    assert!(
        message.contains("iiwa-pendulum, ")
            && message.contains("cart-pole")
            && message.contains("`cart-poel`")
    );
    assert_eq!(
        "cart-pole".parse::<System>().expect("shipped"),
        System::Shipped(System::shipped().find(|system| system.name() == "cart-pole").expect("shipped"))
    );
}
