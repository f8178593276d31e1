//! Requests to a service, and its answers.

use crate::dialect::{MavCmd, MavResult};
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Address, Message};
use crate::num;
use crate::time::Duration;
use crate::types::{Command, Origin, Outcome, Payer, Peer, Refusal, Sender, SignedAt, Trust};

/// A frame that is addressed to us or to all.
pub struct Received<'a> {
    pub(crate) frame: &'a Frame<'a>,
    /// The sender, and the link on which it was received.
    pub(crate) from: Peer,
    /// What proves the sender.
    pub(crate) trust: Trust,
    /// Whether what the frame claims counts.
    pub(crate) counts: bool,
    /// Whether the sender may change the vehicle.
    pub(crate) may_change: bool,
    /// The address to which it is sent.
    pub(crate) target: Address,
    /// How long ago it was signed, if that is known.
    pub(crate) age: Option<Duration>,
}

/// The fate of a frame that a service got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handled {
    /// The service does not handle its message.
    No,
    /// It was handled.
    Yes,
    /// There is no room for its answer, so it was dropped without effect. Counted.
    NoRoom,
    /// It does not belong on this link, or to this address. Counted.
    OutOfPlace,
}

/// A received command.
#[derive(Debug)]
pub struct Request {
    pub(crate) command: Command,
    /// The id in the answer.
    pub(crate) answer_as: MavCmd,
    /// SET_MODE.custom_mode, if the command was received as SET_MODE: a parameter cannot hold every number.
    pub(crate) set_mode: Option<u32>,
    /// Set by the stack.
    pub(crate) signed_at: SignedAt,
    /// Whose credits pay for what the command causes on the high-latency links (L-17). Set by the stack.
    pub(crate) payer: Payer,
    /// No service has answered it: the streams then answer for a message that nobody knows.
    pub(crate) is_unclaimed: bool,
}

impl Request {
    /// Returns the command.
    pub const fn command(&self) -> &Command {
        &self.command
    }

    /// Whether it is MAV_CMD_REQUEST_MESSAGE for message `M`.
    pub fn asks_for<M: Message>(&self) -> bool {
        let [id, ..] = self.command.params;
        self.command.id == MavCmd::REQUEST_MESSAGE && num::integer(id) == Some(M::ID)
    }

    /// Whether the answer to a request may be sent on the link on which it was received. Otherwise it is DENIED.
    pub fn has_response_target(&self) -> bool {
        self.command.has_response_target()
    }
}

impl From<Command> for Request {
    fn from(command: Command) -> Self {
        Self {
            answer_as: command.id,
            command,
            set_mode: None,
            signed_at: None,
            payer: Payer::Anyone,
            is_unclaimed: false,
        }
    }
}

/// The answer to a command.
#[derive(Clone, Copy, Debug)]
pub enum Verdict {
    /// The vehicle's answer, or one that needs no text.
    Done(Outcome),
    /// The stack refused the command: a text explains why.
    Refused(Refusal),
}

impl From<Outcome> for Verdict {
    fn from(outcome: Outcome) -> Self {
        Self::Done(outcome)
    }
}

impl Verdict {
    /// The vehicle's own answer, or one without a text.
    pub(crate) fn done(result: MavResult) -> Self {
        Self::Done(result.into())
    }

    /// ACCEPTED, or a refusal with a text that explains it.
    pub(crate) fn accepted(result: MavResult) -> Self {
        if result == MavResult::ACCEPTED { Self::done(result) } else { Self::Refused(result.into()) }
    }
}

impl From<MavResult> for Verdict {
    fn from(result: MavResult) -> Self {
        Self::done(result)
    }
}

impl Received<'_> {
    /// Returns the frame.
    pub const fn frame(&self) -> &Frame<'_> {
        self.frame
    }

    /// Returns the sender, and the link on which the frame was received.
    pub const fn from(&self) -> Peer {
        self.from
    }

    /// Returns the address to which the frame is sent: our system and component, or 0 for all.
    pub const fn target(&self) -> Address {
        self.target
    }

    /// Returns the sender, with what proves it.
    pub const fn sender(&self) -> Sender {
        Sender { peer: self.from, trust: self.trust }
    }

    /// Whether a claim in the frame counts: an answer to a request of ours, a status of a component, a time. The sender is in the
    /// peer table, no frame on the link within `peer_timeout` has proved it better than this one, and a component of our own
    /// system has signed it or is on a link that [trusts](crate::LinkConfig::trusts_own_system) our system.
    pub const fn counts(&self) -> bool {
        self.counts
    }

    /// Whether the sender may change the vehicle: it is in control, or nobody is (O-5, X-5).
    pub const fn may_change(&self) -> bool {
        self.may_change
    }

    pub(crate) fn origin(&self, port: &Port) -> Origin {
        Origin { from: self.from, trust: self.trust, class: port.config.class, age: self.age }
    }
}
