//! The physics: one control period per step.

use crate::body::{Body, Force, Outside};
use crate::drives::Drives;
use crate::encoders::Encoders;
use crate::faults::{Faults, SetEventError, check_room};
use crate::start::{StateError, check_state};
use upswing_config::{Config, Fault, Push, RobotSettings};
use upswing_ipc::{Clock, Command, Measurement};
use upswing_model::{ActuatedVector, JointVector, NU, Period, position, velocity};

/// Robot, pendulum, drives, encoders and brakes at one moment.
///
/// The state obeys M(q) qdd + C(q, qd) qd + g(q) = tau - friction + stops + what acts from outside (1) while the brakes are released. When
/// they hold, they decelerate the arm by u = qdd_A = -qd_A / time constant, and the pendulum follows (3a), less its
/// friction. Torques are constant over a period, which classical Runge-Kutta crosses in `substeps` steps.
///
/// Equal settings, commands and calls give bit-equal states: there is no clock and no I/O, noise depends on its seed,
/// and after construction only [`Plant::set_fault`] and [`Plant::push`] allocate.
#[derive(Clone, Debug)]
pub struct Plant {
    robot: RobotSettings,
    body: Body,
    drives: Drives,
    encoders: Encoders,
    faults: Faults,
    pushes: Vec<Push>,
    period: Period,
    /// Number of the cycle that the next step completes.
    seq: u64,
}

impl Plant {
    /// At standstill in the start pose of the settings, brakes closed, before cycle 1.
    ///
    /// # Errors
    /// [`StateError`] if the pose is outside the limits or the pendulum has no rest there inside its own.
    pub fn new(config: &Config) -> Result<Self, StateError> {
        let start = &config.plant.start;
        let model = config.plant.model.apply(&config.plant_model);
        let x = config.start_state_of(&model, &start.q, start.pendulum)?;
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
        let model = settings.model.apply(&config.plant_model);
        let mut plant = Self {
            robot: config.robot.clone(),
            body: Body::new(config, model, q, qd),
            drives: Drives::new(&settings.drive, &config.robot.limits.tau_max, period),
            encoders: Encoders::new(&settings.encoder),
            faults: Faults::new(&settings.faults),
            pushes: settings.pushes.clone(),
            period,
            seq: 1,
        };
        plant.sense();
        Ok(plant)
    }

    /// Puts the plant into a state of choice (q in rad, qd in rad/s, joint frames); also clears a drive fault and the
    /// peaks of the torques. The cycle number goes on. Closed brakes stop an arm that moves.
    ///
    /// # Errors
    /// [`StateError::BrakesReleased`], or as [`Plant::at`]; nothing changes then.
    pub fn reset(&mut self, q: &JointVector, qd: &JointVector) -> Result<(), StateError> {
        if !self.brakes_closed() {
            return Err(StateError::BrakesReleased);
        }
        check_state(&self.robot, q, qd)?;
        (self.body.q, self.body.qd) = (*q, *qd);
        self.drives.reset();
        self.sense();
        Ok(())
    }

    /// What the daemon finds in this cycle: angles with bias and noise, rounded to the encoders' resolution; torques of
    /// the drives in the last period, with brakes that hold the arm at rest those of the load, as sensors on the side of the
    /// links show them (none while it still moves, and under a drive fault); simulated time, `seq` * period; clock
    /// `lockstep`. Under a fault on the way it may be another measurement or the one of the last cycle again, which its
    /// `seq` tells.
    pub fn measure(&self) -> Measurement {
        self.faults.show(self.seq)
    }

    /// Advances one control period under `command`; None if the daemon sent no new one.
    ///
    /// The drives follow the last command that arrived, until for `drive.watchdog_cycles` none has: then, and before the
    /// first one, the brakes are closed. They cut each torque to 100 % of its limit and say so. A torque that is not a
    /// number is a drive fault, which closes the brakes until a command closes them too. Sequence and age of the
    /// command are not looked at.
    pub fn step(&mut self, command: Option<&Command>) {
        let command = command.filter(|_| !self.faults.loses_command(self.seq));
        self.faults.end(self.seq);
        let action = self.drives.step(self.seq, command);
        let outside = self.outside();
        if self.body.advance(&action, &outside).is_none() {
            // The numbers ran away: hold the last state that was one.
            self.body.qd = JointVector::zeros();
            self.drives.fail();
        }
        self.seq = self.seq.saturating_add(1);
        self.sense();
    }

