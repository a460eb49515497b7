//! The simulated plant: its state, and its step of one control period.

use crate::drives::{DriveCommand, Drives};
use crate::encoders::Encoders;
use crate::faults::{Faults, Reading, SetEventError, check_room};
use crate::mechanism::{ExternalLoad, Mechanism, TipForce};
use crate::start::{StateError, check_state};
use upswing_config::{Config, Fault, Push, RobotSettings};
use upswing_ipc::{Clock, Command, Measurement};
use upswing_model::{ActuatedVector, JointVector, Model, Order, Period};

/// Simulated robot with drives, encoders, brakes and faults.
///
/// While the brakes are released the state obeys M(q) qdd + C(q, qd) qd + g(q) = tau - friction + stops + external load (1).
/// Brakes that hold decelerate the actuated joints by u = qdd_A = -qd_A / time constant; the unactuated ones then obey (3a), less
/// their friction.
/// Torques are constant over a control period, which the classical Runge-Kutta method integrates in `substeps` steps.
///
/// Equal settings, commands and calls give bit-equal states: there is no clock and no I/O, noise depends on its seed alone.
/// After construction only [`Plant::set_fault`] and [`Plant::push`] allocate.
#[derive(Clone, Debug)]
pub struct Plant {
    robot: RobotSettings,
    mechanism: Mechanism,
    drives: Drives,
    encoders: Encoders,
    faults: Faults,
    pushes: Vec<Push>,
    period: Period,
    /// Number of the present cycle, which the next step completes.
    seq: u64,
}

impl Plant {
    /// The model of the simulated bodies and rotors: that of their URDF with the differences of `plant.model` in the settings.
    pub fn model(config: &Config) -> Model {
        let differences = &config.plant.model;
        let urdf = &config.plant_model;
        urdf.with_scaled_masses(differences.actuated_mass_scale, differences.unactuated_mass_scale)
            .with_scaled_rod_length(differences.unactuated_length_scale)
            .with_payload(differences.payload, differences.payload_position.into())
            .with_rotors(&differences.rotor_inertia)
    }

    /// A plant at rest in the start pose of the settings, with closed brakes, before cycle 1.
    ///
    /// # Errors
    /// [`StateError`] if the pose is outside the limits, or the pendulum has no rest position within its limits there.
    pub fn new(config: &Config) -> Result<Self, StateError> {
        let start = &config.plant.start;
        let model = Self::model(config);
        let x = config.start_state_of(&model, &start.q, start.pendulum)?;
        Self::at(config, &x.q(), &x.qd())
    }

    /// A plant in a given state (q in rad or m, qd in rad/s or m/s, joint frames), with closed brakes, before cycle 1.
    ///
    /// # Errors
    /// [`StateError`] with the first joint that is not a number or outside its limits.
    pub fn at(config: &Config, q: &JointVector, qd: &JointVector) -> Result<Self, StateError> {
        let model = Self::model(config);
        check_state(&model, &config.robot, q, qd)?;
        let settings = &config.plant;
        let period = config.daemon.cycle.period;
        let mut plant = Self {
            robot: config.robot.clone(),
            mechanism: Mechanism::new(config, model, q, qd),
            drives: Drives::new(&settings.drive, &config.robot.limits.tau_max, period),
            encoders: Encoders::new(&settings.encoder),
            faults: Faults::new(&settings.faults, q.sizes()),
            pushes: settings.pushes.clone(),
            period,
            seq: 1,
        };
        plant.sense();
        Ok(plant)
    }

    /// Puts the plant into a given state (q in rad or m, qd in rad/s or m/s, joint frames), and clears a drive fault and the peaks of the
    /// torques. Cycle numbers continue. The closed brakes stop an arm that moves.
    ///
    /// # Errors
    /// [`StateError::BrakesReleased`], or as [`Plant::at`]; nothing changes then.
    pub fn reset(&mut self, q: &JointVector, qd: &JointVector) -> Result<(), StateError> {
        if !self.brakes_closed() {
            return Err(StateError::BrakesReleased);
        }
        check_state(&self.mechanism.model, &self.robot, q, qd)?;
        (self.mechanism.q, self.mechanism.qd) = (*q, *qd);
        self.drives.reset();
        self.sense();
        Ok(())
    }

    /// The measurement that the daemon receives in the present cycle.
    ///
    /// Angles have bias and noise and are rounded to the encoders' resolution. Torques are those of the drives in the last
    /// period; while the brakes hold the arm at rest, those of the load, as measured by sensors on the link side (0 while the arm
    /// still moves, and under a drive fault). The time is simulated, `seq` * period, the clock `lockstep`. Under a
    /// fault of the transmission it may be an earlier measurement, or that of the last cycle again: see its `seq`.
    pub fn measure(&self) -> Measurement {
        let Reading { seq, t_ns, q, tau, status } = self.faults.show(self.seq);
        Measurement {
            seq,
            t_ns,
            status,
            clock: Clock::Lockstep.code(),
            period_ns: self.period.nanos(),
            ..Measurement::new(self.order(), &q, &tau)
        }
    }

