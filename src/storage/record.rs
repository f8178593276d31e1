//! One record that is replaced as a whole: two slots, of which one always keeps what was complete before.
//!
//! The bytes are described in `layout.md` beside this file, which is a part of [`PlanStore`](super::PlanStore)'s
//! documentation.
//!
//! Of two whole records the newer counts. The other slot is the spare: it is erased ahead of need, its header first, then
//! written, its header last. So whatever moment the power goes, one slot has a record that was whole before, or the other
//! one has the new one:
//!
//! - while the spare is erased, it has an older record, or none; what is left of a body does not match its CRC, and
//!   without its header it is nothing;
//! - while the body is written, there is no header;
//! - a torn header does not match its own CRC.
//!
//! A record of a schema that this version does not know is kept as long as any other.
//!
//! What a power cut cannot have left is damage, and never counts as empty (G-18): a header of ours that is wrong while there is no
//! whole record, and a newer header whose body does not match. It is left alone until a record replaces it. What never was ours is
//! no damage: the slot counts as blank.
//!
//! What cannot be read may be the newest record. So nothing counts until it was read, or until several looks failed: then a slot
//! with an unreadable header is torn, if the other one has a whole record. A whole record that the owner has not read is never
//! replaced.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use crate::crc32::Crc32;
use crate::time::{Duration, Instant};

/// The most that is written at once; every unit that storage may be written in divides it.
pub(crate) const CHUNK: usize = 256;
/// The most that is read at once: it is on the stack where that is deepest.
const PIECE: usize = 128;
/// Bodies come in rows of so many bytes; every unit that storage may be read in divides it.
pub(crate) const ROW: usize = 32;
/// Where the body begins in its slot: the header can be written alone.
pub(crate) const BODY: u32 = 256;

const MAGIC: [u8; 4] = *b"MVSR";

/// Ends the use of a buffer on the stack that a body went through. The signing key does so too: so it is overwritten (SEC-15).
/// A guard would do that by itself, and be moved to its place: the buffer would be on the stack twice.
pub(super) fn wipe(buffer: &mut [u8]) {
    #[cfg(feature = "signing")]
    zeroize::Zeroize::zeroize(buffer);
    #[cfg(not(feature = "signing"))]
    let _ = buffer;
}

/// What one [`step`](Record::step) did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Nothing: there is nothing to do.
    Idle,
    /// A part; there is more to do.
    Busy,
    /// The last part: the record is complete, and was read back. Once a job.
    Done,
    /// The storage failed, or the content has no room. The next step begins anew.
    Failed,
    /// What could not be read before can be read now, or is given up: the owner is to read. Nothing was written.
    Unread,
}

/// Why stored content was not restored, or not completely. A text reports it too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RestoreError<E> {
    /// The storage, or a part of it that may hold the newest record, could not be read, and reported this. Nothing stored is in
    /// use. `persist_…` reads again, at most once a second, and before anything is written: what can be read then comes back late.
    /// When only one of the two copies stays unreadable, the other one comes back after three seconds.
    Storage(E),
    /// The newest record is damaged. Plans and parameters of an older record that is whole are in use. The damage stays there until
    /// something new is stored.
    Damaged,
    /// The stored data is whole, but has a layout that this version does not know, because newer firmware wrote it. It stays
    /// there until something new is stored.
    Foreign,
}

impl<E> From<E> for RestoreError<E> {
    fn from(error: E) -> Self {
        Self::Storage(error)
    }
}

impl<E: core::fmt::Debug> core::fmt::Display for RestoreError<E> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Storage(error) => write!(f, "the storage cannot be read: {error:?}"),
            Self::Damaged => f.write_str("what is stored is damaged: set it again"),
            Self::Foreign => f.write_str("newer firmware stored it: install that, or set it again"),
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for RestoreError<E> {}

/// What is to be durable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Job {
    /// Another number is another content.
    pub(crate) id: u32,
    pub(crate) schema: u16,
    /// Bytes: a multiple of [`ROW`].
    pub(crate) len: u32,
}

/// The newest whole record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Newest {
    /// Address of its slot.
    slot: u32,
    header: Header,
}

/// What a header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Header {
    pub(crate) schema: u16,
    pub(crate) sequence: u32,
    pub(crate) len: u32,
    pub(crate) body_crc: u32,
}

