//! Flight modes: the list of modes, the current mode, and requests for another.
//!
//! Implements <https://mavlink.io/en/services/standard_modes.html>, MAV_CMD_DO_SET_MODE and its predecessor SET_MODE:
//! rules C-32, Q-3, Q-10. The modes are a constant of the firmware ([`Modes::MODES`]). Every form of request reaches
//! the vehicle as a row of that table; a request for any other mode is DENIED. Each pending AVAILABLE_MODES is a bit on
//! its link.
//!
//! High-latency links get nothing but answers. Links that send MAVLink 1 get none of these messages, because MAVLink 1
//! has no room for their ids (S-10). The table cannot change, so AVAILABLE_MODES_MONITOR is only sent on request.

use super::{About, Cx, Received, Request, Service, Shared, StackEvent, Turn, Verdict, View, increment};
use crate::dialect::{
    AvailableModes, AvailableModesMonitor, CurrentMode, MavCmd, MavModeFlag, MavModeProperty, MavResult, MavSeverity,
    MavStandardMode, SetMode,
};
use crate::frame::Version;
use crate::link::Port;
use crate::message::{ComponentId, Message, Text};
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{
    Command, CommandPosition, Context, Firmware, LinkClass, ModeFault, ObservedVehicle, Origin, Outcome, Peer, Refusal,
    RefusalReason, Vehicle, VehicleState,
};

/// The maximum number of modes of a vehicle.
pub const MAX_MODES: usize = 32;

/// The maximum length of a name: AVAILABLE_MODES terminates it by a NUL.
const MAX_NAME: usize = 34;

/// The revision of the table, the same in AVAILABLE_MODES and AVAILABLE_MODES_MONITOR. It starts at 0 and counts
/// changes; a constant table has none. Source: mavlink#2557.
const SEQ: u8 = 0;

/// A flight mode: a row of [`Modes::MODES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlightMode {
    /// The value of [`VehicleState::custom_mode`](crate::VehicleState::custom_mode) in this mode. Each mode has a
    /// different one.
    pub custom_mode: u32,
    /// The name that ground stations show: 1 to 34 bytes.
    pub name: &'static str,
    /// The standard mode that it is, if any. No two modes may be the same standard mode.
    pub standard_mode: MavStandardMode,
    /// Properties for the ground station. A request for a mode with
    /// [`NOT_USER_SELECTABLE`](MavModeProperty::NOT_USER_SELECTABLE) is DENIED.
    pub properties: MavModeProperty,
}

impl FlightMode {
    /// Returns a mode that only this vehicle has, and that any peer may request.
    ///
    /// MAV_CMD_DO_SET_MODE cannot request a `custom_mode` of more than 24 significant bits, because its parameters are
    /// `f32`. SET_MODE can.
    pub const fn new(custom_mode: u32, name: &'static str) -> Self {
        let (standard_mode, properties) = (MavStandardMode::NON_STANDARD, MavModeProperty::EMPTY);
        Self { custom_mode, name, standard_mode, properties }
    }

    /// Returns the same mode as a standard mode, which MAV_CMD_DO_SET_STANDARD_MODE requests.
    #[must_use]
    pub const fn with_standard_mode(self, standard_mode: MavStandardMode) -> Self {
        Self { standard_mode, ..self }
    }

    /// Returns the same mode with these properties. `with` combines several.
    #[must_use]
    pub const fn with_properties(self, properties: MavModeProperty) -> Self {
        Self { properties, ..self }
    }

    /// Checks a table: at most [`MAX_MODES`] modes, each number and each standard mode once, names of 1 to 34 bytes.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    #[doc(hidden)]
    pub const fn check(table: &[Self]) {
        assert!(table.len() <= MAX_MODES, "a vehicle has at most 32 modes");
        let mut i = 0;
        while i < table.len() {
            let FlightMode { custom_mode, name, standard_mode, .. } = table[i];
            assert!(!name.is_empty() && name.len() <= MAX_NAME, "a mode's name has 1 to 34 bytes: shorten it");
            let mut j = 0;
            while j < i {
                assert!(custom_mode != table[j].custom_mode, "two modes with the same custom_mode");
                let is_same = standard_mode.0 == table[j].standard_mode.0;
                assert!(
                    !is_same || standard_mode.0 == MavStandardMode::NON_STANDARD.0,
                    "two modes that are the same standard mode"
                );
                j += 1;
            }
            i += 1;
        }
    }
}

