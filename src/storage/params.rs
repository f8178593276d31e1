//! Storage of the parameters: a record with a row for each parameter (P-17).
//!
//! `format.md` in this folder documents the format. A row has a hash of the parameter's name and type, so firmware with
//! another table keeps the parameters that both tables have. If you change the row, increment the schema version, and
//! keep reading the old one.

use super::content::{Part, Persistent, RestoreError, Texts, Write, is_disarmed};
use super::page::PAYLOAD;
use super::plans::Loading;
use crate::crc32::Crc32;
use crate::service::Cx;
use crate::service::param::{ParamService, ParamTable, Parameters, Stored, Work};
use crate::types::{Firmware, Vehicle};

/// Length of a row in bytes.
const ROW: usize = 8;
/// Number of rows in a page.
const ROWS: u16 = 28;
#[allow(clippy::as_conversions, reason = "`from` is not const")]
const _: () = assert!(ROWS as usize * ROW == PAYLOAD);

/// The bit of a key that says that the parameter had its default.
const DEFAULT: u32 = 1 << 31;

/// Returns the key of a parameter: 31 bits of a hash of its name and type, and whether it has its default.
fn key(stored: &Stored) -> u32 {
    let mut crc = Crc32::new();
    crc.add(&stored.name);
    crc.add(&[stored.r#type.0]);
    (crc.sum() & !DEFAULT) | if stored.is_default { DEFAULT } else { 0 }
}

/// Parameters survive a restart (P-17).
impl<F> Persistent<F> for ParamService
where
    F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
{
    const KIND: u8 = 2;
    const RECORDS: u8 = if F::Parameters::INFO.is_empty() { 0 } else { 1 };
    const SCHEMA: u16 = 1;
    #[allow(clippy::as_conversions, reason = "`from` is not const; a table has fewer than 65,536 parameters")]
    const MAX_LEN: u32 = F::Parameters::INFO.len() as u32 * 8;
    const TEXTS: Texts = Texts {
        unreadable: "Stored parameters cannot be read",
        damaged: "Stored parameters are damaged",
        readable: "Stored parameters can be read again",
    };

    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        let refill = cx.shared.config.storage_refill;
        self.attach(cx.parameters, refill);
    }

    /// Late, or if values were set since storage was attached, it takes only the parameters that still have their defaults: a
    /// value that was set since is newer.
    #[inline(never)]
    fn load(&mut self, cx: &mut Cx<'_, F>, part: &Part<'_>, _: &mut Loading) -> Result<(), RestoreError> {
        // If the operator requests the stored values, what was set since is not wanted.
        let keeps = self.keeps_values(cx.parameters);
        let is_late = (part.is_late || keeps) && !self.is_reload_requested(cx.parameters);
        // Both tables are sorted by name, so the search usually ends at once.
        let mut next = 0;
        for [key, value] in part.bytes.as_chunks::<ROW>().0.iter().map(|row| {
            let [a, b, c, d, e, f, g, h] = *row;
            [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes)
        }) {
            next = load_row::<F>(self, cx, next, key, value, is_late);
        }
        Ok(())
    }

    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: Result<bool, RestoreError>, is_late: bool) {
        if is_late && !self.is_reload_requested(cx.parameters) {
            self.reread(cx.now, cx.parameters, result != Err(RestoreError::Unreadable));
        } else {
            // If nothing was loaded, what was set since is still to be written.
            self.keeps_values(cx.parameters);
            self.loaded(cx.parameters, result == Ok(true));
        }
        if result == Err(RestoreError::Damaged) {
            self.set_stored_differs(cx.parameters);
        }
    }

    /// A request for the stored values fails, and a write is deferred: a sleeping loop is not woken for it.
    fn on_blocked<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        Persistent::<F>::loaded(self, cx, Err(RestoreError::Unreadable), true);
    }

    fn is_reload_requested(&self, cx: &mut Cx<'_, F>) -> bool {
        self.is_reload_requested(cx.parameters)
    }

    fn save_again(&mut self, cx: &mut Cx<'_, F>) {
        self.save_again(cx.parameters);
    }

    fn may_load(&self, cx: &Cx<'_, F>, is_late: bool) -> bool {
        !is_late || is_disarmed(cx.vehicle)
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Write> {
        let version = self.pending_write(cx.now, cx.parameters)?;
        Some(Write { record: 0, version, is_secret: false })
    }

    #[inline(never)]
    fn fill(&mut self, cx: &mut Cx<'_, F>, _: u8, page: u16, bytes: &mut [u8]) -> Option<(u8, bool)> {
        let table = cx.parameters.table_mut();
        let first = page.checked_mul(ROWS)?;
        let mut len = 0u8;
        for (index, row) in (first..table.count()).zip(bytes.as_chunks_mut::<ROW>().0) {
            let stored = table.stored(index)?;
            let [[a, b, c, d], [e, f, g, h]] = [key(&stored), stored.bits].map(u32::to_le_bytes);
            *row = [a, b, c, d, e, f, g, h];
            len = len.saturating_add(8);
        }
        // An empty table has an empty page.
        (len > 0 || page == 0).then_some((len, first.saturating_add(ROWS) >= table.count()))
    }

    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        if is_saved {
            self.on_saved(cx.now, cx.parameters);
        } else {
            let mut work = Work { now: cx.now, texts: cx.texts, normal: cx.shared.normal };
            self.on_save_failed(&mut work, cx.parameters);
        }
    }
}

/// Loads the parameter with this key, if there is one; looks for it from index `from` on. Returns the index after it.
fn load_row<F>(
    params: &mut ParamService,
    cx: &mut Cx<'_, F>,
    from: u16,
    stored_key: u32,
    bits: u32,
    is_late: bool,
) -> u16
where
    F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
{
    let table = cx.parameters.table_mut();
    let count = table.count();
    let found = (from..count).chain(0..from.min(count)).find_map(|index| {
        let stored = table.stored(index)?;
        ((key(&stored) ^ stored_key) & !DEFAULT == 0).then_some((index, stored))
    });
    let Some((index, stored)) = found else { return from };
    params.load(cx, &Stored { bits, is_default: stored_key & DEFAULT != 0, ..stored }, is_late);
    index.saturating_add(1)
}
