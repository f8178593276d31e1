//! Decoding: bytes to frames (S-1, S-9, S-9b, S-13, S-20, V-2, SEC-1). [`Decoder`] shows the state machine.

#[cfg(feature = "signing")]
use zeroize::Zeroize;

use super::{Frame, Header, INCOMPAT_SIGNED, MAX_FRAME_LEN, SIGNATURE_LEN, STX_V1, STX_V2, Version};
use crate::crc;
use crate::log::increment;
use crate::message::{Address, MessageInfo, MessageTable, zero_extend};
use crate::time::{Duration, Instant};

/// The longest frame and one byte: the byte after a frame with an unknown id helps to decide whether it is one (R-9).
const BUFFER_LEN: usize = MAX_FRAME_LEN + 1;

/// An offset in the buffer. Hosts use 32 bits, because store-to-load forwarding is slower with 16.
#[cfg(target_pointer_width = "64")]
type Position = u32;
#[cfg(not(target_pointer_width = "64"))]
type Position = u16;

/// How long the link must be silent after a frame with an unknown id before it counts as idle (R-9).
const IDLE: Duration = Duration::from_millis(20);

/// The cost of examining a header: on a microcontroller it takes as long as the checksum of this many bytes.
const HEADER_COST: u32 = 17;

counters! {
    /// Counts of the frames that a decoder returned and of the candidates that it dropped. They wrap.
    RxCounters {
        /// Frames with a correct checksum.
        count frames,
        /// Frames with an unknown id, whose checksum could not be verified (S-12).
        count unchecked,
        /// Bytes that were skipped before a start byte.
        drop skipped,
        /// Candidates with an unknown incompatibility flag (S-9).
        drop incompat_flags,
        /// Candidates with source system 0, or with source component 0 if the [`Config`](crate::Config) refuses it (S-11).
        drop zero_source,
        /// MAVLink 1 candidates that are shorter than their message's base fields, or longer than all its fields (S-8).
        drop length,
        /// Candidates with a wrong checksum (S-2).
        drop checksum,
        /// Candidates with an unknown id and no evidence that they are frames (R-9), see [`Decoder::next`].
        drop unknown_id,
        /// Incomplete candidates that received no byte for the configured time (SEC-4).
        drop stale,
    }
}

/// Finds frames in a stream of bytes.
///
/// It owns one buffer. [`push`](Decoder::push) copies bytes into it; [`spare`](Decoder::spare) and
/// [`filled`](Decoder::filled) let a driver write into it directly. [`next`](Decoder::next) examines the *candidate*,
/// the oldest bytes that are not yet consumed:
///
/// ```text
///                     ┌─ skip to a start byte ◀────────────────────────────┐
///                     ▼                                                    │ drop one byte, count the reason
///   bytes ──▶ start byte ──▶ header ──▶ whole frame ──▶ checksum ── wrong ─┤
///                 │ unknown flag │ source 0,  │ stale      │ right         │
///                 │              │ v1 length  │            ▼               │
///                 └──────────────┴────────────┴───────── ─ ─ ─ ────────────┘
///                                                        Frame
/// ```
///
/// When a candidate is dropped, the search continues at its second byte. So a false start byte or a corrupted length
/// never swallows an intact frame behind it (S-13, SEC-4). The frames do not depend on how the bytes were split into
/// pieces.
///
/// A budget bounds the time of each call, because nested false headers can make one byte cost thousands of units
/// (SEC-2).
///
/// ```
/// use mavstack::frame::Decoder;
/// use mavstack::message::Dialect;
/// use mavstack::{Instant, dialect::{Common, Heartbeat}};
/// # use mavstack::Address;
/// # use mavstack::frame::{Version, encode};
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
    /// The lowest source component that is accepted: 0 by default, 1 if component 0 is refused (S-11).
    least_component: u8,
    window: Window,
    /// When the last byte was received.
    grown: Instant,
    /// µs; `u32::MAX` means never.
    stale_after: u32,
    counters: RxCounters,
}

