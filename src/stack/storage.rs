//! Persistence: the code between the services and a [`Store`] (G-13, G-15, M-44, P-17, SEC-11, SEC-12).
//!
//! Writing is separate from polling, because an erase of a microcontroller's own flash stops the processor for 100 ms
//! and more. The firmware chooses when [`persist`](Stack::persist) runs. The vehicle is asked before each step.

use embedded_storage::nor_flash::NorFlash;

use super::services::{Services, States};
use super::{Cx, Declares, PeerMemory, Stack, TextMemory, split};
use crate::service::param::{ParamService, ParamTable, Parameters};
use crate::storage::{self, Body, Format, KINDS, Persistent, Record, RestoreErrors, Step, Store};
use crate::time::Instant;

/// Defines what is done for each kind, in the order of the list: the service, its type, and its field of [`RestoreErrors`].
macro_rules! kinds {
    ($($index:literal $service:ident $type:ident $field:ident;)*) => {
        impl<D: Declares> Services<D> {
            /// The format of each kind, and the maximum length of its content.
            const KINDS: [(Format, u32); KINDS] =
                [$((<D::$type as Persistent<D>>::FORMAT, <D::$type as Persistent<D>>::MAX_LEN)),*];

            const fn region_len<F: NorFlash>() -> u32 {
                0u32$(.saturating_add(Record::region_len::<F>(<D::$type as Persistent<D>>::MAX_LEN)))*
            }

            fn restore<F: NorFlash>(
                &mut self,
                cx: &mut Cx<'_, D>,
                store: &mut Store<F>,
            ) -> Result<(), RestoreErrors<F::Error>> {
                let Store { flash, records, .. } = store;
                let [$($service),*] = records;
                $(let $service = storage::read(cx, &mut self.$service, &mut Body::new($service, flash), false).err();)*
                let is_restored = true $(&& $service.is_none())*;
                if is_restored { Ok(()) } else { Err(RestoreErrors { $($field: $service),* }) }
            }

            fn persist<F: NorFlash>(
                &mut self,
                cx: &mut Cx<'_, D>,
                states: &mut [States<D>],
                store: &mut Store<F>,
            ) -> bool {
                let Store { flash, records, turn, .. } = store;
                let [$($service),*] = records;
                let step = match *turn {
                    $($index => {
                        let links = states.iter_mut().map(|state| &mut state.$service);
                        if self.$service.cancel_if_refused(cx, links) {
                            Step::Busy
                        } else {
                            let links = states.iter_mut().map(|state| &mut state.$service);
                            let body = &mut Body::new($service, flash);
                            let step = storage::persist(cx, &mut self.$service, links, body);
                            if step == Step::Unread {
                                // Not in the call above, whose stack is free again.
                                let _ = storage::read(cx, &mut self.$service, body, true);
                            }
                            step
                        }
                    })*
                    _ => Step::Idle,
                };
                store.took_turn(step);
                step != Step::Idle
            }
        }
    };
}

// The order of the parts of a region. The length of the first one never changes.
kinds! {
    0 signing Signing signing;
    1 param Param parameters;
    2 mission Mission plans;
}

impl<F: NorFlash> Store<F> {
    /// Returns the length of the region for everything that the firmware declares, in bytes: a multiple of the erase
    /// unit. Two units or more for each of `signing`, `parameters` and `plans`.
    pub const fn region_len<D: Declares>() -> u32 {
        Services::<D>::region_len::<F>()
    }
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Reads the signing key, the parameters and the plans at startup, as far as they are declared, and persists them in
    /// `store` from then on. Call it once, before the loop. It reads the whole store, and blocks for as long as the
    /// flash takes. If nothing was ever stored, nothing changes.
    ///
    /// The vehicle is told of each parameter that does not have its default. The stack and the vehicle check the plans
    /// as in an upload. A plan that this firmware cannot fly, or has no room for, does not become live, and a text
    /// reports it.
    ///
    /// # Errors
    ///
    /// Returns an error if something is damaged or cannot be read (G-18), and a text reports each. The store is in use
    /// nevertheless, and everything else was restored.
    ///
    /// - [`plans`](RestoreErrors::plans): the plans that were not read are empty. A vehicle that must not fly without
    ///   its geofence learns here that there may have been one.
    /// - [`parameters`](RestoreErrors::parameters): those that were not read keep their values.
    /// - [`signing`](RestoreErrors::signing): there is no key, unless the firmware has set one, but the links are not
    ///   open. Links that would sign, or refuse unsigned frames, accept nothing until there is a key. Only links for
    ///   provisioning (`LinkSigning::provisioning`) accept SETUP_SIGNING, which ends this state by setting a key or by
    ///   removing it. `Signing::set_key` and `clear_key` end it too. The unsigned text that reports it is repeated, at
    ///   most every 10 s, when a frame is refused on a link for provisioning.
    ///
    /// While the newest content cannot be read, older content does not replace it. [`persist`](Self::persist) reads
    /// again: the key at any time, parameters and plans while the vehicle is disarmed. Parameters that still have their
    /// defaults are then restored, and plans that were not uploaded meanwhile go live.
    /// [`plan_changed`](crate::Plans::plan_changed) informs the vehicle, and a text the operators.
    #[inline(never)]
    pub fn restore<F: NorFlash>(
        &mut self,
        now: Instant,
        store: &mut Store<F>,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), RestoreErrors<F::Error>> {
        store.divide(Services::<D>::KINDS);
        let (mut cx, services, ..) = split!(&mut *self, now, vehicle);
        services.restore(&mut cx, store)
    }

    /// Writes what has changed, one step per call: it erases at most one erase unit, or writes 256 bytes, and only while
    /// the vehicle [permits](crate::Vehicle::may_persist) it. It may block for as long as that takes. Returns true if
    /// more is to be done at once.
    ///
    /// Plans are written when they were uploaded. With [`Durability::Durable`](crate::plan::Durability::Durable) the final
    /// answer to an upload waits for this: call it in every pass of the loop, or from an idle task. Between uploads it
    /// erases in advance, so that a plan is stored within a second of its last item even if an erase takes 100 ms.
    ///
    /// Parameters are written about a second after a change, at most every ten seconds; the signing key after a change;
    /// and the signing time every 55 s. If the vehicle does not permit writing in flight, a restart in flight begins
    /// with the time of take-off, until the first signed frame provides a later time. See also `Signing::set_time`.
    #[inline(never)]
    pub fn persist<F: NorFlash>(&mut self, now: Instant, store: &mut Store<F>, vehicle: &mut D::Vehicle) -> bool {
        let (mut cx, services, _, states) = split!(&mut *self, now, vehicle);
        (0..KINDS).any(|_| services.persist(&mut cx, states, store))
    }
}

/// With `parameters` (P-17).
impl<D, const LINKS: usize> Stack<D, LINKS>
where
    D: Declares<Parameters: ParamTable, Param = ParamService>,
    D::Vehicle: Parameters<Table = D::Parameters>,
{
    /// Schedules the parameters that are not stored yet for writing at once, like MAV_CMD_PREFLIGHT_STORAGE: for use
    /// before a reboot. Afterwards, [`persist`](Self::persist) returns false once they are stored, or cannot be.
    pub fn save_parameters(&mut self, now: Instant) {
        self.services.param.write_now(now, &mut self.parameters);
    }
}
