//! Flight modes: which ones there are, which one the vehicle is in, and who asks for another.
//!
//! Implements <https://mavlink.io/en/services/standard_modes.html>, MAV_CMD_DO_SET_MODE and the SET_MODE from before it:
//! rules C-32, Q-3, Q-10. The modes are a constant of the firmware
//! ([`Commands::MODES`](crate::Commands::MODES)); a request for one of them reaches the vehicle as that row of the table,
//! whichever way it came, and any other is DENIED. Which modes a link was asked for and not told yet is a bit each. Nothing
//! but answers goes to a high-latency link, and nothing at all to one that sends MAVLink 1, which has no room for these
//! messages' ids (S-10). The table cannot change, so AVAILABLE_MODES_MONITOR is only sent to who asks for it.

use super::command::Origin;
use super::identity::Owed;
use crate::dialect::{
    AvailableModes, AvailableModesMonitor, CurrentMode, MavCmd, MavModeFlag, MavModeProperty, MavResult,
    MavStandardMode, SetMode,
};
use crate::frame::Version;
use crate::link::{Link, LinkClass, Peer, Port};
use crate::message::{Message, Text};
use crate::num;
use crate::time::Duration;
use crate::vehicle::{Command, CommandPosition, Commands, Outcome, Vehicle, VehicleState};

/// The most modes that a vehicle can declare.
pub const MAX_MODES: usize = 32;

/// The longest name: AVAILABLE_MODES ends it with a NUL.
const MAX_NAME: usize = 34;

/// The revision of the table, the same in AVAILABLE_MODES and AVAILABLE_MODES_MONITOR. It starts at 0 and counts changes; the
/// table is a constant and has none. Source: mavlink#2557.
const SEQ: u8 = 0;

/// A flight mode: a row of [`Commands::MODES`](crate::Commands::MODES).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FlightMode {
    /// What [`VehicleState::custom_mode`](crate::VehicleState::custom_mode) is in this mode. No other mode has the same.
    pub custom_mode: u32,
    /// What people call it: 1 to 34 bytes.
    pub name: &'static str,
    /// The mode that means the same on all vehicles, if it is one; no other mode is the same one.
    pub standard_mode: MavStandardMode,
    /// What a ground station should know of it. One that is
    /// [`NOT_USER_SELECTABLE`](MavModeProperty::NOT_USER_SELECTABLE) is DENIED to who asks for it.
    pub properties: MavModeProperty,
}

impl FlightMode {
    /// A mode of this vehicle only, which anybody may ask for.
    ///
    /// A `custom_mode` of more than 24 significant bits is no `f32`: then SET_MODE can ask for it and MAV_CMD_DO_SET_MODE
    /// cannot.
    pub const fn new(custom_mode: u32, name: &'static str) -> Self {
        let (standard_mode, properties) = (MavStandardMode::NON_STANDARD, MavModeProperty::EMPTY);
        Self { custom_mode, name, standard_mode, properties }
    }

    /// The same, as the standard mode that MAV_CMD_DO_SET_STANDARD_MODE asks for.
    #[must_use]
    pub const fn with_standard_mode(self, standard_mode: MavStandardMode) -> Self {
        Self { standard_mode, ..self }
    }

    /// The same, with what a ground station should know of it: several are put together by `with`.
    #[must_use]
    pub const fn with_properties(self, properties: MavModeProperty) -> Self {
        Self { properties, ..self }
    }

    /// At most [`MAX_MODES`], each number and each standard mode once, names within bounds.
    #[allow(clippy::indexing_slicing, clippy::arithmetic_side_effects, reason = "const-evaluated")]
    pub(crate) const fn check(table: &[Self]) {
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

/// How parameters 2 and 3 of MAV_CMD_DO_SET_MODE make a `custom_mode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CustomMode {
    /// Parameter 2 is all of it, and parameter 3 says nothing: ArduPilot's way.
    Whole,
    /// Parameter 2 is the main mode, parameter 3 the sub-mode, each 0 to 255: `main << 16 | sub << 24`, PX4's way, which
    /// MAVSDK uses with every autopilot but ArduPilot. Without a sub-mode a parameter 2 above 255 is all of it, as with
    /// [`Whole`](Self::Whole).
    MainSub,
}

/// Who asks for a mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ModeRequest {
    /// The sender, and the link.
    pub from: Peer,
    /// As [`Command::class`](crate::Command::class).
    pub class: LinkClass,
    /// As [`Command::age`](crate::Command::age).
    pub age: Option<Duration>,
    /// Whether every system was asked (C-1).
    pub is_broadcast: bool,
}

