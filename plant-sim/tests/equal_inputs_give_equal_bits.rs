//! The plant is a function of its settings and commands, to the last bit, whatever they are.

mod common;

use common::{settings, torque};
use upswing_ipc::Command;
use upswing_model::NU;
use upswing_plant::Plant;

/// Any torque up to twice what drives can do, sometimes brakes, silence, and what is no number.
fn command(k: u64) -> Option<Command> {
    let mut word = k.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut draw = || {
        word ^= word << 13;
        word ^= word >> 7;
        word ^= word << 17;
        (word >> 11) as f64 / (1_u64 << 53) as f64
    };
    let max = settings_tau();
    let mut command = torque(std::array::from_fn(|i| 4.0 * (draw() - 0.5) * max[i]));
    match k % 97 {
        13 => return None,
        31 => command.brake = 1,
        57 if k.is_multiple_of(11) => command.tau[3] = f64::NAN,
        _ => {}
    }
    Some(command)
}

fn settings_tau() -> [f64; NU] {
    [320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0]
}

#[test]
fn two_runs_agree_bit_by_bit_and_stay_finite() {
    let config = settings();
    let mut plants = [Plant::new(&config).unwrap(), Plant::new(&config).unwrap()];
    for k in 1..1_100 {
        let command = command(k);
        let bits = plants.each_mut().map(|plant| {
            plant.step(command.as_ref());
            assert!(plant.position().iter().chain(plant.velocity().iter()).all(|v| v.is_finite()));
            let m = plant.measure();
            let state = plant.position().iter().chain(plant.velocity().iter()).map(|v| v.to_bits());
            (state.collect::<Vec<_>>(), m.q.map(f64::to_bits), m.status, m.seq)
        });
        assert_eq!(bits[0], bits[1], "cycle {k}");
    }
}
