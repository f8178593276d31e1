//! The parameters on storage: one [record](super::record) with a row for each of them (P-17).
//!
//! The bytes are described in `params.md` beside this file. Rows are matched by name and type when they are read, so that
//! firmware with another table keeps what both have. Whoever changes a row counts the schema version up, and goes on reading
//! what was stored before.

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
        let [name0, name1, name2, name3, value, what, ..] = row.as_chunks_mut().0 else { return row };
        let (name, _) = self.name.as_chunks();
        for (to, from) in [name0, name1, name2, name3].into_iter().zip(name) {
            *to = *from;
        }
        *value = self.bits.to_le_bytes();
        *what = [self.r#type.0, u8::from(self.is_default), 0, 0];
        row
    }

    /// What a row says; whatever is in it, it is something.
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

/// Keeps the parameters on storage: two slots, of which one always has what was complete before.
///
/// The storage is anything that is [`NorFlash`] with a `WRITE_SIZE` that divides 256 and a `READ_SIZE` that divides 32, as for
/// [`PlanStore`](super::PlanStore), beside whose region this one stands. Writing goes in steps of at most one erase unit or 256
/// bytes, about a second after a change and at most every ten seconds (SEC-12), in the long run at most every
/// [`storage_refill`](crate::Config::storage_refill) (C-15):
///
/// ```text
///            a value changes             after 1 s, and 10 s after the last one       whole
///   stored ──────────────────▶ changed ─────────────────────────────────────▶ writing ─────▶ stored
///                                 ▲       PREFLIGHT_STORAGE: at once             │
///                                 └──── not written: a text, again after 10 s ───┘
/// ```
///
/// What changes while it is written is in it or not; then it is written once more.
///
#[doc = include_str!("params.md")]
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParamStore<F> {
    record: Record<F>,
}

impl<F: NorFlash> ParamStore<F> {
    /// A store in this region of the storage, of which it uses two halves of whole erase units. Nothing is read yet.
    pub const fn new(flash: F, region: Range<u32>) -> Self {
        Self { record: Record::new(flash, region, KIND) }
    }

    /// How long the region has to be for so many parameters, in bytes: a multiple of two erase units. It has to begin where
    /// an erase unit does.
    #[allow(clippy::as_conversions, reason = "`try_from` is not const; saturated before")]
    pub const fn region_len(count: usize) -> u32 {
        let rows = if count < 0x0400_0000 { count as u32 } else { 0x0400_0000 };
        Record::<F>::slot_len(rows.saturating_mul(32)).saturating_mul(2)
    }

    /// The storage.
    pub const fn flash(&self) -> &F {
        &self.record.flash
    }

    /// The storage. What is written to the store's region here is lost, or damages the parameters.
    pub const fn flash_mut(&mut self) -> &mut F {
        &mut self.record.flash
    }

    /// Gives the storage back.
    pub fn into_inner(self) -> F {
        self.record.flash
    }

    /// Finds the newest record, and says how many rows it has. Reads the whole of it.
    ///
    /// # Errors
    ///
    /// Neither slot has a whole record of this version, and the storage is not empty.
    pub(crate) fn open(&mut self) -> Result<u32, RestoreError<F::Error>> {
        match self.record.open()? {
            Some(header) if header.schema != SCHEMA => Err(RestoreError::Foreign),
            header => Ok(header.map_or(0, |header| header.len / 32)),
        }
    }

    /// Whether there is damage besides the record that was found.
    pub(crate) const fn is_damaged(&self) -> bool {
        self.record.is_damaged()
    }

    /// Whether a [`step`](Self::step) only reads again what could not be read.
    pub(crate) const fn is_unread(&self) -> bool {
        self.record.is_unread()
    }

    /// A row of those that [`open`](Self::open) has found.
    #[inline(never)]
    pub(crate) fn row(&mut self, index: u32) -> Result<Option<Stored>, F::Error> {
        Ok(self.record.row(index)?.map(|row| Stored::from_row(&row)))
    }

    /// At most one erase unit or one write of at most 256 bytes, towards the table being durable, with a number that stands
    /// for its content. What changes between two steps is in the record or not. Without a number, towards the next record
    /// having an erased slot.
    #[inline(never)]
    pub(crate) fn step(&mut self, now: Instant, table: &TableMut<'_>, job: Option<u32>) -> Step {
        let len = u32::from(table.count()).saturating_mul(32);
        let job = job.map(|id| Job { id, schema: SCHEMA, len });
        self.record.step(now, job, |index| Some(table.stored(u16::try_from(index).ok()?)?.to_row()))
    }
}