/// What an answer to SET_MODE calls its command (C-32): the number of no command.
pub(crate) const SET_MODE: MavCmd = MavCmd(11);
const _: () = assert!(SetMode::ID == 11);

/// The command that a SET_MODE is, but for its number, which a parameter cannot always hold: [`on_command`] gets it apart.
pub(crate) fn from_set_mode(message: &SetMode, origin: Origin) -> Command {
    Command {
        id: MavCmd::DO_SET_MODE,
        params: [f32::from(message.base_mode.0), num::f32_from_u32(message.custom_mode), 0.0, 0.0],
        position: CommandPosition::Long { param5: 0.0, param6: 0.0 },
        z: 0.0,
        from: origin.from,
        class: origin.class,
        age: origin.age,
        is_broadcast: message.target_system == 0,
        confirmation: 0,
    }
}

/// A mode that is refused: its number, if it has one, and the reason.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refused(pub(crate) Option<u32>, pub(crate) &'static str);

/// Handles a command about modes; `None` for all others. `set_mode` is the `custom_mode` of a SET_MODE. An error means
/// DENIED, and a text must explain it.
#[inline(never)]
pub(crate) fn on_command<V: Vehicle + Commands>(
    port: &mut Port,
    vehicle: &mut V,
    command: &Command,
    set_mode: Option<u32>,
) -> Option<Result<Outcome, Refused>> {
    let [first, ..] = command.params;
    let (asked, mode) = match command.id {
        MavCmd::DO_SET_MODE => {
            let custom_mode = set_mode.or_else(|| custom_mode(V::CUSTOM_MODE, command.params));
            // The other flags name no mode that a vehicle would know.
            let is_custom =
                num::integer(first).is_some_and(|flags| MavModeFlag(flags).contains(MavModeFlag::CUSTOM_MODE_ENABLED));
            if !is_custom {
                return Some(Err(Refused(custom_mode, "set CUSTOM_MODE_ENABLED")));
            }
            (custom_mode, custom_mode.and_then(|mode| find(V::MODES, mode)))
        }
        MavCmd::DO_SET_STANDARD_MODE => (None, num::integer(first).and_then(|mode| find_standard(V::MODES, mode))),
        MavCmd::REQUEST_MESSAGE => {
            let result = request(V::MODES.len(), port, command, || vehicle.state().is_some());
            return result.map(|result| Ok(result.into()));
        }
        _ => return None,
    };
    Some(match mode {
        Some(mode) if mode.properties.contains(MavModeProperty::NOT_USER_SELECTABLE) => {
            Err(Refused(asked, "it cannot be selected"))
        }
        Some(mode) => {
            let Command { from, class, age, is_broadcast, .. } = *command;
            Ok(vehicle.set_mode(mode, &ModeRequest { from, class, age, is_broadcast }))
        }
        // The guide has FAILED for a standard mode that there is not; but asking again never helps (C-4).
        None => Err(Refused(asked, "not in AVAILABLE_MODES")),
    })
}

/// The `custom_mode` of parameters 2 and 3 of a MAV_CMD_DO_SET_MODE (C-8, C-9).
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

/// A request for one of the messages about modes; `None` for other messages. `count` is how many modes there are.
fn request(count: usize, port: &mut Port, command: &Command, knows_mode: impl FnOnce() -> bool) -> Option<MavResult> {
    let [id, index, ..] = command.params;
    let id = num::unsigned(id).filter(|id| matches!(*id, AvailableModes::ID..=AvailableModesMonitor::ID))?;
    if !takes(port) || !command.has_response_target() {
        return Some(MavResult::DENIED);
    }
    let message = match id {
        AvailableModes::ID => {
            let index = if index.is_nan() { Some(0) } else { num::integer::<u8>(index) };
            let Some(modes) = index.and_then(|index| bits(count, index)) else { return Some(MavResult::DENIED) };
            port.modes |= modes;
            Owed::AVAILABLE_MODES
        }
        CurrentMode::ID if knows_mode() => Owed::CURRENT_MODE,
        CurrentMode::ID => return Some(MavResult::DENIED),
        _ => Owed::AVAILABLE_MODES_MONITOR,
    };
    port.owed.add(message);
    Some(MavResult::ACCEPTED)
}

const _: () = assert!(CurrentMode::ID == AvailableModes::ID + 1 && AvailableModesMonitor::ID == CurrentMode::ID + 1);

