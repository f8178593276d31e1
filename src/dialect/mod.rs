//! The messages, enumerations and commands of MAVLink's common, standard and minimal.
//!
//! Implements <https://mavlink.io/en/messages/common.html>. `cargo dialect` generates the declarations from the
//! definitions in `dialect/`.
//!
//! - **Names:** types have MAVLink's names in Rust's style ([`HighLatency2`], [`MavType`]). Fields and constants have
//!   MAVLink's names ([`MavCmd::NAV_WAYPOINT`]).
//! - **Enumerations:** a field with an enumeration has its type if both have the same size on the wire. Otherwise the
//!   field is an integer, and its documentation links to the enumeration.
//! - **Units** are in brackets in the documentation of a field.
//! - **Commands** have ids and seven parameters on the wire. [`commands`] has types with named fields for them, and
//!   [`rules`] the rules for their parameters.
//!
//! Each message has a constant `UNKNOWN`: all fields have the value for "not known" from the definitions (`invalid`),
//! or zero if there is none. Start from it to fill in a message partly. `Default` is zero in all fields, which often is
//! a valid reading:
//!
//! ```
//! use mavstack::dialect::BatteryStatus;
//!
//! let mut voltages = BatteryStatus::UNKNOWN.voltages;
//! voltages[..3].copy_from_slice(&[3_850, 3_840, 3_860]);
//! let battery = BatteryStatus { voltages, ..BatteryStatus::UNKNOWN };
//! assert_eq!((battery.battery_remaining, BatteryStatus::default().battery_remaining), (-1, 0));
//! ```
//!
//! A message that is never decoded takes no flash, except for its row in the message table.

mod common;

pub use common::*;
