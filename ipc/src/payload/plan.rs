//! A plan as a message from planner to daemon, and its conversion to and from the plan that the controller follows.

use super::words::{WORD, Zeroable, boxed_zeroed};
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{ActuatedVector, NU, NX, State};
use upswing_trajectory::{Gain, Gains, KNOTS, Plan, Trajectory};
use xxhash_rust::xxh3::xxh3_64;

/// A trajectory xi with its gain schedule, planner -> daemon; x = [q, qd], knots uniform over [0, t_F].
///
/// About 140 KB: keep it in a box, start from [`PlanMessage::boxed_zeroed`]. [`PlanMessage::seal`] before it is published;
/// the receiver copies it out of shared memory first and asks [`PlanMessage::is_intact`] of the copy.
#[repr(C)]
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[type_name("upswing.Plan.v2")]
pub struct PlanMessage {
    /// Identity of the plan, unique per planner, above 0.
    pub id: u64,
    /// Fingerprint of the model that the plan was made for.
    pub fingerprint: u64,
    /// Moment of t = 0, for which x_0 was predicted: ns on the daemon's clock, as `t_ns` of its telemetry. 0: the plan
    /// begins whenever it is started, because the robot stays at x_0.
    pub activation_ns: u64,
    /// t_F, duration, s, above 0.
    pub t_f: f64,
    /// x_k, states at the knots, joint frames, rad and rad/s.
    pub x: [[f64; NX]; KNOTS],
    /// u_k, inputs at the knots, rad/s^2.
    pub u: [[f64; NU]; KNOTS],
    /// f_k = f(x_k, u_k), time derivative of the state at the knots, rad/s and rad/s^2.
    pub f: [[f64; NX]; KNOTS],
    /// K_k, feedback gains at the knots, u = u_d + K dx, rows: inputs, 1/s^2 (positions) and 1/s (velocities).
    pub k: [[[f64; NX]; NU]; KNOTS],
    /// Gain at the final equilibrium x_T, after t_F; units as `k`.
    pub k_final: [[f64; NX]; NU],
    /// XXH3 (64 bit) over all bytes before this field.
    pub checksum: u64,
}

const _: () = assert!(size_of::<PlanMessage>() == WORD * (5 + KNOTS * (2 * NX + NU + NU * NX) + NU * NX));
// The checksum covers all that lies before it, so it must be last.
const _: () = assert!(std::mem::offset_of!(PlanMessage, checksum) == size_of::<PlanMessage>() - WORD);

const WORDS: usize = size_of::<PlanMessage>() / WORD;

// SAFETY: numbers only, size above zero.
unsafe impl Zeroable for PlanMessage {}

impl PlanMessage {
    /// A plan of zeros on the heap; it has never been on the stack.
    pub fn boxed_zeroed() -> Box<Self> {
        boxed_zeroed()
    }

    /// A copy on the heap that has never been on the stack.
    pub fn boxed_copy(&self) -> Box<Self> {
        let mut copy = Self::boxed_zeroed();
        *copy = *self;
        copy
    }

    /// The fields in their order as plain words (numbers with a fraction: their bits), for files.
    pub fn words(&self) -> impl Iterator<Item = u64> {
        // SAFETY: `repr(C)` of 8-byte numbers without padding (size assertion above); any bits are a valid `u64`.
        let words = unsafe { std::slice::from_raw_parts(std::ptr::from_ref(self).cast::<u64>(), WORDS) };
        words.iter().copied()
    }

    /// The plan that [`Self::words`] gave; `None` if their number differs.
    pub fn from_words(words: &[u64]) -> Option<Box<Self>> {
        let mut plan = Self::boxed_zeroed();
        // SAFETY: as in `words`; any bits are a valid number of 8 bytes, and the box is borrowed mutably here only.
        let own =
            unsafe { std::slice::from_raw_parts_mut(std::ptr::from_mut(&mut *plan).cast::<u64>(), WORDS) };
        if words.len() != WORDS {
            return None;
        }
        own.copy_from_slice(words);
        Some(plan)
    }

    /// The checksum that belongs to the contents; `checksum` itself does not enter.
    pub fn checksum_of(&self) -> u64 {
        let covered = std::mem::offset_of!(PlanMessage, checksum);
        // SAFETY: `repr(C)` without padding (size assertion above), so all of these bytes are initialized.
        xxh3_64(unsafe { std::slice::from_raw_parts(std::ptr::from_ref(self).cast::<u8>(), covered) })
    }

    /// Sets the checksum to that of the contents.
    pub fn seal(&mut self) {
        self.checksum = self.checksum_of();
    }

    /// Whether the contents are those that were sealed.
    pub fn is_intact(&self) -> bool {
        self.checksum == self.checksum_of()
    }
}

impl From<&Plan> for Box<PlanMessage> {
    /// The sealed message of a plan.
    fn from(plan: &Plan) -> Self {
        let mut message = PlanMessage::boxed_zeroed();
        message.id = plan.id;
        message.fingerprint = plan.fingerprint;
        message.activation_ns = plan.activation_ns.unwrap_or(0);
        message.t_f = plan.trajectory.t_f;
        for k in 0..KNOTS {
            message.x[k] = plan.trajectory.x[k].into();
            message.u[k] = plan.trajectory.u[k].into();
            message.f[k] = plan.f[k].into();
            message.k[k] = rows(&plan.gains.knots[k]);
        }
        message.k_final = rows(&plan.gains.end);
        message.seal();
        message
    }
}

/// Why a message is not a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DamagedPlan {
    /// The bytes are not those that the planner sealed.
    #[error("checksum: the plan names {expected:016x}, its contents give {got:016x}")]
    Checksum {
        /// The checksum in the message.
        expected: u64,
        /// The checksum of its contents.
        got: u64,
    },
    /// The id is 0, which means "no plan".
    #[error("id: expected one above 0")]
    Id,
}

impl TryFrom<&PlanMessage> for Box<Plan> {
    type Error = DamagedPlan;

    /// The plan in a message, of which nothing else is checked. `message` must be a copy that no other process can write to.
    fn try_from(message: &PlanMessage) -> Result<Self, DamagedPlan> {
        if !message.is_intact() {
            return Err(DamagedPlan::Checksum { expected: message.checksum, got: message.checksum_of() });
        }
        if message.id == 0 {
            return Err(DamagedPlan::Id);
        }
        Ok(Self::new(Plan {
            id: message.id,
            fingerprint: message.fingerprint,
            activation_ns: Some(message.activation_ns).filter(|ns| *ns != 0),
            trajectory: Trajectory {
                t_f: message.t_f,
                x: Box::new(std::array::from_fn(|k| State::from(message.x[k]))),
                u: Box::new(std::array::from_fn(|k| ActuatedVector::from(message.u[k]))),
            },
            f: Box::new(std::array::from_fn(|k| State::from(message.f[k]))),
            gains: Gains {
                knots: Box::new(std::array::from_fn(|k| gain(&message.k[k]))),
                end: gain(&message.k_final),
            },
        }))
    }
}

/// A gain by rows.
fn rows(gain: &Gain) -> [[f64; NX]; NU] {
    std::array::from_fn(|i| std::array::from_fn(|j| gain[(i, j)]))
}

/// The gain with these rows.
fn gain(rows: &[[f64; NX]; NU]) -> Gain {
    Gain::from_fn(|i, j| rows[i][j])
}
