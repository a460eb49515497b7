//! The frames in recordings and reports are those of the model, at any angles.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::collections::HashMap;
use upswing_config::Config;
use upswing_model::{JointVector, NQ, Pose};
use upswing_record::robot::Robot;

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_joint(q in prop::array::uniform9(-3.0_f64..3.0)) {
        let config = Config::embedded().expect("the settings load");
        let robot = Robot::from_urdf(&config.urdf, &config.model).expect("it can be drawn");
        let q = JointVector::from(q);
        let mut world = HashMap::from([(robot.links[0].name.as_str(), Pose::identity())]);
        for (parent, link, pose) in robot.transforms(&q) {
            world.insert(link, world[parent] * pose);
        }
        let moving: Vec<_> = robot.links.iter().filter(|link| link.joint.is_some()).collect();
        prop_assert_eq!(moving.len(), NQ);
        for (link, expected) in moving.iter().zip(config.model.poses(&q)) {
            let got = world[link.name.as_str()];
            prop_assert!((got.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9, "{}", link.name);
        }
        prop_assert!(robot.links.iter().any(|link| !link.shapes.is_empty()));
    }
}
