//! Metrics of a system: a [`View`] as OpenMetrics, <https://prometheus.io/docs/specs/om/open_metrics_spec/>. All types also exist
//! in the older text format, which the textfile collector of node_exporter reads.

use crate::live::{CycleView, DaemonStatus, LatencyPercentiles, View};
use serde::Serialize;
use std::fmt::Write;
use upswing_ipc::{Degradation, Mode};
use upswingd::trip::TripCause;

/// Content type of [`text`].
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Type of a metric family.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum MetricType {
    /// The value rises and falls.
    Gauge,
    /// The value rises; 0 after a restart.
    Counter,
    /// Percentiles of a distribution.
    Summary,
}

/// Metric family: samples of one metric with different labels.
#[derive(Clone, Debug, Serialize)]
pub struct MetricFamily {
    /// Name with the unit, without the suffix of a sample.
    pub name: String,
    /// Type of the metric.
    pub kind: MetricType,
    /// Base unit, empty for numbers without a unit.
    pub unit: &'static str,
    /// Description of the metric.
    pub help: &'static str,
    /// Samples of the metric.
    pub samples: Vec<MetricSample>,
}

/// Sample of a metric: a value with its labels.
#[derive(Clone, Debug, Serialize)]
pub struct MetricSample {
    /// Suffix after the name of the family: `_total`, `_count`, or nothing.
    pub suffix: &'static str,
    /// Names and values of the labels.
    pub labels: Vec<(&'static str, String)>,
    /// Value, in the unit of the family.
    pub value: f64,
}

/// Collector of metric families.
#[derive(Default)]
struct Families(Vec<MetricFamily>);

impl Families {
    fn add(
        &mut self,
        kind: MetricType,
        name: &str,
        unit: &'static str,
        help: &'static str,
        samples: Vec<MetricSample>,
    ) {
        let end = if unit.is_empty() { String::new() } else { format!("_{unit}") };
        self.0.push(MetricFamily { name: format!("upswing_{name}{end}"), kind, unit, help, samples });
    }

    fn gauge(&mut self, name: &str, unit: &'static str, help: &'static str, value: f64) {
        self.add(MetricType::Gauge, name, unit, help, vec![sample("", vec![], value)]);
    }

    fn counter(&mut self, name: &str, help: &'static str, value: u64) {
        self.add(MetricType::Counter, name, "", help, vec![sample("_total", vec![], value as f64)]);
    }

    /// Adds a gauge with one sample for each value of a label.
    fn each(
        &mut self,
        name: &str,
        unit: &'static str,
        help: &'static str,
        label: &'static str,
        values: impl IntoIterator<Item = (String, f64)>,
    ) {
        let samples = values.into_iter().map(|(of, value)| sample("", vec![(label, of)], value)).collect();
        self.add(MetricType::Gauge, name, unit, help, samples);
    }

    fn percentiles(&mut self, name: &str, help: &'static str, us: &LatencyPercentiles) {
        let quantiles = [("0.5", us.p50), ("0.99", us.p99), ("0.999", us.p99_9), ("0.9999", us.p99_99)];
        let mut samples: Vec<_> = quantiles
            .into_iter()
            .map(|(of, value)| sample("", vec![("quantile", of.into())], value * 1e-6))
            .collect();
        samples.push(sample("_count", vec![], us.count as f64));
        self.add(MetricType::Summary, name, "seconds", help, samples);
        self.gauge(&format!("{name}_max"), "seconds", "Longest since the start of the daemon", us.max * 1e-6);
    }
}

fn sample(suffix: &'static str, labels: Vec<(&'static str, String)>, value: f64) -> MetricSample {
    MetricSample { suffix, labels, value }
}

fn flag(is: bool) -> f64 {
    f64::from(u8::from(is))
}

/// Collects the metrics of a system; those of cycles and status only once these have arrived.
pub fn families(view: &View) -> Vec<MetricFamily> {
    let mut f = Families::default();
    let here = [("daemon", view.daemon), ("planner", view.planner), ("plant", view.plant)];
    let here = here.map(|(name, here)| (name.to_owned(), flag(here)));
    f.each("process_up", "", "Whether the process is there", "process", here);
    let mode = |mode: &Mode| (mode.to_string(), flag(view.mode.as_deref() == Some(&mode.to_string())));
    f.each("mode", "", "1 for the mode of the daemon", "mode", Mode::ALL.iter().map(mode));
    f.counter("faults_seen", "Faults since the start of this exporter", view.faults);
    f.counter("plans_seen", "Plans published since the start of this exporter", view.plans);
    f.counter("cycles_lost", "Cycles whose telemetry did not reach this exporter", view.lost);
    if let Some(plan) = &view.plan {
        f.gauge("plan_duration", "seconds", "Duration of the newest plan, t_F", plan.t_f);
    }
    if let Some(status) = &view.status {
        of_status(&mut f, status);
    }
    if let Some(cycle) = &view.cycle {
        of_cycle(&mut f, cycle);
    }
    f.0
}

