//! The simulated plant alone, and the closed loop of controller and plant in one process.

use crate::array::{Input, Output, output};
use crate::chain;
use crate::errors::{aborted, failed, input, of_failure};
use crate::planning::{Plan, Planner};
use crate::progress::{cancellable, interruptible};
use crate::recording;
use crate::system::System;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::cell::RefCell;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use upswing_config::{Config, Fault, FaultKind, PendulumStart, Push};
use upswing_ipc::{Command, PlanMessage, Telemetry};
use upswing_model::{ActuatedVector, State, Workspace};
use upswing_plant::Plant as Simulation;
use upswing_record::Recorder;
use upswing_record::Window;
use upswing_record::evaluation::SwingUpEvaluation;
use upswing_rig::closed_loop::{Aborted, ClosedLoop as Loop, Disturbances, RunOptions, swing_up};
use upswing_rig::montecarlo::closed_loop::ConditionStudy;
use upswing_rig::montecarlo::condition::PlantCondition;
use upswing_rig::montecarlo::contender::Contender;
use upswing_rig::montecarlo::{RandomStarts, Study};
use upswing_trajectory::Plan as Reference;
use upswingd::plan::accept;
use upswingd::step::StepRequest;

/// A push of an argument: time (s) after the start of the plan, impulse (N s, world frame), duration (s).
type PushArgument = (f64, [f64; 3], f64);

/// The push that begins `at` (s) after cycle `now`.
fn push_at(config: &Config, now: u64, (at, impulse, duration): PushArgument) -> PyResult<Push> {
    let period = config.daemon.cycle.period.seconds();
    if !(at >= 0.0 && at.is_finite() && duration >= 0.0 && duration.is_finite()) {
        return Err(input(format!("push: expected times of 0 s or more, got {at} s and {duration} s")));
    }
    let cycles = |seconds: f64| (seconds / period).round() as u64;
    let push = Push { from: now + cycles(at), cycles: cycles(duration).max(1), impulse };
    push.check().map_err(|e| input(format!("push: {e}"))).map(|()| push)
}

/// The fault of the arguments.
fn fault_of(
    config: &Config,
    kind: &str,
    from: u64,
    cycles: u64,
    (joint, amount): (Option<&str>, f64),
) -> PyResult<Fault> {
    let known = || FaultKind::all().iter().map(|kind| format!("{kind:?}")).collect::<Vec<_>>().join(", ");
    let same = |of: &&FaultKind| format!("{of:?}").eq_ignore_ascii_case(&kind.replace(['-', '_'], ""));
    let kind = FaultKind::all().iter().find(same).copied();
    let kind = kind.ok_or_else(|| input(format!("`kind`: expected one of {}", known())))?;
    let joint = kind.joint(joint, &config.model).map_err(input)?;
    let fault = Fault { kind, from, cycles, joint, amount };
    fault.check(config.model.sizes()).map_err(input).map(|()| fault)
}

/// A plant in the state of the argument `start`: all positions and velocities, or those of the actuated joints with the others at rest; the
/// start of the settings without one.
fn plant_at(config: &Config, start: Option<&Input<'_>>) -> PyResult<Simulation> {
    let (sizes, order) = (config.model.sizes(), config.model.order());
    let plant = match start {
        None => Simulation::new(config),
        Some(start) if start.shape() == [sizes.actuated()] => {
            let mut config = config.clone();
            config.plant.start.q = chain::actuated(order, &start.numbers());
            config.plant.start.pendulum = PendulumStart::Rest;
            Simulation::new(&config)
        }
        Some(start) => {
            let of = "positions and velocities of all joints";
            let x = chain::state(order, &start.vector("start", sizes.state(), of)?);
            Simulation::at(config, &x.q(), &x.qd())
        }
    };
    plant.map_err(|e| input(format!("`start`: {e}")))
}

/// The true state of a plant, [q, qd] in the chain's order.
fn true_state(plant: &Simulation) -> State {
    State::new(plant.position(), plant.velocity())
}