/// The modes that index `index` of AVAILABLE_MODES means: 0 is all of the `count`, others count from 1.
fn bits(count: usize, index: u8) -> Option<u32> {
    let count = u32::try_from(count).ok()?;
    let index = u32::from(index);
    if index == 0 {
        return u32::MAX.checked_shr(u32::BITS.wrapping_sub(count));
    }
    1u32.checked_shl(index.wrapping_sub(1)).filter(|_| index <= count)
}

/// Whether the messages about modes may go out on a link.
fn takes(port: &Port) -> bool {
    port.config.class != LinkClass::HighLatency && port.outbox.version() == Version::V2
}

/// CURRENT_MODE is to be sent.
fn tell(port: &mut Port) {
    if takes(port) {
        port.owed.add(Owed::CURRENT_MODE);
    }
}

/// Sends CURRENT_MODE when the mode of `state` differs from `told`, the last reported mode.
pub(crate) fn poll(told: &mut u32, links: &mut [Link], state: Option<VehicleState>) {
    let Some(state) = state.filter(|state| state.custom_mode != *told) else { return };
    *told = state.custom_mode;
    event!("mode {=u32}", state.custom_mode);
    links.iter_mut().for_each(|link| tell(&mut link.port));
}

/// A HEARTBEAT was sent: CURRENT_MODE goes with every second one.
pub(crate) fn on_heartbeat(port: &mut Port) {
    if !port.owed.take(Owed::NO_MODE_NEXT) {
        port.owed.add(Owed::NO_MODE_NEXT);
        tell(port);
    }
}

/// Sends CURRENT_MODE or AVAILABLE_MODES_MONITOR. False when neither is owed, or can be sent.
pub(crate) fn next_current<V: Vehicle + Commands>(port: &mut Port, vehicle: &V) -> bool {
    let Port { owed, outbox, .. } = port;
    if owed.take(Owed::CURRENT_MODE)
        && let Some(state) = vehicle.state()
    {
        let mode = find(V::MODES, state.custom_mode);
        return outbox.send(&CurrentMode {
            custom_mode: state.custom_mode,
            intended_custom_mode: vehicle.intended_mode(),
            standard_mode: mode.map_or(MavStandardMode::NON_STANDARD, |mode| mode.standard_mode),
        });
    }
    owed.take(Owed::AVAILABLE_MODES_MONITOR) && outbox.send(&AvailableModesMonitor { seq: SEQ })
}

/// Sends the next row of `table` that somebody asked for. False when none is owed, or can be sent.
pub(crate) fn next_listed(port: &mut Port, table: &[FlightMode]) -> bool {
    let Port { owed, modes, outbox, .. } = port;
    if !owed.take(Owed::AVAILABLE_MODES) {
        return false;
    }
    // In the table's order: QGroundControl takes the last one for the end of the list.
    let index = usize::try_from(modes.trailing_zeros()).unwrap_or(MAX_MODES);
    *modes &= modes.wrapping_sub(1);
    if *modes != 0 {
        owed.add(Owed::AVAILABLE_MODES);
    }
    table.get(index).is_some_and(|mode| {
        outbox.send(&AvailableModes {
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
    fn tables_within_bounds_are_taken() {
        FlightMode::check(&[]);
        FlightMode::check(&[HOLD, LAND, FlightMode::new(0, "a mode whose name is 34 bytes long")]);
        let mut most = [HOLD; MAX_MODES];
        (0..).zip(&mut most).for_each(|(number, mode)| mode.custom_mode = number);
        FlightMode::check(&most);
    }

    #[test]
    #[should_panic(expected = "at most 32 modes")]
    fn too_many_modes_are_not() {
        FlightMode::check(&[HOLD; MAX_MODES + 1]);
    }

    #[test]
    #[should_panic(expected = "same custom_mode")]
    fn two_modes_with_one_number_are_not() {
        FlightMode::check(&[HOLD, LAND, FlightMode { name: "Wait", ..HOLD }]);
    }

    #[test]
    #[should_panic(expected = "same standard mode")]
    fn one_standard_mode_twice_is_not() {
        FlightMode::check(&[LAND, HOLD, FlightMode { custom_mode: 3, ..LAND }]);
    }

    #[test]
    #[should_panic(expected = "1 to 34 bytes")]
    fn a_mode_without_a_name_is_not() {
        FlightMode::check(&[HOLD, FlightMode { name: "", ..LAND }]);
    }

    #[test]
    #[should_panic(expected = "1 to 34 bytes")]
    fn a_name_without_room_for_its_end_is_not() {
        FlightMode::check(&[FlightMode { name: "a mode whose name is 35 bytes long.", ..HOLD }]);
    }
}
