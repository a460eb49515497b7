//! `upswing demo`: runs the whole system on this machine for its first manoeuvre, such as a swing-up.

use super::system_list::SystemList;
use super::{CommonArgs, own_system, session_failure, time_bar, writable};
use crate::parse::{Degrees, start_state};
use serde::Serialize;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use upswing_config::PendulumStart;
use upswing_ipc::Clock;
use upswing_planner::database::DatabaseFile;
use upswing_planner::replan::Planner;
use upswing_process::number::within;
use upswing_process::output::{Destination, Overwrite};
use upswing_process::{Failure, note, shutdown_flag};
use upswing_record::Recorder;
use upswing_record::evaluation::SwingUpEvaluation;
use upswing_rig::course::{SessionCourse, execute_from_idle, first_manoeuvre};
use upswing_rig::session::{Programs, Session, SessionError};
use upswing_view::picture;

/// Starts daemon, planner and plant as three processes, and executes the first manoeuvre of the settings: swings the pendulum up and
/// balances it.
///
/// Example: upswing demo --start 10,10,0,-100,0,-20,0 --clock lockstep --seconds 3
#[derive(Clone, Debug, clap::Args)]
pub struct DemoArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
    /// Print the shipped systems with their joints and manoeuvres instead
    #[arg(long)]
    pub list: bool,
    /// Start positions of the actuated joints, deg or m; the others hang at rest [default: start.q_deg and start.q_m of plant.toml]
    #[arg(long, value_name = "Q1,..", allow_hyphen_values = true)]
    pub start: Option<Degrees>,
    /// Clock: `paced` (real-time pace), `lockstep` (as fast as possible, deterministic) or `wall`
    #[arg(long, default_value = "paced", value_parser = upswing_plant::clock_parser())]
    pub clock: Clock,
    /// Scenario of the plant: a name, or the path of a .toml file
    #[arg(long, value_name = "NAME|FILE")]
    pub scenario: Option<String>,
    /// Duration of the balance, s (2 to 600); success is judged in the last second, after the transient
    #[arg(long, value_name = "S", default_value_t = 5.0, value_parser = within(2.0, 600.0))]
    pub seconds: f64,
    /// Record every cycle in this file (MCAP), for `upswing report`, Foxglove or PlotJuggler
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<Destination>,
    /// Picture to write (SVG) [default: upswing-demo.svg, or upswing-demo-2.svg, ... if it exists]
    #[arg(long, value_name = "FILE")]
    pub picture: Option<Destination>,
    /// Overwriting of existing files.
    #[command(flatten)]
    pub overwrite: Overwrite,
}

#[derive(Serialize)]
struct DemoResult {
    #[serde(flatten)]
    evaluation: SwingUpEvaluation,
    clock: String,
    start: Vec<f64>,
    scenario: Option<String>,
    picture: PathBuf,
    recording: Option<PathBuf>,
}

impl std::fmt::Display for DemoResult {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.evaluation)?;
        write!(f, "  picture   {}", self.picture.display())?;
        match &self.recording {
            Some(file) => write!(f, "\n  recording {}", file.display()),
            None => Ok(()),
        }
    }
}

/// Returns the default path of the picture: the first unused name.
fn default_picture(overwrite: Overwrite) -> Destination {
    let name = |n: u32| match n {
        1 => "upswing-demo.svg".to_owned(),
        n => format!("upswing-demo-{n}.svg"),
    };
    let free = |name: &String| overwrite.force || !Path::new(name).exists();
    let free = (1..=u32::MAX).map(name).find(free);
    OsString::from(free.unwrap_or_else(|| name(1))).into()
}

/// Runs the demo.
///
/// # Errors
/// [`Failure::BadInput`] for an impossible start or duration, [`Failure::Failed`] if the pendulum does not end
/// balanced.
pub fn run(args: &DemoArgs) -> Result<(), Failure> {
    if args.list {
        return args.common.print(&SystemList::shipped()?);
    }
    let mut config = args.common.process.load()?;
    if let Some(scenario) = &args.scenario {
        let purpose = config.use_scenario(scenario)?;
        if !args.common.json {
            note(&format!("scenario {scenario}: {purpose}"));
        }
    }
    let start = match &args.start {
        Some(start) => start.clone(),
        None => {
            let shown = |(i, q): (usize, &f64)| config.model.joint_kind(i).shown(*q).0;
            let q = config.plant.start.q.iter().enumerate().map(shown);
            Degrees(q.map(|q| (q * 1e9).round() / 1e9).collect())
        }
    };
    start_state(&config, "--start", &start, PendulumStart::Rest)?;
    Planner::check_databases(&config).map_err(Failure::bad_input)?;
    let named = args.picture.clone().unwrap_or_else(|| default_picture(args.overwrite));
    let picture = writable("--picture", Some(&named), args.overwrite)?;
    let recording = writable("--record", args.record.as_ref(), args.overwrite)?;
    let stop = shutdown_flag()?;

    let (_clean, options) =
        own_system(&args.common, "demo", args.clock, start.to_string(), args.scenario.clone())?;
    let period = config.daemon.cycle.period.seconds();
    let recorder = recording.map(|file| {
        file.clear().map_err(|e| Failure::BadInput(format!("--record: {e}")))?;
        let mut details = vec![("clock", args.clock.to_string()), ("start", start.to_string())];
        if let Some(database) = DatabaseFile::of(&config, 0)? {
            details.push(("database_fingerprint", database.fingerprint().map_err(Failure::bad_input)?));
        }
        details.extend(args.scenario.clone().map(|scenario| ("scenario", scenario)));
        Recorder::create(file.path(), &config, details).map_err(Failure::from)
    });
    let recorder = recorder.transpose()?;
    if !args.common.json {
        note(&format!("starting daemon, planner and plant ({} clock) ...", args.clock));
    }
    let swing = || -> Result<_, SessionError> {
        let mut session = Session::start(Programs::own()?, &options, recorder)?;
        let bar = time_bar(args.seconds, "executing the manoeuvre");
        let progress = |passed: f64, total: f64| {
            bar.set_length((total * 1e3) as u64);
            bar.set_position((passed * 1e3) as u64);
        };
        let mut course =
            SessionCourse { session: &mut session, period, interrupted: &stop, progress: &progress };
        let plan = execute_from_idle(&mut course, &first_manoeuvre(&config), period, args.seconds);
        bar.finish_and_clear();
        let plan = plan?;
        let dropped = session.dropped();
        let records = std::mem::take(&mut session.records);
        session.end()?;
        Ok((plan, records, dropped))
    };
    let (plan, records, dropped) = swing().map_err(|e| session_failure(&e, &options.logs))?;
    let evaluation = SwingUpEvaluation::new(&config, &plan, &records, dropped, args.seconds, None);
    let success = evaluation.success;
    let result = DemoResult {
        evaluation,
        clock: args.clock.to_string(),
        start: start.0,
        scenario: args.scenario.clone(),
        picture: named.to_path_buf(),
        recording: args.record.as_deref().map(Path::to_path_buf),
    };
    let draw = |output| picture::draw(&output, &records, &config.model, &config.robot.limits, period);
    let drawn = picture.map_or(Ok(()), draw);
    args.common.print(&result)?;
    if !success {
        let logs = options.logs.display();
        return Err(Failure::failed(format!("the manoeuvre did not end as planned; logs in {logs}")));
    }
    // The logs are kept only if the demo fails.
    let _ = std::fs::remove_dir_all(&options.logs);
    drawn.map_err(Failure::failed)
}