/// How parameters 2 and 3 of MAV_CMD_DO_SET_MODE encode a `custom_mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CustomMode {
    /// Parameter 2 is the `custom_mode`, and parameter 3 is ignored: the encoding of ArduPilot.
    Whole,
    /// Parameter 2 is the main mode and parameter 3 the sub-mode, each 0 to 255: `main << 16 | sub << 24`. This is the
    /// encoding of PX4, which MAVSDK uses with every autopilot except ArduPilot. If there is no sub-mode, a parameter 2
    /// above 255 is the whole `custom_mode`, as with [`Whole`](Self::Whole).
    MainSub,
}

/// The sender of a request for a mode, and the circumstances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ModeRequest {
    /// The sender, and the link.
    pub from: Peer,
    /// As [`Command::class`](crate::Command::class).
    pub class: LinkClass,
    /// As [`Command::age`](crate::Command::age).
    pub age: Option<Duration>,
    /// Whether the request is addressed to every system (C-1).
    pub is_broadcast: bool,
}

/// Flight modes, for a vehicle that declares `modes` in [`#[stack]`](macro@crate::Stack). Without it, the two commands about
/// modes reach [`Commands::command`](crate::Commands::command), and SET_MODE reaches [`Vehicle::message`].
///
/// ```
/// use mavstack::dialect::{MavModeProperty, MavResult, MavStandardMode};
/// use mavstack::{Context, CustomMode, FlightMode, ModeRequest, Modes, Outcome, Vehicle, VehicleState};
///
/// const HOLD: u32 = 0x0304_0000;
/// const RETURN: u32 = 0x0504_0000;
/// const AFLOAT: u32 = 0x0009_0000;
///
/// struct Copter { mode: u32, has_fix: bool }
///
/// # impl Vehicle for Copter { fn state(&self) -> Option<VehicleState> { None } }
/// impl Modes for Copter {
///     const MODES: &'static [FlightMode] = &[
///         FlightMode::new(HOLD, "Hold"),
///         FlightMode::new(RETURN, "Return").with_standard_mode(MavStandardMode::SAFE_RECOVERY),
///         // Reported, but no peer can request it.
///         FlightMode::new(AFLOAT, "Afloat").with_properties(MavModeProperty::NOT_USER_SELECTABLE),
///     ];
///     const CUSTOM_MODE: CustomMode = CustomMode::MainSub;
///
///     fn set_mode(&mut self, _: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
///         if mode.custom_mode == RETURN && !self.has_fix {
///             return MavResult::TEMPORARILY_REJECTED.into();
///         }
///         self.mode = mode.custom_mode;
///         MavResult::ACCEPTED.into()
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Modes`",
    note = "`modes` in `#[stack]` needs `impl Modes for {Self}`: write it, or leave `modes` out"
)]
pub trait Modes: Vehicle {
    /// The flight modes, including those that the vehicle only enters by itself. At most
    /// [`MAX_MODES`](crate::limits::MAX_MODES), with names of 1 to 34 bytes, and no `custom_mode` or standard mode twice;
    /// otherwise it does not compile.
    ///
    /// The stack lists them on request (AVAILABLE_MODES). It reports the current mode with every second HEARTBEAT and
    /// at once after a change (CURRENT_MODE, Q-10). It turns MAV_CMD_DO_SET_MODE, the older message SET_MODE, and
    /// MAV_CMD_DO_SET_STANDARD_MODE into [`set_mode`](Self::set_mode).
    ///
    /// [`VehicleState::custom_mode`](crate::VehicleState::custom_mode) is the current mode.
    const MODES: &'static [FlightMode];

    /// How parameters 2 and 3 of MAV_CMD_DO_SET_MODE encode a `custom_mode`.
    const CUSTOM_MODE: CustomMode = CustomMode::Whole;

