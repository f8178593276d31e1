//! The sessions of clients: what each has open, and the answers that are pending for it (F-4, F-6, F-12, F-13).

use super::packet::Request;
use crate::dialect::{MavFtpErr, MavFtpOpcode};
use crate::message::Address;
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer};

/// A session ends when its client was silent for this time, and nothing was sent to it either (F-6).
const IDLE: Duration = Duration::from_secs(10);
/// Another client takes over a session that was idle for this time.
const TAKEOVER: Duration = Duration::from_secs(3);
/// A burst that takes longer is cut off, and the client requests the rest: otherwise it would go on for a client that is gone.
const LONGEST_BURST: Duration = Duration::from_secs(5);

/// The number of requests that a client may send at a time: MAVProxy reads and writes five packets ahead.
const ANSWERS: usize = 5;

/// What a session has open. `Nothing` is all zero bits: with this representation no field has the discriminant in its niche.
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
pub(super) enum Open<V> {
    Nothing,
    /// A file of the vehicle's hooks, by number.
    Hook {
        number: u16,
        is_writable: bool,
    },
    /// A file that never changes, by its index.
    Static(u8),
    /// A file of a virtual directory, to be read.
    Virtual(V),
    /// A file of a virtual directory, to be uploaded: one at a time.
    Upload(V),
}

/// The state of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum State {
    /// There is none.
    Empty,
    /// It was sent, and is sent again if the request is repeated.
    Sent,
    /// It is computed.
    Working,
    Pending,
}

/// The answer to a request, without data: these are read when it is sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub(super) state: State,
    pub(super) opcode: MavFtpOpcode,
    pub(super) error: MavFtpErr,
    /// The length of the data that is asked for.
    pub(super) size: u8,
    pub(super) seq: u16,
    pub(super) offset: u32,
    /// The size of a file that was opened, a checksum, or the number of a directory.
    pub(super) value: u32,
    /// Stands for the request.
    pub(super) digest: u32,
}

impl Answer {
    /// All zero bits.
    const EMPTY: Self = Self {
        state: State::Empty,
        opcode: MavFtpOpcode::NONE,
        error: MavFtpErr::NONE,
        size: 0,
        seq: 0,
        offset: 0,
        value: 0,
        digest: 0,
    };

    /// Whether it contains data of a file or a directory.
    pub(super) fn has_data(&self) -> bool {
        self.error == MavFtpErr::NONE && is_data(self.opcode)
    }
}

/// Whether the answer to a request contains data of a file or a directory.
pub(super) const fn is_data(opcode: MavFtpOpcode) -> bool {
    matches!(opcode, MavFtpOpcode::READFILE | MavFtpOpcode::LISTDIRECTORY | MavFtpOpcode::LISTDIRECTORYWITHTIME)
}

/// A burst: packets that are sent without a request for each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Burst {
    pub(super) is_active: bool,
    pub(super) size: u8,
    /// The sequence number of the next packet.
    pub(super) seq: u16,
    /// The offset of the next packet.
    pub(super) offset: u32,
    /// When the burst is cut off.
    pub(super) until: Instant,
    /// Stands for the request.
    digest: u32,
}

/// A client's session, or the answers to a client without one.
#[derive(Clone, Copy, Debug)]
pub struct Session<V> {
    pub(super) is_used: bool,
    /// Its link was opened again: the next poll ends it.
    pub(super) is_gone: bool,
    /// The number that the client has given it.
    pub(super) number: u8,
    pub(super) client: Peer,
    pub(super) open: Open<V>,
    /// When the client was last heard, or was last sent a packet of a burst.
    pub(super) touched: Instant,
    /// The request that has opened it, and its answer: the size.
    pub(super) opened_by: u32,
    pub(super) size: u32,
    pub(super) burst: Burst,
    /// The oldest first.
    pub(super) answers: [Answer; ANSWERS],
}

impl<V> Session<V> {
    /// All zero bits.
    pub(super) const FREE: Self = Self {
        is_used: false,
        is_gone: false,
        number: 0,
        client: Peer { address: Address::new(0, 0), link: LinkId(0) },
        open: Open::Nothing,
        touched: Instant::ZERO,
        opened_by: 0,
        size: 0,
        burst: Burst { is_active: false, size: 0, seq: 0, offset: 0, until: Instant::ZERO, digest: 0 },
        answers: [Answer::EMPTY; ANSWERS],
    };

    /// Makes it free. Not an assignment, which would be a call.
    pub(super) fn free(&mut self) {
        (self.is_used, self.is_gone, self.burst.is_active) = (false, false, false);
        (self.open, self.opened_by) = (Open::Nothing, 0);
        self.forget_all();
    }

    /// Forgets all answers.
    pub(super) fn forget_all(&mut self) {
        for answer in &mut self.answers {
            answer.state = State::Empty;
        }
    }

    /// Returns when it ends, unless its client is heard.
    pub(super) fn ends_at(&self) -> Instant {
        match (self.is_used, self.is_gone) {
            (false, _) => Instant::NEVER,
            (true, false) => self.touched.after(IDLE),
            (true, true) => Instant::ZERO,
        }
    }

    pub(super) fn is_open(&self) -> bool {
        !matches!(self.open, Open::Nothing)
    }

