//! Admits commands, dispatches them, and answers them.

use super::acks::CommandLink;
use super::duplicates::ExecutionLimit;
use super::long::{CommandMemory, LongCommands, NO_PROGRESS};
use super::policy::CommandPolicy;
use super::refusal;
use super::vehicle::Commands;
use crate::dialect::{
    CommandCancel, CommandInt, CommandLong, MavCmd, MavFrame, MavProtocolCapability, MavResult, MavSeverity,
};
use crate::link::Port;
use crate::log::RefusalLog;
use crate::message::{Address, ComponentId, Message};
use crate::service::{About, Cx, Handled, Part, Received, Request, Service, Turn, Verdict, View, increment};
use crate::time::Instant;
use crate::types::{Command, CommandPosition, Context, Firmware, LinkId, Outcome, Peer, Refusal, Vehicle};

/// Commands whose broadcasts are always refused, because they reset, erase or replace stored data of a vehicle, restart
/// the vehicle (C-14), or cost money on each of them (L-17). Commands that only move, arm or terminate a vehicle are not
/// in the list: they can be meant for a fleet, and [`CommandPolicy::no_broadcast`] refuses them. Those without a name
/// are from dialects that include common.
const NO_BROADCAST: [MavCmd; 15] = [
    // Parameters are reset, overwritten from storage, or stored. The vehicle restarts, possibly into the bootloader.
    MavCmd::PREFLIGHT_STORAGE,
    MavCmd::PREFLIGHT_REBOOT_SHUTDOWN,
    // Stored calibrations and the ids of motors on a CAN bus are replaced. The last one is DO_START_MAG_CAL.
    MavCmd::PREFLIGHT_CALIBRATION,
    MavCmd::PREFLIGHT_SET_SENSOR_OFFSETS,
    MavCmd::PREFLIGHT_UAVCAN,
    MavCmd::FIXED_MAG_CAL_YAW,
    MavCmd(42_424),
    // The firmware is replaced: DO_UPGRADE, FLASH_BOOTLOADER.
    MavCmd(247),
    MavCmd(42_650),
    // A memory card is erased; a camera's settings are reset.
    MavCmd::STORAGE_FORMAT,
    MavCmd::RESET_CAMERA_SETTINGS,
    // A receiver loses its transmitter.
    MavCmd::START_RX_PAIR,
    // Every vehicle gets the same system id (DO_SET_SYS_CMP_ID); an empty battery counts as full (BATTERY_RESET).
    MavCmd(610),
    MavCmd(42_651),
    // Each vehicle sends by satellite.
    MavCmd::CONTROL_HIGH_LATENCY,
];

/// A COMMAND_ACK that is pending.
#[derive(Clone, Copy, Debug)]
pub enum AckReply {
    /// The answer to a received command.
    Answer,
    /// The final result of a long-running command.
    Final,
    /// The progress of a running command.
    Progress,
}

/// The service of the command protocol. `S` has the slots for long-running commands.
#[derive(Debug)]
pub struct CommandService<S> {
    pub(crate) slots: S,
    refusals: RefusalLog,
}

/// Returns the command in a COMMAND_LONG or COMMAND_INT.
pub(crate) fn command_in(port: &Port, received: &Received<'_>) -> Option<Request> {
    // COMMAND_INT has the same layout: parameters 5 and 6 are integers, and the frame is in place of `confirmation`.
    let is_int = received.frame.id() == CommandInt::ID;
    if !is_int && received.frame.id() != CommandLong::ID {
        return None;
    }
    let message = CommandLong::decode(received.frame.payload());
    let CommandLong { param5, param6, confirmation, .. } = message;
    let integer = |param: f32| param.to_bits().cast_signed();
    let position = match is_int {
        true => CommandPosition::Int { frame: MavFrame(confirmation), x: integer(param5), y: integer(param6) },
        false => CommandPosition::Long { param5, param6 },
    };
    Some(Request::from(Command {
        id: message.command,
        params: [message.param1, message.param2, message.param3, message.param4],
        position,
        z: message.param7,
        from: received.from,
        trust: received.trust,
        class: port.config.class,
        age: received.age,
        component: ComponentId::new(message.target_component),
        is_broadcast: message.target_system == 0,
        confirmation: if is_int { 0 } else { confirmation },
    }))
}

