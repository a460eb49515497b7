//! With q3 = q5 = q7 = 0 the pendulum hangs at q8 = 0, q9 = pitch - 90 deg, pitch = q2 - q4 + q6; at pitch 90 deg
//! q8 = 180 deg, q9 = 0 is upright and an equilibrium, too.

mod common;

use common::{SIZES, robot};
use upswing_model::{JointVector, Workspace};

fn pose(q2: f64, q4: f64, q6: f64) -> JointVector {
    let mut q = JointVector::zeros(SIZES);
    (q[1], q[3], q[5]) = (q2.to_radians(), q4.to_radians(), q6.to_radians());
    q
}

#[test]
fn hanging_at_any_pitch() {
    let (model, mut work) = (robot(), Workspace::default());
    for (q2, q4, q6) in [(0.0, -90.0, 0.0), (-15.0, -95.0, 10.0), (30.0, -60.0, 20.0), (-30.0, -120.0, -20.0)]
    {
        let rest = model.rest_position(&pose(q2, q4, q6), &mut work).expect("it hangs");
        assert!(rest[7].abs() < 1e-9);
        assert!((rest[8].to_degrees() - (q2 - q4 + q6 - 90.0)).abs() < 1e-9, "q9 = {}", rest[8].to_degrees());
    }
}

#[test]
fn in_twisted_poses_too() {
    let (model, mut work) = (robot(), Workspace::default());
    let mut q = pose(10.0, -80.0, 5.0);
    (q[0], q[2], q[4], q[6]) = (0.5, 0.3, -0.4, 0.7);
    let rest = model.rest_position(&q, &mut work).expect("it hangs");
    assert!(model.gravity_torque(&rest, &mut work).unactuated().amax() < 1e-9);
    // Lower than anywhere else on a grid of pendulum angles.
    let lowest = model.potential_energy(&rest);
    for i in -18..=18 {
        for j in -18..=18 {
            let mut other = rest;
            (other[7], other[8]) = (f64::from(i) * 0.17, f64::from(j) * 0.17);
            assert!(model.potential_energy(&other) >= lowest - 1e-12);
        }
    }
    assert_eq!(rest.actuated(), q.actuated(), "the arm stays");
}

#[test]
fn near_the_start_of_the_search() {
    let (model, mut work) = (robot(), Workspace::default());
    // Where the flange points down or up, the start of the search is far from rest, or a saddle.
    for q2 in [0.0, 40.0, -60.0, 119.0] {
        let rest = model.rest_position(&pose(q2, 0.0, 0.0), &mut work).expect("it hangs");
        assert!(rest.unactuated().amax() < 2.0 * std::f64::consts::PI, "{q2}: {rest:?}");
    }
}

#[test]
fn upright_is_an_equilibrium_with_the_tip_above() {
    let (model, mut work) = (robot(), Workspace::default());
    let mut q = pose(20.0, -60.0, 10.0);
    q[7] = std::f64::consts::PI;
    let g = model.gravity_torque(&q, &mut work);
    assert!(g.unactuated().amax() < 1e-12);
    let rod = model.rod(&q);
    assert!((rod.z - 0.5).abs() < 1e-12, "the rod of 0.5 m points up, got {rod:?}");
}

#[test]
fn from_each_equilibrium_the_lowest_and_the_highest() {
    for (urdf, free) in [
        (include_str!("../../config/systems/cart-pole/robot.urdf"), 1),
        (include_str!("../../config/systems/cart-double/robot.urdf"), 2),
        (include_str!("../../config/systems/cart-triple/robot.urdf"), 3),
    ] {
        let (model, mut work) =
            (upswing_model::Model::from_urdf(urdf).expect("the robot"), Workspace::default());
        let at = |turned: usize| {
            // The links are relative to each other: half a turn of one turns those behind it, too.
            let half = |i: usize| f64::from(u8::from(turned & (1 << i) != 0)) * std::f64::consts::PI;
            JointVector::from_fn(model.sizes(), |i| if i == 0 { 0.2 } else { half(i - 1) })
        };
        let energies: Vec<_> = (0..1 << free).map(|turned| model.potential_energy(&at(turned))).collect();
        let lowest = energies.iter().copied().fold(f64::INFINITY, f64::min);
        let highest = energies.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for turned in 0..1 << free {
            let rest = model.rest_position(&at(turned), &mut work).expect("it hangs");
            let upright = model.upright_position(&at(turned), &mut work).expect("it stands");
            assert!((model.potential_energy(&rest) - lowest).abs() < 1e-9, "{turned}: {rest:?}");
            assert!((model.potential_energy(&upright) - highest).abs() < 1e-9, "{turned}: {upright:?}");
            assert_eq!((rest[0], upright[0]), (0.2, 0.2));
        }
    }
}
