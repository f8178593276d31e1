//! Storage of the signing key and its timestamp: a record of one page (G-13, G-15, SEC-8, SEC-15).
//!
//! `format.md` in this folder documents the format.

use super::persistent::{DamagedContent, FilledPage, LoadResult, LoadedPage, PendingWrite, Persistent, RestoreTexts};
use super::restore_error::RestoreError;
use crate::frame::SigningKey;
use crate::service::Cx;
use crate::service::signing::{Signing, SigningStream};
use crate::types::{Firmware, Vehicle};

/// Length of the content in bytes.
const LEN: u8 = 41;

/// The key and the time survive a restart (G-13, G-15).
impl<F: Firmware<Vehicle: Vehicle>, const STREAMS: usize> Persistent<F> for Signing<[SigningStream; STREAMS]> {
    const KIND: u8 = 3;
    const RECORDS: u8 = 1;
    const SCHEMA: u16 = 1;
    #[allow(clippy::as_conversions, reason = "`from` is not const")]
    const MAX_LEN: u32 = LEN as u32;
    /// It may have been replaced because it was compromised.
    const USES_OLDER: bool = false;
    const TEXTS: RestoreTexts = RestoreTexts {
        unreadable: "The signing key cannot be read",
        damaged: "The signing key is damaged: links are closed",
        readable: "The signing key can be read again",
    };

    fn attach(&mut self, cx: &mut Cx<'_, F>) {
        self.attach_storage(cx.shared.config.storage_refill);
    }

    fn load(&mut self, cx: &mut Cx<'_, F>, page: LoadedPage<'_>) -> Result<(), DamagedContent> {
        if !self.is_lost() {
            // A key that was set while the stored one was read takes precedence.
            return Ok(());
        }
        load(self, cx.now, page.bytes).ok_or(DamagedContent)
    }

    fn loaded(&mut self, _: &mut Cx<'_, F>, result: LoadResult, _: bool) {
        match result {
            // A key was set or removed in the meantime.
            LoadResult::Failed(_) if !self.is_lost() => {}
            LoadResult::Loaded => {}
            LoadResult::Empty => self.nothing_stored(),
            LoadResult::Failed(error) => self.lost(error == RestoreError::Unreadable),
        }
    }

    fn pending_write(&mut self, cx: &mut Cx<'_, F>) -> Option<PendingWrite> {
        let version = Signing::pending_write(self, cx.now)?;
        Some(PendingWrite { record: 0, version, is_secret: self.has_old_key() })
    }

    fn fill(&mut self, _: &mut Cx<'_, F>, _: u8, page: u16, bytes: &mut [u8]) -> Option<FilledPage> {
        if page > 0 {
            return None;
        }
        let (key, timestamp) = self.content();
        let (place, rest) = bytes.split_first_chunk_mut::<32>()?;
        let (time, rest) = rest.split_first_chunk_mut::<8>()?;
        *place = key.map_or([0; 32], |key| *key.bytes());
        *time = timestamp.to_le_bytes();
        *rest.first_mut()? = key.is_some().into();
        Some(FilledPage { len: LEN, is_last: true })
    }

    fn on_written<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>, is_saved: bool)
    where
        Self::Link: 'l,
    {
        if is_saved { self.on_saved(cx.now) } else { self.on_save_failed(cx.now) }
    }

    fn save_again(&mut self, _: &mut Cx<'_, F>) {
        Signing::save_again(self);
    }

    /// A key that was set in the meantime takes precedence.
    fn prepare_load<'l>(&mut self, _: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut Self::Link>) -> bool
    where
        Self::Link: 'l,
    {
        self.is_lost()
    }
}

/// Restores the stored key and time. Returns `None` if they are invalid.
fn load(signing: &mut Signing, now: crate::time::Instant, bytes: &[u8]) -> Option<()> {
    let (key, rest) = bytes.split_first_chunk::<32>()?;
    let (time, &[is_set]) = rest.split_first_chunk::<8>()? else { return None };
    let key = (is_set != 0).then(|| SigningKey::new(*key));
    signing.restore(now, key, u64::from_le_bytes(*time));
    Some(())
}
