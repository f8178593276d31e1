//! The command protocol: each COMMAND_LONG and COMMAND_INT is answered by exactly one COMMAND_ACK.
//!
//! Implements <https://mavlink.io/en/services/command.html>, rules C-1 to C-24. A command is accepted only while its link has a
//! free slot for the answer. Otherwise it is dropped and counted, and not carried out: to its sender it looks like a lost frame,
//! which the sender repeats.
//!
//! [`Commands`] has a diagram of a command's path.

mod acks;
mod duplicates;
mod long;
mod policy;
mod refusal;
mod vehicle;

pub(crate) use acks::Acks;
pub(crate) use duplicates::{Duplicates, LATE, Once, SOON, is_well_after};
pub use long::{CommandSlots, LongCommands};
pub use policy::CommandPolicy;
pub use vehicle::Commands;

use super::{About, Cx, Handled, Part, Received, Request, Service, Turn, Verdict, View, increment};
use crate::dialect::{
    CommandCancel, CommandInt, CommandLong, MavCmd, MavFrame, MavProtocolCapability, MavResult, MavSeverity,
};
use crate::link::Port;
use crate::log::RefusalLog;
use crate::message::{Address, ComponentId};
use crate::time::Instant;
use crate::types::{Command, CommandPosition, Context, Firmware, LinkId, Origin, Outcome, Peer, Refusal, Vehicle};

/// Returns the command of a COMMAND_LONG.
pub(crate) fn from_long(message: &CommandLong, origin: Origin) -> Command {
    Command {
        id: message.command,
        params: [message.param1, message.param2, message.param3, message.param4],
        position: CommandPosition::Long { param5: message.param5, param6: message.param6 },
        z: message.param7,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        component: ComponentId::new(message.target_component),
        is_broadcast: message.target_system == 0,
        confirmation: message.confirmation,
    }
}

/// Returns the command of a COMMAND_INT.
pub(crate) fn from_int(message: &CommandInt, origin: Origin) -> Command {
    Command {
        id: message.command,
        params: [message.param1, message.param2, message.param3, message.param4],
        position: CommandPosition::Int { frame: MavFrame(message.frame.0), x: message.x, y: message.y },
        z: message.z,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        component: ComponentId::new(message.target_component),
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    }
}

/// Whether a broadcast of this command is always refused, because it resets, erases or replaces what a vehicle stores, or
/// restarts the vehicle (C-14). Commands that only move, arm or terminate a vehicle are not in the list: they can be meant for a
/// fleet, and [`CommandPolicy::no_broadcast`] refuses them.
const fn is_for_one(command: MavCmd) -> bool {
    // From dialects that include common.
    const DO_UPGRADE: MavCmd = MavCmd(247);
    const DO_SET_SYS_CMP_ID: MavCmd = MavCmd(610);
    const DO_START_MAG_CAL: MavCmd = MavCmd(42_424);
    const FLASH_BOOTLOADER: MavCmd = MavCmd(42_650);
    const BATTERY_RESET: MavCmd = MavCmd(42_651);
    matches!(
        command,
        // Parameters are reset, overwritten from storage, or stored. The vehicle restarts, possibly into the
        // bootloader.
        MavCmd::PREFLIGHT_STORAGE | MavCmd::PREFLIGHT_REBOOT_SHUTDOWN
        // Stored calibrations and the ids of motors on a CAN bus are replaced.
        | MavCmd::PREFLIGHT_CALIBRATION | MavCmd::PREFLIGHT_SET_SENSOR_OFFSETS | MavCmd::PREFLIGHT_UAVCAN
        | MavCmd::FIXED_MAG_CAL_YAW | DO_START_MAG_CAL
        // The firmware is replaced.
        | DO_UPGRADE | FLASH_BOOTLOADER
        // A memory card is erased; a camera's settings are reset.
        | MavCmd::STORAGE_FORMAT | MavCmd::RESET_CAMERA_SETTINGS
        // A receiver loses its transmitter; every vehicle gets the same system id; an empty battery counts as full.
        | MavCmd::START_RX_PAIR | DO_SET_SYS_CMP_ID | BATTERY_RESET
    )
}

