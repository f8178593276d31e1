//! Downloads of flight logs.
//!
//! Implements the vehicle's side of LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END and LOG_ERASE, rules LOG-1 to LOG-9 and LOG-15. The
//! developer guide has no page for them, so they follow PX4 (`mavlink_log_handler.cpp`) and ArduPilot
//! (`AP_Logger_MAVLinkLogTransfer.cpp`) as far as the two agree. They serve QGroundControl (`LogDownloadController.cc`), MAVSDK
//! (`log_files_impl.cpp`), MAVProxy (`mavproxy_log.py`) and Mission Planner.
//!
//! Left out: more than one client at a time. LOG_ERASE has no answer in MAVLink, so a text reports its result.
//!
//! ```text
//!          LOG_REQUEST_LIST, LOG_REQUEST_DATA
//!    ┌───────────────────────────────────────────┐   the same client requests again: the new request replaces the old one
//!    │                                           ▼
//!   free ◀─────── all of it was sent ────────── busy ──▶ LOG_ENTRY, LOG_DATA
//!    ▲                                           │
//!    └───────────────────────────────────────────┘   LOG_REQUEST_END, the vehicle is armed, the client is silent for 10 s
//! ```
//!
//! After a flight or an erasure, a number may belong to another log, but a client repeats its requests throughout a
//! flight. A client therefore gets data only after it has listed the logs again (LOG-16). Only a text can report this:
//! LOG_DATA has no error, and clients take an empty LOG_DATA for a part of the log.

mod directory;
mod vehicle;

pub use vehicle::{LogInfo, LogRead, Logs};

use super::rate_limit::RETRY;
use super::{About, Cx, Handled, Received, Service, Shared, ShowCounters, StackEvent, Turn, View, increment};
use crate::dialect::{LogData, LogEntry, LogErase, LogRequestData, LogRequestEnd, LogRequestList, MavSeverity};
use crate::link::Port;
use crate::message::{Address, Message};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId, Peer};

/// Pending entries and data are dropped when the client was silent for this time. MAVProxy requests a whole log at
/// once, and then only sends heartbeats.
const SILENCE: Duration = Duration::from_secs(10);

/// The number of bytes of a log in a LOG_DATA.
const BLOCK: usize = 90;
/// The number of clients that are remembered to have listed the logs. The one that listed them first is forgotten.
const LISTED: usize = 4;
/// The answer to an erasure while a client reads a log.
const BEING_READ: &[u8] = b"Logs not erased: a client reads one";
/// No frame is from system 0.
const NO_CLIENT: Peer = Peer { address: Address::new(0, 0), link: LinkId(0) };

/// The size of LOG_DATA: offset, id and count come before the bytes.
const LOG_DATA: usize = 7 + BLOCK;

counters! {
    /// Counters of log downloads. They wrap.
    LogCounters {
        /// Requests for data that were accepted.
        count requests,
        /// Requests that were refused because the vehicle was armed.
        drop armed,
        /// Requests that were refused because another client was being served, and erasures while a file was being read.
        drop busy,
        /// Requests for a log that does not exist.
        drop unknown,
        /// Requests that used a number from before a flight or an erasure.
        drop outdated,
        /// Downloads that ended because the vehicle could not read the log.
        drop failed,
        /// Lists and downloads that ended because their client was silent.
        drop timed_out,
    }
}

/// The pending work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Work {
    Nothing,
    /// The entries from `id` to `last`.
    List,
    /// `left` bytes from `offset` on.
    Data,
    /// The answer that the log ends before `offset`.
    End,
}

/// What log downloads send.
#[derive(Clone, Copy, Debug)]
pub enum LogReply {
    /// LOG_ENTRY.
    Entry,
    /// LOG_DATA: bytes of a log, or its end.
    Data,
}

/// The state of log downloads: declared by `logs` in [`#[stack]`](macro@crate::Stack), and read through [`Stack::logs`](crate::Stack::logs).
/// The vehicle's part is [`Logs`].
///
/// It serves one client at a time. Its LOG_ENTRY and LOG_DATA use the capacity that other traffic leaves. Together with
/// files and log streaming they have at least 30 % of the link's rate.
#[derive(Debug)]
pub struct LogServer {
    work: Work,
    /// The client that was served last.
    client: Peer,
    /// The next log to list, or the one to read.
    id: u16,
    /// The last log to list.
    last: u16,
    offset: u32,
    left: u32,
    /// When the client was last heard.
    heard: Instant,
    /// When to read the log again.
    ready_at: Instant,
    /// The clients that have listed the logs since the numbers may have changed; `None` if they did not change since
    /// startup.
    listed: Option<[Peer; LISTED]>,
    /// Whether logs could not be read at the last check, and whether a text has reported this, or a change of the logs.
    is_refusing: bool,
    has_told: bool,
    counters: LogCounters,
}