    /// Whether an answer or a packet of a burst is pending.
    pub(super) fn is_busy(&self) -> bool {
        self.burst.is_active || self.answers.iter().any(|answer| !matches!(answer.state, State::Empty | State::Sent))
    }

    /// Whether an answer with or without data is pending, or a packet of a burst.
    pub(super) fn is_due(&self, has_data: bool) -> bool {
        (has_data && self.burst.is_active) || self.pending(has_data).is_some()
    }

    /// Returns the answer in this place, or the next packet of the burst.
    pub(super) fn next_answer(&self, place: Option<usize>) -> Answer {
        let Burst { size, seq, offset, .. } = self.burst;
        match place.and_then(|place| self.answers.get(place)) {
            Some(answer) => Answer { seq: answer.seq.wrapping_add(1), ..*answer },
            None => Answer { opcode: MavFtpOpcode::BURSTREADFILE, size, seq, offset, ..Answer::EMPTY },
        }
    }

    /// Returns the index of the oldest pending answer with or without data.
    pub(super) fn pending(&self, has_data: bool) -> Option<usize> {
        self.answers.iter().position(|answer| answer.state == State::Pending && answer.has_data() == has_data)
    }

    /// Returns the index of the oldest answer that is not pending, if there is one: its place is for another answer.
    fn place(&self) -> Option<usize> {
        self.answers.iter().position(|answer| matches!(answer.state, State::Empty | State::Sent))
    }

    /// Whether there is a place for another answer.
    pub(super) fn has_room(&self) -> bool {
        self.place().is_some()
    }

    /// Adds an answer behind the others.
    pub(super) fn put(&mut self, answer: Answer) {
        let places = self.place().and_then(|place| self.answers.get_mut(place..));
        let mut places = places.unwrap_or_default().iter_mut();
        let Some(mut place) = places.next() else { return };
        for next in places {
            *place = *next;
            place = next;
        }
        *place = answer;
    }

    /// Returns the answer that is being computed.
    pub(super) fn working(&mut self) -> Option<&mut Answer> {
        self.answers.iter_mut().find(|answer| answer.state == State::Working)
    }

    /// If an identical request was answered, or is being answered, has the same answer sent again.
    pub(super) fn is_repeated(&mut self, digest: u32) -> bool {
        let is_it = |answer: &&mut Answer| answer.state != State::Empty && answer.digest == digest;
        let Some(answer) = self.answers.iter_mut().find(is_it) else { return false };
        if answer.state == State::Sent {
            answer.state = State::Pending;
        }
        true
    }

    /// Forgets what was answered: in another file, an identical request is a new one. But a delayed duplicate of what has ended
    /// the session before does not end this one.
    pub(super) fn forget_answers(&mut self) {
        let is_it =
            |answer: &&mut Answer| answer.state == State::Sent && answer.opcode != MavFtpOpcode::TERMINATESESSION;
        for answer in self.answers.iter_mut().filter(is_it) {
            answer.state = State::Empty;
        }
    }

    /// Forgets the data of the open file that is pending: the client does not wait for it any more.
    pub(super) fn drop_data(&mut self) {
        self.burst.is_active = false;
        for answer in self.answers.iter_mut().filter(|answer| answer.opcode == MavFtpOpcode::READFILE) {
            answer.state = State::Empty;
        }
    }

    /// Starts or replaces the burst (F-8). A repeated request does not start a running one again.
    pub(super) fn start_burst(&mut self, now: Instant, request: &Request<'_>, digest: u32) {
        if self.burst.is_active && self.burst.digest == digest {
            return;
        }
        self.burst = Burst {
            is_active: true,
            size: request.wanted(),
            seq: request.seq.wrapping_add(1),
            offset: request.offset,
            until: now.after(LONGEST_BURST),
            digest,
        };
    }
}

/// Returns the position of the session of a client. Without one, a place for it: one that is not used, or else the one that
/// was idle for the longest and has nothing open. `None` if there is none: then a request is dropped.
pub(super) fn find<V>(sessions: &mut [Session<V>], client: Peer, number: u8) -> Option<usize> {
    let is_it = |session: &Session<V>| {
        session.is_used && !session.is_gone && session.client == client && session.number == number
    };
    if let Some(place) = sessions.iter().position(is_it) {
        return Some(place);
    }
    let mut best: Option<(Instant, usize)> = None;
    let mut place = 0usize;
    for session in sessions.iter() {
        let since = if session.is_used { session.touched } else { Instant::ZERO };
        let is_free = !session.is_open() && !session.is_busy();
        if is_free && best.is_none_or(|(earliest, _)| since < earliest) {
            best = Some((since, place));
        }
        place = place.wrapping_add(1);
    }
    let (_, place) = best?;
    let session = sessions.get_mut(place)?;
    session.free();
    (session.is_used, session.client, session.number) = (true, client, number);
    Some(place)
}

/// Returns the open session that another client takes over: the one that was idle for the longest, at least three seconds.
/// `Err` if all are in use.
pub(super) fn victim<V>(sessions: &[Session<V>], now: Instant) -> Option<usize> {
    let oldest = sessions.iter().filter(|session| session.is_open()).map(|session| session.touched).min()?;
    let place = sessions.iter().position(|session| session.is_open() && session.touched == oldest);
    place.filter(|_| now.since(oldest) >= TAKEOVER)
}