/// The state of the command protocol on a link.
#[derive(Debug)]
pub struct CommandLink {
    acks: Acks,
    /// The period in which a text last explained a refusal; see [`refusal`].
    refusal: u16,
}

/// A COMMAND_ACK that is pending.
#[derive(Clone, Copy, Debug)]
pub enum Ack {
    /// The answer to a received command.
    Answer,
    /// The final result of a long-running command.
    Final,
    /// The progress of a running command.
    Progress,
}

/// Slots for the long-running commands of a vehicle, or none.
pub trait CommandMemory: core::fmt::Debug {
    /// All zero bits.
    const NEW: Self;

    /// Returns the slots, if there are any.
    fn view_mut(&mut self) -> Option<&mut LongCommands>;

    /// The same, for reading.
    fn view(&self) -> Option<&LongCommands>;
}

/// The slots of a firmware whose [`#[stack]`](macro@crate::Stack) has no `commands`: none.
#[derive(Clone, Copy, Debug)]
pub struct NoSlots;

impl CommandMemory for NoSlots {
    const NEW: Self = Self;

    fn view_mut(&mut self) -> Option<&mut LongCommands> {
        None
    }

    fn view(&self) -> Option<&LongCommands> {
        None
    }
}

impl<const N: usize> CommandMemory for CommandSlots<N> {
    const NEW: Self = Self::new();

    fn view_mut(&mut self) -> Option<&mut LongCommands> {
        Some(self)
    }

    fn view(&self) -> Option<&LongCommands> {
        Some(self)
    }
}

/// Admits commands, dispatches them, and answers them. `S` has the slots for long-running commands.
#[derive(Debug)]
pub struct CommandService<S> {
    pub(crate) slots: S,
    refusals: RefusalLog,
}

/// Returns the command in a COMMAND_LONG or COMMAND_INT.
pub(crate) fn command_in(port: &Port, received: &Received<'_>) -> Option<Request> {
    let long = received.frame.decode::<CommandLong>().map(|message| from_long(&message, received.origin(port)));
    let int = || received.frame.decode::<CommandInt>().map(|message| from_int(&message, received.origin(port)));
    long.or_else(int).map(Request::from)
}

impl<F: Firmware<Vehicle: Commands>, S: CommandMemory> Service<F> for CommandService<S> {
    const NEW: Self = Self { slots: S::NEW, refusals: RefusalLog::NEW };
    type Link = CommandLink;
    const VACANT: CommandLink = CommandLink { acks: Acks::new(), refusal: 0 };
    type Reply = Ack;
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

    /// A final result precedes the answers, because the answer to what has ended a command has the same id (C-23); but not the
    /// command's own IN_PROGRESS.
    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &CommandLink, turn: Turn) -> Option<(Instant, Ack)> {
        let long = self.slots.view();
        let ack = match turn {
            Turn::CommandProgress => long.filter(|long| long.has_progress(port.id)).map(|_| Ack::Progress),
            _ if long.is_some_and(|long| long.has_final(port.id)) && !link.acks.has_progress() => Some(Ack::Final),
            _ => (!link.acks.is_empty()).then_some(Ack::Answer),
        };
        Some((view.now, ack?))
    }

    fn send(&mut self, _: &mut Cx<'_, F>, port: &mut Port, link: &mut CommandLink, ack: Ack) -> bool {
        let (long, tx) = (self.slots.view_mut(), &mut port.outbox);
        match (ack, long) {
            (Ack::Answer, long) => {
                let progress = |command| long.map_or(self::long::NO_PROGRESS, |long| long.progress_of(command));
                link.acks.next::<F>(tx, progress)
            }
            (Ack::Final, Some(long)) => long.send_final::<F>(tx),
            (Ack::Progress, Some(long)) => long.send_progress::<F>(tx),
            (Ack::Final | Ack::Progress, None) => false,
        }
    }
}

/// The steps of a received command before and after a service carries it out.
impl<S: CommandMemory> CommandService<S> {
    /// Whether every received command was answered.
    pub(crate) const fn has_answered(link: &CommandLink) -> bool {
        link.acks.is_empty()
    }

