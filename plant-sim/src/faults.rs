//! Faults of the transmission of measurements and commands, faults of encoders, and external torques.

use upswing_config::{EventError, Fault, FaultKind, MAX_DELAY};
use upswing_model::{ActuatedVector, JointVector, Sizes};

/// Largest number of faults, and of pushes, that can be set at the same time.
const MOST_FAULTS: usize = 16;
/// Number of true measurements in the history: the longest delay of a fault, and the present measurement.
const HISTORY: usize = MAX_DELAY as usize + 1;

/// Error of adding a fault or a push.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetEventError {
    /// A value of the fault or push is impossible.
    #[error(transparent)]
    Impossible(#[from] EventError),
    /// The fault or push would begin in a past cycle.
    #[error("expected a cycle from {next} on, got {got}: past cycles cannot be changed")]
    Past {
        /// First cycle that can still change.
        next: u64,
        /// Requested first cycle.
        got: u64,
    },
    /// Too many faults or pushes are set already.
    #[error("expected at most {MOST_FAULTS} at a time: clear some first")]
    TooMany,
}

/// Fails if `count` events leave no room for another event, or if its first cycle `from` is before the cycle `next`.
pub(crate) fn check_room(count: usize, next: u64, from: u64) -> Result<(), SetEventError> {
    if from < next {
        return Err(SetEventError::Past { next, got: from });
    }
    if count >= MOST_FAULTS { Err(SetEventError::TooMany) } else { Ok(()) }
}

/// A measurement of encoders and drives, as [`upswing_ipc::Measurement`], with the joints sorted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reading {
    /// Number of the cycle; 0 before the first measurement.
    pub seq: u64,
    /// Simulated time, ns.
    pub t_ns: u64,
    /// Measured positions, rad or m.
    pub q: JointVector,
    /// Measured torques or forces, N m or N.
    pub tau: ActuatedVector,
    /// Status bits.
    pub status: u64,
}

impl Reading {
    /// The content of a measurement before cycle 1.
    fn none(sizes: Sizes) -> Self {
        Self { seq: 0, t_ns: 0, q: JointVector::zeros(sizes), tau: ActuatedVector::zeros(sizes), status: 0 }
    }
}

/// A fault, with the measurement that it may freeze.
#[derive(Clone, Debug)]
struct FaultState {
    fault: Fault,
    /// The true measurement of the cycle in which the fault begins.
    at_begin: Reading,
}

/// The faults that are set, and the measurements that they delay, freeze or repeat.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    /// Faults in the order of their kinds, not of their addition: the kinds that select a measurement come before the kinds that
    /// falsify it.
    states: Vec<FaultState>,
    /// True measurements, a ring buffer by cycle number.
    history: [Reading; HISTORY],
    /// The measurement that the daemon received in the last cycle.
    last_shown: Reading,
}

impl Faults {
    pub(crate) fn new(faults: &[Fault], sizes: Sizes) -> Self {
        let none = Reading::none(sizes);
        let state = |fault: &Fault| FaultState { fault: *fault, at_begin: none };
        let mut states: Vec<_> = faults.iter().map(state).collect();
        sort(&mut states);
        Self { states, history: [none; HISTORY], last_shown: none }
    }

    /// Adds a fault that begins in cycle `next` or later.
    pub(crate) fn add(&mut self, fault: &Fault, next: u64) -> Result<(), SetEventError> {
        fault.check(self.sizes())?;
        self.states.retain(|state| {
            state.fault.cycles == 0 || state.fault.from.saturating_add(state.fault.cycles) > next
        });
        check_room(self.states.len(), next, fault.from)?;
        self.states.push(FaultState { fault: *fault, at_begin: self.at(next) });
        sort(&mut self.states);
        Ok(())
    }

    /// Removes all faults.
    pub(crate) fn clear(&mut self) {
        self.states.clear();
    }

    /// Stores the true measurement of the present cycle; called again if the state is reset in the cycle.
    pub(crate) fn measured(&mut self, measurement: Reading) {
        self.history[slot(measurement.seq)] = measurement;
        for state in &mut self.states {
            if state.fault.from == measurement.seq {
                state.at_begin = measurement;
            }
        }
    }

    /// Ends cycle `seq`: the daemon has received its measurement.
    pub(crate) fn end(&mut self, seq: u64) {
        self.last_shown = self.show(seq);
    }

    /// The measurement that the daemon receives in the present cycle `seq`; that of the last cycle if no new one arrives.
    pub(crate) fn show(&self, seq: u64) -> Reading {
        let mut measurement = self.at(seq);
        for FaultState { fault, at_begin } in self.states.iter().filter(|state| state.fault.acts(seq)) {
            let since = seq - fault.from;
            let odd = !since.is_multiple_of(2);
            match fault.kind {
                FaultKind::DropMeasurement => return self.last_shown,
                FaultKind::DuplicateMeasurement if !odd => return self.last_shown,
                FaultKind::ReorderMeasurement if odd => measurement = self.at(seq.saturating_sub(2)),
                FaultKind::DelayMeasurement => {
                    // A whole number, as checked by `Fault::check`.
                    let delay = fault.amount as u64;
                    if since < delay {
                        return self.last_shown;
                    }
                    measurement = self.at(seq - delay);
                }
                FaultKind::FreezeMeasurement => {
                    (measurement.q, measurement.tau) = (at_begin.q, at_begin.tau);
                }
                FaultKind::StaleTime => measurement.t_ns = at_begin.t_ns,
                FaultKind::EncoderStuck => measurement.q[fault.joint] = at_begin.q[fault.joint],
                FaultKind::EncoderJump => measurement.q[fault.joint] += fault.amount,
                FaultKind::EncoderNan => measurement.q[fault.joint] = f64::NAN,
                FaultKind::DuplicateMeasurement
                | FaultKind::ReorderMeasurement
                | FaultKind::LoseCommand
                | FaultKind::ArmTorque => {}
            }
        }
        measurement
    }

    /// Whether the command of cycle `seq` is lost.
    pub(crate) fn loses_command(&self, seq: u64) -> bool {
        self.states.iter().any(|state| state.fault.kind == FaultKind::LoseCommand && state.fault.acts(seq))
    }

    /// External torques or forces on the joints in cycle `seq`, N m or N; `None` if there is none.
    pub(crate) fn torque(&self, seq: u64) -> Option<JointVector> {
        let acting = self.states.iter().filter(|s| s.fault.kind == FaultKind::ArmTorque && s.fault.acts(seq));
        acting.fold(None, |sum, FaultState { fault, .. }| {
            let mut sum = sum.unwrap_or_else(|| JointVector::zeros(self.sizes()));
            sum[fault.joint] += fault.amount;
            Some(sum)
        })
    }

    fn sizes(&self) -> Sizes {
        self.last_shown.q.sizes()
    }

    /// The true measurement of cycle `seq`, one of the last [`HISTORY`] cycles.
    fn at(&self, seq: u64) -> Reading {
        self.history[slot(seq)]
    }
}

fn sort(states: &mut [FaultState]) {
    states.sort_by_key(|state| state.fault.kind.code());
}

/// Index of a cycle in the history.
fn slot(seq: u64) -> usize {
    (seq % HISTORY as u64) as usize
}
