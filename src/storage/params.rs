//! Storage of the parameters: a [record](super::record) with a row for each parameter (P-17).
//!
//! `params.md` in this folder documents the format. Rows are matched by name and type when they are read, so firmware
//! with another table keeps the parameters that both tables have. If you change the row, increment the schema version,
//! and keep reading the old one.

use embedded_storage::nor_flash::NorFlash;

use super::record::{Format, Job, ROW, RestoreError};
use super::store::{Body, Found, Persistent, Texts, is_disarmed};
use crate::dialect::MavParamType;
use crate::service::Cx;
use crate::service::param::{ParamService, ParamTable, Parameters, Stored, Work};
use crate::types::{Firmware, Vehicle};

impl Stored {
    pub(super) fn to_row(self) -> [u8; ROW] {
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
    pub(super) fn from_row(row: &[u8; ROW]) -> Self {
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

/// Parameters survive a restart (P-17).
impl<F> Persistent<F> for ParamService
where
    F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
{
    const FORMAT: Format = Format { kind: 2, schema: 1 };
    #[allow(clippy::as_conversions, reason = "`from` is not const; a table has fewer than 65,536 parameters")]
    const MAX_LEN: u32 = F::Parameters::INFO.len() as u32 * 32;
    const TEXTS: Texts = Texts {
        unreadable: "Stored parameters cannot be read",
        damaged: "Stored parameters are damaged",
        readable: "Stored parameters can be read again",
    };

    /// Late, it takes only the parameters that still have their defaults: a value that was set since is newer.
    fn load<N: NorFlash>(
        &mut self,
        cx: &mut Cx<'_, F>,
        body: &mut Body<'_, N>,
        found: Found<N::Error>,
        is_late: bool,
    ) -> Result<(), RestoreError<N::Error>> {
        let refill = cx.shared.config.storage_refill;
        self.set_refill(cx.parameters, refill);
        let result = load_rows(self, cx, body, found, is_late);
        if is_late {
            self.reread(cx.now, cx.parameters, result.is_ok());
        } else {
            self.loaded(cx.parameters, !matches!(result, Err(RestoreError::Storage(_))));
        }
        result
    }

    fn is_reload_requested(&self, cx: &mut Cx<'_, F>) -> bool {
        self.is_reload_requested(cx.parameters)
    }

    fn may_load_late(&self, cx: &Cx<'_, F>) -> bool {
        is_disarmed(cx.vehicle)
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Job> {
        let id = self.pending_write(cx.now, cx.parameters)?;
        Some(Job { id, len: <Self as Persistent<F>>::MAX_LEN })
    }

    fn row(&self, cx: &mut Cx<'_, F>, index: u32) -> Option<[u8; ROW]> {
        Some(cx.parameters.table_mut().stored(u16::try_from(index).ok()?)?.to_row())
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

/// Restores all parameters, or only those that have their defaults.
fn load_rows<F, N: NorFlash>(
    params: &mut ParamService,
    cx: &mut Cx<'_, F>,
    body: &mut Body<'_, N>,
    found: Found<N::Error>,
    is_late: bool,
) -> Result<(), RestoreError<N::Error>>
where
    F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
{
    for index in 0..found?.unwrap_or(0) / 32 {
        let mut row = [0; ROW];
        if body.row(index, &mut row)? {
            params.load(cx, &Stored::from_row(&row), is_late);
        }
    }
    if body.is_damaged() { Err(RestoreError::Damaged) } else { Ok(()) }
}
