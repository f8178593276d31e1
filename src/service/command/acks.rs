//! The state of a link: its pending answers (C-3).

use core::num::Wrapping;

use super::long::NO_PROGRESS;
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::link::Outbox;
use crate::message::{Address, ComponentId};
use crate::types::{Firmware, Outcome};

/// The maximum number of answers that are pending on a link: a power of two, because the counters of the ring wrap.
const MAX_ANSWERS: u8 = 4;

/// The state of the command protocol on a link.
#[derive(Debug)]
pub struct CommandLink {
    /// The pending answers, in the order of the commands: a ring buffer.
    answers: [PendingAck; 4],
    /// The numbers of answers that were sent, and that were queued.
    sent: Wrapping<u8>,
    queued: Wrapping<u8>,
    /// The period in which a text last explained a refusal; see [`refusal`](super::refusal).
    pub(super) explained_in: u16,
}

/// A COMMAND_ACK that answers a received command.
#[derive(Clone, Copy, Debug)]
struct PendingAck {
    to: Address,
    /// The component that answers.
    from: ComponentId,
    command: MavCmd,
    result: MavResult,
    /// The bytes of an `i32`, without its alignment: that saves padding on each link.
    result_param2: [u8; 4],
}

impl PendingAck {
    const NONE: Self = Self {
        to: Address::new(0, 0),
        from: ComponentId::ALL,
        command: MavCmd(0),
        result: MavResult::ACCEPTED,
        result_param2: [0; 4],
    };
}

/// Returns the place of an answer in the ring.
fn place(Wrapping(number): Wrapping<u8>) -> usize {
    usize::from(number % MAX_ANSWERS)
}

impl CommandLink {
    pub(super) const VACANT: Self =
        Self { answers: [PendingAck::NONE; 4], sent: Wrapping(0), queued: Wrapping(0), explained_in: 0 };

    fn answer(&self, number: Wrapping<u8>) -> Option<&PendingAck> {
        self.answers.get(place(number))
    }

    /// Whether there is a slot for another answer. Without one, a further command is dropped.
    pub(super) fn has_room(&self) -> bool {
        (self.queued - self.sent).0 < MAX_ANSWERS
    }

    /// Whether every received command was answered.
    pub(super) fn has_answered(&self) -> bool {
        self.queued == self.sent
    }

    /// Whether this command, or none, is answered next.
    pub(super) fn is_next(&self, command: MavCmd) -> bool {
        self.answer(self.sent).is_some_and(|ack| ack.command == command)
    }

    /// Whether an IN_PROGRESS is pending.
    pub(super) fn has_progress(&self) -> bool {
        let mut number = self.sent;
        while number != self.queued {
            if self.answer(number).is_some_and(|ack| ack.result == MavResult::IN_PROGRESS) {
                return true;
            }
            number += 1;
        }
        false
    }

    /// Queues the answer of a component to `to`. The caller checks [`has_room`](Self::has_room) before the command is executed.
    pub(super) fn push(&mut self, from: ComponentId, to: Address, command: MavCmd, outcome: Outcome) {
        if let Some(answer) = self.answers.get_mut(place(self.queued)) {
            let Outcome { result, result_param2 } = outcome;
            *answer = PendingAck { to, from, command, result, result_param2: result_param2.to_ne_bytes() };
            self.queued += 1;
        }
    }

    /// Sends the oldest answer. Returns false if none is pending. `progress` returns the progress of a running command.
    pub(super) fn send<F: Firmware>(&mut self, tx: &mut Outbox, progress: impl FnOnce(MavCmd) -> u8) -> bool {
        let Some(ack) = self.answer(self.sent).filter(|_| !self.has_answered()).copied() else { return false };
        self.sent += 1;
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
        type Credits = [crate::types::Credits; 0];
    }

    /// C-3: an answer for each command, in the order of the commands, with any number of them.
    #[test]
    fn answers_are_sent_in_the_order_of_the_commands() {
        let mut tx = Outbox::VACANT;
        tx.set_version(Version::V2);
        let mut link = CommandLink::VACANT;
        let sent = |link: &mut CommandLink, tx: &mut Outbox| {
            link.send::<Rover>(tx, |_| 0).then(|| {
                let frame = tx.pending();
                let command = CommandAck::decode(&frame[10..frame.len() - 2]).command.0;
                tx.advance(frame.len());
                command
            })
        };
        let mut next = 0;
        for count in 0..=4 {
            for number in 0..count {
                assert!(link.has_room());
                link.push(
                    ComponentId::new(1),
                    Address::new(255, 190),
                    MavCmd(next + number),
                    MavResult::ACCEPTED.into(),
                );
            }
            assert_eq!((link.has_room(), link.has_answered()), (count < 4, count == 0));
            for _ in 0..count {
                assert_eq!(sent(&mut link, &mut tx), Some(next));
                next += 1;
            }
            assert_eq!(sent(&mut link, &mut tx), None);
        }
    }
}
