//! The manoeuvres of the arm: targets, grids, and values that a request gives.

use upswing_config::{Config, GivenError, TargetValue};
use upswing_model::{Posture, Workspace};

#[test]
fn those_of_the_arm() {
    let config = Config::embedded().expect("embedded settings");
    let names: Vec<_> = config.manoeuvres.iter().map(|manoeuvre| manoeuvre.name.as_str()).collect();
    assert_eq!(names, ["swing-up", "swing-down", "move", "carry"]);
    let [up, down, to_pose, carry] = config.manoeuvres.as_slice() else { panic!("four manoeuvres") };
    assert_eq!((up.start, up.end, up.reverses), (Posture::Hanging, Posture::Standing, None));
    assert_eq!((down.start, down.end, down.reverses), (Posture::Standing, Posture::Hanging, Some(0)));
    assert_eq!((&down.grid, down.target.len()), (&up.grid, 0));
    assert_eq!((up.target.len(), up.given().count()), (7, 0));
    let rows = up.rows(&config.model, &[]).expect("rows");
    assert_eq!(rows[6].0.to_vec(), [0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    assert_eq!((rows[6].1, rows[4].1), (90_f64.to_radians(), 180_f64.to_radians()));
    assert_eq!(carry.given().map(|axis| axis.joint).collect::<Vec<_>>(), [0]);
    assert_eq!(
        to_pose.given().map(|axis| (axis.joint, axis.points)).collect::<Vec<_>>(),
        [(0, 4), (1, 1), (3, 2)]
    );
}

#[test]
fn a_rest_row_has_the_value_at_which_its_joint_hangs() {
    let config = Config::embedded().expect("embedded settings");
    let mut to_pose = config.manoeuvres[2].clone();
    for (pitch, given) in [(90.0, [0.5, -0.3, -1.7]), (60.0, [-0.4, -0.2, -1.4])] {
        to_pose.target[3].value = TargetValue::Fixed(f64::to_radians(pitch));
        let rows = to_pose.rows(&config.model, &given).expect("rows");
        let mut pose = upswing_model::JointVector::zeros(config.model.sizes());
        (pose[0], pose[1], pose[3]) = (given[0], given[1], given[2]);
        pose[5] = f64::to_radians(pitch) - given[1] + given[2];
        let rest = config.model.rest_position(&pose, &mut Workspace::default()).expect("it hangs");
        assert!(
            (rows[7].1 - rest[7]).abs() < 1e-12 && (rows[8].1 - rest[8]).abs() < 1e-12,
            "{rows:?} {rest:?}"
        );
        for (coefficients, value) in rows {
            assert!((coefficients.dot(&rest) - value).abs() < 1e-12);
        }
        assert_eq!(config.model.posture(&rest, &mut Workspace::default()), Posture::Hanging);
    }
    let refused = to_pose.rows(&config.model, &[0.0]).expect_err("three are needed");
    assert_eq!(refused, GivenError::Number { expected: 3, got: 1 });
    assert_eq!(refused.to_string(), "expected 3 values, got 1");
}
