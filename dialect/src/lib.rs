//! Generates Rust declarations for [mavstack](https://docs.rs/mavstack) from MAVLink's XML definitions.
//!
//! - [`load`] reads a definition with its includes, and checks it.
//! - [`generate`] generates declarations with `mavstack`'s macros `wire_enum!`, `wire_bitmask!`, `command!`, `message!`
//!   and `dialect!`.
//! - [`write()`] replaces a file by the text.
//! - [`export()`] goes the other way: it makes a definition of what a firmware declares in Rust, for ground stations and mavgen.
//!
//! The command line tool of the same name runs these three, and so does [`Build`] in a build script. The model
//! ([`Dialect`]) has all facts of the XML, for tools that generate something else.
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
//! # Names
//!
//! - Types have MAVLink's names in Rust's style (`HIGH_LATENCY2` → `HighLatency2`). If two names are equal, or one is
//!   reserved in Rust, `Message` is appended to a message and `Enum` to an enumeration.
//! - Constants have the names of their entries without the common prefix (`MAV_CMD_NAV_WAYPOINT` → `NAV_WAYPOINT`). A
//!   name that would begin with a digit gets a leading `_`.
//! - Fields keep their names.
//!
//! # Types
//!
//! - An enumeration has the integer type that most of its fields have. Fields of this type have the enumeration as
//!   type. Other fields are integers, and their documentation links to the enumeration.
//! - The attribute `invalid` of a field gives its value in the message's constant `UNKNOWN`.
//!
//! # Commands
//!
//! The generated module `rules` has a constant for each command, with the rules for its parameters. The module
//! `commands` has a type for each command with parameters; its fields are named by the parameters' labels.

mod beside;
mod build;
mod builtin;
mod commands;
mod doc;
mod emit;
mod error;
#[cfg(feature = "cli")]
mod export;
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
#[cfg(feature = "cli")]
pub use export::export;
pub use load::load;
pub use model::{Dialect, Origin};
pub use output::{is_current, write};
