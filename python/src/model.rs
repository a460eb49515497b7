//! The dynamics of a system, one state at a time or in batches.

use crate::array::{self, Input, Output, Vectors};
use crate::chain;
use crate::errors::{failed, input};
use pyo3::prelude::*;
use std::cell::RefCell;
use std::sync::Arc;
use upswing_config::Config;
use upswing_model::{
    ActuatedVector, Dims as _, JointVector, Linearization, Model as Chain, Order, State, UnactuatedVector,
    Workspace,
};

thread_local! {
    /// Scratch memory of the recursions; making it anew would cost as much as a small chain.
    static WORK: RefCell<Workspace> = RefCell::new(Workspace::default());
}

/// Runs `f` with the scratch memory of this thread.
fn with_work<T>(f: impl FnOnce(&mut Workspace) -> T) -> T {
    WORK.with_borrow_mut(f)
}

/// The dynamics M(q) qdd + C(q, qd) qd + g(q) = tau of a system (1), in which the unactuated joints have no torque, and
/// dx/dt = f(x, u) with the input u = qdd_A, the accelerations of the actuated joints (5).
#[pyclass(frozen, module = "upswing")]
pub struct Model {
    config: Arc<Config>,
}

impl Model {
    /// The model of the settings.
    pub fn of(config: &Arc<Config>) -> Self {
        Self { config: config.clone() }
    }

    fn chain(&self) -> &Chain {
        &self.config.model
    }

    fn order(&self) -> &Order {
        self.chain().order()
    }

    fn per_joint<'a>(&self, name: &str, values: &'a Input<'_>) -> PyResult<Vectors<'a>> {
        values.vectors(name, self.chain().sizes().joints(), "one number per joint")
    }

    fn per_actuated<'a>(&self, name: &str, values: &'a Input<'_>) -> PyResult<Vectors<'a>> {
        values.vectors(name, self.chain().sizes().actuated(), "one number per actuated joint")
    }

    fn states<'a>(&self, x: &'a Input<'_>) -> PyResult<Vectors<'a>> {
        x.vectors("x", self.chain().sizes().state(), "positions and velocities of all joints")
    }

    /// For each q: `f` of it.
    fn of_q<'py>(
        &self,
        py: Python<'py>,
        q: &Input<'py>,
        out: &[usize],
        f: impl Fn(&JointVector, &mut Workspace, &mut [f64]) -> PyResult<()> + Sync,
    ) -> PyResult<Output<'py>> {
        let (q, order) = (self.per_joint("q", q)?, *self.order());
        array::map(py, [("q", &q)], out, |i, out| {
            with_work(|work| f(&chain::joints(&order, q.get(i)), work, out))
        })
    }

    /// For each x and u: `f` of them.
    fn of_xu<'py>(
        &self,
        py: Python<'py>,
        (x, u): (&Input<'py>, &Input<'py>),
        out: &[usize],
        f: impl Fn(&State, &ActuatedVector, &mut Workspace, &mut [f64]) + Sync,
    ) -> PyResult<Output<'py>> {
        let (x, u, order) = (self.states(x)?, self.per_actuated("u", u)?, *self.order());
        array::map(py, [("x", &x), ("u", &u)], out, |i, out| {
            let (x, u) = (chain::state(&order, x.get(i)), chain::actuated(&order, u.get(i)));
            with_work(|work| f(&x, &u, work, out));
            Ok(())
        })
    }
}

