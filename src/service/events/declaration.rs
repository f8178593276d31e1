//! The parts of a declaration of events: [`events!`](crate::events!) implements these traits (EVT-1).
//!
//! Ids are those of PX4 and libevents: the component id in the highest byte, and the lowest 24 bits of the FNV-1a hash
//! of the event's name. The compiler computes them. The texts are constants that only the generator of the metadata
//! uses, so they take no flash in a firmware.

use crate::message::{Field, FieldWriter};
use crate::types::MAX_EVENT_ARGUMENTS;

/// The importance of an event. An event has an external level, for the operator, and an internal one, for logs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum LogLevel {
    /// The vehicle is lost or out of control.
    Emergency,
    /// Act at once.
    Alert,
    /// A critical condition.
    Critical,
    /// An error. An arming check of this level or above marks its component as failed.
    Error,
    /// A warning.
    Warning,
    /// Unusual, but not an error.
    Notice,
    /// Normal operation.
    Info,
    /// For developers.
    Debug,
    /// Part of a protocol: ground stations do not show it.
    Protocol,
    /// Not shown, or not logged.
    Disabled,
}

impl LogLevel {
    #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; a level is less than 10")]
    const fn number(self) -> u8 {
        self as u8
    }
}

/// The group of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EventGroup {
    /// Shown when it is received.
    Default,
    /// A check before arming.
    ArmingCheck,
    /// A check of a component's health.
    Health,
}

/// The type of an event's argument: an integer of up to 64 bits, `f32`, or an enumeration or bitmask of
/// [`events!`](crate::events!).
#[diagnostic::on_unimplemented(
    message = "`{Self}` cannot be an argument of an event",
    note = "use an integer of up to 64 bits, `f32`, or an enumeration of the same `events!`"
)]
pub trait EventArgument: Field {
    /// The name of the enumeration, or `None` for a number.
    const ENUM: Option<&'static str> = None;
}

macro_rules! arguments {
    ($($ty:ty),*) => { $(impl EventArgument for $ty {})* };
}
arguments!(u8, i8, u16, i16, u32, i32, u64, i64, f32);

/// An argument of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArgumentInfo {
    pub(crate) name: &'static str,
    pub(crate) description: &'static str,
    /// The name of a number's type, or of an enumeration.
    pub(crate) r#type: &'static str,
    pub(crate) is_enum: bool,
    size: usize,
}

impl ArgumentInfo {
    #[doc(hidden)]
    pub const fn new<T: EventArgument>(name: &'static str, description: &'static str) -> Self {
        let (r#type, is_enum) = match T::ENUM {
            Some(name) => (name, true),
            None => (T::WIRE_TYPE, false),
        };
        Self { name, description, r#type, is_enum, size: T::SIZE }
    }
}

/// An entry of an enumeration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EntryInfo {
    pub(crate) name: &'static str,
    pub(crate) description: &'static str,
    pub(crate) value: u64,
}

impl EntryInfo {
    #[doc(hidden)]
    pub const fn new(name: &'static str, description: &'static str, value: u64) -> Self {
        assert!(
            !description.is_empty(),
            "an entry of an enumeration, of `modes` or of `components` needs a doc comment, which ground stations show"
        );
        Self { name, description, value }
    }

    #[doc(hidden)]
    #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u32 to u64")]
    pub const fn bit(name: &'static str, description: &'static str, bit: u32) -> Self {
        Self::new(name, description, bit as u64)
    }
}

/// An enumeration, or a bitmask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnumInfo {
    pub(crate) name: &'static str,
    pub(crate) description: &'static str,
    pub(crate) r#type: &'static str,
    pub(crate) is_bitmask: bool,
    pub(crate) entries: &'static [EntryInfo],
}

impl EnumInfo {
    #[doc(hidden)]
    #[allow(clippy::panic, reason = "const-evaluated: a compile error")]
    pub const fn new<T: EventArgument>(
        description: &'static str,
        is_bitmask: bool,
        entries: &'static [EntryInfo],
    ) -> Self {
        let Some(name) = T::ENUM else { panic!("a number is no enumeration") };
        Self { name, description, r#type: T::WIRE_TYPE, is_bitmask, entries }
    }
}

/// The declaration of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventInfo {
    pub(crate) id: u32,
    pub(crate) name: &'static str,
    pub(crate) group: EventGroup,
    /// Whether it begins or ends a report of the checks.
    pub(crate) is_summary: bool,
    pub(crate) log_levels: u8,
    pub(crate) message: &'static str,
    pub(crate) description: &'static str,
    pub(crate) arguments: &'static [ArgumentInfo],
}

