//! `upswing montecarlo replan`: plans from many random starts.

use super::{SamplingArgs, list_failures, study_failure, writable, write_spreads};
use serde::Serialize;
use upswing_config::Config;
use upswing_process::number::whole;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_rig::montecarlo::replan::{self, CLOSED_DEFECT, PlanFigures, PlanStudyResult};
use upswing_view::picture::map;

/// Options of `montecarlo replan`.
#[derive(Clone, Debug, clap::Args)]
pub struct ReplanArgs {
    /// Starts and database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Largest number of linearisations per entry; 1 is the paper's mode [default: the setting]
    #[arg(long, value_parser = whole(1_u32, 100))]
    pub iterations: Option<u32>,
    /// Draw the smallest margins over the ranges of the starts (SVG)
    #[arg(long, value_name = "FILE", conflicts_with = "output")]
    pub svg: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct ReplanResult {
    success: bool,
    complete: bool,
    database: String,
    entries: usize,
    seed: u64,
    #[serde(flatten)]
    statistics: PlanStudyResult,
    #[serde(skip)]
    threads: usize,
}

impl std::fmt::Display for ReplanResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let s = &self.statistics;
        let part = if self.complete { "" } else { " (interrupted)" };
        let (n, seed) = (s.samples, self.seed);
        writeln!(f, "{} of {n} starts planned within all limits{part}, seed {seed}", s.succeeded)?;
        writeln!(f, "  database  {}, {} entries", self.database, self.entries)?;
        let attempts: Vec<_> = s.attempts.iter().map(usize::to_string).collect();
        writeln!(
            f,
            "  feasible  {} (from the nearest entry, the next, ...: {})",
            s.feasible,
            attempts.join(", ")
        )?;
        writeln!(f, "  defect    at most {CLOSED_DEFECT:.0e} in {} plans", s.defect_closed)?;
        let rows = [
            ("linearisations", s.iterations, 1.0),
            ("defect, rad or rad/s", s.defect, 1.0),
            ("margin of position", s.margin_q, 1.0),
            ("margin of velocity", s.margin_qd, 1.0),
            ("margin of torque", s.margin_tau, 1.0),
            ("t_F, s", s.t_f, 1.0),
            ("distance, rad", s.distance, 1.0),
            ("replan, ms", s.times.replan, 1e3),
            ("  its QPs, ms", s.times.qp, 1e3),
            ("  its gains, ms", s.times.lqr, 1e3),
        ];
        write_spreads(f, &rows)?;
        write!(f, "  time      {:.1} s on {} threads", s.times.total, self.threads)?;
        let failures = s.results.iter().filter_map(|r| Some((r.index, &r.start[..], r.failure.clone()?)));
        list_failures(f, failures)
    }
}

/// Plans from every start.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if not every start succeeded.
pub fn run(args: &ReplanArgs) -> Result<(), Failure> {
    let svg = writable("--svg", args.svg.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;
    let iterations = |config: &mut Config| {
        if let Some(iterations) = args.iterations {
            config.planner.replan.iterations = iterations as usize;
        }
    };
    let planner = args.sampling.planner(iterations, &stop)?;
    let starts = args.sampling.indices().len();
    let runs = args.sampling.runs("replan", &planner, &(), args.overwrite)?;
    let statistics = args
        .sampling
        .study(&planner, runs.as_ref(), starts, &stop, |study| replan::run(study).map_err(study_failure))?;
    let (samples, succeeded) = (statistics.samples, statistics.succeeded);
    if let Some(result) = args.sampling.conclude_shard(runs, args.sampling.indices().into_iter(), samples) {
        return result;
    }
    let complete = samples == starts;
    if let Some(output) = &svg {
        let margins =
            |p: &PlanFigures| [p.plan.margins.margin_q, p.plan.margins.margin_qd, p.plan.margins.margin_tau];
        let points: Vec<_> = statistics
            .results
            .iter()
            .map(|s| map::MapPoint { q: s.start.clone(), margins: s.plan.as_ref().map(margins) })
            .collect();
        let config = planner.config();
        map::draw(output, &config.model, &config.manoeuvres[0].grid.axes, &points)
            .map_err(Failure::failed)?;
    }
    args.sampling.common.print(&ReplanResult {
        success: complete && succeeded == samples,
        complete,
        database: planner.origin(0).to_owned(),
        entries: planner.entries(0),
        seed: args.sampling.seed,
        statistics,
        threads: args.sampling.threads(),
    })?;
    args.sampling.verdict(complete, samples, succeeded)
}
