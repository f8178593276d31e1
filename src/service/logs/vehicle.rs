//! The interface of log downloads to the vehicle: rules LOG-1, LOG-6, LOG-9.

use crate::types::{Context, Peer};

/// The hooks of a vehicle with flight logs, for a vehicle that declares `logs` in [`#[stack]`](macro@crate::Stack).
///
/// Logs are numbered from 0, the oldest first, as in PX4. The numbers may change only while
/// [`may_read_logs`](Self::may_read_logs) returns false, and in [`erase_logs`](Self::erase_logs). Afterwards clients
/// must list the logs again, so no download mixes two logs. A log may grow at any time. With the default, a vehicle may
/// begin a log when it is armed, and evict the oldest one. A vehicle that permits reads in flight must not evict a log
/// in flight.
///
/// ```
/// use mavstack::logs::{LogInfo, LogRead};
/// use mavstack::prelude::*;
/// use mavstack::dialect;
///
/// /// A rover whose logs are in memory.
/// struct Rover { logs: [&'static [u8]; 2] }
///
/// impl Logs for Rover {
///     fn log_count(&self) -> u16 {
///         2
///     }
///
///     fn log_info(&self, id: u16) -> Option<LogInfo> {
///         let log = self.logs.get(usize::from(id))?;
///         Some(LogInfo { size: log.len() as u32, time_utc: 0 })
///     }
///
///     fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead {
///         let log = self.logs.get(usize::from(id)).and_then(|log| log.get(offset as usize..)?.get(..out.len()));
///         let Some(bytes) = log else { return LogRead::Failed };
///         out.copy_from_slice(bytes);
///         LogRead::Done
///     }
/// }
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
/// # }
///
/// #[derive(Stack)]
/// #[stack(vehicle: Rover, links: 1, logs)]
/// struct Mavlink;
/// ```
///
/// # Cost
///
/// No hook may block. [`read_log`](Self::read_log) is called at most once for each sent packet, and up to eight times
/// in each poll while a client asks for the checksum of a log's file. Read a slow medium, such as an SD card, ahead in
/// another task; until that has data, the hook returns [`LogRead::Later`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Logs`",
    note = "`logs` in `#[stack]` needs `impl Logs for {Self}`: write it, or leave `logs` out"
)]
pub trait Logs {
    /// The file extension of the logs in the virtual directory `@MAV_LOG`, if the stack has `files` too: `log_0.ulg`,
    /// `log_1.ulg` and so on. QGroundControl lists `ulg` and `bin`.
    const LOG_EXTENSION: &'static str = "ulg";

    /// Returns the number of logs. They are numbered from 0.
    fn log_count(&self) -> u16;

    /// Returns the size and the time of a log; `None` if there is no such log.
    fn log_info(&self, id: u16) -> Option<LogInfo>;

    /// Reads from a log: fills all of `out`, at most 239 bytes, all inside the log. It should have no other effect: a
    /// client may request the same part again.
    fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead;

    /// Erases all logs, or begins to; from then on [`log_count`](Self::log_count) returns 0. Returns false if this
    /// sender may not erase them, or if the erasure failed. By default no log is erased.
    ///
    /// Not called while the vehicle is armed or another client is downloading, in the 3 s after a log's file was read
    /// (unless its end was read), or for systems that are not in [control](crate::operator_control::OperatorControl).
    fn erase_logs(&mut self, cx: &mut Context<'_>, from: Peer) -> bool {
        let _ = (cx, from);
        false
    }

    /// Whether logs may be listed and read now. By default not while the vehicle is armed, as in ArduPilot: a download
    /// takes a third of a telemetry link, and time of the log's medium. PX4 permits it. The stack calls this hook in
    /// each poll; when it becomes false, running downloads end, and reads of open log files fail.
    fn may_read_logs(&self, is_armed: bool) -> bool {
        !is_armed
    }
}

/// A log, as LOG_ENTRY reports it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LogInfo {
    /// Its size (bytes).
    pub size: u32,
    /// The time of its start (s since 1970, UTC); 0 if unknown. It must not change: a file with another time is another
    /// log.
    pub time_utc: u32,
}

/// The result of [`Logs::read_log`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LogRead {
    /// All bytes were read.
    Done,
    /// There is no data yet. The stack retries while the client is heard: any of its frames during a download by
    /// messages, its requests while it reads the log's file.
    Later,
    /// The log cannot be read. The download ends without an answer, and the client may request the same part again.
    Failed,
}
