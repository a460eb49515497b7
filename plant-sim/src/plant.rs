//! The physics: one control period per step.

use crate::start::{StateError, check_state};
use upswing_config::{Config, EncoderSettings, FrictionSettings, RobotSettings};
use upswing_ipc::{Clock, Command, Measurement};
use upswing_model::{
    ActuatedVector, JointVector, Model, N_ACTUATED, N_UNACTUATED, NQ, NU, UnactuatedVector, Workspace,
    position, velocity,
};

/// Speed below which a braked joint stands still, rad/s.
const STANDSTILL: f64 = 1e-6;

/// Robot, pendulum, drives, encoders and brakes at one moment.
///
/// The state obeys M(q) qdd + C(q, qd) qd + g(q) = tau - friction (1) while the brakes are released. Closed, they
/// decelerate the arm by u = qdd_A = -qd_A / time constant, and the pendulum follows (3a), less its friction. Torques
/// are constant over a period, which classical Runge-Kutta crosses in `substeps` steps.
///
/// Equal inputs give bit-equal states: there is no clock, no random number and no I/O, and after construction
/// nothing is allocated. Joint stops are not simulated: neither those of the arm nor that of q9, which passes its
/// limit unhindered.
#[derive(Clone, Debug)]
pub struct Plant {
    model: Model,
    robot: RobotSettings,
    encoder: EncoderSettings,
    friction: Friction,
    /// s, at least one integration step: the integration must resolve it.
    brake_time_constant: f64,
    substeps: u32,
    /// Length of an integration step, s.
    step: f64,
    period_ns: u64,
    /// Number of the cycle that the next step completes.
    seq: u64,
    q: JointVector,
    qd: JointVector,
    /// Torque of the drives in the last period, N m.
    tau: ActuatedVector,
    tau_peak: ActuatedVector,
    brakes_closed: bool,
    saturated: bool,
    drive_fault: bool,
    work: Workspace,
}

impl Plant {
    /// At standstill in the start pose of the settings, brakes closed, before cycle 1.
    ///
    /// # Errors
    /// [`StateError`] if the pose is outside the limits or the pendulum has no rest there inside its own.
    pub fn new(config: &Config) -> Result<Self, StateError> {
        let start = &config.plant.start;
        let x = config.start_state(&start.q, start.pendulum)?;
        Self::at(config, &position(&x), &velocity(&x))
    }

    /// In a state of choice (q in rad, qd in rad/s, joint frames), brakes closed, before cycle 1.
    ///
    /// # Errors
    /// [`StateError`] naming the first joint that is not a number or outside its limits.
    pub fn at(config: &Config, q: &JointVector, qd: &JointVector) -> Result<Self, StateError> {
        check_state(&config.robot, q, qd)?;
        let settings = &config.plant;
        let period = config.daemon.cycle.period;
        let step = period.as_secs_f64() / f64::from(settings.substeps);
        Ok(Self {
            model: config.model.clone(),
            robot: config.robot.clone(),
            encoder: settings.encoder,
            friction: Friction::new(&settings.friction),
            brake_time_constant: settings.drive.brake_time_constant.max(step),
            substeps: settings.substeps,
            step,
            period_ns: u64::try_from(period.as_nanos()).unwrap_or(u64::MAX),
            seq: 1,
            q: *q,
            qd: *qd,
            tau: ActuatedVector::zeros(),
            tau_peak: ActuatedVector::zeros(),
            brakes_closed: true,
            saturated: false,
            drive_fault: false,
            work: Workspace::default(),
        })
    }

    /// Puts the plant into a state of choice (q in rad, qd in rad/s, joint frames); also clears a drive fault and the
    /// peaks of the torques. The cycle number goes on. Closed brakes stop an arm that moves.
    ///
    /// # Errors
    /// [`StateError::BrakesReleased`], or as [`Plant::at`]; nothing changes then.
    pub fn reset(&mut self, q: &JointVector, qd: &JointVector) -> Result<(), StateError> {
        if !self.brakes_closed {
            return Err(StateError::BrakesReleased);
        }
        check_state(&self.robot, q, qd)?;
        (self.q, self.qd) = (*q, *qd);
        self.tau = ActuatedVector::zeros();
        self.tau_peak = ActuatedVector::zeros();
        self.saturated = false;
        self.drive_fault = false;
        Ok(())
    }

