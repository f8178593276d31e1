//! A request, from its first transmission to its last answer.

use super::param::Query;
use super::recipients::{find, has_answered, overlap};
use super::{OutgoingCommand, TIMEOUT};
use crate::dialect::{CommandCancel, CommandInt, CommandLong, MavCmd};
use crate::link::Port;
use crate::message::{Address, ComponentId, Message};
use crate::network::{PeerInfo, Peers};
use crate::service::Shared;
use crate::time::{Duration, Instant};
use crate::types::{CommandPosition, LinkId, LinkMask, Peer, Recipient};

/// How long more answers may be received to a command that was sent more than once.
const LATE: Duration = Duration::from_secs(2);

/// The state of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    Free,
    /// It waits for the end of an equal command.
    Waiting,
    /// A transmission is pending. If the link has not taken it by [`Slot::at`], another link is tried.
    Due,
    /// An answer is expected until [`Slot::at`].
    Sent,
    /// IN_PROGRESS was received. Another answer is expected until [`Slot::at`].
    Running,
    /// It has ended, and more answers to it may be received until [`Slot::at`].
    Ended,
}

/// What is requested.
#[derive(Clone, Copy, Debug)]
pub(super) enum What {
    Command(OutgoingCommand),
    Param(Query),
}

/// A request that was not finally answered yet.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    pub(super) state: State,
    /// The number of attempts to send the command; of COMMAND_CANCEL once `is_cancelled`.
    pub(super) tries: u8,
    /// The number of transmissions.
    pub(super) sent: u8,
    pub(super) is_cancelled: bool,
    /// IN_PROGRESS was received.
    pub(super) is_running: bool,
    /// The recipient, and the link on which it is sent. Component 0 is any component of the system.
    pub(super) to: Peer,
    /// The component that is told to cancel it; 0 for none.
    pub(super) executor: ComponentId,
    pub(super) token: u16,
    pub(super) what: What,
    pub(super) at: Instant,
}

impl Slot {
    /// All zero bits.
    pub(super) const FREE: Self = Self {
        state: State::Free,
        tries: 0,
        sent: 0,
        is_cancelled: false,
        is_running: false,
        to: Peer { address: Address::new(0, 0), link: LinkId(0) },
        executor: ComponentId::ALL,
        token: 0,
        what: What::Command(OutgoingCommand::NONE),
        at: Instant::ZERO,
    };

    /// Returns the number of its command, if it is one.
    pub(super) fn command(&self) -> Option<MavCmd> {
        if let What::Command(command) = &self.what { Some(command.id) } else { None }
    }

    /// Whether an answer from this component is one to this request.
    pub(super) fn is_answered_by(&self, from: Address) -> bool {
        !matches!(self.state, State::Free | State::Waiting) && self.sent > 0 && overlap(self.to.address, from)
    }

    /// Whether an answer could be one to either of two commands.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.command().is_some() && self.command() == other.command() && overlap(self.to.address, other.to.address)
    }

    /// Schedules the first attempt.
    pub(super) fn start(&mut self, now: Instant) {
        (self.state, self.tries, self.at) = (State::Due, 1, now + TIMEOUT);
    }

    /// Schedules another attempt, on another link if the recipient is alive there.
    pub(super) fn try_again(&mut self, now: Instant, peers: &Peers, shared: &Shared) {
        let tries = self.tries.saturating_add(1);
        // Heartbeats may be forged on any open link. Where it has answered, an answer is likely to be lost and not the link.
        let stays = tries == 2 && self.state == State::Sent && has_answered(peers, self.to);
        self.start(now);
        self.tries = tries;
        let next = LinkId(self.to.link.0.wrapping_add(u8::from(!stays)));
        self.to = find(peers, shared, Recipient::Peer(Peer { link: next, ..self.to })).unwrap_or(self.to);
        if self.is_cancelled {
            self.aim(peers, shared);
        }
    }

    /// Selects the component that is told to cancel a command: COMMAND_CANCEL is for exactly one (C-23). Of a command to a whole
    /// system that none has answered, the living components take turns.
    pub(super) fn aim(&mut self, peers: &Peers, shared: &Shared) {
        let Address { system, component } = self.to.address;
        self.executor = component;
        if component.wire() != 0 {
            return;
        }
        let is_it = |info: &&PeerInfo| {
            let Peer { address, link } = info.peer;
            info.is_alive && address.system == system && shared.normal.contains(LinkMask::of(link))
        };
        let mut living = peers.iter().filter(is_it).cycle();
        if let Some(info) = living.nth(usize::from(self.tries.saturating_sub(1))) {
            (self.executor, self.to.link) = (info.peer.address.component, info.peer.link);
        }
    }

    /// Ends it. Each transmission of a command may be answered, so a command that was sent twice is remembered for a while.
    pub(super) fn end(&mut self, now: Instant, has_answer: bool) {
        let is_late = self.command().is_some() && self.sent > u8::from(has_answer);
        self.state = if is_late { State::Ended } else { State::Free };
        self.at = now + LATE;
    }

    /// Returns the id of the message of a request for a parameter; COMMAND_LONG for a command.
    pub(super) fn id(&self) -> u32 {
        if let What::Param(query) = &self.what { query.id() } else { CommandLong::ID }
    }

    /// Sends the command, or its cancellation.
    pub(super) fn send_command(&self, command: &OutgoingCommand, confirmation: u8, port: &mut Port) -> bool {
        let OutgoingCommand { id: command, params: [param1, param2, param3, param4], position, z } = *command;
        let (target_system, target_component) = (self.to.address.system.wire(), self.to.address.component.wire());
        match position {
            _ if self.is_cancelled => {
                let target_component = self.executor.wire();
                port.outbox.send(&CommandCancel { command, target_system, target_component })
            }
            CommandPosition::Long { param5, param6 } => port.outbox.send(&CommandLong {
                param1,
                param2,
                param3,
                param4,
                param5,
                param6,
                param7: z,
                command,
                target_system,
                target_component,
                confirmation,
            }),
            CommandPosition::Int { frame, x, y } => port.outbox.send(&CommandInt {
                param1,
                param2,
                param3,
                param4,
                x,
                y,
                z,
                command,
                target_system,
                target_component,
                frame,
                current: 0,
                autocontinue: 0,
            }),
        }
    }
}
