//! Storage of the signing key and its timestamp: a [record](super::record) of two rows (G-13, G-15).
//!
//! `signing.md` in this folder documents the format.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;
use zeroize::Zeroize;

use super::record::{Job, ROW, Record, RestoreError, Step};
use crate::frame::SigningKey;
use crate::service::signing::Signing;
use crate::time::Instant;

const KIND: u8 = 3;
const SCHEMA: u16 = 1;
const LEN: u32 = 64;

/// The key, if there is one, and the timestamp to start from.
type Stored = (Option<SigningKey>, u64);

/// Stores the signing key and its timestamp in two slots, of which one always has a complete record. So a key and a
/// timestamp always belong together (G-13).
///
/// The storage is a [`NorFlash`] with a `WRITE_SIZE` that divides 256 and a `READ_SIZE` that divides 32, as for
/// [`PlanStore`](super::PlanStore). Each store needs a region of its own. It writes in steps of at most one erase unit
/// or 256 bytes, when the key was changed, and every 55 s while there is one.
///
/// Each slot is erased every 110 s. FRAM endures that, but flash rated for 10,000 cycles lasts twelve days of powered
/// and disarmed time. Peers can hardly increase this rate: see [`storage_refill`](crate::Config::storage_refill).
///
/// The key is stored unencrypted.
///
#[doc = include_str!("signing.md")]
pub struct SigningStore<F> {
    record: Record<F>,
}

/// Omits the storage, whose `Debug` may show its bytes (SEC-15).
impl<F> core::fmt::Debug for SigningStore<F> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("SigningStore")
    }
}

#[cfg(feature = "defmt")]
impl<F> defmt::Format for SigningStore<F> {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "SigningStore");
    }
}

impl<F: NorFlash> SigningStore<F> {
    /// Length of the region in bytes: a multiple of two erase units. The region must begin at an erase unit.
    pub const REGION_LEN: u32 = Record::<F>::slot_len(LEN).saturating_mul(2);

    /// Returns a store in this region of the storage. It uses two halves of whole erase units. Reads nothing yet.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { record: Record::new(flash, region, KIND) }
    }

    /// Returns the storage.
    pub const fn flash(&self) -> &F {
        &self.record.flash
    }

    /// Returns the storage. Do not write to the store's region: that may damage the record.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.record.flash
    }

    /// Returns the storage and drops the store.
    pub fn into_inner(self) -> F {
        self.record.flash
    }

    /// Reads the newest record: the key, if there is one, and the timestamp to start from.
    ///
    /// # Errors
    ///
    /// The newest record is damaged, cannot be read, or is of another version. An older key is not used instead: it may
    /// have been replaced because it was compromised.
    pub(crate) fn open(&mut self) -> Result<Option<Stored>, RestoreError<F::Error>> {
        let Some(header) = self.record.open()? else { return Ok(None) };
        if header.schema != SCHEMA {
            return Err(RestoreError::Foreign);
        }
        if self.record.is_damaged() {
            return Err(RestoreError::Damaged);
        }
        let Some(mut secret) = self.record.row(0)? else { return Err(RestoreError::Damaged) };
        let key = SigningKey::new(secret);
        secret.zeroize();
        let Some(rest) = self.record.row(1)? else { return Err(RestoreError::Damaged) };
        let [timestamp, [is_set, ..], ..] = rest.as_chunks::<8>().0 else { return Err(RestoreError::Damaged) };
        Ok(Some(((*is_set != 0).then_some(key), u64::from_le_bytes(*timestamp))))
    }

    /// Returns whether the next [`step`](Self::step) only repeats a failed read.
    pub(crate) const fn is_unread(&self) -> bool {
        self.record.is_unread()
    }

    /// Erases at most one unit or writes at most 256 bytes. With a `job`, it is a step towards storing the key and
    /// timestamp; the job's number stands for this content. Without a job, it is a step towards an erased spare slot.
    pub(crate) fn step(&mut self, now: Instant, signing: &Signing, job: Option<u32>) -> Step {
        let job = job.map(|id| Job { id, schema: SCHEMA, len: LEN });
        self.record.step(now, job, |index| row(signing, index))
    }
}

/// Returns a row of the record.
fn row(signing: &Signing, index: u32) -> Option<[u8; ROW]> {
    let (key, timestamp) = signing.content();
    if index == 0 {
        return Some(key.map_or([0; ROW], |key| *key.bytes()));
    }
    let mut row = [0; ROW];
    let [time, flags, ..] = row.as_chunks_mut().0 else { return None };
    *time = timestamp.to_le_bytes();
    *flags = u64::from(key.is_some()).to_le_bytes();
    Some(row)
}
