//! The sessions of clients: the open file of each, and its pending answers (F-4, F-6, F-12, F-13).

use super::packet::Head;
use crate::dialect::MavFtpOpcode;
use crate::message::Address;
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer};

/// A session ends when its client was silent for ten seconds, no packet of a burst was sent to it, and no checksum
/// advanced (F-6). In units of 1,024 µs, like all times of sessions.
pub(super) const IDLE: u32 = 9_766;
/// Another client takes over a session that was idle for three seconds.
pub(super) const TAKEOVER: u32 = 2_930;
/// An upload is closed when no new part has arrived for eight seconds (F-26; by messages, M-41): it excludes all other
/// uploads, and other requests of its client would keep its session.
pub(super) const STALLED: u32 = 7_813;
/// A repeat is an identical request within two seconds of the client's last one (F-13): clients repeat after half a
/// second or one, and a client that was started again numbers its requests from 0 again.
pub(super) const REPEAT: u32 = 1_953;
/// A checksum that takes longer than two minutes ends with its client's session: MAVProxy waits for as long.
pub(super) const LONGEST_CHECKSUM: u32 = 117_188;
/// A burst that takes longer than five seconds is cut off, and the client requests the rest: otherwise it would
/// continue for a client that is gone.
pub(super) const LONGEST_BURST: u32 = 4_883;

/// The number of requests that a client may send at a time: MAVProxy reads and writes five packets ahead. Their answers have the
/// first slots, and the burst has the last one.
pub(super) const BURST: usize = 5;

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
    /// It is pending, without data.
    Pending,
    /// It is pending, with data of a file or a directory.
    Data,
}

/// The answer to a request, without its data, which is read when the answer is sent. Or the next packet of a burst,
/// whose packets are sent without a request for each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub(super) state: State,
    /// The request is refused.
    pub(super) is_refused: bool,
    /// The request.
    pub(super) head: Head,
    /// The size of a file that was opened, a checksum, or the number of a directory; the error of a refusal.
    pub(super) value: u32,
    /// Identifies the request.
    pub(super) digest: u32,
}

impl Answer {
    /// All zero bits.
    const EMPTY: Self = Self { state: State::Empty, is_refused: false, head: Head::EMPTY, value: 0, digest: 0 };

    /// Whether another answer may take its slot.
    fn is_free(&self) -> bool {
        matches!(self.state, State::Empty | State::Sent)
    }
}

/// Identifies a session: the client, its link, and the client's number for the session. One integer, because it is
/// compared often.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Key(u32);

impl Key {
    /// The id of an unused session: all zero bits.
    pub(super) const FREE: Self = Self(0);
    /// The id of a session whose link was opened again.
    const GONE: Self = Self(u32::MAX);

    pub(super) fn of(client: Peer, number: u8) -> Self {
        let (system, component) = (client.address.system.wire(), client.address.component.wire());
        Self(u32::from_le_bytes([system, component, client.link.0.wrapping_add(1), number]))
    }

    /// Returns the system, the component, the link and the number.
    pub(super) const fn bytes(self) -> [u8; 4] {
        self.0.to_le_bytes()
    }

    /// Returns the client.
    pub(super) const fn client(self) -> Peer {
        let [system, component, link, _] = self.bytes();
        Peer { address: Address::new(system, component), link: LinkId(link.wrapping_sub(1)) }
    }

    pub(super) const fn is_on(self, link: LinkId) -> bool {
        let [_, _, own, _] = self.bytes();
        own == link.0.wrapping_add(1)
    }

    /// Whether it is another session of the same client, or the same.
    pub(super) const fn has_client_of(self, other: Self) -> bool {
        (self.0 ^ other.0) & 0x00FF_FFFF == 0
    }
}

/// A client's session, or the answers to a client without one. The large array is last: fields near the front take less
/// code to reach.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Session<V> {
    pub(super) key: Key,
    /// When the client was last heard, a packet of a burst was sent to it, or its checksum advanced.
    pub(super) touched: u32,
    /// When the burst began.
    pub(super) burst_began: u32,
    /// The request that opened the file, and its answer: the size.
    pub(super) opened_by: u32,
    pub(super) size: u32,
    pub(super) open: Open<V>,
    /// The answers, the oldest first, then the burst.
    pub(super) answers: [Answer; BURST + 1],
}

impl<V> Session<V> {
    /// All zero bits.
    pub(super) const FREE: Self = Self {
        key: Key::FREE,
        touched: 0,
        burst_began: 0,
        opened_by: 0,
        size: 0,
        open: Open::Nothing,
        answers: [Answer::EMPTY; BURST + 1],
    };

    /// Assigns the session to a client, or frees it. Not an assignment, which would be a call.
    pub(super) fn begin(&mut self, key: Key) {
        self.key = key;
        (self.open, self.opened_by) = (Open::Nothing, 0);
        self.forget(|_| true);
    }

    pub(super) fn is_gone(&self) -> bool {
        self.key == Key::GONE
    }

    /// Ends the session if it belongs to a client on this link: the next poll closes its file.
    pub(super) fn leave(&mut self, link: LinkId) {
        if self.key.is_on(link) {
            self.key = Key::GONE;
        }
    }

