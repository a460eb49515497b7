//! `upswing status`: how the system is.

use super::CommonArgs;
use super::request::{control, mode, reason};
use serde::Serialize;
use upswing_config::process::Failure;
use upswing_ipc::ControlCommand;

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
    degraded: bool,
    remark: String,
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
        if self.degraded {
            write!(f, "\nreal time  degraded: the system refused real-time scheduling or locked memory")?;
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
        degraded: s.degraded == 1,
        remark: reason(&s),
    })
}
