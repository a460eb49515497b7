//! Layouts of what crosses shared memory: `#[repr(C)]`, 8-byte numbers only, so there is no padding and a
//! reader in any language can map them. Angles in rad, velocities in rad/s, torques in N m, times in s unless
//! the name ends in `_ns`; joints run from the base to the tip, q = [q_A, q_U].

mod control;
mod cycle;
mod plan;
mod planner;
mod plant;

pub use control::{ControlRequest, ControlResponse, Percentiles};
pub use cycle::{Command, Measurement, TELEMETRY_BATCH, Telemetry, TelemetryBatch};
pub use plan::Plan;
pub use planner::{PlannerRequest, PlannerResponse};
pub use plant::{PlantRequest, PlantResponse};

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