/// The simulated robot with drives, encoders and friction, without a controller.
///
/// At a state (2n,), or with the actuated joints at (n_A,) and the others at rest; `None`: the start of the settings.
#[pyclass(module = "upswing")]
pub struct Plant {
    config: Arc<Config>,
    plant: Simulation,
    work: Workspace,
}

impl Plant {
    /// Advances by `cycles` periods under torques, or under those of the torque law (24) for accelerations.
    fn advance(&mut self, action: &ActuatedVector, is_torque: bool, cycles: u32) {
        for _ in 0..cycles {
            let tau = match is_torque {
                true => *action,
                false => self.config.model.torque(&true_state(&self.plant), action, &mut self.work),
            };
            self.plant.step(Some(&Command::new(&tau)));
        }
    }
}

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (system, start = None))]
    fn new(system: &System, start: Option<Input<'_>>) -> PyResult<Self> {
        let config = system.config.clone();
        Ok(Self { plant: plant_at(&config, start.as_ref())?, config, work: Workspace::default() })
    }

    /// Advances by control periods under constant torques (n_A,), which the drives cut to their limits.
    #[pyo3(signature = (tau, cycles = 1))]
    fn step(&mut self, py: Python<'_>, tau: Input<'_>, cycles: u32) -> PyResult<()> {
        let sizes = self.config.model.sizes();
        let tau = tau.vector("tau", sizes.actuated(), "torques of the actuated joints")?;
        let tau = chain::actuated(self.config.model.order(), &tau);
        py.detach(|| self.advance(&tau, true, cycles));
        Ok(())
    }

    /// Advances under the torque law (24) for accelerations u (n_A,), computed in each period from the true state.
    #[pyo3(signature = (u, cycles = 1))]
    fn step_acceleration(&mut self, py: Python<'_>, u: Input<'_>, cycles: u32) -> PyResult<()> {
        let sizes = self.config.model.sizes();
        let u = u.vector("u", sizes.actuated(), "accelerations of the actuated joints")?;
        let u = chain::actuated(self.config.model.order(), &u);
        py.detach(|| self.advance(&u, false, cycles));
        Ok(())
    }

    /// True state, (2n,). Setting it begins anew, with closed brakes.
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let x = chain::state_in_chain(self.config.model.order(), &true_state(&self.plant));
        output(py, vec![x.len()], x)
    }

    #[setter]
    fn set_x(&mut self, x: Input<'_>) -> PyResult<()> {
        self.plant = plant_at(&self.config, Some(&x))?;
        Ok(())
    }

    /// Simulated time, s.
    #[getter]
    fn t(&self) -> f64 {
        self.plant.completed() as f64 * self.config.daemon.cycle.period.seconds()
    }

    /// Measurement of the present cycle: seq, t (s), q (n,), tau (n_A,), status.
    fn measure<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (measurement, sizes) = (self.plant.measure(), self.config.model.sizes());
        let dict = PyDict::new(py);
        dict.set_item("seq", measurement.seq)?;
        dict.set_item("t", measurement.t_ns as f64 * 1e-9)?;
        let q = measurement.q[..sizes.joints()].to_vec();
        dict.set_item("q", output(py, vec![q.len()], q)?)?;
        let tau = measurement.tau_measured[..sizes.actuated()].to_vec();
        dict.set_item("tau", output(py, vec![tau.len()], tau)?)?;
        dict.set_item("status", measurement.status)?;
        Ok(dict)
    }

    /// Whether the drives have failed, after a torque that is not finite.
    #[getter]
    fn drive_fault(&self) -> bool {
        self.plant.drive_fault()
    }

    /// Pushes the tip of the rod: impulse (3,), N s, world frame; duration and delay in s.
    #[pyo3(signature = (impulse, duration = 0.01, delay = 0.0))]
    fn push(&mut self, impulse: [f64; 3], duration: f64, delay: f64) -> PyResult<()> {
        let push = push_at(&self.config, self.plant.seq(), (delay, impulse, duration))?;
        self.plant.push(&push).map_err(|e| input(format!("push: {e}")))
    }
}

