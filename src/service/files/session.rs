//! The sessions of clients: the open file of each, and its answers (F-4, F-6, F-12, F-13).

use core::num::{NonZeroU32, Saturating, Wrapping};
use core::ops::Range;

use super::directory::Directory;
use super::file::{File, Origin};
use super::packet::{Head, Request, SessionId};
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer, Trust};

/// A time in units of 1,024 µs. It wraps after 50 days, so only differences are compared.
pub(super) type Ticks = Wrapping<u32>;

/// A session ends when its client was silent for ten seconds, no packet of a burst was sent to it, and no checksum
/// advanced (F-6).
pub(super) const IDLE: Ticks = seconds(10);
/// Another client takes over a session that was idle for three seconds.
pub(super) const TAKEOVER: Ticks = seconds(3);
/// A file that its client has held for so long gives way to a client without one, and a checksum that runs for so long to another
/// client's.
pub(super) const TURN: Ticks = seconds(30);
pub(super) const CHECKSUM_TURN: Ticks = seconds(10);
/// A repeat is an identical request within two seconds of the client's last one (F-13): clients repeat after half a
/// second or one, and a client that was started again numbers its requests from 0 again.
const REPEAT: Ticks = seconds(2);
/// A burst that takes longer than five seconds is cut off, and the client requests the rest: otherwise it would
/// continue for a client that is gone.
pub(super) const LONGEST_BURST: Ticks = seconds(5);

/// The number of requests that a client may send at a time: MAVProxy reads and writes five packets ahead.
const AHEAD: usize = 5;
const SLOTS: usize = AHEAD + 1;
/// The slot of the burst, behind those of the other answers.
const BURST_SLOT: Range<usize> = AHEAD..SLOTS;

pub(super) const fn ticks(time: Instant) -> Ticks {
    Wrapping(time.coarse())
}

/// Rounds to the nearest tick.
pub(super) const fn seconds(seconds: u64) -> Ticks {
    ticks(Instant::from_micros(512).saturating_add(Duration::from_secs(seconds)))
}

pub(super) fn duration(ticks: Ticks) -> Duration {
    Duration::from_micros(u64::from(ticks.0) << 10)
}

/// The state of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// The slot has no answer.
    Empty,
    /// The answer was sent, and is sent again if the request is repeated.
    Sent,
    /// The server's operation computes the answer.
    Running,
    /// The answer is sent when the link has room.
    Pending,
    /// The same, with data of a file or a directory: it uses only a share of the link.
    PendingData,
}

/// The content of an answer.
#[derive(Clone, Copy, Debug)]
pub(super) enum Content {
    /// An ACK without data.
    Empty,
    /// The size of the file that was opened, or a checksum, as bytes of the packet.
    Number([u8; 4]),
    /// A NAK.
    Refused(MavFtpErr),
    /// A part of the open file. It is read when the answer is sent.
    FilePart,
    /// Entries of this directory. They are listed when the answer is sent.
    Entries(Directory),
    /// Files of the virtual directory with this number.
    VirtualEntries(u16),
}

impl Content {
    pub(super) const fn number(number: u32) -> Self {
        Self::Number(number.to_le_bytes())
    }
}

/// The answer to a request, or the next packet of a burst, whose packets are sent without a request for each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub(super) state: State,
    pub(super) content: Content,
    /// The request.
    pub(super) head: Head,
    /// Identifies the request.
    digest: Option<NonZeroU32>,
}

impl Answer {
    /// All zero bits.
    const EMPTY: Self = Self { state: State::Empty, content: Content::Empty, head: Head::EMPTY, digest: None };

    /// Returns the answer to a request; without content while it is computed.
    pub(super) fn new(request: &Request<'_>, content: Option<Content>) -> Self {
        let state = match content {
            None => State::Running,
            Some(Content::FilePart | Content::Entries(_) | Content::VirtualEntries(_)) => State::PendingData,
            Some(_) => State::Pending,
        };
        let head = Head { size: request.head.requested_len(), ..request.head };
        Self { state, content: content.unwrap_or(Content::Empty), head, digest: Some(request.digest) }
    }