/// The part of the buffer that is in use.
#[derive(Clone, Copy)]
struct Window {
    /// Start of the candidate. The bytes before it are consumed.
    start: Position,
    /// End of the received bytes.
    end: Position,
    /// The smallest `end` with which examining the candidate gives a new result.
    wanted: Position,
}

impl Window {
    const EMPTY: Self = Self { start: 0, end: 0, wanted: 1 };

    /// Returns whether examining the candidate must wait for more bytes.
    #[inline(always)]
    const fn is_waiting(&self) -> bool {
        self.end < self.wanted
    }

    /// Returns the candidate: all received bytes that are not consumed.
    #[inline(always)]
    fn candidate<'a>(&self, buffer: &'a [u8; BUFFER_LEN]) -> Option<&'a [u8]> {
        buffer.get(index(self.start)..index(self.end))
    }

    /// Consumes the candidate's first `len` bytes.
    #[inline(always)]
    fn consume(&mut self, len: usize) {
        self.start = self.start.wrapping_add(position(len));
        self.wanted = self.start.wrapping_add(1);
    }

    /// Consumes and returns the candidate's first `len` bytes.
    #[inline(always)]
    fn take<'a>(&mut self, buffer: &'a [u8; BUFFER_LEN], len: usize) -> Option<&'a [u8]> {
        let start = index(self.start);
        self.consume(len);
        buffer.get(start..index(self.start))
    }

    /// Defers the next examination until the candidate has `len` bytes.
    #[inline(always)]
    fn want(&mut self, len: usize) {
        self.wanted = self.start.wrapping_add(position(len));
    }
}

/// The checks by which a candidate becomes a frame.
pub(crate) struct Checks<K, V> {
    pub(crate) messages: MessageTable,
    /// Returns whether a source was heard before.
    pub(crate) is_known: K,
    /// Returns whether a whole signed frame has a valid signature, and subtracts the cost from the budget. A frame
    /// with an unknown
    /// id is accepted if it has one (SEC-5).
    pub(crate) verifies: V,
}

/// The result of examining a candidate.
enum Verdict {
    /// Undecided until the candidate has this many bytes.
    Need(usize),
    /// Not a frame.
    Reject(Reason),
    /// A whole frame with a known id. Its checksum is not verified yet.
    Check(Extent, &'static MessageInfo),
    /// A whole frame with an unknown id.
    Unknown(Extent),
}

/// The decision on a whole frame with an unknown id (R-9).
enum Evidence {
    Accept,
    Reject,
    /// The next byte decides, or silence.
    Undecided,
}

/// The extent of a frame in bytes: all that is kept of its header until it is verified.
#[derive(Clone, Copy)]
struct Extent {
    header_len: usize,
    /// Offset of the payload's end.
    payload_end: usize,
    /// Length of the whole frame.
    len: usize,
}

/// Why a candidate was dropped.
#[derive(Clone, Copy)]
enum Reason {
    IncompatFlags,
    ZeroSource,
    Length,
    Checksum,
    UnknownId,
    Stale,
}

/// Omits the received bytes: a key may be among them (SEC-15).
impl core::fmt::Debug for Decoder {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let waiting = self.window.end.wrapping_sub(self.window.start);
        f.debug_struct("Decoder").field("waiting", &waiting).field("counters", &self.counters).finish_non_exhaustive()
    }
}

impl Decoder {
    /// The smallest budget, in cost units, with which [`next`](Self::next) always makes progress: one header and the
    /// checksum of the longest frame.
    pub const MIN_BUDGET: u32 = HEADER_COST + 10 + 255;

    /// How long an incomplete candidate is kept after its last byte, by default (SEC-4). It is long because packet
    /// radios pause in the middle of a frame.
    pub const STALE_AFTER: Duration = Duration::from_millis(500);

    /// A decoder before [`configure`](Self::configure): all zero bits, so that it is placed in `.bss`.
    pub(crate) const VACANT: Self = Self::with(0, 0);

    /// Returns an empty decoder that drops an incomplete candidate `stale_after` its last byte; 71 minutes or more
    /// means never.
    ///
    /// It accepts frames with source component 0, which MAVLink does not allow but pymavlink sends by default (S-11).
    pub const fn new(stale_after: Duration) -> Self {
        Self::with(micros(stale_after), 1)
    }

