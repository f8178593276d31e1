//! The signing key and the time that survive a power cut: what joins the stack and a [`SigningStore`] (G-13, G-15).

use embedded_storage::nor_flash::NorFlash;

use super::Stack;
use crate::dialect::MavSeverity;
use crate::message::Text;
use crate::service::mission::PlanStorage;
use crate::service::statustext::StatusTexts;
use crate::storage::{SigningStore, Step};
use crate::time::Instant;
use crate::vehicle::Autopilot;

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Reads the signing key back after a start, with the time to begin with. Call it once, before the loop. Without a whole
    /// record, as in a new vehicle, the vehicle's [`Signing`](crate::Signing) stays as it is.
    ///
    /// # Errors
    ///
    /// What the flash reported when it could not be read. There is no key then, unless the vehicle has set one: a link that
    /// [requires](crate::Accept::Required) signatures hears nothing.
    #[inline(never)]
    pub fn restore_signing<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
        vehicle: &mut V,
    ) -> Result<(), F::Error> {
        let Some(signing) = vehicle.signing() else { return Ok(()) };
        match store.open() {
            Ok(Some((key, timestamp))) => signing.restore(now, key, timestamp),
            Ok(None) => {}
            Err(error) => {
                event!("signing: storage cannot be read");
                let texts: &mut StatusTexts = &mut self.texts;
                texts.push(now, self.core.normal, MavSeverity::ERROR, &Text::new("The signing key cannot be read"));
                return Err(error);
            }
        }
        Ok(())
    }

    /// Writes the signing key when it was changed, and with it the time that is used up, one step at a time, as
    /// [`persist_plans`](Self::persist_plans) does with plans: every 55 s, and only while the vehicle [permits](crate::Plans::may_persist).
    /// True when there is more to do at once.
    ///
    /// A vehicle that does not permit it in flight begins, after a restart there, with the time of its take-off, until the first
    /// signed frame tells it better: see [`set_time`](crate::Signing::set_time) too.
    #[inline(never)]
    pub fn persist_signing<F: NorFlash, V: Autopilot>(
        &mut self,
        now: Instant,
        store: &mut SigningStore<F>,
        vehicle: &mut V,
    ) -> bool {
        if !vehicle.may_persist() {
            return false;
        }
        let Some(signing) = vehicle.signing() else { return false };
        let job = signing.unsaved(now);
        match store.step(signing, job) {
            Step::Idle => return false,
            Step::Busy => {}
            Step::Done => signing.saved(),
            Step::Failed => signing.not_saved(now),
        }
        true
    }
}
