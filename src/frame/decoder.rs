//! Bytes to frames.
//!
//! The state machine is drawn at [`Decoder`].

#[cfg(feature = "signing")]
use zeroize::Zeroize;

use super::{Address, Frame, Header, INCOMPAT_SIGNED, MAX_FRAME_LEN, STX_V1, STX_V2, Version, crc};
use crate::message::{MessageInfo, MessageTable, zero_extend};
use crate::time::{Duration, Instant};

/// One more than the longest frame: whether a frame with an unknown id is one, the byte behind it tells (R-9).
const BUFFER_LEN: usize = MAX_FRAME_LEN + 1;

/// For how long nothing may come after a frame with an unknown id before the line counts as idle (R-9).
const IDLE: Duration = Duration::from_millis(20);

/// What a decoder has seen and dropped. Numbers wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct RxCounters {
    /// Frames whose checksum was right.
    pub frames: u32,
    /// Frames with an unknown id, which could not be checked (S-12).
    pub unchecked: u32,
    /// Bytes before a start byte.
    pub skipped: u32,
    /// Candidates with an incompatibility flag that we do not know (S-9).
    pub incompat_flags: u32,
    /// Candidates with 0 as source system or component (S-11).
    pub zero_source: u32,
    /// v1 candidates whose length does not fit their id (S-8).
    pub length: u32,
    /// Candidates with a wrong checksum (S-2).
    pub checksum: u32,
    /// Candidates with an unknown id and nothing that speaks for them (R-9).
    pub unknown_id: u32,
    /// Candidates that stopped growing (SEC-4).
    pub stale: u32,
}

impl RxCounters {
    const ZERO: Self = Self {
        frames: 0,
        unchecked: 0,
        skipped: 0,
        incompat_flags: 0,
        zero_source: 0,
        length: 0,
        checksum: 0,
        unknown_id: 0,
        stale: 0,
    };
}

/// Finds frames in a stream of bytes.
///
/// It owns one buffer. Bytes land in it ([`spare`](Decoder::spare) and [`commit`](Decoder::commit), or
/// [`push`](Decoder::push)), and [`next`](Decoder::next) looks at the *candidate* at its front:
///
/// ```text
///                     ┌─ skip to a start byte ◀────────────────────────────┐
///                     ▼                                                    │ drop one byte, count the reason
///   bytes ──▶ start byte ──▶ header ──▶ whole frame ──▶ checksum ── wrong ─┤
///                 │ unknown flag │ source 0,  │ stopped    │ right         │
///                 │              │ v1 length  │ growing    ▼               │
///                 └──────────────┴────────────┴───────── ─ ─ ─ ────────────┘
///                                                        Frame
/// ```
///
/// A candidate that fails costs one byte: the search goes on from its second, so a false start byte or a corrupted length
/// never swallows an intact frame behind it (S-13, SEC-4). What comes out does not depend on how the bytes were cut into
/// pieces. Work is charged to a budget, because nested false headers can make one byte cost thousands (SEC-2).
///
/// ```
/// use mavstack::{Decoder, Dialect, Instant, dialect::{Common, Heartbeat}};
/// # use mavstack::{Address, Version, encode};
/// # let mut bytes = [0; 64];
/// # let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
/// # let len = encode(&heartbeat, Version::V2, Address::new(255, 190), 7, &mut bytes).unwrap();
/// # let bytes = &bytes[..len];
/// let now = Instant::ZERO;
/// let mut decoder = Decoder::default();
/// assert_eq!(decoder.push(bytes, now), bytes.len());
/// let mut budget = Decoder::MIN_BUDGET;
/// while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut budget, |_| false) {
///     if let Some(heartbeat) = frame.decode::<Heartbeat>() {
///         assert_eq!(heartbeat.mavlink_version, 3);
///     }
/// }
/// assert_eq!(decoder.counters().frames, 1);
/// ```
#[derive(Clone)]
pub struct Decoder {
    buffer: [u8; BUFFER_LEN],
    accepts_component_0: bool,
    /// The candidate begins here; what is before it is done with.
    start: u16,
    /// Received bytes end here.
    end: u16,
    /// How many bytes the candidate needs before there is something new to decide.
    need: u16,
    /// When the last byte came.
    grown: Instant,
    /// µs; from 71 minutes on it is never.
    stale_after: u32,
    counters: RxCounters,
}

