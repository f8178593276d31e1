//! Bytes to frames.
//!
//! The state machine is drawn at [`Decoder`].

#[cfg(feature = "signing")]
use zeroize::Zeroize;

use super::{Address, Frame, Header, INCOMPAT_SIGNED, MAX_FRAME_LEN, SIGNATURE_LEN, STX_V1, STX_V2, Version, crc};
use crate::message::{MessageInfo, MessageTable, zero_extend};
use crate::time::{Duration, Instant};

/// One more than the longest frame: whether a frame with an unknown id is one, the byte behind it tells (R-9).
const BUFFER_LEN: usize = MAX_FRAME_LEN + 1;

/// A place in the buffer. A host's processor passes on what was just stored fastest in its own word sizes.
#[cfg(target_pointer_width = "64")]
type Position = u32;
#[cfg(not(target_pointer_width = "64"))]
type Position = u16;

/// For how long nothing may come after a frame with an unknown id before the line counts as idle (R-9).
const IDLE: Duration = Duration::from_millis(20);

/// What looking at a header takes of the budget: on a microcontroller as long as so many bytes of a checksum.
const HEADER_COST: u32 = 16;

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
    /// Candidates with source system 0, or source component 0 where the [`Config`](crate::Config) refuses it (S-11).
    pub zero_source: u32,
    /// v1 candidates that are shorter than their message's base fields, or longer than all its fields (S-8).
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
    /// Source components below this are refused: 0 by default, 1 where component 0 is refused (S-11).
    least_component: u8,
    window: Window,
    /// When the last byte came.
    grown: Instant,
    /// µs; from 71 minutes on it is never.
    stale_after: u32,
    counters: RxCounters,
}

/// What of the buffer is in use.
#[derive(Clone, Copy)]
struct Window {
    /// The candidate begins here; what is before it is done with.
    start: Position,
    /// Received bytes end here.
    end: Position,
    /// Where they must end before there is something new to decide.
    wanted: Position,
}

impl Window {
    const EMPTY: Self = Self { start: 0, end: 0, wanted: 1 };

    /// Whether nothing came that could be decided.
    #[inline(always)]
    const fn is_waiting(&self) -> bool {
        self.end < self.wanted
    }

    /// The candidate: it begins with the first byte that is not done with.
    #[inline(always)]
    fn of<'a>(&self, buffer: &'a [u8; BUFFER_LEN]) -> Option<&'a [u8]> {
        buffer.get(index(self.start)..index(self.end))
    }

    /// The candidate's first `len` bytes are done with.
    #[inline(always)]
    fn consume(&mut self, len: usize) {
        self.start = self.start.wrapping_add(position(len));
        self.wanted = self.start.wrapping_add(1);
    }

    /// There is something to decide when the candidate has so many bytes.
    #[inline(always)]
    fn want(&mut self, len: usize) {
        self.wanted = self.start.wrapping_add(position(len));
    }
}

/// What the bytes of a candidate say.
enum Verdict {
    /// Too early to tell: ask again when there are so many bytes.
    Need(usize),
    /// Not a frame.
    Reject(Reason),
    /// A frame with this id is known, and it is whole: check it.
    Check(Extent, &'static MessageInfo),
    /// A whole frame with an unknown id.
    Unknown(Extent),
}

/// How far a frame goes: all of its header that is carried about while it is looked at.
#[derive(Clone, Copy)]
struct Extent {
    header_len: usize,
    /// Where the payload ends.
    payload_end: usize,
    /// Length of the whole frame.
    len: usize,
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
        let waiting = self.window.end.wrapping_sub(self.window.start);
        f.debug_struct("Decoder").field("waiting", &waiting).field("counters", &self.counters).finish_non_exhaustive()
    }
}

impl Decoder {
    /// The least budget that lets [`next`](Self::next) always get on: one header and the longest frame's checksum.
    pub const MIN_BUDGET: u32 = HEADER_COST + 10 + 255;

    /// After how long a candidate that does not grow is dropped, by default: packet radios pause in the middle of a
    /// frame (SEC-4).
    pub const STALE_AFTER: Duration = Duration::from_millis(500);

    /// Before it is [configured](Self::configure); all zero bits.
    pub(crate) const VACANT: Self = Self::with(0, 0);

    /// Returns an empty decoder that drops a candidate `stale_after` its last byte; a time of 71 minutes or more means
    /// never. It accepts frames with source component 0, which MAVLink does not allow but pymavlink sends by default (S-11).
    pub const fn new(stale_after: Duration) -> Self {
        Self::with(micros(stale_after), 1)
    }

