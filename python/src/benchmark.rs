//! The fixed benchmark with plans and controllers of Python.

use crate::array::{Output, output};
use crate::errors::{UpswingError, failed, input};
use crate::planning::{Plan, Planner};
use crate::progress::interruptible;
use crate::simulation::{call_controller, of_json};
use crate::system::System;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use upswing_config::Config;
use upswing_ipc::Telemetry;
use upswing_model::State;
use upswing_process::output::Overwrite;
use upswing_rig::benchmark::{Benchmark as Runs, BenchmarkError, Score as Scores, table};
use upswing_rig::closed_loop::RunOptions;
use upswing_rig::montecarlo::contender::Contender;

/// Plans and controllers that functions of Python make.
struct PythonContender<'a> {
    planner: &'a Planner,
    config: Arc<Config>,
    plan: Option<&'a Py<PyAny>>,
    controller: Option<&'a Py<PyAny>>,
    /// The first exception that is no failure of a run.
    raised: Mutex<Option<PyErr>>,
    stop: &'a AtomicBool,
}

impl PythonContender<'_> {
    /// The text of a failure of the run. Other exceptions end the benchmark.
    fn text(&self, py: Python<'_>, e: PyErr) -> String {
        let text = e.value(py).to_string();
        if !e.is_instance_of::<UpswingError>(py) {
            self.stop.store(true, Ordering::Release);
            let mut raised = self.raised.lock().unwrap_or_else(PoisonError::into_inner);
            raised.get_or_insert(e);
        }
        text
    }

    fn plan(&self, py: Python<'_>, start: &State) -> PyResult<Py<Plan>> {
        match self.plan {
            None => Py::new(py, self.planner.plan_from(py, start)?),
            Some(plan) => {
                let q_a = start.q_a().to_vec();
                let plan = plan.call1(py, (output(py, vec![q_a.len()], q_a)?,))?;
                Ok(plan.extract::<Py<Plan>>(py)?)
            }
        }
    }
}

impl Contender for PythonContender<'_> {
    fn options(&self, _: u64, start: &State) -> Result<RunOptions<'_>, String> {
        Python::attach(|py| {
            let plan = self.plan(py, start).map_err(|e| self.text(py, e))?;
            let reference = plan.get().reference.clone();
            let Some(make) = self.controller else {
                return Ok(RunOptions { plan: Some(reference), ..RunOptions::default() });
            };
            let controller = make.call1(py, (plan,)).map_err(|e| self.text(py, e))?;
            let torque = move |cycle: &Telemetry| {
                Python::attach(|py| {
                    call_controller(controller.bind(py), &self.config, cycle).map_err(|e| self.text(py, e))
                })
            };
            let controller: Box<upswing_rig::closed_loop::OtherController<'_>> = Box::new(torque);
            Ok(RunOptions { plan: Some(reference), controller: Some(controller), ..RunOptions::default() })
        })
    }
}

/// What happens during the runs is `UpswingError`, the rest `InputError`.
fn error(e: BenchmarkError) -> PyErr {
    match e {
        BenchmarkError::Study(e) => failed(e),
        e => input(e),
    }
}

/// Starts and conditions of runs of the first manoeuvre of a system, and the time at its end, as `upswing bench export` writes them.
///
/// The first starts of `upswing montecarlo` with this seed; `conditions` as of `monte_carlo`; success is judged in the last of the `seconds`.
#[pyclass(frozen, module = "upswing")]
pub struct Benchmark {
    /// The system of planner and controller.
    #[pyo3(get)]
    system: Py<System>,
    runs: Runs,
}

#[pymethods]
impl Benchmark {
    #[new]
    #[pyo3(signature = (system, samples = 20, *, seed = 0, conditions = None, seconds = 4.0))]
    fn new(
        py: Python<'_>,
        system: Bound<'_, System>,
        samples: u64,
        seed: u64,
        conditions: Option<Vec<String>>,
        seconds: f64,
    ) -> PyResult<Self> {
        let conditions = conditions.unwrap_or_else(|| vec!["nominal".into(), "everyday".into()]);
        let config = &system.get().config;
        let runs = py.detach(|| Runs::new(config, samples, seed, conditions, seconds)).map_err(error)?;
        Ok(Self { system: system.unbind(), runs })
    }

