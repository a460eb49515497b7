//! Robustness curves: share of successful swing-ups over the size of one error or disturbance.

use super::variation::{MissedCycleCounts, ValueError, Variation};
use super::{ENDED_BADLY, NoStart, Scratch, Study, StudyError, shown_pose, wilson};
use crate::closed_loop::{Aborted, RunOptions};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use upswing_config::{Config, VelocityEstimate};
use upswing_ipc::Telemetry;
use upswing_model::State;
use upswing_record::evaluation::SwingUpEvaluation;

/// One point to compute of a robustness curve: variation, value and settings.
#[derive(Debug)]
pub struct RobustnessCase {
    /// The varied quantity.
    pub over: Variation,
    /// Value of the variation, in the unit of `over`.
    pub value: f64,
    /// Method of the controller's velocity estimate.
    pub velocity: VelocityEstimate,
    /// Settings of controller and plant, with the value applied.
    config: Config,
}

impl RobustnessCase {
    /// A case with the settings `base` and the error `value`, in the unit of `over`.
    ///
    /// # Errors
    /// [`ValueError`] if the value is outside the range of `over`.
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

/// A start whose swing-up failed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FailedStart {
    /// Number of the start.
    pub index: u64,
    /// Positions of the actuated joints at the start, deg or m.
    pub start: Vec<f64>,
    /// Kind of the failure.
    pub kind: String,
    /// Details of the failure, one per criterion that was not met.
    pub reasons: Vec<String>,
}

/// Share of successful swing-ups over the values of one variation.
#[derive(Serialize)]
pub struct SuccessCurve {
    /// The varied quantity.
    pub over: Variation,
    /// Label of the axis, with the unit.
    pub label: &'static str,
    /// Method of the controller's velocity estimate, `filter` or `model`.
    pub velocity: &'static str,
    /// Points of the curve, in the order of the cases.
    pub points: Vec<SuccessPoint>,
}

/// Number of successful swing-ups at one value.
#[derive(Serialize)]
pub struct SuccessPoint {
    /// Value of the variation, in its unit.
    pub value: f64,
    /// Number of runs.
    pub samples: usize,
    /// Number of successful runs, in which the rod was balanced at the end.
    pub succeeded: usize,
    /// 95 % interval of the probability of success (Wilson).
    pub interval: (f64, f64),
    /// Number of failures of each kind.
    pub failures: BTreeMap<String, usize>,
    /// The starts of the failed runs.
    pub failed: Vec<FailedStart>,
}

/// A study of swing-ups under errors of growing size.
pub struct RobustnessStudy<'a> {
    /// Planner, starts and threads.
    pub study: &'a Study<'a>,
    /// Histogram of missed cycles for [`Variation::Jitter`].
    pub misses: &'a MissedCycleCounts,
    /// Duration of the balance, s.
    pub seconds: f64,
}

impl RobustnessStudy<'_> {
    /// Runs a swing-up from every start in every case.
    ///
    /// # Errors
    /// [`StudyError`] if there is no start, or threads cannot be started.
    pub fn run(&self, cases: &[RobustnessCase]) -> Result<Vec<SuccessCurve>, StudyError> {
        let Self { study, .. } = self;
        let jobs: Vec<u64> = (0..(cases.len() * study.indices.len()) as u64).collect();
        // In the order of the starts, so that all cases advance together and the estimate of the remaining time is fair.
        let place = |job: u64| (job as usize % cases.len(), job as usize / cases.len());
        let results = study.each(
            0,
            &jobs,
            || Scratch::new(study.planner),
            |scratch, job| {
                let (case, start) = place(job);
                Ok((case, self.sample(&cases[case], scratch, study.indices[start])?))
            },
        )?;
        Ok(curves_of(cases, results))
    }

    /// Runs the swing-up from start number `index` and returns its telemetry, one record per cycle until its end or abort.
    ///
    /// # Errors
    /// [`NoStart`] if there is no start of this number.
    pub fn records(&self, case: &RobustnessCase, index: u64) -> Result<Vec<Telemetry>, NoStart> {
        let mut scratch = Scratch::new(self.study.planner);
        // An abort is part of the study's result already.
        let _ = self.swing_up(case, &mut scratch, index, &self.study.starts.start(index)?);
        Ok(scratch.records)
    }

    /// Runs the swing-up from one start; `None`: success.
    fn sample(
        &self,
        case: &RobustnessCase,
        scratch: &mut Scratch,
        index: u64,
    ) -> Result<Option<FailedStart>, NoStart> {
        let start = self.study.starts.start(index)?;
        let (kind, reasons) = match self.swing_up(case, scratch, index, &start) {
            Ok(evaluation) if evaluation.success => return Ok(None),
            Ok(evaluation) => (ENDED_BADLY.into(), evaluation.failures),
            Err(e) => (e.kind(), vec![e.to_string()]),
        };
        Ok(Some(FailedStart {
            index,
            start: shown_pose(&self.study.starts.config.model, &start),
            kind,
            reasons,
        }))
    }

    fn swing_up(
        &self,
        case: &RobustnessCase,
        scratch: &mut Scratch,
        index: u64,
        start: &State,
    ) -> Result<SwingUpEvaluation, Aborted> {
        let config = &case.config;
        let seconds = case.over.seconds(self.seconds);
        let period = config.daemon.cycle.period.seconds();
        let shares = self.study.starts.shares(index);
        let disturbances =
            |t_f: f64| case.over.disturbances(case.value, t_f, seconds, period, self.misses, shares);
        let (plant, none) = (config.clone(), RunOptions::default());
        scratch.swing_up(self.study.planner, (index, start), config, plant, seconds, disturbances, none)
    }
}

fn name(velocity: VelocityEstimate) -> &'static str {
    match velocity {
        VelocityEstimate::Filter => "filter",
        VelocityEstimate::Model => "model",
    }
}

/// Sorts the results, pairs of case index and failure, into curves.
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
