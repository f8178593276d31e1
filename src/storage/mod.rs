//! Persistent storage of plans, parameters, the signing key and a firmware's own small records: in the flash of a
//! microcontroller, in NOR flash or FRAM on SPI, in EEPROM.
//!
//! The stack calls no driver. It hands out [jobs](Job) and gets their results, so an erase can run in another task, by
//! DMA, or in a chip, while the stack keeps working. [`Store`] runs the jobs on a blocking driver, `AsyncStore` on an
//! async one.
#![doc = ""]
#![doc = include_str!("format.md")]

#[cfg(feature = "embedded-storage-async")]
mod async_store;
mod job;
mod journal;
mod own_records;
mod page;
mod params;
mod partition;
mod persistent;
mod plans;
mod region;
mod restore_error;
#[cfg(feature = "signing")]
mod signing;
mod state;
mod store;

#[cfg(test)]
mod tests;

#[cfg(feature = "embedded-storage-async")]
pub use async_store::AsyncStore;
pub use job::{Job, JobSlot};
pub(crate) use journal::{Event, Next};
pub use own_records::{MAX_RECORD_LEN, RecordService, Records, decode_record, encode_record};
pub use page::Page;
pub use partition::{Partition, PartitionError};
pub use persistent::Persistent;
pub(crate) use persistent::{LoadResult, LoadedPage, PendingWrite, RestoreTexts, report};
pub use region::Region;
pub use restore_error::{RestoreError, RestoreErrors};
pub use state::Storage;
pub(crate) use state::{Content, RecordLayout};
pub use store::Store;
