//! Flight modes: the list of modes, the current mode, and requests for another.
//!
//! Implements <https://mavlink.io/en/services/standard_modes.html>, MAV_CMD_DO_SET_MODE and its predecessor SET_MODE:
//! rules C-32, Q-3, Q-10. The modes are a constant of the firmware ([`Modes::MODES`]). Every form of request reaches
//! the vehicle as a row of that table; a request for any other mode is DENIED. Each pending AVAILABLE_MODES is a bit on
//! its link.
//!
//! High-latency links get nothing but answers. Links that send MAVLink 1 get none of these messages, because MAVLink 1
//! has no room for their ids (S-10). The table cannot change, so AVAILABLE_MODES_MONITOR is only sent on request.

mod vehicle;

use core::num::Wrapping;

pub use vehicle::{CustomMode, FlightMode, MAX_MODES, ModeRequest, Modes};

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
    Command, CommandPosition, Firmware, ModeFault, ObservedVehicle, Origin, Refusal, RefusalReason, Vehicle,
    VehicleState,
};

/// The revision of the table, the same in AVAILABLE_MODES and AVAILABLE_MODES_MONITOR. It starts at 0 and counts
/// changes; a constant table has none. Source: mavlink#2557.
const SEQ: u8 = 0;

/// The command id in the answer to SET_MODE (C-32). No command has this id.
const SET_MODE: MavCmd = MavCmd(11);
const _: () = assert!(SetMode::ID == 11);

/// Converts a SET_MODE to a command. A parameter cannot always hold the mode number, so the request carries it
/// separately.
fn from_set_mode(message: &SetMode, origin: Origin) -> Request {
    let command = Command {
        id: MavCmd::DO_SET_MODE,
        params: [f32::from(message.base_mode.0), num::f32_from_u32(message.custom_mode), 0.0, 0.0],
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: origin.from,
        trust: origin.trust,
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
    pending_rows: u32,
    /// Whether a requested CURRENT_MODE is pending.
    is_current_requested: bool,
    /// Whether a requested AVAILABLE_MODES_MONITOR is pending.
    is_monitor_requested: bool,
    /// [`ModeService::changes`] and [`heartbeat_pairs`] when CURRENT_MODE was last sent.
    sent_changes: Wrapping<u8>,
    sent_pairs: u8,
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
    /// How often it has changed.
    changes: Wrapping<u8>,
    /// The mode that was accepted and is not reported yet.
    accepted: u32,
    /// Until when it must be reported; [`Instant::ZERO`] if there is none.
    report_until: Instant,
}

/// An accepted mode must be reported within this time (C-18).
const REPORTED_WITHIN: Duration = Duration::from_secs(1);

/// Returns the number of pairs of scheduled heartbeats, starting with the first: CURRENT_MODE is sent once for each.
const fn heartbeat_pairs(port: &Port) -> u8 {
    port.facts.periods.wrapping_add(1) >> 1
}

impl ModeService {
    /// Whether CURRENT_MODE is pending on a link: after a change, with every second heartbeat, and on request.
    fn is_current_pending(&self, shared: &Shared, port: &Port, link: &ModeLink) -> bool {
        let has_changed = link.sent_changes != self.changes || link.sent_pairs != heartbeat_pairs(port);
        (link.is_current_requested || has_changed) && shared.observed.has_state && can_send(port)
    }

    /// Records that CURRENT_MODE is no longer pending on a link.
    fn forget_current(&self, port: &Port, link: &mut ModeLink) {
        link.is_current_requested = false;
        link.sent_changes = self.changes;
        link.sent_pairs = heartbeat_pairs(port);
    }

    /// Asks the vehicle to enter the mode that a command requests. `number`: the `custom_mode` in the command, if
    /// any. `mode`: its
    /// row of the table, if any. The vehicle must report a mode that it accepts (C-18).
    fn enter<F: Firmware<Vehicle: Modes>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        command: &Command,
        number: Option<u32>,
        mode: Option<&'static FlightMode>,
    ) -> Verdict {
        // MAVLink's guide answers an unknown standard mode with FAILED. DENIED is clearer: asking again never helps
        // (C-4).
        let Some(mode) = mode else { return refused(number, ModeFault::Unknown) };
        if mode.properties.contains(MavModeProperty::NOT_USER_SELECTABLE) {
            return refused(number, ModeFault::NotSelectable);
        }
        let Command { from, class, age, is_broadcast, .. } = *command;
        let (vehicle, mut context) = cx.hook();
        let outcome = vehicle.set_mode(&mut context, mode, &ModeRequest { from, class, age, is_broadcast });
        if outcome.result == MavResult::ACCEPTED {
            // A mode may end before the next poll.
            let is_reported = cx.vehicle.state().is_some_and(|state| state.custom_mode == mode.custom_mode);
            self.accepted = mode.custom_mode;
            self.report_until = if is_reported { Instant::ZERO } else { cx.now + REPORTED_WITHIN };
        }
        outcome.into()
    }
}

fn refused(number: Option<u32>, fault: ModeFault) -> Verdict {
    let number = number.and_then(|number| i32::try_from(number).ok()).unwrap_or(-1);
    Verdict::Refused(Refusal::denied(RefusalReason::Mode(number, fault)))
}