    /// Lists the fields instead of using a constant, which would be an initialiser copied from flash.
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

    /// Returns the counts since the decoder was created.
    pub const fn counters(&self) -> RxCounters {
        self.counters
    }

    /// Discards all bytes that are not yet a frame, and keeps the counters. Call it when the link was reopened.
    pub const fn clear(&mut self) {
        self.window = Window::EMPTY;
    }

    /// Overwrites the buffer outside the candidate: a consumed frame contained a key (SEC-15).
    #[cfg(feature = "signing")]
    pub(crate) fn wipe(&mut self) {
        self.buffer.get_mut(..index(self.window.start)).unwrap_or_default().iter_mut().zeroize();
        self.buffer.get_mut(index(self.window.end)..).unwrap_or_default().iter_mut().zeroize();
    }

    /// Returns the free space for received bytes: read into its front, then call [`filled`](Self::filled).
    ///
    /// When no byte is pending it is the whole buffer, 281 bytes, so that a packet transport can deliver the longest
    /// frame in one read. It is empty only while frames, or a search that ran out of budget, wait for
    /// [`next`](Self::next).
    pub fn spare(&mut self) -> &mut [u8] {
        if self.is_cramped() {
            self.compact();
        }
        // With the minimum, slicing needs no check of its own.
        self.buffer.get_mut(index(self.window.end).min(BUFFER_LEN)..).unwrap_or_default()
    }

    /// Returns the cost of [`spare`](Self::spare), which may move bytes.
    pub(crate) fn spare_cost(&self) -> u32 {
        let moved = if self.is_cramped() { self.window.end.wrapping_sub(self.window.start) } else { 0 };
        u32::try_from(index(moved) / 2).unwrap_or(u32::MAX)
    }

    /// Returns whether [`compact`](Self::compact) is worth its cost: there is less room behind the candidate than in
    /// front of it, or there is nothing to move.
    #[inline]
    fn is_cramped(&self) -> bool {
        let Window { start, end, .. } = self.window;
        // A frame that is received in pieces stays at the front.
        start > 0 && (start == end || index(start).wrapping_add(index(end)) > BUFFER_LEN)
    }

