//! Monte Carlo study of swing-ups under one plant condition that is unknown to planner and controller.

use super::condition::PlantCondition;
use super::contender::Contender;
use super::{ENDED_BADLY, NoStart, Scratch, Spread, Study, StudyError, shown_pose};
use crate::closed_loop::{Aborted, Disturbances, ReplanCounts, RunOptions};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Instant;
use upswing_ipc::Telemetry;
use upswing_model::State;
use upswing_record::evaluation::{MotionFigures, SwingUpEvaluation};

/// Result of the swing-up from one start. It is a function of settings, condition, seed and index only.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunResult {
    /// Number of the start.
    pub index: u64,
    /// Positions of the actuated joints at the start, deg or m.
    pub start: Vec<f64>,
    /// Figures of a completed run; `None` if the run was aborted.
    pub end: Option<RunFigures>,
    /// Kind of the failure; `None`: success, the rod was balanced at the end.
    pub failure: Option<String>,
    /// Details of the failure, one per criterion that was not met.
    pub reasons: Vec<String>,
    /// What continuous replanning did.
    pub replans: ReplanCounts,
}

/// Figures of one swing-up, a part of [`SwingUpEvaluation`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunFigures {
    /// Duration of the plan t_F, s.
    pub t_f: f64,
    /// Figures of the motion.
    #[serde(flatten)]
    pub motion: MotionFigures,
}

/// Result of all runs under one condition. Spreads are over the completed runs; `None` without any.
#[derive(Serialize)]
pub struct ConditionResult {
    /// Name of the condition.
    pub condition: String,
    /// Purpose of the condition, a sentence.
    pub purpose: String,
    /// Number of runs.
    pub samples: usize,
    /// Number of successful runs, in which the rod was balanced at the end.
    pub succeeded: usize,
    /// Number of failures of each kind.
    pub failures: BTreeMap<String, usize>,
    /// What continuous replanning did in all runs.
    pub replans: ReplanCounts,
    /// Spread of each figure of the motion.
    #[serde(flatten)]
    pub motion: MotionFigures<Option<Spread>>,
    /// Computation times.
    pub times: RunTimes,
    /// Result of each run, in the order of the starts.
    pub results: Vec<RunResult>,
}

/// Computation times of the runs, s; the only part of the result that is not reproducible.
#[derive(Serialize)]
pub struct RunTimes {
    /// Spread over the single runs, s.
    pub run: Option<Spread>,
    /// Time for all runs together, s.
    pub total: f64,
}

/// A study of swing-ups under one plant condition.
pub struct ConditionStudy<'a> {
    /// Planner, starts and threads.
    pub study: &'a Study<'a>,
    /// Number of the condition in the study.
    pub part: usize,
    /// The condition of the plant.
    pub condition: &'a PlantCondition,
    /// Duration of the balance, s.
    pub seconds: f64,
    /// Plans and controller in place of those of planner and daemon.
    pub contender: Option<&'a dyn Contender>,
}

impl ConditionStudy<'_> {
    /// Runs a swing-up from every start.
    ///
    /// # Errors
    /// [`StudyError`] if there is no start, or threads cannot be started.
    pub fn run(&self) -> Result<ConditionResult, StudyError> {
        let Self { study, condition, .. } = self;
        let begin = Instant::now();
        // Each result with the computation time of its run, s.
        let results: Vec<(RunResult, f64)> = study.each(
            self.part,
            &study.indices,
            || Scratch::new(study.planner),
            |scratch, index| self.sample(scratch, index),
        )?;
        let completed = || results.iter().filter_map(|(s, _)| Some(&s.end.as_ref()?.motion));
        Ok(ConditionResult {
            condition: condition.name.clone(),
            purpose: condition.purpose.clone(),
            samples: results.len(),
            failures: results.iter().filter_map(|(s, _)| s.failure.clone()).fold(
                BTreeMap::new(),
                |mut n, kind| {
                    *n.entry(kind).or_default() += 1;
                    n
                },
            ),
            replans: results.iter().fold(ReplanCounts::default(), |mut sum, (s, _)| {
                sum += s.replans;
                sum
            }),
            succeeded: results.iter().filter(|(s, _)| s.failure.is_none()).count(),
            motion: MotionFigures::statistic(|figure| Spread::of(completed().map(figure))),
            times: RunTimes {
                run: Spread::of(results.iter().map(|(_, time)| *time)),
                total: begin.elapsed().as_secs_f64(),
            },
            results: results.into_iter().map(|(result, _)| result).collect(),
        })
    }

    /// Runs the swing-up from start number `index` and returns its telemetry, one record per cycle until its end or abort.
    ///
    /// # Errors
    /// [`NoStart`] if there is no start of this number.
    pub fn records(&self, index: u64) -> Result<Vec<Telemetry>, NoStart> {
        let mut scratch = Scratch::new(self.study.planner);
        // An abort is part of the study's result already.
        let _ = self.swing_up(&mut scratch, index, &self.study.starts.start(index)?);
        Ok(scratch.records)
    }

    fn sample(&self, scratch: &mut Scratch, index: u64) -> Result<(RunResult, f64), NoStart> {
        let begin = Instant::now();
        let start = self.study.starts.start(index)?;
        let (end, failure, reasons) = match self.swing_up(scratch, index, &start) {
            Ok(evaluation) => {
                let failure = (!evaluation.success).then(|| ENDED_BADLY.into());
                let end = RunFigures { t_f: evaluation.t_f, motion: evaluation.statistics.motion };
                (Some(end), failure, evaluation.failures)
            }
            Err(e) => (None, Some(e.kind()), vec![e.to_string()]),
        };
        let time = begin.elapsed().as_secs_f64();
        let result = RunResult {
            index,
            start: shown_pose(&self.study.starts.config.model, &start),
            end,
            failure,
            reasons,
            replans: scratch.replans,
        };
        Ok((result, time))
    }

    fn swing_up(
        &self,
        scratch: &mut Scratch,
        index: u64,
        start: &State,
    ) -> Result<SwingUpEvaluation, Aborted> {
        let Study { planner, starts, .. } = self.study;
        let plant = self.condition.plant(starts, index);
        let undisturbed = |_| Disturbances::default();
        let options = match self.contender {
            Some(contender) => contender.options(index, start).map_err(Aborted::NoPlanGiven)?,
            None => RunOptions::default(),
        };
        let (seconds, controller) = (self.seconds, planner.config());
        scratch.swing_up(planner, (index, start), controller, plant, seconds, undisturbed, options)
    }
}
