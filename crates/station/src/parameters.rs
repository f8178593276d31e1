//! Parameters: the whole list, single reads, and sets with the confirmation that each client waits for.
//!
//! | | QGroundControl | MAVSDK | MAVProxy | pymavlink |
//! |---|---|---|---|---|
//! | list: asks again without an answer | 5 s, 5 tries, all components | 2 s, 6 tries | 2 s | once |
//! | list: gaps | 3 s of silence, then 11 at a time, 5 times each | 2 s, then 10 at a time | 1 s, 10 at a time | as DroneKit: 51 every 5 s |
//! | read by name | 1 s, 3 tries | 0.5 s, 6 tries | once | once |
//! | set | 1 s, 3 tries | 0.5 s, 6 tries; at once after another value | 1 s, 3 tries | 1 s, 3 tries |
//! | confirmed by | the value | type and value | the value | any value |
//! | PARAM_ERROR | ends it | ends it | ignored | ignored |
//! | integers of an autopilot that is not ArduPilot | bytewise | bytewise | bytewise from PX4 only | as MAVProxy |
//!
//! So MAVProxy shows an integer parameter of a generic vehicle wrongly, and never sees a set of it confirmed: `REAL32` is safe.

mod file;
mod list;
mod packed;
mod read;
mod set;
mod value;

pub use file::FileList;
pub use list::List;
pub use packed::{PackedError, decode_packed};
pub use read::Read;
pub use set::Set;
pub use value::{Encoding, Parameter, Value};

use crate::Io;
use mavstack::dialect::{ParamRequestRead, ParamValue};
use mavstack::message::Text;

/// Returns the name in a message.
fn name_of(text: &Text<16>) -> String {
    String::from_utf8_lossy(text.as_bytes()).into_owned()
}

/// Whether a message comes from the component that was asked.
fn is_from_target(io: &Io<'_>, frame: &crate::Received) -> bool {
    frame.source() == io.target()
}

/// Sends a PARAM_REQUEST_READ by name.
fn request_by_name(io: &mut Io<'_>, name: &str) {
    let target = io.target();
    io.send(&ParamRequestRead {
        param_index: -1,
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        param_id: Text::new(name),
    });
}

/// Returns what the client makes of a PARAM_VALUE.
fn parameter_of(io: &Io<'_>, message: &ParamValue) -> Parameter {
    let encoding = Encoding::of(io);
    let index = (message.param_index != u16::MAX).then_some(message.param_index);
    let value = Value::decode(message.param_value, message.param_type, encoding);
    Parameter { name: name_of(&message.param_id), index, value, param_type: message.param_type }
}
