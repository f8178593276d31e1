//! A request of the vehicle, from its first transmission to its last answer: its recipient, its link and its deadlines.

use core::num::{Saturating, Wrapping};

use super::vehicle::{CommandClient, OutgoingCommand};
use crate::dialect::{CommandCancel, CommandInt, CommandLong, MavCmd, ParamExtRequestRead, ParamRequestRead};
use crate::link::{Outbox, Port};
use crate::message::{Address, ComponentId, Message, Text};
use crate::network::{PeerInfo, Peers};
use crate::service::Shared;
use crate::time::{Duration, Instant};
use crate::types::{Command, CommandPosition, Component, LinkClass, LinkId, LinkMask, Peer, Recipient, Trust};

/// How long to wait for an answer before the request is sent again.
const TIMEOUT: Duration = Duration::from_millis(700);

/// How long to wait after IN_PROGRESS, which its sender repeats about every second (C-20); and, if another request waits for the slot, how
/// long for a change of the progress.
const PROGRESS_TIMEOUT: Duration = Duration::from_secs(30);

/// How long more answers may be received to a command that was sent more than once.
const LATE: Duration = Duration::from_secs(2);

/// The state of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SlotState {
    Free,
    /// It waits for the end of an equal command.
    Waiting,
    /// A transmission is pending. If the link has not taken it by the deadline, another link is tried.
    Due,
    /// An answer is expected until the deadline.
    Sent,
    /// IN_PROGRESS was received. Another answer is expected until the deadline.
    Running,
    /// It has ended, and more answers to it may be received until the deadline.
    Ended,
}

/// A request of the vehicle to another component.
#[derive(Clone, Copy, Debug)]
pub(super) enum ClientRequest {
    Command(OutgoingCommand),
    Param { name: Text<16>, is_ext: bool },
}

/// A request that has no final answer yet.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    pub(super) state: SlotState,
    /// The number of attempts to send the command; of COMMAND_CANCEL once `is_cancelled`.
    pub(super) attempts: Saturating<u8>,
    /// The number of transmissions.
    pub(super) transmissions: Saturating<u8>,
    pub(super) is_cancelled: bool,
    /// IN_PROGRESS was received.
    pub(super) is_running: bool,
    /// The last progress.
    progress: u8,
    /// The recipient, and the link on which it is sent. Component 0 is any component of the system.
    pub(super) to: Peer,
    /// The links on which it was sent: there an answer counts.
    asked: LinkMask,
    /// The component that is asked to cancel it; 0 for none.
    executor: ComponentId,
    pub(super) token: u16,
    pub(super) request: ClientRequest,
    pub(super) deadline: Instant,
    /// When the progress last changed.
    pub(super) changed_at: Instant,
}

impl Slot {
    /// All zero bits.
    pub(super) const FREE: Self = Self {
        state: SlotState::Free,
        attempts: Saturating(0),
        transmissions: Saturating(0),
        is_cancelled: false,
        is_running: false,
        progress: 0,
        to: Peer { address: Address::new(0, 0), link: LinkId(0) },
        asked: LinkMask::NONE,
        executor: ComponentId::ALL,
        token: 0,
        request: ClientRequest::Command(OutgoingCommand::NONE),
        deadline: Instant::ZERO,
        changed_at: Instant::ZERO,
    };

    /// Returns a request that waits.
    pub(super) const fn waiting(to: Peer, token: u16, request: ClientRequest) -> Self {
        Self { state: SlotState::Waiting, to, token, request, ..Self::FREE }
    }

    /// Returns the number of its command, if it is one.
    pub(super) const fn command(&self) -> Option<MavCmd> {
        if let ClientRequest::Command(command) = &self.request { Some(command.id) } else { None }
    }

    /// Whether it was taken up, and has not been answered for good.
    pub(super) const fn is_started(&self) -> bool {
        !matches!(self.state, SlotState::Free | SlotState::Waiting)
    }

    /// Whether an answer from this component is one to this request: it was sent on the answer's link.
    pub(super) fn is_answered_by(&self, from: Peer) -> bool {
        let was_asked = match from.link {
            LinkId::NONE => self.to.link == LinkId::NONE,
            link => self.asked.contains(link),
        };
        self.is_started() && self.transmissions.0 > 0 && was_asked && overlap(self.to.address, from.address)
    }

