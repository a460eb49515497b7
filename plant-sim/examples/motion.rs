//! The motion of the plant without controller and clock, for comparison with other simulators (`bench/plant/run`).
//!
//! Argument: a scenario, optional. Standard input, one JSON value per line: first the state at the start, 18 numbers
//! (q, rad, then qd, rad/s), then the torques of each control period, 7 numbers (N m). Standard output: the true state
//! at the end of each period.

use std::error::Error;
use std::io::{BufRead, BufWriter, Write, stdin, stdout};
use upswing_config::Config;
use upswing_ipc::Command;
use upswing_model::{NQ, NX, State, StateParts, state};
use upswing_plant::Plant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut config = Config::embedded()?;
    if let Some(scenario) = std::env::args().nth(1) {
        config.use_scenario(&scenario)?;
    }
    let mut lines = stdin().lock().lines();
    let first = lines.next().ok_or("expected a line with the state at the start, got no input")??;
    let first: Vec<f64> = serde_json::from_str(&first)?;
    if first.len() != NX {
        return Err(format!("expected {NX} numbers, {NQ} angles and velocities, got {}", first.len()).into());
    }
    let x = State::from_column_slice(&first);
    let mut plant = Plant::at(&config, &x.q(), &x.qd())?;
    let mut output = BufWriter::new(stdout().lock());
    for line in lines {
        let tau = serde_json::from_str(&line?)?;
        plant.step(Some(&Command { tau, ..Command::default() }));
        let x = state(plant.position(), plant.velocity());
        writeln!(output, "{}", serde_json::to_string(x.as_slice())?)?;
    }
    Ok(output.flush()?)
}
