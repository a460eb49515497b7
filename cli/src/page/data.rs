//! What the page shows, as the JSON that its script reads.

use super::times::{CycleTimes, Times};
use crate::recording::{Recording, RecordingError, Tally};
use crate::report::Figures;
use crate::robot::{Capsule, Link, Robot};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use upswing_ipc::{Degradation, Mode, Telemetry};
use upswing_model::{Limits, Model, NQ, NU};
use xxhash_rust::xxh3::xxh3_64;

/// Samples of the motion per second: smooth on a screen.
const RATE: f64 = 250.0;
/// Most samples of one page; a longer recording gets a coarser motion.
const SAMPLES: usize = 30_000;

/// Everything on the page. Times in s from the start of the first plan, or else from the first cycle.
#[derive(Debug, Serialize)]
pub struct Data {
    name: String,
    /// Name and value.
    summary: Vec<(&'static str, String)>,
    details: BTreeMap<String, String>,
    /// Name, fingerprint, text.
    settings: Vec<(String, String, String)>,
    #[serde(flatten)]
    body: Body,
    /// Times of the samples.
    t: Vec<f64>,
    /// Angles of one joint each, rad.
    q: Vec<Vec<f64>>,
    qd: Vec<Vec<f64>>,
    q_d: Vec<Vec<f64>>,
    qd_d: Vec<Vec<f64>>,
    /// Torques of one joint each, N m.
    tau: Vec<Vec<f64>>,
    modes: Vec<Span>,
    /// Times of cycles that ended late.
    late: Vec<f64>,
    times: Vec<Times>,
    period_us: f64,
}

/// A stretch of time in one mode.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Span {
    /// The mode, or the cause of a fault.
    pub name: String,
    /// Begin, s.
    pub from: f64,
    /// End, s.
    pub to: f64,
}

/// The robot as both pages draw it.
#[derive(Debug, Serialize)]
pub(super) struct Body {
    links: Vec<LinkJson>,
    limits: LimitsJson,
}

impl Body {
    /// `limits`: 100 %.
    pub(super) fn new(robot: Robot, limits: &Limits) -> Self {
        Self {
            links: robot.links.into_iter().map(LinkJson::from).collect(),
            limits: LimitsJson {
                q: limits.q_max.iter().copied().collect(),
                qd: limits.qd_max.iter().copied().collect(),
                tau: limits.tau_max.iter().copied().collect(),
            },
        }
    }
}

#[derive(Debug, Serialize)]
struct LimitsJson {
    q: Vec<f64>,
    qd: Vec<f64>,
    tau: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct LinkJson {
    name: String,
    parent: Option<usize>,
    origin: [f64; 3],
    /// Rows of the rotation matrix.
    rotation: [[f64; 3]; 3],
    joint: Option<usize>,
    axis: [f64; 3],
    shapes: Vec<Capsule>,
}

impl From<Link> for LinkJson {
    fn from(link: Link) -> Self {
        let r = link.origin.rotation.to_rotation_matrix();
        Self {
            name: link.name,
            parent: link.parent,
            origin: link.origin.translation.vector.into(),
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| r[(i, j)])),
            joint: link.joint.map(|(i, _)| i),
            axis: link.joint.map_or([0.0; 3], |(_, axis)| axis.into_inner().into()),
            shapes: link.shapes,
        }
    }
}

/// Moment that pictures count from: the start of the first plan, or else the first cycle. ns.
pub fn zero(records: &[Telemetry]) -> u64 {
    let first = records.iter().find(|t| t.mode() == Ok(Mode::Track)).or(records.first());
    first.map_or(0, |t| t.t_ns)
}

/// The modes one after the other, s from `zero` (ns).
pub fn spans(records: &[Telemetry], zero: u64) -> Vec<Span> {
    let mut spans: Vec<Span> = Vec::new();
    let mut previous = None;
    for record in records {
        let t = seconds(record, zero);
        if let Some(span) = spans.last_mut() {
            span.to = t;
        }
        if previous != Some((record.mode, record.fault)) {
            let mode = record.mode().map_or_else(|e| e.to_string(), |mode| mode.to_string());
            let cause = upswingd::fault_text(record.fault).filter(|_| record.mode() == Ok(Mode::Fault));
            let name = cause.map_or_else(|| mode.clone(), |cause| format!("{mode}: {cause}"));
            spans.push(Span { name, from: t, to: t });
            previous = Some((record.mode, record.fault));
        }
    }
    spans
}

fn seconds(record: &Telemetry, zero: u64) -> f64 {
    round((record.t_ns as i128 - zero as i128) as f64 * 1e-9, 1e6)
}

