//! Data of a recording's page, as the JSON that its script reads.

use super::times::LatencyHistogram;
use super::{MotionColumns, RecordingDigest};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use upswing_ipc::{Degradation, Mode};
use upswing_model::{JointVector, Limits, Model};
use upswing_record::robot::{Capsule, Link, Robot};
use upswing_record::{Recording, RecordingError};
use xxhash_rust::xxh3::xxh3_64;

/// Data on the page. Times in s from the start of the first plan, or from the first cycle if there is no plan.
#[derive(Debug, Serialize)]
pub struct PageData {
    name: String,
    /// Names and values.
    summary: Vec<(&'static str, String)>,
    details: BTreeMap<String, String>,
    /// Names, fingerprints and texts of the attached files.
    settings: Vec<(String, String, String)>,
    #[serde(flatten)]
    body: RobotDrawing,
    #[serde(flatten)]
    motion: MotionColumns,
    modes: Vec<ModeSpan>,
    /// Times of overrun cycles, s.
    late: Vec<f64>,
    times: Vec<LatencyHistogram>,
    period_us: f64,
}

/// Time span in one mode.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModeSpan {
    /// Mode, or cause of a fault.
    pub name: String,
    /// Begin, s.
    pub from: f64,
    /// End, s.
    pub to: f64,
}

/// Links and limits of the robot, for both pages.
#[derive(Debug, Serialize)]
pub(super) struct RobotDrawing {
    links: Vec<LinkJson>,
    joints: Vec<JointJson>,
    limits: LimitsJson,
}

impl RobotDrawing {
    /// Links of `robot`, and `limits` of its `model` drawn as 100 %.
    pub(super) fn new(robot: Robot, model: &Model, limits: &Limits) -> Self {
        let (sizes, order) = (model.sizes(), model.order());
        let in_chain = |v: &JointVector| order.in_chain(v)[..sizes.joints()].to_vec();
        let joints = model.joint_names().enumerate().map(|(i, name)| {
            let c = order.coordinate(i);
            let (_, unit) = model.joint_kind(c).shown(0.0);
            JointJson { name: name.to_owned(), unit, motor: order.is_actuated(i).then_some(c) }
        });
        Self {
            links: robot.links.into_iter().map(LinkJson::from).collect(),
            joints: joints.collect(),
            limits: LimitsJson {
                q: in_chain(&JointVector::from_fn(sizes, |c| limits.largest_position(c))),
                qd: in_chain(&limits.qd_max),
                tau: limits.tau_max.to_vec(),
            },
        }
    }
}

/// A joint of the chain.
#[derive(Debug, Serialize)]
struct JointJson {
    name: String,
    /// Unit in which positions are shown: deg or m.
    unit: &'static str,
    /// Index of its motor in lists of torques; `None`: no motor.
    motor: Option<usize>,
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
    /// Rotation matrix by rows.
    rotation: [[f64; 3]; 3],
    joint: Option<usize>,
    axis: [f64; 3],
    /// Whether the joint slides along its axis instead of turning about it.
    slides: bool,
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
            joint: link.joint.map(|joint| joint.index),
            axis: link.joint.map_or([0.0; 3], |joint| joint.axis.into_inner().into()),
            slides: link.joint.is_some_and(|joint| joint.slides),
            shapes: link.shapes,
        }
    }
}

impl PageData {
    /// Collects the data of a recording, whose file is `path`.
    ///
    /// # Errors
    /// [`RecordingError`] if the recording has no URDF `robot.urdf` or its robot cannot be drawn.
    pub fn new(path: &Path, recording: &Recording, digest: &RecordingDigest) -> Result<Self, RecordingError> {
        let robot = Robot::from_urdf(recording.urdf(path)?, &digest.model)
            .map_err(|cause| RecordingError::Robot { path: path.to_owned(), cause })?;
        let mut motion = MotionColumns::new(digest.model.sizes());
        digest.samples.iter().for_each(|record| motion.push(digest.seconds(record.t_ns), record));
        Ok(Self {
            name: path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            summary: summary(digest, recording),
            details: recording.details.clone(),
            settings: settings(recording),
            body: RobotDrawing::new(robot, &digest.model, &digest.model.rated_limits().scale()),
            motion,
            modes: digest.spans(),
            late: digest.late(),
            times: digest.times.times(),
            period_us: digest.period * 1e6,
        })
    }
}

fn settings(recording: &Recording) -> Vec<(String, String, String)> {
    let files = recording.files.iter();
    files
        .map(|(name, text)| (name.clone(), format!("{:016x}", xxh3_64(text.as_bytes())), text.clone()))
        .collect()
}

fn summary(digest: &RecordingDigest, recording: &Recording) -> Vec<(&'static str, String)> {
    let ((end, statistics), tally) = (digest.statistics(), &digest.tally);
    let (time, last_second) = match end {
        Mode::Balance => ("balance", "last second of balance"),
        _ => ("hold after a plan", "last second of hold"),
    };
    let motion = statistics.motion;
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let degraded: Vec<_> = Degradation::of(digest.degraded).map(|d| d.to_string()).collect();
    let warnings: Vec<_> = upswingd::warning_texts(digest.warnings).collect();
    let mut rows = vec![
        ("duration", format!("{:.3} s", tally.seconds)),
        (
            "cycles",
            format!(
                "{} recorded, {} lost, {} late",
                statistics.cycles, statistics.dropped, statistics.overruns
            ),
        ),
        (
            "tracking error",
            format!(
                "{:.3} (actuated joints), {:.3} (unactuated joints), rad or m",
                motion.tracking_error_arm, motion.tracking_error_pendulum
            ),
        ),
        (time, format!("{:.2} s", statistics.balance_s)),
    ];
    if motion.final_error_deg.is_finite() {
        rows.push((
            last_second,
            format!(
                "unactuated joints within {:.2} deg of the end of the plan, actuated joints below {:.3} rad/s or m/s",
                motion.final_error_deg, motion.final_speed
            ),
        ));
    }
    rows.push((
        "peaks of the actuated joints",
        format!(
            "position {}, velocity {}, torque {} of the 100 % limits",
            percent(motion.peak_position),
            percent(motion.peak_velocity),
            percent(motion.peak_torque)
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
    texts("recording damaged", recording.damage.clone().unwrap_or_default());
    rows
}
