//! What `cargo sitl` and `cargo qemu` have in common on the host: the vehicle's status on a terminal, and the log of the
//! frames that passed.

mod line;
mod show;
mod tlog;

pub use line::Line;
pub use show::Console;
pub use tlog::{Frames, Tap, Tlog};
