//! Storage of the parameters: a record with a row for each parameter (P-17).
//!
//! `format.md` in this folder documents the format. A row has a hash of the parameter's name and type, so firmware with
//! another table keeps the parameters that both tables have. If you change the row, increment the schema version, and
//! keep reading the old one.

use core::num::Saturating;

use super::page::PAYLOAD;
use super::persistent::{
    DamagedContent, FilledPage, LoadResult, LoadedPage, PendingWrite, Persistent, RestoreTexts, is_disarmed,
};
use super::restore_error::RestoreError;
use crate::crc32::Crc32;
use crate::service::Cx;
use crate::service::param::{ParamInfo, ParamMemory, ParamService, ParamTable, Parameters, Replaced, Stored};
use crate::time::Instant;
use crate::types::{Firmware, Vehicle};

/// A row: the key of a parameter and its value, in little-endian order.
type Row = [[u8; 4]; 2];
/// Number of rows in a page.
const ROWS: Saturating<u16> = Saturating(28);
#[allow(clippy::as_conversions, reason = "`from` is not const")]
const _: () = assert!(ROWS.0 as usize * size_of::<Row>() == PAYLOAD);

/// The bit of a key that is set if the parameter had its default when it was stored.
const DEFAULT: u32 = 1 << 31;

/// Returns 31 bits of a hash of a parameter's name and type.
// Out of line: it has several callers.
#[inline(never)]
fn key(info: &ParamInfo) -> u32 {
    let mut crc = Crc32::new();
    crc.add(info.wire_name());
    crc.add(&[info.param_type().0]);
    crc.sum() & !DEFAULT
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
    const TEXTS: RestoreTexts = RestoreTexts {
        unreadable: "Stored parameters cannot be read",
        damaged: "Stored parameters are damaged",
        readable: "Stored parameters can be read again",
    };

    fn write_deadline(&self) -> Instant {
        self.write_due()
    }

    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        let refill = cx.shared.config.storage_refill;
        self.attach(cx.parameters, refill);
    }

    /// Loads the rows of a page. No page is damaged: a row without a parameter, or with an invalid value, is skipped.
    ///
    /// A value that was set since storage was attached, or since an earlier attempt to read failed, is newer than the
    /// stored one. So only parameters that still have their defaults are loaded then.
    // Out of line: its locals stay off the call stack of the other contents.
    #[inline(never)]
    fn load(&mut self, cx: &mut Cx<'_, F>, page: LoadedPage<'_>) -> Result<(), DamagedContent> {
        let replaced = self.saving(cx.parameters, |saving| saving.replaced(page.is_retry));
        if replaced == Replaced::Nothing {
            return Ok(());
        }
        // The rows and the parameters are sorted by name, so the search for a parameter usually ends at its first step.
        let mut search_from = 0;
        let rows: &[Row] = page.bytes.as_chunks().0.as_chunks().0;
        for row in rows {
            search_from = load_row::<F>(self, cx, search_from, row, replaced == Replaced::Defaults);
        }
        Ok(())
    }

    fn loaded(&mut self, cx: &mut Cx<'_, F>, result: LoadResult, is_retry: bool) {
        let now = cx.now;
        // Later, the system id changes only at the next start.
        if let Some(system) = cx.parameters.system_id()
            && self.saving(cx.parameters, |saving| saving.is_unloaded())
        {
            cx.shared.config.address = cx.shared.config.address.with_system(system);
        }
        self.saving(cx.parameters, |saving| {
            if is_retry && !saving.is_reload_requested {
                let is_read = result != LoadResult::Failed(RestoreError::Unreadable);
                saving.reread(now, is_read);
            } else {
                saving.loaded(result == LoadResult::Loaded);
            }
            let is_damaged = result == LoadResult::Failed(RestoreError::Damaged);
            saving.schedule.stored_differs |= is_damaged;
        });
    }

    /// Ends a request for the stored values, and defers a pending write, so that a sleeping loop is not woken for the
    /// write.
    fn on_blocked<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>)
    where
        Self::Link: 'l,
    {
        Persistent::<F>::loaded(self, cx, LoadResult::Failed(RestoreError::Unreadable), true);
    }

    fn is_reload_requested(&self, cx: &mut Cx<'_, F>) -> bool {
        self.is_reload_requested(cx.parameters)
    }

    fn save_again(&mut self, cx: &mut Cx<'_, F>) {
        self.save_again(cx.parameters);
    }

    /// A second attempt waits until the vehicle is disarmed: in flight, only the operator changes parameters.
    fn may_load(&self, cx: &Cx<'_, F>, is_retry: bool) -> bool {
        !is_retry || is_disarmed(cx.vehicle)
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<PendingWrite> {
        let version = self.pending_write(cx.now, cx.parameters)?;
        Some(PendingWrite { record: 0, version, is_secret: false })
    }

    /// Fills a page with rows. Returns `None` if no row is left for it. An empty table has one empty page.
    fn fill(&mut self, cx: &mut Cx<'_, F>, _: u8, page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
        let table = cx.parameters.table_mut();
        let first = Saturating(page) * ROWS;
        let mut len = Saturating(0);
        let rows: &mut [Row] = bytes.as_chunks_mut().0.as_chunks_mut().0;
        for (index, row) in (first.0..table.count()).zip(rows) {
            let (info, Stored { bits, is_default }) = table.stored(index)?;
            let key = key(info) | if is_default { DEFAULT } else { 0 };
            *row = [key.to_le_bytes(), bits.to_le_bytes()];
            len += 8;
        }
        let is_last = (first + ROWS).0 >= table.count();
        let exists = len.0 > 0 || page == 0;
        exists.then_some(FilledPage { len: len.0, is_last })
    }

    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        if is_saved {
            self.on_saved(cx.now, cx.parameters);
        } else {
            self.on_save_failed(cx);
        }
    }
}

/// Loads the value in a row, if the table has the row's parameter. The search for the parameter begins at index
/// `search_from` and wraps around at the end of the table. Returns the index after the parameter, or `search_from` if
/// there is none.
///
/// `keeps_value`: a parameter without its default keeps its value.
fn load_row<F>(params: &mut ParamService, cx: &mut Cx<'_, F>, search_from: u16, row: &Row, keeps_value: bool) -> u16
where
    F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
{
    let [stored_key, bits] = *row;
    let (stored_key, bits) = (u32::from_le_bytes(stored_key), u32::from_le_bytes(bits));
    let table = cx.parameters.table_mut();
    let mut next = Saturating(search_from);
    for _ in 0..table.count() {
        let index = if next.0 < table.count() { next.0 } else { 0 };
        next = Saturating(index) + Saturating(1);
        let is_of_row = table.get(index).is_some_and(|(info, _)| key(info) == stored_key & !DEFAULT);
        if is_of_row {
            let stored = Stored { bits, is_default: stored_key & DEFAULT != 0 };
            params.load(cx, index, &stored, keeps_value);
            return next.0;
        }
    }
    search_from
}
