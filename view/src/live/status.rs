//! The status of the daemon for display.

use serde::Serialize;
use upswing_ipc::{ControlResponse, Degradation, Percentiles};

/// Status of the daemon.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DaemonStatus {
    /// Mode of the daemon.
    pub mode: String,
    /// Latched fault.
    pub fault: Option<String>,
    /// Id of the plan that waits for its start.
    pub loaded_plan: Option<String>,
    /// Id of the plan that is followed.
    pub running_plan: Option<String>,
    /// Number of the last cycle.
    pub cycles: u64,
    /// Cycles that ended late.
    pub overruns: u64,
    /// Time, phase and cause of the last late cycle.
    pub last_overrun: Option<String>,
    /// Limits beyond their warning level since the last enable, start or reset.
    pub warnings: Vec<&'static str>,
    /// Parts of the real-time set-up that the operating system refused.
    pub degraded: Vec<String>,
    /// Latency of wake-ups.
    pub wake_us: LatencyPercentiles,
    /// Computing time of a cycle.
    pub compute_us: LatencyPercentiles,
    /// Cause of a fault or stop, and the last refusal.
    pub remark: String,
    /// Next action of the operator.
    pub next: String,
}

/// Percentiles of a duration over all cycles since the start of the daemon, us.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LatencyPercentiles {
    /// Number of durations.
    pub count: u64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p99_9: f64,
    /// 99.99th percentile.
    pub p99_99: f64,
    /// Maximum.
    pub max: f64,
}

impl LatencyPercentiles {
    /// Converts percentiles from ns to us.
    pub fn new(p: &Percentiles) -> Self {
        let [p50, p99, p99_9, p99_99, max] =
            [p.p50, p.p99, p.p99_9, p.p99_99, p.max].map(|ns| ns as f64 * 1e-3);
        Self { count: p.count, p50, p99, p99_9, p99_99, max }
    }

    /// Writes one line of text, without a line end.
    pub fn line(&self, f: &mut std::fmt::Formatter<'_>, name: &str) -> std::fmt::Result {
        let Self { p50, p99, p99_9, p99_99, max, .. } = self;
        write!(
            f,
            "{name:<10} p50 {p50:.1}, p99 {p99:.1}, p99.9 {p99_9:.1}, p99.99 {p99_99:.1}, max {max:.1} us"
        )
    }
}

impl DaemonStatus {
    /// Converts the response of the daemon, whose values are not trusted.
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
            wake_us: LatencyPercentiles::new(&s.wake),
            compute_us: LatencyPercentiles::new(&s.compute),
            remark: s.reason.to_string(),
            next: s.next.to_string(),
        }
    }
}

impl std::fmt::Display for DaemonStatus {
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
