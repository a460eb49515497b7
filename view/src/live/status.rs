//! What the daemon says about itself.

use serde::Serialize;
use upswing_ipc::{ControlResponse, Degradation, Percentiles};

/// Answer of the daemon to a request for its status.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Status {
    /// Its mode.
    pub mode: String,
    /// The latched fault.
    pub fault: Option<String>,
    /// Id of the plan that waits for its start.
    pub loaded_plan: Option<String>,
    /// Id of the plan that is followed.
    pub running_plan: Option<String>,
    /// Number of the last cycle.
    pub cycles: u64,
    /// Cycles that ended late.
    pub overruns: u64,
    /// When, which phase and why.
    pub last_overrun: Option<String>,
    /// Limits beyond their warning level since the last enable, start or reset.
    pub warnings: Vec<&'static str>,
    /// What the system refused of the real-time set-up.
    pub degraded: Vec<String>,
    /// Lateness of wake-ups.
    pub wake_us: Times,
    /// Computing times.
    pub compute_us: Times,
    /// Cause of a fault or stop, the last refusal.
    pub remark: String,
    /// What the operator can do next.
    pub next: String,
}

/// Percentiles of all cycles since the start of the daemon, us.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Times {
    /// How many durations.
    pub count: u64,
    /// 50 % were at most this.
    pub p50: f64,
    /// 99 %
    pub p99: f64,
    /// 99.9 %
    pub p99_9: f64,
    /// 99.99 %
    pub p99_99: f64,
    /// 100 %
    pub max: f64,
}

impl Times {
    /// From ns.
    pub fn new(p: &Percentiles) -> Self {
        let [p50, p99, p99_9, p99_99, max] =
            [p.p50, p.p99, p.p99_9, p.p99_99, p.max].map(|ns| ns as f64 * 1e-3);
        Self { count: p.count, p50, p99, p99_9, p99_99, max }
    }

    /// One line without its end.
    pub fn line(&self, f: &mut std::fmt::Formatter<'_>, name: &str) -> std::fmt::Result {
        let Self { p50, p99, p99_9, p99_99, max, .. } = self;
        write!(
            f,
            "{name:<10} p50 {p50:.1}, p99 {p99:.1}, p99.9 {p99_9:.1}, p99.99 {p99_99:.1}, max {max:.1} us"
        )
    }
}

impl Status {
    /// Reads an answer, of which nothing is trusted.
    pub fn new(s: &ControlResponse) -> Self {
        let id = |id: u64| (id != 0).then(|| format!("{id:016x}"));
        Self {
            mode: s.mode_text(),
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
            remark: s.reason.to_string(),
            next: s.next.to_string(),
        }
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
        write!(f, "\nnext       {}", self.next)
    }
}
