//! Plan files: reads and writes the text format "QGC WPL" of QGroundControl, Mission Planner and MAVProxy.
//!
//! Implements <https://mavlink.io/en/file_formats/> (plain-text file format), rules W-1 to W-8. A [`Reader`] takes a
//! file in blocks of any length, for example from an SD card. A [`Writer`] returns one line at a time. Both hold a
//! single line in memory.
//!
//! Neither uses `core::fmt` or floating-point arithmetic. Coordinates are exact to 1e-7 degrees. Parameters are read as
//! the nearest `f32`, and written as the shortest text that reads back as the same `f32`. NaN is kept.
//!
//! ```
//! use mavstack::wpl::{HomeRow, Reader, Writer};
//!
//! let file = b"QGC WPL 110\r\n\
//!     0\t1\t0\t16\t0\t0\t0\t0\t47.3977420\t8.5455940\t488.1\t1\r\n\
//!     1\t0\t3\t22\t0\t0\t0\tnan\t47.3977420\t8.5455940\t10\t1\r\n\
//!     2\t0\t2\t177\t1\t-1\t0\t0\t0\t0\t0\t1\r\n";
//!
//! let mut plan = heapless::Vec::<_, 100>::new();
//! let mut reader = Reader::new(HomeRow::First);
//! for mut block in file.chunks(64) {
//!     while let Some(item) = reader.next(&mut block)? {
//!         plan.push(item).expect("room");
//!     }
//! }
//! if let Some(item) = reader.finish()? {
//!     plan.push(item).expect("room");
//! }
//! let home = reader.home().expect("a home row");
//! assert_eq!((home.x, home.y), (473_977_420, 85_455_940));
//! assert!(plan[0].params[3].is_nan());
//! assert_eq!(plan[1].params[0], 0.0, "home is not counted, so the jump's target is item 0");
//!
//! let mut text = Vec::from(Writer::HEADER);
//! let mut writer = Writer::new(HomeRow::First);
//! text.extend(writer.row(&home)?);
//! for item in &plan {
//!     text.extend(writer.row(item)?);
//! }
//! assert_eq!(text, file.iter().copied().filter(|&byte| byte != b'\r').collect::<Vec<_>>());
//! # Ok::<(), Box<dyn core::error::Error>>(())
//! ```
//!
//! # The format
//!
//! A file is a header, `QGC WPL 110` or `QGC WPL 120`, followed by rows of twelve columns: index, current, frame,
//! command, param1 to param4, x, y, z, autocontinue. A row becomes an [`Item`]. The reader checks `current` but does
//! not keep it. The file does not say whether it is a mission, a geofence or rally points: the caller must know.
//!
//! The reader accepts:
//!
//! - Any white space between columns; lines that end in LF or CRLF, and a last line without an end; blank lines; lines
//!   that begin with `#`; a byte order mark (W-5).
//! - Numbers with a sign and an exponent, and `nan`. In param1 to param4 and z also `inf`, which the vehicle's
//!   validation then refuses.
//! - x and y in degrees in global frames, rounded to 1e-7; in metres in local frames, rounded to 1e-4 (M-4); as whole
//!   numbers in [`MavFrame::MISSION`], and in every frame if the command has no position (M-75). `nan` means "not given", which
//!   is `i32::MAX` in an item (M-70).
//!
//! The reader refuses the following, with the number of the line:
//!
//! - Versions other than 110 and 120: for example 100, and the protobuf format `PB 110`.
//! - Fence files with latitude and longitude only, and rally files of `RALLY` lines.
//! - Numbers that do not fit in the item, or have more than 64 characters.
//! - Numbers of 1,000,000 and more in x or y of a command without a position, outside [`MavFrame::MISSION`]: whoever wrote
//!   them scaled them like degrees (M-75).
//! - Frames for which the meaning of x and y is not known.
//! - A [`DO_JUMP`](MavCmd::DO_JUMP) to home, or to a row that does not exist.
//!
//! The reader does not check whether the vehicle can fly the plan. The checks of an upload do.
//!
//! The writer writes version 110, which all three programs read (W-3). NaN is written without sign and payload, and a
//! jump's target of -0 as 0. All other values are read back bit by bit.

mod decimal;
mod line;
mod reader;
mod wide;
mod writer;

pub use reader::{Error, Fault, Reader};
pub use writer::Writer;

use crate::dialect::{MavCmd, MavFrame};
use crate::message::{Item, has_position, is_scaled};
use crate::num;

/// Whether row 0 of a version 110 file is the home position (W-6). The file itself does not say.
///
/// The targets of DO_JUMP are rows. If row 0 is home, item 0 of the plan is row 1, so the target of each jump is one
/// less in the plan than in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HomeRow {
    /// Row 0 is the planned home: missions saved by QGroundControl and Mission Planner.
    First,
    /// There is no home, and row 0 is item 0: geofences, rally points, and missions that MAVProxy saves from a vehicle
    /// without home in its mission. Files of version 120 never have a home row.
    None,
}

/// Returns the number of decimals of an item's x and y; `None` if their meaning is not known in its frame (M-4). Only a
/// position is scaled (M-75). The row of `home` always has one.
fn decimals(item: &Item, is_home: bool) -> Option<u8> {
    let decimals = scale(item.frame)?;
    Some(if is_home || has_position(item.command) { decimals } else { 0 })
}

/// Whether x or y was scaled although it is a plain number (M-75).
fn is_wrongly_scaled(item: &Item, number: i32, decimals: u8) -> bool {
    decimals == 0 && is_scaled(number, item.frame)
}

/// Returns the number of decimals of a position in this frame; `None` if the meaning of x and y is not known (M-4).
fn scale(frame: MavFrame) -> Option<u8> {
    match frame {
        MavFrame::GLOBAL
        | MavFrame::GLOBAL_INT
        | MavFrame::GLOBAL_RELATIVE_ALT
        | MavFrame::GLOBAL_RELATIVE_ALT_INT
        | MavFrame::GLOBAL_TERRAIN_ALT
        | MavFrame::GLOBAL_TERRAIN_ALT_INT => Some(7),
        MavFrame::LOCAL_NED
        | MavFrame::LOCAL_ENU
        | MavFrame::LOCAL_OFFSET_NED
        | MavFrame::BODY_NED
        | MavFrame::BODY_OFFSET_NED
        | MavFrame::BODY_FRD
        | MavFrame::LOCAL_FRD
        | MavFrame::LOCAL_FLU => Some(4),
        MavFrame::MISSION => Some(0),
        _ => None,
    }
}

/// Returns the target of a [`DO_JUMP`](MavCmd::DO_JUMP); `None` for other commands.
fn jump_target(item: &Item) -> Option<Result<u16, Fault>> {
    let [target, ..] = item.params;
    (item.command == MavCmd::DO_JUMP).then(|| num::integer(target).ok_or(Fault::Jump))
}
