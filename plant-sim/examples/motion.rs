//! The motion of the plant without controller and clock, for comparison with other simulators (`bench/plant/run`).
//!
//! Argument: a scenario, optional. Standard input, one JSON list per line: first the state at the start, positions of all joints from
//! base to tip (rad or m), then their velocities, then the torques of the actuated joints in each control period (N m or N). Standard
//! output: the true state at the end of each period.

use std::error::Error;
use std::io::{BufRead, BufWriter, Write, stdin, stdout};
use upswing_config::Config;
use upswing_ipc::Command;
use upswing_model::ActuatedVector;
use upswing_plant::Plant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut config = Config::embedded()?;
    if let Some(scenario) = std::env::args().nth(1) {
        config.use_scenario(&scenario)?;
    }
    let mut lines = stdin().lock().lines();
    let first = lines.next().ok_or("expected a line with the state at the start, got no input")??;
    let first: Vec<f64> = serde_json::from_str(&first)?;
    let (order, sizes) = (*config.model.order(), config.model.sizes());
    let x = first.split_at_checked(sizes.joints()).and_then(|(q, qd)| order.sorted_state(q, qd)).ok_or_else(
        || format!("expected {} numbers, positions and velocities, got {}", sizes.state(), first.len()),
    )?;
    let mut plant = Plant::at(&config, &x.q(), &x.qd())?;
    let mut output = BufWriter::new(stdout().lock());
    for line in lines {
        let tau: Vec<f64> = serde_json::from_str(&line?)?;
        let tau = ActuatedVector::from_slice(sizes, &tau)
            .ok_or_else(|| format!("expected {} torques, got {}", sizes.actuated(), tau.len()))?;
        plant.step(Some(&Command::new(&tau)));
        let [q, qd] = [plant.position(), plant.velocity()].map(|v| order.in_chain(v));
        let x = [&q[..sizes.joints()], &qd[..sizes.joints()]].concat();
        writeln!(output, "{}", serde_json::to_string(&x)?)?;
    }
    Ok(output.flush()?)
}
