//! Operator control: of several ground stations, one is in control of the vehicle, and another one takes over with its
//! consent.
//!
//! Implements MAV_CMD_REQUEST_OPERATOR_CONTROL and CONTROL_STATUS of MAVLink's `development.xml`, rule O-5, as the
//! manager of the whole system. They may still change there. The system in control sends commands (C-5), sticks (J-2)
//! and setpoints (J-6).
//!
//! Left out: control of single components, and changes of plans and parameters by messages. A vehicle that refuses
//! those too copies [`owner`](OperatorControl::owner) in its flight loop, and compares it with the sender in
//! [`Plans::may_change`](crate::Plans::may_change) and [`Parameters::may_set`](crate::Parameters::may_set).
//!
//! [`OperatorControl`] shows how control is requested, taken over and released.

use super::{
    About, ControlGate, Cx, Handled, Received, Request, Service, ShowCounters, Turn, Verdict, View, increment,
};
use crate::dialect::{
    CommandAck, CommandCancel, CommandLong, LogErase, ManualControl, MavCmd, MavProtocolCapability, MavResult,
    MissionSetCurrent, RadioRcChannels, RcChannelsOverride, SetActuatorControlTarget, SetAttitudeTarget,
    SetGpsGlobalOrigin, SetHomePosition, SetMode, SetPositionTargetGlobalInt, SetPositionTargetLocalNed,
};
use crate::link::Port;
use crate::message::{Address, Message, SystemId};
use crate::network::{PeerInfo, Peers};
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{Command, Controllers, Firmware, LinkId, LinkMask, Peer, Refusal, RefusalReason, Trust};
use core::num::{Saturating, Wrapping};

/// MAV_CMD_REQUEST_OPERATOR_CONTROL: action, takeover, timeout, system.
const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);

/// The action that requests control; 0 releases it.
const REQUEST: u8 = 1;

/// The number of systems besides the owner that may send commands.
const SECONDARIES: usize = 10;

/// The period of CONTROL_STATUS without a change.
const PERIOD: Duration = Duration::from_secs(1);

/// The maximum number of times that the owner is notified of a request.
const NOTICES: u8 = 3;

/// The time between two notices, also if a request is repeated (X-5).
const NOTICE_PERIOD: Duration = Duration::from_secs(3);

/// GCS_CONTROL_STATUS_FLAGS: about the whole system.
const SYSTEM_MANAGER: u8 = 1;
/// A request is granted.
const TAKEOVER_ALLOWED: u8 = 2;

crate::message! {
    /// `CONTROL_STATUS`.
    struct ControlStatus: CONTROL_STATUS = 512, crc_extra = 21 {
        flags: u8,
        gcs_main: u8,
        gcs_secondary: [u8; 10],
    }
}

counters! {
    /// Counters of operator control. They wrap.
    OperatorCounters {
        /// Requests for control that were granted.
        count granted,
        /// Requests for control that were refused: the owner allows no takeover.
        count refused,
        /// Commands that were answered NOT_IN_CONTROL.
        drop commands,
        /// Sticks, setpoints, and messages that are equivalent to a command, that were dropped because their sender was
        /// not in control.
        drop messages,
    }
}