impl Header {
    pub(crate) fn encode(&self, kind: u8) -> [u8; ROW] {
        let [m0, m1, m2, m3] = MAGIC;
        let [v0, v1] = self.schema.to_le_bytes();
        let words = [
            u32::from_le_bytes([m0, m1, m2, m3]),
            u32::from_le_bytes([kind, 0, v0, v1]),
            self.sequence,
            self.len,
            self.body_crc,
            0,
            0,
        ];
        let mut crc = Crc32::new();
        let mut row = [0; ROW];
        let (places, _) = row.as_chunks_mut();
        for (place, word) in places.iter_mut().zip(words) {
            *place = word.to_le_bytes();
            crc.add(place);
        }
        if let Some(place) = places.last_mut() {
            *place = crc.sum().to_le_bytes();
        }
        row
    }

    /// The header, when it is one of this kind and undamaged. A power cut in its last bytes leaves them erased: then the CRC of the
    /// body has to do, which was complete before.
    pub(crate) fn decode(row: &[u8; ROW], kind: u8) -> Option<Self> {
        let (words, _) = row.as_chunks();
        let &[_, what, sequence, len, body_crc, ..] = words else { return None };
        let [_, _, v0, v1] = what;
        let header = Self {
            schema: u16::from_le_bytes([v0, v1]),
            sequence: u32::from_le_bytes(sequence),
            len: u32::from_le_bytes(len),
            body_crc: u32::from_le_bytes(body_crc),
        };
        // Magic, kind, zeros and CRC in one.
        let expected = header.encode(kind);
        let is_right =
            |(index, (byte, expected)): (usize, (&u8, &u8))| byte == expected || (index > 28 && *byte == 0xFF);
        row.iter().zip(&expected).enumerate().all(is_right).then_some(header)
    }
}

/// Whether a header that does not [decode](Header::decode) is damage: it was one, and does not end erased as one that a power cut
/// has left. Bytes that never were ours pass for one once in 300,000 times.
fn was_header(row: &[u8; ROW], kind: u8) -> bool {
    let [m0, m1, m2, m3, what, ..] = row;
    // Not `count`, whose overflow check the compiler cannot remove.
    let right = [m0, m1, m2, m3]
        .into_iter()
        .zip(&MAGIC)
        .fold(0_u8, |right, (byte, expected)| right.saturating_add(u8::from(byte == expected)));
    (right == 4 || right >= 2 && (what ^ kind).count_ones() <= 1) && !row.ends_with(&[0xFF; 4])
}

/// Whether the record of sequence `a` was written after that of `b`.
pub(crate) fn is_newer(a: u32, b: u32) -> bool {
    a.wrapping_sub(b).cast_signed() > 0
}

/// The content of a slot.
#[derive(Clone, Copy, Debug)]
enum Slot {
    /// No header of ours: never written, or erased; or the beginning of one, which a power cut left.
    Blank,
    Whole(Newest),
    /// It was a header, or its body does not match; the sequence, where the header tells one.
    Damaged(Option<u32>),
    /// The storage refused; the sequence, if the header could be read.
    Unreadable(Option<u32>),
}

impl Slot {
    const fn whole(self) -> Option<Newest> {
        match self {
            Self::Whole(found) => Some(found),
            _ => None,
        }
    }

    const fn sequence(self) -> Option<u32> {
        match self {
            Self::Blank => None,
            Self::Whole(found) => Some(found.header.sequence),
            Self::Damaged(sequence) | Self::Unreadable(sequence) => sequence,
        }
    }

    /// Whether this may be newer than `newest`, and could not be read.
    fn is_unreadable(self, newest: Option<Newest>) -> bool {
        match (self, newest) {
            (Self::Unreadable(Some(sequence)), Some(newest)) => is_newer(sequence, newest.header.sequence),
            (Self::Unreadable(_), _) => true,
            _ => false,
        }
    }

    /// Whether a power cut cannot have left this next to `newest`.
    fn is_damage(self, newest: Option<Newest>) -> bool {
        match (self, newest) {
            (Self::Damaged(_), None) => true,
            (Self::Damaged(Some(sequence)), Some(newest)) => is_newer(sequence, newest.header.sequence),
            _ => false,
        }
    }
}