    /// What encoders and drives report in this cycle. Angles are multiples of the encoders' resolution, torques are
    /// those of the drives in the last period (none while the brakes are closed), time is simulated:
    /// `seq` * period, clock `lockstep`.
    pub fn measure(&self) -> Measurement {
        let mut q = [0.0; NQ];
        for i in 0..NQ {
            let actuated = i < N_ACTUATED;
            let resolution =
                if actuated { self.encoder.arm_resolution } else { self.encoder.pendulum_resolution };
            q[i] = (self.q[i] / resolution).round() * resolution;
        }
        let bit = |set: bool, bit: u64| if set { bit } else { 0 };
        Measurement {
            seq: self.seq,
            t_ns: self.seq.saturating_mul(self.period_ns),
            q,
            tau_measured: self.tau.into(),
            status: bit(self.brakes_closed, Measurement::BRAKES_CLOSED)
                | bit(!self.drive_fault, Measurement::DRIVES_READY)
                | bit(self.saturated, Measurement::SATURATED)
                | bit(self.drive_fault, Measurement::DRIVE_FAULT),
            clock: Clock::Lockstep.code(),
            period_ns: self.period_ns,
        }
    }

    /// Advances one control period under `command`; without one the brakes are closed.
    ///
    /// Drives cut each torque to 100 % of its limit and say so. A torque that is not a number is a drive fault, which
    /// closes the brakes until a command closes them too. Sequence and age of the command are not looked at.
    pub fn step(&mut self, command: Option<&Command>) {
        let torque = self.drive(command);
        self.brakes_closed = torque.is_none();
        self.tau = torque.unwrap_or_default();
        self.tau_peak = self.tau_peak.sup(&self.tau.abs());
        for _ in 0..self.substeps {
            if self.integrate(torque.as_ref()).is_none() {
                // The numbers ran away: hold the last state that was one.
                self.qd = JointVector::zeros();
                self.brakes_closed = true;
                self.drive_fault = true;
                break;
            }
        }
        self.seq = self.seq.saturating_add(1);
    }

    /// Number of the cycle that [`Plant::measure`] reports and the next step completes; counts from 1.
    pub fn seq(&self) -> u64 {
        self.seq
    }

    /// True joint positions q, joint frames, rad.
    pub fn position(&self) -> &JointVector {
        &self.q
    }

    /// True joint velocities qd, joint frames, rad/s.
    pub fn velocity(&self) -> &JointVector {
        &self.qd
    }

    /// Whether the brakes held the arm in the last period.
    pub fn brakes_closed(&self) -> bool {
        self.brakes_closed
    }

    /// Whether the drives report a fault.
    pub fn drive_fault(&self) -> bool {
        self.drive_fault
    }

    /// Largest magnitude of each drive's torque since the start or the last reset, N m.
    pub fn tau_peak(&self) -> &ActuatedVector {
        &self.tau_peak
    }

    /// Control period, ns.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The torque of the drives under a command, N m; None with closed brakes.
    fn drive(&mut self, command: Option<&Command>) -> Option<ActuatedVector> {
        self.saturated = false;
        let command = command?;
        if !command.tau.iter().all(|tau| tau.is_finite()) {
            self.drive_fault = true;
        } else if command.brake != 0 {
            self.drive_fault = false;
        }
        if self.drive_fault || command.brake != 0 {
            return None;
        }
        let mut torque = ActuatedVector::from(command.tau);
        for i in 0..NU {
            let max = self.robot.limits.tau_max[i];
            self.saturated |= torque[i].abs() > max;
            torque[i] = torque[i].clamp(-max, max);
        }
        Some(torque)
    }