/// Operator control: declared by `operator_control` in [`#[stack]`](macro@crate::Stack), and read through
/// [`Stack::operator_control`](crate::Stack::operator_control).
///
/// ```text
///                 request, and takeover is allowed: the new owner says whether it allows another one
///                 ┌───────────────────────────────────────────────┐
///        request  │                                               ▼
///   nobody ──────▶ owned by a ground station ─── request ──▶ is takeover allowed?
///      ▲           │                     ▲                        │ no
///      └───────────┘                     └────────────────────────┘
///        release, or its heartbeats        the request FAILED; the owner gets it, and may
///        have stopped                      release control or allow a takeover
/// ```
///
/// While nobody is in control, every system controls the vehicle. Otherwise these do:
///
/// | sender | commands | sticks, setpoints |
/// |---|---|---|
/// | the owner, and components of the vehicle's own system | yes | yes |
/// | the pilot's [receivers](crate::manual_control::ManualInput::set_receivers) for radio control | as their system | sticks |
/// | [secondary](Self::set_secondaries) systems | yes | no |
/// | others | NOT_IN_CONTROL | dropped and counted |
///
/// A refused command calls no hook of the vehicle. Everyone may request control, messages, their intervals, and the
/// vehicle's capabilities. COMMAND_CANCEL, LOG_ERASE, MISSION_SET_CURRENT, SET_MODE, SET_HOME_POSITION and
/// SET_GPS_GLOBAL_ORIGIN are treated like commands, but only SET_MODE has an answer that could say so, if the vehicle
/// has modes. SET_ACTUATOR_CONTROL_TARGET is treated like a setpoint. FTP requests that change files, such as uploads of
/// plans and parameters as files, are refused by FileProtected. All other messages reach
/// [`Vehicle::message`](crate::Vehicle::message).
///
/// The owner is notified of a request by the same command, up to three times, until it has answered. CONTROL_STATUS is
/// sent on every normal link that carries MAVLink 2: at once after a change, and every second.
///
/// ```
/// # use mavstack::prelude::*;
/// # use mavstack::{dialect, message};
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
/// #[derive(mavstack::Stack)]
/// #[stack(vehicle: Rover, links: 2, manual_control, operator_control)]
/// struct Mavlink;
///
/// /// Called once, before the loop. System 253 plans missions for the pilots: it never steers.
/// fn configure(stack: &mut StackOf<Mavlink>) {
///     let control = stack.operator_control_mut();
///     control.set_secondaries(&[message::SystemId::new(253)]);
///     // When the owner is lost a failsafe decides, not the next station.
///     control.set_release_on_loss(false);
/// }
///
/// fn pilot(stack: &StackOf<Mavlink>, now: Instant) -> Option<message::SystemId> {
///     stack.operator(now)
/// }
/// ```
#[derive(Clone, Debug)]
pub struct OperatorControl {
    owner: Option<SystemId>,
    /// What has proved the frame that took control: less does not count as the owner's (X-1).
    trust: Trust,
    allows_takeover: bool,
    /// Control is not released when the owner is lost.
    keeps_lost: bool,
    /// The owner is another one since [`take_new_owner`](ControlGate::take_new_owner).
    is_new: bool,
    /// The number of changes, to report each of them once on each link.
    changes: Wrapping<u8>,
    /// As CONTROL_STATUS has them: 0 is none.
    secondaries: [u8; SECONDARIES],
    notice: Notice,
    counters: OperatorCounters,
}

/// The notification of the owner about a refused request.
#[derive(Clone, Copy, Debug)]
struct Notice {
    /// How often it will be sent.
    left: Saturating<u8>,
    /// The owner's ground station, and the link on which it is alive.
    to: Peer,
    /// The system that the owner was last notified of: the next one has the next higher id, so that all have their turn.
    notified: SystemId,
    /// The system that requests control, whether it would allow a takeover, and how long it waits (s).
    requester: SystemId,
    allow: u8,
    timeout: u8,
    /// When it is due.
    at: Instant,
}

impl Notice {
    /// All zero bits.
    const NONE: Self = Self {
        left: Saturating(0),
        to: Peer { address: Address::new(0, 0), link: LinkId(0) },
        notified: SystemId::ALL,
        requester: SystemId::ALL,
        allow: 0,
        timeout: 0,
        at: Instant::ZERO,
    };

    /// How many systems come before this one.
    fn turn(&self, system: SystemId) -> u8 {
        system.wire().wrapping_sub(self.notified.wire()).wrapping_sub(1)
    }
}

/// The state of the service on a link.
#[derive(Clone, Copy, Debug)]
pub struct OperatorLink {
    /// When CONTROL_STATUS is due without a change.
    status_at: Instant,
    /// The changes that were reported.
    changes: Wrapping<u8>,
}

/// A message of operator control.
#[derive(Clone, Copy, Debug)]
pub enum OperatorReply {
    /// The notification of the owner about a request.
    Notice,
    /// CONTROL_STATUS.
    Status,
}