/// After so many looks a slot that cannot be read is torn, if the other one has a whole record.
const LOOKS: u8 = 4;
/// From one look to the next.
const LOOK_PAUSE: Duration = Duration::from_secs(1);
/// The same after [`LOOKS`].
const LONG_PAUSE: Duration = Duration::from_secs(10);

/// What is known of the slot that the next record goes to.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Spare {
    /// Nothing is known, not even which slot it is.
    Unknown,
    /// It could not be erased or read, or its content is damaged. Not touched until there is something to write.
    Failing,
    /// Erased up to this offset.
    Dirty(u32),
    Blank,
    /// So many bytes of this job's body are written.
    Writing {
        job: Job,
        written: u32,
        crc: Crc32,
    },
}

/// The two slots of a record, and where the writing of the next one stands.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Record<F> {
    pub(crate) flash: F,
    start: u32,
    slot_len: u32,
    kind: u8,
    newest: Option<Newest>,
    /// The sequence of the newest header, even if its record is damaged.
    sequence: Option<u32>,
    /// Address of the spare slot.
    spare_slot: u32,
    spare: Spare,
    /// The job that is done, as long as it is asked for.
    done: Option<u32>,
    /// How many slots could not be read that may have the newest record.
    unreadable: u8,
    /// What is newest was not read as a whole: to be [looked at again](Self::look_again).
    is_unread: bool,
    is_damaged: bool,
    /// How many looks are left until a slot that cannot be read is torn.
    looks: u8,
    /// The next look is not before.
    look_from: Instant,
}

impl<F: NorFlash> Record<F> {
    #[allow(clippy::as_conversions, reason = "const-evaluated; checked below")]
    pub(crate) const ERASE: u32 = {
        assert!(F::WRITE_SIZE > 0 && CHUNK.is_multiple_of(F::WRITE_SIZE), "WRITE_SIZE must divide 256");
        assert!(F::READ_SIZE > 0 && ROW.is_multiple_of(F::READ_SIZE), "READ_SIZE must divide 32");
        assert!(F::ERASE_SIZE > 0 && F::ERASE_SIZE <= 1 << 30, "ERASE_SIZE must be 1 to 2^30");
        assert!(F::ERASE_SIZE.is_multiple_of(F::WRITE_SIZE), "ERASE_SIZE must be a multiple of WRITE_SIZE");
        F::ERASE_SIZE as u32
    };

    /// The region is divided in two halves; what does not fill whole erase units is not used.
    pub(crate) const fn new(flash: F, region: Range<u32>, kind: u8) -> Self {
        let start = match region.start.checked_next_multiple_of(Self::ERASE) {
            Some(start) => start,
            None => u32::MAX,
        };
        let half = region.end.saturating_sub(start) / 2;
        let slot_len = match half.checked_rem(Self::ERASE) {
            Some(rest) => half.saturating_sub(rest),
            None => 0,
        };
        Self {
            flash,
            start,
            slot_len,
            kind,
            newest: None,
            sequence: None,
            spare_slot: start,
            spare: Spare::Unknown,
            done: None,
            unreadable: 0,
            is_unread: false,
            is_damaged: false,
            looks: LOOKS,
            look_from: Instant::ZERO,
        }
    }

    /// Length of a slot whose body has `len` bytes.
    pub(crate) const fn slot_len(len: u32) -> u32 {
        match BODY.saturating_add(len).checked_next_multiple_of(Self::ERASE) {
            Some(len) => len,
            None => u32::MAX,
        }
    }

    /// Finds the newest whole record.
    ///
    /// # Errors
    ///
    /// What may be the newest record cannot be read; after [`LOOKS`] that is no error if only the header of one slot cannot, and the
    /// other one has a whole record: a power cut leaves that where memory has error correction. Or neither slot has a whole
    /// record, and one is damaged. Where there is one beside damage, [`is_damaged`](Self::is_damaged) says so.
    pub(crate) fn open(&mut self) -> Result<Option<Header>, RestoreError<F::Error>> {
        let mut error = None;
        let first = self.examine(self.start, &mut error);
        let second = self.examine(self.second_slot(), &mut error);
        self.judge([first, second], error)
    }

    /// Address of the second slot.
    const fn second_slot(&self) -> u32 {
        self.start.saturating_add(self.slot_len)
    }

