//! Persistent storage of plans, parameters, the signing key and a firmware's own small records: in the flash of a
//! microcontroller, in NOR flash or FRAM on SPI, in EEPROM.
//!
//! The stack calls no driver. It hands out [jobs](Job) and gets their results, so an erase can run in another task,
//! by DMA, or in a chip, while the stack keeps working. [`Store`] runs the jobs on a blocking driver, `AsyncStore` on an
//! async one.
#![doc = ""]
#![doc = include_str!("format.md")]

#[cfg(feature = "embedded-storage-async")]
mod async_store;
mod content;
mod log;
mod page;
mod params;
mod partition;
mod plans;
mod records;
mod region;
#[cfg(feature = "signing")]
mod signing;
mod slot;
mod store;

#[cfg(test)]
mod tests;

#[cfg(feature = "embedded-storage-async")]
pub use async_store::AsyncStore;
pub(crate) use content::{Kind, Part, Texts, Write, report};
pub use content::{Persistent, RestoreError, RestoreErrors, Storage};
pub(crate) use log::{Event, Next};
pub use page::Page;
pub use partition::{Partition, PartitionError};
pub use records::{MAX_RECORD_LEN, RecordService, Records, decode_record, encode_record};
pub use region::{Job, Region};
pub use slot::JobSlot;
pub use store::Store;
