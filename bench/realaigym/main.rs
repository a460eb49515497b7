//! The RealAIGym benchmark of acrobot and pendubot: the daemon swings up its simulated machine; `bench/realaigym/run` calls it. bench/README.md
//! names the sources of all definitions.

mod boards;
mod machine;
mod pilot;
mod scores;

use boards::{Benchmark, Version};
use clap::Parser;
use machine::{Joints, Parameters};
use pilot::Pilot;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use upswing_config::{Config, Level, System};
use upswing_model::{JointVector, Model, Workspace};
use upswing_planner::replan::Planner;

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
    let mut config = Config::load(system).map_err(|e| e.to_string())?;
    let order = *config.model.order();
    let (joints, actuated) = (order.sizes().joints(), order.sizes().actuated());
    if (joints, actuated) != (2, 1) {
        return Err(format!(
            "{system}: expected a double pendulum, 2 joints and 1 of them actuated, got {joints} and {actuated}; choose \
             another --system"
        ));
    }
    if !(args.input_weight > 0.0 && args.input_weight.is_finite()) {
        return Err(format!("--input-weight: expected a number above 0, got {}", args.input_weight));
    }
    config.planner.offline.input_weight = args.input_weight;
    never_trip(&mut config);
    let mut limits: Joints = [0.0; 2];
    limits[order.joint(0)] = config.robot.limits.tau_max[0];

    println!("{system}");
    for version in [Version::Two, Version::One] {
        let machine = boards::machine(version, &limits);
        if version == Version::One {
            if args.performance {
                break;
            }
            config.model = Model::from_urdf(&machine.urdf(&limits)).map_err(|e| e.to_string())?;
        }
        agree(&config.model, &machine).map_err(|e| format!("{system}: {e}"))?;
        // Without a database, whose entries have another weight, the planner optimises the plan in full.
        let planner =
            Planner::with_entries(config.clone(), 0, String::new(), Vec::new()).map_err(|e| e.to_string())?;
        let benchmark = Benchmark { config: &config, version, limits, seed: args.seed };
        let pilot = Pilot::new(&planner)?;
        if version == Version::Two {
            let path = args.csv.as_deref().map(|folder| folder.join(format!("{system}.csv")));
            performance(&benchmark, &pilot, &machine, path.as_deref())?;
        }
        if !args.performance {
            robustness(&benchmark, &pilot);
        }
    }
    Ok(())
}

/// Raises the trip levels that protect a machine, which the benchmark does not have, out of reach.
fn never_trip(config: &mut Config) {
    let never = Level { warn: f64::INFINITY, trip: f64::INFINITY };
    let limits = &mut config.daemon.limits;
    for level in [
        &mut limits.encoder_jump,
        &mut limits.position_margin,
        &mut limits.velocity_fraction,
        &mut limits.torque_rate,
        &mut limits.collision_torque,
        &mut limits.tracking_error,
        &mut limits.balance_error,
        &mut limits.balance_distance,
        &mut limits.balance_speed,
    ] {
        *level = never;
    }
}

fn performance(
    benchmark: &Benchmark<'_>,
    pilot: &Pilot<'_>,
    machine: &Parameters,
    csv: Option<&Path>,
) -> Result<(), String> {
    let motion = benchmark.fly(pilot, benchmark.nominal(), 0);
    let figures = scores::Performance::of(&motion, machine);
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
    let Some(path) = csv else { return Ok(()) };
    std::fs::write(path, scores::csv(&motion))
        .map_err(|e| format!("{}: {e}; choose another --csv", path.display()))
}

fn robustness(benchmark: &Benchmark<'_>, pilot: &Pilot<'_>) {
    println!("  robustness, version {}", if benchmark.version == Version::One { 1 } else { 2 });
    let categories = benchmark.robustness(pilot, |name, each| {
        let marks: String = each.iter().map(|success| if *success { '+' } else { '.' }).collect();
        println!("    {name:<26} {marks}");
    });
    for (name, share) in &categories {
        println!("    {name:<26} {:>8.1} %", 100.0 * share);
    }
    let score = categories.iter().map(|(_, share)| share).sum::<f64>() / categories.len() as f64;
    println!("    {:<26} {score:>8.3}", "score");
}

/// Checks that the model of planner and daemon is the machine of the benchmark.
fn agree(model: &Model, machine: &Parameters) -> Result<(), String> {
    let (order, mut work) = (model.order(), Workspace::default());
    for n in 0..100 {
        let number = |k: i32| ((f64::from(n) * 7.0 + f64::from(k)) * 1.7).sin();
        let x = [4.0 * number(1), 4.0 * number(2), 15.0 * number(3), 15.0 * number(4)];
        let mut tau = [0.0; 2];
        tau[order.joint(0)] = 6.0 * number(5);
        let sorted = |chain: &[f64]| order.sorted(chain).unwrap_or_else(|| panic!("a chain of two joints"));
        let ours = model.forward_dynamics(&sorted(&x[..2]), &sorted(&x[2..]), &sorted(&tau), &mut work);
        let theirs = sorted(&machine.acceleration(&x, &tau));
        let difference = ours.map_or(f64::INFINITY, |ours: JointVector| (ours - theirs).amax());
        // Rounding errors.
        if !(difference <= 1e-9 * theirs.amax()) {
            return Err(format!(
                "expected the machine of the benchmark, got one whose accelerations differ by {difference:.1e} rad/s^2 \
                 at {x:.2?}; choose another --system"
            ));
        }
    }
    Ok(())
}
