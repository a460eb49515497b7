//! A fixed benchmark: the same starts, plants and criteria for every planner and controller, and a table of the results for a paper.

use crate::montecarlo::closed_loop::{ConditionResult, ConditionStudy, RunResult};
use crate::montecarlo::condition::PlantCondition;
use crate::montecarlo::contender::Contender;
use crate::montecarlo::{NoStart, RandomStarts, Spread, Study, StudyError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use upswing_config::{Config, ConfigError, read_file};
use upswing_model::State;
use upswing_planner::replan::Planner;
use upswing_record::evaluation::MotionFigures;

/// Starts and conditions of runs of the first manoeuvre of a system, and the time at its end. A file of it is this as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Benchmark {
    /// Name of the shipped system, or its folder.
    pub system: String,
    /// Fingerprint of the dynamics, 16 hexadecimal digits.
    pub model: String,
    /// Names of the actuated joints.
    pub actuated: Vec<String>,
    /// Seed of the starts and of random conditions: those of `upswing montecarlo`.
    pub seed: u64,
    /// Positions of the actuated joints at the starts, rad or m; the others hang at rest.
    pub starts: Vec<Vec<f64>>,
    /// Conditions, as of `upswing montecarlo closed-loop`.
    pub conditions: Vec<String>,
    /// Time at the end of the plan, s; success is judged in the last second.
    pub seconds: f64,
}

/// Error of a benchmark.
#[derive(Debug, thiserror::Error)]
pub enum BenchmarkError {
    /// The file cannot be read.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Cause.
        cause: std::io::Error,
    },
    /// The file is no benchmark.
    #[error("{}: {cause}; expected a file that `upswing bench export` writes", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Cause.
        cause: serde_json::Error,
    },
    /// The model is another one.
    #[error("expected the model {expected} of {system}, got {got}; export the benchmark anew")]
    Model {
        /// Name of the system.
        system: String,
        /// Fingerprint in the benchmark.
        expected: String,
        /// Fingerprint of the settings.
        got: String,
    },
    /// A start is not that of the seed.
    #[error("expected start {index} of seed {seed}, got another one; export the benchmark anew")]
    Start {
        /// Number of the start.
        index: usize,
        /// Seed of the benchmark.
        seed: u64,
    },
    /// A number is outside its range.
    #[error("`{name}`: expected {expected}, got {got}")]
    Range {
        /// Name of the number.
        name: &'static str,
        /// Its range.
        expected: &'static str,
        /// Its value.
        got: f64,
    },
    /// A condition cannot be used.
    #[error(transparent)]
    Condition(#[from] ConfigError),
    /// The ranges of the grid hold no start.
    #[error(transparent)]
    NoStart(#[from] NoStart),
    /// The runs could not be made.
    #[error(transparent)]
    Study(#[from] StudyError),
}

impl Benchmark {
    /// The benchmark of a system with the first starts of `upswing montecarlo` with this seed.
    ///
    /// # Errors
    /// [`BenchmarkError`] if a number is outside its range, a condition is unknown, or there is no start.
    pub fn new(
        config: &Config,
        samples: u64,
        seed: u64,
        conditions: Vec<String>,
        seconds: f64,
    ) -> Result<Self, BenchmarkError> {
        let starts = RandomStarts { config, seed };
        let benchmark = Self {
            system: config.system().to_string(),
            model: fingerprint(config),
            actuated: actuated(config),
            seed,
            starts: (0..samples).map(|i| Ok(pose(&starts.start(i)?))).collect::<Result<_, NoStart>>()?,
            conditions,
            seconds,
        };
        benchmark.conditions(config)?;
        Ok(benchmark)
    }

    /// Reads a file; [`Self::check`] compares it with the settings of its system.
    ///
    /// # Errors
    /// [`BenchmarkError`] if it cannot be read, or is no benchmark.
    pub fn read(path: &Path) -> Result<Self, BenchmarkError> {
        let text = read_file(path).map_err(|cause| BenchmarkError::Io { path: path.to_owned(), cause })?;
        serde_json::from_slice(&text).map_err(|cause| BenchmarkError::File { path: path.to_owned(), cause })
    }

    /// Fails unless the starts are those of these settings.
    ///
    /// # Errors
    /// [`BenchmarkError`]
    pub fn check(&self, config: &Config) -> Result<(), BenchmarkError> {
        let got = fingerprint(config);
        if got != self.model || actuated(config) != self.actuated {
            let (system, expected) = (self.system.clone(), self.model.clone());
            return Err(BenchmarkError::Model { system, expected, got });
        }
        let seed = self.seed;
        let starts = RandomStarts { config, seed };
        for (index, start) in self.starts.iter().enumerate() {
            if *start != pose(&starts.start(index as u64)?) {
                return Err(BenchmarkError::Start { index, seed });
            }
        }
        self.conditions(config).map(drop)
    }

    /// The plants of the conditions.
    fn conditions(&self, config: &Config) -> Result<Vec<PlantCondition>, BenchmarkError> {
        if !(1..=100_000).contains(&self.starts.len()) {
            let (name, got) = ("samples", self.starts.len() as f64);
            return Err(BenchmarkError::Range { name, expected: "1 to 100000", got });
        }
        if !(2.0..=600.0).contains(&self.seconds) {
            let (name, got) = ("seconds", self.seconds);
            return Err(BenchmarkError::Range { name, expected: "2 to 600", got });
        }
        Ok(self.conditions.iter().map(|name| PlantCondition::new(name, config)).collect::<Result<_, _>>()?)
    }

    /// Number of runs.
    pub fn runs(&self) -> usize {
        self.starts.len() * self.conditions.len()
    }

    /// Runs every start under every condition, with the plans and the controller of `contender` or, without it, those of planner and daemon.
    /// `progress` is called after each run; setting `stop` ends the benchmark after the runs in progress.
    ///
    /// # Errors
    /// [`BenchmarkError`] if the benchmark is not one of the settings of `planner`.
    pub fn score(
        &self,
        name: &str,
        planner: &Planner,
        contender: Option<&dyn Contender>,
        threads: usize,
        stop: &AtomicBool,
        progress: &(dyn Fn() + Sync),
    ) -> Result<Score, BenchmarkError> {
        let config = planner.config();
        self.check(config)?;
        let study = Study {
            planner,
            starts: RandomStarts { config, seed: self.seed },
            indices: (0..self.starts.len() as u64).collect(),
            runs: None,
            threads,
            stop,
            progress,
        };
        let conditions = self.conditions(config)?;
        let seconds = self.seconds;
        let score = |(part, condition): (usize, &PlantCondition)| {
            let study = ConditionStudy { study: &study, part, condition, seconds, contender };
            Ok(ConditionScore::of(study.run()?))
        };
        let conditions = conditions.iter().enumerate().map(score).collect::<Result<_, BenchmarkError>>()?;
        let (system, model) = (self.system.clone(), self.model.clone());
        Ok(Score { name: name.to_owned(), system, model, seed: self.seed, seconds, conditions })
    }
}

/// Fingerprint of the dynamics of planner and controller.
fn fingerprint(config: &Config) -> String {
    format!("{:016x}", config.model.fingerprint())
}

fn actuated(config: &Config) -> Vec<String> {
    let model = &config.model;
    (0..model.sizes().actuated()).map(|i| model.joint_name(i).to_owned()).collect()
}

/// Positions of the actuated joints, rad or m.
fn pose(x: &State) -> Vec<f64> {
    x.q_a().to_vec()
}

/// The runs of one planner and controller.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Score {
    /// Name of planner and controller.
    pub name: String,
    /// Name of the shipped system, or its folder.
    pub system: String,
    /// Fingerprint of the dynamics.
    pub model: String,
    /// Seed of the starts.
    pub seed: u64,
    /// Time at the end of the plan, s.
    pub seconds: f64,
    /// Results under each condition.
    pub conditions: Vec<ConditionScore>,
}

/// The runs of one planner and controller under one condition. Medians are over the successful runs; `None` without any.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ConditionScore {
    /// Name of the condition.
    pub condition: String,
    /// Number of runs.
    pub samples: usize,
    /// Number of runs in which the system stayed at the end of the plan within all limits.
    pub succeeded: usize,
    /// Number of failures of each kind.
    pub failures: BTreeMap<String, usize>,
    /// Median duration of the plans t_F, s.
    pub t_f: Option<f64>,
    /// Medians of the figures of the motion.
    #[serde(flatten)]
    pub motion: MotionFigures<Option<f64>>,
    /// Each run, in the order of the starts.
    pub results: Vec<RunResult>,
}