    /// Decides by the content of both slots what is the newest record. Not inlined: its stack is not needed while slots are read.
    #[inline(never)]
    fn judge(&mut self, slots: [Slot; 2], error: Option<F::Error>) -> Result<Option<Header>, RestoreError<F::Error>> {
        let second_slot = self.second_slot();
        let newer = |a: Option<u32>, b: Option<u32>| match (a, b) {
            (Some(a), Some(b)) => Some(if is_newer(b, a) { b } else { a }),
            _ => a.or(b),
        };
        self.done = None;
        self.sequence = slots.iter().map(|slot| slot.sequence()).fold(None, newer);
        self.newest = match slots.map(Slot::whole) {
            [Some(first), Some(second)] if is_newer(second.header.sequence, first.header.sequence) => Some(second),
            [first, second] => first.or(second),
        };
        let newest = self.newest;
        self.unreadable = slots.iter().map(|slot| u8::from(slot.is_unreadable(newest))).fold(0, u8::saturating_add);
        if self.unreadable == 0 {
            self.looks = LOOKS;
        }
        let is_torn = self.looks == 0 && newest.is_some();
        self.is_unread = self.unreadable > 0 && !is_torn;
        // A body that stays unreadable under a good header is not what a power cut leaves.
        let is_damage = |slot: &Slot| match slot {
            Slot::Unreadable(Some(_)) => is_torn && slot.is_unreadable(newest),
            _ => slot.is_damage(newest),
        };
        self.is_damaged = slots.iter().any(is_damage);
        // What cannot be read now, or not any more, is left alone until there is something to write.
        let is_left_alone = self.unreadable > 0 || self.is_damaged;
        self.spare = if is_left_alone { Spare::Failing } else { Spare::Dirty(0) };
        self.spare_slot = match (newest, slots) {
            (Some(newest), _) if newest.slot == self.start => second_slot,
            // Damage outlasts what replaces it, and what cannot be read is replaced first: erasing may mend that.
            (None, [Slot::Blank | Slot::Damaged(_), Slot::Unreadable(_)] | [Slot::Damaged(_), Slot::Blank]) => {
                second_slot
            }
            _ => self.start,
        };
        match error {
            Some(error) if self.is_unread => Err(RestoreError::Storage(error)),
            _ if newest.is_none() && self.is_damaged => Err(RestoreError::Damaged),
            _ => Ok(newest.map(|newest| newest.header)),
        }
    }

    /// What lies in a slot.
    fn examine(&mut self, slot: u32, error: &mut Option<F::Error>) -> Slot {
        if self.slot_len < BODY {
            return Slot::Blank;
        }
        match self.header_at(slot, error) {
            Ok(header) => self.check_body(slot, header, error),
            Err(content) => content,
        }
    }

    /// The header of a slot, or what else is there. Not inlined: its stack is free again when the body is read.
    #[inline(never)]
    fn header_at(&mut self, slot: u32, error: &mut Option<F::Error>) -> Result<Header, Slot> {
        let mut row = [0; ROW];
        if let Err(failure) = self.flash.read(slot, &mut row) {
            *error = Some(failure);
            return Err(Slot::Unreadable(None));
        }
        let is_damage = was_header(&row, self.kind);
        Header::decode(&row, self.kind).ok_or(if is_damage { Slot::Damaged(None) } else { Slot::Blank })
    }

    /// What a slot with this header holds.
    #[inline(never)]
    fn check_body(&mut self, slot: u32, header: Header, error: &mut Option<F::Error>) -> Slot {
        let mut crc = Crc32::new();
        let add = |bytes: &[u8]| {
            crc.add(bytes);
            true
        };
        if self.is_len(header.len)
            && let Err(failure) = self.scan(slot.saturating_add(BODY), header.len, add)
        {
            *error = Some(failure);
            return Slot::Unreadable(Some(header.sequence));
        }
        if self.is_len(header.len) && crc.sum() == header.body_crc {
            Slot::Whole(Newest { slot, header })
        } else {
            Slot::Damaged(Some(header.sequence))
        }
    }

    /// Whether a body can have this length.
    fn is_len(&self, len: u32) -> bool {
        const MIN: u32 = 32;
        len >= MIN && len.is_multiple_of(MIN) && len <= self.slot_len.saturating_sub(BODY)
    }

