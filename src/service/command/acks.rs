//! The state of a link: its pending answers (C-3).

use super::long::NO_PROGRESS;
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::link::Outbox;
use crate::list::take_first;
use crate::message::{Address, ComponentId};
use crate::types::{Firmware, Outcome};
use heapless::Vec;

/// The maximum number of answers that are pending on a link.
const MAX_ANSWERS: usize = 4;

/// The state of the command protocol on a link.
#[derive(Debug)]
pub struct CommandLink {
    /// The pending answers, in the order of the commands.
    answers: Vec<PendingAck, MAX_ANSWERS, u8>,
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

impl CommandLink {
    pub(super) const VACANT: Self = Self { answers: Vec::new(), explained_in: 0 };

    /// Whether there is a slot for another answer. Without one, a further command is dropped.
    pub(crate) fn has_room(&self) -> bool {
        !self.answers.is_full()
    }

    /// Whether every received command was answered.
    pub(crate) fn has_answered(&self) -> bool {
        self.answers.is_empty()
    }

    /// Whether an IN_PROGRESS is pending.
    pub(super) fn has_progress(&self) -> bool {
        self.answers.iter().any(|ack| ack.result == MavResult::IN_PROGRESS)
    }

    /// Queues the answer of a component to `to`. The caller checks [`has_room`](Self::has_room) before the command is executed.
    pub(super) fn push(&mut self, from: ComponentId, to: Address, command: MavCmd, outcome: Outcome) {
        let Outcome { result, result_param2 } = outcome;
        let result_param2 = result_param2.to_ne_bytes();
        let _ = self.answers.push(PendingAck { to, from, command, result, result_param2 });
    }

    /// Sends the oldest answer. Returns false if none is pending. `progress` returns the progress of a running command.
    pub(super) fn send<F: Firmware>(&mut self, tx: &mut Outbox, progress: impl FnOnce(MavCmd) -> u8) -> bool {
        let Some(ack) = take_first(&mut self.answers, |_| true) else { return false };
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
