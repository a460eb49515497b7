//! `upswing optimize`: runs one offline optimisation.

use super::{CommonArgs, TrajectoryJson, print_json, print_line, spinner};
use crate::parse::{ManoeuvreArgs, StartArgs, WEEK};
use serde::Serialize;
use std::sync::atomic::Ordering;
use std::time::Instant;
use upswing_ocp::interior_point::{NlpOptions, NlpStatus};
use upswing_ocp::multistart::Search;
use upswing_planner::database::solutions_near;
use upswing_planner::offline::{optimize, options, problem, target};
use upswing_planner::replan::MarginShares;
use upswing_process::number::within;
use upswing_process::{Failure, shutdown_flag};
use upswing_trajectory::Margins;

/// Optimises a manoeuvre (6), (8) from a start at rest; Ctrl-C prints the result so far.
///
/// Example: upswing optimize --start 0,0,0,-90,0,0,0 --json > trajectory.json
#[derive(Clone, Debug, clap::Args)]
pub struct OptimizeArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Start at rest.
    #[command(flatten)]
    pub start: StartArgs,
    /// The manoeuvre.
    #[command(flatten)]
    pub manoeuvre: ManoeuvreArgs,
    /// Search for the best of several local optima, also from the nearest entries of the database
    #[arg(long)]
    pub best: bool,
    /// Longest time for each attempt, s
    #[arg(long, value_name = "S", value_parser = within(0.0, WEEK))]
    pub budget: Option<f64>,
}

#[derive(Serialize)]
struct OptimizeResult {
    #[serde(flatten)]
    trajectory: TrajectoryJson,
    status: String,
    cost: f64,
    iterations: usize,
    violation: f64,
    stationarity: f64,
    #[serde(flatten)]
    margins: MarginShares,
    time_s: f64,
}

/// Runs the optimisation.
///
/// # Errors
/// [`Failure::BadInput`] for an impossible start, [`Failure::Failed`] if no solution is found.
pub fn run(args: &OptimizeArgs) -> Result<(), Failure> {
    let config = args.common.process.load()?;
    let (manoeuvre, given, start) = args.manoeuvre.of(&config, &args.start)?;
    if config.manoeuvres[manoeuvre].reverses.is_some() {
        let name = &config.manoeuvres[manoeuvre].name;
        return Err(Failure::BadInput(format!(
            "--manoeuvre: `{name}` runs another one backwards: optimise that one"
        )));
    }
    let target = target(&config, manoeuvre, &given).map_err(Failure::bad_input)?;
    let begin = Instant::now();
    let time_budget = args.budget.map(std::time::Duration::from_secs_f64);
    // Ctrl-C ends the optimisation, and the result so far is printed.
    let stop = shutdown_flag()?;
    let search = if args.best { Search::Best } else { Search::First };
    let stopped = || stop.load(Ordering::Acquire);
    let options = NlpOptions { time_budget, cancelled: Some(&stopped), ..options(&config) };
    let waiting = spinner("optimising; Ctrl-C prints what there is");
    let neighbours = match search {
        Search::Best => solutions_near(&config, manoeuvre, &given, &start)?,
        _ => Vec::new(),
    };
    let solution = optimize(&problem(&config, target, start), search, &neighbours, &options);
    waiting.finish_and_clear();
    let time_s = begin.elapsed().as_secs_f64();
    let status = solution.status.to_string();
    let margins = Margins::of(&solution.trajectory, &config.model, &config.robot.planning, 0);
    let result = OptimizeResult {
        trajectory: TrajectoryJson::new(&solution.trajectory, config.model.order()),
        status: status.clone(),
        cost: solution.cost,
        iterations: solution.iterations,
        violation: solution.violation,
        stationarity: solution.stationarity,
        margins: (&margins).into(),
        time_s,
    };
    if args.common.json {
        print_json(&result)?;
    } else {
        print_line(&format!(
            "{status}: t_F {:.4} s, cost {:.5}, {} iterations in {:.2} s\n\
             largest violation {:.1e}, stationarity {:.1e}\n\
             smallest margin at the knots (share of half the range): {}",
            result.trajectory.t_f,
            result.cost,
            result.iterations,
            time_s,
            result.violation,
            result.stationarity,
            result.margins
        ))?;
    }
    if solution.status == NlpStatus::Solved {
        Ok(())
    } else {
        Err(Failure::failed(format!("no solution: {status}")))
    }
}
