//! Downloads of flight logs.
//!
//! Implements the vehicle's side of LOG_REQUEST_LIST, LOG_REQUEST_DATA, LOG_REQUEST_END and LOG_ERASE, rules LOG-1 to
//! LOG-9 and LOG-15. The developer guide has no page for them, so they follow PX4 (`mavlink_log_handler.cpp`) and
//! ArduPilot (`AP_Logger_MAVLinkLogTransfer.cpp`) as far as the two agree. They serve QGroundControl
//! (`LogDownloadController.cc`), MAVSDK (`log_files_impl.cpp`), MAVProxy (`mavproxy_log.py`) and Mission Planner.
//!
//! Left out: more than two clients at a time. LOG_ERASE has no answer in MAVLink, so a text reports its result.
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
//! The request of a second client waits. The two then take turns (X-3): the one that is served gives way when all that it requested
//! was sent, after 64 kB, or after 30 s. A third client is refused, until the one that waits has had its turn: it then takes
//! its place. So more clients take turns if they repeat their requests, as all do. The system in control is served at once.
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
use crate::frame::Frame;
use crate::link::Port;
use crate::message::{Address, Message};
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkId, Peer, Sender, Trust};
use core::num::Saturating;

/// Pending entries and data are dropped when the client was silent for this time. MAVProxy requests a whole log at
/// once, and then only sends heartbeats.
const SILENCE: Duration = Duration::from_secs(10);

/// How long a client is served while another waits, and how many bytes it is sent.
const LONGEST_TURN: Duration = Duration::from_secs(30);
const TURN: Saturating<u32> = Saturating(64 * 1_024);

/// The number of bytes of a log in a LOG_DATA.
const BLOCK: usize = 90;
/// The number of clients that are remembered to have listed the logs. The one that listed them first is forgotten.
const LISTED: usize = 4;
/// No frame is from system 0.
const NO_CLIENT: Peer = Peer { address: Address::new(0, 0), link: LinkId(0) };

/// The size of LOG_ENTRY.
const LOG_ENTRY: u32 = 14;
/// The size of LOG_DATA: offset, id and count come before the bytes.
const LOG_DATA: usize = 7 + BLOCK;

