//! Every message of the dialect, one call each. The list is the generated one: its text is compiled once more, here, with
//! macros in the place of the crate's, so that it cannot be forgotten when a message comes.

#![allow(unused_imports, reason = "what the generated text imports")]

use mavstack::Message;
use std::fmt::Debug;

/// What a test does with every message.
pub trait Visit {
    fn visit<M: Message + Debug + Default + PartialEq>(&mut self);
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

pub(crate) use {each as dialect, nothing as message, nothing as wire_bitmask, nothing as wire_enum};

#[path = "../../src/dialect/common.rs"]
mod common;

pub use common::each;
