//! Layouts of what crosses shared memory: `#[repr(C)]`, 8-byte numbers only, so there is no padding and a
//! reader in any language can map them. Angles in rad, velocities in rad/s, torques in N m, times in s unless
//! the name ends in `_ns`; joints run from the base to the tip, q = [q_A, q_U].

mod control;
mod cycle;
mod plan;
mod planner;
mod plant;
mod step;

pub use control::{ControlRequest, ControlResponse, Percentiles};
pub use cycle::{Command, Measurement, Telemetry, TelemetryBatch};
pub use plan::{DamagedPlan, Plan};
pub use planner::{PlannerRequest, PlannerResponse};
pub use plant::{PlantRequest, PlantResponse};
pub use step::{Step, StepBatch};

use std::alloc::{Layout, alloc_zeroed, handle_alloc_error};

/// Bytes of one number; every field of a payload is made of these.
const WORD: usize = size_of::<u64>();

/// A type whose all-zero bytes are a valid value.
///
/// # Safety
/// Only for types of plain numbers and a size above zero.
unsafe trait Zeroable: Sized {}

/// A zeroed `T` that has never been on the stack.
fn boxed_zeroed<T: Zeroable>() -> Box<T> {
    let layout = Layout::new::<T>();
    // SAFETY: the layout has a size above zero (contract of `Zeroable`).
    let memory = unsafe { alloc_zeroed(layout) }.cast::<T>();
    if memory.is_null() {
        handle_alloc_error(layout);
    }
    // SAFETY: allocated above by the global allocator with the layout of `T`; zero is a valid `T`.
    unsafe { Box::from_raw(memory) }
}

/// Defines the conversions of a payload to and from plain words, for files.
macro_rules! words {
    ($payload:ident) => {
        impl $payload {
            /// The fields in their order as plain words (numbers with a fraction: their bits), for files.
            pub fn words(&self) -> impl Iterator<Item = u64> + use<> {
                let words: [u64; size_of::<Self>() / WORD] =
                    // SAFETY: `repr(C)` of 8-byte numbers without padding (size assertion of the type); any bits are a
                    // valid `u64`.
                    unsafe { std::mem::transmute_copy(self) };
                words.into_iter()
            }

            /// The payload that [`Self::words`] gave; `None` if their number differs.
            pub fn from_words(words: &[u64]) -> Option<Self> {
                let words: [u64; size_of::<Self>() / WORD] = words.try_into().ok()?;
                // SAFETY: as in `words`; any bits are a valid number of 8 bytes.
                Some(unsafe { std::mem::transmute::<[u64; size_of::<Self>() / WORD], Self>(words) })
            }
        }
    };
}

/// Defines the methods of a batch, which has a `count` and as many `records`.
macro_rules! batch {
    ($batch:ident of $record:ident, $capacity:ident) => {
        // SAFETY: numbers only, size above zero.
        unsafe impl Zeroable for $batch {}

        impl $batch {
            /// An empty batch on the heap (it is too large for small stacks).
            pub fn boxed_zeroed() -> Box<Self> {
                super::boxed_zeroed()
            }

            /// The records in use; a `count` beyond the end counts as all of them.
            pub fn used(&self) -> &[$record] {
                let count = usize::try_from(self.count).map_or($capacity, |n| n.min($capacity));
                &self.records[..count]
            }

            /// Whether there is no room for another record.
            pub fn is_full(&self) -> bool {
                self.used().len() == $capacity
            }

            /// Appends a record; false, and nothing done, if the batch is full.
            pub fn push(&mut self, record: $record) -> bool {
                let slot = usize::try_from(self.count).ok().and_then(|i| self.records.get_mut(i));
                match slot {
                    Some(slot) => {
                        *slot = record;
                        self.count += 1;
                        true
                    }
                    None => false,
                }
            }

            /// Makes the batch empty.
            pub fn clear(&mut self) {
                self.count = 0;
            }
        }
    };
}

use {batch, words};