counters! {
    /// Counters of log downloads. They wrap.
    LogCounters {
        /// Requests for data that were accepted.
        count requests,
        /// Requests that were refused because the vehicle was armed.
        drop armed,
        /// Requests that were refused because one client was being served and another one waited, and erasures while
        /// a client read a log.
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

/// A list or a download.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    None,
    /// The entries of the logs from `id` to `last`.
    List {
        id: u16,
        last: u16,
    },
    /// `left` bytes of a log from `offset` on; without bytes, the answer that the log ends before `offset`.
    Data {
        id: u16,
        offset: Saturating<u32>,
        left: Saturating<u32>,
    },
}

/// A client, and what it has requested.
#[derive(Clone, Copy, Debug)]
struct Download {
    transfer: Transfer,
    /// A frame with less proof is another client's (X-1).
    client: Sender,
    /// When the client was last heard.
    heard: Instant,
    /// When to read the log again.
    ready_at: Instant,
    /// Whether the client was served before it waited.
    had_turn: bool,
}

impl Download {
    const NONE: Self = Self {
        transfer: Transfer::None,
        client: Sender { peer: NO_CLIENT, trust: Trust::None },
        heard: Instant::ZERO,
        ready_at: Instant::ZERO,
        had_turn: false,
    };

    fn is_idle(&self) -> bool {
        self.transfer == Transfer::None
    }

    /// Whether another client has requested something that was not sent yet.
    fn is_of_other(&self, sender: Sender) -> bool {
        !self.is_idle() && !self.client.is_repeated_by(sender)
    }

    /// When it ends, unless its client is heard (LOG-5).
    fn ends_at(&self) -> Instant {
        if self.is_idle() { Instant::NEVER } else { self.heard + SILENCE }
    }
}

/// The state of log downloads: declared by `logs` in [`#[stack]`](macro@crate::Stack), and read through
/// [`Stack::logs`](crate::Stack::logs). The vehicle's part is [`Logs`].
///
/// It serves one client at a time; two of them take turns. Its LOG_ENTRY and LOG_DATA use the capacity that other traffic
/// leaves. Together with files and log streaming they have at least 30 % of the link's rate.
#[derive(Debug)]
pub struct LogServer {
    served: Download,
    /// That of another client, whose turn is next.
    waiting: Download,
    /// When the turn of the client that is served began, and how many bytes it was sent in it.
    turn_began: Instant,
    sent: Saturating<u32>,
    /// The clients that have listed the logs since the numbers may have changed; `None` if they did not change since
    /// startup.
    listed: Option<[Peer; LISTED]>,
    /// Whether logs could not be read at the last check, and whether a text has reported this, or a change of the logs.
    is_refusing: bool,
    is_reported: bool,
    counters: LogCounters,
}

impl LogServer {
    /// Returns the counters.
    pub const fn counters(&self) -> LogCounters {
        self.counters
    }

    /// Records that the numbers of the logs may have changed (LOG-16).
    fn forget_lists(&mut self, shared: &mut Shared) {
        shared.log_numbering = shared.log_numbering.wrapping_add(1);
        self.listed = Some([NO_CLIENT; LISTED]);
        self.is_reported = false;
    }

    fn downloads(&mut self) -> [&mut Download; 2] {
        [&mut self.served, &mut self.waiting]
    }

    /// Ends what a client has requested.
    fn end(&mut self, sender: Sender) {
        for download in self.downloads() {
            if !download.is_of_other(sender) {
                download.transfer = Transfer::None;
            }
        }
    }

    /// When the client that waits is served, at the latest.
    fn turn_deadline(&self) -> Instant {
        match self.waiting.is_idle() {
            true => Instant::NEVER,
            false if self.served.is_idle() || self.sent >= TURN => Instant::ZERO,
            false => self.turn_began + LONGEST_TURN,
        }
    }

    /// Serves the client that waits, and has the other one wait.
    fn change_turns(&mut self, now: Instant) {
        core::mem::swap(&mut self.served, &mut self.waiting);
        self.waiting.had_turn = true;
        self.begin_turn(now);
    }

    fn change_turns_if_due(&mut self, now: Instant) {
        if now >= self.turn_deadline() {
            self.change_turns(now);
        }
    }

    fn begin_turn(&mut self, now: Instant) {
        (self.turn_began, self.sent) = (now, Saturating(0));
    }

    /// Returns the place for a client's request (LOG-5); `None` if other clients have both.
    fn place<F: Firmware>(&mut self, shared: &Shared, now: Instant, sender: Sender) -> Option<&mut Download> {
        if self.served.is_of_other(sender) {
            let (system, served) = (sender.peer.address.system, self.served.client.peer.address.system);
            if !shared.takes_precedence::<F>(system, served) {
                return Some(&mut self.waiting).filter(|waiting| waiting.had_turn || !waiting.is_of_other(sender));
            }
            // The system in control takes what it needs at once (X-3).
            self.change_turns(now);
        } else if self.served.is_idle() {
            self.begin_turn(now);
        }
        Some(&mut self.served)
    }
}

impl<F: Firmware<Vehicle: Logs>> Service<F> for LogServer {
    type Link = ();
    const VACANT: () = ();
    const ABOUT: About = About { turns: &[Turn::LateBulk, Turn::Bulk], holds: true, ..About::AUTOPILOT };
    type Reply = ();
    const NEW: Self = Self {
        served: Download::NONE,
        waiting: Download::NONE,
        turn_began: Instant::ZERO,
        sent: Saturating(0),
        listed: None,
        is_refusing: false,
        is_reported: false,
        counters: LogCounters::ZERO,
    };

    /// Ends the transfers of silent clients (LOG-5), and in flight (LOG-6), and changes turns.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>) {
        let may_read = update_permission(self, cx);
        let Self { served, waiting, counters, .. } = self;
        for download in [served, waiting] {
            let is_silent = cx.now >= download.ends_at();
            if is_silent {
                increment(&mut counters.timed_out);
            }
            if is_silent || !may_read {
                download.transfer = Transfer::None;
            }
        }
        self.change_turns_if_due(cx.now);
    }

    fn deadline(&self) -> Instant {
        self.served.ends_at().min(self.waiting.ends_at()).min(self.turn_deadline())
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        let sender = received.sender();
        match received.frame.id() {
            LogRequestList::ID | LogRequestData::ID | LogRequestEnd::ID | LogErase::ID
                if received.target.system.is_all() =>
            {
                // It would erase the logs of every vehicle in range, or have all of them send.
                return Handled::OutOfPlace;
            }
            LogRequestList::ID | LogRequestData::ID if port.is_stalled() => return Handled::NoRoom,
            LogRequestList::ID | LogRequestData::ID => on_request(self, cx, received.frame, sender),
            // MAVSDK sends it when it connects. It ends no transfer of another client, not even for the system in control (LOG-5).
            LogRequestEnd::ID => self.end(sender),
            LogErase::ID => erase(self, cx, sender),
            _ => return Handled::No,
        }
        Handled::Yes
    }

    #[inline(always)]
    fn pending(&self, _: &View<'_>, port: &Port, (): &(), _: Turn) -> Option<(Instant, ())> {
        let Download { client, ready_at, .. } = self.served;
        (!self.served.is_idle() && client.peer.link == port.id).then_some((ready_at, ()))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), (): ()) -> bool {
        let is_sent = match self.served.transfer {
            Transfer::None => false,
            Transfer::List { id, last } => send_entry(self, cx, port, id, last),
            Transfer::Data { id, offset, left } => send_data(self, cx, port, id, offset, left),
        };
        self.change_turns_if_due(cx.now);
        is_sent
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        for download in self.downloads() {
            let client = download.client.peer;
            match event {
                // The client is gone, or gets no data.
                StackEvent::Opened(port, _) | StackEvent::Stalled(port, _) if client.link == port.id => {
                    download.transfer = Transfer::None
                }
                StackEvent::Heard { now, from } if from == client => download.heard = now,
                _ => {}
            }
        }
    }
}

