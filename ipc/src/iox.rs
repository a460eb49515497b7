//! The private file layout of iceoryx2 0.10, and what this crate does because of it. Lowest layer of the crate: it knows
//! directories and files, but neither nodes nor services.
//!
//! iceoryx2 is not built for processes that are killed while they create a service, or for shared memory that is full. So
//! in every domain of upswing:
//!
//! - one process at a time creates, lists or cleans up: [`CreationLock`];
//! - the holder of that lock removes the unfinished files of processes that were killed: [`leftovers`];
//! - shared memory is reserved when it is created, so that a lack of it is an error and not a SIGBUS: [`reservation`];
//! - iceoryx2 takes its settings from the domain, never from the working directory: [`process_defaults`].
//!
//! Where the files are, how they are named and which permission bits say "unfinished" stands in [`Layout`]'s module only. A
//! new version of iceoryx2 means: check this folder against its source, and run `ipc/tests`.

mod creation_lock;
mod layout;
pub(crate) mod leftovers;
pub(crate) mod process_defaults;
pub(crate) mod reservation;

pub(crate) use creation_lock::CreationLock;
pub(crate) use layout::{Layout, TYPE_HASH_DIGITS, open_regular_file};