impl OperatorControl {
    /// Returns the system in control, whose stations are among these peers: see
    /// [`Stack::operator`](crate::Stack::operator).
    pub(crate) fn operator(&self, mut peers: impl Iterator<Item = PeerInfo>) -> Option<SystemId> {
        let owner = self.owner?;
        let is_kept = self.keeps_lost || peers.any(|info| is_station(&info, owner, self.trust));
        is_kept.then_some(owner)
    }

    /// Returns whether a request for control is granted, as of the last poll.
    pub(crate) const fn allows_takeover(&self) -> bool {
        self.allows_takeover || self.owner.is_none()
    }

    /// Sets the systems that may send commands besides the owner, at most ten; more are ignored.
    pub fn set_secondaries(&mut self, systems: &[SystemId]) {
        self.secondaries = [0; SECONDARIES];
        for (secondary, system) in self.secondaries.iter_mut().zip(systems) {
            *secondary = system.wire();
        }
        self.changes += 1;
    }

    /// Sets whether control is released when no ground station of the owner is
    /// [alive](crate::network::PeerInfo::is_living_station) on any link; by default it is. Otherwise only the owner
    /// releases it, and the firmware by [`release`](Self::release). While control is released on loss, only a ground
    /// station that is alive can request it.
    pub fn set_release_on_loss(&mut self, releases: bool) {
        self.keeps_lost = !releases;
    }

    /// Releases control: then no system is in control.
    pub fn release(&mut self) {
        self.set_owner(None, Trust::None, false);
    }

    /// Returns the counters.
    pub const fn counters(&self) -> OperatorCounters {
        self.counters
    }

    fn set_owner(&mut self, owner: Option<SystemId>, trust: Trust, allows_takeover: bool) {
        self.notice.left.0 = 0;
        self.trust = trust;
        if (self.owner, self.allows_takeover) != (owner, allows_takeover) {
            self.is_new = self.owner != owner;
            self.owner = owner;
            self.allows_takeover = allows_takeover;
            event!("operator control: system {=u8}", self.main());
            self.changes += 1;
        }
    }

    /// Returns the owner as CONTROL_STATUS has it: 0 is none.
    const fn main(&self) -> u8 {
        match self.owner {
            Some(owner) => owner.wire(),
            None => 0,
        }
    }

    /// Whether a frame is the owner's.
    fn is_owner(&self, system: SystemId, trust: Trust) -> bool {
        self.owner == Some(system) && trust >= self.trust
    }

    /// Whether the sender of a frame may steer.
    fn may_steer(&self, is_ours: bool, system: SystemId, trust: Trust) -> bool {
        is_ours || self.owner.is_none() || self.is_owner(system, trust)
    }

    /// Whether the sender of a frame may send commands.
    fn may_command(&self, is_ours: bool, system: SystemId, trust: Trust) -> bool {
        self.may_steer(is_ours, system, trust) || self.secondaries.iter().any(|secondary| *secondary == system.wire())
    }

    /// Handles MAV_CMD_REQUEST_OPERATOR_CONTROL.
    fn request<F: Firmware>(&mut self, cx: &Cx<'_, F>, command: &Command) -> Verdict {
        let [action, allow, timeout, system] = command.params;
        let from = command.from.address.system;
        let allow = if allow.is_nan() { Some(0) } else { num::integer::<u8>(allow).filter(|&allow| allow <= 1) };
        // It must not be requested for another system. Clients give no system by 0 or NaN.
        let is_for_sender = system.is_nan() || num::integer(system).is_some_and(|id: u8| id == 0 || id == from.wire());
        let is_ours = from == cx.address().system;
        let (Some(action @ 0..=REQUEST), Some(allow), true, false, false) =
            (num::integer::<u8>(action), allow, is_for_sender, is_ours, command.is_broadcast)
        else {
            let reason = if command.is_broadcast { RefusalReason::Broadcast } else { RefusalReason::Result };
            return Verdict::Refused(Refusal::denied(reason));
        };
        let is_accepted = if action == REQUEST {
            self.request_for(cx, command, allow, num::integer(timeout).unwrap_or(0))
        } else {
            if self.is_owner(from, command.trust) {
                self.release();
            }
            self.owner.is_none()
        };
        if is_accepted {
            return Verdict::done(MavResult::ACCEPTED);
        }
        match self.owner {
            Some(_) => Verdict::Refused(Refusal { result: MavResult::FAILED, reason: RefusalReason::Taken }),
            None => Verdict::done(MavResult::FAILED),
        }
    }

