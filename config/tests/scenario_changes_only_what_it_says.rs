//! A scenario replaces the keys that it contains and no others; an invalid one is refused with its file and key.

mod common;
use common::exported;
use upswing_config::{Config, EventError, Fault, FaultKind, MAX_DELAY, Push};
use upswing_model::JointVector;

fn embedded() -> Config {
    Config::embedded().expect("embedded settings")
}

/// The settings under a scenario with this text.
fn under(text: &str) -> Result<Config, String> {
    let dir = tempfile::tempdir().expect("temporary folder");
    let path = dir.path().join("mine.toml");
    std::fs::write(&path, text).expect("write");
    let mut config = embedded();
    match config.use_scenario(path.to_str().expect("UTF-8")) {
        Ok(_) => Ok(config),
        Err(e) => {
            let message = e.to_string();
            assert!(message.contains("mine.toml"), "{message}");
            Err(message)
        }
    }
}

#[test]
fn every_shipped_scenario_loads_and_says_what_it_is_for() {
    let dir = exported();
    let names = embedded().system().scenarios();
    assert_eq!(std::fs::read_dir(dir.path().join("scenarios")).expect("folder").count(), names.len());
    assert!(names.len() >= 16, "{names:?}");
    for name in &names {
        let (mut embedded, mut of_folder) = (embedded(), Config::from_dir(dir.path()).expect("exported"));
        let before = (embedded.plant.clone(), embedded.plant_model.fingerprint());
        let purpose = embedded.use_scenario(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(purpose.contains(' ') && purpose.ends_with('.'), "{name}: `{purpose}` is no sentence");
        let after = (embedded.plant.clone(), embedded.plant_model.fingerprint());
        assert_ne!(before, after, "{name} changes nothing");
        of_folder.use_scenario(name).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(embedded.plant, of_folder.plant, "{name}");
    }
}

#[test]
fn what_it_does_not_state_stays() {
    let config = under("purpose = 'a'\n[drive]\ntorque_lag_ms = 2\n[encoder]\nseed = 7\n").expect("scenario");
    let mut expected = embedded().plant;
    expected.drive.torque_lag = 0.002;
    expected.encoder.seed = 7;
    assert_eq!(config.plant, expected);
    assert_eq!(config.plant_model.fingerprint(), embedded().plant_model.fingerprint());
    assert_eq!(under("purpose = 'a'").expect("scenario").plant, embedded().plant);
}

#[test]
fn a_table_of_joints_changes_those_that_it_names() {
    let base = embedded().plant;
    let viscous = |value: &str| {
        let text = format!("purpose = 'a'\n[friction]\nviscous = {value}\n");
        under(&text).expect("scenario").plant.friction.viscous
    };
    let mut expected = base.friction.viscous;
    expected[2] = 5.0;
    assert_eq!(viscous("{ joint_3 = 5 }"), expected);
    assert_eq!(viscous("5").to_vec(), [5.0; 9]);
    let mut expected = JointVector::zeros(expected.sizes());
    expected[2] = 5.0;
    assert_eq!(viscous("{ default = 0, joint_3 = 5 }"), expected);
    // The base is one number.
    let encoder =
        under("purpose = 'a'\n[encoder]\nnoise_rad = { joint_2 = 1e-4 }\n").expect("scenario").plant.encoder;
    let changed = encoder.noise.iter().zip(base.encoder.noise.iter()).map(|(new, old)| new != old);
    assert!(encoder.noise[1] == 1e-4 && changed.filter(|changed| *changed).count() == 1);
    let stops = under("purpose = 'a'\n[stops.margin_deg]\njoint_2 = 0\n").expect("scenario").plant.stops;
    let limits = embedded().robot.limits;
    assert_eq!((stops.q_min[1], stops.q_max[1]), (limits.q_min[1], limits.q_max[1]));
    assert_eq!((stops.q_min[0], stops.q_max[8]), (base.stops.q_min[0], base.stops.q_max[8]));
}

#[test]
fn a_plant_has_the_kinds_of_joints_of_the_robot() {
    let dir = exported();
    let path = dir.path().join("robot-acin.urdf");
    let text = std::fs::read_to_string(&path).expect("the arm");
    let (arm, pendulum) = text.split_at(text.find("<joint name=\"pendulum_1\"").expect("the joint"));
    std::fs::write(&path, format!("{arm}{}", pendulum.replacen("effort=\"0\"", "effort=\"1\"", 1)))
        .expect("written");
    let message =
        under(&format!("purpose = 'a'\n[model]\nurdf = '{}'", path.display())).expect_err("8 motors");
    assert!(
        message.contains("model.urdf: expected the kinds of joints of robot.urdf, actuated revolute"),
        "{message}"
    );
}

#[test]
fn a_second_scenario_replaces_the_first() {
    let mut config = embedded();
    config.use_scenario("second-arm").expect("scenario");
    config.use_scenario("slow-drives").expect("scenario");
    assert_eq!(config.plant_model.fingerprint(), config.model.fingerprint());
    assert_eq!(config.plant.drive.command_delay, 2);
}

#[test]
fn the_second_arm_has_the_geometry_of_the_first() {
    let mut config = embedded();
    config.use_scenario("second-arm").expect("scenario");
    assert_ne!(config.plant_model.fingerprint(), config.model.fingerprint());
    assert_eq!(config.plant_model.rated_limits(), config.model.rated_limits());
    for k in 0..20 {
        let q = JointVector::from_fn(config.model.sizes(), |i| (1.7 * k as f64 + 0.9 * i as f64).sin() * 2.0);
        assert_eq!(config.plant_model.poses(&q), config.model.poses(&q));
        assert_eq!(config.plant_model.tip(&q), config.model.tip(&q));
    }
}

#[test]
fn any_urdf_can_be_the_plant() {
    let dir = exported();
    let urdf = dir.path().join("robot-acin.urdf");
    let config = under(&format!("purpose = 'a'\n[model]\nurdf = '{}'", urdf.display())).expect("scenario");
    let mut second = embedded();
    second.use_scenario("second-arm").expect("scenario");
    assert_eq!(config.plant_model.fingerprint(), second.plant_model.fingerprint());
}

#[test]
fn faults_and_pushes_are_read() {
    let config = under(
        "purpose = 'a'\n\
         [[fault]]\nkind = 'encoder-jump'\nfrom_cycle = 5\njoint = 'pendulum_1'\namount = 0.1\n\
         [[fault]]\nkind = 'delay-measurement'\nfrom_cycle = 9\ncycles = 3\namount = 2\n\
         [[push]]\nfrom_cycle = 4\ncycles = 2\nimpulse_ns = [0, 0.5, 1]\n",
    )
    .expect("scenario");
    let jump = Fault { kind: FaultKind::EncoderJump, from: 5, cycles: 0, joint: 7, amount: 0.1 };
    let delay = Fault { kind: FaultKind::DelayMeasurement, from: 9, cycles: 3, joint: 0, amount: 2.0 };
    assert_eq!(config.plant.faults, [jump, delay]);
    assert_eq!(config.plant.pushes, [Push { from: 4, cycles: 2, impulse: [0.0, 0.5, 1.0] }]);
    assert_eq!([4, 5, 1_000_000].map(|cycle| jump.acts(cycle)), [false, true, true]);
    assert_eq!([8, 9, 11, 12].map(|cycle| delay.acts(cycle)), [false, true, true, false]);
}

#[test]
fn what_cannot_be_is_refused() {
    let too_late = format!("amount: expected a whole number of cycles from 1 to {MAX_DELAY}, got 64");
    for (text, parts) in [
        ("", &["missing field `purpose`"][..]),
        ("purpose = ' '", &["purpose: expected a sentence"]),
        ("purpose = 1", &["line 1", "purpose"]),
        ("purpose = 'a'\nfriction = 3", &["friction", "expected a table as in plant.toml, got a number"]),
        ("purpose = 'a'\n[drives]\na = 1", &["drives", "expected a key of plant.toml"]),
        ("purpose = 'a'\n[drive]\ntorque_lag = 1", &["drive.torque_lag", "expected a key of plant.toml"]),
        ("purpose = 'a'\n[drive]\ntorque_lag_ms = '1'", &["drive.torque_lag_ms", "a number", "a string"]),
        ("purpose = 'a'\n[drive]\ntorque_lag_ms = -1", &["drive.torque_lag_ms", "0 or above, got -1"]),
        ("purpose = 'a'\n[drive]\ncommand_delay_cycles = 64", &["drive.command_delay_cycles", "0 to 63"]),
        ("purpose = 'a'\n[encoder]\nnoise_rad = [1, 'b']", &["encoder.noise_rad", "a list with a string"]),
        ("purpose = 'a'\n[encoder]\nnoise_rad = 'b'", &["encoder.noise_rad", "a number as in", "a string"]),
        (
            "purpose = 'a'\n[encoder]\nnoise_rad = [1]",
            &["encoder.noise_rad", "by joint name", "got a list of 1"],
        ),
        (
            "purpose = 'a'\n[encoder]\nnoise_rad = { joint_8 = 1 }",
            &["line 3", "encoder.noise_rad.joint_8", "one of joint_1, joint_2", "got `joint_8`"],
        ),
        (
            "purpose = 'a'\n[drive]\ntorque_lag_ms = { joint_1 = 1 }",
            &["drive.torque_lag_ms", "invalid type: map"],
        ),
        ("purpose = 'a'\n[start]\nunactuated = 'up'", &["`up`", "`rest` or `zero`"]),
        ("purpose = 'a'\n[model]\nurdf = 'robot.toml'", &["model.urdf", "robot-acin.urdf", "a path"]),
        (
            "purpose = 'a'\n[model]\npayload_position_m = [1, 2]",
            &["payload_position_m", "3 numbers, for x, y and z", "got 2"],
        ),
        ("purpose = 'a'\n[[fault]]\nkind = 'b'\nfrom_cycle = 1", &["line 3", "fault.kind", "`lose-command`"]),
        ("purpose = 'a'\n[[fault]]\nkind = 'lose-command'\nfrom_cycle = 0", &["fault.from_cycle", "from 1"]),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'encoder-jump'\nfrom_cycle = 1\njoint = 'pendulum_1'",
            &["amount: expected a finite number other than 0, rad, got 0"],
        ),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'encoder-nan'\nfrom_cycle = 1",
            &["fault.joint", "expected one of joint_1, joint_2", "pendulum_2, got none"],
        ),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'encoder-nan'\nfrom_cycle = 1\njoint = 'joint_8'",
            &["fault.joint", "expected one of joint_1, joint_2", "pendulum_2, got `joint_8`"],
        ),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'arm-torque'\nfrom_cycle = 1\namount = 1\njoint = 'pendulum_1'",
            &["fault.joint", "joint_6, joint_7, got `pendulum_1`"],
        ),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'encoder-nan'\nfrom_cycle = 1\njoint = 2",
            &["fault", "integer `2`"],
        ),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'stale-time'\nfrom_cycle = 1\njoint = 'joint_2'",
            &["fault.joint", "expected none for this kind, got `joint_2`"],
        ),
        (
            "purpose = 'a'\n[[fault]]\nkind = 'delay-measurement'\nfrom_cycle = 1\namount = 64",
            &["fault", too_late.as_str()],
        ),
        (
            "purpose = 'a'\n[[push]]\nfrom_cycle = 1\ncycles = 1\nimpulse_ns = [nan, 0, 0]",
            &["push.impulse_ns", "expected a finite number, got NaN for x"],
        ),
        ("purpose = 'a'\n[[push]]\nfrom_cycle = 1\ncycles = 1\nimpulse_ns = [0, 0]", &["push.impulse_ns"]),
        (
            "purpose = 'a'\n[[push]]\nfrom_cycle = 1\ncycles = 1\nimpulse_ns = [0, 0, 1, 0]",
            &["push.impulse_ns", "3 numbers, for x, y and z", "got 4"],
        ),
    ] {
        let message = under(text).err().unwrap_or_else(|| panic!("accepted: {text}"));
        for part in parts {
            assert!(message.contains(part), "{text}: no `{part}` in: {message}");
        }
    }
    assert_eq!(
        Push { from: 1, cycles: 0, impulse: [0.0; 3] }.check(),
        Err(EventError::Duration),
        "a push needs time"
    );
}

#[test]
fn a_scenario_that_is_not_there_is_refused_with_those_that_are() {
    let message = embedded().use_scenario("nowhere").expect_err("no such scenario").to_string();
    for name in embedded().system().scenarios() {
        assert!(message.contains(&name), "{message}");
    }
    let message = embedded().use_scenario("no/where.toml").expect_err("no such file").to_string();
    assert!(message.contains("no/where.toml: cannot be read"), "{message}");
}
