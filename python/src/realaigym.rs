//! Scores of the RealAIGym leaderboards for controllers of Python, and for ours.

use crate::array::{Input, output};
use crate::errors::{failed, input};
use crate::progress::{cancellable, interruptible};
use crate::simulation::of_json;
use crate::system::System;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use upswing_planner::replan::Planner;
use upswing_rig::realaigym::{
    Benchmark, Controller, DT, DoublePendulum, Performance, Pilot, State, Version, machine,
};

/// Weight r of the input in (6a) of our plans, s^4/rad^2.
const INPUT_WEIGHT: f64 = 0.01;

/// A system of the benchmark with the seed of its random numbers.
struct Board {
    pendulum: DoublePendulum,
    version: Version,
    seed: u64,
    /// Without a database, whose entries have another weight.
    planner: Planner,
}

impl Board {
    fn new(system: &System, version: Version, seed: u64) -> PyResult<Self> {
        let pendulum = DoublePendulum::new((*system.config).clone(), version, INPUT_WEIGHT).map_err(input)?;
        let planner = Planner::with_entries(pendulum.config.clone(), 0, String::new(), Vec::new());
        Ok(Self { pendulum, version, seed, planner: planner.map_err(failed)? })
    }

    fn benchmark(&self) -> Benchmark<'_> {
        Benchmark { pendulum: &self.pendulum, version: self.version, seed: self.seed }
    }
}

/// A controller of Python: torque of the motor for time and state.
struct PythonController<'a> {
    controller: Py<PyAny>,
    /// Index of the joint with the motor.
    joint: usize,
    /// The first exception, after which there is no torque.
    raised: &'a Mutex<Option<PyErr>>,
    stop: &'a AtomicBool,
}

impl<'a> PythonController<'a> {
    fn torque(&self, t: f64, x: &State) -> PyResult<f64> {
        Python::attach(|py| {
            let x = output(py, vec![4], x.to_vec())?;
            let tau: Input<'_> = self.controller.bind(py).call1((t, x))?.extract()?;
            match tau.numbers()[..] {
                [tau] if tau.is_finite() => Ok(tau),
                ref got => Err(input(format!("the controller: expected one finite torque, got {got:?}"))),
            }
        })
    }

    /// The controller of one simulation.
    fn simulation(self) -> Box<Controller<'a>> {
        let mut calls = 0_u32;
        Box::new(move |x| {
            let mut torques = [0.0; 2];
            if !self.stop.load(Ordering::Acquire) {
                match self.torque(f64::from(calls) * DT, x) {
                    Ok(tau) => torques[self.joint] = tau,
                    Err(e) => raise(self.raised, self.stop, e),
                }
            }
            calls += 1;
            torques
        })
    }
}

/// Keeps the first exception, and stops.
fn raise(raised: &Mutex<Option<PyErr>>, stop: &AtomicBool, e: PyErr) {
    stop.store(true, Ordering::Release);
    raised.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(e);
}

/// Which scores there are.
fn version_of(score: &str) -> PyResult<Version> {
    match score {
        "performance" | "robustness" | "uptime" => Ok(Version::Two),
        "robustness-1" => Ok(Version::One),
        got => Err(input(format!(
            "`score`: expected \"performance\", \"robustness\", \"robustness-1\" or \"uptime\", got {got:?}"
        ))),
    }
}