    /// Gives control to the sender's system, or notifies the owner of the request. Returns whether the system is in control.
    fn request_for<F: Firmware>(&mut self, cx: &Cx<'_, F>, command: &Command, allow: u8, timeout: u8) -> bool {
        let (system, trust) = (command.from.address.system, command.trust);
        let is_possible = self.keeps_lost || station(cx.peers, system, Trust::None, LinkMask::ALL).is_some();
        if is_possible && (self.allows_takeover() || self.is_owner(system, trust)) {
            // A frame may have 0 as its source.
            self.set_owner(Some(system).filter(|system| !system.is_all()), trust, allow != 0);
            increment(&mut self.counters.granted);
            return true;
        }
        increment(&mut self.counters.refused);
        let Notice { left, notified, requester, at, .. } = self.notice;
        let is_next = left.0 == 0 || self.notice.turn(system) <= self.notice.turn(requester);
        if is_possible
            && is_next
            && let Some(owner) = self.owner
            && let Some(to) = station(cx.peers, owner, self.trust, cx.shared.normal)
        {
            let (left, timeout) = (Saturating(NOTICES), timeout.clamp(3, 60));
            // The time stays that after the last notice, so that requests in a row cause no more notices.
            let at = cx.now.max(at);
            self.notice = Notice { left, to, notified, requester: system, allow, timeout, at };
        }
        false
    }
}

/// Whether a peer is a ground station of a system that is alive, and proves itself so well (X-1).
fn is_station(info: &PeerInfo, system: SystemId, trust: Trust) -> bool {
    info.is_living_station() && info.peer.address.system == system && info.trust >= trust
}

/// Returns such a station on one of the links.
fn station(peers: &Peers, system: SystemId, trust: Trust, links: LinkMask) -> Option<Peer> {
    let is_it = |info: &&PeerInfo| is_station(info, system, trust) && links.contains(info.peer.link);
    peers.iter().find(is_it).map(|info| info.peer)
}

/// Whether everyone may send this command: it requests control, or information.
const fn is_for_all(command: MavCmd) -> bool {
    matches!(
        command,
        REQUEST_OPERATOR_CONTROL
            | MavCmd::REQUEST_MESSAGE
            | MavCmd::GET_MESSAGE_INTERVAL
            | MavCmd::SET_MESSAGE_INTERVAL
            | MavCmd::REQUEST_PROTOCOL_VERSION
            | MavCmd::REQUEST_AUTOPILOT_CAPABILITIES
    )
}

impl ControlGate for OperatorControl {
    const IS_SOME: bool = true;

    fn drops(&mut self, is_ours: bool, is_receiver: bool, received: &Received<'_>) -> bool {
        let (system, trust) = (received.from.address.system, received.trust);
        let may = match received.frame.id() {
            // A receiver's rank is above operator control (J-11).
            ManualControl::ID | RcChannelsOverride::ID | RadioRcChannels::ID => {
                is_receiver || self.may_steer(is_ours, system, trust)
            }
            SetPositionTargetLocalNed::ID
            | SetPositionTargetGlobalInt::ID
            | SetAttitudeTarget::ID
            | SetActuatorControlTarget::ID => self.may_steer(is_ours, system, trust),
            // Only systems that may command erase logs (LOG-7).
            CommandCancel::ID
            | LogErase::ID
            | MissionSetCurrent::ID
            | SetMode::ID
            | SetHomePosition::ID
            | SetGpsGlobalOrigin::ID => self.may_command(is_ours, system, trust),
            _ => true,
        };
        if !may {
            increment(&mut self.counters.messages);
        }
        !may
    }