impl<F: Firmware<Vehicle: Commands>, S: CommandMemory> Service<F> for CommandService<S> {
    const NEW: Self = Self { slots: S::NEW, refusals: RefusalLog::NEW };
    type Link = CommandLink;
    const VACANT: CommandLink = CommandLink::VACANT;
    type Reply = AckReply;
    const ABOUT: About = About {
        turns: &[Turn::CommandAck, Turn::CommandProgress],
        capabilities: MavProtocolCapability::COMMAND_INT,
        part: Part::Every,
        ..About::AUTOPILOT
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut CommandLink>) {
        if let Some(long) = self.slots.view_mut() {
            long.poll(cx.now);
        }
    }

    fn deadline(&self) -> Instant {
        let Some(long) = self.slots.view() else { return Instant::NEVER };
        if !F::COMPONENTS.is_empty() && long.has_own_end() {
            return Instant::ZERO;
        }
        long.deadline()
    }

    /// COMMAND_CANCEL (C-23): without an answer of its own.
    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut CommandLink, received: &Received<'_>) -> Handled {
        let Some(long) = self.slots.view_mut() else { return Handled::No };
        let Some(message) = received.frame.decode::<CommandCancel>() else { return Handled::No };
        let own = cx.shared.config.address.get();
        let Address { system, component } = received.target;
        if system != own.system || !(component == own.component || F::is_component(component)) {
            return Handled::OutOfPlace;
        }
        cancel(cx, long, message.command, component, received.from);
        Handled::Yes
    }

    /// A final result precedes the answers, because the answer to the request that ended a command has the same id
    /// (C-23); but not the command's own IN_PROGRESS.
    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &CommandLink, turn: Turn) -> Option<(Instant, AckReply)> {
        let long = self.slots.view();
        let ack = match turn {
            Turn::CommandProgress => long.filter(|long| long.has_progress(port.id)).map(|_| AckReply::Progress),
            _ if long.is_some_and(|long| long.has_final(port.id)) && !link.has_progress() => Some(AckReply::Final),
            // The answer about a reset of all parameters comes after the last of them.
            _ if size_of::<F::Parameters>() > 0
                && view.shared.pending_resets > 0
                && link.is_next(MavCmd::PREFLIGHT_STORAGE) =>
            {
                None
            }
            _ => (!link.has_answered()).then_some(AckReply::Answer),
        };
        Some((view.now, ack?))
    }

    fn send(&mut self, _: &mut Cx<'_, F>, port: &mut Port, link: &mut CommandLink, ack: AckReply) -> bool {
        let (long, tx) = (self.slots.view_mut(), &mut port.outbox);
        match (ack, long) {
            (AckReply::Answer, long) => {
                link.send::<F>(tx, |command| long.map_or(NO_PROGRESS, |long| long.progress_of(command)))
            }
            (AckReply::Final, Some(long)) => long.send_final::<F>(tx),
            (AckReply::Progress, Some(long)) => long.send_progress::<F>(tx),
            (AckReply::Final | AckReply::Progress, None) => false,
        }
    }
}

/// The steps of a received command before and after a service executes it.
impl<S: CommandMemory> CommandService<S> {
    /// Returns whether a link has a slot for another answer. Without one, a further command is dropped.
    pub(crate) fn has_room(link: &CommandLink) -> bool {
        link.has_room()
    }

    /// Returns whether every command that was received on a link was answered.
    pub(crate) fn has_answered(link: &CommandLink) -> bool {
        link.has_answered()
    }