/// Digits that no screen shows would double the size of the page.
fn round(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

impl Data {
    /// What is to be shown of a recording, whose file is `path`.
    ///
    /// # Errors
    /// [`RecordingError`] if the recording does not hold a robot that can be drawn.
    pub fn new(path: &Path, recording: &Recording) -> Result<Self, RecordingError> {
        let urdf = urdf(path, recording)?;
        let model = model(path, urdf)?;
        let robot = Robot::from_urdf(urdf, &model)
            .map_err(|cause| RecordingError::Robot { path: path.to_owned(), cause })?;
        let records = &recording.cycles;
        let limits = model.rated_limits();
        let tally = Tally::of(records);
        let period = period(records);
        let zero = zero(records);
        let every = ((1.0 / (RATE * period)) as usize).max(records.len() / SAMPLES).max(1);
        let samples: Vec<_> = records.iter().step_by(every).collect();
        let column = |of: &dyn Fn(&Telemetry) -> f64| samples.iter().map(|t| round(of(t), 1e4)).collect();
        let columns = |n: usize, of: fn(&Telemetry, usize) -> f64| {
            (0..n).map(|i| column(&|t| of(t, i))).collect::<Vec<Vec<f64>>>()
        };
        let late = records.iter().filter(|t| t.flags & Telemetry::OVERRUN != 0);
        Ok(Self {
            name: path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            summary: summary(&Figures::new(&model, limits, period, records, tally.lost), &tally, recording),
            details: recording.details.clone(),
            settings: settings(recording),
            body: Body::new(robot, limits),
            t: samples.iter().map(|t| seconds(t, zero)).collect(),
            q: columns(NQ, |t, i| t.q[i]),
            qd: columns(NQ, |t, i| t.qd[i]),
            q_d: columns(NQ, |t, i| t.q_d[i]),
            qd_d: columns(NQ, |t, i| t.qd_d[i]),
            tau: columns(NU, |t, i| t.tau[i]),
            modes: spans(records, zero),
            late: late.take(SAMPLES).map(|t| seconds(t, zero)).collect(),
            times: CycleTimes::of(records).times(),
            period_us: period * 1e6,
        })
    }
}

fn urdf<'a>(path: &Path, recording: &'a Recording) -> Result<&'a str, RecordingError> {
    recording.file_text("robot.urdf").ok_or_else(|| RecordingError::Missing {
        path: path.to_owned(),
        expected: "an attachment robot.urdf".into(),
    })
}

fn model(path: &Path, urdf: &str) -> Result<Model, RecordingError> {
    Model::from_urdf(urdf).map_err(|e| RecordingError::Robot {
        path: path.to_owned(),
        cause: crate::robot::RobotError::Parse(e.to_string()),
    })
}

/// Limits of the robot in a recording, 100 %.
///
/// # Errors
/// [`RecordingError`] if there is no robot.
pub fn limits(path: &Path, recording: &Recording) -> Result<Limits, RecordingError> {
    Ok(*model(path, urdf(path, recording)?)?.rated_limits())
}

/// Time from one cycle to the next, s: the median, because cycles may be late or missing.
pub fn period(records: &[Telemetry]) -> f64 {
    /// Where there is a single cycle only.
    const USUAL: f64 = 125e-6;
    let mut steps: Vec<u64> = records.windows(2).map(|w| w[1].t_ns.saturating_sub(w[0].t_ns)).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).filter(|step| **step > 0).map_or(USUAL, |step| *step as f64 * 1e-9)
}

fn settings(recording: &Recording) -> Vec<(String, String, String)> {
    let files = recording.files.iter();
    files
        .map(|(name, text)| (name.clone(), format!("{:016x}", xxh3_64(text.as_bytes())), text.clone()))
        .collect()
}

fn summary(f: &Figures, tally: &Tally, recording: &Recording) -> Vec<(&'static str, String)> {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let degraded = recording.cycles.iter().fold(0, |bits, t| bits | t.degraded);
    let degraded: Vec<_> = Degradation::of(degraded).map(|d| d.to_string()).collect();
    let warnings = recording.cycles.iter().fold(0, |bits, t| bits | t.warnings);
    let warnings: Vec<_> = upswingd::warning_texts(warnings).collect();
    let mut rows = vec![
        ("duration", format!("{:.3} s", tally.seconds)),
        ("cycles", format!("{} recorded, {} lost, {} late", f.cycles, f.dropped, f.overruns)),
        (
            "tracking error",
            format!(
                "{:.3} rad (joints 1-7), {:.3} rad (pendulum)",
                f.tracking_error_arm, f.tracking_error_pendulum
            ),
        ),
        ("balance", format!("{:.2} s", f.balance_s)),
    ];
    if f.final_tilt_deg.is_finite() {
        rows.push((
            "last second of balance",
            format!(
                "rod within {:.2} deg of upright, arm below {:.3} rad/s",
                f.final_tilt_deg, f.final_speed
            ),
        ));
    }
    rows.push((
        "peaks of joints 1-7",
        format!(
            "position {}, velocity {}, torque {} of the 100 % limits",
            percent(f.peak_position),
            percent(f.peak_velocity),
            percent(f.peak_torque)
        ),
    ));
    let mut texts = |name, texts: String| {
        if !texts.is_empty() {
            rows.push((name, texts));
        }
    };
    texts("warnings", warnings.join(", "));
    texts("real time, degraded", degraded.join(", "));
    texts("recording ends early", recording.cut.clone().unwrap_or_default());
    rows
}