/// Whether logs may be read now.
fn may_read<F: Firmware<Vehicle: Logs>>(cx: &Cx<'_, F>) -> bool {
    cx.vehicle.may_read_logs(cx.shared.observed.state.is_armed())
}

/// Updates whether logs may be read, and returns it. Their numbers may change when this becomes false: a vehicle begins
/// a log then.
fn update_permission<F: Firmware<Vehicle: Logs>>(server: &mut LogServer, cx: &mut Cx<'_, F>) -> bool {
    let may_read = may_read(cx);
    if may_read == server.is_refusing {
        server.is_refusing = !may_read;
        server.is_reported = false;
        if !may_read {
            server.forget_lists(cx.shared);
        }
    }
    may_read
}

/// Erases the logs, unless the vehicle is armed or another client reads them. That does not keep the system in control from
/// it (X-3). A text reports the result: there is no other answer.
fn erase<F: Firmware<Vehicle: Logs>>(server: &mut LogServer, cx: &mut Cx<'_, F>, sender: Sender) {
    update_permission(server, cx);
    if cx.shared.observed.state.is_armed() {
        increment(&mut server.counters.armed);
        return cx.text(MavSeverity::NOTICE, b"Logs not erased: disarm first");
    }
    let is_read =
        cx.now < cx.shared.logs_read_until || server.served.is_of_other(sender) || server.waiting.is_of_other(sender);
    let is_owner = F::HAS_CONTROL && cx.shared.controllers.is_owner(sender.peer.address.system, sender.trust);
    if is_read && !is_owner {
        increment(&mut server.counters.busy);
        return cx.text(MavSeverity::NOTICE, b"Logs not erased: a client reads one");
    }
    for download in server.downloads() {
        download.transfer = Transfer::None;
    }
    cx.shared.has_acted = true;
    let (vehicle, mut context) = cx.hook();
    if !vehicle.erase_logs(&mut context, sender.peer) {
        return cx.text(MavSeverity::WARNING, b"Logs not erased");
    }
    server.forget_lists(cx.shared);
    cx.text(MavSeverity::INFO, b"Logs erased");
}