fn of_status(f: &mut Families, status: &DaemonStatus) {
    f.counter("cycles", "Control cycles since the start of the daemon", status.cycles);
    f.counter("cycles_late", "Cycles that ended late since the start of the daemon", status.overruns);
    f.percentiles("wake_up", "Lateness of wake-ups since the start of the daemon", &status.wake_us);
    f.percentiles("compute", "Computing time of cycles since the start of the daemon", &status.compute_us);
    let warned = |cause: &TripCause| (cause.text().to_owned(), flag(status.warnings.contains(&cause.text())));
    let help = "Limits beyond their warning level since the last enable, start or reset";
    f.each("warning", "", help, "cause", TripCause::ALL.iter().map(warned));
    let refused = |d: &Degradation| (d.to_string(), flag(status.degraded.contains(&d.to_string())));
    let help = "What the system refused of the real-time set-up";
    f.each("degraded", "", help, "what", Degradation::ALL.iter().map(refused));
}

fn of_cycle(f: &mut Families, cycle: &CycleView) {
    let fault = |cause: &TripCause| (cause.text().to_owned(), flag(cycle.fault == Some(cause.text())));
    f.each("fault", "", "1 for the latched fault", "cause", TripCause::ALL.iter().map(fault));
    f.gauge("brakes_closed", "", "Whether the brakes are closed", flag(cycle.brakes));
    f.gauge("torque_limited", "", "Whether the torque limiter cut the command", flag(cycle.limited));
    f.gauge("rod_tilt", "radians", "Angle of the last link from upright", cycle.tilt);
    let errors = [("arm", cycle.error_arm), ("pendulum", cycle.error_pendulum)];
    let errors = errors.map(|(part, error)| (part.to_owned(), error));
    let help = "Largest distance of a joint from its reference in track and balance";
    f.each("tracking_error", "radians", help, "part", errors);
    let joints = || (1..).map(|i: usize| i.to_string()).zip(&cycle.joints);
    let help = "Position of a joint";
    f.each("joint_position", "radians", help, "joint", joints().map(|(i, j)| (i, j.q)));
    let help = "Velocity of a joint";
    f.each("joint_velocity", "radians_per_second", help, "joint", joints().map(|(i, j)| (i, j.qd)));
    let torques = || joints().filter_map(|(i, j)| Some((i, j.tau, j.torque()?)));
    let help = "Commanded torque of a joint";
    f.each("joint_torque", "newton_meters", help, "joint", torques().map(|(i, tau, _)| (i, tau)));
    let help = "Place between the limits of the position, from -1 to 1";
    f.each("joint_position", "ratio", help, "joint", joints().map(|(i, j)| (i, j.position())));
    let help = "Velocity by its 100 % limit";
    f.each("joint_velocity", "ratio", help, "joint", joints().map(|(i, j)| (i, j.velocity())));
    let help = "Commanded torque by its 100 % limit";
    f.each("joint_torque", "ratio", help, "joint", torques().map(|(i, _, share)| (i, share)));
}

/// Formats the families as OpenMetrics text.
pub fn text(families: &[MetricFamily]) -> String {
    let mut text = String::new();
    for MetricFamily { name, kind, unit, help, samples } in families {
        let kind = match kind {
            MetricType::Gauge => "gauge",
            MetricType::Counter => "counter",
            MetricType::Summary => "summary",
        };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "# TYPE {name} {kind}");
        if !unit.is_empty() {
            let _ = writeln!(text, "# UNIT {name} {unit}");
        }
        let _ = writeln!(text, "# HELP {name} {help}");
        for MetricSample { suffix, labels, value } in samples {
            let labels: Vec<_> =
                labels.iter().map(|(name, value)| format!("{name}=\"{}\"", escape(value))).collect();
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            let _ = writeln!(text, "{name}{suffix}{labels} {}", number(*value));
        }
    }
    text.push_str("# EOF\n");
    text
}

fn escape(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

fn number(value: f64) -> String {
    match value {
        f64::INFINITY => "+Inf".into(),
        f64::NEG_INFINITY => "-Inf".into(),
        value => value.to_string(),
    }
}