/// What the bytes of a candidate say.
enum Verdict {
    /// Too early to tell: ask again when there are so many bytes.
    Need(u16),
    /// Not a frame.
    Reject(Reason),
    /// A frame with this id is known, and it is whole: check it.
    Check(Header, &'static MessageInfo),
    /// A whole frame with an unknown id.
    Unknown(Header),
}

/// Why a candidate is not a frame.
#[derive(Clone, Copy)]
enum Reason {
    IncompatFlags,
    ZeroSource,
    Length,
    Checksum,
    UnknownId,
    Stale,
}

/// Without the received bytes: a key may be among them (SEC-15).
impl core::fmt::Debug for Decoder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let waiting = self.end.wrapping_sub(self.start);
        f.debug_struct("Decoder").field("waiting", &waiting).field("counters", &self.counters).finish_non_exhaustive()
    }
}

impl Decoder {
    /// The least budget that lets [`next`](Self::next) always get on: one header and the longest frame's checksum.
    pub const MIN_BUDGET: u32 = 281;

    /// After how long a candidate that does not grow is dropped, by default: packet radios pause in the middle of a
    /// frame (SEC-4).
    pub const STALE_AFTER: Duration = Duration::from_millis(500);

    /// Before it is [configured](Self::configure); all zero bits.
    pub(crate) const VACANT: Self = Self {
        buffer: [0; BUFFER_LEN],
        accepts_component_0: false,
        start: 0,
        end: 0,
        need: 0,
        grown: Instant::ZERO,
        stale_after: 0,
        counters: RxCounters::ZERO,
    };

    /// An empty decoder that drops a candidate `stale_after` its last byte; from 71 minutes on never.
    pub const fn new(stale_after: Duration) -> Self {
        let mut new = Self::VACANT;
        new.configure(stale_after, false);
        new
    }

    pub(crate) const fn configure(&mut self, stale_after: Duration, accepts_component_0: bool) {
        self.need = 1;
        self.stale_after = micros(stale_after);
        self.accepts_component_0 = accepts_component_0;
    }

    /// What was seen and dropped so far.
    pub const fn counters(&self) -> RxCounters {
        self.counters
    }

    /// Forgets all bytes that are not yet a frame; the counters stay. For a line that was opened anew.
    pub const fn clear(&mut self) {
        self.start = 0;
        self.end = 0;
        self.need = 1;
    }

    /// Overwrites what is done with: a key was in it (SEC-15).
    #[cfg(feature = "signing")]
    pub(crate) fn wipe(&mut self) {
        self.buffer.get_mut(..usize::from(self.start)).unwrap_or_default().iter_mut().zeroize();
        self.buffer.get_mut(usize::from(self.end)..).unwrap_or_default().iter_mut().zeroize();
    }

    /// Room for new bytes: read into its front, then [`commit`](Self::commit).
    ///
    /// Empty only while frames, or a search that ran out of budget, wait for [`next`](Self::next).
    pub fn spare(&mut self) -> &mut [u8] {
        self.compact();
        self.buffer.get_mut(usize::from(self.end)..).unwrap_or_default()
    }

    /// Moves the candidate to the front of the buffer.
    fn compact(&mut self) {
        if self.start > 0 {
            // A plain loop: `copy_within` can panic, and brings 1.5 kB of memmove. What is moved is the front of one frame.
            let cells = core::cell::Cell::from_mut(&mut self.buffer[..]).as_slice_of_cells();
            let (start, end) = (usize::from(self.start), usize::from(self.end));
            for (to, from) in cells.iter().zip(cells.get(start..end).unwrap_or_default()) {
                to.set(from.get());
            }
            self.end = self.end.saturating_sub(self.start);
            self.start = 0;
        }
    }

    /// The first `len` bytes of [`spare`](Self::spare) were filled at `now`; more than there was room for counts as all.
    #[inline]
    pub fn commit(&mut self, len: usize, now: Instant) {
        self.end = self.end.saturating_add(short(len)).min(const { short(BUFFER_LEN) });
        self.grown = now;
    }

    /// Takes as many of `bytes` as there is room for and returns their number. Call [`next`](Self::next) until it has no
    /// frame left, then push the rest.
    #[inline]
    #[must_use = "bytes beyond these were not taken: they are to be given again"]
    pub fn push(&mut self, bytes: &[u8], now: Instant) -> usize {
        if let (&[byte], Some(free)) = (bytes, self.buffer.get_mut(usize::from(self.end))) {
            // What an interrupt for each byte does.
            *free = byte;
            self.end = self.end.wrapping_add(1);
            self.grown = now;
            return 1;
        }
        // Moving what is there can wait until there is no room behind it.
        if BUFFER_LEN.saturating_sub(usize::from(self.end)) < bytes.len() {
            self.compact();
        }
        let len = zero_extend(bytes, self.buffer.get_mut(usize::from(self.end)..).unwrap_or_default());
        self.commit(len, now);
        len
    }