    /// Forgets some answers.
    fn forget(&mut self, is_it: impl Fn(&Answer) -> bool) {
        for answer in &mut self.answers {
            if is_it(answer) {
                answer.state = State::Empty;
            }
        }
    }

    /// Returns how long the session was idle: the maximum if it has no client.
    pub(super) fn idle_for(&self, now: u32) -> u32 {
        match self.key {
            Key::FREE | Key::GONE => u32::MAX,
            _ => now.wrapping_sub(self.touched),
        }
    }

    pub(super) const fn is_open(&self) -> bool {
        !matches!(self.open, Open::Nothing)
    }

    pub(super) const fn is_uploading(&self) -> bool {
        matches!(self.open, Open::Upload(_))
    }

    /// Returns the slot of the oldest answer in a state.
    pub(super) fn oldest(&self, state: State) -> Option<usize> {
        self.answers.iter().position(|answer| answer.state == state)
    }

    /// Returns the slot for another answer: that of the oldest one that is not pending.
    pub(super) fn room(&self) -> Option<usize> {
        self.answers.iter().position(Answer::is_free).filter(|place| *place < BURST)
    }

    /// Appends an answer, in place of the one in this slot, or puts the burst into its own slot.
    pub(super) fn put(&mut self, place: usize, answer: Answer) {
        let mut rest = self.answers.get_mut(place..).unwrap_or_default();
        while let [to, from, _, ..] = rest {
            *to = *from;
            rest = rest.get_mut(1..).unwrap_or_default();
        }
        if let Some(to) = rest.first_mut() {
            *to = answer;
        }
    }

    /// Returns whether an identical request was answered or is being answered. Its answer is sent again; a burst
    /// continues. `is_last`: whether only the last request can be repeated.
    pub(super) fn is_repeated(&mut self, digest: u32, is_last: bool) -> bool {
        let answers = self.answers.get_mut(if is_last { BURST - 1 } else { 0 }..).unwrap_or_default();
        let is_it = |answer: &&mut Answer| answer.state != State::Empty && answer.digest == digest;
        let Some(answer) = answers.iter_mut().find(is_it) else { return false };
        if answer.state == State::Sent {
            answer.state = State::Pending;
        }
        true
    }

    /// Forgets what was sent: from now on, an identical request is a new one. `ends`: the ends of sessions. `others`: everything
    /// else.
    pub(super) fn forget_sent(&mut self, ends: bool, others: bool) {
        self.forget(|answer| {
            let forgets = if answer.head.opcode == MavFtpOpcode::TERMINATESESSION { ends } else { others };
            answer.state == State::Sent && forgets
        });
    }

    /// Drops pending data of the open file, and a size or checksum that is being computed: the client no longer waits
    /// for them.
    pub(super) fn drop_data(&mut self) {
        self.forget(|answer| match answer.head.opcode {
            MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE => true,
            MavFtpOpcode::OPENFILERO | MavFtpOpcode::CALCFILECRC => answer.state == State::Working,
            _ => false,
        });
    }
}

/// Returns the index of a session. If there is none, returns a place for it: an unused one, or else the one that was
/// idle for the longest and has no open file. `None` if there is none: then the request is dropped.
pub(super) fn find<V>(sessions: &mut [Session<V>], key: Key, now: u32) -> Option<usize> {
    if let Some(place) = sessions.iter().position(|session| session.key == key) {
        return Some(place);
    }
    let place = oldest(sessions, false, now)?;
    sessions.get_mut(place)?.begin(key);
    Some(place)
}

/// Returns the index of the session that was idle for the longest, among those with an open file or among those with
/// neither an open file nor a pending answer.
pub(super) fn oldest<V>(sessions: &[Session<V>], is_open: bool, now: u32) -> Option<usize> {
    let (mut oldest, mut longest, mut place) = (None, 0, 0usize);
    for session in sessions {
        let is_it = session.is_open() == is_open && (is_open || session.answers.iter().all(Answer::is_free));
        let idle_for = session.idle_for(now);
        if is_it && (oldest.is_none() || idle_for > longest) {
            (oldest, longest) = (Some(place), idle_for);
        }
        place = place.wrapping_add(1);
    }
    oldest
}

/// Returns the index of the session of a link that sends next, from `first` on: one with an answer in this state.
pub(super) fn next<V>(sessions: &[Session<V>], link: LinkId, first: usize, state: State) -> Option<usize> {
    let mut place = first;
    for _ in sessions {
        if place >= sessions.len() {
            place = 0;
        }
        let session = sessions.get(place)?;
        if session.key.is_on(link) && session.oldest(state).is_some() {
            return Some(place);
        }
        place = place.wrapping_add(1);
    }
    None
}

/// Returns until when a client on a link counts as transferring (F-11): it has a file open, and was heard or sent a packet of a
/// burst in the last three seconds.
pub(super) fn transferring_until<V>(sessions: &[Session<V>], link: LinkId, now: Instant) -> Instant {
    let mut longest = 0;
    for session in sessions {
        if session.key.is_on(link) && session.is_open() {
            longest = longest.max(TAKEOVER.saturating_sub(now.coarse().wrapping_sub(session.touched)));
        }
    }
    now + Duration::from_micros(u64::from(longest).wrapping_shl(10))
}