    /// Built here and not from a constant, which would be an initialiser copied from flash.
    const fn with(stale_after: u32, wanted: Position) -> Self {
        Self {
            buffer: [0; BUFFER_LEN],
            least_component: 0,
            window: Window { wanted, ..Window::EMPTY },
            grown: Instant::ZERO,
            stale_after,
            counters: RxCounters::ZERO,
        }
    }

    pub(crate) const fn configure(&mut self, stale_after: Duration, accepts_component_0: bool) {
        self.window.wanted = 1;
        self.stale_after = micros(stale_after);
        self.least_component = if accepts_component_0 { 0 } else { 1 };
    }

    /// What was seen and dropped so far.
    pub const fn counters(&self) -> RxCounters {
        self.counters
    }

    /// Forgets all bytes that are not yet a frame; the counters stay. For a line that was opened anew.
    pub const fn clear(&mut self) {
        self.window = Window::EMPTY;
    }

    /// Overwrites what is done with: a key was in it (SEC-15).
    #[cfg(feature = "signing")]
    pub(crate) fn wipe(&mut self) {
        self.buffer.get_mut(..index(self.window.start)).unwrap_or_default().iter_mut().zeroize();
        self.buffer.get_mut(index(self.window.end)..).unwrap_or_default().iter_mut().zeroize();
    }

    /// Room for new bytes: read into its front, then [`commit`](Self::commit). It is at least half of the buffer, and where
    /// nothing waits all of it, 281 bytes: the longest frame has room, for a line that gives packets.
    ///
    /// Empty only while frames, or a search that ran out of budget, wait for [`next`](Self::next).
    pub fn spare(&mut self) -> &mut [u8] {
        if self.is_cramped() {
            self.compact();
        }
        self.buffer.get_mut(index(self.window.end)..).unwrap_or_default()
    }

    /// What [`spare`](Self::spare) takes of a budget: bytes are moved.
    pub(crate) fn spare_cost(&self) -> u32 {
        let moved = if self.is_cramped() { self.window.end.wrapping_sub(self.window.start) } else { 0 };
        u32::try_from(index(moved) / 2).unwrap_or(u32::MAX)
    }

    /// Whether there is less room behind the candidate than in front of it, or nothing to be moved: else it is not worth it.
    #[inline]
    fn is_cramped(&self) -> bool {
        let Window { start, end, .. } = self.window;
        // While a frame comes it is at the front.
        start > 0 && (start == end || index(start).wrapping_add(index(end)) > BUFFER_LEN)
    }

    /// Moves the candidate to the front of the buffer.
    fn compact(&mut self) {
        if self.window.start > 0 {
            // A plain loop: `copy_within` can panic, and brings 1.5 kB of memmove. What is moved is the front of one frame.
            let cells = core::cell::Cell::from_mut(&mut self.buffer[..]).as_slice_of_cells();
            let (start, end) = (index(self.window.start), index(self.window.end));
            for (to, from) in cells.iter().zip(cells.get(start..end).unwrap_or_default()) {
                to.set(from.get());
            }
            self.window.end = self.window.end.saturating_sub(self.window.start);
            self.window.wanted = self.window.wanted.saturating_sub(self.window.start);
            self.window.start = 0;
        }
    }

    /// The first `len` bytes of [`spare`](Self::spare) were filled at `now`; more than there was room for counts as all.
    #[inline]
    pub fn commit(&mut self, len: usize, now: Instant) {
        self.window.end = position(index(self.window.end).saturating_add(len).min(BUFFER_LEN));
        self.grown = now;
    }

    /// Takes as many of `bytes` as there is room for and returns their number. Call [`next`](Self::next) until it has no
    /// frame left, then push the rest.
    #[inline]
    #[must_use = "bytes beyond these were not taken: they are to be given again"]
    pub fn push(&mut self, bytes: &[u8], now: Instant) -> usize {
        if let (&[byte], Some(free)) = (bytes, self.buffer.get_mut(index(self.window.end))) {
            // What an interrupt for each byte does.
            *free = byte;
            self.window.end = self.window.end.wrapping_add(1);
            self.grown = now;
            return 1;
        }
        self.push_piece(bytes, now)
    }

    /// Apart, for it is called seldom where bytes come one by one.
    #[cfg_attr(target_pointer_width = "64", inline(never))]
    fn push_piece(&mut self, bytes: &[u8], now: Instant) -> usize {
        // Moving what is there can wait until there is no room behind it.
        if BUFFER_LEN.saturating_sub(index(self.window.end)) < bytes.len() {
            self.compact();
        }
        let len = zero_extend(bytes, self.buffer.get_mut(index(self.window.end)..).unwrap_or_default());
        self.window.end = self.window.end.wrapping_add(position(len));
        self.grown = now;
        len
    }

