//! Drives: what becomes of a command until it is torque on the joints, and when the brakes close.

use upswing_config::{DriveSettings, MAX_DELAY};
use upswing_ipc::Command;
use upswing_model::{ActuatedVector, NU, Period};

/// Places for commands on their way, with the one that arrives.
const LINE: usize = MAX_DELAY as usize + 1;

/// What the drives do to the actuated joints for one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Action {
    /// Released brakes and this torque on the joints, N m.
    Torque(ActuatedVector),
    /// Closed brakes.
    Brakes,
}

/// The drives and brakes of joints 1 to 7.
#[derive(Clone, Debug)]
pub(crate) struct Drives {
    tau_max: ActuatedVector,
    offset: ActuatedVector,
    /// Share of the way to the commanded torque that one period covers.
    approach: f64,
    watchdog_cycles: u32,
    engage_cycles: u64,
    delay: usize,
    /// Commands on their way, a ring.
    line: [Option<Command>; LINE],
    /// The command in force, and cycles since it came.
    held: Option<Command>,
    age: u32,
    /// Cycles until closing brakes hold.
    engaging: u64,
    /// Torque that the sensors show, N m.
    tau: ActuatedVector,
    tau_peak: ActuatedVector,
    braking: bool,
    saturated: bool,
    fault: bool,
}

impl Drives {
    /// Drives with closed brakes. `tau_max`: the torque limits, N m.
    pub(crate) fn new(settings: &DriveSettings, tau_max: &ActuatedVector, period: Period) -> Self {
        let lag = settings.torque_lag;
        Self {
            tau_max: *tau_max,
            offset: settings.torque_offset.into(),
            approach: if lag > 0.0 { -(-period.seconds() / lag).exp_m1() } else { 1.0 },
            watchdog_cycles: settings.watchdog_cycles,
            engage_cycles: period.nearest_cycles(settings.brake_engage),
            delay: settings.command_delay as usize,
            line: [None; LINE],
            held: None,
            age: 0,
            engaging: 0,
            tau: ActuatedVector::zeros(),
            tau_peak: ActuatedVector::zeros(),
            braking: true,
            saturated: false,
            fault: false,
        }
    }

    /// Forgets torques, their peaks and a fault.
    pub(crate) fn reset(&mut self) {
        self.tau = ActuatedVector::zeros();
        self.tau_peak = ActuatedVector::zeros();
        self.saturated = false;
        self.fault = false;
    }

    /// What happens in period `seq` when `command` is sent, or none.
    pub(crate) fn step(&mut self, seq: u64, command: Option<&Command>) -> Action {
        self.line[place(seq)] = command.copied();
        let delay = self.delay as u64;
        let arrived = if seq > delay { self.line[place(seq - delay)].take() } else { None };
        match arrived {
            Some(command) => (self.held, self.age) = (Some(command), 0),
            None => self.age = self.age.saturating_add(1),
        }
        if self.age >= self.watchdog_cycles {
            self.held = None;
        }
        match self.demanded() {
            Some(demanded) => Action::Torque(self.follow(&demanded)),
            None => self.brake(),
        }
    }

    /// After numbers that ran away: brakes until a command closes them too.
    pub(crate) fn fail(&mut self) {
        self.fault = true;
        self.braking = true;
        self.engaging = 0;
    }

    /// What the sensors show of a load that the brakes hold, N m: less their offset, as of the drives' own torque.
    pub(crate) fn show_load(&self, load: &ActuatedVector) -> ActuatedVector {
        (load - self.offset).inf(&self.tau_max).sup(&-self.tau_max)
    }

    /// Torque that the sensors show of the drives, N m.
    pub(crate) fn tau(&self) -> &ActuatedVector {
        &self.tau
    }

    /// Largest magnitude of each since the start or the last reset, N m.
    pub(crate) fn tau_peak(&self) -> &ActuatedVector {
        &self.tau_peak
    }

    pub(crate) fn brakes_hold(&self) -> bool {
        self.braking && self.engaging == 0
    }

    pub(crate) fn saturated(&self) -> bool {
        self.saturated
    }

    pub(crate) fn fault(&self) -> bool {
        self.fault
    }

    /// The commanded torque within the limits, N m; None if the brakes have to be closed.
    fn demanded(&mut self) -> Option<ActuatedVector> {
        self.saturated = false;
        let command = self.held?;
        if !command.tau.iter().all(|tau| tau.is_finite()) {
            self.fault = true;
        } else if command.brake != 0 {
            self.fault = false;
        }
        if self.fault || command.brake != 0 {
            return None;
        }
        let mut torque = ActuatedVector::from(command.tau);
        for i in 0..NU {
            let max = self.tau_max[i];
            self.saturated |= torque[i].abs() > max;
            torque[i] = torque[i].clamp(-max, max);
        }
        Some(torque)
    }

    fn follow(&mut self, demanded: &ActuatedVector) -> ActuatedVector {
        // While the brakes hold, the torque loops have time to settle.
        if self.braking || self.approach >= 1.0 {
            self.tau = *demanded;
        } else {
            self.tau += (demanded - self.tau) * self.approach;
        }
        self.braking = false;
        self.tau_peak = self.tau_peak.sup(&self.tau.abs());
        self.tau + self.offset
    }

    fn brake(&mut self) -> Action {
        self.engaging = if self.braking { self.engaging.saturating_sub(1) } else { self.engage_cycles };
        self.braking = true;
        self.tau = ActuatedVector::zeros();
        if self.engaging == 0 { Action::Brakes } else { Action::Torque(self.tau) }
    }
}

/// Place of a cycle in a ring of [`LINE`].
fn place(seq: u64) -> usize {
    (seq % LINE as u64) as usize
}
