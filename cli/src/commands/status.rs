//! `upswing status`: how the system is.

use super::CommonArgs;
use super::request::{control, mode, reason};
use serde::Serialize;
use upswing_config::process::Failure;
use upswing_ipc::{ControlCommand, Degradation, Percentiles};

/// Shows the mode of the running daemon, its plan, faults and overruns.
///
/// Example: upswing status --json
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Options of every command.
    #[command(flatten)]
    pub common: CommonArgs,
}

#[derive(Serialize)]
struct Status {
    mode: String,
    fault: Option<String>,
    loaded_plan: Option<String>,
    running_plan: Option<String>,
    cycles: u64,
    overruns: u64,
    last_overrun: Option<String>,
    warnings: Vec<&'static str>,
    degraded: Vec<String>,
    wake_us: Times,
    compute_us: Times,
    remark: String,
}

/// Percentiles, us.
#[derive(Serialize)]
pub(super) struct Times {
    pub(super) count: u64,
    p50: f64,
    p99: f64,
    p99_9: f64,
    p99_99: f64,
    max: f64,
}

impl Times {
    pub(super) fn new(p: &Percentiles) -> Self {
        let [p50, p99, p99_9, p99_99, max] =
            [p.p50, p.p99, p.p99_9, p.p99_99, p.max].map(|ns| ns as f64 * 1e-3);
        Self { count: p.count, p50, p99, p99_9, p99_99, max }
    }

    /// One line without its end.
    pub(super) fn line(&self, f: &mut std::fmt::Formatter<'_>, name: &str) -> std::fmt::Result {
        let Self { p50, p99, p99_9, p99_99, max, .. } = self;
        write!(
            f,
            "{name:<10} p50 {p50:.1}, p99 {p99:.1}, p99.9 {p99_9:.1}, p99.99 {p99_99:.1}, max {max:.1} us"
        )
    }
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let or_none = |v: &Option<String>| v.clone().unwrap_or_else(|| "none".into());
        writeln!(f, "mode       {}", self.mode)?;
        writeln!(f, "fault      {}", or_none(&self.fault))?;
        writeln!(
            f,
            "plan       loaded {}, running {}",
            or_none(&self.loaded_plan),
            or_none(&self.running_plan)
        )?;
        write!(f, "cycles     {} ({} late)", self.cycles, self.overruns)?;
        for (times, name) in [(&self.wake_us, "wake-up"), (&self.compute_us, "compute")] {
            if times.count > 0 {
                writeln!(f)?;
                times.line(f, name)?;
            }
        }
        if let Some(overrun) = &self.last_overrun {
            write!(f, "\nlast late  {overrun}")?;
        }
        if !self.degraded.is_empty() {
            write!(f, "\nreal time  degraded: {}", self.degraded.join(", "))?;
        }
        if !self.warnings.is_empty() {
            write!(f, "\nwarnings   {}", self.warnings.join(", "))?;
        }
        if !self.remark.is_empty() {
            write!(f, "\nremark     {}", self.remark)?;
        }
        Ok(())
    }
}

/// Asks the daemon.
///
/// # Errors
/// [`Failure::Failed`] if no daemon answers.
pub fn run(args: &StatusArgs) -> Result<(), Failure> {
    let node = args.common.connect()?;
    let s = control(&node, ControlCommand::Status)?;
    let id = |id: u64| (id != 0).then(|| format!("{id:016x}"));
    args.common.print(&Status {
        mode: mode(&s),
        fault: upswingd::fault_text(s.fault).map(Into::into),
        loaded_plan: id(s.plan_id),
        running_plan: id(s.running_plan),
        cycles: s.seq,
        overruns: s.overruns,
        last_overrun: Some(s.overrun.to_string()).filter(|text| !text.is_empty()),
        warnings: upswingd::warning_texts(s.warnings).collect(),
        degraded: Degradation::of(s.degraded).map(|d| d.to_string()).collect(),
        wake_us: Times::new(&s.wake),
        compute_us: Times::new(&s.compute),
        remark: reason(&s),
    })
}
