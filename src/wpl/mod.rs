//! Plans as text: the file format "QGC WPL" of QGroundControl, Mission Planner and MAVProxy.
//!
//! Implements <https://mavlink.io/en/file_formats/> (plain-text file format), rules W-1 to W-8: a [`Reader`] that takes
//! a file in pieces of any length, as they come from an SD card, and a [`Writer`] that gives one line after the other.
//! Both need no more memory than a line's worth, and neither `core::fmt` nor floating-point arithmetic: coordinates are
//! read and written exactly to 1e-7 degrees, parameters as the nearest `f32` and the shortest text that gives it back.
//! NaN stays NaN.
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
//! let home = reader.home().expect("a row for it");
//! assert_eq!((home.x, home.y), (473_977_420, 85_455_940));
//! assert!(plan[0].params[3].is_nan());
//! assert_eq!(plan[1].params[0], 0.0, "counted without home, the jump goes to item 0");
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
//! A header, `QGC WPL 110` or `QGC WPL 120`, then twelve columns a row: index, current, frame, command, param1 to
//! param4, x, y, z, autocontinue. What the columns say goes into the [`Item`]; the reader checks `current` and forgets
//! it. The file does not tell a mission from a geofence or rally points: that is the caller's to know.
//!
//! What is read: any white space between columns, lines that end in LF or CRLF, the last also without; blank lines,
//! lines that begin with `#`, and a byte order mark in front (W-5). Numbers may have a sign and an exponent, or be
//! `nan` or, in param1 to param4 and z, `inf` (which the vehicle's validation then refuses). x and y are degrees in
//! global frames, rounded to 1e-7; metres in local frames, rounded to 1e-4 (M-4); whole numbers in
//! [`MavFrame::MISSION`]. In each, `nan` is "not given", `i32::MAX` (M-70).
//!
//! What is refused, with the line's number: versions other than 110 and 120, so 100 and the protobuf form `PB 110`;
//! fence files of latitude and longitude alone, rally files of `RALLY` lines; numbers that the item cannot hold, or of
//! more than 64 characters; frames whose x and y mean nothing known; a [`DO_JUMP`](MavCmd::DO_JUMP) to home or to a row
//! that is not there. What a vehicle can fly is not looked at: that is for the checks that an upload goes through as
//! well.
//!
//! What is written: version 110, as all of these programs read it (W-3). NaN is written without sign and payload, a jump's
//! target of -0 as 0; all other values come back to the bit.

mod decimal;
mod line;
mod reader;
mod wide;
mod writer;

pub use reader::{Error, Fault, Reader};
pub use writer::Writer;

use crate::dialect::{MavCmd, MavFrame};
use crate::num;
use crate::service::mission::Item;

/// Whether row 0 of a version 110 file is the home position (W-6). The file does not say.
///
/// DO_JUMP counts rows. Where row 0 is home, it is no item of the vehicle's plan: item 0 is row 1, and the target of
/// each jump is one less in the plan than in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum HomeRow {
    /// Row 0 is the planned home: missions of QGroundControl and Mission Planner.
    First,
    /// There is none, row 0 is item 0: geofences, rally points, and what MAVProxy saves of a vehicle that does not keep
    /// its home in the mission. Files of version 120 are so by definition.
    None,
}

/// How many decimals x and y have in this frame; nothing when it is not known what they are (M-4).
fn decimals(frame: MavFrame) -> Option<u8> {
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

/// The row that a [`DO_JUMP`](MavCmd::DO_JUMP) goes to; nothing for other commands.
fn jump_target(item: &Item) -> Option<Result<u16, Fault>> {
    let [target, ..] = item.params;
    (item.command == MavCmd::DO_JUMP).then(|| num::integer(target).ok_or(Fault::Jump))
}