    /// Adds a fault from the cycle [`Plant::seq`] on, which must not have been measured yet, or from a later one.
    ///
    /// # Errors
    /// [`SetEventError`]: it cannot be, begins too early, or there are too many.
    pub fn set_fault(&mut self, fault: &Fault) -> Result<(), SetEventError> {
        self.faults.add(fault, self.seq)
    }

    /// Removes all faults.
    pub fn clear_faults(&mut self) {
        self.faults.clear();
    }

    /// Adds a push from the cycle [`Plant::seq`] or a later one on.
    ///
    /// # Errors
    /// As [`Plant::set_fault`].
    pub fn push(&mut self, push: &Push) -> Result<(), SetEventError> {
        push.check()?;
        let next = self.seq;
        self.pushes.retain(|push| push.from.saturating_add(push.cycles) > next);
        check_room(self.pushes.len(), next, push.from)?;
        self.pushes.push(*push);
        Ok(())
    }

    /// Number of the cycle that [`Plant::measure`] reports and the next step completes; counts from 1.
    pub fn seq(&self) -> u64 {
        self.seq
    }

    /// True joint positions q, joint frames, rad.
    pub fn position(&self) -> &JointVector {
        &self.body.q
    }

    /// True joint velocities qd, joint frames, rad/s.
    pub fn velocity(&self) -> &JointVector {
        &self.body.qd
    }

    /// Whether the brakes held the arm in the last period.
    pub fn brakes_closed(&self) -> bool {
        self.drives.brakes_hold()
    }

    /// Whether the drives report a fault.
    pub fn drive_fault(&self) -> bool {
        self.drives.fault()
    }

    /// Largest magnitude of each drive's torque since the start or the last reset, N m.
    pub fn tau_peak(&self) -> &ActuatedVector {
        self.drives.tau_peak()
    }

    /// Control period T_s.
    pub fn period(&self) -> Period {
        self.period
    }

    /// Takes the measurement of this cycle.
    fn sense(&mut self) {
        let bit = |set: bool, bit: u64| if set { bit } else { 0 };
        let outside = self.outside();
        let load =
            if self.brakes_closed() && !self.drive_fault() { self.body.held_load(&outside) } else { None };
        let tau: [f64; NU] =
            load.as_ref().map_or(*self.drives.tau(), |load| self.drives.show_load(load)).into();
        self.faults.measured(Measurement {
            seq: self.seq,
            t_ns: self.period.nanos_of(self.seq),
            q: self.encoders.read(&self.body.q),
            tau_measured: tau,
            status: bit(self.brakes_closed(), Measurement::BRAKES_CLOSED)
                | bit(!self.drive_fault(), Measurement::DRIVES_READY)
                | bit(self.drives.saturated(), Measurement::SATURATED)
                | bit(self.drive_fault(), Measurement::DRIVE_FAULT)
                | bit(load.is_some(), Measurement::LOAD_SENSED),
            clock: Clock::Lockstep.code(),
            period_ns: self.period.nanos(),
        });
    }

    /// What acts on the bodies in this cycle.
    fn outside(&self) -> Outside {
        Outside { force: self.force(), torque: self.faults.torque(self.seq) }
    }

    /// All pushes of this cycle together, N.
    fn force(&self) -> Option<Force> {
        self.pushes.iter().filter(|push| push.acts(self.seq)).fold(None, |sum: Option<Force>, push| {
            let sum = sum.unwrap_or_default();
            let time = self.period.seconds_of(push.cycles);
            Some(std::array::from_fn(|i| sum[i] + push.impulse[i] / time))
        })
    }
}
