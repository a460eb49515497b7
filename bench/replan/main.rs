//! Times replanning: its QPs, its steps, and requests to a running system; `bench/replan/run` calls it.
//!
//! - `solvers FOLDER STARTS`: for random starts the first two QPs with both back ends, whole replans and LQR syntheses;
//!   writes the QPs and their solutions to FOLDER for the peers.
//! - `system STARTS`: a running system: from request to plan accepted, and the memory of the planner.

mod qps;
mod solvers;
mod system;

use std::path::Path;
use std::time::Duration;
use upswing_config::Config;
use upswing_model::State;
use upswing_rig::montecarlo::{RandomStarts, Spread};

/// Seed of the random starts.
const SEED: u64 = 0;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match (arguments.as_slice(), arguments.last().and_then(|n| n.parse().ok())) {
        (["solvers", folder, _], Some(n)) if n > 0 => solvers::run(Path::new(folder), n),
        (["system", _], Some(n)) if n > 0 => system::run(n),
        _ => {
            eprintln!("error: expected `solvers FOLDER STARTS` or `system STARTS`, got {arguments:?}");
            std::process::exit(2);
        }
    }
}

/// Settings and random starts, those of `upswing montecarlo` with the same seed.
fn starts(config: &Config, count: u64) -> Vec<State> {
    let starts = RandomStarts { config, seed: SEED };
    (0..count).map(|i| starts.start(i).unwrap_or_else(|e| panic!("{e}"))).collect()
}

fn config() -> Config {
    Config::embedded().unwrap_or_else(|e| panic!("{e}"))
}

/// Prints median and 99th percentile of times, in ms.
fn print(name: &str, times: impl IntoIterator<Item = Duration>) {
    let ms: Vec<f64> = times.into_iter().map(|t| 1e3 * t.as_secs_f64()).collect();
    let samples = ms.len();
    if let Some(s) = Spread::of(ms) {
        println!("{name:<44} median {:>8.3} ms, p99 {:>8.3} ms ({samples} samples)", s.median, s.p99);
    }
}