    /// Enters `mode`, a selectable row of [`MODES`](Self::MODES), or refuses. The outcome is sent at once and is the
    /// only answer, so IN_PROGRESS is answered FAILED. A request for the current mode must do no harm (C-11).
    ///
    /// ACCEPTED means that [`Vehicle::state`] reports the mode within a second (C-18). Refuse a mode that the vehicle
    /// cannot enter now, such as "land" on the ground: after ACCEPTED a ground station waits for the mode. The
    /// stack counts an accepted mode that is not reported
    /// ([`HookFaults::unreported_modes`](crate::command::HookFaults::unreported_modes)), and reports it by a text.
    ///
    /// Base the decision on input that was received: [`Vehicle::control_input`] gets sticks and setpoints before this
    /// is called (C-17).
    ///
    /// The stack has DENIED invalid requests before: a number or a standard mode that is not in the table, NaN, a
    /// fraction, flags without [`CUSTOM_MODE_ENABLED`](MavModeFlag::CUSTOM_MODE_ENABLED). The armed flag is ignored, as
    /// in ArduPilot: clients send back the flags of the last heartbeat, and do not mean to arm or disarm.
    ///
    /// If MAV_CMD_DO_SET_MODE is one of [`POLICIES`](crate::Commands::POLICIES), its policy applies to SET_MODE too
    /// (C-5). MAV_CMD_DO_SET_STANDARD_MODE has its own policy. SET_MODE is answered by a COMMAND_ACK for command 11
    /// (C-32); it is not accepted from a high-latency link.
    fn set_mode(&mut self, cx: &mut Context<'_>, mode: &'static FlightMode, request: &ModeRequest) -> Outcome;

    /// Returns the `custom_mode` that was requested last, by any peer, or the mode that followed it, such as hold after
    /// a take-off. It differs from the current mode only after a failsafe. 0, the default, means unknown. It is sent in
    /// CURRENT_MODE.
    fn intended_mode(&self) -> u32 {
        0
    }
}

/// The command id in the answer to SET_MODE (C-32). No command has this id.
const SET_MODE: MavCmd = MavCmd(11);
const _: () = assert!(SetMode::ID == 11);

/// Converts a SET_MODE to a command. A parameter cannot always hold the mode number, so the request carries it separately.
fn from_set_mode(message: &SetMode, origin: Origin) -> Request {
    let command = Command {
        id: MavCmd::DO_SET_MODE,
        params: [f32::from(message.base_mode.0), num::f32_from_u32(message.custom_mode), 0.0, 0.0],
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        // It has no target component.
        component: ComponentId::ALL,
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    };
    Request { answer_as: SET_MODE, set_mode: Some(message.custom_mode), ..Request::from(command) }
}

/// The state of the service on a link.
#[derive(Clone, Copy, Debug)]
pub struct ModeLink {
    /// A bit for each row of the table whose AVAILABLE_MODES is pending.
    listed: u32,
    /// Whether a requested CURRENT_MODE is pending.
    current: bool,
    /// Whether AVAILABLE_MODES_MONITOR is pending.
    monitor: bool,
    /// The changes of the mode and the pairs of heartbeats for which CURRENT_MODE was sent: values of
    /// [`ModeService::changes`] and [`pairs`].
    changes: u8,
    pairs: u8,
}

/// A message that is pending.
#[derive(Clone, Copy, Debug)]
pub enum ModeReply {
    /// CURRENT_MODE.
    Current,
    /// AVAILABLE_MODES_MONITOR.
    Monitor,
    /// AVAILABLE_MODES: a row of the table.
    Listed,
}

/// Reports the vehicle's mode, and enters another one on request.
#[derive(Debug)]
pub struct ModeService {
    /// The mode that was reported last.
    mode: u32,
    /// How often it has changed. Wraps.
    changes: u8,
    /// The mode that was accepted and is not reported yet.
    accepted: u32,
    /// Until when it must be reported; [`Instant::ZERO`] if there is none.
    report_until: Instant,
}

/// An accepted mode must be reported within this time (C-18).
const REPORTED_WITHIN: Duration = Duration::from_secs(1);

/// Counts pairs of scheduled heartbeats, starting with the first: CURRENT_MODE is sent once for each.
const fn pairs(port: &Port) -> u8 {
    port.facts.periods.wrapping_add(1) >> 1
}

