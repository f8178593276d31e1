//! The plan service of a firmware without plans. It answers every request with UNSUPPORTED, because a client would
//! repeat an unanswered request for seconds.

use heapless::Vec;

use super::messages::{is_handled, is_request, mission_type};
use crate::dialect::{MavMissionResult, MavMissionType, MissionAck};
use crate::link::{Outbox, Port};
use crate::list::take_first;
use crate::message::Address;
use crate::service::{About, Cx, Firmware, Handled, Received, Service, Turn, View};
use crate::time::Instant;

/// Capacity of a link's queue of refusals.
const SLOTS: usize = 8;

/// The plan service of a firmware without plans.
#[derive(Debug)]
pub struct WithoutPlans;

impl<F: Firmware> Service<F> for WithoutPlans {
    const NEW: Self = Self;
    type Link = Refusals;
    const VACANT: Refusals = Refusals(Vec::new());
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::MissionAck]);
    type Reply = ();

    fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, link: &mut Refusals, received: &Received<'_>) -> Handled {
        let Received { frame, from, target, .. } = received;
        match target.system.wire() {
            _ if !is_handled(frame.id()) => Handled::No,
            0 => Handled::OutOfPlace,
            _ if !is_request(frame.id()) || link.push(from.address, mission_type(frame)) => Handled::Yes,
            _ => Handled::NoRoom,
        }
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, _: &Port, link: &Refusals, _: Turn) -> Option<(Instant, ())> {
        (!link.0.is_empty()).then_some((view.now, ()))
    }

    fn send(&mut self, _: &mut Cx<'_, F>, port: &mut Port, link: &mut Refusals, (): ()) -> bool {
        link.next(&mut port.outbox)
    }
}

/// A pending MISSION_ACK with UNSUPPORTED.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Refusal {
    to: Address,
    /// As received, even if it names no plan (M-25, M-26).
    mission_type: MavMissionType,
}

/// The pending refusals of a link, oldest first.
#[derive(Clone, Debug)]
pub struct Refusals(Vec<Refusal, SLOTS, u8>);

impl Refusals {
    /// Queues a refusal. Repeated requests share a slot. Returns false if no slot is free.
    fn push(&mut self, to: Address, mission_type: MavMissionType) -> bool {
        let refusal = Refusal { to, mission_type };
        !self.0.is_full() && (self.0.contains(&refusal) || self.0.push(refusal).is_ok())
    }

    /// Sends the oldest refusal. Returns false if none is pending.
    fn next(&mut self, tx: &mut Outbox) -> bool {
        let Some(Refusal { to, mission_type }) = take_first(&mut self.0, |_| true) else { return false };
        tx.send(&MissionAck {
            target_system: to.system.wire(),
            target_component: to.component.wire(),
            r#type: MavMissionResult::UNSUPPORTED,
            mission_type,
            opaque_id: 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Version;
    use crate::message::Message;

    /// M-25: an answer for each request, in the order of the requests, whatever the queue held before; one for repeated
    /// requests.
    #[test]
    fn refusals_are_sent_in_the_order_of_the_requests() {
        let mut tx = Outbox::VACANT;
        tx.set_version(Version::V2);
        let mut refusals = Refusals(Vec::new());
        let sent = |refusals: &mut Refusals, tx: &mut Outbox| {
            refusals.next(tx).then(|| {
                let frame = tx.pending();
                let ack = MissionAck::decode(&frame[10..frame.len() - 2]);
                tx.advance(frame.len());
                assert_eq!((ack.r#type, ack.opaque_id), (MavMissionResult::UNSUPPORTED, 0));
                (ack.target_system, ack.target_component, ack.mission_type.0)
            })
        };
        for count in 0..=8 {
            for number in 0..count {
                assert!(refusals.push(Address::new(255, number), MavMissionType(number)));
                assert_eq!(refusals.push(Address::new(255, number), MavMissionType(number)), number < 7);
            }
            assert_eq!(
                (refusals.0.is_empty(), refusals.clone().push(Address::new(1, 1), MavMissionType(0))),
                (count == 0, count < 8)
            );
            for number in 0..count {
                assert_eq!(sent(&mut refusals, &mut tx), Some((255, number, number)));
            }
            assert_eq!(sent(&mut refusals, &mut tx), None);
        }
    }
}
