//! The command protocol: COMMAND_LONG and COMMAND_INT in, exactly one COMMAND_ACK out.
//!
//! Implements <https://mavlink.io/en/services/command.html>, rules C-1 to C-24 and the commands that a stack answers by
//! itself (§6.4 in part). A command is taken only while there is a free slot to owe its answer in; else it is dropped
//! unexecuted and counted, which to the sender is a lost frame that it repeats.
//!
//! The way of a command is drawn at [`Commands`].

mod acks;
mod copies;
mod macros;
mod memory;
mod policy;
mod refusal;
mod typed;

pub(crate) use acks::Acks;
pub(crate) use copies::{Copies, LATE, Once, SOON, SignedAt, is_well_after};
pub use memory::{CommandMemory, CommandSlot, CommandSlots};
pub use policy::CommandPolicy;
pub(crate) use refusal::{Refusal, explain, explain_mode};
pub use typed::{CommandParam, CommandParams, LatLon, Location, TypedCommand};

use crate::dialect::{CommandInt, CommandLong, MavCmd, MavFrame, MavResult};
use crate::link::{LinkClass, Peer, Port};
use crate::service::identity::Owed;
use crate::time::{Duration, Instant};
use crate::vehicle::{Command, CommandPosition, Commands, Outcome};

/// Where a command came from, and how old it is.
#[derive(Clone, Copy)]
pub(crate) struct Origin {
    pub(crate) from: Peer,
    pub(crate) class: LinkClass,
    pub(crate) age: Option<Duration>,
}

/// The command of a COMMAND_LONG.
pub(crate) fn from_long(message: &CommandLong, origin: Origin) -> Command {
    Command {
        id: message.command,
        params: [message.param1, message.param2, message.param3, message.param4],
        position: CommandPosition::Long { param5: message.param5, param6: message.param6 },
        z: message.param7,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        is_broadcast: message.target_system == 0,
        confirmation: message.confirmation,
    }
}

/// The command of a COMMAND_INT.
pub(crate) fn from_int(message: &CommandInt, origin: Origin) -> Command {
    Command {
        id: message.command,
        params: [message.param1, message.param2, message.param3, message.param4],
        position: CommandPosition::Int { frame: MavFrame(message.frame.0), x: message.x, y: message.y },
        z: message.z,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    }
}

