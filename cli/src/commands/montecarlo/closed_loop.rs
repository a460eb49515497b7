//! `upswing montecarlo closed-loop`: swings up and balances from many random starts in simulation.

use super::{SamplingArgs, draw_run, list_failures, study_failure, writable, write_spreads};
use serde::Serialize;
use std::path::PathBuf;
use upswing_config::Config;
use upswing_process::number::within;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, shutdown_flag};
use upswing_rig::closed_loop::ReplanCounts;
use upswing_rig::montecarlo::closed_loop::{ConditionResult, ConditionStudy};
use upswing_rig::montecarlo::condition::PlantCondition;
use upswing_rig::montecarlo::contender::{Contender, GivenPlans, GivenPlansError};

/// Options of `montecarlo closed-loop`.
#[derive(Clone, Debug, clap::Args)]
pub struct ClosedLoopArgs {
    /// Starts and database.
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Conditions, that is differences between the plant and the controller's model, separated by commas: `nominal`;
    /// `arm-mass`, `pendulum-mass`, `pendulum-length` (scaled by 0.9 to 1.1, drawn for each start); or scenarios of the
    /// plant, by name or as .toml files
    #[arg(long, value_name = "NAME|FILE,..", value_delimiter = ',', default_value = "nominal")]
    pub condition: Vec<String>,
    /// Replan continuously while the plan is tracked, also where the settings of the planner do not say so
    #[arg(long, conflicts_with = "plans")]
    pub continuous: bool,
    /// Duration of the balance, s (2 to 600); success is judged in the last second
    #[arg(long, value_name = "S", default_value_t = 4.0, value_parser = within(2.0, 600.0))]
    pub seconds: f64,
    /// Plans in place of ours, the i-th one for start number i: JSON documents one after the other, each as `upswing plan --json` prints it, or
    /// null for none; they get our gains
    #[arg(long, value_name = "FILE")]
    pub plans: Option<PathBuf>,
    /// Draw the swing-up of --only, up to its failure (SVG)
    #[arg(long, value_name = "FILE", requires = "only")]
    pub picture: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct ClosedLoopResult {
    success: bool,
    complete: bool,
    database: String,
    /// File with the plans of --plans.
    #[serde(skip_serializing_if = "Option::is_none")]
    plans: Option<PathBuf>,
    seed: u64,
    conditions: Vec<ConditionResult>,
}

impl std::fmt::Display for ClosedLoopResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let part = if self.complete { "" } else { " (interrupted)" };
        match &self.plans {
            None => write!(f, "seed {}, {}{part}", self.seed, self.database)?,
            Some(plans) => write!(f, "seed {}, plans of {}{part}", self.seed, plans.display())?,
        }
        self.conditions.iter().try_for_each(|c| {
            writeln!(f)?;
            write_condition(f, c)
        })
    }
}

fn write_condition(f: &mut std::fmt::Formatter<'_>, c: &ConditionResult) -> std::fmt::Result {
    writeln!(f, "{}: {} of {} starts succeed", c.condition, c.succeeded, c.samples)?;
    writeln!(f, "  {}", c.purpose)?;
    let m = &c.motion;
    let rows = [
        ("tracking, actuated", m.tracking_error_arm, 1.0),
        ("tracking, unactuated", m.tracking_error_pendulum, 1.0),
        ("position, % of limit", m.peak_position, 100.0),
        ("velocity, % of limit", m.peak_velocity, 100.0),
        ("velocity, unactuated, %", m.peak_velocity_pendulum, 100.0),
        ("torque, % of limit", m.peak_torque, 100.0),
        ("cut torques, % of time", m.limited_share, 100.0),
        ("final error, deg", m.final_error_deg, 1.0),
        ("final speed, rad/s", m.final_speed, 1.0),
        ("one run, s", c.times.run, 1.0),
    ];
    write_spreads(f, &rows)?;
    write!(f, "  time {:.1} s", c.times.total)?;
    let ReplanCounts { active, failed, dropped } = c.replans;
    if active + failed + dropped > 0 {
        write!(
            f,
            "\n  continuous replanning: {active} plans active, {failed} steps without a plan, {dropped} plans dropped"
        )?;
    }
    c.failures.iter().try_for_each(|(kind, n)| write!(f, "\n  {n} times: {kind}"))?;
    let failed = c.results.iter().filter(|s| s.failure.is_some());
    list_failures(f, failed.map(|s| (s.index, &s.start[..], s.reasons.join("; "))))
}

/// Swings up from every start under every condition.
///
/// # Errors
/// [`Failure::BadInput`] for unusable options or files; [`Failure::Failed`] if not every start succeeded.
pub fn run(args: &ClosedLoopArgs) -> Result<(), Failure> {
    let picture = writable("--picture", args.picture.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;
    let continuous = |config: &mut Config| config.planner.continuous.enabled |= args.continuous;
    let planner = args.sampling.planner(continuous, &stop)?;
    let config = planner.config();
    let conditions: Vec<PlantCondition> =
        args.condition.iter().map(|name| PlantCondition::new(name, config)).collect::<Result<_, _>>()?;
    if args.picture.is_some() && conditions.len() != 1 {
        let got = conditions.len();
        return Err(Failure::BadInput(format!("--picture: expected one --condition, got {got}")));
    }
    let plans = args.plans.as_ref().map(|path| -> Result<_, GivenPlansError> {
        let plans = GivenPlans::read(path, config)?;
        let starts = args.sampling.only.map_or(args.sampling.samples, |index| index.saturating_add(1));
        plans.require(starts, path)?;
        Ok(plans)
    });
    let plans = plans.transpose().map_err(Failure::bad_input)?;
    let contender = plans.as_ref().map(|plans| plans as &dyn Contender);
    let given = plans.as_ref().map(GivenPlans::fingerprint);
    let options = (&conditions, args.seconds, given);
    let runs = args.sampling.runs("closed-loop", &planner, &options, args.overwrite)?;
    let parts = conditions.len();
    let expected = args.sampling.indices().len() * conditions.len();
    let study_of = |(part, condition): (usize, PlantCondition)| -> Result<ConditionResult, Failure> {
        args.sampling.study(&planner, runs.as_ref(), args.sampling.indices().len(), &stop, |study| {
            let seconds = args.seconds;
            let study = ConditionStudy { study, part, condition: &condition, seconds, contender };
            if let (Some(output), Some(index)) = (&picture, args.sampling.only) {
                draw_run(output, config, study.records(index))?;
            }
            study.run().map_err(study_failure)
        })
    };
    let answers: Vec<ConditionResult> =
        conditions.into_iter().enumerate().map(study_of).collect::<Result<_, _>>()?;
    let samples = answers.iter().map(|c| c.samples).sum();
    let succeeded = answers.iter().map(|c| c.succeeded).sum();
    let jobs = (0..parts).flat_map(|_| args.sampling.indices());
    if let Some(result) = args.sampling.conclude_shard(runs, jobs, samples) {
        return result;
    }
    let complete = samples == expected;
    args.sampling.common.print(&ClosedLoopResult {
        success: complete && succeeded == samples,
        complete,
        database: planner.origin(0).to_owned(),
        plans: args.plans.clone(),
        seed: args.sampling.seed,
        conditions: answers,
    })?;
    args.sampling.verdict(complete, samples, succeeded)
}