/// Plants of one system that advance side by side on all cores.
///
/// All at the start of the settings.
#[pyclass(module = "upswing")]
pub struct Plants {
    config: Arc<Config>,
    plants: Vec<Plant>,
}

#[pymethods]
impl Plants {
    #[new]
    fn new(system: &System, count: usize) -> PyResult<Self> {
        if !(1..=100_000).contains(&count) {
            return Err(input(format!("`count`: expected 1 to 100000, got {count}")));
        }
        let config = system.config.clone();
        let plant = plant_at(&config, None)?;
        let one = || Plant { config: config.clone(), plant: plant.clone(), work: Workspace::default() };
        Ok(Self { plants: std::iter::repeat_with(one).take(count).collect(), config })
    }

    /// Puts one plant at a state (2n,).
    fn put(&mut self, number: usize, x: Input<'_>) -> PyResult<()> {
        let count = self.plants.len();
        let plant = self.plants.get_mut(number);
        plant.ok_or_else(|| input(format!("`number`: expected below {count}, got {number}")))?.set_x(x)
    }

    /// Advances all by control periods under torques, or accelerations, (count, n_A); returns the true states (count, 2n).
    #[pyo3(signature = (actions, cycles = 1, acceleration = false))]
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        actions: Input<'py>,
        cycles: u32,
        acceleration: bool,
    ) -> PyResult<Output<'py>> {
        let (sizes, order) = (self.config.model.sizes(), *self.config.model.order());
        let actions = actions.vectors("actions", sizes.actuated(), "one number per actuated joint")?;
        if actions.lead != [self.plants.len()] {
            let count = self.plants.len();
            return Err(input(format!("`actions`: expected {count} rows, got {:?}", actions.lead)));
        }
        let plants = &mut self.plants;
        py.detach(|| {
            plants.par_iter_mut().enumerate().for_each(|(i, plant)| {
                plant.advance(&chain::actuated(&order, actions.get(i)), !acceleration, cycles);
            });
        });
        self.x(py)
    }

    /// True states, (count, 2n).
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let order = self.config.model.order();
        let rows =
            self.plants.iter().flat_map(|plant| chain::state_in_chain(order, &true_state(&plant.plant)));
        output(py, vec![self.plants.len(), order.sizes().state()], rows.collect())
    }

    /// Whether the drives of each plant have failed.
    #[getter]
    fn drive_faults(&self) -> Vec<bool> {
        self.plants.iter().map(|plant| plant.plant.drive_fault()).collect()
    }

    fn __len__(&self) -> usize {
        self.plants.len()
    }
}

/// Controller and plant in one process, bit for bit as the three processes on the clock `lockstep`.
///
/// `start` as for `Plant`. `plant`: a system with another plant, as of `with_scenario`. `seed` of the encoders' noise.
#[pyclass(module = "upswing")]
pub struct ClosedLoop {
    planner: Py<Planner>,
    /// Settings of the controller.
    config: Arc<Config>,
    /// Settings of the plant.
    plant: Arc<Config>,
    start: Simulation,
    system: Loop,
    records: Vec<Telemetry>,
}

impl ClosedLoop {
    /// One cycle with a request.
    fn request(&mut self, request: StepRequest) -> PyResult<()> {
        let name = request.name();
        let mut request = Some(request);
        let output = (0..1000).find_map(|_| self.system.cycle(&mut request));
        let output = output.ok_or_else(|| failed("no new measurement in 1000 cycles"))?;
        self.records.push(output.record.telemetry);
        match output.answer {
            Some(Err(refusal)) => {
                Err(failed(format!("{name} was refused: {}", refusal.text(&self.config.model))))
            }
            _ => Ok(()),
        }
    }
}

