//! `upswing model`: the dynamics on the command line.

use super::{CommonArgs, print_json, print_line};
use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};
use std::io::BufRead;
use upswing_config::process::Failure;
use upswing_model::{ActuatedVector, JointVector, Model, NQ, NU, Workspace, state};

/// Evaluates or prints the robot model.
#[derive(Clone, Debug, clap::Args)]
pub struct ModelArgs {
    /// What to do.
    #[command(subcommand)]
    pub command: ModelCommand,
}

/// What to do with the model.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ModelCommand {
    /// Evaluate the dynamics for each JSON line on stdin; prints one JSON line each
    #[command(after_help = "Input: {\"q\":[9],\"qd\":[9],\"u\":[7]} in rad, rad/s, rad/s^2.\n\
        Output: M, nle (C qd + g), g, f, A, B, tau, tau_without_coriolis; rows first, SI units.\n\n\
        Example: echo '{\"q\":[0,0,0,-1.57,0,0,0,0,0],\"qd\":[0,0,0,0,0,0,0,0,0],\
        \"u\":[0,0,0,0,0,0,0]}' | upswing model eval")]
    Eval(CommonArgs),
    /// Print the robot description (URDF)
    Urdf(CommonArgs),
}

#[derive(Serialize)]
struct UrdfJson {
    urdf: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Query {
    q: Vec<f64>,
    qd: Vec<f64>,
    u: Vec<f64>,
}

#[derive(Serialize)]
#[allow(non_snake_case)]
struct Evaluation {
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
/// [`Failure::BadInput`] that names the line and what is wrong with it.
pub fn run(args: &ModelArgs) -> Result<(), Failure> {
    match &args.command {
        ModelCommand::Urdf(common) => {
            let urdf = common.process.load()?.urdf;
            if common.json { print_json(&UrdfJson { urdf }) } else { print_line(&urdf.trim_end()) }
        }
        ModelCommand::Eval(common) => {
            let config = common.process.load()?;
            let mut work = Workspace::default();
            for (number, line) in std::io::stdin().lock().lines().enumerate() {
                let at = |reason: String| Failure::BadInput(format!("line {}: {reason}", number + 1));
                let line = line.map_err(|e| at(e.to_string()))?;
                if line.trim().is_empty() {
                    continue;
                }
                let query: Query = serde_json::from_str(&line).map_err(|e| at(e.to_string()))?;
                print_json(&evaluate(&config.model, &query, &mut work).map_err(at)?)?;
            }
            Ok(())
        }
    }
}

fn evaluate(model: &Model, query: &Query, work: &mut Workspace) -> Result<Evaluation, String> {
    for (name, values, expected) in [("q", &query.q, NQ), ("qd", &query.qd, NQ), ("u", &query.u, NU)] {
        if values.len() != expected {
            return Err(format!("`{name}`: expected {expected} numbers, got {}", values.len()));
        }
    }
    let q = JointVector::from_column_slice(&query.q);
    let qd = JointVector::from_column_slice(&query.qd);
    let (x, u) = (state(&q, &qd), ActuatedVector::from_column_slice(&query.u));
    let d = model.derivatives(&x, &u, work);
    Ok(Evaluation {
        A: rows(&d.a()),
        B: rows(&d.b()),
        f: vector(&d.f(&x, &u)),
        tau: vector(&d.value.tau),
        M: rows(&model.mass_matrix(&q, work)),
        nle: vector(&model.nonlinear_effects(&q, &qd, work)),
        g: vector(&model.gravity_torque(&q, work)),
        tau_without_coriolis: vector(&model.torque_without_coriolis(&x, &u, work)),
    })
}

fn rows<const R: usize, const C: usize>(m: &SMatrix<f64, R, C>) -> Vec<Vec<f64>> {
    m.row_iter().map(|r| r.iter().copied().collect()).collect()
}

fn vector<const R: usize>(v: &SMatrix<f64, R, 1>) -> Vec<f64> {
    v.iter().copied().collect()
}