    /// Reads `len` bytes, until `each` says that it has seen enough.
    fn scan(&mut self, at: u32, len: u32, mut each: impl FnMut(&[u8]) -> bool) -> Result<bool, F::Error> {
        let mut piece = [0; PIECE];
        let mut done = 0;
        let mut result = Ok(true);
        while done < len && matches!(result, Ok(true)) {
            let part = clamped(len.saturating_sub(done), PIECE);
            let bytes = piece.get_mut(..part).unwrap_or_default();
            result = self.flash.read(at.saturating_add(done), bytes).map(|()| each(bytes));
            done = done.saturating_add(u32::try_from(part).unwrap_or(u32::MAX));
        }
        wipe(&mut piece);
        result
    }

    /// Whether a slot could not be read.
    pub(crate) const fn is_impaired(&self) -> bool {
        self.unreadable > 0
    }

    /// Whether a [`step`](Self::step) reads again what could not be read, and does nothing else.
    pub(crate) const fn is_unread(&self) -> bool {
        self.is_unread && matches!(self.spare, Spare::Failing)
    }

    /// Whether there is damage that no power cut leaves.
    pub(crate) const fn is_damaged(&self) -> bool {
        self.is_damaged
    }

    /// A row of the newest record's body.
    pub(crate) fn row(&mut self, index: u32) -> Result<Option<[u8; ROW]>, F::Error> {
        let Some(Newest { slot, header }) = self.newest else { return Ok(None) };
        if index >= header.len / 32 {
            return Ok(None);
        }
        let mut row = [0; ROW];
        let read = self.flash.read(slot.saturating_add(BODY).saturating_add(index.saturating_mul(32)), &mut row);
        if read.is_err() {
            // That comes first.
            (self.is_unread, self.spare) = (true, Spare::Failing);
        }
        read.map(|()| Some(row))
    }

    /// Erases at most one unit or writes at most [`CHUNK`] bytes, towards a record that is what `job` says, or, without
    /// one, towards a blank spare slot. `row` gives a row of the body; `None` gives the job up.
    pub(crate) fn step(&mut self, now: Instant, job: Option<Job>, row: impl FnMut(u32) -> Option<[u8; ROW]>) -> Step {
        if job.is_none() || self.done != job.map(|job| job.id) {
            self.done = None;
        }
        let job = job.filter(|_| self.done.is_none());
        // No room; without a job, not even for the shortest record.
        if !self.is_len(job.map_or(32, |job| job.len)) {
            return if job.is_some() { Step::Failed } else { Step::Idle };
        }
        match (self.spare, job) {
            (Spare::Unknown, _) => {
                // Without a record it begins one; an error here comes again from what is done next.
                let _ = self.open();
                Step::Busy
            }
            (Spare::Failing, job) if self.is_unread => self.look_again(now, job.is_some()),
            (Spare::Failing | Spare::Blank, None) => Step::Idle,
            (Spare::Failing, Some(_)) => {
                self.spare = Spare::Dirty(0);
                Step::Busy
            }
            (Spare::Dirty(done), _) => self.clear(done),
            (Spare::Blank, Some(job)) => self.write(job, 0, Crc32::new(), row),
            (Spare::Writing { job: begun, written, crc }, Some(job)) if begun == job => {
                if written < job.len {
                    self.write(job, written, crc, row)
                } else {
                    self.finish(job, crc)
                }
            }
            // Something else is wanted now.
            (Spare::Writing { .. }, _) => self.clear(0),
        }
    }

    /// Reads what could not be read before, at most once a second. After [`LOOKS`], when there is something to write, a slot that
    /// still cannot be read is given up; not both, for one of them has what was complete.
    #[inline(never)]
    fn look_again(&mut self, now: Instant, is_wanted: bool) -> Step {
        if now < self.look_from {
            return Step::Idle;
        }
        self.looks = self.looks.saturating_sub(1);
        self.look_from = now.after(if self.looks > 0 { LOOK_PAUSE } else { LONG_PAUSE });
        let _ = self.open();
        if !self.is_unread {
            // Also that there is nothing is worth knowing.
            return if self.newest.is_some() || !is_wanted { Step::Unread } else { Step::Busy };
        }
        match self.unreadable {
            _ if !is_wanted => return Step::Idle,
            1 if self.looks == 0 => self.spare = Spare::Dirty(0),
            1 => {}
            _ => return Step::Failed,
        }
        Step::Busy
    }

