//! Plans: the offline optimisation (6), replans (16) with their gains (23), one at a time or in batches on all cores.

use crate::array::{Input, Output, output};
use crate::chain;
use crate::database::Database;
use crate::errors::{failed, input, no_plan};
use crate::progress::{cancellable, interruptible};
use crate::system::{System, To, Wanted};
use crate::trajectory::{Trajectory, margins};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_model::{Order, State, Workspace};
use upswing_ocp::interior_point::{Multipliers, NlpOptions, NlpSolution, NlpStatus};
use upswing_ocp::lqr::{LqrWeights, synthesize};
use upswing_ocp::multistart::Search;
use upswing_ocp::qp::QpSolver;
use upswing_planner::database::{DatabaseFile, solutions_near};
use upswing_planner::offline::{self, lqr_recursion, lqr_weights, target};
use upswing_planner::replan::{Effort, Method, NoPlan, PlanSummary, Planner as Replanner, Replan};
use upswing_rig::course::first_manoeuvre;
use upswing_trajectory::{Gain, Gains, Margins, Plan as Reference, Trajectory as Knots};

/// A time budget of an argument.
fn budget(seconds: Option<f64>) -> PyResult<Option<Duration>> {
    seconds
        .map(|s| {
            Duration::try_from_secs_f64(s)
                .map_err(|_| input(format!("`budget`: expected a number of seconds, 0 or above, got {s}")))
        })
        .transpose()
}

/// Result of `optimize`.
#[pyclass(frozen, module = "upswing")]
pub struct Optimum {
    config: Arc<Config>,
    solution: NlpSolution,
    /// The trajectory.
    #[pyo3(get)]
    trajectory: Py<Trajectory>,
}

#[pymethods]
impl Optimum {
    /// "solved", or why there is no solution.
    #[getter]
    fn status(&self) -> String {
        self.solution.status.to_string()
    }

    /// Whether all residuals are within the tolerance.
    #[getter]
    fn solved(&self) -> bool {
        self.solution.status == NlpStatus::Solved
    }

    /// Cost (6a), s.
    #[getter]
    fn cost(&self) -> f64 {
        self.solution.cost
    }

    /// Number of iterations.
    #[getter]
    fn iterations(&self) -> usize {
        self.solution.iterations
    }

    /// Largest violation of a constraint.
    #[getter]
    fn violation(&self) -> f64 {
        self.solution.violation
    }

    /// Largest scaled residual of the conditions of stationarity.
    #[getter]
    fn stationarity(&self) -> f64 {
        self.solution.stationarity
    }

    /// Multipliers of L = J + sum lambda_k . c_k + nu . (C x_N - d) + sum zeta_k . x_k + sum pi_k . tau_k + zeta_t t_F, whose derivatives with
    /// respect to x_1..x_N, u_0..u_N and t_F are zero at an optimum; c_k = x_{k+1} - x_k - h/2 (f_k + f_{k+1}) are the defects (6b).
    ///
    /// A dictionary: "defects" lambda (N, 2n), s per unit of x; "target" nu (m,), rows as of `System.target`; "x" zeta (N + 1, 2n), that of the given
    /// x_0 is 0; "torque" pi (N + 1, n_A), s per N m or N, of the torque (9), or (11) if the settings say so; "t_f" zeta_t.
    /// Those of limits are positive at the upper limit and negative at the lower one. They are the last iterate's if there is no solution.
    #[getter]
    fn multipliers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let order = self.config.model.order();
        let (state, actuated) = (order.sizes().state(), order.sizes().actuated());
        let Multipliers { defects, target, x, torque, t_f } = &self.solution.multipliers;
        let n = defects.len();
        let states = |x: &[State]| x.iter().flat_map(|x| chain::state_in_chain(order, x)).collect::<Vec<_>>();
        let dict = PyDict::new(py);
        dict.set_item("defects", output(py, vec![n, state], states(defects))?)?;
        dict.set_item("target", output(py, vec![target.len()], target.clone())?)?;
        dict.set_item("x", output(py, vec![n + 1, state], [vec![0.0; state], states(x)].concat())?)?;
        let torque = torque.iter().flat_map(|tau| tau.to_vec()).collect();
        dict.set_item("torque", output(py, vec![n + 1, actuated], torque)?)?;
        dict.set_item("t_f", t_f)?;
        Ok(dict)
    }

    /// As `Trajectory.margins`.
    #[getter]
    fn margins<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let config = &self.config;
        margins(
            py,
            (&Margins::of(&self.solution.trajectory, &config.model, &config.robot.planning, 0)).into(),
        )
    }

    fn __repr__(&self) -> String {
        let NlpSolution { trajectory, status, cost, iterations, .. } = &self.solution;
        let t_f = trajectory.t_f;
        format!("<upswing.Optimum: {status}, t_F {t_f:.4} s, cost {cost:.5}, {iterations} iterations>")
    }
}

