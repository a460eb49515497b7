//! A trajectory with its gains, as the daemon runs it.

use super::{WORD, Zeroable, boxed_zeroed};
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{NU, NX};
use upswing_trajectory::KNOTS;
use xxhash_rust::xxh3::xxh3_64;

/// A trajectory xi with its gain schedule, planner -> daemon; x = [q, qd], knots uniform over [0, t_F].
///
/// About 140 KB: keep it in a box, start from [`Plan::boxed_zeroed`]. [`Plan::seal`] before it is published;
/// the receiver copies it out of shared memory first and asks [`Plan::is_intact`] of the copy.
#[repr(C)]
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[type_name("upswing.Plan.v2")]
pub struct Plan {
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

const _: () = assert!(size_of::<Plan>() == WORD * (5 + KNOTS * (2 * NX + NU + NU * NX) + NU * NX));
// The checksum covers all that lies before it, so it must be last.
const _: () = assert!(std::mem::offset_of!(Plan, checksum) == size_of::<Plan>() - WORD);

const WORDS: usize = size_of::<Plan>() / WORD;

// SAFETY: numbers only, size above zero.
unsafe impl Zeroable for Plan {}

impl Plan {
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
        let covered = std::mem::offset_of!(Plan, checksum);
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
