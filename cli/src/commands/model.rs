//! `upswing model`: evaluates or prints the robot model.

use super::json::in_chain;
use super::{CommonArgs, print_json, print_line, progress_bar};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::io::BufRead;
use std::time::Instant;
use upswing_model::coriolis::bound;
use upswing_model::{ActuatedVector, JointVector, Limits, Linearization, Model, Order, State, Workspace};
use upswing_process::number::whole;
use upswing_process::{Failure, shutdown_flag};

/// Evaluates or prints the robot model.
///
/// Example: upswing model bound --samples 1000000
#[derive(Clone, Debug, clap::Args)]
pub struct ModelArgs {
    /// The action.
    #[command(subcommand)]
    pub command: ModelCommand,
}

/// Actions on the model.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ModelCommand {
    /// Evaluate the dynamics for each JSON line on stdin; prints one JSON line for each
    #[command(after_help = "Input: {\"q\":[9],\"qd\":[9],\"u\":[7]} in rad, rad/s, rad/s^2.\n\
        Output: one JSON line each, with or without --json: M, nle (C qd + g), g, f, A, B, tau, tau_without_coriolis; rows first, SI units.\n\n\
        Example: echo '{\"q\":[0,0,0,-1.57,0,0,0,0,0],\"qd\":[0,0,0,0,0,0,0,0,0],\
        \"u\":[0,0,0,0,0,0,0]}' | upswing model eval")]
    Eval(CommonArgs),
    /// Print the robot description (URDF)
    ///
    /// Example: upswing model urdf > robot.urdf
    Urdf(CommonArgs),
    /// Sample the Coriolis torques over random admissible states: the bound c of (11), Section III-A
    ///
    /// Uniform in the position limits of all joints and in the velocities that a plan may use. The same seed gives the
    /// same numbers on any number of cores.
    ///
    /// Example: upswing model bound --samples 1000000
    Bound(BoundArgs),
}

/// Most states: two weeks on one core; the extremes converge long before.
const MOST: u64 = 1_000_000_000_000;

/// Options of the sampling.
#[derive(Clone, Debug, clap::Args)]
pub struct BoundArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Number of states [the paper: 100000000, half a minute on two cores]
    #[arg(long, value_name = "N", default_value_t = 100_000_000, value_parser = whole(1, MOST))]
    pub samples: u64,
    /// Seed of the random states
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole(0, u64::MAX))]
    pub seed: u64,
}

#[derive(Serialize)]
struct ModelUrdfResult {
    urdf: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EvalInput {
    q: Vec<f64>,
    qd: Vec<f64>,
    u: Vec<f64>,
}

#[derive(Serialize)]
#[allow(non_snake_case)]
struct ModelEvalResult {
    M: Vec<Vec<f64>>,
    nle: Vec<f64>,
    g: Vec<f64>,
    f: Vec<f64>,
    A: Vec<Vec<f64>>,
    B: Vec<Vec<f64>>,
    tau: Vec<f64>,
    tau_without_coriolis: Vec<f64>,
}

/// Evaluates or prints the model.
///
/// # Errors
/// [`Failure::BadInput`] with the line or option and the reason; [`Failure::Failed`] if the sampling
/// was interrupted.
pub fn run(args: &ModelArgs) -> Result<(), Failure> {
    match &args.command {
        ModelCommand::Urdf(common) => {
            let urdf = common.process.load()?.urdf;
            if common.json { print_json(&ModelUrdfResult { urdf }) } else { print_line(&urdf.trim_end()) }
        }
        ModelCommand::Bound(args) => sample_bound(args),
        ModelCommand::Eval(common) => {
            let config = common.process.load()?;
            let mut work = Workspace::default();
            for (number, line) in std::io::stdin().lock().lines().enumerate() {
                let at = |e: &dyn std::fmt::Display| Failure::BadInput(format!("line {}: {e}", number + 1));
                let line = line.map_err(|e| at(&e))?;
                if line.trim().is_empty() {
                    continue;
                }
                let query: EvalInput = serde_json::from_str(&line).map_err(|e| at(&e))?;
                print_json(&evaluate(&config.model, &query, &mut work).map_err(|e| at(&e))?)?;
            }
            Ok(())
        }
    }
}

/// Range of the Coriolis torques, N m, one number per motor.
#[derive(Serialize)]
struct ModelBoundResult {
    samples: u64,
    complete: bool,
    seed: u64,
    /// Names of the actuated joints, in the order of the other lists.
    joints: Vec<String>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// Bounds of the settings; absent if they have none.
    paper_lower: Option<Vec<f64>>,
    paper_upper: Option<Vec<f64>>,
    time_s: f64,
}

impl std::fmt::Display for ModelBoundResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        writeln!(
            f,
            "Coriolis torques of {} random states{part}, seed {}, {:.1} s, N m",
            self.samples, self.seed, self.time_s
        )?;
        write!(f, "  {:<16} lower     upper   lower, (11)   upper, (11)", "joint")?;
        for (i, joint) in self.joints.iter().enumerate() {
            write!(f, "\n  {joint:<12} {:>9.4} {:>9.4}", self.lower[i], self.upper[i])?;
            if let (Some(lower), Some(upper)) = (&self.paper_lower, &self.paper_upper) {
                write!(f, " {:>13} {:>13}", lower[i], upper[i])?;
            }
        }
        Ok(())
    }
}