impl ModeService {
    /// Whether CURRENT_MODE is pending on a link (Q-10).
    fn owes_current(&self, shared: &Shared, port: &Port, link: &ModeLink) -> bool {
        let is_pending = link.current || link.changes != self.changes || link.pairs != pairs(port);
        is_pending && shared.observed.has_state && can_send(port)
    }

    /// Records that CURRENT_MODE is no longer pending on a link.
    fn forget_current(&self, port: &Port, link: &mut ModeLink) {
        (link.current, link.changes, link.pairs) = (false, self.changes, pairs(port));
    }

    /// Asks the vehicle to enter a mode. The vehicle must report a mode that it accepts (C-18).
    fn enter<F: Firmware<Vehicle: Modes>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        mode: &'static FlightMode,
        request: &ModeRequest,
    ) -> Verdict {
        let (vehicle, mut context) = cx.hook();
        let outcome = vehicle.set_mode(&mut context, mode, request);
        if outcome.result == MavResult::ACCEPTED {
            // A mode may end before the next poll.
            let is_reported = cx.vehicle.state().is_some_and(|state| state.custom_mode == mode.custom_mode);
            self.accepted = mode.custom_mode;
            self.report_until = if is_reported { Instant::ZERO } else { cx.now + REPORTED_WITHIN };
        }
        outcome.into()
    }
}

/// Returns the command in a SET_MODE.
pub(crate) fn command_in(port: &Port, received: &Received<'_>) -> Option<Request> {
    received.frame.decode::<SetMode>().map(|message| from_set_mode(&message, received.origin(port)))
}

