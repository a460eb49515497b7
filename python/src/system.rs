//! Systems: a robot with its settings and manoeuvres.

use crate::array::{Input, Output, output};
use crate::chain;
use crate::errors::{failed, input};
use crate::model::Model;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Arc;
use upswing_config::{Config, GridAxis, PendulumStart, System as Source};
use upswing_model::{JointVector, Limits, State};
use upswing_planner::offline::target;
use upswing_planner::wanted;

/// A robot with its settings and manoeuvres.
#[pyclass(frozen, module = "upswing")]
pub struct System {
    pub config: Arc<Config>,
}

/// A manoeuvre from a start, as an argument of Python names it.
pub struct Wanted {
    /// Number of the manoeuvre in the settings.
    pub manoeuvre: usize,
    /// Values for its target, rad or m.
    pub given: Vec<f64>,
    /// rad, rad/s
    pub start: State,
}

/// Reads the place of the unactuated joints at a start.
pub fn pendulum_start(pendulum: &str) -> PyResult<PendulumStart> {
    match pendulum {
        "rest" => Ok(PendulumStart::Rest),
        "zero" => Ok(PendulumStart::Zero),
        got => Err(input(format!("`pendulum`: expected \"rest\" or \"zero\", got {got:?}"))),
    }
}

/// Positions by the names of their joints, rad or m.
pub type To = HashMap<String, f64>;

impl System {
    pub fn new(config: Config) -> Self {
        Self { config: Arc::new(config) }
    }

    /// The state of the argument `start`: positions of the actuated joints at standstill, in the posture in which the manoeuvre starts, or a
    /// whole state.
    pub fn start(&self, start: &Input<'_>, manoeuvre: usize, pendulum: &str) -> PyResult<State> {
        let sizes = self.config.model.sizes();
        let order = self.config.model.order();
        match start.shape()[..] {
            [n] if n == sizes.state() => Ok(chain::state(order, &start.numbers())),
            [_] => wanted::start_of(&self.config, manoeuvre, &start.numbers(), pendulum_start(pendulum)?)
                .map_err(|e| input(format!("`start`: {e}"))),
            ref shape => Err(input(format!(
                "`start`: expected an array of shape ({},), positions of the actuated joints, or ({},), positions and \
                 velocities of all joints, got the shape {shape:?}",
                sizes.actuated(),
                sizes.state()
            ))),
        }
    }

    /// The manoeuvre of the arguments.
    pub fn wanted(
        &self,
        start: &Input<'_>,
        manoeuvre: Option<&str>,
        to: Option<&To>,
        pendulum: &str,
    ) -> PyResult<Wanted> {
        let config = &self.config;
        let manoeuvre = self.number(manoeuvre)?;
        let to = to.into_iter().flatten().map(|(joint, value)| (joint.as_str(), *value));
        let given = wanted::given_values(config, manoeuvre, to);
        let mut given = given.map_err(|e| input(format!("`to`: {e}")))?;
        let start = self.start(start, manoeuvre, pendulum)?;
        wanted::complete_given(config, manoeuvre, &mut given, &start);
        Ok(Wanted { manoeuvre, given, start })
    }

    /// Number of the manoeuvre `name`; the first one without a name.
    pub fn number(&self, name: Option<&str>) -> PyResult<usize> {
        wanted::manoeuvre_number(&self.config, name).map_err(input)
    }

    /// Ranges of axes by the names of their joints, rad or m.
    fn ranges<'a>(&self, axes: impl Iterator<Item = &'a GridAxis>) -> HashMap<String, (f64, f64)> {
        axes.map(|axis| (self.config.model.joint_name(axis.joint).to_owned(), (axis.from, axis.to))).collect()
    }

    fn limits_of<'py>(&self, py: Python<'py>, limits: &Limits) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        let order = self.config.model.order();
        let joints = |v: &JointVector| output(py, vec![order.sizes().joints()], chain::in_chain(order, v));
        dict.set_item("q_min", joints(&limits.q_min)?)?;
        dict.set_item("q_max", joints(&limits.q_max)?)?;
        dict.set_item("qd_max", joints(&limits.qd_max)?)?;
        dict.set_item("tau_max", output(py, vec![order.sizes().actuated()], limits.tau_max.to_vec())?)?;
        Ok(dict)
    }
}

#[pymethods]
impl System {
    /// The shipped system of this name (`System.shipped()`), or the folder of a system; `None`: iiwa-pendulum.
    ///
    /// Raises `InputError` if it is unknown, or a file of it cannot be used.
    #[staticmethod]
    #[pyo3(signature = (system = None))]
    pub fn load(py: Python<'_>, system: Option<PathBuf>) -> PyResult<Self> {
        let source = match system {
            Some(system) => Source::try_from(OsString::from(system)).map_err(input)?,
            None => Source::default(),
        };
        py.detach(|| Config::load(&source)).map(Self::new).map_err(input)
    }