/// Optimises a manoeuvre (6) from `start`, as `upswing optimize`: positions of the actuated joints (n_A,), at standstill, or a state (2n,).
///
/// `to` gives positions of joints, by their names, to a manoeuvre that asks for some. `best` searches for the best of several local optima.
/// `budget` limits each attempt, s. An unsolved optimum is no exception: see `Optimum.status`.
#[pyfunction]
#[pyo3(signature = (system, start, manoeuvre = None, *, to = None, best = false, budget = None, pendulum = "rest"))]
pub fn optimize(
    py: Python<'_>,
    system: &System,
    start: Input<'_>,
    manoeuvre: Option<&str>,
    to: Option<To>,
    best: bool,
    budget: Option<f64>,
    pendulum: &str,
) -> PyResult<Optimum> {
    let config = &system.config;
    let Wanted { manoeuvre, given, start } = system.wanted(&start, manoeuvre, to.as_ref(), pendulum)?;
    if config.manoeuvres[manoeuvre].reverses.is_some() {
        let name = &config.manoeuvres[manoeuvre].name;
        return Err(input(format!("`manoeuvre`: `{name}` runs another one backwards: optimise that one")));
    }
    let target = target(config, manoeuvre, &given).map_err(input)?;
    let time_budget = self::budget(budget)?;
    let neighbours = match best {
        true => py.detach(|| solutions_near(config, manoeuvre, &given, &start)).map_err(input)?,
        false => Vec::new(),
    };
    let search = if best { Search::Best } else { Search::First };
    let solution = cancellable(py, |stop| {
        let options = NlpOptions { time_budget, cancelled: Some(stop), ..offline::options(config) };
        offline::optimize(&offline::problem(config, target, start), search, &neighbours, &options)
    })?;
    let trajectory = Py::new(py, Trajectory::of(config, solution.trajectory.clone()))?;
    Ok(Optimum { config: config.clone(), solution, trajectory })
}

/// Gains as arrays: those at the knots, shape (N + 1, n_A, 2n), and the one that holds the end, (n_A, 2n).
fn gain_arrays<'py>(py: Python<'py>, order: &Order, gains: &Gains) -> PyResult<(Output<'py>, Output<'py>)> {
    let (actuated, state) = (order.sizes().actuated(), order.sizes().state());
    let in_chain = |gain: Gain<'_>| -> Vec<f64> {
        let column = |row: &[f64], j: usize| row[chain::state_row(order, j)];
        gain.rows().flat_map(|row| (0..state).map(|j| column(row, j)).collect::<Vec<_>>()).collect()
    };
    let knots = gains.knots().flat_map(in_chain).collect();
    let knots = output(py, vec![gains.intervals() + 1, actuated, state], knots)?;
    Ok((knots, output(py, vec![actuated, state], in_chain(gains.end()))?))
}

/// The gains of arrays, inverse of [`gain_arrays`].
fn gains_of(order: &Order, intervals: usize, (gains, end): (&Input<'_>, &Input<'_>)) -> PyResult<Gains> {
    let (actuated, state) = (order.sizes().actuated(), order.sizes().state());
    let expect = |name: &str, input_: &Input<'_>, shape: &[usize]| match input_.shape() == shape {
        true => Ok(input_.numbers()),
        false => {
            Err(input(format!("`{name}`: expected the shape {shape:?}, got the shape {:?}", input_.shape())))
        }
    };
    let mut slab = expect("gains", gains, &[intervals + 1, actuated, state])?;
    slab.extend(expect("gain_end", end, &[actuated, state])?);
    for row in slab.chunks_exact_mut(state) {
        let in_chain = row.to_vec();
        for (j, value) in in_chain.into_iter().enumerate() {
            row[chain::state_row(order, j)] = value;
        }
    }
    Gains::from_slab(order.sizes(), intervals, slab).ok_or_else(|| failed("gains of another length"))
}

