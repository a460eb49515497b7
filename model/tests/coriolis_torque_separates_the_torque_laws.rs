//! C~ qd (10) is what the torque (9) has more than (11), for any u: in the golden data and in our own torque laws.

mod common;

use common::{Golden, SIZES, assert_close, robot};
use upswing_model::{JointVector, Workspace};

#[test]
fn at_random_states() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all() {
        let (x, u) = (golden.x(), golden.u());
        let coriolis = model.coriolis_torque(&golden.q(), &golden.qd(), &mut work);
        let ours = model.torque(&x, &u, &mut work) - model.torque_without_coriolis(&x, &u, &mut work);
        assert_close("C~ qd", coriolis.iter().copied(), ours.iter().copied(), 1e-10);
        let theirs =
            golden.tau.iter().zip(&golden.tau_without_coriolis).map(|(full, without)| full - without);
        assert_close("C~ qd, golden", coriolis.iter().copied(), theirs, 1e-10);
    }
}

#[test]
fn none_at_rest_and_four_times_as_much_at_twice_the_speed() {
    let (model, mut work) = (robot(), Workspace::default());
    for golden in Golden::all() {
        let at = |qd: &JointVector, work: &mut Workspace| model.coriolis_torque(&golden.q(), qd, work);
        assert_eq!(at(&JointVector::zeros(SIZES), &mut work).amax(), 0.0);
        let (once, twice) = (at(&golden.qd(), &mut work), at(&(golden.qd() * 2.0), &mut work));
        assert_close("C~ qd", twice.iter().copied(), (once * 4.0).iter().copied(), 1e-12);
    }
}
