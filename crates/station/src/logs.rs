//! Flight logs: [`Listing`], [`Download`] and [`Erasure`].
//!
//! What the clients do differently:
//!
//! | | QGroundControl | MAVSDK | MAVProxy |
//! |---|---|---|---|
//! | an entry that was lost | is requested again, 3 times, after 0.5 s | is missed: the list fails after 5 s | is missed: the list fails after 5 s |
//! | a list that is not answered | has no logs, after 5 s | fails | fails |
//! | data are requested | by 46,080 bytes, the last ones too | by 46,080 bytes, up to the end | all at once, without an end |
//! | without data for | 0.5 s: the first gap is requested | 0.5 s: the first gap is requested | 0.7 s: up to 20 gaps are requested |
//! | behind a gap | the next gap is requested at once | the next gap is requested, by each packet after the chunk's last one | |
//! | the first request is lost | it is sent again | it is sent again | nothing is sent any more |
//! | the log has ended | when its announced size is there | when its announced size is there | at a short packet without gaps, or at an empty one |
//! | at the end | | | LOG_REQUEST_END |
//! | an empty log | is never finished | is refused | is read |
//!
//! None gives up a download; here it fails after 30 s without data. pymavlink has no logs of its own: scripts do as MAVProxy.
//!
//! Sources: QGroundControl's `LogDownloadController.cc` and `LogEntry.h` (5.0), MAVSDK's `log_files_impl.cpp`, MAVProxy's
//! `mavproxy_log.py` (1.8.75).

mod download;
mod list;

pub use download::Download;
pub use list::{Erasure, Listing};

use crate::Io;
use mavstack::dialect::LogRequestEnd;

/// A flight log of the vehicle, as in LOG_ENTRY.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Log {
    /// Its number.
    pub id: u16,
    /// Its size (bytes).
    pub size: u32,
    /// When it was begun (s since 1970, UTC); 0 if unknown.
    pub time_utc: u32,
}

/// Sends LOG_REQUEST_END, which has no answer.
pub fn end(io: &mut Io<'_>) {
    let target = io.target();
    io.send(&LogRequestEnd { target_system: target.system.wire(), target_component: target.component.wire() });
}