    /// Whether another answer may take its slot.
    const fn is_free(&self) -> bool {
        matches!(self.state, State::Empty | State::Sent)
    }
}

/// The decision on a request before it is executed.
pub(super) enum Admission {
    /// It repeats a request, whose answer is sent again.
    Repeated,
    /// All slots have pending answers, so it is dropped. The client sends it again.
    NoSlot,
    /// It is executed. Its answer replaces the oldest of these slots.
    Executed { slots: Range<usize> },
}

/// How much a client uses the file that it has open.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lease {
    /// When the client opened its first file. Another client's file in its place ends this time; the same client's does not.
    pub(super) held: Ticks,
    since: Ticks,
    /// The bytes of data that were sent and taken since then.
    pub(super) bytes: Saturating<u32>,
    /// The rate of the client's link (bytes/s).
    rate: u32,
}

impl Lease {
    /// All zero bits.
    pub(super) const NONE: Self = Self { held: Wrapping(0), since: Wrapping(0), bytes: Saturating(0), rate: 0 };

    fn new(now: Ticks, rate: u32) -> Self {
        /// The assumed rate of a link without one.
        const NOMINAL: u32 = 5_760;
        /// A client that sends one request after the other uses no more of a faster link.
        const FASTEST: u32 = 24_000;
        let rate = if rate == 0 { NOMINAL } else { rate.min(FASTEST) };
        Self { held: now, since: now, bytes: Saturating(0), rate }
    }

    pub(super) const fn has_begun(&self) -> bool {
        self.rate > 0
    }

    /// Whether the file was used at less than a twentieth of the link's rate, for ten seconds or more. Called when another client
    /// waits: a file that was used enough is judged by what follows from then on.
    pub(super) fn is_slow(&mut self, now: Ticks) -> bool {
        /// Rounded.
        const TICKS_PER_SECOND: u32 = 977;
        let seconds = (now - self.since).0 / TICKS_PER_SECOND;
        if seconds < 10 {
            return false;
        }
        let is_slow = self.bytes.0 < (self.rate / 20).saturating_mul(seconds);
        if !is_slow {
            *self = Self { held: self.held, ..Self::new(now, self.rate) };
        }
        is_slow
    }
}

/// A client's session, or the answers to a client without an open file.
#[derive(Clone, Copy, Debug)]
pub struct Session<V> {
    /// `None`: it has no client. If a file is open, its client is gone, and the next poll closes the file.
    pub(super) id: Option<SessionId>,
    /// What proves the client. A frame with another proof is another client's.
    pub(super) trust: Trust,
    /// When the client was last heard, a packet of a burst was sent to it, or its checksum advanced.
    pub(super) touched: Ticks,
    pub(super) burst_began: Ticks,
    pub(super) file: File<V>,
    pub(super) lease: Lease,
    /// When its client last asked for a checksum in vain, and when its last one began.
    pub(super) checksum_refused: Ticks,
    pub(super) checksum_began: Ticks,
    /// The request that opened the file.
    pub(super) opened_by: Option<NonZeroU32>,
    /// The answers, the oldest first, then the burst.
    pub(super) answers: [Answer; SLOTS],
}

impl<V> Session<V> {
    /// All zero bits.
    pub(super) const FREE: Self = Self {
        id: None,
        trust: Trust::None,
        touched: Wrapping(0),
        burst_began: Wrapping(0),
        file: File::CLOSED,
        lease: Lease::NONE,
        checksum_refused: Wrapping(0),
        checksum_began: Wrapping(0),
        opened_by: None,
        answers: [Answer::EMPTY; SLOTS],
    };

    pub(super) fn is_on(&self, link: LinkId) -> bool {
        self.id.is_some_and(|id| id.client.link == link)
    }

    pub(super) const fn is_open(&self) -> bool {
        !matches!(self.file.origin, Origin::Closed)
    }

    pub(super) const fn is_uploading(&self) -> bool {
        matches!(self.file.origin, Origin::Upload(_))
    }

