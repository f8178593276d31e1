//! Storage of the signing key and its timestamp: a [record](super::record) of two rows (G-13, G-15).
//!
//! `signing.md` in this folder documents the format.

use embedded_storage::nor_flash::NorFlash;
use zeroize::Zeroize;

use super::record::{Format, Job, ROW, RestoreError};
use super::store::{Body, Found, Persistent, Texts};
use crate::frame::SigningKey;
use crate::service::Cx;
use crate::service::signing::{Signing, SigningStream};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, Vehicle};

pub(super) const FORMAT: Format = Format { kind: 3, schema: 1 };
const LEN: u32 = 64;

/// The key, if there is one, and the timestamp to start from.
type Stored = (Option<SigningKey>, u64);

/// Reads the record that was found: the key, if there is one, and the timestamp to start from.
///
/// # Errors
///
/// The newest record is damaged, cannot be read, or is of another version. An older key is not used instead: it may
/// have been replaced because it was compromised.
pub(super) fn open<N: NorFlash>(
    body: &mut Body<'_, N>,
    found: Found<N::Error>,
) -> Result<Option<Stored>, RestoreError<N::Error>> {
    if found?.is_none() {
        return Ok(None);
    }
    if body.is_damaged() {
        return Err(RestoreError::Damaged);
    }
    let mut row = [0; ROW];
    let has_key = body.row(0, &mut row)?;
    let key = SigningKey::new(row);
    row.zeroize();
    if !has_key || !body.row(1, &mut row)? {
        return Err(RestoreError::Damaged);
    }
    let [timestamp, [is_set, ..], ..] = row.as_chunks::<8>().0 else { return Err(RestoreError::Damaged) };
    Ok(Some(((*is_set != 0).then_some(key), u64::from_le_bytes(*timestamp))))
}

/// The key and the time survive a restart (G-13, G-15).
impl<F: Firmware<Vehicle: Vehicle>, const STREAMS: usize> Persistent<F> for Signing<[SigningStream; STREAMS]> {
    const FORMAT: Format = FORMAT;
    const MAX_LEN: u32 = LEN;
    const TEXTS: Texts = Texts {
        unreadable: "The signing key cannot be read",
        damaged: "The signing key is damaged: links are closed",
        readable: "The signing key can be read again",
    };

    fn load<N: NorFlash>(
        &mut self,
        cx: &mut Cx<'_, F>,
        body: &mut Body<'_, N>,
        found: Found<N::Error>,
        _: bool,
    ) -> Result<(), RestoreError<N::Error>> {
        load(self, cx.now, cx.shared.config.storage_refill, open(body, found))
    }

    /// Even in flight: without the key, links are closed.
    fn may_load_late(&self, _: &Cx<'_, F>) -> bool {
        true
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<Job> {
        let id = Signing::pending_write(self, cx.now)?;
        Some(Job { id, len: LEN })
    }

    fn row(&self, _: &mut Cx<'_, F>, index: u32) -> Option<[u8; ROW]> {
        row(self, index)
    }

    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        if is_saved { self.on_saved(cx.now) } else { self.on_save_failed(cx.now) }
    }

    /// A key that was set in the meantime takes precedence.
    fn on_readable<'l>(&mut self, _: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        self.is_lost()
    }
}

/// Restores the stored key, or records it as lost.
fn load<E>(
    signing: &mut Signing,
    now: Instant,
    refill: Duration,
    stored: Result<Option<Stored>, RestoreError<E>>,
) -> Result<(), RestoreError<E>> {
    signing.set_refill(refill);
    match stored {
        Ok(None) => signing.nothing_stored(),
        Ok(Some((key, timestamp))) => signing.restore(now, key, timestamp),
        Err(error) => {
            signing.lost(matches!(error, RestoreError::Storage(_)));
            return Err(error);
        }
    }
    Ok(())
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