    /// The next frame.
    ///
    /// `budget` is what this call may still spend: 16 for each header looked at, 32 for one with an unknown id, and 1 for each
    /// byte put through the checksum, so that it bounds the time. When it does not suffice, `None` is returned and the search
    /// goes on from the same place at the next call; give at least [`MIN_BUDGET`](Self::MIN_BUDGET) a poll.
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
        self.next_vouched(now, messages, budget, is_known, |_, _| false)
    }

    /// The same. `vouches` tells whether a whole signed frame bears a right signature, and takes from the budget what that costs:
    /// then it is one, though its id is unknown (SEC-5).
    #[inline(always)]
    pub(crate) fn next_vouched(
        &mut self,
        now: Instant,
        messages: MessageTable,
        budget: &mut u32,
        is_known: impl Fn(Address) -> bool,
        vouches: impl Fn(&[u8], &mut u32) -> bool,
    ) -> Option<Frame<'_>> {
        if self.window.is_waiting() && now.since(self.grown) < IDLE {
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
        vouches: impl Fn(&[u8], &mut u32) -> bool,
    ) -> Option<Frame<'_>> {
        let Self { buffer, window, counters, least_component, grown, stale_after, .. } = self;
        let (candidate, extent, info) = loop {
            let candidate = window.of(buffer)?;
            if window.is_waiting() {
                let quiet = now.since(*grown);
                if candidate.is_empty() || quiet < IDLE {
                    return None;
                }
                if *budget == 0 {
                    return None;
                }
                *budget = budget.saturating_sub(HEADER_COST);
                if let Verdict::Unknown(extent) = examine(candidate, messages, *least_component) {
                    break (candidate, extent, None);
                }
                if quiet < duration(*stale_after) {
                    return None;
                }
                reject(Reason::Stale, window, counters);
                continue;
            }
            if !matches!(candidate.first(), Some(&(STX_V1 | STX_V2))) {
                skip(candidate, window, counters);
                continue;
            }
            if *budget == 0 {
                return None;
            }
            match examine(candidate, messages, *least_component) {
                Verdict::Need(need) => {
                    *budget = budget.saturating_sub(HEADER_COST);
                    window.want(need);
                }
                Verdict::Reject(reason) => {
                    *budget = budget.saturating_sub(HEADER_COST);
                    reject(reason, window, counters);
                }
                Verdict::Check(extent, info) => {
                    *budget = budget.checked_sub(checksum_cost(candidate))?;
                    let (summed, behind) = candidate.split_at_checked(extent.payload_end)?;
                    let sum = crc::checksum(summed.get(1..)?, info.crc_extra());
                    if behind.first_chunk() == Some(&sum.to_le_bytes()) {
                        break (candidate, extent, Some(info));
                    }
                    reject(Reason::Checksum, window, counters);
                }
                Verdict::Unknown(extent) => {
                    let header = Header::parse(candidate)?;
                    // Whether its sender is known costs as much again.
                    *budget = budget.saturating_sub(const { 2 * HEADER_COST });
                    if cfg!(feature = "signing")
                        && header.is_signed()
                        && candidate.get(..extent.len).is_some_and(|raw| vouches(raw, budget))
                    {
                        break (candidate, extent, None);
                    }
                    match candidate.get(extent.len) {
                        _ if !is_known(header.source) => reject(Reason::UnknownId, window, counters),
                        Some(&(STX_V1 | STX_V2)) => break (candidate, extent, None),
                        Some(_) => reject(Reason::UnknownId, window, counters),
                        // Wait for the byte behind it, or for silence.
                        None => window.want(extent.len.wrapping_add(1)),
                    }
                }
            }
        };
        let counter = if info.is_some() { &mut counters.frames } else { &mut counters.unchecked };
        *counter = counter.wrapping_add(1);
        window.consume(extent.len);
        let raw = candidate.get(..extent.len)?;
        let payload = raw.get(extent.header_len..extent.payload_end)?;
        Some(Frame { header: Header::parse(raw)?, payload, raw, info })
    }

    /// When [`next`](Self::next) has something to do though no byte comes.
    pub(crate) fn deadline(&self) -> Instant {
        let candidate = self.window.of(&self.buffer).unwrap_or_default();
        match candidate.len() {
            0 => Instant::NEVER,
            // Frames, or a search, wait for the next poll's budget.
            _ if !self.window.is_waiting() => Instant::ZERO,
            // A whole frame with an unknown id waits for one byte more, or for silence.
            received if Header::parse(candidate).is_some_and(|header| header.frame_len() == received) => {
                self.grown.after(IDLE)
            }
            _ => self.grown.after(duration(self.stale_after)),
        }
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new(Self::STALE_AFTER)
    }
}