impl EventInfo {
    #[doc(hidden)]
    pub const fn new(component: u8, name: &'static str, group: EventGroup, levels: [LogLevel; 2]) -> Self {
        let [external, internal] = levels;
        Self {
            id: id(component, name),
            name,
            group,
            is_summary: false,
            log_levels: internal.number() << 4 | external.number(),
            message: "",
            description: "",
            arguments: &[],
        }
    }

    #[doc(hidden)]
    #[must_use]
    pub const fn with(
        self,
        message: &'static str,
        description: &'static str,
        arguments: &'static [ArgumentInfo],
    ) -> Self {
        assert!(
            !message.is_empty() && message.len() <= 120,
            "the message of an event has 1 to 120 bytes: put the rest into its description"
        );
        let mut size = 0usize;
        let mut rest = arguments;
        while let Some((argument, after)) = rest.split_first() {
            size = size.saturating_add(argument.size);
            rest = after;
        }
        assert!(
            size <= MAX_EVENT_ARGUMENTS,
            "the arguments of an event have at most 25 bytes, and those of a check 20"
        );
        let first = match self.group {
            EventGroup::Default => 1,
            EventGroup::ArmingCheck | EventGroup::Health => 3,
        };
        check_places(message, first, arguments.len());
        check_places(description, first, arguments.len());
        Self { message, description, arguments, ..self }
    }

    #[doc(hidden)]
    #[must_use]
    pub const fn summary(self) -> Self {
        Self { is_summary: true, ..self }
    }

    /// Returns the event's id, as in EVENT.
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// Returns the internal level in the high four bits and the external one in the low four, as in EVENT.
    pub const fn log_levels(&self) -> u8 {
        self.log_levels
    }
}

/// A set of events, with the names and texts for ground stations: `metadata::events` writes its file.
/// [`events!`](crate::events!) implements it.
pub trait EventSet {
    /// The namespace of the events.
    const NAMESPACE: &'static str;
    /// The highest byte of the ids: usually the component id.
    const COMPONENT: u8;
    /// The enumerations.
    const ENUMS: &'static [EnumInfo];
    /// The events.
    const EVENTS: &'static [EventInfo];
    /// The numbers of the flight modes (HEARTBEAT.custom_mode) in each group of modes.
    const MODE_GROUPS: &'static [&'static [u32]];
}

/// A set of events with groups of modes and components, and therefore with checks.
pub trait CheckSet: EventSet {
    /// The groups of flight modes.
    type Modes: CheckBits;
    /// The components.
    type Components: CheckBits;
    /// All groups.
    const ALL_MODES: u32;
    #[doc(hidden)]
    const ARMING_SUMMARY: EventInfo;
    #[doc(hidden)]
    const HEALTH_SUMMARY: EventInfo;
}

/// Groups of flight modes, or components, as bits.
pub trait CheckBits: EventArgument {
    /// Returns the bits.
    fn bits(self) -> u32;
}

/// An event or a check that [`events!`](crate::events!) declared.
pub trait DeclaredEvent {
    /// Its declaration.
    const INFO: EventInfo;

    /// Writes its own arguments.
    #[doc(hidden)]
    fn write(&self, out: &mut FieldWriter<'_>);
}

/// An event that a vehicle sends with [`Context::event`](crate::Context::event) or
/// [`Stack::event`](crate::Stack::event).
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not an event",
    note = "declare it under `events` in `events!`; a check is reported by `HealthReport::fails` and not sent by itself"
)]
pub trait Event: DeclaredEvent {}

/// A check that a vehicle reports with [`HealthReport::fails`](super::HealthReport::fails).
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a check",
    note = "declare it under `arming_checks` or `health_checks` in `events!`; an event is sent by `Context::event`"
)]
pub trait Check: DeclaredEvent {
    /// The set that has its groups of modes and its components.
    type Set: CheckSet;
}

/// Returns the id of an event. Its name is written as in the metadata: `BatteryLow` is `battery_low`.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u8 to u32")]
const fn id(component: u8, name: &str) -> u32 {
    let mut hash = FNV1A_BASIS;
    let (mut rest, mut is_first) = (name.as_bytes(), true);
    while let Some((&byte, after)) = rest.split_first() {
        if byte.is_ascii_uppercase() && !is_first {
            hash = fnv1a(hash, b'_');
        }
        hash = fnv1a(hash, byte.to_ascii_lowercase());
        (rest, is_first) = (after, false);
    }
    (component as u32) << 24 | (hash & 0x00FF_FFFF)
}