    /// Returns the answer to a command that must not be executed: its declaration refuses it, it is running, or it is a
    /// duplicate (C-5, C-12, C-14, C-21, C-24). For a vehicle that declares nothing, this compiles to almost nothing.
    pub(crate) fn admit<F: Firmware<Vehicle: Commands + Vehicle>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        request: &Request,
    ) -> Option<Verdict> {
        let Request { command, answer_as, signed_at, .. } = request;
        if command.is_broadcast && NO_BROADCAST.contains(answer_as) {
            return Some(Verdict::Refused(Refusal::BROADCAST));
        }
        let (vehicle, mut context) = cx.hook();
        if let Err(refusal) = check(vehicle, &mut context, command) {
            return Some(Verdict::Refused(refusal));
        }
        let long = self.slots.view_mut()?;
        if ends_calibration(command) && long.is_running(command.id) {
            cancel(cx, long, command.id, command.component, command.from);
            if !long.is_running(command.id) {
                return Some(Verdict::done(MavResult::ACCEPTED));
            }
        }
        let outcome = if is_own::<F>(command) {
            long.recall_own(cx.now, command)?
        } else {
            long.recall(cx.now, command, *signed_at, execution_limit::<F::Vehicle>(command.id))?
        };
        // The refusal of a duplicate was already explained.
        let is_busy = outcome.result == MavResult::TEMPORARILY_REJECTED && !long.knows(command);
        Some(if is_busy { Verdict::Refused(outcome.result.into()) } else { Verdict::Done(outcome) })
    }

    /// Answers a received command: queues the answer of the component to which it is addressed, or of the one that has executed a
    /// command to all.
    pub(crate) fn answer<F: Firmware<Vehicle: Commands>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &Port,
        link: &mut CommandLink,
        request: &Request,
        verdict: Option<Verdict>,
        is_admitted: bool,
    ) {
        if let Some(Verdict::Refused(refusal)) = verdict {
            refusal::explain(cx, port, link, request, refusal);
        }
        let outcome = self.conclude(cx, request, verdict, is_admitted);
        let from = request.command.from.address;
        self.log(cx.now, request.answer_as, from, outcome.result);
        let mut by = request.command.component;
        if !F::COMPONENTS.is_empty() {
            let answerer = core::mem::replace(&mut cx.shared.answerer, ComponentId::ALL);
            by = if by.is_all() { answerer } else { by };
        }
        link.push(by, from, request.answer_as, outcome);
    }

    /// Returns the outcome of a command, and records it. A command that no service has handled is passed to the vehicle. IN_PROGRESS
    /// is a promise, which only a slot keeps, and only the hooks for commands get one: otherwise it becomes FAILED, and a text says
    /// so (C-20).
    pub(crate) fn conclude<F: Firmware<Vehicle: Commands>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        request: &Request,
        verdict: Option<Verdict>,
        is_admitted: bool,
    ) -> Outcome {
        let Request { command, signed_at, .. } = request;
        let may_start = verdict.is_none() && self.slots.view().is_some_and(|long| long.can_start(command.from));
        let mut outcome = match verdict {
            None => execute(cx, command, may_start),
            Some(Verdict::Done(outcome)) => outcome,
            Some(Verdict::Refused(refusal)) => refusal.result.into(),
        };
        if !is_admitted {
            return outcome;
        }
        cx.shared.has_acted = true;
        if outcome.result == MavResult::IN_PROGRESS && !may_start {
            outcome.result = MavResult::FAILED;
            increment(&mut cx.shared.faults.unfinished);
            cx.text(MavSeverity::ERROR, b"IN_PROGRESS without a slot");
        }
        if let Some(long) = self.slots.view_mut() {
            let limit = match is_own::<F>(command) {
                true => ExecutionLimit::None,
                false => execution_limit::<F::Vehicle>(command.id),
            };
            long.record(cx.now, command, *signed_at, outcome, limit);
        }
        outcome
    }

    /// Cancels a command that the firmware itself has sent to one of its components.
    pub(crate) fn cancel_own<F: Firmware<Vehicle: Commands>>(&mut self, cx: &mut Cx<'_, F>, command: &Command) {
        if let Some(long) = self.slots.view_mut() {
            cancel(cx, long, command.id, command.component, command.from);
        }
    }

    /// Logs the answer to a command; of refusals, at most one a second.
    fn log(&mut self, now: Instant, command: MavCmd, from: Address, result: MavResult) {
        if matches!(result, MavResult::ACCEPTED | MavResult::IN_PROGRESS) {
            event!("command {=u16} from {}: {=u8}", command.0, from, result.0);
        } else if let Some(refused) = self.refusals.count(now) {
            event!("command {=u16} from {}: {=u8}; {=u32} refused so far", command.0, from, result.0, refused);
        }
    }
}

