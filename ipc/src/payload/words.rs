//! Payloads as 64-bit words: zeroed boxes, files, batches of records.

use std::alloc::{Layout, alloc_zeroed, handle_alloc_error};

/// Bytes of one number; every field of a payload is made of these.
pub(super) const WORD: usize = size_of::<u64>();

/// A type whose all-zero bytes are a valid value.
///
/// # Safety
/// Only for types of plain numbers and a size above zero.
pub(super) unsafe trait Zeroable: Sized {}

/// A zeroed `T` on the heap, without a copy on the stack.
pub(super) fn boxed_zeroed<T: Zeroable>() -> Box<T> {
    let layout = Layout::new::<T>();
    // SAFETY: the layout has a size above zero (contract of `Zeroable`).
    let memory = unsafe { alloc_zeroed(layout) }.cast::<T>();
    if memory.is_null() {
        handle_alloc_error(layout);
    }
    // SAFETY: allocated above by the global allocator with the layout of `T`; zero is a valid `T`.
    unsafe { Box::from_raw(memory) }
}

/// Defines the conversions of a payload to and from 64-bit words, for files.
macro_rules! words {
    ($payload:ident) => {
        impl $payload {
            /// The fields in order as 64-bit words (of floating-point numbers their bits), for files.
            pub fn words(&self) -> impl Iterator<Item = u64> + use<> {
                let words: [u64; size_of::<Self>() / WORD] =
                    // SAFETY: `repr(C)` of 8-byte numbers without padding (size assertion of the type); any bits are a
                    // valid `u64`.
                    unsafe { std::mem::transmute_copy(self) };
                words.into_iter()
            }

            /// The payload of the words that [`Self::words`] returned; `None` if their number differs.
            pub fn from_words(words: &[u64]) -> Option<Self> {
                let words: [u64; size_of::<Self>() / WORD] = words.try_into().ok()?;
                // SAFETY: as in `words`; any bits are a valid number of 8 bytes.
                Some(unsafe { std::mem::transmute::<[u64; size_of::<Self>() / WORD], Self>(words) })
            }
        }
    };
}

/// Defines the methods of a batch: a payload with `records`, of which the first `count` are in use.
macro_rules! batch {
    ($batch:ident of $record:ident, $capacity:ident) => {
        // SAFETY: numbers only, size above zero.
        unsafe impl Zeroable for $batch {}

        impl $batch {
            /// An empty batch on the heap (it is too large for small stacks).
            pub fn boxed_zeroed() -> Box<Self> {
                super::words::boxed_zeroed()
            }

            /// The records in use; all of them if `count` is too large.
            pub fn used(&self) -> &[$record] {
                let count = usize::try_from(self.count).map_or($capacity, |n| n.min($capacity));
                &self.records[..count]
            }

            /// Whether there is no room for another record.
            pub fn is_full(&self) -> bool {
                self.used().len() == $capacity
            }

            /// Appends a record and returns true; returns false if the batch is full.
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

            /// Removes all records.
            pub fn clear(&mut self) {
                self.count = 0;
            }
        }
    };
}

pub(super) use {batch, words};
