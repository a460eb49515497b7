//! A measured angle is the multiple of the encoder's resolution nearest to the true angle.

mod common;

use common::{at_rest, equal_torques, level_pose, settings, sizes};
use upswing_ipc::{Clock, Measurement};
use upswing_plant::Plant;

#[test]
fn every_angle_is_on_the_grid_and_nearest() {
    let config = settings();
    let encoder = &config.plant.encoder;
    assert_eq!(
        encoder.resolution.to_vec(),
        [&[2e-5; 7][..], &[std::f64::consts::TAU / 131_072.0; 2]].concat()
    );
    let mut plant = Plant::at(&config, &level_pose(), &at_rest()).unwrap();
    for _ in 0..500 {
        plant.step(Some(&equal_torques(1.0)));
        let measured = plant.measure();
        for i in 0..sizes().joints() {
            let step = encoder.resolution[i];
            let steps = (measured.q[i] / step).round();
            assert_eq!(measured.q[i], steps * step, "joint {} is on the grid", i + 1);
            let error = (measured.q[i] - plant.position()[i]).abs();
            assert!(error <= 0.5 * step * (1.0 + 1e-9), "joint {}: off by {error:e} rad", i + 1);
        }
    }
}

#[test]
fn cycles_count_from_one_and_time_is_simulated() {
    let config = settings();
    let mut plant = Plant::new(&config).unwrap();
    for seq in 1..10 {
        let m = plant.measure();
        assert_eq!((m.seq, m.t_ns, m.period_ns), (seq, seq * 125_000, 125_000));
        assert_eq!(m.clock().unwrap(), Clock::Lockstep);
        let expected = Measurement::BRAKES_CLOSED | Measurement::LOAD_SENSED;
        assert_eq!(m.status, expected);
        plant.step(None);
    }
}
