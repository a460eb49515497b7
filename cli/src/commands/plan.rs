//! `upswing plan`: computes one replan without a running system.

use super::{CommonArgs, TrajectoryJson, print_json, print_line, writable};
use crate::parse::{Degrees, ManoeuvreArgs, StartArgs, start_state};
use serde::Serialize;
use upswing_config::Config;
use upswing_ipc::PlannerStatus;
use upswing_model::State;
use upswing_ocp::interior_point::NlpStatus;
use upswing_planner::database::certify;
use upswing_planner::offline::{optimize_entry, options, target};
use upswing_planner::replan::{Effort, Method, PlanSummary, Planner, key};
use upswing_process::Failure;
use upswing_process::number::whole;
use upswing_process::output::{Destination, Overwrite};
use upswing_trajectory::Entry;
use upswing_view::picture;

/// Plans a manoeuvre from a start at rest as the planner process does: adapts the nearest database entry, or runs the full
/// optimisation if no entry is near enough.
///
/// Prints t_F in s, distances in rad, margins as shares of half the range; --json adds the trajectory in s, rad, rad/s, rad/s^2.
///
/// Example: upswing plan --start -15,-15,0,-95,0,10,0 --iterations 1 --svg plan.svg
#[derive(Clone, Debug, clap::Args)]
pub struct PlanArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Start at rest.
    #[command(flatten)]
    pub start: StartArgs,
    /// The manoeuvre.
    #[command(flatten)]
    pub manoeuvre: ManoeuvreArgs,
    /// Largest number of QPs, each linearised around the previous result; 1 is the paper's mode [default: the setting]
    #[arg(long, value_parser = whole(1_u32, 100))]
    pub iterations: Option<u32>,
    /// Adapt the optimal trajectory from these positions of the actuated joints, deg or m, instead of a database entry
    #[arg(long, value_name = "Q1,..", allow_hyphen_values = true)]
    pub reference: Option<Degrees>,
    /// Draw the plan (solid) and its reference trajectory (dashed), scaled by the 100 % limits (SVG)
    #[arg(long, value_name = "FILE")]
    pub svg: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct PlanResult {
    #[serde(flatten)]
    trajectory: TrajectoryJson,
    status: String,
    cost: f64,
    #[serde(flatten)]
    figures: PlanSummary,
    time_nearest_s: f64,
    time_qp_s: f64,
    time_optimisation_s: f64,
    time_lqr_s: f64,
    time_s: f64,
}

/// Runs the replan.
///
/// # Errors
/// [`Failure::BadInput`] for an impossible start or database, [`Failure::Failed`] if there is no plan.
pub fn run(args: &PlanArgs) -> Result<(), Failure> {
    let svg = writable("--svg", args.svg.as_ref(), args.overwrite)?;
    let mut config = args.common.process.load()?;
    if let Some(iterations) = args.iterations {
        config.planner.replan.iterations = iterations as usize;
    }
    let (manoeuvre, given, start) = args.manoeuvre.of(&config, &args.start)?;
    let planner = match &args.reference {
        Some(reference) => {
            let x = start_state(&config, "--reference", reference, args.start.pendulum())?;
            let entry = optimal_entry(&config, (manoeuvre, &given), x)?;
            Planner::with_entries(config, manoeuvre, "--reference".into(), vec![entry])
        }
        None => Planner::new(config),
    };
    let planner = planner.map_err(Failure::bad_input)?;
    let settings = &planner.config().planner;
    let effort = Effort::iterations(settings.replan.iterations);
    // With --reference, only this trajectory is adapted: there is no full optimisation instead.
    let effort = Effort { optimise: effort.optimise && args.reference.is_none(), ..effort };
    let replan = planner
        .replan_with(&mut planner.solver(), manoeuvre, &given, &start, &effort)
        .map_err(Failure::failed)?;
    let open = replan.defect > settings.replan.defect;
    let status = if open { PlannerStatus::OpenDefect } else { PlannerStatus::Solved };
    if let Some(output) = &svg {
        let nearest = replan.entry.map(|entry| planner.entry(manoeuvre, entry.index));
        let nearest = nearest.transpose().map_err(Failure::failed)?;
        // Without a database, the plan is its own reference.
        let reference = nearest.as_ref().map_or(&replan.trajectory, |entry| &entry.trajectory);
        let config = planner.config();
        picture::plan::draw(output, &config.model, &config.robot.limits, &replan.trajectory, reference)
            .map_err(Failure::failed)?;
    }
    let result = PlanResult {
        trajectory: TrajectoryJson::new(&replan.trajectory, planner.config().model.order()),
        status: status.to_string(),
        cost: replan.trajectory.cost(settings.offline.input_weight),
        figures: PlanSummary::from(&replan),
        time_nearest_s: replan.statistics.nearest.as_secs_f64(),
        time_qp_s: replan.statistics.qp.as_secs_f64(),
        time_optimisation_s: replan.statistics.optimisation.as_secs_f64(),
        time_lqr_s: replan.statistics.lqr.as_secs_f64(),
        time_s: replan.statistics.total.as_secs_f64(),
    };
    if args.common.json {
        return print_json(&result);
    }
    let f = &result.figures;
    let way = match (replan.method, f.nearest_entry.zip(f.distance)) {
        (Method::Quadratic, Some((_, away))) if args.reference.is_some() => {
            format!("from the reference ({away:.3} rad away), {} QPs", f.iterations)
        }
        (Method::Quadratic, Some((entry, away))) => {
            format!("from entry {entry} ({away:.3} rad away), {} QPs", f.iterations)
        }
        (_, Some((entry, away))) => format!(
            "optimised in full in {} iterations (nearest entry: {entry}, {away:.3} rad away)",
            f.iterations
        ),
        (_, None) => format!("optimised in full in {} iterations (no database)", f.iterations),
    };
    print_line(&format!(
        "{}: t_F {:.4} s, cost {:.5}, {way}\n\
         defect of the real dynamics {:.1e}; smallest margin (share of half the range): {}\n\
         {:.0} ms: QPs {:.0} ms, full optimisation {:.0} ms, gains {:.0} ms",
        result.status,
        result.trajectory.t_f,
        result.cost,
        f.defect,
        f.margins,
        1e3 * result.time_s,
        1e3 * result.time_qp_s,
        1e3 * result.time_optimisation_s,
        1e3 * result.time_lqr_s
    ))
}

/// Optimises the trajectory of a manoeuvre, with its given values, from `start` as a database entry.
fn optimal_entry(
    config: &Config,
    (manoeuvre, given): (usize, &[f64]),
    start: State,
) -> Result<Entry, Failure> {
    let target = target(config, manoeuvre, given).map_err(Failure::failed)?;
    let solution = optimize_entry(config, target, start, &[], &options(config));
    if solution.status != NlpStatus::Solved {
        return Err(Failure::failed(format!("--reference: no trajectory: {}", solution.status)));
    }
    let entry = Entry::new(&solution.trajectory, |t| certify(config, t));
    Ok(Entry { key: key(entry.trajectory.start(), given), ..entry })
}
