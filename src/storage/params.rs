//! Storage of the parameters: a [record](super::record) with a row for each parameter (P-17).
//!
//! `params.md` in this folder documents the format. Rows are matched by name and type when they are read, so firmware
//! with another table keeps the parameters that both tables have. If you change the row, increment the schema version,
//! and keep reading the old one.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use super::record::{Job, ROW, Record, RestoreError, Step};
use crate::dialect::MavParamType;
use crate::service::param::{Stored, TableMut};
use crate::time::Instant;

const KIND: u8 = 2;
const SCHEMA: u16 = 1;

impl Stored {
    fn to_row(self) -> [u8; ROW] {
        let mut row = [0; ROW];
        let [name0, name1, name2, name3, value, flags, ..] = row.as_chunks_mut().0 else { return row };
        let (name, _) = self.name.as_chunks();
        for (to, from) in [name0, name1, name2, name3].into_iter().zip(name) {
            *to = *from;
        }
        *value = self.bits.to_le_bytes();
        *flags = [self.r#type.0, u8::from(self.is_default), 0, 0];
        row
    }

    /// Decodes a row. All bytes are valid.
    fn from_row(row: &[u8; ROW]) -> Self {
        let (words, _) = row.as_chunks();
        let word = |index: usize| -> [u8; 4] { words.get(index).copied().unwrap_or_default() };
        let [r#type, is_default, ..] = word(5);
        Self {
            name: row.first_chunk().copied().unwrap_or_default(),
            r#type: MavParamType(r#type),
            bits: u32::from_le_bytes(word(4)),
            is_default: is_default != 0,
        }
    }
}

/// Stores the parameters in two slots, of which one always has a complete record.
///
/// The storage is a [`NorFlash`] with a `WRITE_SIZE` that divides 256 and a `READ_SIZE` that divides 32, as for
/// [`PlanStore`](super::PlanStore). Each store needs a region of its own. It writes in steps of at most one erase unit
/// or 256 bytes: about a second after a change, and at most every ten seconds (SEC-12). In the long run it writes at
/// most once every [`storage_refill`](crate::Config::storage_refill) (C-15).
///
/// ```text
///            a value changes           after 1 s, and 10 s after the last write     complete
///   stored ──────────────────▶ changed ─────────────────────────────────────▶ writing ─────▶ stored
///                                 ▲       PREFLIGHT_STORAGE: immediately         │
///                                 └─── failed: text, and a retry after 10 s ─────┘
/// ```
///
/// A value that changes while it is written may or may not be in the record; the parameters are then written again.
///
#[doc = include_str!("params.md")]
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParamStore<F> {
    record: Record<F>,
}

impl<F: NorFlash> ParamStore<F> {
    /// Returns a store in this region of the storage. It uses two halves of whole erase units. Reads nothing yet.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { record: Record::new(flash, region, KIND) }
    }

    /// Returns the length of the region for `count` parameters, in bytes: a multiple of two erase units. The region
    /// must begin at an erase unit.
    #[allow(clippy::as_conversions, reason = "`try_from` is not const; the value is bounded")]
    pub const fn region_len(count: usize) -> u32 {
        let rows = if count < 0x0400_0000 { count as u32 } else { 0x0400_0000 };
        Record::<F>::slot_len(rows.saturating_mul(32)).saturating_mul(2)
    }

    /// Returns the storage.
    pub const fn flash(&self) -> &F {
        &self.record.flash
    }

    /// Returns the storage. Do not write to the store's region: that may damage the parameters.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.record.flash
    }

    /// Returns the storage and drops the store.
    pub fn into_inner(self) -> F {
        self.record.flash
    }

    /// Finds the newest record, and returns its number of rows. Reads all of it.
    ///
    /// # Errors
    ///
    /// Neither slot has a whole record of this version, and the storage is not empty; or it cannot be read.
    pub(crate) fn open(&mut self) -> Result<u32, RestoreError<F::Error>> {
        match self.record.open()? {
            Some(header) if header.schema != SCHEMA => Err(RestoreError::Foreign),
            header => Ok(header.map_or(0, |header| header.len / 32)),
        }
    }

    /// Returns whether a slot is damaged, besides the record that was found.
    pub(crate) const fn is_damaged(&self) -> bool {
        self.record.is_damaged()
    }

    /// Returns whether the next [`step`](Self::step) only repeats a failed read.
    pub(crate) const fn is_unread(&self) -> bool {
        self.record.is_unread()
    }

    /// Reads a row of the record that [`open`](Self::open) has found.
    #[inline(never)]
    pub(crate) fn row(&mut self, index: u32) -> Result<Option<Stored>, F::Error> {
        Ok(self.record.row(index)?.map(|row| Stored::from_row(&row)))
    }

    /// Erases at most one unit or writes at most 256 bytes.
    ///
    /// With a `job`, it is a step towards storing the table; the job's number stands for the table's content. A value
    /// that changes between two steps may or may not be in the record. Without a job, it is a step towards an erased
    /// spare slot.
    #[inline(never)]
    pub(crate) fn step(&mut self, now: Instant, table: &TableMut<'_>, job: Option<u32>) -> Step {
        let len = u32::from(table.count()).saturating_mul(32);
        let job = job.map(|id| Job { id, schema: SCHEMA, len });
        self.record.step(now, job, |index| Some(table.stored(u16::try_from(index).ok()?)?.to_row()))
    }
}
