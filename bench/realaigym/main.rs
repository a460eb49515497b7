//! Prints the scores of the RealAIGym leaderboards for acrobot and pendubot; `bench/realaigym/run` calls it. The library has the definitions.

use clap::Parser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use upswing_config::System;
use upswing_planner::replan::Planner;
use upswing_rig::realaigym::{
    Benchmark, Controller, DoublePendulum, Performance, Pilot, Version, csv, machine,
};

/// Flies the machine of the RealAIGym benchmark and prints the scores of its leaderboards
#[derive(Parser)]
#[command(name = "bench/realaigym/run")]
struct Args {
    /// Systems, acrobots or pendubots: names of shipped ones, or folders
    #[arg(long, value_name = "NAME|DIR,..", value_delimiter = ',', default_value = "acrobot,pendubot")]
    system: Vec<System>,
    /// Only the performance score, which is the result of one simulation
    #[arg(long)]
    performance: bool,
    /// Weight r of the input in (6a), s^4/rad^2: that of upswing's defaults; the systems' own ones are smaller, for a short time
    #[arg(long, value_name = "R", default_value_t = 0.01)]
    input_weight: f64,
    /// Seed of all random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Folder for the motions of the performance score, as files that the leaderboard's own script reads
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
}

fn main() -> ExitCode {
    let args = Args::parse();
    match args.system.iter().try_for_each(|system| run(system, &args)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
    }
}

fn run(system: &System, args: &Args) -> Result<(), String> {
    println!("{system}");
    for version in [Version::Two, Version::One] {
        if version == Version::One && args.performance {
            break;
        }
        let pendulum = DoublePendulum::load(system, version, args.input_weight)?;
        let benchmark = Benchmark { pendulum: &pendulum, version, seed: args.seed };
        // Without a database, whose entries have another weight, the planner optimises the plan in full.
        let planner = Planner::with_entries(pendulum.config.clone(), 0, String::new(), Vec::new())
            .map_err(|e| e.to_string())?;
        let pilot = Pilot::new(&planner)?;
        if version == Version::Two {
            let path = args.csv.as_deref().map(|folder| folder.join(format!("{system}.csv")));
            performance(&benchmark, &pilot, path.as_deref())?;
        }
        if !args.performance {
            robustness(&benchmark, &pilot);
        }
    }
    Ok(())
}

fn performance(benchmark: &Benchmark<'_>, pilot: &Pilot<'_>, csv_file: Option<&Path>) -> Result<(), String> {
    let mut pilot = pilot.clone();
    let motion = benchmark.fly(&mut |x| pilot.step(x), benchmark.nominal(), 0);
    let figures = Performance::of(&motion, &machine(benchmark.version, &benchmark.pendulum.limits));
    println!("  performance, version 2");
    for (name, value) in [
        ("success", f64::from(u8::from(figures.success))),
        ("swing-up time, s", figures.time),
        ("energy, J", figures.energy),
        ("torque cost, N^2 m^2 s", figures.cost),
        ("torque smoothness, N m", figures.smoothness),
        ("velocity cost, rad^2/s", figures.velocity),
        ("score", figures.score()),
    ] {
        println!("    {name:<26} {value:>8.3}");
    }
    let Some(path) = csv_file else { return Ok(()) };
    std::fs::write(path, csv(&motion)).map_err(|e| format!("{}: {e}; choose another --csv", path.display()))
}

fn robustness(benchmark: &Benchmark<'_>, pilot: &Pilot<'_>) {
    println!("  robustness, version {}", if benchmark.version == Version::One { 1 } else { 2 });
    let controller = || -> Box<Controller<'_>> {
        let mut pilot = pilot.clone();
        Box::new(move |x| pilot.step(x))
    };
    let result = benchmark.robustness(&controller, &AtomicBool::new(false), &|| ());
    let Some(result) = result else { return };
    for quantity in &result.quantities {
        let marks: String =
            quantity.succeeded.iter().map(|success| if *success { '+' } else { '.' }).collect();
        println!("    {:<26} {marks}", quantity.name);
    }
    for (name, share) in result.categories() {
        println!("    {name:<26} {:>8.1} %", 100.0 * share);
    }
    println!("    {:<26} {:>8.3}", "score", result.score());
}
