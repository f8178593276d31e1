//! The answers that a link owes.

use super::memory::NO_PROGRESS;
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::frame::Address;
use crate::link::Outbox;
use crate::vehicle::Outcome;

/// Answers that one link can owe.
const SLOTS: usize = 4;

/// The answers that a link owes, in the order of the questions.
#[derive(Clone, Debug)]
pub(crate) struct Acks(heapless::Deque<Ack, SLOTS>);

#[derive(Clone, Copy, Debug)]
struct Ack {
    to: Address,
    command: MavCmd,
    outcome: Outcome,
}

impl Acks {
    pub(crate) const fn new() -> Self {
        Self(heapless::Deque::new())
    }

    /// Whether a command would be dropped.
    pub(crate) fn is_full(&self) -> bool {
        self.0.is_full()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Owes the answer to `to`. The caller asked [`is_full`](Self::is_full) before the command was carried out.
    /// Not inlined: there are six who push.
    #[inline(never)]
    pub(crate) fn push(&mut self, to: Address, command: MavCmd, outcome: Outcome) {
        event!("command {=u16} from {}: {=u8}", command.0, to, outcome.result.0);
        let _ = self.0.push_back(Ack { to, command, outcome });
    }

    /// Sends the oldest answer. False when none is owed. `progress` says how far a command is that runs.
    pub(crate) fn next(&mut self, tx: &mut Outbox, progress: impl FnOnce(MavCmd) -> u8) -> bool {
        let Some(ack) = self.0.pop_front() else { return false };
        tx.send(&CommandAck {
            command: ack.command,
            result: ack.outcome.result,
            progress: if ack.outcome.result == MavResult::IN_PROGRESS { progress(ack.command) } else { NO_PROGRESS },
            result_param2: ack.outcome.result_param2,
            target_system: ack.to.system.0,
            target_component: ack.to.component.0,
        })
    }
}