/// Passes a command that no service handles to the vehicle: to the hook of the component to which it is addressed. `can_start`:
/// there is a slot for a long-running command.
fn execute<F: Firmware<Vehicle: Commands>>(cx: &mut Cx<'_, F>, command: &Command, can_start: bool) -> Outcome {
    let (vehicle, mut context) = cx.hook();
    context.can_start = can_start;
    if !F::is_component(command.component) {
        return vehicle.command(&mut context, command);
    }
    let outcome = F::component_command(vehicle, &mut context, command);
    // Every component knows these commands, for its HEARTBEAT at least.
    let is_about_message =
        matches!(command.id, MavCmd::REQUEST_MESSAGE | MavCmd::SET_MESSAGE_INTERVAL | MavCmd::GET_MESSAGE_INTERVAL);
    if is_about_message && outcome.result == MavResult::UNSUPPORTED {
        // The command is known: the component does not have this message.
        return MavResult::DENIED.into();
    }
    outcome
}

/// Whether the command is PX4's form of COMMAND_CANCEL for a calibration: all parameters are 0.
fn ends_calibration(command: &Command) -> bool {
    let (p5, p6) = command.position.params();
    let rest = [p5, p6, command.z];
    command.id == MavCmd::PREFLIGHT_CALIBRATION
        // NaN is "not given" (C-8).
        && !command.params.iter().chain(&rest).any(|param| param.abs() > 0.0)
}

/// Whether the firmware itself has given the command to one of its components. Nothing is lost on that way, so nothing is repeated.
fn is_own<F: Firmware>(command: &Command) -> bool {
    !F::COMPONENTS.is_empty() && command.from.link == LinkId::NONE
}

/// Asks the vehicle to cancel a command if a component is running it (C-23), and if `from` has given it or is in control. While
/// nobody is, everyone may cancel.
fn cancel<F: Firmware<Vehicle: Commands>>(
    cx: &mut Cx<'_, F>,
    long: &mut LongCommands,
    command: MavCmd,
    of: ComponentId,
    from: Peer,
) {
    let is_its =
        |component| F::COMPONENTS.is_empty() || component == of || !(F::is_component(component) || F::is_component(of));
    let is_free = cx.shared.controllers.owner().is_none_or(|owner| owner == from.address.system);
    let only = if is_free || (!F::COMPONENTS.is_empty() && from.link == LinkId::NONE) { None } else { Some(from) };
    if long.is_running_in(command, only, is_its) {
        let (vehicle, mut context) = cx.hook();
        if vehicle.cancel_command(&mut context, command, from) {
            long.finish(command, MavResult::CANCELLED);
        }
    }
    cx.shared.has_acted = true;
}

/// Returns how often `command` may be executed, as the vehicle declares it.
fn execution_limit<V: Commands>(command: MavCmd) -> ExecutionLimit {
    CommandPolicy::find(V::POLICIES, command).map_or(ExecutionLimit::None, CommandPolicy::execution_limit)
}

/// Checks a command against the vehicle's declaration, if there is one (C-5).
fn check<V: Commands + Vehicle>(vehicle: &V, cx: &mut Context<'_>, command: &Command) -> Result<(), Refusal> {
    match CommandPolicy::find(V::POLICIES, command.id) {
        None => Ok(()),
        Some(policy) => policy.check(command, V::HAS_TERRAIN_MODEL, || vehicle.is_in_control(cx, command)),
    }
}

/// Whether the vehicle's declaration permits `command` (C-5). For messages that are equivalent to a command (M-46).
pub(crate) fn is_allowed<V: Commands + Vehicle>(vehicle: &V, cx: &mut Context<'_>, command: &Command) -> bool {
    check(vehicle, cx, command).is_ok()
}
