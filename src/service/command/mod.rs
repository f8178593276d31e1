//! The command protocol: each COMMAND_LONG and COMMAND_INT is answered by exactly one COMMAND_ACK.
//!
//! Implements <https://mavlink.io/en/services/command.html>, rules C-1 to C-24. A command is accepted only while its link has a
//! free slot for the answer. Otherwise it is dropped and counted, and not carried out: to its sender it looks like a lost frame,
//! which the sender repeats.
//!
//! [`Commands`] has a diagram of a command's path.

mod acks;
mod duplicates;
mod long;
mod policy;
mod refusal;
mod service;
mod vehicle;

pub(crate) use duplicates::{Duplicates, LATE, SOON, is_well_after};
pub use long::{CommandMemory, CommandSlots, LongCommands, NoSlots};
pub use policy::CommandPolicy;
pub use service::CommandService;
pub(crate) use service::{command_in, is_allowed};
pub use vehicle::Commands;