#[pymethods]
impl ClosedLoop {
    #[new]
    #[pyo3(signature = (planner, start = None, *, plant = None, seed = 0))]
    fn new(
        planner: Bound<'_, Planner>,
        start: Option<Input<'_>>,
        plant: Option<&System>,
        seed: u64,
    ) -> PyResult<Self> {
        let config = planner.get().config.clone();
        let plant = plant.map_or_else(|| config.clone(), |plant| plant.config.clone());
        if plant.model.order() != config.model.order() {
            return Err(input("`plant`: expected a system with the joints of the planner's"));
        }
        let mut seeded = (*plant).clone();
        seeded.plant.encoder.seed = seeded.plant.encoder.seed.wrapping_add(seed);
        let start = plant_at(&seeded, start.as_ref())?;
        Ok(Self {
            planner: planner.unbind(),
            system: Loop::new(&config, start.clone()),
            config,
            plant: Arc::new(seeded),
            start,
            records: Vec::new(),
        })
    }

    /// Holds the arm, executes the first manoeuvre from the start, stays at its end for `seconds`, and evaluates the run.
    ///
    /// `plan`: your own instead of the planner's. `controller(t, x, x_d, u_d)`: your own, called in each cycle after the start of the plan
    /// with the time (s), the estimated state (2n,), and the reference; it returns the torques (n_A,), which are cut to the limits. Our
    /// controller estimates the velocities and monitors all limits meanwhile: a run that exceeds one ends, as ours would.
    /// `pushes`: (time after the start of the plan in s, impulse (3,) in N s, duration in s).
    /// Raises `Aborted` if the run cannot begin, and what the controller raises.
    #[pyo3(signature = (seconds = 4.0, *, plan = None, controller = None, pushes = Vec::new()))]
    fn run(
        &self,
        py: Python<'_>,
        seconds: f64,
        plan: Option<&Plan>,
        controller: Option<Bound<'_, PyAny>>,
        pushes: Vec<PushArgument>,
    ) -> PyResult<Run> {
        if !(2.0..=600.0).contains(&seconds) {
            return Err(input(format!("`seconds`: expected 2 to 600, got {seconds}")));
        }
        let config = &self.config;
        let pushes: Vec<Push> =
            pushes.into_iter().map(|push| push_at(config, 0, push)).collect::<PyResult<_>>()?;
        let disturbances = |_: f64| Disturbances { pushes, missed: Vec::new() };
        let planner = self.planner.bind(py).get();
        let plan = plan.map(|plan| plan.reference.clone());
        let mut records = Vec::new();
        let start = self.start.clone();
        let result = match controller {
            None => cancellable(py, |stop| {
                let options = RunOptions { plan, interrupted: Some(stop), ..RunOptions::default() };
                planner.with_solver(|solver| {
                    let planner = &planner.planner;
                    swing_up(planner, solver, config, start, seconds, disturbances, options, &mut records)
                })
            })?,
            Some(controller) => {
                let raised = RefCell::new(None);
                let torque = |cycle: &Telemetry| {
                    call_controller(&controller, config, cycle).map_err(|e| {
                        let text = e.to_string();
                        raised.replace(Some(e));
                        text
                    })
                };
                let options =
                    RunOptions { plan, controller: Some(Box::new(torque)), ..RunOptions::default() };
                let result = planner.with_solver(|solver| {
                    let planner = &planner.planner;
                    swing_up(planner, solver, config, start, seconds, disturbances, options, &mut records)
                });
                if let Some(e) = raised.into_inner() {
                    return Err(e);
                }
                result
            }
        };
        Run::new(config, records, result)
    }

    /// Releases the brakes and holds the arm. Raises `UpswingError` with the reason of a refusal, as the other requests.
    fn enable(&mut self) -> PyResult<()> {
        self.request(StepRequest::Enable)
    }

    /// Holds the present pose of the arm.
    fn hold(&mut self) -> PyResult<()> {
        self.request(StepRequest::Hold)
    }

    /// Decelerates the arm, then holds it.
    fn stop(&mut self) -> PyResult<()> {
        self.request(StepRequest::Stop)
    }

    /// Leaves Fault.
    fn reset(&mut self) -> PyResult<()> {
        self.request(StepRequest::Reset)
    }

