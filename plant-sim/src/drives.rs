//! Drives and brakes of the actuated joints: torque on the joints under a command, and closing of the brakes.

use upswing_config::{DriveSettings, MAX_DELAY};
use upswing_model::{ActuatedVector, Period};

/// Length of the delay line for commands.
const DELAY_LINE: usize = MAX_DELAY as usize + 1;

/// A command as the drives receive it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DriveCommand {
    /// Torques or forces of the actuated joints, N m or N; `None` if the command is for other numbers of joints.
    pub tau: Option<ActuatedVector>,
    /// Whether the brakes have to close.
    pub brake: bool,
}

/// The actuation over one control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Actuation {
    /// Released brakes, with the torques or forces on the actuated joints, N m or N.
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
    delay_line: [Option<DriveCommand>; DELAY_LINE],
    /// The newest command that has arrived, until the watchdog drops it.
    active: Option<DriveCommand>,
    /// Number of cycles since a command arrived.
    silent_cycles: u32,
    /// Whether a command was sent since power-up.
    commanded: bool,
    /// Number of cycles until closing brakes hold.
    engage_left: u64,
    /// Measured torques or forces of the drives, N m or N.
    tau: ActuatedVector,
    tau_peak: ActuatedVector,
    /// Whether the brakes are commanded to close.
    braking: bool,
    saturated: bool,
    fault: bool,
}

impl Drives {
    /// Drives with closed brakes. `tau_max`: the limits of their torques or forces, N m or N.
    pub(crate) fn new(settings: &DriveSettings, tau_max: &ActuatedVector, period: Period) -> Self {
        let lag = settings.torque_lag;
        let zero = ActuatedVector::zeros(tau_max.sizes());
        Self {
            tau_max: *tau_max,
            offset: settings.torque_offset,
            lag_share: if lag > 0.0 { -libm::expm1(-period.seconds() / lag) } else { 1.0 },
            watchdog_cycles: settings.watchdog_cycles,
            engage_cycles: period.nearest_cycles(settings.brake_engage),
            delay: settings.command_delay.into(),
            delay_line: [None; DELAY_LINE],
            active: None,
            silent_cycles: 0,
            commanded: false,
            engage_left: 0,
            tau: zero,
            tau_peak: zero,
            braking: true,
            saturated: false,
            fault: false,
        }
    }

    /// Clears torques, their peaks and a fault.
    pub(crate) fn reset(&mut self) {
        self.tau = ActuatedVector::zeros(self.tau.sizes());
        self.tau_peak = self.tau;
        self.saturated = false;
        self.fault = false;
    }

    /// Advances by cycle `seq`, in which the daemon sends `command` (`None`: no command), and returns the actuation in it.
    pub(crate) fn step(&mut self, seq: u64, command: Option<DriveCommand>) -> Actuation {
        self.commanded |= command.is_some();
        self.delay_line[slot(seq)] = command;
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

    /// Measured torques or forces of a `load` that the brakes hold, N m or N: less the offset of the sensors, within the limits.
    pub(crate) fn sensed_load(&self, load: &ActuatedVector) -> ActuatedVector {
        (load - self.offset).inf(&self.tau_max).sup(&-self.tau_max)
    }

    /// Measured torques or forces of the drives, N m or N.
    pub(crate) fn tau(&self) -> &ActuatedVector {
        &self.tau
    }

    /// Largest magnitude of each drive's torque or force since the start or the last reset, N m or N.
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

    /// The commanded torques or forces within the limits, N m or N; `None` if the brakes have to close.
    fn commanded_torque(&mut self) -> Option<ActuatedVector> {
        self.saturated = false;
        let command = self.active?;
        let usable = command.tau.filter(|tau| tau.iter().all(|tau| tau.is_finite()));
        if usable.is_none() {
            self.fault = true;
        } else if command.brake {
            self.fault = false;
        }
        let commanded = usable.filter(|_| !self.fault && !command.brake)?;
        let torque = commanded.inf(&self.tau_max).sup(&-self.tau_max);
        self.saturated = torque != commanded;
        Some(torque)
    }

    /// Releases the brakes and returns the torques or forces on the joints, N m or N: those commanded with lag, plus the offset.
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

    /// Closes the brakes; until they hold, the joints move without torque.
    fn brake(&mut self) -> Actuation {
        self.engage_left = if self.braking { self.engage_left.saturating_sub(1) } else { self.engage_cycles };
        self.braking = true;
        self.tau = ActuatedVector::zeros(self.tau.sizes());
        if self.engage_left == 0 { Actuation::Brakes } else { Actuation::Torque(self.tau) }
    }
}

/// Index of a cycle in the delay line.
fn slot(seq: u64) -> usize {
    (seq % DELAY_LINE as u64) as usize
}
