//! The pending refusals of one link, for a vehicle without plans: a short queue, ordered as the requests.

use crate::dialect::{MavMissionResult, MavMissionType, MissionAck};
use crate::link::Outbox;
use crate::message::Address;

/// Capacity of the queue: a power of two, because the index into the ring wraps.
const SLOTS: usize = 8;

/// A pending MISSION_ACK with UNSUPPORTED.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Refusal {
    to: Address,
    /// As received, even if it names no plan (M-25, M-26).
    mission_type: MavMissionType,
}

/// The pending refusals of a link: a ring buffer, initially all zero bits.
#[derive(Clone, Debug)]
pub struct Refusals {
    slots: [Refusal; SLOTS],
    /// The index of the oldest one.
    first: u8,
    count: u8,
}

impl Refusals {
    pub(super) const fn new() -> Self {
        let none = Refusal { to: Address::new(0, 0), mission_type: MavMissionType(0) };
        Self { slots: [none; SLOTS], first: 0, count: 0 }
    }

    pub(super) const fn is_empty(&self) -> bool {
        self.count == 0
    }

    fn slot(&mut self, number: u8) -> Option<&mut Refusal> {
        self.slots.get_mut(usize::from(self.first.wrapping_add(number)) % SLOTS)
    }

    /// Queues a refusal. Repeated requests share a slot. Returns false if no slot is free.
    pub(super) fn push(&mut self, to: Address, mission_type: MavMissionType) -> bool {
        if usize::from(self.count) >= SLOTS {
            return false;
        }
        let refusal = Refusal { to, mission_type };
        if (0..self.count).all(|number| self.slot(number).is_some_and(|slot| *slot != refusal)) {
            if let Some(slot) = self.slot(self.count) {
                *slot = refusal;
            }
            self.count = self.count.wrapping_add(1);
        }
        true
    }

    /// Sends the oldest refusal. Returns false if none is pending.
    pub(super) fn next(&mut self, tx: &mut Outbox) -> bool {
        if self.is_empty() {
            return false;
        }
        let Some(Refusal { to, mission_type }) = self.slot(0).copied() else { return false };
        self.first = self.first.wrapping_add(1);
        self.count = self.count.wrapping_sub(1);
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

    /// M-25: an answer for each request, in the order of the requests, at every position of the ring; one for repeated requests.
    #[test]
    fn refusals_are_sent_in_the_order_of_the_requests() {
        let mut tx = Outbox::VACANT;
        tx.set_version(Version::V2);
        let mut refusals = Refusals::new();
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
                (refusals.is_empty(), refusals.clone().push(Address::new(1, 1), MavMissionType(0))),
                (count == 0, count < 8)
            );
            for number in 0..count {
                assert_eq!(sent(&mut refusals, &mut tx), Some((255, number, number)));
            }
            assert_eq!(sent(&mut refusals, &mut tx), None);
        }
    }
}