    /// Whether there is a free slot for an answer. Otherwise the command is dropped and counted.
    pub(crate) fn has_room(port: &mut Port, link: &CommandLink) -> bool {
        let has_room = !link.acks.is_full();
        if !has_room {
            increment(&mut port.counters.no_answer_slot);
        }
        has_room
    }

    /// Returns the answer to a command that must not be carried out: its declaration refuses it, it is running, or it is a
    /// duplicate (C-5, C-12, C-14, C-21, C-24). For a vehicle that declares nothing, this compiles to almost nothing.
    pub(crate) fn admit<F: Firmware<Vehicle: Commands + Vehicle>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        Request { command, answer_as, signed_at, .. }: &Request,
    ) -> Option<Verdict> {
        if command.is_broadcast && is_for_one(*answer_as) {
            return Some(Verdict::Refused(Refusal::BROADCAST));
        }
        let (vehicle, mut context) = cx.hook();
        if let Err(refusal) = policy::check(vehicle, &mut context, command) {
            return Some(Verdict::Refused(refusal));
        }
        let once = policy::once::<F::Vehicle>(command.id);
        let long = self.slots.view_mut()?;
        if ends_calibration(command) && long.is_running(command.id) {
            cancel(cx, long, command.id, command.component, command.from);
            if !long.is_running(command.id) {
                return Some(Verdict::done(MavResult::ACCEPTED));
            }
        }
        let outcome = match is_own::<F>(command) {
            true => long.recall_own(cx.now, command)?,
            false => long.recall(cx.now, command, *signed_at, once)?,
        };
        // The refusal of a duplicate was already explained.
        let is_busy = outcome.result == MavResult::TEMPORARILY_REJECTED && !long.knows(command);
        Some(if is_busy { Verdict::Refused(outcome.result.into()) } else { Verdict::Done(outcome) })
    }

    /// Queues the answer to a command: of the component to which it is addressed, or of the one that has
    /// executed a command to all. An admitted command that no service has handled is passed to the vehicle.
    pub(crate) fn answer<F: Firmware<Vehicle: Commands>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &Port,
        link: &mut CommandLink,
        request: &Request,
        verdict: Option<Verdict>,
        is_admitted: bool,
    ) {
        let is_own_hook = verdict.is_none();
        let mut outcome = match verdict {
            None => self.execute(cx, &request.command),
            Some(Verdict::Done(outcome)) => outcome,
            Some(Verdict::Refused(refusal)) => {
                refusal::explain(cx, port, link, request, refusal);
                refusal.result.into()
            }
        };
        if is_admitted {
            self.settle(cx, request, &mut outcome, is_own_hook);
        }
        let from = request.command.from.address;
        self.log(cx.now, request.answer_as, from, outcome.result);
        let mut by = request.command.component;
        if !F::COMPONENTS.is_empty() {
            let answerer = core::mem::replace(&mut cx.shared.answerer, ComponentId::ALL);
            by = if by.wire() == 0 { answerer } else { by };
        }
        link.acks.push(by, from, request.answer_as, outcome);
    }

    /// Returns the outcome of a command of the firmware itself to one of its components: `verdict` is that of a service.
    pub(crate) fn settle_own<F: Firmware<Vehicle: Commands>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        request: &Request,
        verdict: Option<Verdict>,
        is_admitted: bool,
    ) -> Outcome {
        let is_own_hook = verdict.is_none();
        let mut outcome = match verdict {
            None => self.execute_of_component(cx, &request.command),
            Some(Verdict::Done(outcome)) => outcome,
            Some(Verdict::Refused(refusal)) => refusal.result.into(),
        };
        if is_admitted {
            self.settle(cx, request, &mut outcome, is_own_hook);
        }
        outcome
    }

    /// Cancels a command that the firmware itself has sent to one of its components.
    pub(crate) fn cancel_own<F: Firmware<Vehicle: Commands>>(&mut self, cx: &mut Cx<'_, F>, command: &Command) {
        if let Some(long) = self.slots.view_mut() {
            cancel(cx, long, command.id, command.component, command.from);
        }
    }

    /// Passes a command that no service handles to the vehicle: to the hook of the component to which it is addressed.
    fn execute<F: Firmware<Vehicle: Commands>>(&mut self, cx: &mut Cx<'_, F>, command: &Command) -> Outcome {
        if F::is_component(command.component) {
            return self.execute_of_component(cx, command);
        }
        let can_start = self.slots.view_mut().is_some_and(|long| long.can_start());
        let (vehicle, mut context) = cx.hook();
        context.can_start = can_start;
        vehicle.command(&mut context, command)
    }

    fn execute_of_component<F: Firmware<Vehicle: Commands>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        command: &Command,
    ) -> Outcome {
        let can_start = self.slots.view_mut().is_some_and(|long| long.can_start());
        let (vehicle, mut context) = cx.hook();
        context.can_start = can_start;
        match F::component_command(vehicle, &mut context, command) {
            // The command is known: the component does not have this message.
            Outcome { result: MavResult::UNSUPPORTED, .. } if is_about_message(command.id) => MavResult::DENIED.into(),
            outcome => outcome,
        }
    }

    /// Logs the answer to a command; of refusals, at most one a second.
    pub(crate) fn log(&mut self, now: Instant, command: MavCmd, from: Address, result: MavResult) {
        if matches!(result, MavResult::ACCEPTED | MavResult::IN_PROGRESS) {
            event!("command {=u16} from {}: {=u8}", command.0, from, result.0);
        } else if let Some(refused) = self.refusals.count(now) {
            event!("command {=u16} from {}: {=u8}; {=u32} refused so far", command.0, from, result.0, refused);
        }
    }

    /// Records the outcome of a command that was carried out. IN_PROGRESS is a promise, which only a slot keeps, and only the hooks
    /// for commands get one: otherwise it becomes FAILED, and a text says so (C-20).
    fn settle<F: Firmware<Vehicle: Commands>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        Request { command, signed_at, .. }: &Request,
        outcome: &mut Outcome,
        may_start: bool,
    ) {
        cx.shared.has_acted = true;
        let has_slot = may_start && self.slots.view().is_some_and(LongCommands::can_start);
        if outcome.result == MavResult::IN_PROGRESS && !has_slot {
            outcome.result = MavResult::FAILED;
            increment(&mut cx.shared.faults.unfinished);
            cx.text(MavSeverity::ERROR, b"IN_PROGRESS without a slot");
        }
        if let Some(long) = self.slots.view_mut() {
            let once = if is_own::<F>(command) { Once::No } else { policy::once::<F::Vehicle>(command.id) };
            long.settle(cx.now, command, *signed_at, *outcome, once);
        }
    }
}