    /// Erases the next unit of the spare slot, unless it is blank.
    fn clear(&mut self, offset: u32) -> Step {
        let at = self.spare_slot.saturating_add(offset);
        let next = offset.saturating_add(Self::ERASE);
        // What cannot be read is not blank.
        let is_blank = self.scan(at, Self::ERASE, |bytes| bytes.iter().all(|byte| *byte == 0xFF)).unwrap_or(false);
        if !is_blank && self.flash.erase(at, at.saturating_add(Self::ERASE)).is_err() {
            self.spare = Spare::Failing;
            return Step::Failed;
        }
        self.spare = if next < self.slot_len { Spare::Dirty(next) } else { Spare::Blank };
        Step::Busy
    }

    /// Writes the next chunk of the body.
    fn write(&mut self, job: Job, written: u32, mut crc: Crc32, mut row: impl FnMut(u32) -> Option<[u8; ROW]>) -> Step {
        // Whatever fails, the slot has to be erased again.
        self.spare = Spare::Dirty(0);
        let mut chunk = [0xFF; CHUNK];
        let mut is_whole = true;
        for (index, place) in (written / 32..job.len / 32).zip(chunk.as_chunks_mut::<ROW>().0) {
            let Some(bytes) = row(index) else {
                is_whole = false;
                break;
            };
            *place = bytes;
            crc.add(place);
        }
        let step = if is_whole { self.write_chunk(job, written, crc, &chunk) } else { Step::Failed };
        wipe(&mut chunk);
        step
    }

    fn write_chunk(&mut self, job: Job, written: u32, crc: Crc32, chunk: &[u8; CHUNK]) -> Step {
        let len = clamped(job.len.saturating_sub(written), CHUNK);
        let bytes = chunk.get(..len.next_multiple_of(F::WRITE_SIZE)).unwrap_or_default();
        let at = self.spare_slot.saturating_add(BODY).saturating_add(written);
        if self.flash.write(at, bytes).is_err() || !self.reads_back(at, bytes) {
            return Step::Failed;
        }
        self.spare = Spare::Writing { job, written: written.saturating_add(BODY), crc };
        Step::Busy
    }

    /// Writes the header: with it the spare slot has the newest record.
    #[inline(never)]
    fn finish(&mut self, job: Job, crc: Crc32) -> Step {
        // Whatever fails, the slot has to be erased again.
        self.spare = Spare::Dirty(0);
        let mut chunk = [0xFF; CHUNK];
        let slot = self.spare_slot;
        let sequence = self.sequence.map_or(1, |sequence| sequence.wrapping_add(1));
        let header = Header { schema: job.schema, sequence, len: job.len, body_crc: crc.sum() };
        if let Some(place) = chunk.first_chunk_mut::<ROW>() {
            *place = header.encode(self.kind);
        }
        let bytes = chunk.get(..ROW.next_multiple_of(F::WRITE_SIZE)).unwrap_or_default();
        // Whatever the driver says: after a restart counts what can be read.
        let _ = self.flash.write(slot, bytes);
        if !self.reads_back(slot, bytes) {
            return Step::Failed;
        }
        self.spare_slot = match self.newest {
            Some(newest) => newest.slot,
            None if slot == self.start => self.start.saturating_add(self.slot_len),
            None => self.start,
        };
        self.newest = Some(Newest { slot, header });
        self.sequence = Some(sequence);
        (self.unreadable, self.is_unread, self.is_damaged) = (0, false, false);
        self.looks = LOOKS;
        self.done = Some(job.id);
        Step::Done
    }

    fn reads_back(&mut self, at: u32, bytes: &[u8]) -> bool {
        let mut at = at;
        let mut row = [0; ROW];
        let (rows, _) = bytes.as_chunks::<ROW>();
        let is_same = rows.iter().all(|expected| {
            let is_same = self.flash.read(at, &mut row).is_ok() && row == *expected;
            at = at.saturating_add(32);
            is_same
        });
        wipe(&mut row);
        is_same
    }
}

fn clamped(len: u32, most: usize) -> usize {
    usize::try_from(len).unwrap_or(most).min(most)
}
