//! Visits every message of the dialect. The generated list is compiled a second time here, with this file's macros instead of
//! the crate's, so no new message is forgotten.

#![allow(unused_imports, reason = "what the generated text imports")]
#![allow(dead_code, reason = "each test uses its own part")]

use mavstack::Message;
use std::fmt::Debug;

/// What a test does with each message.
pub trait Visit {
    fn visit<M: Message + Declared + Debug + Default + PartialEq>(&mut self);
}

/// Constants that the macros compute from a declaration, for comparison with the generated ones.
pub trait Declared {
    fn crc_extra() -> u8;

    /// The constant `UNKNOWN`.
    fn unknown() -> Self;
}

macro_rules! declared {
    (
        $(#[$_meta:meta])*
        pub struct $name:ident: $wire:ident = $id:literal, crc_extra = $crc_extra:literal {
            $( $(#[$_field_meta:meta])* $field:ident: $ty:ty $(= $_unknown:expr)?, )+
        }
        $($_extensions:tt)*
    ) => {
        const _: () = {
            use mavstack::dialect::*;

            impl crate::all::Declared for $name {
                fn crc_extra() -> u8 {
                    use mavstack::message::FieldInfo;
                    FieldInfo::crc_extra(stringify!($wire), &[ $( FieldInfo::of::<$ty>(stringify!($field)), )+ ])
                }

                fn unknown() -> Self {
                    Self::UNKNOWN
                }
            }
        };
    };
}

macro_rules! each {
    ($(#[$_:meta])* pub struct $name:ident: [ $($message:ident,)* ];) => {
        pub fn each(visitor: &mut impl crate::all::Visit) {
            $( visitor.visit::<mavstack::dialect::$message>(); )*
        }
    };
}

macro_rules! nothing {
    ($($_:tt)*) => {};
}

pub(crate) use {
    declared as message, each as dialect, nothing as command, nothing as wire_bitmask, nothing as wire_enum,
};

#[path = "../../src/dialect/common.rs"]
mod common;

pub use common::each;
