//! From MAVLink's XML to Rust declarations for [mavstack](https://docs.rs/mavstack).
//!
//! [`load`] reads a definition with its includes and checks it; [`generate`] writes it down as `wire_enum!`,
//! `wire_bitmask!`, `command!`, `message!` and `dialect!` of `mavstack`, one line a field; [`write()`] replaces a file by
//! the text. The command line tool of the same name does these three, and [`Build`] does them in a build script. The model
//! ([`Dialect`]) keeps every fact of the XML, for whoever wants other tables from it.
//!
//! ```no_run
//! use mavstack_dialect::{Options, generate, load, write};
//!
//! let input = "definitions/common.xml".as_ref();
//! let text = generate(&load(input, &[])?, &Options::for_file(input))?;
//! write("src/dialect.rs".as_ref(), &text)?;
//! # Ok::<(), mavstack_dialect::Error>(())
//! ```
//!
//! Names: types are MAVLink's names in Rust's style (`HIGH_LATENCY2` → `HighLatency2`); where two would be the same, or
//! one is taken by the language, a message gets `Message` behind it and an enumeration `Enum`. Constants lose what all
//! names of their enumeration begin with (`MAV_CMD_NAV_WAYPOINT` → `NAV_WAYPOINT`); one that would begin with a digit
//! gets `_` in front. Fields keep their names.
//!
//! An enumeration has the integer type that most of its fields have, and such fields have its type; other fields remain
//! integers, and their documentation names the enumeration.
//!
//! A field with the attribute `invalid` gets that value after its type: it is the field's value in the message's constant
//! `UNKNOWN`.
//!
//! Rules for commands follow the enumerations, one constant a command: what its parameters may be. Behind them stands a type
//! for each command that has parameters, whose fields have the names of their labels.

mod beside;
mod build;
mod builtin;
mod commands;
mod doc;
mod emit;
mod error;
mod load;
pub mod model;
mod names;
mod output;
mod parse;
mod rules;
mod unknown;

pub use build::Build;
pub use emit::{Options, generate};
pub use error::Error;
pub use load::load;
pub use model::{Dialect, Origin};
pub use output::{is_current, write};