/// Weights of the settings for (20), with those of the arguments in their place.
fn weights(
    config: &Config,
    q: Option<&Input<'_>>,
    q_end: Option<&Input<'_>>,
    r: Option<f64>,
) -> PyResult<LqrWeights> {
    let (sizes, order) = (config.model.sizes(), config.model.order());
    let mut weights = lqr_weights(&config.planner, sizes);
    let diagonal = |name: &str, q: &Input<'_>| -> PyResult<State> {
        let values =
            q.vector(name, sizes.state(), "the diagonal of a weight of all positions and velocities")?;
        match values.iter().all(|v| *v >= 0.0 && v.is_finite()) {
            true => Ok(chain::state(order, &values)),
            false => Err(input(format!("`{name}`: expected finite numbers, 0 or above"))),
        }
    };
    if let Some(q) = q {
        weights.q = diagonal("q", q)?;
        weights.q_end = weights.q;
    }
    if let Some(q_end) = q_end {
        weights.q_end = diagonal("q_end", q_end)?;
    }
    if let Some(r) = r {
        weights.r = r;
    }
    match weights.r > 0.0 && weights.r.is_finite() {
        true => Ok(weights),
        false => Err(input(format!("`r`: expected a finite number above 0, got {}", weights.r))),
    }
}

/// The gains of a trajectory for these weights.
fn gains_for(py: Python<'_>, config: &Config, knots: &Knots, weights: &LqrWeights) -> PyResult<Gains> {
    let ts = config.daemon.cycle.period.seconds();
    let recursion = lqr_recursion(&config.planner);
    py.detach(|| synthesize(&config.model, knots, weights, ts, recursion, &mut Workspace::default()))
        .map_err(failed)
}

/// Time-variant LQR (18)-(23): gains at the knots (N + 1, n_A, 2n), and the gain (n_A, 2n) that holds the end.
///
/// Weights in place of those of the settings: diagonals q along the trajectory and q_end at its end (`None`: q), (2n,); r for all inputs.
/// Raises `UpswingError` if no gain stabilises the end.
#[pyfunction]
#[pyo3(signature = (trajectory, *, q = None, q_end = None, r = None))]
pub fn lqr<'py>(
    py: Python<'py>,
    trajectory: &Trajectory,
    q: Option<Input<'py>>,
    q_end: Option<Input<'py>>,
    r: Option<f64>,
) -> PyResult<(Output<'py>, Output<'py>)> {
    let config = &trajectory.config;
    let weights = weights(config, q.as_ref(), q_end.as_ref(), r)?;
    gain_arrays(py, config.model.order(), &gains_for(py, config, &trajectory.knots, &weights)?)
}

/// A trajectory with feedback gains: u = u_d + K (x - x_d).
///
/// A plan of your own. Without gains (N + 1, n_A, 2n) and gain_end (n_A, 2n), those of `lqr`.
#[pyclass(frozen, module = "upswing")]
pub struct Plan {
    pub config: Arc<Config>,
    pub reference: Reference,
    /// The trajectory.
    #[pyo3(get)]
    trajectory: Py<Trajectory>,
    /// How it was found; `None`: made from arrays.
    replan: Option<Replan>,
}

impl Plan {
    fn of_replan(py: Python<'_>, config: &Arc<Config>, replan: Replan) -> PyResult<Self> {
        Ok(Self {
            config: config.clone(),
            reference: replan.plan(config),
            trajectory: Py::new(py, Trajectory::of(config, replan.trajectory.clone()))?,
            replan: Some(replan),
        })
    }

    fn summary(&self) -> Option<PlanSummary> {
        self.replan.as_ref().map(PlanSummary::from)
    }
}