    /// Whether an answer could be one to either of two commands.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.command().is_some() && self.command() == other.command() && overlap(self.to.address, other.to.address)
    }

    /// Whether a transmission is pending on a link that can carry it: MAVLink 1 has no extended parameters (S-10).
    pub(super) fn is_due_on(&self, port: &Port) -> bool {
        let has_target = !self.is_cancelled || !self.executor.is_all();
        let can_carry = match self.request {
            ClientRequest::Command(_) => true,
            ClientRequest::Param { is_ext: false, .. } => port.outbox.takes(ParamRequestRead::ID),
            ClientRequest::Param { is_ext: true, .. } => port.outbox.takes(ParamExtRequestRead::ID),
        };
        self.state == SlotState::Due && self.to.link == port.id && has_target && can_carry
    }

    /// Schedules the first attempt.
    pub(super) fn start(&mut self, now: Instant) {
        (self.state, self.attempts, self.deadline) = (SlotState::Due, Saturating(1), now + TIMEOUT);
    }

    /// Schedules another attempt, on another link if the recipient is alive there.
    pub(super) fn try_again(&mut self, now: Instant, peers: &Peers, shared: &Shared) {
        let attempts = self.attempts + Saturating(1);
        let mut wanted = self.to;
        // Heartbeats may be forged on any open link. Where it has answered, an answer is likely to be lost and not the link.
        let stays = attempts.0 == 2 && self.state == SlotState::Sent && has_answered(peers, self.to);
        if !stays {
            wanted.link = LinkId((Wrapping(wanted.link.0) + Wrapping(1)).0);
        }
        self.start(now);
        self.attempts = attempts;
        self.to = find(peers, shared, Recipient::Peer(wanted)).unwrap_or(self.to);
        if self.is_cancelled {
            self.select_executor(peers, shared);
        }
    }

    /// Cancels a command that was sent: schedules COMMAND_CANCEL.
    pub(super) fn cancel(&mut self, now: Instant, peers: &Peers, shared: &Shared) {
        self.is_cancelled = true;
        self.start(now);
        self.select_executor(peers, shared);
    }

    /// Selects the component that is asked to cancel a command: COMMAND_CANCEL is for exactly one (C-23). Of a command to a whole
    /// system that none has answered, the living components take turns.
    fn select_executor(&mut self, peers: &Peers, shared: &Shared) {
        let Address { system, component } = self.to.address;
        self.executor = component;
        if !component.is_all() {
            return;
        }
        let is_living = |info: &&PeerInfo| {
            let Peer { address, link } = info.peer;
            info.is_alive && address.system == system && shared.normal.contains(link) && shared.believes(peers, info)
        };
        let turns = peers.iter().filter(is_living).cycle().take(usize::from(self.attempts.0));
        if let Some(info) = turns.last() {
            (self.executor, self.to.link) = (info.peer.address.component, info.peer.link);
        }
    }

    /// Records IN_PROGRESS. A running command is cancelled all the same, and that is requested again once it is known which
    /// component runs it.
    pub(super) fn on_progress(&mut self, now: Instant, from: Address, progress: u8) {
        let was_for_all = self.to.address.component.is_all();
        if !self.is_running || self.progress != progress {
            (self.progress, self.changed_at) = (progress, now);
        }
        (self.is_running, self.to.address) = (true, from);
        if !self.is_cancelled {
            self.expect_progress(now);
        } else if was_for_all {
            self.start(now);
            self.executor = from.component;
        }
    }

    /// Waits for the end of a running command.
    pub(super) fn expect_progress(&mut self, now: Instant) {
        (self.state, self.deadline) = (SlotState::Running, now + PROGRESS_TIMEOUT);
    }

    /// Ends it when its progress has not changed for long, because another request waits for the slot.
    pub(super) fn give_way(&mut self) {
        self.deadline = self.deadline.min(self.changed_at + PROGRESS_TIMEOUT);
    }

    /// Ends it. Each transmission of a command may be answered, so a command that was sent more often than it was answered is
    /// remembered for a while.
    pub(super) fn end(&mut self, now: Instant, has_answer: bool) {
        let may_be_answered = self.command().is_some() && self.transmissions.0 > u8::from(has_answer);
        self.state = if may_be_answered { SlotState::Ended } else { SlotState::Free };
        self.deadline = now + LATE;
    }

    /// Records a transmission, and returns how many there were before.
    fn count_transmission(&mut self, now: Instant) -> u8 {
        let Saturating(before) = self.transmissions;
        self.transmissions += 1;
        self.asked = self.asked.with(LinkMask::of(self.to.link));
        (self.state, self.deadline) = (SlotState::Sent, now + TIMEOUT);
        before
    }

    /// Hands over a command to another component of this firmware, from the component `own`.
    pub(super) fn take_own(&mut self, now: Instant, own: Address) -> Option<Command> {
        let ClientRequest::Command(OutgoingCommand { id, params, position, z }) = self.request else { return None };
        self.count_transmission(now);
        Some(Command {
            id,
            params,
            position,
            z,
            from: Peer { address: own, link: LinkId::NONE },
            trust: Trust::Signed,
            class: LinkClass::Normal,
            age: None,
            component: self.to.address.component,
            is_broadcast: false,
            confirmation: 0,
        })
    }

    /// Sends the request, or the cancellation of a command.
    pub(super) fn send<V: CommandClient>(&mut self, now: Instant, tx: &mut Outbox) -> bool {
        let confirmation = self.count_transmission(now);
        let (target_system, target_component) = (self.to.address.system.wire(), self.to.address.component.wire());
        let OutgoingCommand { id: command, params: [param1, param2, param3, param4], position, z } = match self.request
        {
            ClientRequest::Command(command) => command,
            // By its name (K-6). A vehicle that reads no parameters has none of these messages in flash.
            ClientRequest::Param { .. } if !V::READS_PARAMS => return false,
            ClientRequest::Param { name: param_id, is_ext } => {
                let param_index = -1;
                return match is_ext {
                    true => tx.send(&ParamExtRequestRead { param_index, target_system, target_component, param_id }),
                    false => tx.send(&ParamRequestRead { param_index, target_system, target_component, param_id }),
                };
            }
        };
        match position {
            _ if self.is_cancelled => {
                let target_component = self.executor.wire();
                tx.send(&CommandCancel { command, target_system, target_component })
            }
            CommandPosition::Long { param5, param6 } => tx.send(&CommandLong {
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
            CommandPosition::Int { frame, x, y } => tx.send(&CommandInt {
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

/// Returns the recipient, and a normal link on which it is alive and believed: the wanted one, or the one with the next number. If none is
/// wanted, the link of its last answer, or else the one on which it was heard first.
pub(super) fn find(peers: &Peers, shared: &Shared, to: Recipient) -> Option<Peer> {
    let (wanted, r#type, first_link) = match to {
        Recipient::Type(r#type) => {
            let system = shared.config.address.get().system;
            (Address { system, component: ComponentId::ALL }, Some(r#type), None)
        }
        Recipient::Address(address) => (address, None, None),
        Recipient::Peer(Peer { address, link }) => (address, None, Some(link)),
    };
    let is_it = |info: &&PeerInfo| {
        let is_wanted = overlap(wanted, info.peer.address) && r#type.is_none_or(|r#type| r#type == info.r#type);
        is_wanted && info.is_alive && shared.normal.contains(info.peer.link) && shared.believes(peers, info)
    };
    let distance = |info: &&PeerInfo| match first_link {
        Some(first) => (Wrapping(info.peer.link.0) - Wrapping(first.0)).0,
        None => u8::from(!info.has_answered),
    };
    let mut found = peers.iter().filter(is_it).min_by_key(distance)?.peer;
    if r#type.is_none() {
        // Component 0 stays every component of the system.
        found.address.component = wanted.component;
    }
    Some(found)
}

/// Returns the recipient if it is another component of this firmware.
pub(super) fn find_own(components: &[Component], shared: &Shared, to: Recipient) -> Option<Peer> {
    let system = shared.config.address.get().system;
    let is_it = |component: &&Component| match to {
        Recipient::Type(r#type) => component.r#type == r#type,
        Recipient::Address(address) => address == Address { system, component: component.id },
        Recipient::Peer(_) => false,
    };
    let component = components.iter().find(is_it)?.id;
    Some(Peer { address: Address { system, component }, link: LinkId::NONE })
}

/// Whether the last answer of a living component was received on this link. Component 0 is any of the system.
fn has_answered(peers: &Peers, to: Peer) -> bool {
    let is_it = |info: &PeerInfo| info.peer.link == to.link && overlap(info.peer.address, to.address);
    peers.iter().any(|info| info.is_alive && info.has_answered && is_it(info))
}

/// Records that a component has answered on this link, and on no other one since.
pub(super) fn note_answer(peers: &mut Peers, from: Peer) {
    for info in peers.iter_mut().filter(|info| info.peer.address == from.address) {
        info.has_answered = info.peer.link == from.link;
    }
}

/// Whether two addresses of components overlap: component 0 is every component of a system.
fn overlap(a: Address, b: Address) -> bool {
    a.system == b.system && (a.component == b.component || a.component.is_all() || b.component.is_all())
}
