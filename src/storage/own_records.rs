//! A firmware's own small records: an odometer, a count of starts, a calibration.

use super::page::PAYLOAD;
use super::persistent::{DamagedContent, FilledPage, LoadedPage, PendingWrite, Persistent, RestoreTexts};
use super::state::RecordSet;
use crate::service::{Cx, Service};
use crate::time::{Duration, Instant};
use crate::types::{Context, Firmware};

/// The pause after a failed write.
const RETRY: Duration = Duration::from_secs(10);

/// Maximum length of a record in bytes.
pub const MAX_RECORD_LEN: usize = PAYLOAD;

/// The hooks for a firmware's own records, declared by `storage: { records: N }`.
///
/// `Stack::save_record` requests a write. The record is written when storage is free and the vehicle
/// [permits](crate::Vehicle::may_persist) it; then [`save_record`](Self::save_record) is asked for the content. Records
/// are not rate-limited: each takes 256 bytes of the journal, so do not save one more often than the storage endures.
///
/// ```
/// # use mavstack::prelude::*;
/// # use mavstack::dialect;
/// # struct Rover { starts: u32 }
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// use mavstack::storage::Records;
///
/// const STARTS: u8 = 0;
///
/// impl Records for Rover {
///     fn load_record(&mut self, _: &mut Context<'_>, number: u8, bytes: &[u8]) {
///         if let (STARTS, Ok(bytes)) = (number, bytes.try_into()) {
///             self.starts = u32::from_le_bytes(bytes);
///         }
///     }
///
///     fn save_record(&mut self, _: &mut Context<'_>, _: u8, bytes: &mut [u8]) -> usize {
///         bytes[..4].copy_from_slice(&self.starts.to_le_bytes());
///         4
///     }
/// }
///
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1, storage: { records: 1 })]
/// struct Mavlink;
/// ```
pub trait Records {
    /// Takes the stored content of a record when it is restored: exactly the bytes that were written.
    fn load_record(&mut self, cx: &mut Context<'_>, number: u8, bytes: &[u8]);

    /// Writes the content of a record to the start of `bytes`, which has room for [`MAX_RECORD_LEN`] bytes. Returns its
    /// length.
    fn save_record(&mut self, cx: &mut Context<'_>, number: u8, bytes: &mut [u8]) -> usize;
}

/// Encodes a value as the content of a record, by [postcard](https://postcard.jamesmunns.com), for
/// [`Records::save_record`]. Returns its length; `None` if it does not fit into `bytes`.
///
/// ```
/// use mavstack::Context;
/// use mavstack::storage::{Records, decode_record, encode_record};
///
/// #[derive(Clone, Default, serde::Serialize, serde::Deserialize)]
/// struct Odometer { starts: u32, metres: f32 }
///
/// #[derive(Default)]
/// struct Rover { odometer: Odometer }
///
/// impl Records for Rover {
///     fn load_record(&mut self, _: &mut Context<'_>, _: u8, bytes: &[u8]) {
///         // A record of an older firmware, with other fields, may not be one of these.
///         self.odometer = decode_record(bytes).unwrap_or_default();
///     }
///
///     fn save_record(&mut self, _: &mut Context<'_>, _: u8, bytes: &mut [u8]) -> usize {
///         encode_record(&self.odometer, bytes).unwrap_or(0)
///     }
/// }
/// ```
pub fn encode_record<T: serde::Serialize + ?Sized>(value: &T, bytes: &mut [u8]) -> Option<usize> {
    postcard::to_slice(value, bytes).ok().map(|used| used.len())
}

/// Decodes a value that [`encode_record`] has encoded. `None` if the bytes are not such a value.
pub fn decode_record<'a, T: serde::Deserialize<'a>>(bytes: &'a [u8]) -> Option<T> {
    postcard::from_bytes(bytes).ok()
}

/// The service of a firmware's own records, at most 8.
#[derive(Debug)]
pub struct RecordService<const N: usize> {
    /// The records to write, without the one that is being written.
    pending: RecordSet,
    writing: Option<u8>,
    /// After a failure, nothing is written until then.
    retry_at: Instant,
}

impl<const N: usize> RecordService<N> {
    /// Requests a write of a record. Does nothing if there is no such record.
    pub(crate) fn save(&mut self, number: u8) {
        if usize::from(number) < N {
            self.pending.insert(number);
        }
    }
}

impl<F: Firmware, const N: usize> Service<F> for RecordService<N> {
    type Link = ();
    const VACANT: () = ();
    type Reply = ();
    const NEW: Self = {
        assert!(N > 0 && N <= 8, "`records` of `storage` is 1 to 8; leave it out for none");
        Self { pending: RecordSet::EMPTY, writing: None, retry_at: Instant::ZERO }
    };
}

impl<F: Firmware<Vehicle: Records>, const N: usize> Persistent<F> for RecordService<N> {
    const KIND: u8 = 128;
    #[allow(clippy::as_conversions, reason = "at most 8")]
    const RECORDS: u8 = N as u8;
    const MAX_LEN: u32 = 1;
    const TEXTS: RestoreTexts = RestoreTexts {
        unreadable: "Stored records cannot be read",
        damaged: "A stored record is damaged",
        readable: "Stored records can be read again",
    };

    fn load(&mut self, cx: &mut Cx<'_, F>, page: LoadedPage<'_>) -> Result<(), DamagedContent> {
        // Since an earlier attempt to read failed, the vehicle may have changed the record.
        let is_outdated = page.is_retry && self.pending.contains(page.record);
        if !is_outdated {
            let (vehicle, mut context) = cx.hook();
            vehicle.load_record(&mut context, page.record, page.bytes);
        }
        Ok(())
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<PendingWrite> {
        if cx.now < self.retry_at {
            return None;
        }
        if self.writing.is_none() {
            self.writing = self.pending.take_first();
        }
        Some(PendingWrite { record: self.writing?, version: 0, is_secret: false })
    }

    fn fill(&mut self, cx: &mut Cx<'_, F>, record: u8, page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
        if page > 0 {
            return None;
        }
        let (vehicle, mut context) = cx.hook();
        let len = vehicle.save_record(&mut context, record, bytes);
        Some(FilledPage { len: u8::try_from(len.min(PAYLOAD)).unwrap_or(0), is_last: true })
    }

    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>, is_saved: bool) {
        if let Some(record) = self.writing.take()
            && !is_saved
        {
            self.pending.insert(record);
            self.retry_at = cx.now + RETRY;
        }
    }
}