#[pymethods]
impl Plan {
    #[new]
    #[pyo3(signature = (trajectory, gains = None, gain_end = None))]
    fn new(
        py: Python<'_>,
        trajectory: Bound<'_, Trajectory>,
        gains: Option<Input<'_>>,
        gain_end: Option<Input<'_>>,
    ) -> PyResult<Self> {
        let knots = trajectory.get().knots.clone();
        let config = trajectory.get().config.clone();
        let gains = match (&gains, &gain_end) {
            (Some(gains), Some(end)) => gains_of(config.model.order(), knots.intervals(), (gains, end))?,
            (None, None) => {
                gains_for(py, &config, &knots, &lqr_weights(&config.planner, config.model.sizes()))?
            }
            _ => return Err(input("`gains`, `gain_end`: expected both or none, got one")),
        };
        let reference = Reference::new(&config.model, knots, gains);
        Ok(Self { config, reference, trajectory: trajectory.unbind(), replan: None })
    }

    /// K at the knots, (N + 1, n_A, 2n), 1/s^2 and 1/s.
    #[getter]
    fn gains<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        Ok(gain_arrays(py, self.config.model.order(), &self.reference.gains)?.0)
    }

    /// K that holds the end, (n_A, 2n).
    #[getter]
    fn gain_end<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        Ok(gain_arrays(py, self.config.model.order(), &self.reference.gains)?.1)
    }

    /// x_d (2n,) and u_d (n_A,) at a time since the start, s; after the end x_N and 0.
    fn desired<'py>(&self, py: Python<'py>, t: f64) -> PyResult<(Output<'py>, Output<'py>)> {
        let reference = self.reference.reference(t);
        let x = chain::state_in_chain(self.config.model.order(), &reference.x);
        Ok((output(py, vec![x.len()], x)?, output(py, vec![reference.u.len()], reference.u.to_vec())?))
    }

    /// u = u_d + K (x - x_d), (n_A,).
    fn input<'py>(&self, py: Python<'py>, t: f64, x: Input<'py>) -> PyResult<Output<'py>> {
        let (sizes, order) = (self.config.model.sizes(), self.config.model.order());
        let x = x.vector("x", sizes.state(), "positions and velocities of all joints")?;
        let u = self.reference.reference(t).input(&chain::state(order, &x));
        output(py, vec![u.len()], u.to_vec())
    }

    /// Duration, s.
    #[getter]
    fn t_f(&self) -> f64 {
        self.reference.trajectory.t_f
    }

    /// Cost (6a), s.
    #[getter]
    fn cost(&self) -> f64 {
        self.reference.trajectory.cost(self.config.planner.offline.input_weight)
    }

    /// Largest defect of the dynamics (6b), rad or rad/s per interval.
    #[getter]
    fn defect(&self) -> f64 {
        self.reference.spline().defect()
    }

    /// "quadratic": adapted from an entry by QPs (16); "optimisation": optimised in full; "given": made from arrays.
    #[getter]
    fn method(&self) -> &'static str {
        match self.replan.as_ref().map(|replan| replan.method) {
            None => "given",
            Some(Method::Quadratic) => "quadratic",
            Some(Method::Optimisation) => "optimisation",
        }
    }

    /// "solved", or "open defect" if the defect is above the setting.
    #[getter]
    fn status(&self) -> &'static str {
        // Written so that a NaN counts as an open defect.
        if self.defect() <= self.config.planner.replan.defect { "solved" } else { "open defect" }
    }

    /// Number of the database entry that was adapted, or is the nearest one.
    #[getter]
    fn nearest_entry(&self) -> Option<usize> {
        self.summary()?.nearest_entry
    }

    /// Distance to that entry, rad.
    #[getter]
    fn distance(&self) -> Option<f64> {
        self.summary()?.distance
    }

    /// Number of entries tried.
    #[getter]
    fn attempts(&self) -> Option<usize> {
        Some(self.summary()?.attempts)
    }

    /// Number of QPs, or of iterations of the full optimisation.
    #[getter]
    fn iterations(&self) -> Option<usize> {
        Some(self.summary()?.iterations)
    }

    /// As `Trajectory.margins`; of a replan also between the knots.
    #[getter]
    fn margins<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        match self.summary() {
            Some(summary) => margins(py, summary.margins),
            None => {
                let config = &self.config;
                let of = Margins::of(&self.reference.trajectory, &config.model, &config.robot.planning, 0);
                margins(py, (&of).into())
            }
        }
    }

    /// Durations of the parts of the replan, s: nearest, qp, optimisation, check, lqr, total.
    #[getter]
    fn times<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        if let Some(Replan { statistics, .. }) = &self.replan {
            dict.set_item("nearest", statistics.nearest.as_secs_f64())?;
            dict.set_item("qp", statistics.qp.as_secs_f64())?;
            dict.set_item("optimisation", statistics.optimisation.as_secs_f64())?;
            dict.set_item("check", statistics.check.as_secs_f64())?;
            dict.set_item("lqr", statistics.lqr.as_secs_f64())?;
            dict.set_item("total", statistics.total.as_secs_f64())?;
        }
        Ok(dict)
    }

    fn __repr__(&self) -> String {
        let (t_f, defect, method) = (self.t_f(), self.defect(), self.method());
        format!("<upswing.Plan of {t_f:.4} s, defect {defect:.1e}, {method}>")
    }
}

