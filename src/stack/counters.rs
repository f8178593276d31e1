//! All counters in one call.

use super::{Declares, Memory, Stack};
use crate::log::Counters;
use crate::service::ShowCounters;
use crate::types::LinkId;

/// A counter of the stack or of a service, returned by [`Stack::counters`](crate::Stack::counters). It wraps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct Counter {
    /// The link that it counts for; `None` if it counts for all of them together.
    pub link: Option<LinkId>,
    /// The type that it is a field of, such as `RxCounters`, whose page describes it.
    pub of: &'static str,
    /// Its name, such as `bad_crc`.
    pub name: &'static str,
    /// Its value.
    pub value: u32,
}

/// Passes each counter to a function.
struct Each<C>(C);

impl<C: FnMut(Counter)> Each<C> {
    fn show<T: Counters>(&mut self, link: Option<LinkId>, counters: &T) {
        counters.each(|name, value| (self.0)(Counter { link, of: T::NAME, name, value }));
    }
}

impl<C: FnMut(Counter)> ShowCounters for Each<C> {
    fn counters(&mut self, counters: &impl Counters) {
        self.show(None, counters);
    }

    fn counters_of(&mut self, link: LinkId, counters: &impl Counters) {
        self.show(Some(link), counters);
    }
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Passes each counter of the stack and its services to `counter`: for a console, a log, or a test that looks for drops. Their names
    /// take flash only in a firmware that calls this.
    ///
    /// ```
    /// # use mavstack::prelude::*;
    /// # struct Rover;
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
    /// # }
    /// # #[derive(Stack)]
    /// # #[stack(vehicle: Rover, links: 2)]
    /// # struct Mavlink;
    /// fn show(stack: &StackOf<Mavlink>) {
    ///     stack.counters(|counter| {
    ///         if counter.value != 0 {
    ///             println!("{:?} {}::{} {}", counter.link, counter.of, counter.name, counter.value);
    ///         }
    ///     });
    /// }
    /// # static PULSE: Pulse = Pulse::new();
    /// # show(&StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), &PULSE), [LinkConfig::uart(57_600); 2]));
    /// ```
    pub fn counters(&self, counter: impl FnMut(Counter)) {
        let mut each = Each(counter);
        for link in &self.links {
            let mut own = StackLinkCounters::ZERO;
            own.refused_messages = self.requests.view().refused_on(link.port.id);
            each.counters_of(link.port.id, &link.decoder.counters());
            each.counters_of(link.port.id, &link.port.counters);
            each.counters_of(link.port.id, &own);
        }
        let mut own = StackCounters::ZERO;
        own.dropped_texts = self.dropped_texts();
        own.refused_requests = self.requests.view().refused_requests();
        own.clock_steps = self.clock_steps();
        each.counters(&own);
        each.counters(&self.shared.faults);
        self.services.counters(&mut each);
    }
}

counters! {
    /// Counters of the stack itself, as [`Stack::counters`] shows them.
    StackCounters {
        /// [`Stack::dropped_texts`].
        drop dropped_texts,
        /// [`Stack::refused_requests`].
        drop refused_requests,
        /// [`Stack::clock_steps`].
        count clock_steps,
    }
}

counters! {
    /// Counters of the stack on one link, as [`Stack::counters`] shows them.
    StackLinkCounters {
        /// [`Stack::refused_messages`].
        drop refused_messages,
    }
}