/// Returns the command in a SET_MODE.
pub(crate) fn command_in(port: &Port, received: &Received<'_>) -> Option<Request> {
    received.frame.decode::<SetMode>().map(|message| from_set_mode(&message, received.origin(port)))
}

impl<F: Firmware<Vehicle: Modes>> Service<F> for ModeService {
    const NEW: Self = Self { mode: 0, changes: Wrapping(0), accepted: 0, report_until: Instant::ZERO };
    type Link = ModeLink;
    const VACANT: ModeLink = ModeLink {
        pending_rows: 0,
        is_current_requested: false,
        is_monitor_requested: false,
        sent_changes: Wrapping(0),
        sent_pairs: 0,
    };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::CurrentMode, Turn::ModeList]);
    type Reply = ModeReply;

    /// Notices a change of the mode, and reports an accepted mode that the vehicle does not report (C-18).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ModeLink>) {
        let ObservedVehicle { has_state, state: VehicleState { custom_mode, .. }, .. } = cx.shared.observed;
        if self.report_until != Instant::ZERO {
            if has_state && custom_mode == self.accepted {
                self.report_until = Instant::ZERO;
            } else if cx.now >= self.report_until {
                self.report_until = Instant::ZERO;
                increment(&mut cx.shared.faults.unreported_modes);
                cx.text(MavSeverity::ERROR, b"Accepted mode was not reported");
            }
        }
        if has_state && custom_mode != self.mode {
            self.mode = custom_mode;
            self.changes += 1;
            event!("mode {=u32}", self.mode);
        }
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
        let command = &request.command;
        let modes = F::Vehicle::MODES;
        let [first, ..] = command.params;
        match command.id {
            MavCmd::DO_SET_MODE => {
                let number = request.set_mode.or_else(|| custom_mode(F::Vehicle::CUSTOM_MODE, command.params));
                // The other flags name no mode of the vehicle.
                let is_custom = num::integer(first)
                    .is_some_and(|flags| MavModeFlag(flags).contains(MavModeFlag::CUSTOM_MODE_ENABLED));
                if !is_custom {
                    return Some(refused(number, ModeFault::NotCustom));
                }
                let mode = number.and_then(|number| find(modes, number));
                Some(self.enter(cx, command, number, mode))
            }
            MavCmd::DO_SET_STANDARD_MODE => {
                let mode = num::integer(first).and_then(|standard_mode| find_standard(modes, standard_mode));
                Some(self.enter(cx, command, None, mode))
            }
            MavCmd::REQUEST_MESSAGE => {
                let result = request_message(modes.len(), port, link, command, || cx.vehicle.state().is_some());
                result.map(Verdict::done)
            }
            _ => None,
        }
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &ModeLink, turn: Turn) -> Option<(Instant, ModeReply)> {
        let reply = match turn {
            Turn::ModeList if link.pending_rows != 0 => ModeReply::Listed,
            Turn::CurrentMode if self.is_current_pending(view.shared, port, link) => ModeReply::Current,
            Turn::CurrentMode if link.is_monitor_requested => ModeReply::Monitor,
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
                link.is_monitor_requested = false;
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

/// Returns the `custom_mode` in parameters 2 and 3 of a MAV_CMD_DO_SET_MODE (C-8, C-9).
fn custom_mode(encoding: CustomMode, [_, mode, sub, _]: [f32; 4]) -> Option<u32> {
    let mode = num::unsigned(mode)?;
    let sub = if sub.is_nan() { 0 } else { num::integer::<u8>(sub)? };
    match (encoding, u8::try_from(mode)) {
        (CustomMode::MainSub, Ok(main)) => Some(u32::from_le_bytes([0, 0, main, sub])),
        _ => (sub == 0).then_some(mode),
    }
}

fn find(table: &'static [FlightMode], custom_mode: u32) -> Option<&'static FlightMode> {
    table.iter().find(|mode| mode.custom_mode == custom_mode)
}

fn find_standard(table: &'static [FlightMode], standard_mode: u8) -> Option<&'static FlightMode> {
    let mode = table.iter().find(|mode| mode.standard_mode.0 == standard_mode);
    mode.filter(|mode| mode.standard_mode != MavStandardMode::NON_STANDARD)
}

/// Handles a request for a message about modes; `None` for other messages. `count`: the number of modes.
fn request_message(
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
            let Some(rows) = index.and_then(|index| selected_rows(count, index)) else {
                return Some(MavResult::DENIED);
            };
            link.pending_rows |= rows;
        }
        CurrentMode::ID if knows_mode() => link.is_current_requested = true,
        CurrentMode::ID => return Some(MavResult::DENIED),
        _ => link.is_monitor_requested = true,
    }
    Some(MavResult::ACCEPTED)
}

const _: () = assert!(CurrentMode::ID == AvailableModes::ID + 1 && AvailableModesMonitor::ID == CurrentMode::ID + 1);

/// Returns the rows that `index` of AVAILABLE_MODES selects, a bit for each: 0 selects all, others count from 1.
fn selected_rows(count: usize, index: u8) -> Option<u32> {
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
    let index = usize::try_from(link.pending_rows.trailing_zeros()).unwrap_or(MAX_MODES);
    // Clears the lowest bit.
    link.pending_rows &= link.pending_rows.wrapping_sub(1);
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