/// Plans from measured starts with the databases of a system.
///
/// With the databases of the system, or with one file for one manoeuvre.
#[pyclass(frozen, module = "upswing")]
pub struct Planner {
    pub planner: Replanner,
    /// The system of the planner.
    #[pyo3(get)]
    system: Py<System>,
    pub config: Arc<Config>,
    /// Solvers with their memory, one per thread that plans at the same time. Earlier solves have no influence.
    solvers: Mutex<Vec<QpSolver>>,
}

impl Planner {
    /// Runs `f` with a solver that no other thread uses.
    pub fn with_solver<T>(&self, f: impl FnOnce(&mut QpSolver) -> T) -> T {
        let pool = || self.solvers.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = pool().pop();
        let mut solver = kept.unwrap_or_else(|| self.planner.solver());
        let result = f(&mut solver);
        pool().push(solver);
        result
    }

    /// The plan of the first manoeuvre from a state, as a run in closed loop gets it.
    pub fn plan_from(&self, py: Python<'_>, start: &State) -> PyResult<Plan> {
        let found = py.detach(|| {
            let effort = Effort::iterations(self.config.planner.replan.iterations);
            let manoeuvre = first_manoeuvre(&self.config);
            self.with_solver(|solver| self.planner.replan_with(solver, 0, manoeuvre.given(), start, &effort))
        });
        Plan::of_replan(py, &self.config, found.map_err(no_plan)?)
    }

    fn effort(&self, iterations: Option<usize>, optimise: Option<bool>) -> PyResult<Effort<'static>> {
        let iterations = iterations.unwrap_or(self.config.planner.replan.iterations);
        if !(1..=100).contains(&iterations) {
            return Err(input(format!("`iterations`: expected 1 to 100, got {iterations}")));
        }
        let effort = Effort::iterations(iterations);
        Ok(Effort { optimise: optimise.unwrap_or(effort.optimise), ..effort })
    }
}

#[pymethods]
impl Planner {
    #[new]
    #[pyo3(signature = (system, *, manoeuvre = None, database = None))]
    fn new(
        py: Python<'_>,
        system: Bound<'_, System>,
        manoeuvre: Option<&str>,
        database: Option<PathBuf>,
    ) -> PyResult<Self> {
        let config = system.get().config.clone();
        let number = system.get().number(manoeuvre)?;
        let planner = py.detach(|| match database {
            None => Replanner::new((*config).clone()).map_err(input),
            Some(path) => {
                let file = DatabaseFile::open(&path).map_err(input)?;
                Replanner::with_database((*config).clone(), number, file).map_err(input)
            }
        })?;
        Ok(Self { planner, system: system.unbind(), config, solvers: Mutex::default() })
    }

    /// Number of database entries of a manoeuvre.
    #[pyo3(signature = (manoeuvre = None))]
    fn entries(&self, py: Python<'_>, manoeuvre: Option<&str>) -> PyResult<usize> {
        Ok(self.planner.entries(self.system.bind(py).get().number(manoeuvre)?))
    }

