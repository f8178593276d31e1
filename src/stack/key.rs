//! The signing key and the time that survive a power cut: what joins the stack and a [`SigningStore`] (G-13, G-15).

use embedded_storage::nor_flash::NorFlash;

use super::Stack;
use super::storage::{RestoreTexts, Turn};
use crate::service::mission::PlanStorage;
use crate::storage::{RestoreError, SigningStore, Step};
use crate::time::Instant;
use crate::vehicle::Autopilot;

const KEY_TEXTS: RestoreTexts = RestoreTexts {
    unreadable: "The signing key cannot be read",
    damaged: "The signing key is damaged: links are closed",
    readable: "The signing key can be read again",
};

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Reads the signing key and its timestamp back after a start. Call it once, before the loop. If nothing is stored, as in
    /// a new vehicle, the vehicle's [`Signing`](crate::Signing) is unchanged.
    ///
    /// # Errors
    ///
    /// What is stored is damaged, or cannot be read. Unless the vehicle has set a key, there is none then; but links are not
    /// open (G-18). Those that would sign, or refuse unsigned frames, accept nothing until there is a key; only links for
    /// [provisioning](crate::LinkSigning::provisioning) accept SETUP_SIGNING, which ends it by a key or by taking the key away.
    /// [`Signing::set_key`](crate::Signing::set_key) and [`clear_key`](crate::Signing::clear_key) end it too. A text says so,
    /// unsigned, and again every 10 s at most where a frame is refused on a link for provisioning.
    ///
    /// As long as the newest record cannot be read, an older key does not stand in for it.
    /// [`persist_signing`](Self::persist_signing) reads again, also while nothing may be written.
    pub fn restore_signing<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
        vehicle: &mut V,
    ) -> Result<(), RestoreError<F::Error>> {
        if let Some(signing) = vehicle.signing() {
            signing.limit(self.core.config.storage_refill);
        }
        let result = read_key(now, store, vehicle);
        self.tell_restored(now, &result, &KEY_TEXTS, false);
        result
    }

    /// Writes the signing key when it was changed, and with it the time that is used up, one step at a time, as
    /// [`persist_plans`](Self::persist_plans) does with plans: every 55 s, and only while the vehicle [permits](crate::Plans::may_persist).
    /// True when there is more to do at once.
    ///
    /// A vehicle that does not permit it in flight begins, after a restart there, with the time of its take-off, until the first
    /// signed frame tells it better: see [`set_time`](crate::Signing::set_time) too.
    pub fn persist_signing<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
        vehicle: &mut V,
    ) -> bool {
        let may_write = vehicle.may_persist();
        if vehicle.signing().is_none() || !(may_write || store.is_unread()) {
            return false;
        }
        if !self.core.turn.is_for(Turn::KEY) {
            return true;
        }
        let Some(signing) = vehicle.signing() else { return false };
        let job = if may_write { signing.unsaved(now) } else { None };
        let step = store.step(now, signing, job);
        self.core.turn.took(Turn::KEY, step);
        // A key that was set in the meantime takes precedence.
        if step == Step::Unread && vehicle.signing().is_some_and(|signing| signing.is_lost()) {
            let result = read_key(now, store, vehicle);
            self.tell_restored(now, &result, &KEY_TEXTS, true);
        }
        let Some(signing) = vehicle.signing() else { return false };
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
fn read_key<F: NorFlash, V: Autopilot>(
    now: Instant,
    store: &mut SigningStore<F>,
    vehicle: &mut V,
) -> Result<(), RestoreError<F::Error>> {
    let Some(signing) = vehicle.signing() else { return Ok(()) };
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
