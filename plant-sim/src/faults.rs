//! Faults: what becomes of measurements on the way to the daemon, and of commands on the way back; torques from outside.

use upswing_config::{EventError, Fault, FaultKind, MAX_DELAY};
use upswing_ipc::Measurement;
use upswing_model::JointVector;

/// Faults at a time.
const MOST_FAULTS: usize = 16;
/// Measurements to look back at, with the newest.
const HISTORY: usize = MAX_DELAY as usize + 1;

/// Why a fault or a push cannot be added.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetEventError {
    /// It cannot be in itself.
    #[error(transparent)]
    Impossible(#[from] EventError),
    /// It would begin in a complete cycle.
    #[error("expected a cycle from {next} on, got {got}: what is over cannot be changed")]
    Past {
        /// First possible cycle.
        next: u64,
        /// What came.
        got: u64,
    },
    /// There are as many as there can be.
    #[error("expected at most {MOST_FAULTS} at a time: clear some first")]
    TooMany,
}

/// Fails if there is no room for another event, or it cannot be from cycle `from` on when `next` is the next one.
pub(crate) fn check_room(count: usize, next: u64, from: u64) -> Result<(), SetEventError> {
    if from < next {
        return Err(SetEventError::Past { next, got: from });
    }
    if count >= MOST_FAULTS { Err(SetEventError::TooMany) } else { Ok(()) }
}

#[derive(Clone, Debug)]
struct Entry {
    fault: Fault,
    /// What was measured when the fault began.
    held: Measurement,
}

/// Measurements on their way to the daemon.
#[derive(Clone, Debug)]
pub(crate) struct Faults {
    /// In the order of their kinds: first which measurement arrives, then what is wrong with it, whichever was set first.
    entries: Vec<Entry>,
    /// True measurements, a ring.
    history: [Measurement; HISTORY],
    /// What the daemon saw in the last cycle.
    shown: Measurement,
}

impl Faults {
    pub(crate) fn new(faults: &[Fault]) -> Self {
        let entry = |fault: &Fault| Entry { fault: *fault, held: Measurement::default() };
        let mut entries: Vec<_> = faults.iter().map(entry).collect();
        sort(&mut entries);
        Self { entries, history: [Measurement::default(); HISTORY], shown: Measurement::default() }
    }

    /// Adds a fault that begins in cycle `next` or later.
    pub(crate) fn add(&mut self, fault: &Fault, next: u64) -> Result<(), SetEventError> {
        fault.check()?;
        self.entries.retain(|entry| {
            entry.fault.cycles == 0 || entry.fault.from.saturating_add(entry.fault.cycles) > next
        });
        check_room(self.entries.len(), next, fault.from)?;
        self.entries.push(Entry { fault: *fault, held: self.at(next) });
        sort(&mut self.entries);
        Ok(())
    }

    pub(crate) fn clear(&mut self) {
        self.entries.clear();
    }

    /// Takes in the true measurement of a cycle; again, if the state was changed in between.
    pub(crate) fn measured(&mut self, measurement: Measurement) {
        self.history[place(measurement.seq)] = measurement;
        for entry in &mut self.entries {
            if entry.fault.from == measurement.seq {
                entry.held = measurement;
            }
        }
    }

    /// Ends cycle `seq`: what it showed has been seen.
    pub(crate) fn end(&mut self, seq: u64) {
        self.shown = self.show(seq);
    }

    /// What the daemon finds in cycle `seq`, the newest one; the same as in the last cycle if nothing arrives.
    pub(crate) fn show(&self, seq: u64) -> Measurement {
        let mut measurement = self.at(seq);
        for Entry { fault, held } in self.entries.iter().filter(|entry| entry.fault.acts(seq)) {
            let since = seq - fault.from;
            let odd = !since.is_multiple_of(2);
            match fault.kind {
                FaultKind::DropMeasurement => return self.shown,
                FaultKind::DuplicateMeasurement if !odd => return self.shown,
                FaultKind::ReorderMeasurement if odd => measurement = self.at(seq.saturating_sub(2)),
                FaultKind::DelayMeasurement => {
                    // A checked whole number.
                    let delay = fault.amount as u64;
                    if since < delay {
                        return self.shown;
                    }
                    measurement = self.at(seq - delay);
                }
                FaultKind::FreezeMeasurement => {
                    (measurement.q, measurement.tau_measured) = (held.q, held.tau_measured);
                }
                FaultKind::StaleTime => measurement.t_ns = held.t_ns,
                FaultKind::EncoderStuck => measurement.q[fault.joint] = held.q[fault.joint],
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
        self.entries.iter().any(|entry| entry.fault.kind == FaultKind::LoseCommand && entry.fault.acts(seq))
    }

    /// Torque on the arm from outside in cycle `seq`, N m; `None` if there is none.
    pub(crate) fn torque(&self, seq: u64) -> Option<JointVector> {
        let acting =
            self.entries.iter().filter(|e| e.fault.kind == FaultKind::ArmTorque && e.fault.acts(seq));
        acting.fold(None, |sum, Entry { fault, .. }| {
            let mut sum = sum.unwrap_or_else(JointVector::zeros);
            sum[fault.joint] += fault.amount;
            Some(sum)
        })
    }

    fn at(&self, seq: u64) -> Measurement {
        self.history[place(seq)]
    }
}

fn sort(entries: &mut [Entry]) {
    entries.sort_by_key(|entry| entry.fault.kind.code());
}

/// Place of a cycle in the ring.
fn place(seq: u64) -> usize {
    (seq % HISTORY as u64) as usize
}