    /// Loads and starts a plan, after the checks of the daemon. Raises `UpswingError` if it is refused.
    fn start(&mut self, plan: &Plan) -> PyResult<()> {
        let message = PlanMessage::new(&plan.reference, self.config.model.order());
        let plan = accept(&message, &self.config)
            .map_err(|e| failed(format!("the daemon refused the plan: {e}")))?;
        let id = plan.id;
        self.request(StepRequest::Load(plan))?;
        self.request(StepRequest::Start(id))
    }

    /// Lets time pass, cycle by cycle.
    fn advance(&mut self, py: Python<'_>, seconds: f64) -> PyResult<()> {
        let cycles = seconds / self.config.daemon.cycle.period.seconds();
        if !(0.0..1e9).contains(&cycles) {
            return Err(input(format!("`seconds`: expected 0 or more, got {seconds}")));
        }
        let cycles = cycles.round() as u64;
        let Self { system, records, .. } = self;
        cancellable(py, |stop| {
            for i in 0..cycles {
                if i % 1000 == 0 && stop() {
                    break;
                }
                if let Some(output) = system.cycle(&mut None) {
                    records.push(output.record.telemetry);
                }
            }
        })
    }

    /// Mode of the controller: idle, hold, track, balance, stop or fault.
    #[getter]
    fn mode(&self) -> String {
        self.system.controller.mode().to_string()
    }

    /// Why the controller left its mode, in words.
    #[getter]
    fn trip(&self) -> Option<String> {
        self.system.controller.trip().map(|trip| trip.text(&self.config.model))
    }

    /// Simulated time, s.
    #[getter]
    fn t(&self) -> f64 {
        self.system.plant.completed() as f64 * self.config.daemon.cycle.period.seconds()
    }

    /// State that the controller estimates, (2n,).
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let x = chain::state_in_chain(self.config.model.order(), self.system.controller.state());
        output(py, vec![x.len()], x)
    }

    /// State of the plant, (2n,).
    #[getter]
    fn true_x<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let x = chain::state_in_chain(self.config.model.order(), &true_state(&self.system.plant));
        output(py, vec![x.len()], x)
    }

    /// Pushes the tip of the rod, as `Plant.push`.
    #[pyo3(signature = (impulse, duration = 0.01, delay = 0.0))]
    fn push(&mut self, impulse: [f64; 3], duration: f64, delay: f64) -> PyResult<()> {
        let push = push_at(&self.config, self.system.plant.seq(), (delay, impulse, duration))?;
        self.system.plant.push(&push).map_err(|e| input(format!("push: {e}")))
    }

    /// Adds a fault of the plant, as `upswing disturb fault`; duration 0: until the end.
    #[pyo3(signature = (kind, joint = None, amount = 0.0, duration = 0.0))]
    fn fault(&mut self, kind: &str, joint: Option<&str>, amount: f64, duration: f64) -> PyResult<()> {
        let cycles = (duration / self.config.daemon.cycle.period.seconds()).round() as u64;
        let fault = fault_of(&self.config, kind, self.system.plant.seq(), cycles, (joint, amount))?;
        self.system.plant.set_fault(&fault).map_err(|e| input(format!("fault: {e}")))
    }

    /// Cycles so far, fields as in a recording.
    #[getter]
    fn records<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        recording::arrays(py, &self.records)
    }

    fn __repr__(&self) -> String {
        format!("<upswing.ClosedLoop of {} in {} at {:.3} s>", self.plant.system(), self.mode(), self.t())
    }
}

