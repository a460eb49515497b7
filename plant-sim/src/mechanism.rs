//! The mechanism of arm and pendulum: dynamics (1) with friction, stops, brakes and external loads, and its integration.

use crate::drives::Actuation;
use upswing_config::{Config, FrictionSettings, JointStopSettings};
use upswing_model::thresholds::REST_SPEED_BRAKED;
use upswing_model::{ActuatedVector, JointVector, Model, State, Workspace, runge_kutta_step};

/// A force on the tip of the last body, world frame, N.
pub(crate) type TipForce = [f64; 3];

/// External load on the mechanism, constant over a control period.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ExternalLoad {
    pub tip_force: Option<TipForce>,
    /// Torque or force on the joints, N m or N.
    pub joint_torque: Option<JointVector>,
}

/// Mechanism of arm and pendulum with its state and integrator.
#[derive(Clone, Debug)]
pub(crate) struct Mechanism {
    /// q, rad or m.
    pub q: JointVector,
    /// qd, rad/s or m/s.
    pub qd: JointVector,
    pub model: Model,
    friction: Friction,
    stops: JointStopSettings,
    /// Time constant of the brakes, s; at least one integration step, so that the integration resolves it.
    brake_time_constant: f64,
    substeps: u32,
    /// Length of an integration step, s.
    step: f64,
    work: Workspace,
}

impl Mechanism {
    /// Creates the mechanism in the state q (rad or m), qd (rad/s or m/s).
    pub(crate) fn new(config: &Config, model: Model, q: &JointVector, qd: &JointVector) -> Self {
        let settings = &config.plant;
        let step = config.daemon.cycle.period.seconds() / f64::from(settings.integrator.substeps);
        Self {
            q: *q,
            qd: *qd,
            model,
            friction: Friction::new(&settings.friction),
            stops: settings.stops,
            brake_time_constant: settings.drive.brake_time_constant.max(step),
            substeps: settings.integrator.substeps,
            step,
            work: Workspace::default(),
        }
    }

    /// Integrates one control period. `None` if the state diverges: its last finite value remains.
    pub(crate) fn advance(&mut self, actuation: &Actuation, external: &ExternalLoad) -> Option<()> {
        for _ in 0..self.substeps {
            self.integrate(actuation, external)?;
        }
        Some(())
    }

    /// One integration step.
    fn integrate(&mut self, actuation: &Actuation, external: &ExternalLoad) -> Option<()> {
        let (x, h) = (State::new(&self.q, &self.qd), self.step);
        let derivative = |x: &State| {
            let (q, qd) = (x.q(), x.qd());
            let qdd = self.acceleration(&q, &qd, actuation, external).ok_or(())?;
            Ok::<_, ()>(State::new(&qd, &qdd))
        };
        let mut x = runge_kutta_step(&x, h, derivative).ok()?;
        if !x.iter().all(|v| v.is_finite()) {
            return None;
        }
        if *actuation == Actuation::Brakes {
            x.qd_a_mut().iter_mut().filter(|v| v.abs() < REST_SPEED_BRAKED).for_each(|v| *v = 0.0);
        }
        (self.q, self.qd) = (x.q(), x.qd());
        Some(())
    }

    /// Joint accelerations qdd at (q, qd), rad/s^2 or m/s^2; `None` if the mass matrix cannot be factorised.
    fn acceleration(
        &mut self,
        q: &JointVector,
        qd: &JointVector,
        actuation: &Actuation,
        external: &ExternalLoad,
    ) -> Option<JointVector> {
        let mut load = self.passive_load(q, qd, external);
        let Actuation::Torque(torque) = actuation else { return self.braked_acceleration(q, qd, &load) };
        load.actuated_mut().iter_mut().zip(torque.iter()).for_each(|(load, torque)| *load += torque);
        self.model.forward_dynamics(q, qd, &load, &mut self.work)
    }