    /// Plans from a start as `optimize` takes it: adapts the nearest entry, or optimises in full, as `upswing plan`.
    ///
    /// `iterations`: largest number of QPs per entry; 1 is the mode of the paper. `optimise`: whether the full optimisation may follow.
    /// `budget`: time, s. Raises `NoPlan` with the reasons.
    #[pyo3(signature = (start, manoeuvre = None, *, to = None, iterations = None, optimise = None, budget = None, pendulum = "rest"))]
    fn replan(
        &self,
        py: Python<'_>,
        start: Input<'_>,
        manoeuvre: Option<&str>,
        to: Option<To>,
        iterations: Option<usize>,
        optimise: Option<bool>,
        budget: Option<f64>,
        pendulum: &str,
    ) -> PyResult<Plan> {
        let wanted = self.system.bind(py).get().wanted(&start, manoeuvre, to.as_ref(), pendulum)?;
        let effort = self.effort(iterations, optimise)?;
        let budget = self::budget(budget)?;
        let deadline = budget.and_then(|budget| Instant::now().checked_add(budget));
        let found = cancellable(py, |stop| {
            let effort = Effort { deadline, cancelled: Some(stop), ..effort };
            self.with_solver(|solver| {
                self.planner.replan_with(solver, wanted.manoeuvre, &wanted.given, &wanted.start, &effort)
            })
        })?;
        Plan::of_replan(py, &self.config, found.map_err(no_plan)?)
    }

    /// Plans from each row of `starts` on all cores. A start without a plan has its `NoPlan` in the list.
    #[pyo3(signature = (starts, manoeuvre = None, *, to = None, iterations = None, optimise = None, pendulum = "rest", progress = None))]
    fn replan_all<'py>(
        &self,
        py: Python<'py>,
        starts: Vec<Input<'py>>,
        manoeuvre: Option<&str>,
        to: Option<To>,
        iterations: Option<usize>,
        optimise: Option<bool>,
        pendulum: &str,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyList>> {
        let system = self.system.bind(py).get();
        let wanted: Vec<Wanted> = starts
            .iter()
            .map(|start| system.wanted(start, manoeuvre, to.as_ref(), pendulum))
            .collect::<PyResult<_>>()?;
        drop(starts);
        let (iterations, optimise) = {
            let effort = self.effort(iterations, optimise)?;
            (effort.iterations, effort.optimise)
        };
        let found = interruptible(py, progress.as_ref(), wanted.len(), |stop, done| {
            let work = |wanted: &Wanted| -> Option<Result<Replan, NoPlan>> {
                let stopped = || stop.load(Ordering::Acquire);
                if stopped() {
                    return None;
                }
                let effort = Effort { iterations, optimise, deadline: None, cancelled: Some(&stopped) };
                let found = self.with_solver(|solver| {
                    self.planner.replan_with(solver, wanted.manoeuvre, &wanted.given, &wanted.start, &effort)
                });
                done.fetch_add(1, Ordering::Relaxed);
                Some(found)
            };
            wanted.par_iter().map(work).collect::<Vec<_>>()
        })?;
        let plans = PyList::empty(py);
        for found in found.into_iter().flatten() {
            match found {
                Ok(replan) => plans.append(Plan::of_replan(py, &self.config, replan)?)?,
                Err(e) => plans.append(no_plan(e).into_value(py))?,
            }
        }
        Ok(plans)
    }

    /// Numbers and distances of the entries that `replan` tries, nearest first.
    #[pyo3(signature = (start, manoeuvre = None, *, to = None, pendulum = "rest"))]
    fn nearest(
        &self,
        py: Python<'_>,
        start: Input<'_>,
        manoeuvre: Option<&str>,
        to: Option<To>,
        pendulum: &str,
    ) -> PyResult<Vec<(usize, f64)>> {
        let Wanted { manoeuvre, given, start } =
            self.system.bind(py).get().wanted(&start, manoeuvre, to.as_ref(), pendulum)?;
        let near = self.planner.nearest(manoeuvre, &given, &start);
        Ok(near.into_iter().map(|near| (near.index, near.distance)).collect())
    }

    /// The database of the system for a manoeuvre.
    #[pyo3(signature = (manoeuvre = None))]
    fn database(&self, py: Python<'_>, manoeuvre: Option<&str>) -> PyResult<Option<Database>> {
        let system = self.system.bind(py);
        Database::of_settings(py, system.get(), system.get().number(manoeuvre)?)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let name = self.system.bind(py).get().config.system().to_string();
        format!("<upswing.Planner of {name} with {} database entries>", self.planner.entries_of_all())
    }
}