/// Whether a broadcast of this command is always refused, because it resets, erases or replaces what a vehicle stores, or
/// restarts the vehicle (C-14). Commands that only move, arm or terminate a vehicle are not in the list: they can be meant for a
/// fleet, and [`CommandPolicy::no_broadcast`] refuses them.
pub(crate) const fn is_for_one(command: MavCmd) -> bool {
    // From dialects that include common.
    const DO_UPGRADE: MavCmd = MavCmd(247);
    const DO_SET_SYS_CMP_ID: MavCmd = MavCmd(610);
    const DO_START_MAG_CAL: MavCmd = MavCmd(42_424);
    const FLASH_BOOTLOADER: MavCmd = MavCmd(42_650);
    const BATTERY_RESET: MavCmd = MavCmd(42_651);
    matches!(
        command,
        // Parameters are reset, overwritten from storage, or stored. Restarts, also into the bootloader.
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

/// Returns the answer to a command that is not carried out: refused by its declaration, running, or done before (C-5, C-12,
/// C-21, C-24). An error is a refusal that a text must explain. This compiles to nothing for a vehicle that declares nothing
/// and has no memory for commands.
pub(crate) fn answered<V: Commands>(
    now: Instant,
    command: &Command,
    signed_at: SignedAt,
    vehicle: &mut V,
) -> Option<Result<Outcome, Refusal>> {
    if let Err(refusal) = policy::check(command, vehicle) {
        return Some(Err(refusal));
    }
    let once = policy::once::<V>(command.id);
    let memory = vehicle.command_memory()?;
    let outcome = memory.recall(now, command, signed_at, once)?;
    // The refusal of a duplicate was already explained.
    let is_busy = outcome.result == MavResult::TEMPORARILY_REJECTED && !memory.knows(command);
    Some(if is_busy { Err(outcome.result.into()) } else { Ok(outcome) })
}

/// Whether the vehicle's declaration of `command` permits it (C-5): for a message that is equivalent to a command.
pub(crate) fn is_allowed<V: Commands>(command: &Command, vehicle: &V) -> bool {
    policy::check(command, vehicle).is_ok()
}

/// A command was carried out.
pub(crate) fn carried_out<V: Commands>(
    now: Instant,
    command: &Command,
    signed_at: SignedAt,
    outcome: Outcome,
    vehicle: &mut V,
) {
    let once = policy::once::<V>(command.id);
    if let Some(memory) = vehicle.command_memory() {
        memory.settle(now, command, signed_at, outcome, once);
    }
}

/// COMMAND_CANCEL (C-23): without an answer of its own.
pub(crate) fn cancel<V: Commands>(command: MavCmd, from: Peer, vehicle: &mut V) {
    let is_running = vehicle.command_memory().is_some_and(|memory| memory.is_running(command));
    if is_running
        && vehicle.cancel_command(command, from)
        && let Some(memory) = vehicle.command_memory()
    {
        memory.finish(command, MavResult::CANCELLED);
    }
}

/// Runs the timers.
pub(crate) fn poll(now: Instant, vehicle: &mut impl Commands) {
    if let Some(memory) = vehicle.command_memory() {
        memory.poll(now);
    }
}

/// Sends one answer: to a command that came, or of one that has ended, or of one that runs. The last waits for the link's
/// byte rate, and does not travel by satellite. False when none is owed.
pub(crate) fn next(port: &mut Port, vehicle: &mut impl Commands) -> bool {
    let sent = port.acks.next(&mut port.outbox, |command| {
        let memory = vehicle.command_memory();
        memory.map_or(memory::NO_PROGRESS, |memory| memory.progress_of(command))
    });
    sent || vehicle.command_memory().is_some_and(|memory| {
        let may_wait = port.config.class != LinkClass::HighLatency && port.bucket.has_room();
        memory.next_final(&mut port.outbox) || (may_wait && memory.next_progress(&mut port.outbox))
    })
}

/// Carries out a command: the stack's own, or the vehicle's.
pub(crate) fn execute(command: &Command, class: LinkClass, owed: &mut Owed, vehicle: &mut impl Commands) -> Outcome {
    match command.id {
        MavCmd::REQUEST_MESSAGE => request_message(command, class, owed).into(),
        MavCmd::REQUEST_AUTOPILOT_CAPABILITIES => request_legacy(command, class, owed, Owed::AUTOPILOT_VERSION).into(),
        MavCmd::REQUEST_PROTOCOL_VERSION => request_legacy(command, class, owed, Owed::PROTOCOL_VERSION).into(),
        _ => vehicle.command(command),
    }
}

/// an id that we cannot send is DENIED, since the command itself is supported. Q-3: so is a bad response target.
fn request_message(command: &Command, class: LinkClass, owed: &mut Owed) -> MavResult {
    use crate::dialect::{AutopilotVersion, ProtocolVersion};
    use crate::message::Message;

    let [id, ..] = command.params;
    let message = match crate::num::integer::<u32>(id) {
        Some(id) if id == AutopilotVersion::ID => Owed::AUTOPILOT_VERSION,
        Some(id) if id == ProtocolVersion::ID => Owed::PROTOCOL_VERSION,
        _ => return MavResult::DENIED,
    };
    // Response target: 0 default, 1 the requester, 2 broadcast; NaN is "not used" (C-8).
    let target_is_known = command.z.is_nan() || matches!(crate::num::integer(command.z), Some(0..=2));
    owe(target_is_known, class, owed, message)
}

/// The commands from before REQUEST_MESSAGE: parameter 1 must be 1.
fn request_legacy(command: &Command, class: LinkClass, owed: &mut Owed, message: Owed) -> MavResult {
    let [request, ..] = command.params;
    owe(crate::num::integer(request) == Some(1), class, owed, message)
}

/// On a high-latency link only commands and their answers travel (L-4).
fn owe(valid: bool, class: LinkClass, owed: &mut Owed, message: Owed) -> MavResult {
    if !valid || class == LinkClass::HighLatency {
        return MavResult::DENIED;
    }
    owed.add(message);
    MavResult::ACCEPTED
}