impl LogServer {
    /// Returns the counters.
    pub const fn counters(&self) -> LogCounters {
        self.counters
    }

    /// Records that the numbers of the logs may have changed (LOG-16).
    fn forget_lists(&mut self, shared: &mut Shared) {
        shared.log_numbers = shared.log_numbers.wrapping_add(1);
        (self.listed, self.has_told) = (Some([NO_CLIENT; LISTED]), false);
    }
}

impl<F: Firmware<Vehicle: Logs>> Service<F> for LogServer {
    type Link = ();
    const VACANT: () = ();
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::LateBulk, Turn::Bulk]);
    type Reply = LogReply;
    const NEW: Self = Self {
        work: Work::Nothing,
        client: NO_CLIENT,
        id: 0,
        last: 0,
        offset: 0,
        left: 0,
        heard: Instant::ZERO,
        ready_at: Instant::ZERO,
        listed: None,
        is_refusing: false,
        has_told: false,
        counters: LogCounters::ZERO,
    };

    /// Drops the pending work: of a silent client (LOG-5), or in flight (LOG-6).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>) {
        if !watch(self, cx) {
            self.work = Work::Nothing;
        }
        if self.work != Work::Nothing && cx.now >= self.heard + SILENCE {
            increment(&mut self.counters.timed_out);
            self.work = Work::Nothing;
        }
    }

    fn deadline(&self) -> Instant {
        if self.work == Work::Nothing { Instant::NEVER } else { self.heard + SILENCE }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        match received.frame.id() {
            LogRequestList::ID | LogRequestData::ID | LogRequestEnd::ID | LogErase::ID => {}
            _ => return Handled::No,
        }
        if received.target.system.is_all() {
            // It would erase the logs of every vehicle in range, or have all of them send.
            return Handled::OutOfPlace;
        }
        handle(self, cx, received);
        Handled::Yes
    }

    #[inline(always)]
    fn pending(&self, _: &View<'_>, port: &Port, (): &(), _: Turn) -> Option<(Instant, LogReply)> {
        let reply = match self.work {
            Work::Nothing => return None,
            Work::List => LogReply::Entry,
            Work::Data | Work::End => LogReply::Data,
        };
        (self.client.link == port.id).then_some((self.ready_at, reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), reply: LogReply) -> bool {
        match reply {
            LogReply::Entry => send_entry(self, cx, port),
            LogReply::Data => send_data(self, cx, port),
        }
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            // The client is gone.
            StackEvent::Opened(port, ()) if self.client.link == port.id => self.work = Work::Nothing,
            StackEvent::Heard { now, from } if from == self.client => self.heard = now,
            _ => {}
        }
    }
}

/// Whether logs may be read now.
fn may_read<F: Firmware<Vehicle: Logs>>(cx: &Cx<'_, F>) -> bool {
    cx.vehicle.may_read_logs(cx.shared.flight.state.is_armed())
}

/// Returns whether logs may be read now. Their numbers may change when this becomes false: a vehicle begins a log then.
fn watch<F: Firmware<Vehicle: Logs>>(server: &mut LogServer, cx: &mut Cx<'_, F>) -> bool {
    let is_refusing = !may_read(cx);
    if is_refusing != server.is_refusing {
        (server.is_refusing, server.has_told) = (is_refusing, false);
        if is_refusing {
            server.forget_lists(cx.shared);
        }
    }
    !is_refusing
}

