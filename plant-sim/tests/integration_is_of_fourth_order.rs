//! The steps of a period are fine enough, and halving them divides the error by sixteen.

mod common;

use common::{level_pose, settings, sizes, torque};
use upswing_config::Config;
use upswing_model::{ActuatedVector, JointVector, Period, State};
use upswing_plant::Plant;

const TAU: [f64; 7] = [5.0, -60.0, 3.0, 20.0, -1.0, 2.0, 0.2];

fn after(config: &Config, brakes: bool, substeps: u32, periods: u32) -> State {
    let mut config = config.clone();
    config.plant.integrator.substeps = substeps;
    let mut q = level_pose();
    (q[7], q[8]) = (0.5, -0.3);
    let qd = JointVector::from_fn(sizes(), |i| 0.05 * (i as f64 - 4.0));
    let mut plant = Plant::at(&config, &q, &qd).unwrap();
    for _ in 0..periods {
        plant.step(
            if brakes { None } else { Some(torque(&ActuatedVector::from_slice(sizes(), &TAU).unwrap())) }
                .as_ref(),
        );
    }
    State::new(plant.position(), plant.velocity())
}

#[test]
fn a_period_agrees_with_much_finer_steps() {
    let config = settings();
    for brakes in [false, true] {
        let error = (after(&config, brakes, config.plant.integrator.substeps, 200)
            - after(&config, brakes, 20, 200))
        .amax();
        assert!(error < 1e-7, "brakes closed {brakes}: {error:e} rad or rad/s after 25 ms");
    }
}

#[test]
fn halving_the_step_divides_the_error_by_sixteen() {
    let mut config = settings();
    // Long enough that rounding is negligible. No Coulomb friction: it is too steep for the order of the method.
    config.daemon.cycle.period = Period::from_micros(4000);
    config.plant.friction.coulomb.unactuated_mut().fill(0.0);
    config.plant.drive.brake_time_constant = 0.1;
    for brakes in [false, true] {
        let exact = after(&config, brakes, 32, 20);
        let errors = [2, 4].map(|substeps| (after(&config, brakes, substeps, 20) - exact).amax());
        let ratio = errors[0] / errors[1];
        assert!((12.0..22.0).contains(&ratio), "brakes closed {brakes}: {errors:?}, ratio {ratio}");
    }
}
