//! Trajectories (7): knots, and the spline between them.

use crate::array::{Input, Output, output};
use crate::chain;
use crate::errors::input;
use crate::system::System;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;
use upswing_config::Config;
use upswing_model::State;
use upswing_planner::database::certify;
use upswing_planner::replan::MarginShares;
use upswing_trajectory::{Certificate, INTERVALS, Margins, Trajectory as Knots};

/// A trajectory (7) of N + 1 knots, uniform in time, and its spline (12).
///
/// A trajectory of arrays: t_f (s), x (N + 1, 2n), u (N + 1, n_A).
#[pyclass(frozen, module = "upswing")]
pub struct Trajectory {
    pub config: Arc<Config>,
    pub knots: Knots,
    /// f_k, for the spline.
    f: Vec<State>,
}

/// Margins as a dictionary with the keys of the command line.
pub fn margins<'py>(py: Python<'py>, shares: MarginShares) -> PyResult<Bound<'py, PyDict>> {
    let MarginShares { margin_q, margin_qd, margin_tau } = shares;
    let dict = PyDict::new(py);
    dict.set_item("margin_q", margin_q)?;
    dict.set_item("margin_qd", margin_qd)?;
    dict.set_item("margin_tau", margin_tau)?;
    Ok(dict)
}

/// A certificate as a dictionary.
pub fn certificate<'py>(py: Python<'py>, certificate: &Certificate) -> PyResult<Bound<'py, PyDict>> {
    let Certificate { cost, defect, margin_q, margin_qd, margin_tau, end_error } = *certificate;
    let dict = margins(py, MarginShares { margin_q, margin_qd, margin_tau })?;
    dict.set_item("cost", cost)?;
    dict.set_item("defect", defect)?;
    dict.set_item("end_error", end_error)?;
    Ok(dict)
}

impl Trajectory {
    pub fn of(config: &Arc<Config>, knots: Knots) -> Self {
        let f = knots.f(&config.model);
        Self { config: config.clone(), knots, f }
    }

    /// The knots of arrays.
    pub fn knots_of(config: &Config, t_f: f64, x: &Input<'_>, u: &Input<'_>) -> PyResult<Knots> {
        let (sizes, order) = (config.model.sizes(), config.model.order());
        let x = x.vectors("x", sizes.state(), "positions and velocities of all joints")?;
        let u = u.vectors("u", sizes.actuated(), "accelerations of the actuated joints")?;
        let [knots] = x.lead[..] else {
            return Err(input(format!("`x`: expected one row per knot, got the leading shape {:?}", x.lead)));
        };
        if u.lead != x.lead {
            return Err(input(format!("`u`: expected {knots} rows, as `x` has, got {:?}", u.lead)));
        }
        if !INTERVALS.contains(&knots.saturating_sub(1)) {
            let (least, most) = (INTERVALS.start() + 1, INTERVALS.end() + 1);
            return Err(input(format!("`x`: expected {least} to {most} knots, got {knots}")));
        }
        if !(t_f > 0.0 && t_f <= Knots::LONGEST) {
            return Err(input(format!("`t_f`: expected above 0 to {} s, got {t_f}", Knots::LONGEST)));
        }
        let knots = Knots {
            t_f,
            x: (0..knots).map(|k| chain::state(order, x.get(k))).collect(),
            u: (0..knots).map(|k| chain::actuated(order, u.get(k))).collect(),
        };
        let finite = knots.x.iter().all(|x| x.iter().all(|v| v.is_finite()))
            && knots.u.iter().all(|u| u.iter().all(|v| v.is_finite()));
        if finite { Ok(knots) } else { Err(input("`x`, `u`: expected finite numbers, got others")) }
    }
}

#[pymethods]
impl Trajectory {
    #[new]
    fn new(system: &System, t_f: f64, x: Input<'_>, u: Input<'_>) -> PyResult<Self> {
        Ok(Self::of(&system.config, Self::knots_of(&system.config, t_f, &x, &u)?))
    }

