//! Reruns one cell of the fault matrix (docs/faults.md) and shows its last two seconds.
//!
//! Example: cargo run --release -p upswing-tests --example cell -- balance encoder-stuck --joint pendulum_1

use clap::Parser;
use std::path::PathBuf;
use upswing_config::Config;
use upswing_ipc::Telemetry;
use upswing_record::Recorder;
use upswing_rig::fault_args::FaultArgs;
use upswing_tests::matrix::{FaultCase, WATCHED, mode};
use upswingd::warning_texts;

/// Cycles that are shown: two seconds; and every how many of them, where nothing changes.
const SHOWN: usize = 16_000;
const EVERY: usize = 800;

/// Breaks the plant in a mode of the daemon, lock-step, and shows what follows.
#[derive(Parser)]
struct Cli {
    /// Mode of the daemon: idle, hold, track, balance, stop or fault
    mode: String,
    #[command(flatten)]
    fault: FaultArgs,
    /// Record the run in this new file, for `upswing report` and `upswing replay`
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = Cli::parse();
    let mut case = FaultCase::idle(None);
    case.records = Some(Vec::new());
    let mut case = case.in_mode(mode(&args.mode));
    let first = case.system.plant.seq();
    let fault = args.fault.fault(&case.config.model)?;
    case.break_now(fault);
    case.run(WATCHED);
    let records = case.records.take().unwrap_or_default();
    let cycles: Vec<Telemetry> = records.iter().map(|record| record.telemetry).collect();

    println!("the fault begins in cycle {first}\n");
    println!("   cycle   t_plan  mode     largest |q - q_d|   |tau|/N m  brake  warnings");
    let shown = &cycles[cycles.len().saturating_sub(SHOWN)..];
    for (i, cycle) in shown.iter().enumerate() {
        let before = &shown[i.saturating_sub(1)];
        let same = (before.mode, before.warnings) == (cycle.mode, cycle.warnings);
        if same && !i.is_multiple_of(EVERY) && i + 1 != shown.len() {
            continue;
        }
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        let error =
            largest(&mut cycle.of_joints(&cycle.q).iter().zip(&cycle.q_d).map(|(q, d)| (q - d).abs()));
        let tau = largest(&mut cycle.of_actuated(&cycle.tau).iter().map(|tau| tau.abs()));
        let mode = cycle.mode_text();
        let brake = if cycle.flags & Telemetry::BRAKE == 0 { "open" } else { "closed" };
        let warnings: Vec<_> = warning_texts(cycle.warnings).collect();
        println!(
            "{:8} {:8.3}  {mode:8} {error:15.5} rad  {tau:10.2}  {brake:6} {}",
            cycle.measurement_seq,
            cycle.t_plan,
            warnings.join(", ")
        );
    }
    if let Some(trip) = case.system.controller.trip() {
        println!("\ntripped: {}", trip.text(&case.config.model));
    }
    println!("\noutcome: {}", case.outcome());

    if let Some(file) = &args.record {
        let mut recorder = Recorder::create(file, &Config::embedded()?, [("clock", "lockstep".into())])?;
        if let Some(plan) = &case.plan {
            recorder.write_plan(plan)?;
        }
        recorder.write_steps(&records.iter().map(|record| record.step).collect::<Vec<_>>())?;
        recorder.write(&cycles)?;
        recorder.finish()?;
    }
    Ok(())
}