/// Handles a request.
fn handle<F: Firmware<Vehicle: Logs>>(server: &mut LogServer, cx: &mut Cx<'_, F>, received: &Received<'_>) {
    let (frame, from) = (received.frame, received.from);
    if frame.id() == LogRequestEnd::ID {
        // MAVSDK sends it when it connects. It ends nothing of another client (LOG-5).
        if from == server.client {
            server.work = Work::Nothing;
        }
        return;
    }
    let is_erase = frame.id() == LogErase::ID;
    let may_read = watch(server, cx);
    let is_outdated = frame.id() == LogRequestData::ID && server.listed.is_some_and(|listed| !listed.contains(&from));
    let refusal = if if is_erase { cx.shared.flight.state.is_armed() } else { !may_read } {
        increment(&mut server.counters.armed);
        if is_erase { b"Logs not erased: disarm first".as_slice() } else { b"Logs refused: disarm first" }
    } else if is_outdated {
        increment(&mut server.counters.outdated);
        b"Logs refused: list them again first".as_slice()
    } else {
        b""
    };
    if !refusal.is_empty() {
        // A client may repeat its request through the whole flight, and one text is enough. An erasure has no other answer.
        if is_erase || !core::mem::replace(&mut server.has_told, true) {
            cx.text(MavSeverity::NOTICE, refusal);
        }
        return;
    }
    if server.work != Work::Nothing && server.client != from {
        increment(&mut server.counters.busy);
        let text = if is_erase { BEING_READ } else { b"Logs refused: another client reads them" };
        return cx.text(MavSeverity::NOTICE, text);
    }
    if is_erase {
        if cx.now < cx.shared.logs_read_until {
            increment(&mut server.counters.busy);
            return cx.text(MavSeverity::NOTICE, BEING_READ);
        }
        server.work = Work::Nothing;
        let (vehicle, mut context) = cx.hook();
        let is_erased = vehicle.erase_logs(&mut context, from);
        let (severity, text) = match is_erased {
            true => (MavSeverity::INFO, b"Logs erased".as_slice()),
            false => (MavSeverity::WARNING, b"Logs not erased".as_slice()),
        };
        if is_erased {
            server.forget_lists(cx.shared);
        }
        cx.shared.has_acted = true;
        return cx.text(severity, text);
    }
    (server.client, server.heard, server.ready_at) = (from, cx.now, Instant::ZERO);
    if let Some(LogRequestList { start, end, .. }) = frame.decode() {
        // Without a log, one entry says so (LOG-2).
        let last = cx.vehicle.log_count().saturating_sub(1);
        server.id = start.min(last);
        server.last = end.min(last).max(server.id);
        server.work = Work::List;
        if let Some(listed) = &mut server.listed
            && !listed.contains(&from)
        {
            let [first, second, third, _] = *listed;
            *listed = [from, first, second, third];
        }
        return;
    }
    let Some(LogRequestData { ofs, count, id, .. }) = frame.decode() else { return };
    // A count of 0 ends a download for the client, so only an offset behind the log is answered by it (LOG-4).
    let Some(info) = cx.vehicle.log_info(id) else {
        server.work = Work::Nothing;
        return increment(&mut server.counters.unknown);
    };
    increment(&mut server.counters.requests);
    event!("log {=u16} from {=u32}: {=u32} bytes", id, ofs, count);
    let rest = info.size.saturating_sub(ofs);
    (server.id, server.offset, server.left) = (id, ofs, count.min(rest));
    server.work = match rest {
        0 => Work::End,
        _ if count == 0 => Work::Nothing,
        _ => Work::Data,
    };
}

/// Sends a LOG_ENTRY.
fn send_entry<F: Firmware<Vehicle: Logs>>(server: &mut LogServer, cx: &Cx<'_, F>, port: &mut Port) -> bool {
    let LogServer { id, last: last_log_num, .. } = *server;
    let LogInfo { size, time_utc } = cx.vehicle.log_info(id).unwrap_or_default();
    if id >= last_log_num {
        server.work = Work::Nothing;
    }
    server.id = id.saturating_add(1);
    port.outbox.send(&LogEntry { time_utc, size, id, num_logs: cx.vehicle.log_count(), last_log_num })
}

/// Sends a LOG_DATA.
fn send_data<F: Firmware<Vehicle: Logs>>(server: &mut LogServer, cx: &mut Cx<'_, F>, port: &mut Port) -> bool {
    let LogServer { id, offset, left, .. } = *server;
    let len = usize::try_from(left).unwrap_or(BLOCK).min(BLOCK);
    let count = u8::try_from(len).unwrap_or(0);
    let mut read = LogRead::Done;
    let is_sent = port.outbox.compose(const { &LogData::INFO }, |payload: &mut [u8; LOG_DATA]| {
        let ([a, b, c, d], [low, high]) = (offset.to_le_bytes(), id.to_le_bytes());
        if let Some(front) = payload.first_chunk_mut() {
            *front = [a, b, c, d, low, high, count];
        }
        let data = payload.last_chunk_mut::<BLOCK>().and_then(|data| data.split_at_mut_checked(len));
        let (data, rest) = data.unwrap_or_default();
        rest.fill(0);
        if !data.is_empty() {
            read = cx.vehicle.read_log(id, offset, data);
        }
        read == LogRead::Done
    });
    server.left = left.saturating_sub(count.into());
    server.offset = offset.saturating_add(count.into());
    match read {
        LogRead::Done if server.left > 0 => {}
        LogRead::Done => server.work = Work::Nothing,
        LogRead::Later => (server.offset, server.left, server.ready_at) = (offset, left, cx.now + RETRY),
        LogRead::Failed => {
            increment(&mut server.counters.failed);
            server.work = Work::Nothing;
        }
    }
    is_sent
}