    /// Moves the candidate to the front of the buffer. Out of line, so that it takes no registers from a caller that
    /// receives byte by byte.
    #[inline(never)]
    fn compact(&mut self) {
        if self.window.start > 0 {
            // A plain loop: `copy_within` can panic and links 1.5 kB of `memmove`. Usually it moves a part of a frame.
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

    /// Marks the first `len` bytes of [`spare`](Self::spare) as received at `now`. A larger `len` means all of it.
    #[inline]
    pub fn filled(&mut self, len: usize, now: Instant) {
        self.window.end = position(index(self.window.end).saturating_add(len).min(BUFFER_LEN));
        self.grown = now;
    }

    /// Copies as many of `bytes`, received at `now`, as there is room for, and returns how many. Call
    /// [`next`](Self::next) until it returns `None`, then push the rest.
    #[inline]
    #[must_use = "the bytes after these were not taken: push them again"]
    pub fn push(&mut self, bytes: &[u8], now: Instant) -> usize {
        if let (&[byte], Some(free)) = (bytes, self.buffer.get_mut(index(self.window.end))) {
            // Fast path for an interrupt that pushes each byte.
            *free = byte;
            self.window.end = self.window.end.wrapping_add(1);
            self.grown = now;
            return 1;
        }
        self.push_piece(bytes, now)
    }

    /// Out of line, because it is rarely called when bytes are pushed one by one.
    #[cfg_attr(target_pointer_width = "64", inline(never))]
    fn push_piece(&mut self, bytes: &[u8], now: Instant) -> usize {
        // Compact only when there is too little room.
        if BUFFER_LEN.saturating_sub(index(self.window.end)) < bytes.len() {
            self.compact();
        }
        let len = zero_extend(bytes, self.buffer.get_mut(index(self.window.end)..).unwrap_or_default());
        self.window.end = self.window.end.wrapping_add(position(len));
        self.grown = now;
        len
    }

    /// Returns the next frame; `None` when it needs more bytes or more budget.
    ///
    /// `budget` bounds the time of the call, in cost units: 17 for each header examined, 34 for one with an unknown id,
    /// and 1 for each byte of a checksum. The cost is subtracted from it. When it does not suffice, the next call
    /// continues at the same byte. Give at least [`MIN_BUDGET`](Self::MIN_BUDGET) per poll.
    ///
    /// `is_known` returns whether a source was heard before. A frame whose id is not in `messages` is returned,
    /// unverified, if its source is known and it is followed by a start byte or by 20 ms of silence (R-9). One of the
    /// two does not suffice: after a lost byte such a frame would swallow intact ones. Otherwise its bytes are searched
    /// for frames.
    #[inline]
    pub fn next(
        &mut self,
        now: Instant,
        messages: MessageTable,
        budget: &mut u32,
        is_known: impl Fn(Address) -> bool,
    ) -> Option<Frame<'_>> {
        self.next_checked(now, budget, Checks { messages, is_known, verifies: |_: &[u8], _: &mut u32| false })
    }

    /// As [`next`](Self::next), with these checks.
    #[inline(always)]
    pub(crate) fn next_checked<K, V>(
        &mut self,
        now: Instant,
        budget: &mut u32,
        checks: Checks<K, V>,
    ) -> Option<Frame<'_>>
    where
        K: Fn(Address) -> bool,
        V: Fn(&[u8], &mut u32) -> bool,
    {
        if self.window.is_waiting() && now - self.grown < IDLE {
            // Fast path, inlined into each caller: most calls end here, because only a part of a frame was received.
            return None;
        }
        self.find(now, budget, checks)
    }

    /// Out of line, so that the fast path saves no registers.
    #[cfg_attr(target_pointer_width = "64", inline(never))]
    fn find<K, V>(&mut self, now: Instant, budget: &mut u32, checks: Checks<K, V>) -> Option<Frame<'_>>
    where
        K: Fn(Address) -> bool,
        V: Fn(&[u8], &mut u32) -> bool,
    {
        let (extent, info) = self.search(now, budget, checks)?;
        increment(if info.is_some() { &mut self.counters.frames } else { &mut self.counters.unchecked });
        let raw = self.window.take(&self.buffer, extent.len)?;
        let payload = raw.get(extent.header_len..extent.payload_end)?;
        Some(Frame { header: Header::parse(raw)?, payload, raw, info })
    }

    /// Drops candidates until one is a frame. Returns its extent, and its message if the id is known.
    #[inline(always)]
    fn search<K, V>(
        &mut self,
        now: Instant,
        budget: &mut u32,
        Checks { messages, is_known, verifies }: Checks<K, V>,
    ) -> Option<(Extent, Option<&'static MessageInfo>)>
    where
        K: Fn(Address) -> bool,
        V: Fn(&[u8], &mut u32) -> bool,
    {
        let Self { buffer, window, counters, least_component, grown, stale_after, .. } = self;
        loop {
            let candidate = window.candidate(buffer)?;
            if window.is_waiting() {
                // No byte was received since the candidate was examined: the silence decides.
                let quiet = now - *grown;
                if candidate.is_empty() || quiet < IDLE || *budget == 0 {
                    return None;
                }
                *budget = budget.saturating_sub(HEADER_COST);
                if let Verdict::Unknown(extent) = examine(candidate, messages, *least_component) {
                    return Some((extent, None));
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
                // A wrong checksum is final, whatever the signature says (S-14). A longer payload is from a newer dialect (S-7).
                Verdict::Check(extent, info) => {
                    *budget = budget.checked_sub(checksum_cost(candidate))?;
                    let (summed, behind) = candidate.split_at_checked(extent.payload_end)?;
                    let sum = crc::checksum(summed.get(1..)?, info.crc_extra());
                    if behind.first_chunk() == Some(&sum.to_le_bytes()) {
                        return Some((extent, Some(info)));
                    }
                    reject(Reason::Checksum, window, counters);
                }
                Verdict::Unknown(extent) => {
                    // Looking up the source costs as much as examining the header.
                    *budget = budget.saturating_sub(const { 2 * HEADER_COST });
                    match weigh(candidate, extent, &is_known, |raw| verifies(raw, budget)) {
                        Evidence::Accept => return Some((extent, None)),
                        Evidence::Reject => reject(Reason::UnknownId, window, counters),
                        Evidence::Undecided => window.want(extent.len.wrapping_add(1)),
                    }
                }
            }
        }
    }

    /// Whether frames, or a search that ran out of budget, wait for [`next`](Self::next).
    #[cfg(feature = "embedded-io-async")]
    pub(crate) const fn has_backlog(&self) -> bool {
        self.window.start != self.window.end && !self.window.is_waiting()
    }

    /// Returns when [`next`](Self::next) has work even if no byte is received until then.
    pub(crate) fn deadline(&self) -> Instant {
        let candidate = self.window.candidate(&self.buffer).unwrap_or_default();
        match candidate.len() {
            0 => Instant::NEVER,
            // Frames or a search wait for the next poll's budget.
            _ if !self.window.is_waiting() => Instant::ZERO,
            // A whole frame with an unknown id waits for the next byte, or for silence.
            received if Header::parse(candidate).is_some_and(|header| header.frame_len() == received) => {
                self.grown + IDLE
            }
            _ => self.grown + duration(self.stale_after),
        }
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new(Self::STALE_AFTER)
    }
}

/// Drops the bytes before the next start byte.
#[cold]
fn skip(candidate: &[u8], window: &mut Window, counters: &mut RxCounters) {
    let garbage = candidate.iter().position(|&byte| byte == STX_V1 || byte == STX_V2);
    let garbage = garbage.unwrap_or(candidate.len());
    counters.skipped = counters.skipped.wrapping_add(u32::try_from(garbage).unwrap_or(u32::MAX));
    window.consume(garbage);
}

/// Drops the candidate's first byte, so that the search continues at its second.
#[cold]
// Out of line: it has several callers.
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
    increment(counter);
    window.consume(1);
}

/// Examines a candidate's header and length; the caller verifies the checksum. Inlined where flash size does not
/// matter.
#[cfg_attr(target_pointer_width = "64", inline(always))]
fn examine(candidate: &[u8], messages: MessageTable, least_component: u8) -> Verdict {
    // Check the flags before trusting the length (SEC-3): an unknown flag may change the header's layout.
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

/// Looks for evidence that a candidate with an unknown id is a frame: a valid signature (SEC-5), or a known source and
/// a start byte behind the frame.
#[inline(always)]
fn weigh(
    candidate: &[u8],
    extent: Extent,
    is_known: impl Fn(Address) -> bool,
    verifies: impl FnOnce(&[u8]) -> bool,
) -> Evidence {
    let Some(header) = Header::parse(candidate) else { return Evidence::Undecided };
    if cfg!(feature = "signing") && header.is_signed() && candidate.get(..extent.len).is_some_and(verifies) {
        return Evidence::Accept;
    }
    match candidate.get(extent.len) {
        _ if !is_known(header.source) => Evidence::Reject,
        Some(&(STX_V1 | STX_V2)) => Evidence::Accept,
        Some(_) => Evidence::Reject,
        None => Evidence::Undecided,
    }
}

/// Returns the cost of examining a header and verifying the frame's checksum.
fn checksum_cost(candidate: &[u8]) -> u32 {
    candidate.get(1).map_or(0, |&payload_len| u32::from(payload_len)).saturating_add(const { HEADER_COST + 10 })
}

/// Converts a length within the buffer.
#[allow(clippy::as_conversions, reason = "the argument is no longer than the buffer")]
const fn position(len: usize) -> Position {
    len as Position
}

#[allow(clippy::as_conversions, reason = "`usize` has no `From<u32>`; all supported targets have 32 bits or more")]
const fn index(position: Position) -> usize {
    position as usize
}

fn duration(micros: u32) -> Duration {
    if micros == u32::MAX { Duration::MAX } else { Duration::from_micros(u64::from(micros)) }
}

#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; the value is bounded")]
const fn micros(duration: Duration) -> u32 {
    if duration.as_micros() < u32::MAX as u64 { duration.as_micros() as u32 } else { u32::MAX }
}