/// Whether every component knows this command, for its HEARTBEAT at least.
const fn is_about_message(command: MavCmd) -> bool {
    matches!(command, MavCmd::REQUEST_MESSAGE | MavCmd::SET_MESSAGE_INTERVAL | MavCmd::GET_MESSAGE_INTERVAL)
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

/// Has the vehicle cancel a command if a component is running it (C-23).
fn cancel<F: Firmware<Vehicle: Commands>>(
    cx: &mut Cx<'_, F>,
    long: &mut LongCommands,
    command: MavCmd,
    of: ComponentId,
    from: Peer,
) {
    let is_its =
        |component| F::COMPONENTS.is_empty() || component == of || !(F::is_component(component) || F::is_component(of));
    if long.is_running_in(command, is_its) {
        let (vehicle, mut context) = cx.hook();
        if vehicle.cancel_command(&mut context, command, from) {
            long.finish(command, MavResult::CANCELLED);
        }
    }
    cx.shared.has_acted = true;
}

/// Whether the vehicle's declaration permits `command` (C-5). For messages that are equivalent to a command.
pub(crate) fn is_allowed<V: Commands + Vehicle>(vehicle: &V, cx: &mut Context<'_>, command: &Command) -> bool {
    policy::check(vehicle, cx, command).is_ok()
}
