//! `events!` declares events: their ids, arguments and texts.

/// Declares a vehicle's events: a type for each, with an id computed from its name, and the texts that ground stations
/// show.
///
/// ```
/// mavstack::events! {
///     /// The events of this rover.
///     pub struct RoverEvents in "rover" {
///         enums {
///             /// Why the rover returns.
///             Reason: u8 {
///                 /// low battery
///                 LOW_BATTERY = 0,
///                 /// a command
///                 COMMAND = 1,
///             }
///         }
///         events {
///             /// The rover drives back to where it started.
///             Returning(Warning) { reason: Reason, distance: f32 } = "Returning {2:.0m}: {1}";
///             Parked(Info, Disabled) = "Parked";
///         }
///     }
/// }
/// use mavstack::events::DeclaredEvent;
///
/// let event = Returning { reason: Reason::LOW_BATTERY, distance: 12.5 };
/// assert_eq!(Returning::INFO.id() >> 24, 1, "the autopilot's");
/// # let _ = event;
/// ```
///
/// | part | meaning |
/// |---|---|
/// | `in "rover"`, `in "camera", component 100` | the namespace, and the highest byte of the ids; the autopilot's is 1 |
/// | `enums { Name: type { ENTRY = n, … } … }` | enumerations for arguments; `Name: bitmask type { … }` for bits |
/// | `Name(External, Internal) { argument: type, … } = "message";` | an event; its doc comment is the description |
/// | `modes`, `components`, `arming_checks`, `health_checks` | see [checks](#checks) |
///
/// - The levels are those of [`LogLevel`](crate::events::LogLevel). Without an internal level, it equals the external
///   one.
/// - The parts are in this order: `enums`, `modes`, `components`, `arming_checks`, `health_checks`, `events`. Each
///   entry of `enums`, `modes` and `components` has a doc comment, which ground stations show.
/// - `{1}` in a text is the first argument. `{2:.1m}` is the second with one decimal and a unit. Any unit is shown;
///   ground stations may convert `m`, `m_v` (vertical), `m/s`, `m^2` and `C`. Escape `{`, `<` and the backslash with a
///   backslash.
/// - In the metadata, `BatteryLow` is `battery_low`, and `Reason` is `reason_t`.
/// - The arguments have at most 25 bytes. Never change an event or its meaning: ground stations identify it by its
///   name.
///
/// # Checks
///
/// Arming checks are events too. A vehicle reports them with [`HealthChecks`](crate::HealthChecks):
///
/// ```
/// # const MANUAL: u32 = 1;
/// # const AUTO: u32 = 4;
/// # const HOLD: u32 = 5;
/// mavstack::events! {
///     /// The events of this rover.
///     pub struct RoverEvents in "rover" {
///         modes ModeGroups {
///             /// Manual
///             MANUAL = [MANUAL],
///             /// Automatic
///             AUTO = [AUTO, HOLD],
///         }
///         components Health {
///             /// Battery
///             BATTERY,
///             /// GPS
///             GPS,
///         }
///         arming_checks {
///             /// Wait until the GPS has a position.
///             NoFix(Error) { satellites: u8 } = "No GPS fix, {3} satellites";
///         }
///         health_checks {
///             BatteryWorn(Warning) = "Battery worn";
///         }
///     }
/// }
/// ```
///
/// `modes` lists groups of modes with the same checks, by their numbers (HEARTBEAT.custom_mode). `components` lists the
/// components that can fail. Two arguments come before a check's own: the affected modes and the component. Its first
/// own argument is therefore `{3}`, and its own arguments have at most 20 bytes. `health_checks` may be left out.
///
/// # Compile errors
///
/// ```compile_fail
/// mavstack::events! { struct Twice in "a" { events { A(Info) = "a"; A(Info) = "b"; } } }
/// ```
///
/// ```compile_fail
/// mavstack::events! { struct Place in "a" { events { A(Info) { x: u8 } = "{2}"; } } }
/// ```
///
/// ```compile_fail
/// mavstack::events! { struct Size in "a" { events { A(Info) { a: u64, b: u64, c: u64, d: u16 } = "a"; } } }
/// ```
///
/// ```compile_fail
/// mavstack::events! { struct Double in "a" { events { A(Info) { a: f64 } = "a"; } } }
/// ```
#[macro_export]
macro_rules! events {
    (
        $(#[$meta:meta])*
        $vis:vis struct $set:ident in $namespace:literal $(, component $component:literal)? {
            $(enums {
                $($(#[doc = $enum_doc:literal])* $enum:ident: $($repr:ident)+ { $($entries:tt)* })*
            })?
            $(
                modes $modes:ident {
                    $($(#[doc = $mode_doc:literal])* $mode:ident = [$($number:expr),* $(,)?]),+ $(,)?
                }
                components $parts:ident {
                    $($(#[doc = $part_doc:literal])* $part:ident),+ $(,)?
                }
                arming_checks {
                    $($(#[doc = $arming_doc:literal])* $arming:ident($($arming_level:ident),+)
                        $({ $($arming_args:tt)* })? = $arming_text:literal;)*
                }
                $(health_checks {
                    $($(#[doc = $health_doc:literal])* $health:ident($($health_level:ident),+)
                        $({ $($health_args:tt)* })? = $health_text:literal;)*
                })?
            )?
            $(events {
                $($(#[doc = $doc:literal])* $event:ident($($level:ident),+) $({ $($args:tt)* })? = $text:literal;)*
            })?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug)]
        $vis struct $set;

        $($($crate::__event_enum! {
            $(#[doc = $enum_doc])* $vis $enum: $($repr)+ { $($entries)* }
        })*)?

        $(
            $crate::__check_bits! {
                "Groups of flight modes." $vis $modes
                $($(#[doc = $mode_doc])* $mode),+
            }
            $crate::__check_bits! {
                "What can fail." $vis $parts
                /// None
                NONE
                $(, $(#[doc = $part_doc])* $part)+
            }

            impl $crate::events::CheckSet for $set {
                type Modes = $modes;
                type Components = $parts;
                const ALL_MODES: u32 = $(($modes::$mode).0)|+;
                const ARMING_SUMMARY: $crate::events::EventInfo = $crate::__private::summary::<Self>(true);
                const HEALTH_SUMMARY: $crate::events::EventInfo = $crate::__private::summary::<Self>(false);
            }

            $($crate::__event! {
                check ArmingCheck, $vis $set $(#[doc = $arming_doc])* $arming($($arming_level),+)
                { $($($arming_args)*)? } = $arming_text
            })*
            $($($crate::__event! {
                check Health, $vis $set $(#[doc = $health_doc])* $health($($health_level),+)
                { $($($health_args)*)? } = $health_text
            })*)?
        )?

        $($($crate::__event! {
            event Default, $vis $set $(#[doc = $doc])* $event($($level),+) { $($($args)*)? } = $text
        })*)?

        impl $crate::events::EventSet for $set {
            const NAMESPACE: &'static str = $namespace;
            const COMPONENT: u8 = [$($component,)? 1_u8][0];
            const ENUMS: &'static [$crate::events::EnumInfo] =
                &[$($($enum::__INFO,)*)? $($modes::__INFO, $parts::__INFO,)?];
            const EVENTS: &'static [$crate::events::EventInfo] = &[
                $($(<$event as $crate::events::DeclaredEvent>::INFO,)*)?
                $(
                    <Self as $crate::events::CheckSet>::ARMING_SUMMARY,
                    $(<$arming as $crate::events::DeclaredEvent>::INFO,)*
                    $($(<$health as $crate::events::DeclaredEvent>::INFO,)*)?
                    <Self as $crate::events::CheckSet>::HEALTH_SUMMARY,
                )?
            ];
            const MODE_GROUPS: &'static [&'static [u32]] = &[$($(&[$($number),*]),+)?];
        }

        // Checked at the declaration, not at the first use.
        const _: () = $crate::__private::check_events(
            <$set as $crate::events::EventSet>::EVENTS,
            <$set as $crate::events::EventSet>::ENUMS,
        );
    };
}

/// An enumeration or a bitmask of `events!`.
#[doc(hidden)]
#[macro_export]
macro_rules! __event_enum {
    ($(#[doc = $doc:literal])* $vis:vis $name:ident: bitmask $repr:ident { $($entries:tt)* }) => {
        $crate::__event_enum! { @one wire_bitmask true [$($doc)*] $vis $name: $repr { $($entries)* } }
    };
    ($(#[doc = $doc:literal])* $vis:vis $name:ident: $repr:ident { $($entries:tt)* }) => {
        $crate::__event_enum! { @one wire_enum false [$($doc)*] $vis $name: $repr { $($entries)* } }
    };
    (@one $macro:ident $is_bitmask:literal [$($doc:literal)*] $vis:vis $name:ident: $repr:ident {
        $($(#[doc = $entry_doc:literal])* $entry:ident = $value:literal),* $(,)?
    }) => {
        $crate::$macro! {
            $(#[doc = $doc])*
            $vis struct $name: $repr { $($(#[doc = $entry_doc])* $entry = $value),* }
        }

        impl $crate::events::EventArgument for $name {
            const ENUM: Option<&'static str> = Some(stringify!($name));
        }

        impl $name {
            #[doc(hidden)]
            pub const __INFO: $crate::events::EnumInfo = $crate::events::EnumInfo::new::<Self>(
                concat!($($doc),*),
                $is_bitmask,
                &[$($crate::events::EntryInfo::new(stringify!($entry), concat!($($entry_doc),*), $value)),*],
            );
        }
    };
}

/// The groups of modes or the components of `events!`: a bit for each.
#[doc(hidden)]
#[macro_export]
macro_rules! __check_bits {
    ($doc:literal $vis:vis $name:ident $($(#[doc = $entry_doc:literal])* $entry:ident),+) => {
        $crate::wire_bitmask! {
            #[doc = $doc]
            $vis struct $name: u32 {}
        }

        #[allow(dead_code, reason = "some entries are only for the ground")]
        impl $name {
            $(
                $(#[doc = $entry_doc])*
                pub const $entry: Self = Self($crate::__private::bit(Self::__NAMES, stringify!($entry)));
            )+

            const __NAMES: &[&str] = &[$(stringify!($entry)),+];

            #[doc(hidden)]
            pub const __INFO: $crate::events::EnumInfo = $crate::events::EnumInfo::new::<Self>(
                $doc,
                true,
                &[$($crate::events::EntryInfo::bit(
                    stringify!($entry),
                    concat!($($entry_doc),*),
                    Self::$entry.0,
                )),+],
            );
        }

        impl $crate::events::EventArgument for $name {
            const ENUM: Option<&'static str> = Some(stringify!($name));
        }

        impl $crate::events::CheckBits for $name {
            fn bits(self) -> u32 {
                self.0
            }
        }
    };
}

/// An event or a check of `events!`: its type.
#[doc(hidden)]
#[macro_export]
macro_rules! __event {
    (
        $kind:ident $group:ident, $vis:vis $set:ident $(#[doc = $doc:literal])* $event:ident($($level:ident),+)
        { $($(#[doc = $arg_doc:literal])* $arg:ident: $ty:ty),* $(,)? } = $text:literal
    ) => {
        $crate::__event! { @struct [$(#[doc = $doc])*] $text, $vis $event $($(#[doc = $arg_doc])* $arg: $ty),* }

        impl $crate::events::DeclaredEvent for $event {
            const INFO: $crate::events::EventInfo = $crate::events::EventInfo::new(
                <$set as $crate::events::EventSet>::COMPONENT,
                stringify!($event),
                $crate::events::EventGroup::$group,
                $crate::__event!(@levels $($level),+),
            )
            .with(
                $text,
                concat!($($doc),*),
                $crate::__event!(@arguments $kind $set $($(#[doc = $arg_doc])* $arg: $ty),*),
            );

            fn write(&self, out: &mut $crate::__private::FieldWriter<'_>) {
                $(out.push(self.$arg);)*
                let _ = out;
            }
        }

        $crate::__event! { @trait $kind $set $event }
    };

    (@struct [$($doc:tt)*] $text:literal, $vis:vis $event:ident) => {
        #[doc = concat!("An event: \u{201C}", $text, "\u{201D}.")]
        #[doc = ""]
        $($doc)*
        #[allow(dead_code, reason = "events may be declared before they are sent")]
        #[derive(Clone, Copy, Debug, PartialEq)]
        $vis struct $event;
    };
    (@struct [$($doc:tt)*] $text:literal, $vis:vis $event:ident $($(#[doc = $arg_doc:literal])* $arg:ident: $ty:ty),+) => {
        #[doc = concat!("An event: \u{201C}", $text, "\u{201D}.")]
        #[doc = ""]
        $($doc)*
        #[allow(dead_code, reason = "events may be declared before they are sent")]
        #[derive(Clone, Copy, Debug, PartialEq)]
        $vis struct $event {
            $(
                $(#[doc = $arg_doc])*
                #[allow(missing_docs, reason = "the message shows its value")]
                pub $arg: $ty,
            )+
        }
    };

    (@levels $level:ident) => { [$crate::events::LogLevel::$level; 2] };
    (@levels $external:ident, $internal:ident) => {
        [$crate::events::LogLevel::$external, $crate::events::LogLevel::$internal]
    };

    (@arguments event $set:ident $($(#[doc = $arg_doc:literal])* $arg:ident: $ty:ty),*) => {
        &[$($crate::events::ArgumentInfo::new::<$ty>(stringify!($arg), concat!($($arg_doc),*))),*]
    };
    (@arguments check $set:ident $($(#[doc = $arg_doc:literal])* $arg:ident: $ty:ty),*) => {
        &[
            $crate::events::ArgumentInfo::new::<<$set as $crate::events::CheckSet>::Modes>("modes", ""),
            $crate::events::ArgumentInfo::new::<u8>("health_component_index", ""),
            $($crate::events::ArgumentInfo::new::<$ty>(stringify!($arg), concat!($($arg_doc),*))),*
        ]
    };

    (@trait event $set:ident $event:ident) => {
        impl $crate::events::Event for $event {}
    };
    (@trait check $set:ident $event:ident) => {
        impl $crate::events::Check for $event {
            type Set = $set;
        }
    };
}