    /// One step of classical Runge-Kutta under a torque of the drives or, without one, with closed brakes. None, and
    /// nothing done, if the result is not a number.
    fn integrate(&mut self, torque: Option<&ActuatedVector>) -> Option<()> {
        let h = self.step;
        let (q, v1) = (self.q, self.qd);
        let a1 = self.acceleration(&q, &v1, torque)?;
        let v2 = v1 + a1 * (0.5 * h);
        let a2 = self.acceleration(&(q + v1 * (0.5 * h)), &v2, torque)?;
        let v3 = v1 + a2 * (0.5 * h);
        let a3 = self.acceleration(&(q + v2 * (0.5 * h)), &v3, torque)?;
        let v4 = v1 + a3 * h;
        let a4 = self.acceleration(&(q + v3 * h), &v4, torque)?;
        let q = q + (v1 + (v2 + v3) * 2.0 + v4) * (h / 6.0);
        let mut qd = v1 + (a1 + (a2 + a3) * 2.0 + a4) * (h / 6.0);
        if !q.iter().chain(qd.iter()).all(|v| v.is_finite()) {
            return None;
        }
        if torque.is_none() {
            for i in 0..N_ACTUATED {
                if qd[i].abs() < STANDSTILL {
                    qd[i] = 0.0;
                }
            }
        }
        (self.q, self.qd) = (q, qd);
        Some(())
    }

    /// qdd, rad/s^2.
    fn acceleration(
        &mut self,
        q: &JointVector,
        qd: &JointVector,
        torque: Option<&ActuatedVector>,
    ) -> Option<JointVector> {
        let friction = self.friction.torque(qd);
        let Some(torque) = torque else { return self.braked_acceleration(q, qd, &friction) };
        let mut tau = -friction;
        for i in 0..N_ACTUATED {
            tau[i] += torque[i];
        }
        self.model.forward_dynamics(q, qd, &tau, &mut self.work)
    }

    /// qdd = [u, qdd_U] with u = -qd_A / time constant: (3a) with the friction of the pendulum (N m),
    /// M_UU qdd_U = -(M_UA u + C_U qd + g_U) - friction_U.
    fn braked_acceleration(
        &mut self,
        q: &JointVector,
        qd: &JointVector,
        friction: &JointVector,
    ) -> Option<JointVector> {
        let mut qdd = JointVector::zeros();
        for i in 0..N_ACTUATED {
            qdd[i] = -qd[i] / self.brake_time_constant;
        }
        let force = self.model.inverse_dynamics(q, qd, &qdd, &mut self.work) + friction;
        let mass = self.model.mass_matrix(q, &mut self.work);
        let mass_u = mass.fixed_view::<N_UNACTUATED, N_UNACTUATED>(N_ACTUATED, N_ACTUATED).into_owned();
        let force_u: UnactuatedVector = force.fixed_rows::<N_UNACTUATED>(N_ACTUATED).into();
        qdd.fixed_rows_mut::<N_UNACTUATED>(N_ACTUATED).copy_from(&-mass_u.cholesky()?.solve(&force_u));
        Some(qdd)
    }
}

/// Torque against the motion, viscous qd + coulomb tanh(qd / smoothing), of what the drives do not remove.
#[derive(Clone, Debug)]
struct Friction {
    /// N m s/rad
    viscous: JointVector,
    /// N m
    coulomb: JointVector,
    /// rad/s
    smoothing: f64,
}

impl Friction {
    fn new(settings: &FrictionSettings) -> Self {
        let felt = 1.0 - settings.arm_compensation;
        let join = |arm: &[f64; NU], pendulum: &[f64; N_UNACTUATED]| {
            JointVector::from_fn(|i, _| if i < N_ACTUATED { felt * arm[i] } else { pendulum[i - N_ACTUATED] })
        };
        Self {
            viscous: join(&settings.arm_viscous, &settings.pendulum_viscous),
            coulomb: join(&settings.arm_coulomb, &settings.pendulum_coulomb),
            smoothing: settings.coulomb_smoothing,
        }
    }

    /// N m
    fn torque(&self, qd: &JointVector) -> JointVector {
        JointVector::from_fn(|i, _| {
            self.viscous[i] * qd[i] + self.coulomb[i] * (qd[i] / self.smoothing).tanh()
        })
    }
}