/// Score of the RealAIGym leaderboards of the systems `acrobot` and `pendubot`, as `bench/realaigym/run` computes it, with its criteria.
///
/// `score`: "performance" or "robustness" (version 2), "robustness-1" (version 1), "uptime" (version 3). `controller()` makes the controller of one
/// simulation: a function of the time (s, counted in its calls) and the measured state [q1, q2, qd1, qd2] (4,), rad and rad/s, shoulder and elbow, which
/// hang at 0, that is called every 2 ms and returns the torque of the motor, N m, which is cut to 6. `None`: ours, the daemon with one plan,
/// which has no uptime. Robustness takes 720 simulations of 10 s: ours several minutes. `progress(done, total)` is called
/// about every 0.1 s. The result has "score" and the criteria.
#[pyfunction]
#[pyo3(signature = (system, score, controller = None, *, seed = 0, progress = None))]
pub fn realaigym<'py>(
    py: Python<'py>,
    system: &System,
    score: &str,
    controller: Option<Py<PyAny>>,
    seed: u64,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    if score == "uptime" && controller.is_none() {
        return Err(input("`controller`: expected one for \"uptime\": ours plans once in a simulation"));
    }
    let board = Board::new(system, version_of(score)?, seed)?;
    let benchmark = board.benchmark();
    let joint = board.pendulum.config.model.order().joint(0);
    let raised = Mutex::new(None);
    let stopped = AtomicBool::new(false);
    let dict = PyDict::new(py);
    match score {
        "performance" | "uptime" => {
            let made = controller.map(|make| make.call0(py)).transpose()?;
            let run = |stop: &dyn Fn() -> bool| -> Result<_, String> {
                let (raised, ended) = (&raised, &stopped);
                let mut chosen: Box<Controller<'_>> = match made {
                    Some(controller) => {
                        PythonController { controller, joint, raised, stop: ended }.simulation()
                    }
                    None => {
                        let mut pilot = Pilot::new(&board.planner)?;
                        Box::new(move |x| pilot.step(x))
                    }
                };
                // After an interrupt the rest is of no use.
                let mut controller = |x: &State| if stop() { [0.0; 2] } else { chosen(x) };
                Ok(match score {
                    "uptime" => (Some(benchmark.uptime(&mut controller).0), None),
                    _ => {
                        let motion = benchmark.fly(&mut controller, benchmark.nominal(), 0);
                        let machine = machine(benchmark.version, &board.pendulum.limits);
                        (None, Some(Performance::of(&motion, &machine)))
                    }
                })
            };
            let (uptime, performance) = cancellable(py, run)?.map_err(failed)?;
            if let Some(uptime) = uptime {
                dict.set_item("score", uptime.score())?;
                dict.update(of_json(py, &uptime)?.cast::<PyDict>()?.as_mapping())?;
            }
            if let Some(performance) = performance {
                dict.set_item("score", performance.score())?;
                dict.update(of_json(py, &performance)?.cast::<PyDict>()?.as_mapping())?;
            }
        }
        _ => {
            let result = interruptible(py, progress.as_ref(), benchmark.simulations(), |stop, done| {
                let pilot = match &controller {
                    None => Some(Pilot::new(&board.planner)?),
                    Some(_) => None,
                };
                let new = || -> Box<Controller<'_>> {
                    match (&pilot, &controller) {
                        (Some(pilot), _) => {
                            let mut pilot = pilot.clone();
                            Box::new(move |x| pilot.step(x))
                        }
                        (None, Some(make)) => match Python::attach(|py| make.call0(py)) {
                            Ok(controller) => {
                                PythonController { controller, joint, raised: &raised, stop }.simulation()
                            }
                            // As one that raises.
                            Err(e) => {
                                raise(&raised, stop, e);
                                Box::new(|_| [0.0; 2])
                            }
                        },
                        (None, None) => Box::new(|_| [0.0; 2]),
                    }
                };
                let count = || {
                    done.fetch_add(1, Ordering::Relaxed);
                };
                Ok::<_, String>(benchmark.robustness(&new, stop, &count))
            })?;
            if let Some(result) = result.map_err(failed)? {
                dict.set_item("score", result.score())?;
                dict.set_item(
                    "categories",
                    PyDict::from_sequence(result.categories().into_pyobject(py)?.as_any())?,
                )?;
                dict.set_item("quantities", of_json(py, &result.quantities)?)?;
            }
        }
    }
    match raised.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(e) => Err(e),
        None => Ok(dict),
    }
}