/// The torques of a controller of Python for the record of a cycle.
pub fn call_controller(
    controller: &Bound<'_, PyAny>,
    config: &Config,
    cycle: &Telemetry,
) -> PyResult<ActuatedVector> {
    let (py, order, sizes) = (controller.py(), config.model.order(), config.model.sizes());
    let joined = |a: &[f64], b: &[f64]| output(py, vec![sizes.state()], [a, b].concat());
    let x = joined(cycle.of_joints(&cycle.q), cycle.of_joints(&cycle.qd))?;
    let x_d = joined(cycle.of_joints(&cycle.q_d), cycle.of_joints(&cycle.qd_d))?;
    let u_d = output(py, vec![sizes.actuated()], cycle.of_actuated(&cycle.u_d).to_vec())?;
    let answer = controller.call1((cycle.t_plan, x, x_d, u_d))?;
    let tau: Input<'_> = answer.extract()?;
    let tau =
        tau.vector("the torque of the controller", sizes.actuated(), "one number per actuated joint")?;
    Ok(chain::actuated(order, &tau))
}

/// A run in closed loop.
#[pyclass(frozen, module = "upswing")]
pub struct Run {
    config: Arc<Config>,
    cycles: Vec<Telemetry>,
    evaluation: Option<SwingUpEvaluation>,
    aborted: Option<String>,
}

impl Run {
    fn new(
        config: &Arc<Config>,
        cycles: Vec<Telemetry>,
        result: Result<SwingUpEvaluation, Aborted>,
    ) -> PyResult<Self> {
        let (evaluation, aborted) = match result {
            Ok(evaluation) => (Some(evaluation), None),
            Err(e @ (Aborted::Start(_) | Aborted::NoPlan(_) | Aborted::Plan(_))) => {
                return Err(aborted(e));
            }
            Err(e) => (None, Some(e.to_string())),
        };
        Ok(Self { config: config.clone(), cycles, evaluation, aborted })
    }

    /// Writes the recording to a file that does not exist.
    fn record(&self, path: &std::path::Path) -> Result<(), upswing_process::Failure> {
        let mut recorder = Recorder::create(path, &self.config, [("clock", "lockstep".to_owned())])?;
        recorder.write(&self.cycles)?;
        recorder.finish()?;
        Ok(())
    }
}

#[pymethods]
impl Run {
    /// Whether the system stayed at the end of the plan within all limits.
    #[getter]
    fn success(&self) -> bool {
        self.evaluation.as_ref().is_some_and(|evaluation| evaluation.success)
    }

    /// Why the run ended early.
    #[getter]
    fn aborted(&self) -> Option<&str> {
        self.aborted.as_deref()
    }

    /// Criteria that were not met, as sentences.
    #[getter]
    fn failures(&self) -> Vec<String> {
        match &self.evaluation {
            Some(evaluation) => evaluation.failures.clone(),
            None => self.aborted.iter().cloned().collect(),
        }
    }

    /// Figures of the run, as `upswing demo --json` prints them; `None` if it ended early.
    #[getter]
    fn evaluation<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.evaluation.as_ref().map(|evaluation| of_json(py, evaluation)).transpose()
    }

    /// All cycles, fields as in a recording; `upswing.Recording.of(run)` wraps them.
    #[getter]
    fn records<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = recording::arrays(py, &self.cycles)?;
        let model = &self.config.model;
        dict.set_item("joints", model.joint_names().collect::<Vec<_>>())?;
        let actuated = (0..model.sizes().actuated()).map(|i| model.joint_name(i));
        dict.set_item("actuated", actuated.collect::<Vec<_>>())?;
        Ok(dict)
    }

    /// Writes an MCAP recording, which Foxglove, PlotJuggler and `upswing report` read.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.record(&path)).map_err(of_failure)
    }

    fn _repr_html_page(&self, py: Python<'_>) -> PyResult<String> {
        let html = py.detach(|| {
            let folder = tempfile::tempdir().map_err(upswing_process::Failure::failed)?;
            let path = folder.path().join("run.mcap");
            self.record(&path)?;
            recording::page_of(&path, Window::ALL)
        });
        String::from_utf8(html.map_err(of_failure)?).map_err(failed)
    }

    fn __len__(&self) -> usize {
        self.cycles.len()
    }

    fn __repr__(&self) -> String {
        let end = match (&self.aborted, self.success()) {
            (Some(why), _) => why.clone(),
            (None, true) => "success".into(),
            (None, false) => self.failures().join("; "),
        };
        format!("<upswing.Run of {} cycles: {end}>", self.cycles.len())
    }
}