    /// The next frame.
    ///
    /// `budget` is what this call may still spend: 1 for each header looked at and 1 for each byte put through the
    /// checksum. When it does not suffice, `None` is returned and the search goes on from the same place at the next
    /// call; give at least [`MIN_BUDGET`](Self::MIN_BUDGET) a poll.
    ///
    /// `is_known` tells whether a source was heard of before. That, together with a start byte or silence behind it, speaks
    /// for a frame whose id is not in `messages` (R-9); it is then returned whole and unchecked, else searched. Either by
    /// itself does not: behind a lost byte it would swallow intact frames.
    #[inline]
    pub fn next(
        &mut self,
        now: Instant,
        messages: MessageTable,
        budget: &mut u32,
        is_known: impl Fn(Address) -> bool,
    ) -> Option<Frame<'_>> {
        self.next_vouched(now, messages, budget, is_known, |_| false)
    }

    /// The same. `vouches` tells whether a whole signed frame bears a right signature: then it is one, though its id is unknown
    /// (SEC-5).
    #[inline(always)]
    pub(crate) fn next_vouched(
        &mut self,
        now: Instant,
        messages: MessageTable,
        budget: &mut u32,
        is_known: impl Fn(Address) -> bool,
        vouches: impl Fn(&[u8]) -> bool,
    ) -> Option<Frame<'_>> {
        if self.end.wrapping_sub(self.start) < self.need && now.since(self.grown) < IDLE {
            // Most calls end here: a piece of a frame came. So this much is inlined, however often it is called.
            return None;
        }
        self.find(now, messages, budget, is_known, vouches)
    }

    /// Apart, so that a call that finds nothing saves no registers for what it does not do.
    #[cfg_attr(target_pointer_width = "64", inline(never))]
    fn find(
        &mut self,
        now: Instant,
        messages: MessageTable,
        budget: &mut u32,
        is_known: impl Fn(Address) -> bool,
        vouches: impl Fn(&[u8]) -> bool,
    ) -> Option<Frame<'_>> {
        let (header, info) = self.advance(now, messages, budget, is_known, vouches)?;
        let end = usize::from(self.start);
        let raw = self.buffer.get(end.checked_sub(header.frame_len())?..end)?;
        let payload = raw.get(header.version.header_len()..header.payload_end())?;
        Some(Frame { header, payload, raw, info })
    }

    /// Goes on to the end of the next frame.
    fn advance(
        &mut self,
        now: Instant,
        messages: MessageTable,
        budget: &mut u32,
        is_known: impl Fn(Address) -> bool,
        vouches: impl Fn(&[u8]) -> bool,
    ) -> Option<(Header, Option<&'static MessageInfo>)> {
        loop {
            let candidate = self.candidate();
            if candidate.len() < usize::from(self.need) {
                let quiet = now.since(self.grown);
                if candidate.is_empty() || quiet < IDLE {
                    return None;
                }
                *budget = budget.checked_sub(1)?;
                if let Verdict::Unknown(header) = examine(candidate, messages, self.accepts_component_0) {
                    return Some(self.accept_unchecked(header));
                }
                if quiet < self.stale_after() {
                    return None;
                }
                self.reject(Reason::Stale);
                continue;
            }
            if !matches!(candidate.first(), Some(&(STX_V1 | STX_V2))) {
                let garbage = candidate.iter().position(|&byte| byte == STX_V1 || byte == STX_V2);
                let garbage = garbage.unwrap_or(candidate.len());
                self.counters.skipped = self.counters.skipped.wrapping_add(u32::try_from(garbage).unwrap_or(u32::MAX));
                self.start = self.start.saturating_add(short(garbage));
                self.need = 1;
                continue;
            }
            if *budget == 0 {
                return None;
            }
            match examine(candidate, messages, self.accepts_component_0) {
                Verdict::Need(need) => {
                    *budget = budget.saturating_sub(1);
                    self.need = need;
                }
                Verdict::Reject(reason) => {
                    *budget = budget.saturating_sub(1);
                    self.reject(reason);
                }
                Verdict::Check(header, info) => {
                    let end = header.payload_end();
                    let cost = u32::from(header.payload_len).saturating_add(11);
                    *budget = budget.checked_sub(cost)?;
                    let sum = candidate.get(1..end).map_or(0, |bytes| crc::update(crc::INIT, bytes));
                    let sum = crc::step(sum, info.crc_extra());
                    if candidate.get(end..).and_then(<[u8]>::first_chunk) == Some(&sum.to_le_bytes()) {
                        self.counters.frames = self.counters.frames.wrapping_add(1);
                        self.consume(header.frame_len());
                        return Some((header, Some(info)));
                    }
                    self.reject(Reason::Checksum);
                }
                Verdict::Unknown(header) => {
                    let len = header.frame_len();
                    if cfg!(feature = "signing") && header.is_signed() {
                        *budget = budget.checked_sub(u32::from(header.payload_len).saturating_add(11))?;
                        if candidate.get(..len).is_some_and(&vouches) {
                            return Some(self.accept_unchecked(header));
                        }
                    } else {
                        *budget = budget.saturating_sub(1);
                    }
                    match candidate.get(len) {
                        _ if !is_known(header.source) => self.reject(Reason::UnknownId),
                        Some(&(STX_V1 | STX_V2)) => return Some(self.accept_unchecked(header)),
                        Some(_) => self.reject(Reason::UnknownId),
                        // Wait for the byte behind it, or for silence.
                        None => self.need = short(len.saturating_add(1)),
                    }
                }
            }
        }
    }

    fn accept_unchecked(&mut self, header: Header) -> (Header, Option<&'static MessageInfo>) {
        self.counters.unchecked = self.counters.unchecked.wrapping_add(1);
        self.consume(header.frame_len());
        (header, None)
    }

    fn consume(&mut self, len: usize) {
        self.start = self.start.wrapping_add(short(len));
        self.need = 1;
    }

    fn candidate(&self) -> &[u8] {
        self.buffer.get(usize::from(self.start)..usize::from(self.end)).unwrap_or_default()
    }

    fn stale_after(&self) -> Duration {
        match self.stale_after {
            u32::MAX => Duration::MAX,
            micros => Duration::from_micros(u64::from(micros)),
        }
    }

    /// Drops the candidate's first byte, so that the search goes on from its second.
    fn reject(&mut self, reason: Reason) {
        let counters = &mut self.counters;
        let (counter, _name) = match reason {
            Reason::IncompatFlags => (&mut counters.incompat_flags, "unknown incompatibility flag"),
            Reason::ZeroSource => (&mut counters.zero_source, "source id 0"),
            Reason::Length => (&mut counters.length, "v1 length"),
            Reason::Checksum => (&mut counters.checksum, "checksum"),
            Reason::UnknownId => (&mut counters.unknown_id, "unknown id"),
            Reason::Stale => (&mut counters.stale, "stopped growing"),
        };
        *counter = counter.wrapping_add(1);
        event!("rx: candidate dropped: {=str}", _name);
        self.consume(1);
    }

    /// When [`next`](Self::next) has something to do though no byte comes.
    pub(crate) fn deadline(&self) -> Instant {
        let candidate = self.candidate();
        match candidate.len() {
            0 => Instant::NEVER,
            // Frames, or a search, wait for the next poll's budget.
            received if received >= usize::from(self.need) => Instant::ZERO,
            // A whole frame with an unknown id waits for one byte more, or for silence.
            received if Header::parse(candidate).is_some_and(|header| header.frame_len() == received) => {
                self.grown.after(IDLE)
            }
            _ => self.grown.after(self.stale_after()),
        }
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new(Self::STALE_AFTER)
    }
}

