//! The mechanism of arm and pendulum: dynamics (1) with friction, stops, brakes and external loads, and its integration.

use crate::drives::Actuation;
use upswing_config::{Config, FrictionSettings, JointStopSettings};
use upswing_model::thresholds::REST_SPEED_BRAKED;
use upswing_model::{
    ActuatedVector, JointParts, JointVector, Model, N_UNACTUATED, NU, State, StateParts, Workspace,
    runge_kutta_step, state,
};

/// A force on the tip of the rod, world frame, N.
pub(crate) type TipForce = [f64; 3];

/// External load on the mechanism, constant over a control period.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ExternalLoad {
    pub tip_force: Option<TipForce>,
    /// Torque on the joints, N m.
    pub joint_torque: Option<JointVector>,
}

/// Mechanism of arm and pendulum with its state and integrator.
#[derive(Clone, Debug)]
pub(crate) struct Mechanism {
    /// q, rad.
    pub q: JointVector,
    /// qd, rad/s.
    pub qd: JointVector,
    model: Model,
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
    /// Creates the mechanism in the state q (rad), qd (rad/s).
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
        let (x, h) = (state(&self.q, &self.qd), self.step);
        let derivative = |x: &State| {
            let (q, qd) = (x.q(), x.qd());
            let qdd = self.acceleration(&q, &qd, actuation, external).ok_or(())?;
            Ok::<_, ()>(state(&qd, &qdd))
        };
        let x = runge_kutta_step(&x, h, derivative).ok()?;
        if !x.iter().all(|v| v.is_finite()) {
            return None;
        }
        let (q, mut qd) = (x.q(), x.qd());
        if *actuation == Actuation::Brakes {
            for i in 0..NU {
                if qd[i].abs() < REST_SPEED_BRAKED {
                    qd[i] = 0.0;
                }
            }
        }
        (self.q, self.qd) = (q, qd);
        Some(())
    }

    /// Joint accelerations qdd at (q, qd), rad/s^2; `None` if the mass matrix cannot be factorised.
    fn acceleration(
        &mut self,
        q: &JointVector,
        qd: &JointVector,
        actuation: &Actuation,
        external: &ExternalLoad,
    ) -> Option<JointVector> {
        let mut load = self.passive_load(q, qd, external);
        let Actuation::Torque(torque) = actuation else { return self.braked_acceleration(q, qd, &load) };
        for i in 0..NU {
            load[i] += torque[i];
        }
        self.model.forward_dynamics(q, qd, &load, &mut self.work)
    }

    /// Torque of friction, stops and external load on the joints, N m.
    fn passive_load(&self, q: &JointVector, qd: &JointVector, external: &ExternalLoad) -> JointVector {
        let mut load = -self.friction.torque(qd);
        for i in 0..load.len() {
            load[i] += stop_torque(&self.stops, i, q[i], qd[i]);
        }
        if let Some(force) = external.tip_force {
            load += self.model.torque_of_tip_force(q, &force.into());
        }
        if let Some(torque) = &external.joint_torque {
            load += torque;
        }
        load
    }

    /// Torque with which closed brakes hold the arm at rest, N m; `None` while it moves.
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

    /// Accelerations with closed brakes, rad/s^2: qdd = [u, qdd_U], u = -qd_A / time constant, (3a) with the pendulum's load (N m),
    /// M_UU qdd_U = load_U - (M_UA u + C_U qd + g_U).
    fn braked_acceleration(
        &mut self,
        q: &JointVector,
        qd: &JointVector,
        load: &JointVector,
    ) -> Option<JointVector> {
        let mut qdd = JointVector::zeros();
        for i in 0..NU {
            qdd[i] = -qd[i] / self.brake_time_constant;
        }
        let force = self.model.inverse_dynamics(q, qd, &qdd, &mut self.work) - load;
        let mass = self.model.mass_matrix(q, &mut self.work);
        let mass_u = mass.fixed_view::<N_UNACTUATED, N_UNACTUATED>(NU, NU).into_owned();
        // nalgebra's factorisation: the model's own is written out for M of all joints, and M_UU has the unactuated ones.
        qdd.unactuated_mut().copy_from(&-mass_u.cholesky()?.solve(&force.unactuated()));
        Some(qdd)
    }
}

/// Torque of the mechanical stop of a joint (counted from 0), N m.
fn stop_torque(stops: &JointStopSettings, joint: usize, q: f64, qd: f64) -> f64 {
    let depth = q.abs() - stops.q[joint];
    if stops.stiffness[joint] == 0.0 || depth <= 0.0 {
        return 0.0;
    }
    let back = stops.stiffness[joint] * depth + stops.damping[joint] * qd * q.signum();
    -q.signum() * back.max(0.0)
}

/// Joint friction, viscous qd + coulomb tanh(qd / smoothing), less the share that the drives compensate.
#[derive(Clone, Debug)]
struct Friction {
    /// Viscous coefficients, N m s/rad.
    viscous: JointVector,
    /// Coulomb torques, N m.
    coulomb: JointVector,
    /// Speed over which the Coulomb torque changes its sign, rad/s.
    smoothing: f64,
}

impl Friction {
    fn new(settings: &FrictionSettings) -> Self {
        let residual = 1.0 - settings.arm_compensation;
        let join = |arm: &[f64; NU], pendulum: &[f64; N_UNACTUATED]| {
            JointVector::from_fn(|i, _| if i < NU { residual * arm[i] } else { pendulum[i - NU] })
        };
        Self {
            viscous: join(&settings.arm_viscous, &settings.pendulum_viscous),
            coulomb: join(&settings.arm_coulomb, &settings.pendulum_coulomb),
            smoothing: settings.coulomb_smoothing,
        }
    }

    /// Friction torque at velocities qd (rad/s), N m, with the sign of the velocity: it acts as -torque.
    fn torque(&self, qd: &JointVector) -> JointVector {
        JointVector::from_fn(|i, _| {
            let viscous = self.viscous[i] * qd[i];
            // No tanh where the Coulomb torque is fully compensated or 0.
            if self.coulomb[i] == 0.0 {
                return viscous;
            }
            viscous + self.coulomb[i] * (qd[i] / self.smoothing).tanh()
        })
    }
}
