//! The order of the services carries nothing: in any order of the list, the same traffic has the same answers.
//!
//! It compares the frames that each link sends until nothing is pending, without sequence numbers: services with bulk
//! data share the link in the order of the list.

use core::cell::RefCell;
use proptest::prelude::*;
use std::vec::Vec;

use super::deadlines::world::{World, event};
use crate::service::{Service, Visit, VisitAll};
use crate::types::Firmware;

/// At least the number of services, those of the library and the fields of the declaration.
const PLACES: u8 = 32;

std::thread_local! {
    static ORDER: RefCell<Vec<u8>> = RefCell::new((0..PLACES).collect());
}

/// The order in which this thread visits the services.
pub(super) fn order() -> Vec<u8> {
    ORDER.with(|order| order.borrow().clone())
}

/// Visits only one of the fields of a declaration.
pub(super) struct Nth<'a, V> {
    /// How many come before it.
    pub(super) nth: u8,
    pub(super) visit: &'a mut V,
}

impl<V> Nth<'_, V> {
    fn is_it(&mut self) -> bool {
        let nth = self.nth;
        self.nth = nth.wrapping_sub(1);
        nth == 0
    }
}

impl<F: Firmware, V: Visit<F>> Visit<F> for Nth<'_, V> {
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool {
        self.is_it() && self.visit.visit(service, link)
    }
}

impl<F: Firmware, V: VisitAll<F>> VisitAll<F> for Nth<'_, V> {
    fn visit<'l, S: Service<F>>(&mut self, service: &mut S, links: impl Iterator<Item = &'l mut S::Link>)
    where
        S::Link: 'l,
    {
        if self.is_it() {
            self.visit.visit(service, links);
        }
    }
}

fn set_order(order: Vec<u8>) {
    ORDER.with(|place| *place.borrow_mut() = order);
}

proptest! {
    #[test]
    fn answers_do_not_depend_on_the_order_of_the_services(
        order in Just((0..PLACES).collect::<Vec<_>>()).prop_shuffle(),
        events in prop::collection::vec(event(), 1..60),
    ) {
        let mut sent = [(); 2].map(|()| Vec::new());
        for (order, sent) in [(0..PLACES).collect(), order].into_iter().zip(&mut sent) {
            set_order(order);
            let mut world = World::new(false);
            for event in &events {
                world.on(event);
                // A request to a service that was polled before waits for the next poll. Without this one, the number
                // of polls would depend on the order, and the pulse is sampled by each.
                world.poll();
                world.wake();
                sent.push(world.sent());
            }
        }
        set_order((0..PLACES).collect());
        for (number, (first, second)) in sent[0].iter().zip(&sent[1]).enumerate() {
            prop_assert_eq!(first, second, "after event {}: {:?}", number, events[number]);
        }
    }
}