    /// Names of the shipped systems.
    #[staticmethod]
    fn shipped() -> Vec<&'static str> {
        Source::shipped().map(|system| system.name()).collect()
    }

    /// Name of a shipped system, or its folder.
    #[getter]
    fn name(&self) -> String {
        self.config.system().to_string()
    }

    /// The dynamics of planner and controller.
    #[getter]
    fn model(&self) -> Model {
        Model::of(&self.config)
    }

    /// Names of the joints in the URDF, from base to tip: the order of q and qd.
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.config.model.joint_names().map(str::to_owned).collect()
    }

    /// Names of the actuated joints: the order of u and tau.
    #[getter]
    fn actuated(&self) -> Vec<String> {
        let model = &self.config.model;
        (0..model.sizes().actuated()).map(|i| model.joint_name(i).to_owned()).collect()
    }

    /// Units of the positions of the joints, "rad" or "m".
    #[getter]
    fn units(&self) -> Vec<&'static str> {
        let model = &self.config.model;
        (0..model.sizes().joints()).map(|i| model.joint_kind(model.order().coordinate(i)).unit()).collect()
    }

    /// Names of the manoeuvres; functions without a name take the first one.
    #[getter]
    fn manoeuvres(&self) -> Vec<String> {
        self.config.manoeuvres.iter().map(|manoeuvre| manoeuvre.name.clone()).collect()
    }

    /// Names of the plants that differ from the model, for `with_scenario`.
    #[getter]
    fn scenarios(&self) -> Vec<String> {
        self.config.system().scenarios()
    }

    /// Control period, s.
    #[getter]
    fn period(&self) -> f64 {
        self.config.daemon.cycle.period.seconds()
    }

    /// Text of the robot description.
    #[getter]
    fn urdf(&self) -> String {
        self.config.urdf.clone()
    }

    /// 100 % limits: q_min, q_max, qd_max (n,), tau_max (n_A,).
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.limits_of(py, &self.config.robot.limits)
    }

    /// Limits that plans keep, as `limits`.
    #[getter]
    fn planning_limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.limits_of(py, &self.config.robot.planning)
    }

    /// State (2n,) at standstill in which a manoeuvre starts with the actuated joints at q_a (n_A,): the others hang at rest ("rest") or are at
    /// 0 ("zero"); in a manoeuvre from standing they stand.
    ///
    /// Raises `InputError` outside the limits, or without an equilibrium.
    #[pyo3(signature = (q_a, manoeuvre = None, *, pendulum = "rest"))]
    fn start_state<'py>(
        &self,
        py: Python<'py>,
        q_a: Input<'py>,
        manoeuvre: Option<&str>,
        pendulum: &str,
    ) -> PyResult<Output<'py>> {
        let x = self.start(&q_a, self.number(manoeuvre)?, pendulum)?;
        let order = self.config.model.order();
        output(py, vec![x.len()], chain::state_in_chain(order, &x))
    }

    /// Rows C (m, 2n) and values d (m,) of the target C x = d of a manoeuvre (8).
    #[pyo3(signature = (manoeuvre = None, to = None))]
    fn target<'py>(
        &self,
        py: Python<'py>,
        manoeuvre: Option<&str>,
        to: Option<To>,
    ) -> PyResult<(Output<'py>, Output<'py>)> {
        let (config, order) = (&self.config, self.config.model.order());
        let number = self.number(manoeuvre)?;
        let to = to.iter().flatten().map(|(joint, value)| (joint.as_str(), *value));
        let given = wanted::given_values(config, number, to).map_err(|e| input(format!("`to`: {e}")))?;
        if given.iter().any(|value| value.is_nan()) {
            return Err(input("`to`: expected a position of every joint that the manoeuvre asks for"));
        }
        let rows = target(config, number, &given).map_err(failed)?;
        let (values, width) = (rows.iter().map(|row| row.value).collect(), order.sizes().state());
        let coefficients =
            rows.iter().flat_map(|row| chain::state_in_chain(order, &row.coefficients)).collect();
        Ok((output(py, vec![rows.len(), width], coefficients)?, output(py, vec![rows.len()], values)?))
    }

    /// Ranges of start positions of joints in the grid of a manoeuvre; the other actuated joints start at 0.
    #[pyo3(signature = (manoeuvre = None))]
    fn start_ranges(&self, manoeuvre: Option<&str>) -> PyResult<HashMap<String, (f64, f64)>> {
        let axes = &self.config.manoeuvres[self.number(manoeuvre)?].grid.axes;
        Ok(self.ranges(axes.iter()))
    }

    /// Ranges of the positions that a manoeuvre asks for, by joint; empty if its target is fixed.
    #[pyo3(signature = (manoeuvre = None))]
    fn target_ranges(&self, manoeuvre: Option<&str>) -> PyResult<HashMap<String, (f64, f64)>> {
        Ok(self.ranges(self.config.manoeuvres[self.number(manoeuvre)?].given()))
    }

    /// The system with the plant of a scenario: a name, or the path of a .toml file. Planner and controller keep their model.
    fn with_scenario(&self, scenario: &str) -> PyResult<Self> {
        let mut config = (*self.config).clone();
        config.use_scenario(scenario).map_err(input)?;
        Ok(Self::new(config))
    }

    /// Contents of the files of the system, settings in full, without databases: write them to a folder to make your own system.
    fn files(&self) -> PyResult<HashMap<String, Vec<u8>>> {
        let files = self.config.files().map_err(failed)?;
        Ok(files.into_iter().map(|(name, contents)| (name, contents.into_owned())).collect())
    }

    fn __repr__(&self) -> String {
        format!("<upswing.System {} of the joints {}>", self.name(), self.joints().join(", "))
    }
}