    fn refuses(&mut self, is_ours: bool, command: &Command) -> bool {
        let may = is_for_all(command.id) || self.may_command(is_ours, command.from.address.system, command.trust);
        if !may {
            increment(&mut self.counters.commands);
        }
        !may
    }

    fn controllers(&self) -> Controllers {
        Controllers::new(self.owner, self.trust, self.secondaries)
    }

    fn take_new_owner(&mut self) -> Option<SystemId> {
        let is_new = core::mem::take(&mut self.is_new);
        self.owner.filter(|_| is_new)
    }
}

impl<F: Firmware> Service<F> for OperatorControl {
    const NEW: Self = Self {
        owner: None,
        trust: Trust::None,
        allows_takeover: false,
        keeps_lost: false,
        is_new: false,
        changes: Wrapping(0),
        secondaries: [0; SECONDARIES],
        notice: Notice::NONE,
        counters: OperatorCounters::ZERO,
    };
    type Link = OperatorLink;
    const VACANT: OperatorLink = OperatorLink { status_at: Instant::ZERO, changes: Wrapping(0) };
    type Reply = OperatorReply;
    const ABOUT: About = About {
        turns: &[Turn::OperatorControl],
        capabilities: MavProtocolCapability::COMPONENT_ACCEPTS_GCS_CONTROL,
        ..About::AUTOPILOT
    };

    /// Releases control when the owner is lost.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut OperatorLink>) {
        if let Some(owner) = self.owner
            && !self.keeps_lost
            && station(cx.peers, owner, self.trust, LinkMask::ALL).is_none()
        {
            self.release();
        }
    }

    /// The owner's answer to a notice.
    fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, _: &mut OperatorLink, received: &Received<'_>) -> Handled {
        let Some(ack) = received.frame.decode::<CommandAck>() else { return Handled::No };
        if ack.command != REQUEST_OPERATOR_CONTROL {
            return Handled::No;
        }
        if self.is_owner(received.from.address.system, received.trust) {
            self.notice.left.0 = 0;
        }
        Handled::Yes
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        _: &mut Port,
        _: &mut OperatorLink,
        request: &Request,
    ) -> Option<Verdict> {
        (request.command.id == REQUEST_OPERATOR_CONTROL).then(|| self.request(cx, &request.command))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &OperatorLink, _: Turn) -> Option<(Instant, OperatorReply)> {
        let status_at = match port.outbox.takes(ControlStatus::ID) {
            false => Instant::NEVER,
            true if link.changes != self.changes => view.now,
            true => link.status_at,
        };
        let Notice { left, to, at: notice_at, .. } = self.notice;
        if left.0 > 0 && to.link == port.id && (notice_at <= view.now || notice_at < status_at) {
            return Some((notice_at, OperatorReply::Notice));
        }
        Some((status_at, OperatorReply::Status))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut OperatorLink, reply: OperatorReply) -> bool {
        match reply {
            OperatorReply::Notice => {
                let notice = &mut self.notice;
                let confirmation = Saturating(NOTICES) - notice.left;
                notice.left -= 1;
                notice.notified = notice.requester;
                notice.at = cx.now + NOTICE_PERIOD;
                port.outbox.send(&CommandLong {
                    param1: f32::from(REQUEST),
                    param2: f32::from(notice.allow),
                    param3: f32::from(notice.timeout),
                    param4: f32::from(notice.requester.wire()),
                    command: REQUEST_OPERATOR_CONTROL,
                    target_system: notice.to.address.system.wire(),
                    target_component: notice.to.address.component.wire(),
                    confirmation: confirmation.0,
                    ..CommandLong::default()
                })
            }
            OperatorReply::Status => {
                link.status_at = cx.now + PERIOD;
                link.changes = self.changes;
                let flags = if self.allows_takeover() { SYSTEM_MANAGER | TAKEOVER_ALLOWED } else { SYSTEM_MANAGER };
                port.outbox.send(&ControlStatus { flags, gcs_main: self.main(), gcs_secondary: self.secondaries })
            }
        }
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }
}
