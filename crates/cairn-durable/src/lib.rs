//! Files that survive a crash whole or not at all, and what belongs to that: flushed folders, lock files,
//! reads of bounded size.
//!
//! Two ways in. The functions on paths ([`write_atomic`], [`read_limited`], [`rename`], ...) and [`LockFile`]
//! are for single files. [`Files`] on a [`Disk`] is for those who must show in tests what each failed step
//! leaves behind: [`RealDisk`] is the operating system's; with the feature `testing`, `FaultyDisk` is one
//! in memory that fails on demand.

mod disk;
mod error;
#[cfg(any(test, feature = "testing"))]
mod faulty;
mod files;
mod lock;
mod paths;
mod real;

pub use disk::{Disk, OpenFile};
pub use error::DurableError;
#[cfg(any(test, feature = "testing"))]
pub use faulty::{Fault, FaultyDisk};
pub use files::Files;
pub use lock::LockFile;
pub use paths::{
    create_secret, make_folders, open_to_others, read_limited, read_limited_if_there, read_secret, remove, rename,
    sync_folder, write_atomic, write_secret, write_synced,
};
pub use real::RealDisk;