/// What the candidate is, as far as its bytes go. Cheap: the checksum is left to the caller. Inlined where flash is no matter.
#[cfg_attr(target_pointer_width = "64", inline(always))]
fn examine(candidate: &[u8], messages: MessageTable, accepts_component_0: bool) -> Verdict {
    // The flags come before the length is believed (SEC-3): they may change the header's own length.
    match *candidate {
        [STX_V2, _, incompat_flags, ..] if incompat_flags & !INCOMPAT_SIGNED != 0 => {
            return Verdict::Reject(Reason::IncompatFlags);
        }
        [STX_V2] | [STX_V2, _] => return Verdict::Need(3),
        _ => {}
    }
    let Some(header) = Header::parse(candidate) else {
        let version = if candidate.first() == Some(&STX_V2) { Version::V2 } else { Version::V1 };
        return Verdict::Need(short(version.header_len()));
    };
    if header.source.system.0 == 0 || (header.source.component.0 == 0 && !accepts_component_0) {
        return Verdict::Reject(Reason::ZeroSource);
    }
    let info = messages.get(header.id);
    if let Some(info) = info
        && header.version == Version::V1
        && header.payload_len != info.base_len()
    {
        return Verdict::Reject(Reason::Length);
    }
    let len = header.frame_len();
    match info {
        _ if candidate.len() < len => Verdict::Need(short(len)),
        Some(info) => Verdict::Check(header, info),
        None => Verdict::Unknown(header),
    }
}

/// A length within a buffer.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; what is cast was bounded")]
const fn short(len: usize) -> u16 {
    if len < u16::MAX as usize { len as u16 } else { u16::MAX }
}

#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; what is cast was bounded")]
const fn micros(duration: Duration) -> u32 {
    if duration.as_micros() < u32::MAX as u64 { duration.as_micros() as u32 } else { u32::MAX }
}