    /// Duration, s.
    #[getter]
    fn t_f(&self) -> f64 {
        self.knots.t_f
    }

    /// Names of the joints: the order of the columns of x.
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.config.model.joint_names().map(str::to_owned).collect()
    }

    /// Names of the actuated joints: the order of the columns of u.
    #[getter]
    fn actuated(&self) -> Vec<String> {
        let model = &self.config.model;
        (0..model.sizes().actuated()).map(|i| model.joint_name(i).to_owned()).collect()
    }

    /// Times of the knots, (N + 1,), s.
    #[getter]
    fn t<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let n = self.knots.intervals();
        // The last one is t_F without rounding.
        output(py, vec![n + 1], (0..=n).map(|k| self.knots.t_f * k as f64 / n as f64).collect())
    }

    /// States [q, qd], (N + 1, 2n).
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let order = self.config.model.order();
        let rows = self.knots.x.iter().flat_map(|x| chain::state_in_chain(order, x)).collect();
        output(py, vec![self.knots.x.len(), order.sizes().state()], rows)
    }

    /// Accelerations of the actuated joints, (N + 1, n_A).
    #[getter]
    fn u<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let sizes = self.config.model.sizes();
        let rows = self.knots.u.iter().flat_map(|u| u.iter().copied()).collect();
        output(py, vec![self.knots.u.len(), sizes.actuated()], rows)
    }

    /// x(t), (..., 2n), for times (...,) in s, which are clamped to the trajectory.
    fn state<'py>(&self, py: Python<'py>, t: Input<'py>) -> PyResult<Output<'py>> {
        let (times, order) = (t.numbers(), self.config.model.order());
        let spline = self.knots.spline(&self.f);
        let rows = times.iter().flat_map(|t| chain::state_in_chain(order, &spline.state(*t))).collect();
        output(py, [t.shape(), vec![order.sizes().state()]].concat(), rows)
    }

    /// u(t), (..., n_A).
    fn input<'py>(&self, py: Python<'py>, t: Input<'py>) -> PyResult<Output<'py>> {
        let sizes = self.config.model.sizes();
        let spline = self.knots.spline(&self.f);
        let rows = t.numbers().iter().flat_map(|t| spline.input(*t).to_vec()).collect();
        output(py, [t.shape(), vec![sizes.actuated()]].concat(), rows)
    }

    /// Largest defect of the dynamics (6b), rad or rad/s per interval.
    #[getter]
    fn defect(&self) -> f64 {
        self.knots.spline(&self.f).defect()
    }

    /// Cost (6a), s.
    #[getter]
    fn cost(&self) -> f64 {
        self.knots.cost(self.config.planner.offline.input_weight)
    }

    /// Smallest margins to the limits of plans as shares of half the range, at the knots and `between` more points in each interval:
    /// margin_q, margin_qd, margin_tau; negative: violated.
    #[pyo3(signature = (between = 0))]
    fn margins<'py>(&self, py: Python<'py>, between: usize) -> PyResult<Bound<'py, PyDict>> {
        if between > 1000 {
            return Err(input(format!("`between`: expected 0 to 1000, got {between}")));
        }
        let config = &self.config;
        let of = py.detach(|| Margins::of(&self.knots, &config.model, &config.robot.planning, between));
        margins(py, (&of).into())
    }

    /// Cost, defect, margins (at ten points per interval) and end error of the real dynamics without feedback, as in a database.
    fn certificate<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let computed = py.detach(|| certify(&self.config, &self.knots));
        certificate(py, &computed)
    }

    /// The trajectory in reversed time.
    fn reversed(&self) -> Self {
        Self::of(&self.config, self.knots.reversed())
    }

    fn __len__(&self) -> usize {
        self.knots.x.len()
    }

    fn __repr__(&self) -> String {
        format!("<upswing.Trajectory of {:.4} s with {} knots>", self.knots.t_f, self.knots.x.len())
    }
}
