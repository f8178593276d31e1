//! `message!`, `wire_enum!`, `wire_bitmask!` and `dialect!`: macros that generate messages, their encoders and decoders
//! and their table from declarations. The checked-in dialect uses them, and so do a firmware's private messages.

/// Declares a MAVLink message: a plain struct, its encoder and decoder, its lengths and its `CRC_EXTRA`.
///
/// - **Base fields** are listed in *wire order*: sorted by element size (8, 4, 2, 1 bytes), and fields of the same size
///   in the order of the definition. Fields that are not sorted by size do not compile (S-4).
/// - **Extension fields** follow in an `extensions` block, in the order of the definition.
/// - **The name after the colon** is MAVLink's name of the message. It is a part of `CRC_EXTRA`, like the names and
///   types of the base fields (S-3). A field whose name is a Rust keyword is written raw (`r#type`).
/// - **Field types** implement [`Field`](crate::message::Field): integers, floats, arrays of them, [`Text<N>`](crate::Text) for
///   `char[N]`, and types declared by [`wire_enum!`](crate::wire_enum) and [`wire_bitmask!`](crate::wire_bitmask).
/// - **`= value` after a type** is the value that means "not known". The constant `UNKNOWN` has this value in that
///   field, and zero in fields without one. `Default` is zero in all fields. Start from `UNKNOWN` to fill in a part of
///   a message.
/// - **`, crc_extra = n` after the id** is the digest computed by the generator, which saves time in the compiler. It
///   is not verified: leave it out of handwritten declarations.
///
/// ```
/// mavstack::message! {
///     /// The state of our winch.
///     pub struct WinchReport: WINCH_REPORT = 53_001 {
///         /// Length of the line that is paid out (mm).
///         line_out: u32,
///         /// Tension (N).
///         tension: i16 = i16::MAX,
///         r#type: u8,
///     } extensions {
///         /// Temperature of the motor (°C).
///         temperature: i8,
///     }
/// }
/// use mavstack::Message;
///
/// assert_eq!((WinchReport::ID, WinchReport::BASE_LEN, WinchReport::MAX_LEN), (53_001, 7, 8));
/// let report = WinchReport { line_out: 1_500, ..WinchReport::UNKNOWN };
/// assert_eq!((report.tension, report.temperature), (i16::MAX, 0));
/// let mut payload = [0; 8];
/// assert_eq!(report.encode(&mut payload), Some(8));
/// assert_eq!(WinchReport::decode(&payload), report);
/// ```
///
/// `mavstack-dialect --export` makes MAVLink's XML of the declarations in a file, for ground stations and mavgen.
///
/// A wrong order of fields is a compile error:
///
/// ```compile_fail
/// mavstack::message! {
///     pub struct Wrong: WRONG = 53_002 {
///         small: u8,
///         large: u32,
///     }
/// }
/// ```
#[macro_export]
macro_rules! message {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident: $wire:ident = $id:literal $(, crc_extra = $crc_extra:literal)? {
            $( $(#[$field_meta:meta])* $field:ident: $ty:ty $(= $unknown:expr)? ),+ $(,)?
        }
        $( extensions {
            $( $(#[$ext_meta:meta])* $ext:ident: $ext_ty:ty $(= $ext_unknown:expr)? ),+ $(,)?
        } )?
    ) => {
        $(#[$meta])*
        #[allow(missing_docs, non_snake_case, reason = "a field's name is its definition's; MAVLink documents it")]
        #[derive(Clone, Copy, Debug, PartialEq)]
        $vis struct $name {
            $( $(#[$field_meta])* pub $field: $ty, )+
            $($( $(#[$ext_meta])* pub $ext: $ext_ty, )+)?
        }

        #[allow(non_snake_case, reason = "a field's name is its definition's")]
        const _: () = {
            const BASE: &[$crate::message::FieldInfo] = &[ $( $crate::message::FieldInfo::of::<$ty>(stringify!($field)), )+ ];
            const EXTENSIONS: &[$crate::message::FieldInfo] = &[
                $($( $crate::message::FieldInfo::of::<$ext_ty>(stringify!($ext)), )+)?
            ];

            impl $crate::Message for $name {
                const ID: u32 = $id;
                const NAME: &'static str = stringify!($wire);
                const CRC_EXTRA: u8 = $crate::__crc_extra!($wire $($crc_extra)?);
                #[allow(clippy::arithmetic_side_effects, reason = "const-evaluated: an overflow is a compile error")]
                const BASE_LEN: usize = $crate::message::FieldInfo::total(BASE);
                const MAX_LEN: usize = Self::BASE_LEN + $crate::message::FieldInfo::total(EXTENSIONS);
                const INFO: $crate::message::MessageInfo = $crate::message::MessageInfo::new::<Self>(BASE, EXTENSIONS);

                #[inline]
                fn decode(payload: &[u8]) -> Self {
                    let bytes: [u8; <Self as $crate::Message>::MAX_LEN] = $crate::message::zero_extended(payload);
                    let mut fields = $crate::message::FieldReader::new(&bytes);
                    Self {
                        $( $field: fields.take(), )+
                        $($( $ext: fields.take(), )+)?
                    }
                }

                #[inline]
                fn encode(&self, payload: &mut [u8]) -> Option<usize> {
                    let bytes = payload.get_mut(..Self::MAX_LEN)?;
                    let mut fields = $crate::message::FieldWriter::new(bytes);
                    $( fields.push(self.$field); )+
                    $($( fields.push(self.$ext); )+)?
                    Some(Self::MAX_LEN)
                }
            }

            // Evaluates the checks where the message is declared, not where it is first used.
            const _: $crate::message::MessageInfo = <$name as $crate::Message>::INFO;

            impl $name {
                /// The message with all bytes zero.
                #[allow(dead_code, reason = "a private message may always be filled in completely")]
                pub const ZERO: Self = Self {
                    $( $field: <$ty as $crate::message::Field>::ZERO, )+
                    $($( $ext: <$ext_ty as $crate::message::Field>::ZERO, )+)?
                };

                /// The message with all fields unknown: each has the value that means "not known", or zero if the
                /// definition has no such value. Fill in the known fields: `Self { …, ..Self::UNKNOWN }`.
                #[allow(dead_code, reason = "a private message may always be filled in completely")]
                #[allow(clippy::needless_update, reason = "all fields may have such a value")]
                pub const UNKNOWN: Self = Self { $( $( $field: $unknown, )? )+ $($( $( $ext: $ext_unknown, )? )+)? ..Self::ZERO };
            }

            impl Default for $name {
                #[inline]
                fn default() -> Self {
                    Self::ZERO
                }
            }

            $crate::__message_format! { $name: $wire { $( $field, )+ $($( $ext, )+)? } }
        };
    };
}

/// A message's digest: computed by the generator, or else at compile time.
#[doc(hidden)]
#[macro_export]
macro_rules! __crc_extra {
    ($wire:ident) => {
        $crate::message::FieldInfo::crc_extra(stringify!($wire), BASE)
    };
    ($wire:ident $crc_extra:literal) => {
        $crc_extra
    };
}

/// `defmt::Format` of a message. A firmware that declares a message needs no dependency on `defmt` for it.
#[cfg(feature = "defmt")]
#[doc(hidden)]
#[macro_export]
macro_rules! __message_format {
    ($name:ident: $wire:ident { $( $field:ident, )+ }) => {
        impl $crate::__defmt::Format for $name {
            fn format(&self, f: $crate::__defmt::Formatter<'_>) {
                $crate::message::__format_name(f, stringify!($wire));
                $( $crate::message::__format_field(f, stringify!($field), &self.$field); )+
            }
        }
    };
}

/// Expands to nothing without the feature `defmt`.
#[cfg(not(feature = "defmt"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __message_format {
    ($($any:tt)*) => {};
}

/// Declares an *open* enumeration: a newtype over an integer with named constants. Values that newer definitions add
/// still decode (S-17).
///
/// ```
/// mavstack::wire_enum! {
///     /// The activity of the winch.
///     pub struct WinchState: u8 {
///         IDLE = 0,
///         LOWERING = 1,
///     }
/// }
/// assert_eq!(WinchState::LOWERING.0, 1);
/// assert_ne!(WinchState(77), WinchState::IDLE);
/// ```
#[macro_export]
macro_rules! wire_enum {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident: $repr:ident {
            $( $(#[$entry_meta:meta])* $entry:ident = $value:literal ),* $(,)?
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[repr(transparent)]
        $vis struct $name(pub $repr);

        // The derive would add a hidden function to each type, which costs compile time.
        impl Eq for $name {}

        #[allow(missing_docs, reason = "an entry's name is its definition's; MAVLink documents it")]
        #[allow(dead_code, reason = "a firmware uses some of it")]
        impl $name {
            $( $(#[$entry_meta])* pub const $entry: Self = Self($value); )*
        }

        $crate::__wire_newtype! { $name: $repr }
    };
}

/// Declares a bitmask: a newtype over an integer with named bits and set operations. Unknown bits are kept (S-17).
///
/// ```
/// mavstack::wire_bitmask! {
///     /// Faults that the winch has detected.
///     pub struct WinchFault: u16 {
///         OVERLOAD = 1,
///         JAMMED = 2,
///     }
/// }
/// let faults = WinchFault::OVERLOAD | WinchFault(0x8000);
/// assert!(faults.contains(WinchFault::OVERLOAD) && !faults.contains(WinchFault::JAMMED));
/// assert_eq!(faults.without(WinchFault::OVERLOAD), WinchFault(0x8000));
/// ```
#[macro_export]
macro_rules! wire_bitmask {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident: $repr:ident {
            $( $(#[$entry_meta:meta])* $entry:ident = $value:literal ),* $(,)?
        }
    ) => {
        $crate::wire_enum! {
            $(#[$meta])*
            $vis struct $name: $repr { $( $(#[$entry_meta])* $entry = $value, )* }
        }

        #[allow(dead_code, reason = "a firmware uses some of it")]
        impl $name {
            /// The value with no bit set.
            pub const EMPTY: Self = Self(0);

            /// Returns whether all bits of `other` are set.
            #[inline]
            pub const fn contains(self, other: Self) -> bool {
                self.0 & other.0 == other.0
            }

            /// Returns whether no bit is set.
            #[inline]
            pub const fn is_empty(self) -> bool {
                self.0 == 0
            }

            /// Returns the union of both: the bits that are set in `self` or `other`.
            #[inline]
            #[must_use]
            pub const fn with(self, other: Self) -> Self {
                Self(self.0 | other.0)
            }

            /// Returns the bits of `self` that are not set in `other`.
            #[inline]
            #[must_use]
            pub const fn without(self, other: Self) -> Self {
                Self(self.0 & !other.0)
            }
        }

        impl core::ops::BitOr for $name {
            type Output = Self;
            #[inline]
            fn bitor(self, other: Self) -> Self {
                self.with(other)
            }
        }

        impl core::ops::BitOrAssign for $name {
            #[inline]
            fn bitor_assign(&mut self, other: Self) {
                *self = self.with(other);
            }
        }
    };
}

/// The common part of enumerations and bitmasks: both are fields, and both are logged as numbers.
#[doc(hidden)]
#[macro_export]
macro_rules! __wire_newtype {
    ($name:ident: $repr:ident) => {
        impl $crate::message::Field for $name {
            const SIZE: usize = <$repr as $crate::message::Field>::SIZE;
            const ELEMENT: usize = <$repr as $crate::message::Field>::ELEMENT;
            const WIRE_TYPE: &'static str = <$repr as $crate::message::Field>::WIRE_TYPE;
            const ZERO: Self = Self(0);

            #[inline(always)]
            fn read(payload: &[u8], at: usize) -> Self {
                Self($crate::message::Field::read(payload, at))
            }

            #[inline(always)]
            fn write(&self, payload: &mut [u8], at: usize) {
                $crate::message::Field::write(&self.0, payload, at);
            }
        }

        $crate::__newtype_format! { $name }
    };
}

/// `defmt::Format` of an enumeration or bitmask, which is logged as a number.
#[cfg(feature = "defmt")]
#[doc(hidden)]
#[macro_export]
macro_rules! __newtype_format {
    ($name:ident) => {
        impl $crate::__defmt::Format for $name {
            fn format(&self, f: $crate::__defmt::Formatter<'_>) {
                $crate::__defmt::Format::format(&self.0, f);
            }
        }
    };
}

/// Expands to nothing without the feature `defmt`.
#[cfg(not(feature = "defmt"))]
#[doc(hidden)]
#[macro_export]
macro_rules! __newtype_format {
    ($name:ident) => {};
}

/// Declares a [`Dialect`](crate::message::Dialect), a set of messages that replaces [`Common`](crate::dialect::Common) as
/// [`Vehicle::MESSAGES`](crate::Vehicle::MESSAGES).
///
/// List only a few messages to save flash, or list your own and add all messages of another dialect after a `+`. The
/// order does not matter. Two messages with the same id do not compile.
///
/// Frames of other messages are *unknown*: their checksums cannot be verified, so the stack never acts on them (S-12).
///
/// ```
/// use mavstack::dialect::{CommandLong, Heartbeat};
/// mavstack::dialect! {
///     /// The messages that a winch receives.
///     pub struct Winch: [CommandLong, Heartbeat];
/// }
/// use mavstack::message::Dialect;
/// assert_eq!(Winch::MESSAGES.get(76).map(|info| info.crc_extra()), Some(152));
///
/// mavstack::message! {
///     /// The state of our winch.
///     pub struct WinchReport: WINCH_REPORT = 53_001 { line_out: u32, }
/// }
/// mavstack::dialect! {
///     /// The winch's own message, and all of common.
///     pub struct WithWinch: [WinchReport] + mavstack::dialect::Common;
/// }
/// assert!(WithWinch::MESSAGES.get(53_001).is_some() && WithWinch::MESSAGES.get(30).is_some());
/// ```
#[macro_export]
macro_rules! dialect {
    ( $(#[$meta:meta])* $vis:vis struct $name:ident: [ $($message:ty),* $(,)? ]; ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug)]
        $vis struct $name;

        impl $crate::message::Dialect for $name {
            const MESSAGES: $crate::message::MessageTable = {
                const ROWS: &[$crate::message::MessageInfo] =
                    &$crate::message::MessageTable::sorted([ $( <$message as $crate::Message>::INFO ),* ]);
                $crate::message::MessageTable::new(ROWS, const { &$crate::message::MessageTable::index(ROWS) })
            };
        }
    };
    ( $(#[$meta:meta])* $vis:vis struct $name:ident: [ $($message:ty),* $(,)? ] + $base:path; ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug)]
        $vis struct $name;

        impl $crate::message::Dialect for $name {
            const MESSAGES: $crate::message::MessageTable = {
                const BASE: &[$crate::message::MessageInfo] = <$base as $crate::message::Dialect>::MESSAGES.rows();
                const OWN: &[$crate::message::MessageInfo] = &[ $( <$message as $crate::Message>::INFO ),* ];
                const ROWS: &[$crate::message::MessageInfo] =
                    &$crate::message::MessageTable::joined::<{ BASE.len() + OWN.len() }>(BASE, OWN);
                $crate::message::MessageTable::new(ROWS, const { &$crate::message::MessageTable::index(ROWS) })
            };
        }
    };
}
