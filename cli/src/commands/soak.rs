//! `upswing soak`: runs the whole system on this machine for a long time.

use super::{CommonArgs, own_system, session_failure, time_bar};
use crate::parse::WEEK;
use serde::Serialize;
use std::time::Instant;
use upswing_ipc::Clock;
use upswing_process::number::{whole, within};
use upswing_process::{Failure, shutdown_flag};
use upswing_rig::montecarlo::RandomStarts;
use upswing_rig::session::{Programs, Session};
use upswing_rig::soak::{Kill, ResourceGrowth, Soak, SoakError, SoakOutcome};

/// Repeats swing-up, balance, push, swing-down and hold from random starts.
///
/// Daemon, planner and plant run as three processes. In a share of the rounds one of them is killed (SIGKILL) at a random
/// moment and restarted, and the next round shows that the system has recovered. Exit code 1: a round failed without a kill.
///
/// Example: upswing soak --seconds 1800 --clock wall --json
#[derive(Clone, Debug, clap::Args)]
pub struct SoakArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Duration, s (1 to a week); the last round is completed
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = within(1.0, WEEK))]
    pub seconds: f64,
    /// Clock: `paced` (real-time pace) or `wall`
    #[arg(long, default_value = "paced", value_parser = upswing_plant::clock_parser())]
    pub clock: Clock,
    /// Share of the rounds in which a process is killed, 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.5, value_parser = within(0.0, 1.0))]
    pub kills: f64,
    /// Seed of starts, pushes and kills
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole(0, u64::MAX))]
    pub seed: u64,
}

#[derive(Serialize)]
struct SoakResult {
    success: bool,
    clock: String,
    seed: u64,
    seconds: f64,
    #[serde(flatten)]
    record: SoakOutcome,
    growth: Vec<ResourceGrowth>,
}

impl std::fmt::Display for SoakResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let SoakOutcome { rounds, completed, kills, losses, orderly_restarts, cycles, .. } = &self.record;
        writeln!(f, "Soak: {}", if self.success { "passed" } else { "FAILED" })?;
        writeln!(f, "  clock     {}, {:.0} s, seed {}", self.clock, self.seconds, self.seed)?;
        writeln!(
            f,
            "  rounds    {rounds}: {completed} completed, {} ended by a kill, {} failed",
            rounds - completed - losses.len() as u64,
            losses.len()
        )?;
        let longest = |role: &str| {
            let of_role: Vec<&Kill> = kills.iter().filter(|kill| kill.role == role).collect();
            let most = of_role.iter().map(|kill| kill.recovered_s).fold(0.0, f64::max);
            format!("{} {role} (ready after {most:.2} s at most)", of_role.len())
        };
        let each = ["daemon", "planner", "plant"].map(longest).join(", ");
        writeln!(f, "  kills     {each}; {orderly_restarts} daemons shut down normally")?;
        let (stretches, missed) = cycles.misses();
        let longest = cycles.missed.last_key_value().map_or(0, |(length, _)| *length);
        writeln!(
            f,
            "  cycles    {}; measurements missed {missed} in {stretches} stretches, {longest} in a row at most; {} cycles \
             without a new one; telemetry lost {}",
            cycles.cycles, cycles.without_measurement, cycles.telemetry_lost
        )?;
        let late: Vec<_> = cycles.late.iter().map(|(phase, n)| format!("{n} mostly in {phase}")).collect();
        write!(f, "  late      {}", if late.is_empty() { "none".into() } else { late.join(", ") })?;
        if let Some(cause) = self.record.late_causes.last() {
            write!(f, "; the last: {cause}")?;
        }
        self.growth.iter().try_for_each(|growth| write!(f, "\n  {growth}"))?;
        losses.iter().try_for_each(|l| write!(f, "\n  round {} failed in {}: {}", l.round, l.phase, l.reason))
    }
}

/// Runs rounds from random starts until the duration has passed.
///
/// # Errors
/// [`Failure::BadInput`] for invalid options, [`Failure::Failed`] if a round failed without a kill or the system did not recover.
pub fn run(args: &SoakArgs) -> Result<(), Failure> {
    if args.clock.stands_still() {
        return Err(Failure::BadInput(
            "--clock: expected paced or wall, got lockstep, which stands still between requests".into(),
        ));
    }
    let config = args.common.process.load()?;
    let starts = RandomStarts { config: &config, seed: args.seed };
    let start = Soak::first_start(&starts).map_err(Failure::bad_input)?;
    let stop = shutdown_flag()?;
    let (_clean, options) = own_system(&args.common, "soak", args.clock, start, None)?;
    let begin = Instant::now();
    let soak = || -> Result<SoakOutcome, SoakError> {
        let session = Session::start(Programs::own()?, &options, None)?;
        let mut soak = Soak::new(session, starts, args.clock, args.kills);
        let bar = time_bar(args.seconds, "soak");
        let ran = soak.run(args.seconds, &stop, &|passed| bar.set_position((passed * 1e3) as u64));
        bar.finish_and_clear();
        ran?;
        soak.session.end()?;
        Ok(soak.record)
    };
    let record = soak().map_err(|e| match e {
        SoakError::NoStart(e) => Failure::bad_input(e),
        SoakError::Session(e) => session_failure(&e, &options.logs),
    })?;
    // The logs are kept only if the soak fails.
    let success = record.losses.is_empty() && record.completed > 0;
    if success {
        let _ = std::fs::remove_dir_all(&options.logs);
    }
    let lost = record.losses.len();
    let growth = ResourceGrowth::of(&record.samples);
    let seconds = begin.elapsed().as_secs_f64();
    let clock = args.clock.to_string();
    args.common.print(&SoakResult { success, clock, seed: args.seed, seconds, record, growth })?;
    match (success, lost) {
        (true, _) => Ok(()),
        (false, 0) => Err(Failure::failed("no round was completed: allow more time")),
        (false, n) => Err(Failure::failed(format!("{n} rounds failed; logs in {}", options.logs.display()))),
    }
}