    /// Advances the plant by one control period under `command`; `None` if the daemon sent no new command.
    ///
    /// The drives follow the newest command until none has arrived for `drive.watchdog_cycles`: then, and before the first
    /// command, the brakes are closed. The drives limit each torque to 100 % of its limit and report that. A torque that is
    /// not a number, or a command for another chain, is a drive fault, which closes the brakes until a command closes them, too.
    /// Number and age of the command are not checked.
    pub fn step(&mut self, command: Option<&Command>) {
        let command = command.filter(|_| !self.faults.loses_command(self.seq));
        self.faults.end(self.seq);
        let sizes = self.order().sizes();
        let command = command
            .map(|command| DriveCommand { tau: command.torque(sizes).ok(), brake: command.brake != 0 });
        let actuation = self.drives.step(self.seq, command);
        let external = self.external_load();
        if self.mechanism.advance(&actuation, &external).is_none() {
            // The integration diverged: the last finite state stays, at rest.
            self.mechanism.qd = JointVector::zeros(self.mechanism.qd.sizes());
            self.drives.fail();
        }
        self.seq = self.seq.saturating_add(1);
        self.sense();
    }

    /// Adds a fault that begins in the present cycle, if the cycle was not measured yet, or in a later cycle.
    ///
    /// # Errors
    /// [`SetEventError`] if its numbers are impossible, it begins too early, or there are too many faults.
    pub fn set_fault(&mut self, fault: &Fault) -> Result<(), SetEventError> {
        self.faults.add(fault, self.seq)
    }

    /// Removes all faults, also those of the settings.
    pub fn clear_faults(&mut self) {
        self.faults.clear();
    }

    /// Adds a push on the tip of the rod that begins in the present or in a later cycle.
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

    /// Number of the present cycle, which [`Plant::measure`] measures and the next step completes; counts from 1.
    pub fn seq(&self) -> u64 {
        self.seq
    }

    /// Number of the last complete cycle; 0 before the first.
    pub fn completed(&self) -> u64 {
        self.seq.saturating_sub(1)
    }

    /// Simulated time of the present cycle, ns.
    pub fn time_ns(&self) -> u64 {
        self.period.nanos_of(self.seq)
    }

    /// The index sets A and U of the chain.
    pub fn order(&self) -> &Order {
        self.mechanism.model.order()
    }

    /// True joint positions q, joint frames, rad or m.
    pub fn position(&self) -> &JointVector {
        &self.mechanism.q
    }

    /// True joint velocities qd, joint frames, rad/s or m/s.
    pub fn velocity(&self) -> &JointVector {
        &self.mechanism.qd
    }

    /// Whether the brakes held the arm in the last control period.
    pub fn brakes_closed(&self) -> bool {
        self.drives.brakes_hold()
    }

    /// Whether the drives are in fault.
    pub fn drive_fault(&self) -> bool {
        self.drives.fault()
    }

    /// Largest magnitude of each drive's torque or force since the start or the last reset, N m or N.
    pub fn tau_peak(&self) -> &ActuatedVector {
        self.drives.tau_peak()
    }

    /// Control period T_s.
    pub fn period(&self) -> Period {
        self.period
    }

    /// Computes and stores the true measurement of the present cycle.
    fn sense(&mut self) {
        let bit = |set: bool, bit: u64| if set { bit } else { 0 };
        let external = self.external_load();
        let load = if self.brakes_closed() && !self.drive_fault() {
            self.mechanism.held_load(&external)
        } else {
            None
        };
        self.faults.measured(Reading {
            seq: self.seq,
            t_ns: self.time_ns(),
            q: self.encoders.read(&self.mechanism.q),
            tau: load.as_ref().map_or(*self.drives.tau(), |load| self.drives.sensed_load(load)),
            status: bit(self.brakes_closed(), Measurement::BRAKES_CLOSED)
                | bit(self.drives.ready(), Measurement::DRIVES_READY)
                | bit(self.drives.saturated(), Measurement::SATURATED)
                | bit(self.drive_fault(), Measurement::DRIVE_FAULT)
                | bit(load.is_some(), Measurement::LOAD_SENSED),
        });
    }

    /// External load of pushes and faults in the present cycle.
    fn external_load(&self) -> ExternalLoad {
        ExternalLoad { tip_force: self.tip_force(), joint_torque: self.faults.torque(self.seq) }
    }

    /// Force of all pushes in the present cycle, world frame, N; `None` without a push.
    fn tip_force(&self) -> Option<TipForce> {
        self.pushes.iter().filter(|push| push.acts(self.seq)).fold(None, |sum: Option<TipForce>, push| {
            let sum = sum.unwrap_or_default();
            let time = self.period.seconds_of(push.cycles);
            Some(std::array::from_fn(|i| sum[i] + push.impulse[i] / time))
        })
    }
}
