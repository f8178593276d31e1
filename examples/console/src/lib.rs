//! Host code shared by `cargo sitl` and `cargo qemu`: the vehicle's status on a terminal, and a log of the frames.

mod line;
mod show;
mod tlog;

pub use line::Line;
pub use show::Console;
pub use tlog::{Frames, Tap, Tlog};
