//! Persistence of the signing key and the signing time: the code between the stack and a [`SigningStore`] (G-13, G-15).

use embedded_storage::nor_flash::NorFlash;

use super::storage::{RestoreTexts, Turn};
use super::{Declares, Stack};
use crate::service::signing::{Signing, SigningStream};
use crate::storage::{RestoreError, SigningStore, Step};
use crate::time::Instant;
use crate::types::Vehicle;

const KEY_TEXTS: RestoreTexts = RestoreTexts {
    unreadable: "The signing key cannot be read",
    damaged: "The signing key is damaged: links are closed",
    readable: "The signing key can be read again",
};

/// With `signing`.
impl<D: Declares<Signing = Signing<[SigningStream; N]>>, const LINKS: usize, const N: usize> Stack<D, LINKS> {
    /// Reads the signing key and its timestamp at startup. Call it once, before the loop. If nothing is stored, as in a
    /// new vehicle, [`Signing`](crate::signing::Signing) is unchanged.
    ///
    /// # Errors
    ///
    /// Returns an error if the record is damaged or cannot be read. There is no key then, unless the firmware has set
    /// one, but the links are not open (G-18). Links that would sign, or refuse unsigned frames, accept nothing until
    /// there is a key. Only links for [provisioning](crate::signing::LinkSigning::provisioning) accept SETUP_SIGNING, which ends
    /// this state by setting a key or by removing it. [`Signing::set_key`](crate::signing::Signing::set_key) and
    /// [`clear_key`](crate::signing::Signing::clear_key) end it too. An unsigned text reports it. The text is repeated, at most
    /// every 10 s, when a frame is refused on a link for provisioning.
    ///
    /// While the newest record cannot be read, an older key does not replace it.
    /// [`persist_signing`](Self::persist_signing) reads again, even while nothing may be written.
    pub fn restore_signing<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
    ) -> Result<(), RestoreError<F::Error>> {
        let signing: &mut Signing = &mut self.services.signing;
        signing.limit(self.shared.config.storage_refill);
        let result = read_key(now, store, signing);
        self.tell_restored(now, &result, &KEY_TEXTS, false);
        result
    }

    /// Writes the signing key after a change, and every 55 s the time that is in use. Like
    /// [`persist_plans`](Self::persist_plans) it does one step per call, and writes only while the vehicle
    /// [permits](crate::Vehicle::may_persist) it. Returns true if more is to be done at once.
    ///
    /// If the vehicle does not permit writing in flight, a restart in flight begins with the time of take-off, until
    /// the first signed frame provides a later time. See also [`set_time`](crate::signing::Signing::set_time).
    pub fn persist_signing<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
        vehicle: &D::Vehicle,
    ) -> bool {
        let may_write = vehicle.may_persist();
        if !(may_write || store.is_unread()) {
            return false;
        }
        if !self.turn.is_for(Turn::KEY) {
            return true;
        }
        let signing: &mut Signing = &mut self.services.signing;
        let job = if may_write { signing.unsaved(now) } else { None };
        let step = store.step(now, signing, job);
        self.turn.took(Turn::KEY, step);
        // A key that was set in the meantime takes precedence.
        if step == Step::Unread && signing.is_lost() {
            let result = read_key(now, store, signing);
            self.tell_restored(now, &result, &KEY_TEXTS, true);
        }
        let signing: &mut Signing = &mut self.services.signing;
        match step {
            Step::Idle => return false,
            Step::Busy | Step::Unread => {}
            Step::Done => signing.saved(),
            Step::Failed => signing.not_saved(now),
        }
        true
    }
}

/// Restores the stored key, or records it as lost.
#[inline(never)]
fn read_key<F: NorFlash>(
    now: Instant,
    store: &mut SigningStore<F>,
    signing: &mut Signing,
) -> Result<(), RestoreError<F::Error>> {
    match store.open() {
        Ok(None) => {
            signing.nothing_stored();
            Ok(())
        }
        Ok(Some((key, timestamp))) => {
            signing.restore(now, key, timestamp);
            Ok(())
        }
        Err(error) => {
            signing.lost(matches!(error, RestoreError::Storage(_)));
            Err(error)
        }
    }
}