    /// Torque or force of friction, stops and external load on the joints, N m or N.
    fn passive_load(&self, q: &JointVector, qd: &JointVector, external: &ExternalLoad) -> JointVector {
        let mut load = -self.friction.torque(qd);
        for (i, load) in load.iter_mut().enumerate() {
            *load += stop_torque(&self.stops, i, q[i], qd[i]);
        }
        if let Some(force) = external.tip_force {
            load += self.model.torque_of_tip_force(q, &force.into());
        }
        if let Some(torque) = &external.joint_torque {
            load += torque;
        }
        load
    }

    /// Torque or force with which closed brakes hold the actuated joints at rest, N m or N; `None` while they move.
    pub(crate) fn held_load(&mut self, external: &ExternalLoad) -> Option<ActuatedVector> {
        let (q, qd) = (self.q, self.qd);
        if qd.actuated().amax() != 0.0 {
            return None;
        }
        let load = self.passive_load(&q, &qd, external);
        let qdd = self.braked_acceleration(&q, &qd, &load)?;
        let force = self.model.inverse_dynamics(&q, &qd, &qdd, &mut self.work) - load;
        Some(force.actuated())
    }

    /// Accelerations with closed brakes, rad/s^2 or m/s^2: qdd = [u, qdd_U], u = -qd_A / time constant, (3a) with the load on the
    /// unactuated joints (N m or N), M_UU qdd_U = load_U - (M_UA u + C_U qd + g_U).
    fn braked_acceleration(
        &mut self,
        q: &JointVector,
        qd: &JointVector,
        load: &JointVector,
    ) -> Option<JointVector> {
        let mut qdd = JointVector::zeros(q.sizes());
        qdd.actuated_mut().copy_from_slice(&-(qd.actuated() / self.brake_time_constant));
        let force = self.model.inverse_dynamics(q, qd, &qdd, &mut self.work) - load;
        let mass_u = self.model.mass_matrix(q, &mut self.work).unactuated();
        qdd.unactuated_mut().copy_from_slice(&-mass_u.solve_positive(&force.unactuated())?);
        Some(qdd)
    }
}

/// Torque or force of the mechanical stop of a joint, by its index in q, N m or N.
fn stop_torque(stops: &JointStopSettings, joint: usize, q: f64, qd: f64) -> f64 {
    let (below, above) = (stops.q_min[joint] - q, q - stops.q_max[joint]);
    let (direction, depth) = if above > below { (1.0, above) } else { (-1.0, below) };
    if stops.stiffness[joint] == 0.0 || depth <= 0.0 {
        return 0.0;
    }
    let back = stops.stiffness[joint] * depth + stops.damping[joint] * qd * direction;
    -direction * back.max(0.0)
}

/// Joint friction, viscous qd + coulomb tanh(qd / smoothing), less the share that the drives compensate.
#[derive(Clone, Debug)]
struct Friction {
    /// Viscous coefficients, N m s/rad or N s/m.
    viscous: JointVector,
    /// Coulomb torques or forces, N m or N.
    coulomb: JointVector,
    /// Speed over which the Coulomb torque changes its sign, rad/s or m/s.
    smoothing: f64,
}

impl Friction {
    fn new(settings: &FrictionSettings) -> Self {
        let residual = |friction: &JointVector| {
            let actuated = friction.actuated() * (1.0 - settings.compensation);
            JointVector::joined(&actuated, &friction.unactuated())
        };
        Self {
            viscous: residual(&settings.viscous),
            coulomb: residual(&settings.coulomb),
            smoothing: settings.coulomb_smoothing,
        }
    }

    /// Friction at velocities qd (rad/s or m/s), N m or N, with the sign of the velocity: it acts as -torque.
    fn torque(&self, qd: &JointVector) -> JointVector {
        JointVector::from_fn(qd.sizes(), |i| {
            let viscous = self.viscous[i] * qd[i];
            // No tanh where the Coulomb torque is fully compensated or 0.
            if self.coulomb[i] == 0.0 {
                return viscous;
            }
            viscous + self.coulomb[i] * libm::tanh(qd[i] / self.smoothing)
        })
    }
}