#[pymethods]
impl Model {
    /// Names of the joints in the URDF, from base to tip.
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.chain().joint_names().map(str::to_owned).collect()
    }

    /// Names of the actuated joints, from base to tip.
    #[getter]
    fn actuated(&self) -> Vec<String> {
        (0..self.chain().sizes().actuated()).map(|i| self.chain().joint_name(i).to_owned()).collect()
    }

    /// Fingerprint of the dynamics, 16 hexadecimal digits: equal ones give equal numbers.
    #[getter]
    fn fingerprint(&self) -> String {
        format!("{:016x}", self.chain().fingerprint())
    }

    /// M(q), (..., n) to (..., n, n), kg m^2, kg m or kg.
    fn mass_matrix<'py>(&self, py: Python<'py>, q: Input<'py>) -> PyResult<Output<'py>> {
        let (chain, order, n) = (self.chain(), *self.order(), self.chain().sizes().joints());
        self.of_q(py, &q, &[n, n], |q, work, out| {
            let mass = chain.mass_matrix(q, work);
            for (i, row) in out.chunks_exact_mut(n).enumerate() {
                for (j, out) in row.iter_mut().enumerate() {
                    *out = mass[(order.coordinate(i), order.coordinate(j))];
                }
            }
            Ok(())
        })
    }

    /// C(q, qd) qd + g(q), (..., n), N m or N.
    fn nonlinear_effects<'py>(
        &self,
        py: Python<'py>,
        q: Input<'py>,
        qd: Input<'py>,
    ) -> PyResult<Output<'py>> {
        let (q, qd, order) = (self.per_joint("q", &q)?, self.per_joint("qd", &qd)?, *self.order());
        array::map(py, [("q", &q), ("qd", &qd)], &[order.sizes().joints()], |i, out| {
            let (q, qd) = (chain::joints(&order, q.get(i)), chain::joints(&order, qd.get(i)));
            let effects = with_work(|work| self.chain().nonlinear_effects(&q, &qd, work));
            chain::write_joints(&order, &effects, out);
            Ok(())
        })
    }

    /// g(q), (..., n), N m or N.
    fn gravity<'py>(&self, py: Python<'py>, q: Input<'py>) -> PyResult<Output<'py>> {
        let order = *self.order();
        self.of_q(py, &q, &[order.sizes().joints()], |q, work, out| {
            chain::write_joints(&order, &self.chain().gravity_torque(q, work), out);
            Ok(())
        })
    }

    /// M(q) qdd + C(q, qd) qd + g(q), (..., n), N m or N.
    fn inverse_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: Input<'py>,
        qd: Input<'py>,
        qdd: Input<'py>,
    ) -> PyResult<Output<'py>> {
        let order = *self.order();
        let (q, qd) = (self.per_joint("q", &q)?, self.per_joint("qd", &qd)?);
        let qdd = self.per_joint("qdd", &qdd)?;
        array::map(py, [("q", &q), ("qd", &qd), ("qdd", &qdd)], &[order.sizes().joints()], |i, out| {
            let [q, qd, qdd] = [&q, &qd, &qdd].map(|v| chain::joints(&order, v.get(i)));
            let tau = with_work(|work| self.chain().inverse_dynamics(&q, &qd, &qdd, work));
            chain::write_joints(&order, &tau, out);
            Ok(())
        })
    }

    /// Accelerations of all joints under torques of all joints, (..., n) each.
    fn forward_dynamics<'py>(
        &self,
        py: Python<'py>,
        q: Input<'py>,
        qd: Input<'py>,
        tau: Input<'py>,
    ) -> PyResult<Output<'py>> {
        let order = *self.order();
        let (q, qd) = (self.per_joint("q", &q)?, self.per_joint("qd", &qd)?);
        let tau = self.per_joint("tau", &tau)?;
        array::map(py, [("q", &q), ("qd", &qd), ("tau", &tau)], &[order.sizes().joints()], |i, out| {
            let [q, qd, tau] = [&q, &qd, &tau].map(|v| chain::joints(&order, v.get(i)));
            let qdd = with_work(|work| self.chain().forward_dynamics(&q, &qd, &tau, work));
            let refused =
                || input("`q`: expected finite positions: the mass matrix is not positive definite");
            chain::write_joints(&order, &qdd.ok_or_else(refused)?, out);
            Ok(())
        })
    }

    /// dx/dt = f(x, u) (5): x (..., 2n), u (..., n_A), result (..., 2n).
    fn f<'py>(&self, py: Python<'py>, x: Input<'py>, u: Input<'py>) -> PyResult<Output<'py>> {
        let order = *self.order();
        self.of_xu(py, (&x, &u), &[order.sizes().state()], |x, u, work, out| {
            chain::write_state(&order, &self.chain().f(x, u, work), out);
        })
    }

    /// df/dx (19), exact: (..., 2n, 2n).
    #[pyo3(name = "A")]
    fn a<'py>(&self, py: Python<'py>, x: Input<'py>, u: Input<'py>) -> PyResult<Output<'py>> {
        let (order, n) = (*self.order(), self.chain().sizes().state());
        self.of_xu(py, (&x, &u), &[n, n], |x, u, work, out| {
            let mut d = Linearization::new(order.sizes());
            self.chain().linearize(x, u, work, &mut d);
            let a = d.a();
            for (i, row) in out.chunks_exact_mut(n).enumerate() {
                for (j, out) in row.iter_mut().enumerate() {
                    *out = a[(chain::state_row(&order, i), chain::state_row(&order, j))];
                }
            }
        })
    }

    /// df/du (19), exact: (..., 2n, n_A).
    #[pyo3(name = "B")]
    fn b<'py>(&self, py: Python<'py>, x: Input<'py>, u: Input<'py>) -> PyResult<Output<'py>> {
        let (order, sizes) = (*self.order(), self.chain().sizes());
        self.of_xu(py, (&x, &u), &[sizes.state(), sizes.actuated()], |x, u, work, out| {
            let mut d = Linearization::new(sizes);
            self.chain().linearize(x, u, work, &mut d);
            let b = d.b();
            for (i, row) in out.chunks_exact_mut(sizes.actuated()).enumerate() {
                for (j, out) in row.iter_mut().enumerate() {
                    *out = b[(chain::state_row(&order, i), j)];
                }
            }
        })
    }

    /// Second derivatives of w . qdd_U + mu . tau with respect to z = [q, qd, u], exact: w (n - n_A,) in the order of the unactuated joints,
    /// mu (n_A,), result (..., 2n + n_A, 2n + n_A), symmetric.
    fn hessian<'py>(
        &self,
        py: Python<'py>,
        x: Input<'py>,
        u: Input<'py>,
        w: Input<'py>,
        mu: Input<'py>,
    ) -> PyResult<Output<'py>> {
        let (order, sizes) = (*self.order(), self.chain().sizes());
        let w = w.vector("w", sizes.unactuated(), "one number per unactuated joint")?;
        let mu = mu.vector("mu", sizes.actuated(), "one number per actuated joint")?;
        let (z, stride) = (sizes.knot(), sizes.knot_row());
        self.of_xu(py, (&x, &u), &[z, z], |x, u, work, out| {
            let mut d = Linearization::new(sizes);
            self.chain().linearize(x, u, work, &mut d);
            let mut h = vec![0.0; z * stride];
            self.chain().hessian(&w, &mu, &d, work, &mut h);
            for (i, row) in out.chunks_exact_mut(z).enumerate() {
                for (j, out) in row.iter_mut().enumerate() {
                    *out = h[chain::knot_row(&order, i) * stride + chain::knot_row(&order, j)];
                }
            }
        })
    }

    /// Torque of the motors for the accelerations u, the torque law (9), (24): (..., n_A), N m or N. Without Coriolis terms as in (11).
    #[pyo3(signature = (x, u, coriolis = true))]
    fn torque<'py>(
        &self,
        py: Python<'py>,
        x: Input<'py>,
        u: Input<'py>,
        coriolis: bool,
    ) -> PyResult<Output<'py>> {
        let chain = self.chain();
        self.of_xu(py, (&x, &u), &[chain.sizes().actuated()], |x, u, work, out| {
            let tau = match coriolis {
                true => chain.torque(x, u, work),
                false => chain.torque_without_coriolis(x, u, work),
            };
            out.copy_from_slice(&tau);
        })
    }

    /// Poses of the frames of the bodies in the world frame: homogeneous matrices, (..., n, 4, 4), m.
    fn forward_kinematics<'py>(&self, py: Python<'py>, q: Input<'py>) -> PyResult<Output<'py>> {
        let n = self.chain().sizes().joints();
        self.of_q(py, &q, &[n, 4, 4], |q, _, out| {
            for (out, pose) in out.chunks_exact_mut(16).zip(self.chain().poses(q)) {
                let pose = pose.to_homogeneous();
                for (i, out) in out.iter_mut().enumerate() {
                    *out = pose[(i / 4, i % 4)];
                }
            }
            Ok(())
        })
    }

    /// Tip of the pendulum in the world frame, (..., 3), m.
    fn tip<'py>(&self, py: Python<'py>, q: Input<'py>) -> PyResult<Output<'py>> {
        self.of_q(py, &q, &[3], |q, _, out| {
            out.copy_from_slice(self.chain().tip(q).as_slice());
            Ok(())
        })
    }

    /// Kinetic and potential energy, (...,), J; the latter is 0 at the world's origin.
    fn energy<'py>(&self, py: Python<'py>, x: Input<'py>) -> PyResult<Output<'py>> {
        let (x, order) = (self.states(&x)?, *self.order());
        array::map(py, [("x", &x)], &[], |i, out| {
            out[0] = with_work(|work| self.chain().energy(&chain::state(&order, x.get(i)), work));
            Ok(())
        })
    }

    /// q with the actuated joints at q_a, (..., n_A), and the others hanging, or standing upright: (..., n).
    ///
    /// Raises `UpswingError` where there is no such equilibrium.
    #[pyo3(signature = (q_a, upright = false))]
    fn rest_position<'py>(&self, py: Python<'py>, q_a: Input<'py>, upright: bool) -> PyResult<Output<'py>> {
        let (chain, order) = (self.chain(), *self.order());
        let q_a = self.per_actuated("q_a", &q_a)?;
        let zero = UnactuatedVector::zeros(order.sizes());
        array::map(py, [("q_a", &q_a)], &[order.sizes().joints()], |i, out| {
            let q = JointVector::joined(&chain::actuated(&order, q_a.get(i)), &zero);
            let found = with_work(|work| match upright {
                false => chain.rest_position(&q, work),
                true => chain.upright_position(&q, work),
            });
            chain::write_joints(&order, &found.map_err(failed)?, out);
            Ok(())
        })
    }

    fn __repr__(&self) -> String {
        let sizes = self.chain().sizes();
        format!("<upswing.Model of {} joints, {} of them actuated>", sizes.joints(), sizes.actuated())
    }
}
