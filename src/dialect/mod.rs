//! The messages of MAVLink: all of common, standard and minimal, as the generator writes them.
//!
//! Implements <https://mavlink.io/en/messages/common.html>. The declarations are made from the definitions in `dialect/`
//! and checked in; `cargo dialect` makes them anew. Types have MAVLink's names in Rust's style ([`HighLatency2`],
//! [`MavType`]); fields and constants have MAVLink's own ([`MavCmd::NAV_WAYPOINT`]). A field that names an enumeration has
//! its type where the two have the same size on the wire, else it is an integer whose documentation says which
//! enumeration to see. Units stand in brackets before all else that is known of a field.
//!
//! The commands of MAVLink's command and mission protocols, which are numbers with seven parameters on the wire, are types
//! with named fields in [`commands`], and rules for these in [`command_rules`].
//!
//! Each message has a constant `UNKNOWN`: every field has the value that the definitions mark as "not known" (`invalid`), and
//! zero where they mark none. Fill in a message that is known only in part from there; `Default` is zero in every field, and
//! that is often a reading:
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
//! What is not decoded costs nothing: no code here runs unless a caller names the message.

mod common;

pub use common::*;
