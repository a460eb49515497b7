//! How many swing-ups succeed over growing errors of one kind, as curves.

use super::variation::{MissedCycleCounts, ValueError, Variation};
use super::{ENDED_BADLY, NoStart, Scratch, Study, StudyError, arm_degrees, wilson};
use crate::closed_loop::Aborted;
use serde::Serialize;
use std::collections::BTreeMap;
use upswing_config::{Config, VelocityEstimate};
use upswing_ipc::Telemetry;
use upswing_model::{NU, State};
use upswing_record::evaluation::SwingUpEvaluation;

/// One value of one curve.
pub struct RobustnessCase {
    /// What is varied.
    pub over: Variation,
    /// By how much, in the unit of `over`.
    pub value: f64,
    /// Where the controller takes velocities from.
    pub velocity: VelocityEstimate,
    /// Settings of controller and plant.
    config: Config,
}

impl RobustnessCase {
    /// The settings `base` with an error of `value`, in the unit of `over`.
    ///
    /// # Errors
    /// [`ValueError`]
    pub fn new(
        over: Variation,
        value: f64,
        velocity: VelocityEstimate,
        base: &Config,
    ) -> Result<Self, ValueError> {
        over.check(value)?;
        let mut config = base.clone();
        config.daemon.cycle.velocity = velocity;
        over.apply(value, &mut config);
        Ok(Self { over, value, velocity, config })
    }
}

/// A start that did not end balanced.
#[derive(Clone, Debug, Serialize)]
pub struct FailedStart {
    /// Number of the start.
    pub index: u64,
    /// Angles of joints 1-7, deg.
    pub start_deg: [f64; NU],
    /// The kind of failure.
    pub kind: String,
    /// What exactly was wrong.
    pub reasons: Vec<String>,
}

/// Success over the values of one variation.
#[derive(Serialize)]
pub struct SuccessCurve {
    /// What is varied.
    pub over: Variation,
    /// For the axis, with the unit.
    pub label: &'static str,
    /// Where the controller takes velocities from.
    pub velocity: &'static str,
    /// In the order of the cases.
    pub points: Vec<SuccessPoint>,
}

/// Success at one value.
#[derive(Serialize)]
pub struct SuccessPoint {
    /// By how much, in the unit of the variation.
    pub value: f64,
    /// Runs.
    pub samples: usize,
    /// Runs that ended balanced.
    pub succeeded: usize,
    /// 95 % interval of the probability of success (Wilson).
    pub interval: (f64, f64),
    /// How often each kind of failure occurred.
    pub failures: BTreeMap<String, usize>,
    /// Each run that did not end balanced.
    pub failed: Vec<FailedStart>,
}

/// Swing-ups from every start of the study in every case, each balanced for `seconds`; `misses` for [`Variation::Jitter`].
///
/// # Errors
/// [`StudyError`]
pub fn run(
    study: &Study<'_>,
    cases: &[RobustnessCase],
    misses: &MissedCycleCounts,
    seconds: f64,
) -> Result<Vec<SuccessCurve>, StudyError> {
    let jobs: Vec<u64> = (0..(cases.len() * study.indices.len()) as u64).collect();
    // In the order of the starts, so that the values of a curve take turns and the estimate of the time left is fair.
    let place = |job: u64| (job as usize % cases.len(), job as usize / cases.len());
    let results = study.each(
        &jobs,
        || Scratch::new(study.planner),
        |scratch, job| {
            let (case, start) = place(job);
            let failed = sample(study, &cases[case], misses, seconds, scratch, study.indices[start])?;
            Ok((case, failed))
        },
    )?;
    Ok(curves_of(cases, results))
}

/// Every cycle of the swing-up from start number `index`, as far as it came.
///
/// # Errors
/// [`NoStart`]
pub fn records(
    study: &Study<'_>,
    case: &RobustnessCase,
    misses: &MissedCycleCounts,
    seconds: f64,
    index: u64,
) -> Result<Vec<Telemetry>, NoStart> {
    let mut scratch = Scratch::new(study.planner);
    // How it ended, the result of the study says.
    let _ = swing_up(study, case, misses, seconds, &mut scratch, index, &study.starts.start(index)?);
    Ok(scratch.records)
}

/// What became of one start; `None`: it ended balanced.
fn sample(
    study: &Study<'_>,
    case: &RobustnessCase,
    misses: &MissedCycleCounts,
    seconds: f64,
    scratch: &mut Scratch,
    index: u64,
) -> Result<Option<FailedStart>, NoStart> {
    let start = study.starts.start(index)?;
    let (kind, reasons) = match swing_up(study, case, misses, seconds, scratch, index, &start) {
        Ok(report) if report.success => return Ok(None),
        Ok(report) => (ENDED_BADLY.into(), report.failures),
        Err(e) => (e.kind(), vec![e.to_string()]),
    };
    Ok(Some(FailedStart { index, start_deg: arm_degrees(&start), kind, reasons }))
}

fn swing_up(
    study: &Study<'_>,
    case: &RobustnessCase,
    misses: &MissedCycleCounts,
    seconds: f64,
    scratch: &mut Scratch,
    index: u64,
    start: &State,
) -> Result<SwingUpEvaluation, Aborted> {
    let config = &case.config;
    let seconds = case.over.seconds(seconds);
    let period = config.daemon.cycle.period.seconds();
    let shares = study.starts.shares(index);
    let disturbances = |t_f: f64| case.over.disturbances(case.value, t_f, seconds, period, misses, shares);
    scratch.swing_up(study.planner, (index, start), config, config.clone(), seconds, disturbances)
}

fn name(velocity: VelocityEstimate) -> &'static str {
    match velocity {
        VelocityEstimate::Filter => "filter",
        VelocityEstimate::Model => "model",
    }
}

/// The results, which name their case, as curves.
fn curves_of(cases: &[RobustnessCase], results: Vec<(usize, Option<FailedStart>)>) -> Vec<SuccessCurve> {
    let mut points: Vec<SuccessPoint> = cases
        .iter()
        .map(|case| SuccessPoint {
            value: case.value,
            samples: 0,
            succeeded: 0,
            interval: (0.0, 1.0),
            failures: BTreeMap::new(),
            failed: Vec::new(),
        })
        .collect();
    for (case, failed) in results {
        let point = &mut points[case];
        point.samples += 1;
        point.succeeded += usize::from(failed.is_none());
        if let Some(failed) = failed {
            *point.failures.entry(failed.kind.clone()).or_default() += 1;
            point.failed.push(failed);
        }
    }
    let mut curves: Vec<SuccessCurve> = Vec::new();
    for (case, mut point) in cases.iter().zip(points) {
        point.interval = wilson(point.succeeded, point.samples);
        let velocity = name(case.velocity);
        match curves.last_mut().filter(|c| c.over == case.over && c.velocity == velocity) {
            Some(curve) => curve.points.push(point),
            None => {
                let label = case.over.label();
                curves.push(SuccessCurve { over: case.over, label, velocity, points: vec![point] });
            }
        }
    }
    curves
}