    /// Whether the session has this client, with this proof.
    pub(super) fn is_of(&self, client: Peer, trust: Trust) -> bool {
        self.id.is_some_and(|id| id.client == client) && self.trust == trust
    }

    /// Assigns the session, which has no open file, to a client or to none.
    pub(super) fn assign(&mut self, id: Option<SessionId>, trust: Trust) {
        self.id = id;
        self.trust = trust;
        self.lease = Lease::NONE;
        (self.checksum_refused, self.checksum_began) = (Wrapping(0), Wrapping(0));
        self.opened_by = None;
        self.forget(|_| true);
    }

    /// Returns how long the session was idle: the maximum if it has no client.
    pub(super) fn idle_for(&self, now: Ticks) -> Ticks {
        self.id.map_or(Wrapping(u32::MAX), |_| now - self.touched)
    }

    /// Returns the oldest answer in a state.
    pub(super) fn answer_in(&mut self, state: State) -> Option<&mut Answer> {
        self.answers.iter_mut().find(|answer| answer.state == state)
    }

    /// Prepares the session for a request (F-13): sends the answer again if it is a repeat, drops answers that the client no longer
    /// waits for, and finds a slot for the answer.
    pub(super) fn admit(&mut self, request: &Request<'_>, now: Ticks) -> Admission {
        if now - self.touched >= REPEAT {
            self.opened_by = None;
            self.forget(|answer| answer.state == State::Sent);
        }
        self.touched = now;
        let opcode = request.head.opcode;
        let repeated = match opcode {
            // They are executed again. A checksum that is running continues.
            MavFtpOpcode::READFILE
            | MavFtpOpcode::LISTDIRECTORY
            | MavFtpOpcode::LISTDIRECTORYWITHTIME
            | MavFtpOpcode::CALCFILECRC
            | MavFtpOpcode::RESETSESSION => None,
            // An open whose file was closed since is executed again.
            MavFtpOpcode::OPENFILERO | MavFtpOpcode::OPENFILEWO | MavFtpOpcode::CREATEFILE
                if self.opened_by != Some(request.digest) =>
            {
                None
            }
            // A client waits for the answer to a change before it sends another request, so only its last request can be a repeat.
            MavFtpOpcode::REMOVEFILE
            | MavFtpOpcode::TRUNCATEFILE
            | MavFtpOpcode::CREATEDIRECTORY
            | MavFtpOpcode::REMOVEDIRECTORY
            | MavFtpOpcode::RENAME => self.answers.get_mut(const { AHEAD - 1 }..),
            _ => Some(self.answers.as_mut_slice()),
        };
        let is_same = |answer: &&mut Answer| answer.state != State::Empty && answer.digest == Some(request.digest);
        if let Some(answer) = repeated.unwrap_or_default().iter_mut().find(is_same) {
            if answer.state == State::Sent {
                answer.state = State::Pending;
            }
            return Admission::Repeated;
        }
        match opcode {
            MavFtpOpcode::TERMINATESESSION | MavFtpOpcode::RESETSESSION => self.drop_data(),
            // Until this session is used, a late repeat of the end of the one before does not end it.
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE | MavFtpOpcode::WRITEFILE => self
                .forget(|answer| answer.state == State::Sent && answer.head.opcode == MavFtpOpcode::TERMINATESESSION),
            _ => {}
        }
        if opcode == MavFtpOpcode::BURSTREADFILE {
            self.burst_began = now;
            return Admission::Executed { slots: BURST_SLOT };
        }
        match self.answers.iter().take(AHEAD).position(Answer::is_free) {
            Some(free) => Admission::Executed { slots: free..AHEAD },
            None => Admission::NoSlot,
        }
    }

    /// Appends an answer to these slots, in place of the oldest one.
    pub(super) fn put(&mut self, slots: Range<usize>, answer: Answer) {
        let mut later = answer;
        for slot in self.answers.get_mut(slots).unwrap_or_default().iter_mut().rev() {
            core::mem::swap(slot, &mut later);
        }
    }