/// Random start states (samples, 2n), those of `upswing montecarlo` with the same seed.
#[pyfunction]
#[pyo3(signature = (system, samples, seed = 0))]
pub fn random_starts<'py>(
    py: Python<'py>,
    system: &System,
    samples: u64,
    seed: u64,
) -> PyResult<Output<'py>> {
    let config = &system.config;
    let (starts, order) = (RandomStarts { config, seed }, config.model.order());
    let row = |i| starts.start(i).map(|x| chain::state_in_chain(order, &x));
    let rows: Vec<_> = py.detach(|| (0..samples).map(row).collect::<Result<_, _>>()).map_err(failed)?;
    output(py, vec![rows.len(), order.sizes().state()], rows.concat())
}

/// A result of the libraries as Python has the JSON of the command line.
pub fn of_json<'py>(py: Python<'py>, result: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(result).map_err(failed)?;
    py.import("json")?.call_method1("loads", (text,))
}

/// A plan for each start; `None`: there is none.
struct ArrayPlans(Vec<Option<Reference>>);

impl Contender for ArrayPlans {
    fn options(&self, index: u64, _: &State) -> Result<RunOptions<'_>, String> {
        let plan = usize::try_from(index).ok().and_then(|index| self.0.get(index)?.clone());
        let plan = plan.ok_or("none was given for this start")?;
        Ok(RunOptions { plan: Some(plan), ..RunOptions::default() })
    }
}

/// Swings up from random starts on all cores, and balances for `seconds` (s), as `upswing montecarlo closed-loop`.
///
/// `condition`: "nominal", "arm-mass", "pendulum-mass", "pendulum-length", a scenario of the system, or a .toml file. `progress(done, total)` is
/// called about every 0.1 s. `plans`: one of your own for each start, or `None` for a run that has failed. The result is an element of `conditions` in the output of the command with --json: samples, succeeded, failures,
/// spreads of the figures of the motion, and results of each start. All but its times depends on the settings, the seed and the condition only.
#[pyfunction]
#[pyo3(signature = (planner, samples, *, seed = 0, condition = "nominal", seconds = 4.0, plans = None, threads = None, progress = None))]
pub fn monte_carlo<'py>(
    py: Python<'py>,
    planner: &Planner,
    samples: u64,
    seed: u64,
    condition: &str,
    seconds: f64,
    plans: Option<Vec<Option<Py<Plan>>>>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let plans = plans.map(|plans| {
        ArrayPlans(plans.iter().map(|plan| Some(plan.as_ref()?.get().reference.clone())).collect())
    });
    if let Some(ArrayPlans(plans)) = &plans
        && plans.len() as u64 != samples
    {
        return Err(input(format!("`plans`: expected {samples}, one for each start, got {}", plans.len())));
    }
    if !(2.0..=600.0).contains(&seconds) {
        return Err(input(format!("`seconds`: expected 2 to 600, got {seconds}")));
    }
    let cores = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let threads = threads.unwrap_or_else(cores);
    if !(1..=1024).contains(&threads) {
        return Err(input(format!("`threads`: expected 1 to 1024, got {threads}")));
    }
    let condition = PlantCondition::new(condition, &planner.config).map_err(input)?;
    let result = interruptible(py, progress.as_ref(), samples as usize, |stop, done| {
        let count = || {
            done.fetch_add(1, Ordering::Relaxed);
        };
        let study = Study {
            planner: &planner.planner,
            starts: RandomStarts { config: planner.planner.config(), seed },
            indices: (0..samples).collect(),
            runs: None,
            threads,
            stop,
            progress: &count,
        };
        let contender = plans.as_ref().map(|plans| plans as &dyn Contender);
        ConditionStudy { study: &study, part: 0, condition: &condition, seconds, contender }.run()
    })?;
    of_json(py, &result.map_err(failed)?)
}