/// Drops what is before the next start byte.
#[cold]
#[inline(never)]
fn skip(candidate: &[u8], window: &mut Window, counters: &mut RxCounters) {
    let garbage = candidate.iter().position(|&byte| byte == STX_V1 || byte == STX_V2);
    let garbage = garbage.unwrap_or(candidate.len());
    counters.skipped = counters.skipped.wrapping_add(u32::try_from(garbage).unwrap_or(u32::MAX));
    window.consume(garbage);
}

/// Drops the candidate's first byte, so that the search goes on from its second.
#[cold]
#[inline(never)]
fn reject(reason: Reason, window: &mut Window, counters: &mut RxCounters) {
    let counter = match reason {
        Reason::IncompatFlags => &mut counters.incompat_flags,
        Reason::ZeroSource => &mut counters.zero_source,
        Reason::Length => &mut counters.length,
        Reason::Checksum => &mut counters.checksum,
        Reason::UnknownId => &mut counters.unknown_id,
        Reason::Stale => &mut counters.stale,
    };
    *counter = counter.wrapping_add(1);
    window.consume(1);
}

/// What the candidate is, as far as its bytes go. Cheap: the checksum is left to the caller. Inlined where flash is no matter.
#[cfg_attr(target_pointer_width = "64", inline(always))]
fn examine(candidate: &[u8], messages: MessageTable, least_component: u8) -> Verdict {
    // The flags come before the length is believed (SEC-3): they may change the header's own length.
    let (header_len, payload_len, flags, system, component, id) = match *candidate {
        [STX_V2, _, flags, ..] if flags & !INCOMPAT_SIGNED != 0 => return Verdict::Reject(Reason::IncompatFlags),
        [STX_V2, len, flags, _, _, system, component, a, b, c, ..] => {
            (Version::V2.header_len(), len, flags, system, component, u32::from_le_bytes([a, b, c, 0]))
        }
        [STX_V2, _, _, ..] => return Verdict::Need(Version::V2.header_len()),
        [STX_V2, ..] => return Verdict::Need(3),
        [_, len, _, system, component, id, ..] => (Version::V1.header_len(), len, 0, system, component, u32::from(id)),
        _ => return Verdict::Need(Version::V1.header_len()),
    };
    if system == 0 || component < least_component {
        return Verdict::Reject(Reason::ZeroSource);
    }
    let info = messages.get(id);
    if let Some(info) = info
        && header_len == Version::V1.header_len()
        && !(info.base_len()..=info.max_len()).contains(&payload_len)
    {
        return Verdict::Reject(Reason::Length);
    }
    let payload_end = header_len.wrapping_add(usize::from(payload_len));
    let signature = if flags & INCOMPAT_SIGNED != 0 { SIGNATURE_LEN } else { 0 };
    let len = payload_end.wrapping_add(2).wrapping_add(signature);
    match info {
        _ if candidate.len() < len => Verdict::Need(len),
        Some(info) => Verdict::Check(Extent { header_len, payload_end, len }, info),
        None => Verdict::Unknown(Extent { header_len, payload_end, len }),
    }
}

/// What a look at a header and the checksum behind it are charged with.
fn checksum_cost(candidate: &[u8]) -> u32 {
    candidate.get(1).map_or(0, |&payload_len| u32::from(payload_len)).saturating_add(const { HEADER_COST + 10 })
}

/// A length within the buffer.
#[allow(clippy::as_conversions, reason = "what is cast is no longer than the buffer")]
const fn position(len: usize) -> Position {
    len as Position
}

#[allow(clippy::as_conversions, reason = "a host has no `From` for it; no target of ours is narrower than 32 bits")]
const fn index(position: Position) -> usize {
    position as usize
}

fn duration(micros: u32) -> Duration {
    if micros == u32::MAX { Duration::MAX } else { Duration::from_micros(u64::from(micros)) }
}

#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; what is cast was bounded")]
const fn micros(duration: Duration) -> u32 {
    if duration.as_micros() < u32::MAX as u64 { duration.as_micros() as u32 } else { u32::MAX }
}
