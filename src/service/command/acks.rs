//! The pending answers of a link (C-3).

use super::long::NO_PROGRESS;
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::link::Outbox;
use crate::message::{Address, ComponentId};
use crate::types::{Firmware, Outcome};

/// Capacity of the queue: a power of two, because the index into the ring wraps.
const SLOTS: usize = 4;

/// The pending answers of a link, ordered as the commands: a ring buffer.
#[derive(Clone, Debug)]
pub(crate) struct Acks {
    slots: [Ack; SLOTS],
    /// The index of the oldest one.
    first: u8,
    /// The number of pending answers.
    count: u8,
}

#[derive(Clone, Copy, Debug)]
struct Ack {
    to: Address,
    /// The component that answers.
    from: ComponentId,
    command: MavCmd,
    result: MavResult,
    /// The bytes of an `i32`, without its alignment: that saves padding on each link.
    result_param2: [u8; 4],
}

impl Acks {
    pub(crate) const fn new() -> Self {
        let none = Ack {
            to: Address::new(0, 0),
            from: ComponentId::ALL,
            command: MavCmd(0),
            result: MavResult::ACCEPTED,
            result_param2: [0; 4],
        };
        Self { slots: [none; SLOTS], first: 0, count: 0 }
    }

    /// Whether the queue is full; a further command is dropped.
    pub(crate) fn is_full(&self) -> bool {
        usize::from(self.count) >= SLOTS
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Whether an IN_PROGRESS is pending.
    pub(crate) fn has_progress(&self) -> bool {
        (0..self.count).any(|number| self.slot(number).is_some_and(|ack| ack.result == MavResult::IN_PROGRESS))
    }

    fn slot(&self, number: u8) -> Option<&Ack> {
        self.slots.get(usize::from(self.first.wrapping_add(number)) % SLOTS)
    }

    /// Queues the answer of a component to `to`. The caller checks [`is_full`](Self::is_full) before the command is carried
    /// out.
    pub(crate) fn push(&mut self, from: ComponentId, to: Address, command: MavCmd, outcome: Outcome) {
        if self.is_full() {
            return;
        }
        let end = usize::from(self.first.wrapping_add(self.count)) % SLOTS;
        if let Some(slot) = self.slots.get_mut(end) {
            let Outcome { result, result_param2 } = outcome;
            *slot = Ack { to, from, command, result, result_param2: result_param2.to_ne_bytes() };
        }
        self.count = self.count.wrapping_add(1);
    }

    /// Sends the oldest answer. Returns false if none is pending. `progress` returns the progress of a running command.
    pub(crate) fn next<F: Firmware>(&mut self, tx: &mut Outbox, progress: impl FnOnce(MavCmd) -> u8) -> bool {
        if self.is_empty() {
            return false;
        }
        let Some(ack) = self.slot(0).copied() else { return false };
        self.first = self.first.wrapping_add(1);
        self.count = self.count.wrapping_sub(1);
        let message = CommandAck {
            command: ack.command,
            result: ack.result,
            progress: if ack.result == MavResult::IN_PROGRESS { progress(ack.command) } else { NO_PROGRESS },
            result_param2: i32::from_ne_bytes(ack.result_param2),
            target_system: ack.to.system.wire(),
            target_component: ack.to.component.wire(),
        };
        tx.send_from::<F, _>(Some(ack.from), &message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Version;
    use crate::message::Message;

    struct Rover;

    impl Firmware for Rover {
        type Vehicle = ();
        type Plans = crate::types::NoPlans;
        type Parameters = crate::service::param::NoParams;
    }

    /// C-3: an answer for each command, in the order of the commands, at every position of the ring.
    #[test]
    fn answers_are_sent_in_the_order_of_the_commands() {
        let mut tx = Outbox::VACANT;
        tx.set_version(Version::V2);
        let mut acks = Acks::new();
        let sent = |acks: &mut Acks, tx: &mut Outbox| {
            acks.next::<Rover>(tx, |_| 0).then(|| {
                let frame = tx.pending();
                let command = CommandAck::decode(&frame[10..frame.len() - 2]).command.0;
                tx.advance(frame.len());
                command
            })
        };
        let mut next = 0;
        for count in 0..=4 {
            for number in 0..count {
                assert!(!acks.is_full());
                acks.push(
                    ComponentId::new(1),
                    Address::new(255, 190),
                    MavCmd(next + number),
                    MavResult::ACCEPTED.into(),
                );
            }
            assert_eq!((acks.is_full(), acks.is_empty()), (count == 4, count == 0));
            for _ in 0..count {
                assert_eq!(sent(&mut acks, &mut tx), Some(next));
                next += 1;
            }
            assert_eq!(sent(&mut acks, &mut tx), None);
        }
    }
}
