//! The frames in recordings and reports are those of the model, at any angles.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::collections::HashMap;
use upswing_config::Config;
use upswing_model::{Model, Pose};
use upswing_record::robot::Robot;

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_joint(q in prop::collection::vec(-3.0_f64..3.0, 9)) {
        let config = Config::embedded().expect("the settings load");
        let robot = Robot::from_urdf(&config.urdf, &config.model).expect("it can be drawn");
        let mut world = HashMap::from([(robot.links[0].name.as_str(), Pose::identity())]);
        for (parent, link, pose) in robot.transforms(&q) {
            world.insert(link, world[parent] * pose);
        }
        let moving: Vec<_> = robot.links.iter().filter(|link| link.joint.is_some()).collect();
        prop_assert_eq!(moving.len(), config.model.sizes().joints());
        for (link, expected) in moving.iter().zip(config.model.poses(&config.model.order().sorted(&q).expect("nine"))) {
            let got = world[link.name.as_str()];
            prop_assert!((got.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9, "{}", link.name);
        }
        prop_assert!(robot.links.iter().any(|link| !link.shapes.is_empty()));
    }
}

/// A crane: a trolley, a rope of a length that a motor sets, and a load that swings at its end.
const CRANE: &str = r#"<robot name="crane">
    <link name="world"/>
    <link name="trolley"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <link name="rope"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <link name="load"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="track" type="prismatic">
        <parent link="world"/><child link="trolley"/><axis xyz="1 0 0"/>
        <limit lower="-2" upper="2" velocity="1" effort="100"/>
    </joint>
    <joint name="swing" type="continuous">
        <parent link="trolley"/><child link="rope"/><axis xyz="0 1 0"/><limit velocity="5" effort="0"/>
    </joint>
    <joint name="hoist" type="prismatic">
        <parent link="rope"/><child link="load"/><origin xyz="0 0 -0.5" rpy="0.3 0 0"/><axis xyz="0 0.6 -0.8"/>
        <limit lower="0" upper="2" velocity="1" effort="100"/>
    </joint>
</robot>"#;

#[test]
fn joints_that_slide_and_unactuated_joints_anywhere() {
    let model = Model::from_urdf(CRANE).expect("a chain");
    let robot = Robot::from_urdf(CRANE, &model).expect("it can be drawn");
    // In the chain's order; sorted, the unactuated joint is the last.
    let q = [0.7, 0.4, 1.1];
    let sorted = model.order().sorted(&q).expect("three");
    assert_eq!(sorted.as_slice(), [0.7, 1.1, 0.4]);
    let poses = model.poses(&sorted);
    let mut world = Pose::identity();
    for ((_, link, pose), expected) in robot.transforms(&q).zip(&poses) {
        world *= pose;
        assert!((world.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-12, "{link}");
    }
    assert_eq!(poses.len(), robot.links.len() - 1);
}