impl<F: Firmware<Vehicle: Modes>> Service<F> for ModeService {
    const NEW: Self = Self { mode: 0, changes: 0, accepted: 0, report_until: Instant::ZERO };
    type Link = ModeLink;
    const VACANT: ModeLink = ModeLink { listed: 0, current: false, monitor: false, changes: 0, pairs: 0 };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::CurrentMode, Turn::ModeList]);
    type Reply = ModeReply;

    /// Sends CURRENT_MODE when the mode differs from the last reported one (Q-10).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ModeLink>) {
        let ObservedVehicle { has_state, state: VehicleState { custom_mode, .. }, .. } = cx.shared.observed;
        if self.report_until != Instant::ZERO {
            let is_reported = has_state && custom_mode == self.accepted;
            if is_reported || cx.now >= self.report_until {
                self.report_until = Instant::ZERO;
            }
            if !is_reported && self.report_until == Instant::ZERO {
                increment(&mut cx.shared.faults.unreported_modes);
                cx.text(MavSeverity::ERROR, b"Accepted mode was not reported");
            }
        }
        if !has_state || custom_mode == self.mode {
            return;
        }
        self.mode = custom_mode;
        self.changes = self.changes.wrapping_add(1);
        event!("mode {=u32}", self.mode);
    }

    fn deadline(&self) -> Instant {
        if self.report_until == Instant::ZERO { Instant::NEVER } else { self.report_until }
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut ModeLink,
        request: &Request,
    ) -> Option<Verdict> {
        handle_command(self, cx, port, link, request)
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &ModeLink, turn: Turn) -> Option<(Instant, ModeReply)> {
        let reply = match turn {
            Turn::ModeList if link.listed != 0 => ModeReply::Listed,
            Turn::CurrentMode if self.owes_current(view.shared, port, link) => ModeReply::Current,
            Turn::CurrentMode if link.monitor => ModeReply::Monitor,
            _ => return None,
        };
        Some((view.now, reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut ModeLink, reply: ModeReply) -> bool {
        match reply {
            ModeReply::Current => {
                self.forget_current(port, link);
                send_current(cx.vehicle, port)
            }
            ModeReply::Monitor => {
                link.monitor = false;
                port.outbox.send(&AvailableModesMonitor { seq: SEQ })
            }
            ModeReply::Listed => send_listed(port, link, F::Vehicle::MODES),
        }
    }

    fn on_event(&mut self, event: StackEvent<'_, ModeLink>) {
        // A link that sends MAVLink 1 leaves CURRENT_MODE out, instead of deferring it until it sends MAVLink 2.
        if let StackEvent::Sent(port, link) = event
            && !can_send(port)
        {
            self.forget_current(port, link);
        }
    }
}

/// Handles a command about modes; `None` for all others.
fn handle_command<F: Firmware<Vehicle: Modes>>(
    service: &mut ModeService,
    cx: &mut Cx<'_, F>,
    port: &Port,
    link: &mut ModeLink,
    Request { command, set_mode, .. }: &Request,
) -> Option<Verdict> {
    let refused = |mode: Option<u32>, fault| {
        let number = mode.and_then(|mode| i32::try_from(mode).ok()).unwrap_or(-1);
        Verdict::Refused(Refusal::denied(RefusalReason::Mode(number, fault)))
    };
    let modes = F::Vehicle::MODES;
    let [first, ..] = command.params;
    let (asked, mode) = match command.id {
        MavCmd::DO_SET_MODE => {
            let custom_mode = (*set_mode).or_else(|| custom_mode(F::Vehicle::CUSTOM_MODE, command.params));
            // The other flags name no mode of the vehicle.
            let is_custom =
                num::integer(first).is_some_and(|flags| MavModeFlag(flags).contains(MavModeFlag::CUSTOM_MODE_ENABLED));
            if !is_custom {
                return Some(refused(custom_mode, ModeFault::NotCustom));
            }
            (custom_mode, custom_mode.and_then(|mode| find(modes, mode)))
        }
        MavCmd::DO_SET_STANDARD_MODE => (None, num::integer(first).and_then(|mode| find_standard(modes, mode))),
        MavCmd::REQUEST_MESSAGE => {
            let result = on_request(modes.len(), port, link, command, || cx.vehicle.state().is_some());
            return result.map(Verdict::done);
        }
        _ => return None,
    };
    Some(match mode {
        Some(mode) if mode.properties.contains(MavModeProperty::NOT_USER_SELECTABLE) => {
            refused(asked, ModeFault::NotSelectable)
        }
        Some(mode) => {
            let Command { from, class, age, is_broadcast, .. } = *command;
            service.enter(cx, mode, &ModeRequest { from, class, age, is_broadcast })
        }
        // MAVLink's guide answers an unknown standard mode with FAILED. DENIED is clearer: asking again never helps
        // (C-4).
        None => refused(asked, ModeFault::Unknown),
    })
}

/// Returns the `custom_mode` in parameters 2 and 3 of a MAV_CMD_DO_SET_MODE (C-8, C-9).
fn custom_mode(way: CustomMode, [_, mode, sub, _]: [f32; 4]) -> Option<u32> {
    let mode = num::unsigned(mode)?;
    let sub = if sub.is_nan() { 0 } else { num::integer::<u8>(sub)? };
    match (way, u8::try_from(mode)) {
        (CustomMode::MainSub, Ok(main)) => Some(u32::from_le_bytes([0, 0, main, sub])),
        _ => (sub == 0).then_some(mode),
    }
}

fn find(table: &'static [FlightMode], custom_mode: u32) -> Option<&'static FlightMode> {
    table.iter().find(|mode| mode.custom_mode == custom_mode)
}

fn find_standard(table: &'static [FlightMode], standard_mode: u8) -> Option<&'static FlightMode> {
    let is_it = |mode: &&FlightMode| mode.standard_mode.0 == standard_mode;
    table.iter().find(is_it).filter(|mode| mode.standard_mode != MavStandardMode::NON_STANDARD)
}

/// Handles a request for a message about modes; `None` for other messages. `count`: the number of modes.
fn on_request(
    count: usize,
    port: &Port,
    link: &mut ModeLink,
    command: &Command,
    knows_mode: impl FnOnce() -> bool,
) -> Option<MavResult> {
    let [id, index, ..] = command.params;
    let id = num::integer(id).filter(|id| matches!(*id, AvailableModes::ID..=AvailableModesMonitor::ID))?;
    if !can_send(port) || !command.has_response_target() {
        return Some(MavResult::DENIED);
    }
    match id {
        AvailableModes::ID => {
            let index = if index.is_nan() { Some(0) } else { num::integer::<u8>(index) };
            let Some(modes) = index.and_then(|index| bits(count, index)) else { return Some(MavResult::DENIED) };
            link.listed |= modes;
        }
        CurrentMode::ID if knows_mode() => link.current = true,
        CurrentMode::ID => return Some(MavResult::DENIED),
        _ => link.monitor = true,
    }
    Some(MavResult::ACCEPTED)
}

const _: () = assert!(CurrentMode::ID == AvailableModes::ID + 1 && AvailableModesMonitor::ID == CurrentMode::ID + 1);

/// Returns the rows that `index` of AVAILABLE_MODES selects, a bit for each: 0 selects all, others count from 1 (Q-3).
fn bits(count: usize, index: u8) -> Option<u32> {
    let count = u32::try_from(count).ok()?;
    let index = u32::from(index);
    if index == 0 {
        return u32::MAX.checked_shr(u32::BITS.wrapping_sub(count));
    }
    1u32.checked_shl(index.wrapping_sub(1)).filter(|_| index <= count)
}

/// Whether the messages about modes can be sent on a link: MAVLink 1 has no room for their ids (S-10).
fn can_send(port: &Port) -> bool {
    !port.config.class.is_high_latency() && port.outbox.version() == Version::V2
}

/// Sends CURRENT_MODE. Returns false if the vehicle is in a fault.
fn send_current<V: Modes>(vehicle: &V, port: &mut Port) -> bool {
    vehicle.state().is_some_and(|VehicleState { custom_mode, .. }| {
        port.outbox.send(&CurrentMode {
            custom_mode,
            intended_custom_mode: vehicle.intended_mode(),
            standard_mode: find(V::MODES, custom_mode).map_or(MavStandardMode::NON_STANDARD, |mode| mode.standard_mode),
        })
    })
}

/// Sends the next pending row of `table`.
fn send_listed(port: &mut Port, link: &mut ModeLink, table: &[FlightMode]) -> bool {
    // In the table's order: QGroundControl takes the last row for the end of the list.
    let index = usize::try_from(link.listed.trailing_zeros()).unwrap_or(MAX_MODES);
    link.listed &= link.listed.wrapping_sub(1);
    table.get(index).is_some_and(|mode| {
        port.outbox.send(&AvailableModes {
            custom_mode: mode.custom_mode,
            properties: mode.properties,
            number_modes: u8::try_from(table.len()).unwrap_or(0),
            mode_index: u8::try_from(index).unwrap_or(0).saturating_add(1),
            standard_mode: mode.standard_mode,
            mode_name: Text::new(mode.name),
            seq: SEQ,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLD: FlightMode = FlightMode::new(1, "Hold");
    const LAND: FlightMode = FlightMode::new(2, "Land").with_standard_mode(MavStandardMode::LAND);

    #[test]
    fn valid_tables_are_accepted() {
        FlightMode::check(&[]);
        FlightMode::check(&[HOLD, LAND, FlightMode::new(0, "a mode whose name is 34 bytes long")]);
        let mut most = [HOLD; MAX_MODES];
        (0..).zip(&mut most).for_each(|(number, mode)| mode.custom_mode = number);
        FlightMode::check(&most);
    }

    #[test]
    #[should_panic(expected = "at most 32 modes")]
    fn too_many_modes_are_refused() {
        FlightMode::check(&[HOLD; MAX_MODES + 1]);
    }

    #[test]
    #[should_panic(expected = "same custom_mode")]
    fn a_number_twice_is_refused() {
        FlightMode::check(&[HOLD, LAND, FlightMode { name: "Wait", ..HOLD }]);
    }

    #[test]
    #[should_panic(expected = "same standard mode")]
    fn a_standard_mode_twice_is_refused() {
        FlightMode::check(&[LAND, HOLD, FlightMode { custom_mode: 3, ..LAND }]);
    }

    #[test]
    #[should_panic(expected = "1 to 34 bytes")]
    fn an_empty_name_is_refused() {
        FlightMode::check(&[HOLD, FlightMode { name: "", ..LAND }]);
    }

    #[test]
    #[should_panic(expected = "1 to 34 bytes")]
    fn a_name_without_room_for_the_nul_is_refused() {
        FlightMode::check(&[FlightMode { name: "a mode whose name is 35 bytes long.", ..HOLD }]);
    }
}
