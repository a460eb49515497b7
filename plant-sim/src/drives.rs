//! Drives and brakes of the arm: torque on the joints under a command, and closing of the brakes.

use upswing_config::{DriveSettings, MAX_DELAY};
use upswing_ipc::Command;
use upswing_model::{ActuatedVector, NU, Period};

/// Length of the delay line for commands.
const DELAY_LINE: usize = MAX_DELAY as usize + 1;

/// The actuation of the arm over one control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Actuation {
    /// Released brakes, with the torque on the actuated joints, N m.
    Torque(ActuatedVector),
    /// Closed brakes.
    Brakes,
}

/// The drives and brakes of the actuated joints.
#[derive(Clone, Debug)]
pub(crate) struct Drives {
    tau_max: ActuatedVector,
    offset: ActuatedVector,
    /// Share of the difference to the commanded torque that one period removes: first-order lag, discretised.
    lag_share: f64,
    watchdog_cycles: u32,
    engage_cycles: u64,
    delay: u64,
    /// Commands in transit, a ring buffer by cycle number.
    delay_line: [Option<Command>; DELAY_LINE],
    /// The newest command that has arrived, until the watchdog drops it.
    active: Option<Command>,
    /// Number of cycles since a command arrived.
    silent_cycles: u32,
    /// Whether a command was sent since power-up.
    commanded: bool,
    /// Number of cycles until closing brakes hold.
    engage_left: u64,
    /// Measured torque of the drives, N m.
    tau: ActuatedVector,
    tau_peak: ActuatedVector,
    /// Whether the brakes are commanded to close.
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
            lag_share: if lag > 0.0 { -(-period.seconds() / lag).exp_m1() } else { 1.0 },
            watchdog_cycles: settings.watchdog_cycles,
            engage_cycles: period.nearest_cycles(settings.brake_engage),
            delay: settings.command_delay.into(),
            delay_line: [None; DELAY_LINE],
            active: None,
            silent_cycles: 0,
            commanded: false,
            engage_left: 0,
            tau: ActuatedVector::zeros(),
            tau_peak: ActuatedVector::zeros(),
            braking: true,
            saturated: false,
            fault: false,
        }
    }

    /// Clears torques, their peaks and a fault.
    pub(crate) fn reset(&mut self) {
        self.tau = ActuatedVector::zeros();
        self.tau_peak = ActuatedVector::zeros();
        self.saturated = false;
        self.fault = false;
    }

    /// Advances by cycle `seq`, in which the daemon sends `command` (`None`: no command), and returns the actuation in it.
    pub(crate) fn step(&mut self, seq: u64, command: Option<&Command>) -> Actuation {
        self.commanded |= command.is_some();
        self.delay_line[slot(seq)] = command.copied();
        let arrived = if seq > self.delay { self.delay_line[slot(seq - self.delay)].take() } else { None };
        match arrived {
            Some(command) => (self.active, self.silent_cycles) = (Some(command), 0),
            None => self.silent_cycles = self.silent_cycles.saturating_add(1),
        }
        if self.silent_cycles >= self.watchdog_cycles {
            self.active = None;
        }
        match self.commanded_torque() {
            Some(commanded) => Actuation::Torque(self.apply(&commanded)),
            None => self.brake(),
        }
    }

    /// Sets a drive fault; the brakes hold at once. It lasts until a command closes the brakes.
    pub(crate) fn fail(&mut self) {
        self.fault = true;
        self.braking = true;
        self.engage_left = 0;
    }

    /// Measured torque of a load (N m) that the brakes hold, N m: less the offset of the sensors, within the torque limits.
    pub(crate) fn sensed_load(&self, load: &ActuatedVector) -> ActuatedVector {
        (load - self.offset).inf(&self.tau_max).sup(&-self.tau_max)
    }

    /// Measured torque of the drives, N m.
    pub(crate) fn tau(&self) -> &ActuatedVector {
        &self.tau
    }

    /// Largest magnitude of each drive's torque since the start or the last reset, N m.
    pub(crate) fn tau_peak(&self) -> &ActuatedVector {
        &self.tau_peak
    }

    pub(crate) fn brakes_hold(&self) -> bool {
        self.braking && self.engage_left == 0
    }

    /// Whether a drive limited the newest command.
    pub(crate) fn saturated(&self) -> bool {
        self.saturated
    }

    /// Whether the drives follow torque commands: a command was sent since power-up, and there is no drive fault.
    pub(crate) fn ready(&self) -> bool {
        self.commanded && !self.fault
    }

    pub(crate) fn fault(&self) -> bool {
        self.fault
    }

    /// The commanded torque within the limits, N m; `None` if the brakes have to close.
    fn commanded_torque(&mut self) -> Option<ActuatedVector> {
        self.saturated = false;
        let command = self.active?;
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

    /// Releases the brakes and returns the torque on the joints, N m: the commanded torque with lag, plus the offset.
    fn apply(&mut self, commanded: &ActuatedVector) -> ActuatedVector {
        // No lag in the first period: while the brakes hold, the torque loops settle.
        if self.braking || self.lag_share >= 1.0 {
            self.tau = *commanded;
        } else {
            self.tau += (commanded - self.tau) * self.lag_share;
        }
        self.braking = false;
        self.tau_peak = self.tau_peak.sup(&self.tau.abs());
        self.tau + self.offset
    }

    /// Closes the brakes; until they hold, the arm moves without torque.
    fn brake(&mut self) -> Actuation {
        self.engage_left = if self.braking { self.engage_left.saturating_sub(1) } else { self.engage_cycles };
        self.braking = true;
        self.tau = ActuatedVector::zeros();
        if self.engage_left == 0 { Actuation::Brakes } else { Actuation::Torque(self.tau) }
    }
}

/// Index of a cycle in the delay line.
fn slot(seq: u64) -> usize {
    (seq % DELAY_LINE as u64) as usize
}