    /// Reads a file of `export`. Raises `InputError` if it is none, or of another model or other settings.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let named = |e: BenchmarkError| input(format!("{}: {e}", path.display()));
        let runs = Runs::read(&path).map_err(error)?;
        let system = System::load(py, Some(PathBuf::from(&runs.system)))?;
        runs.check(&system.config).map_err(named)?;
        Ok(Self { system: Py::new(py, system)?, runs })
    }

    /// Writes the benchmark as JSON with all digits, which `upswing bench score` reads. The file is replaced if it exists.
    fn export(&self, path: PathBuf) -> PyResult<()> {
        let write = || -> Result<(), Box<dyn std::error::Error>> {
            let output = Overwrite { force: true }.output(&path);
            let mut file = output.begin()?;
            serde_json::to_writer_pretty(&mut file, &self.runs)?;
            file.finish()?;
            Ok(())
        };
        write().map_err(failed)
    }

    /// Positions of the actuated joints at the starts, (samples, n_A), rad or m; the others hang at rest.
    #[getter]
    fn starts<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let width = self.runs.starts.first().map_or(0, Vec::len);
        output(py, vec![self.runs.starts.len(), width], self.runs.starts.concat())
    }

    /// Names of the conditions.
    #[getter]
    fn conditions(&self) -> Vec<String> {
        self.runs.conditions.clone()
    }

    /// Seed of starts and random conditions.
    #[getter]
    fn seed(&self) -> u64 {
        self.runs.seed
    }

    /// Time at the end of the plan, s.
    #[getter]
    fn seconds(&self) -> f64 {
        self.runs.seconds
    }

    /// Runs every start under every condition.
    ///
    /// `plan(q_a)` gives the `Plan` for a start in place of `planner`'s, and `controller(plan)` a controller, as `ClosedLoop.run` takes it, in place
    /// of ours. An `UpswingError` of theirs is a run that has failed; other exceptions end the benchmark. `progress(done, total)` is called about
    /// every 0.1 s.
    #[pyo3(signature = (name, planner, *, plan = None, controller = None, threads = None, progress = None))]
    fn score(
        &self,
        py: Python<'_>,
        name: &str,
        planner: &Planner,
        plan: Option<Py<PyAny>>,
        controller: Option<Py<PyAny>>,
        threads: Option<usize>,
        progress: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Score> {
        let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = threads.unwrap_or_else(cores);
        if !(1..=1024).contains(&threads) {
            return Err(input(format!("`threads`: expected 1 to 1024, got {threads}")));
        }
        let (score, raised) = interruptible(py, progress.as_ref(), self.runs.runs(), |stop, done| {
            let contender = PythonContender {
                planner,
                config: planner.config.clone(),
                plan: plan.as_ref(),
                controller: controller.as_ref(),
                raised: Mutex::default(),
                stop,
            };
            let given = plan.is_some() || controller.is_some();
            let given = given.then_some(&contender as &dyn Contender);
            let count = || {
                done.fetch_add(1, Ordering::Relaxed);
            };
            let score = self.runs.score(name, &planner.planner, given, threads, stop, &count);
            (score, contender.raised.into_inner().unwrap_or_else(PoisonError::into_inner))
        })?;
        match raised {
            Some(e) => Err(e),
            None => Ok(Score { score: score.map_err(error)? }),
        }
    }

    fn __repr__(&self) -> String {
        let Runs { system, starts, conditions, .. } = &self.runs;
        format!("<upswing.Benchmark of {system}, {} starts under {}>", starts.len(), conditions.join(", "))
    }
}

/// The runs of one planner and controller in a benchmark.
#[pyclass(frozen, module = "upswing")]
pub struct Score {
    score: Scores,
}

#[pymethods]
impl Score {
    /// Name of planner and controller.
    #[getter]
    fn name(&self) -> &str {
        &self.score.name
    }

    /// Results under each condition, as `upswing bench score --json` prints them: condition, samples, succeeded, failures, medians t_f and figures of the
    /// motion over the successful runs, results of each run.
    #[getter]
    fn conditions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        of_json(py, &self.score.conditions)
    }

    /// All runs as JSON, the document of `upswing bench score --json`.
    fn to_json(&self) -> PyResult<String> {
        serde_json::to_string(&self.score).map_err(failed)
    }

    /// The score of such a document.
    #[staticmethod]
    fn of_json(text: &str) -> PyResult<Self> {
        let score = serde_json::from_str(text).map_err(|e| input(format!("`text`: {e}")))?;
        Ok(Self { score })
    }

    fn __repr__(&self) -> String {
        let each = self.score.conditions.iter();
        let each: Vec<_> =
            each.map(|c| format!("{} {} of {}", c.condition, c.succeeded, c.samples)).collect();
        format!("<upswing.Score of {}: {}>", self.score.name, each.join(", "))
    }
}

/// A table of scores in Markdown, as `upswing bench score` prints it: success, and medians over the successful runs.
#[pyfunction]
pub fn score_table(scores: Vec<PyRef<'_, Score>>) -> String {
    table(&scores.iter().map(|score| score.score.clone()).collect::<Vec<_>>())
}