impl ConditionScore {
    fn of(result: ConditionResult) -> Self {
        let ConditionResult { condition, samples, succeeded, failures, results, .. } = result;
        let successful =
            || results.iter().filter(|run| run.failure.is_none()).filter_map(|run| run.end.as_ref());
        let median = |values: &mut dyn Iterator<Item = f64>| Spread::of(values).map(|spread| spread.median);
        let t_f = median(&mut successful().map(|end| end.t_f));
        let motion =
            MotionFigures::statistic(|figure| median(&mut successful().map(|end| figure(&end.motion))));
        Self { condition, samples, succeeded, failures, t_f, motion, results }
    }
}

/// A table in Markdown: success, and medians over the successful runs.
pub fn table(scores: &[Score]) -> String {
    let mut text = "| planner and controller | condition | success | t_F, s | tracking, unactuated, rad | torque, % of limit | final error, deg |\n\
                    |---|---|---|---|---|---|---|"
        .to_owned();
    let number = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    for score in scores {
        for c in &score.conditions {
            let ConditionScore { condition, succeeded, samples, t_f, motion, .. } = c;
            let (tracking, torque) = (motion.tracking_error_pendulum, motion.peak_torque);
            // A String takes everything.
            let _ = write!(
                text,
                "\n| {} | {condition} | {succeeded} of {samples} | {} | {} | {} | {} |",
                score.name,
                number(*t_f, 3),
                number(tracking, 4),
                number(torque.map(|share| 100.0 * share), 0),
                number(motion.final_error_deg, 3),
            );
        }
    }
    text
}