fn sample_bound(args: &BoundArgs) -> Result<(), Failure> {
    let samples = args.samples;
    let config = args.common.process.load()?;
    let stop = shutdown_flag()?;
    let robot = &config.robot;
    // Positions of Table II: the planning margins of the pendulum are not part of the paper's range.
    let limits = Limits { qd_max: robot.planning.qd_max, ..robot.limits };
    let bar = progress_bar(samples, "states");
    let begin = Instant::now();
    let range = bound(&config.model, &limits, samples, args.seed, &stop, |n| bar.inc(n));
    bar.finish_and_clear();
    let complete = range.samples == samples;
    if range.samples > 0 {
        args.common.print(&ModelBoundResult {
            samples: range.samples,
            complete,
            seed: args.seed,
            joints: config
                .model
                .joint_names()
                .enumerate()
                .filter(|(i, _)| config.model.order().is_actuated(*i))
                .map(|(_, name)| name.to_owned())
                .collect(),
            lower: range.lower.to_vec(),
            upper: range.upper.to_vec(),
            paper_lower: robot.coriolis_bound.map(|bound| bound.lower.to_vec()),
            paper_upper: robot.coriolis_bound.map(|bound| bound.upper.to_vec()),
            time_s: begin.elapsed().as_secs_f64(),
        })?;
    }
    if complete {
        Ok(())
    } else {
        Err(Failure::failed(format!("interrupted after {} of {samples} states", range.samples)))
    }
}

/// Error of a vector of the input that has not one number per joint.
#[derive(Debug, thiserror::Error)]
#[error("`{name}`: expected {expected} numbers, got {got}")]
struct VectorLengthError {
    name: &'static str,
    expected: usize,
    got: usize,
}

fn evaluate(
    model: &Model,
    query: &EvalInput,
    work: &mut Workspace,
) -> Result<ModelEvalResult, VectorLengthError> {
    let (sizes, order) = (model.sizes(), model.order());
    let n = sizes.joints();
    let joints = |name, values: &[f64]| {
        order.sorted(values).ok_or(VectorLengthError { name, expected: n, got: values.len() })
    };
    let (q, qd) = (joints("q", &query.q)?, joints("qd", &query.qd)?);
    let u = ActuatedVector::from_slice(sizes, &query.u);
    let (expected, got) = (sizes.actuated(), query.u.len());
    let u = u.ok_or(VectorLengthError { name: "u", expected, got })?;
    let x = State::new(&q, &qd);
    let mut d = Linearization::new(sizes);
    model.linearize(&x, &u, work, &mut d);
    let mass = model.mass_matrix(&q, work);
    let in_order = |v: JointVector| order.in_chain(&v)[..n].to_vec();
    Ok(ModelEvalResult {
        A: rows(&d.a(), order, true),
        B: rows(&d.b(), order, false),
        f: in_chain(order, &d.f(&x, &u)),
        tau: d.value().tau.to_vec(),
        M: (0..n)
            .map(|i| (0..n).map(|j| mass[(order.coordinate(i), order.coordinate(j))]).collect())
            .collect(),
        nle: in_order(model.nonlinear_effects(&q, &qd, work)),
        g: in_order(model.gravity_torque(&q, work)),
        tau_without_coriolis: model.torque_without_coriolis(&x, &u, work).to_vec(),
    })
}

/// Rows of a matrix over the state, in the chain's order; `square`: so are its columns.
fn rows(m: &DMatrix<f64>, order: &Order, square: bool) -> Vec<Vec<f64>> {
    let n = order.sizes().joints();
    let place = |i: usize| if i < n { order.coordinate(i) } else { n + order.coordinate(i - n) };
    let column = |j: usize| if square { place(j) } else { j };
    (0..m.nrows()).map(|i| (0..m.ncols()).map(|j| m[(place(i), column(j))]).collect()).collect()
}