    /// Assigns an open file. For another file, a request that was answered before is a new one.
    pub(super) fn set_file(&mut self, file: File<V>, request: &Request<'_>, now: Ticks) {
        self.file = file;
        if !self.lease.has_begun() {
            self.lease = Lease::new(now, request.rate);
        }
        self.opened_by = Some(request.digest);
        self.forget(|answer| answer.state == State::Sent && answer.head.opcode != MavFtpOpcode::TERMINATESESSION);
    }

    /// Drops pending data of the open file, and a checksum that is being computed: the client no longer waits for them.
    pub(super) fn drop_data(&mut self) {
        self.forget(|answer| match answer.head.opcode {
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => true,
            MavFtpOpcode::CALCFILECRC => answer.state == State::Running,
            _ => false,
        });
    }

    fn forget(&mut self, is_forgotten: impl Fn(&Answer) -> bool) {
        for answer in &mut self.answers {
            if is_forgotten(answer) {
                answer.state = State::Empty;
            }
        }
    }
}

/// Returns the session of a request, and its index. If there is none, begins one in place of an unused session, or else of the one
/// that was idle for the longest and has neither an open file nor, unless the client is in control, a pending answer. If all have
/// one, takes one of another link that has more sessions, so that a slow link does not keep them. `None` if there is none.
pub(super) fn find_or_begin<'a, V>(
    sessions: &'a mut [Session<V>],
    request: &Request<'_>,
    is_in_control: bool,
    now: Ticks,
) -> Option<(usize, &'a mut Session<V>)> {
    let (id, trust) = (request.session, request.trust);
    let is_its = |session: &Session<V>| session.id == Some(id) && session.trust == trust;
    if let Some(index) = sessions.iter().position(is_its) {
        return Some((index, sessions.get_mut(index)?));
    }
    let count_on = |link: LinkId| sessions.iter().filter(|session| session.is_on(link)).count();
    let mut longest: Option<(usize, (bool, Ticks))> = None;
    for (index, session) in sessions.iter().enumerate().filter(|(_, session)| !session.is_open()) {
        let is_calm = is_in_control || session.answers.iter().all(Answer::is_free);
        let has_more = |held: SessionId| count_on(held.client.link) > count_on(id.client.link).saturating_add(1);
        let rank = (is_calm, session.idle_for(now));
        if (is_calm || session.id.is_some_and(has_more)) && longest.is_none_or(|(_, longest)| rank > longest) {
            longest = Some((index, rank));
        }
    }
    let (index, _) = longest?;
    let session = sessions.get_mut(index)?;
    session.assign(Some(id), trust);
    Some((index, session))
}

/// Returns how many files a client has open.
// It has two callers.
#[inline(never)]
pub(super) fn count_open<V>(sessions: &[Session<V>], client: Peer) -> usize {
    let is_its = |session: &&Session<V>| session.is_open() && session.id.is_some_and(|id| id.client == client);
    sessions.iter().filter(is_its).count()
}

/// Returns the index of the session of a link that sends next, from `first` on: one with an answer in this state.
pub(super) fn next<V>(sessions: &[Session<V>], link: LinkId, first: usize, state: State) -> Option<usize> {
    let mut index = first;
    for _ in sessions {
        if index >= sessions.len() {
            index = 0;
        }
        let session = sessions.get(index)?;
        if session.is_on(link) && session.answers.iter().any(|answer| answer.state == state) {
            return Some(index);
        }
        index = index.saturating_add(1);
    }
    None
}

/// Returns until when a client on a link counts as transferring (F-11): it has a file open, and was heard or sent a packet of a
/// burst in the last three seconds.
pub(super) fn transferring_until<V>(sessions: &[Session<V>], link: LinkId, now: Instant) -> Instant {
    let transferring = sessions.iter().filter(|session| session.is_on(link) && session.is_open());
    let idle = transferring.map(|session| session.idle_for(ticks(now))).min().unwrap_or(TAKEOVER);
    now + duration(TAKEOVER - idle.min(TAKEOVER))
}