/// The FNV-1a hash of nothing.
pub(super) const FNV1A_BASIS: u32 = 0x811C_9DC5;

/// Adds a byte to an FNV-1a hash.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u8 to u32")]
pub(super) const fn fnv1a(hash: u32, byte: u8) -> u32 {
    (hash ^ byte as u32).wrapping_mul(0x0100_0193)
}

/// Fails to compile if a text shows an argument that does not exist: `{1}` is the first one, and `{3}` the first one of
/// a check.
#[allow(
    clippy::as_conversions,
    clippy::arithmetic_side_effects,
    reason = "const-evaluated: a failure is a compile error"
)]
const fn check_places(text: &str, first: usize, arguments: usize) {
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte == b'\\' {
            if let Some((_, after)) = rest.split_first() {
                rest = after;
            }
        } else if byte == b'{' {
            let (mut number, mut is_closed) = (0, false);
            let mut place = rest;
            while let Some((&digit @ b'0'..=b'9', after)) = place.split_first() {
                number = number * 10 + (digit - b'0') as usize;
                place = after;
            }
            while let Some((&byte, after)) = place.split_first() {
                is_closed |= byte == b'}';
                place = after;
            }
            assert!(
                number >= first && number <= arguments && is_closed,
                "a text shows an argument as `{{1}}` or `{{2:.1m}}`, counted from 1, and from 3 in a check; put a backslash before any other brace"
            );
        }
    }
}

/// Fails to compile if two events of a set have the same id, or if an enumeration is wrong, which its constructor says.
#[doc(hidden)]
pub const fn check_events(events: &[EventInfo], _: &[EnumInfo]) {
    let mut rest = events;
    while let Some((event, after)) = rest.split_first() {
        let mut others = after;
        while let Some((other, after)) = others.split_first() {
            assert!(
                event.id != other.id,
                "two events have the same name, or names with the same hash: rename one of them"
            );
            others = after;
        }
        rest = after;
    }
}

/// Returns the bit of an entry: its place among the names.
#[doc(hidden)]
#[allow(clippy::panic, reason = "const-evaluated: a compile error")]
pub const fn bit(names: &[&str], name: &str) -> u32 {
    assert!(names.len() <= 32, "there are at most 32 groups of modes, and 31 components");
    let (mut bit, mut rest) = (1_u32, names);
    while let Some((other, after)) = rest.split_first() {
        if is_same(other.as_bytes(), name.as_bytes()) {
            return bit;
        }
        (bit, rest) = (bit << 1, after);
    }
    panic!("the name is not in the list")
}

const fn is_same(mut a: &[u8], mut b: &[u8]) -> bool {
    while let (Some((x, after)), Some((y, behind))) = (a.split_first(), b.split_first()) {
        if *x != *y {
            return false;
        }
        (a, b) = (after, behind);
    }
    a.is_empty() && b.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// EVT-1: the ids are those of PX4's `events::ID`, computed with its Python generator's hash.
    #[test]
    fn ids_are_those_of_px4() {
        assert_eq!(id(1, "commander_arming_check_summary"), id(1, "CommanderArmingCheckSummary"));
        assert_eq!(id(0, ""), 0x001C_9DC5);
        // FNV-1a of "foobar" is 0xBF9CF968.
        assert_eq!(id(1, "foobar"), 0x019C_F968);
        assert_eq!(id(100, "Foobar"), 0x649C_F968);
        assert_ne!(id(1, "FooBar"), id(1, "Foobar"));
    }

    #[test]
    fn places_are_checked() {
        check_places("", 1, 0);
        check_places("{1} {2:.1m/s} \\{3} {3}", 1, 3);
        check_places("{3} {4}", 3, 4);
        let wrong =
            [("{1}", 1, 0), ("{0}", 1, 1), ("{", 1, 1), ("{2}", 1, 1), ("{1", 1, 1), ("{}", 1, 1), ("{2}", 3, 4)];
        for (text, first, arguments) in wrong {
            assert!(std::panic::catch_unwind(|| check_places(text, first, arguments)).is_err(), "{text}");
        }
    }
}