/// Handles LOG_REQUEST_LIST or LOG_REQUEST_DATA.
fn on_request<F: Firmware<Vehicle: Logs>>(
    server: &mut LogServer,
    cx: &mut Cx<'_, F>,
    frame: &Frame<'_>,
    sender: Sender,
) {
    let from = sender.peer;
    let is_data = frame.id() == LogRequestData::ID;
    let refusal = if !update_permission(server, cx) {
        increment(&mut server.counters.armed);
        Some(b"Logs refused: disarm first".as_slice())
    } else if is_data && server.listed.is_some_and(|listed| !listed.contains(&from)) {
        increment(&mut server.counters.outdated);
        Some(b"Logs refused: list them again first".as_slice())
    } else {
        None
    };
    if let Some(text) = refusal {
        // A client may repeat its request through the whole flight, and one text is enough.
        if !core::mem::replace(&mut server.is_reported, true) {
            cx.text(MavSeverity::NOTICE, text);
        }
        return;
    }
    // Decided before a place is taken: a request for nothing must not take another client's.
    let transfer = requested(server, cx.vehicle, frame);
    if transfer == Transfer::None {
        return server.end(sender);
    }
    let Some(place) = server.place::<F>(cx.shared, cx.now, sender) else {
        increment(&mut server.counters.busy);
        return cx.text(MavSeverity::NOTICE, b"Logs refused: other clients read them");
    };
    let had_turn = place.had_turn && place.client.is_repeated_by(sender);
    *place = Download { transfer, client: sender, heard: cx.now, had_turn, ..Download::NONE };
    if is_data {
        increment(&mut server.counters.requests);
    } else if let Some(listed) = &mut server.listed
        && !listed.contains(&from)
    {
        let [first, second, third, _] = *listed;
        *listed = [from, first, second, third];
    }
}

/// Returns what LOG_REQUEST_LIST or LOG_REQUEST_DATA has requested: nothing if there is no such log.
fn requested(server: &mut LogServer, vehicle: &mut impl Logs, frame: &Frame<'_>) -> Transfer {
    let Some(LogRequestData { ofs, count, id, .. }) = frame.decode() else {
        let LogRequestList { start, end, .. } = frame.decode().unwrap_or_default();
        // Without a log, one entry says so (LOG-2).
        let newest = vehicle.log_count().saturating_sub(1);
        let id = start.min(newest);
        return Transfer::List { id, last: end.min(newest).max(id) };
    };
    let Some(info) = vehicle.log_info(id) else {
        increment(&mut server.counters.unknown);
        return Transfer::None;
    };
    event!("log {=u16} from {=u32}: {=u32} bytes", id, ofs, count);
    let left = (Saturating(info.size) - Saturating(ofs)).min(Saturating(count));
    // A count of 0 ends a download for the client, so only an offset behind the log is answered by it (LOG-4).
    if count == 0 && info.size > ofs { Transfer::None } else { Transfer::Data { id, offset: Saturating(ofs), left } }
}

/// Sends a LOG_ENTRY.
fn send_entry<F: Firmware<Vehicle: Logs>>(
    server: &mut LogServer,
    cx: &Cx<'_, F>,
    port: &mut Port,
    id: u16,
    last: u16,
) -> bool {
    let LogInfo { size, time_utc } = cx.vehicle.log_info(id).unwrap_or_default();
    let next = Transfer::List { id: id.saturating_add(1), last };
    server.served.transfer = if id < last { next } else { Transfer::None };
    server.sent += LOG_ENTRY;
    port.outbox.send(&LogEntry { time_utc, size, id, num_logs: cx.vehicle.log_count(), last_log_num: last })
}

/// Sends a LOG_DATA.
fn send_data<F: Firmware<Vehicle: Logs>>(
    server: &mut LogServer,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    id: u16,
    offset: Saturating<u32>,
    left: Saturating<u32>,
) -> bool {
    let len = usize::try_from(left.0).unwrap_or(BLOCK).min(BLOCK);
    let count = u8::try_from(len).unwrap_or(0);
    let mut read = LogRead::Done;
    let is_sent = port.outbox.compose(const { &LogData::INFO }, |payload: &mut [u8; LOG_DATA]| {
        let ([a, b, c, d], [low, high]) = (offset.0.to_le_bytes(), id.to_le_bytes());
        if let Some(front) = payload.first_chunk_mut() {
            *front = [a, b, c, d, low, high, count];
        }
        let data = payload.last_chunk_mut::<BLOCK>().and_then(|data| data.split_at_mut_checked(len));
        let (data, rest) = data.unwrap_or_default();
        rest.fill(0);
        if !data.is_empty() {
            read = cx.vehicle.read_log(id, offset.0, data);
        }
        read == LogRead::Done
    });
    let sent = Saturating(u32::from(count));
    match read {
        LogRead::Done => {
            let rest = Transfer::Data { id, offset: offset + sent, left: left - sent };
            server.served.transfer = if left > sent { rest } else { Transfer::None };
            server.sent += sent;
        }
        LogRead::Later => server.served.ready_at = cx.now + RETRY,
        LogRead::Failed => {
            increment(&mut server.counters.failed);
            server.served.transfer = Transfer::None;
        }
    }
    is_sent
}
