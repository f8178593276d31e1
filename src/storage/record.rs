//! A record that is replaced as a whole: two slots, of which one always has a complete record.
//!
//! `layout.md` in this folder, a part of the documentation of [`Store`](super::Store), documents the format. The log of
//! records that replaces the two slots needs no more of this file's interface than [`open`](Record::open),
//! [`row`](Record::row), [`step`](Record::step) and [`write`](Record::write).
//!
//! Of two whole records the newer one is valid. The other slot is the spare. It is erased in advance, its header first;
//! then it is written, its header last. So if power fails at any moment, one slot has a whole record:
//!
//! - While the spare is erased, it has an older record or none. The rest of a body does not match its CRC, and a slot
//!   without a header is empty.
//! - While the body is written, there is no header.
//! - A torn header does not match its own CRC.
//!
//! A record of an unknown schema version is kept like any other.
//!
//! What a power cut cannot leave is damage, and never counts as empty (G-18): a wrong header if there is no whole
//! record, and a newer header whose body does not match. Damage remains until a record replaces it. Data that never was
//! a record is not damage: the slot counts as blank.
//!
//! A slot that cannot be read may have the newest record. So no record is valid until it was read, or until several
//! attempts have failed. Then a slot with an unreadable header is torn, if the other slot has a whole record. A whole
//! record that the owner has not read is never replaced.

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use crate::crc32::Crc32;
use crate::time::{Duration, Instant};

/// Maximum length of a write in bytes, a multiple of `WRITE_SIZE`.
pub(crate) const CHUNK: usize = 256;
/// Maximum length of a read in bytes. The buffer lies on the stack where that is deepest.
const PIECE: usize = 128;
/// Length of a body's row in bytes, a multiple of `READ_SIZE`.
pub(crate) const ROW: usize = 32;
/// Offset of the body in its slot, so that the header can be written separately.
pub(crate) const BODY: u32 = 256;

const MAGIC: [u8; 4] = *b"MVSR";

/// Overwrites a buffer that has held a part of a body, which may be the signing key (SEC-15). A drop guard would do it
/// automatically, but would be moved, so that the buffer would be on the stack twice.
pub(super) fn wipe(buffer: &mut [u8]) {
    #[cfg(feature = "signing")]
    zeroize::Zeroize::zeroize(buffer);
    #[cfg(not(feature = "signing"))]
    let _ = buffer;
}

/// The result of a [`step`](Record::step).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// There was nothing to do.
    Idle,
    /// A part is done, and more is to do.
    Busy,
    /// The record is complete, and was read back. Returned once for each job.
    Done,
    /// The storage failed, or the content does not fit. The next step starts again.
    Failed,
    /// A slot that could not be read can be read now, or is given up: the owner must read the record. Nothing was
    /// written.
    Unread,
    /// The part of the body that begins at this row is next: the owner must call [`write`](Record::write) with it.
    Write(u32),
}

/// Why stored data was not restored, or not completely. A STATUSTEXT reports it, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum RestoreError<E> {
    /// The storage, or a part of it that may have the newest record, could not be read. No stored data is in use.
    ///
    /// `persist` reads again, at most once a second, before it writes: data that can be read then is restored late.
    /// If only one of the two slots remains unreadable, the other one is restored after three seconds.
    Storage(E),
    /// The newest record is damaged. Plans and parameters are restored from the older record if it is whole. The
    /// damaged data remains until new data is stored.
    Damaged,
    /// The stored data is whole, but newer firmware wrote it in a format that this version does not know. It remains
    /// until new data is stored.
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
            Self::Storage(error) => write!(f, "the storage cannot be read, reading is repeated: {error:?}"),
            Self::Damaged => f.write_str("the stored data is damaged: store it again"),
            Self::Foreign => {
                f.write_str("newer firmware wrote the stored data: install that firmware, or store it again")
            }
        }
    }
}

impl<E: core::fmt::Debug> core::error::Error for RestoreError<E> {}

/// The content that is to be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Job {
    /// Stands for the content: other content has another number.
    pub(crate) id: u32,
    /// Length in bytes: a multiple of [`ROW`].
    pub(crate) len: u32,
}

/// The kind of a record, and the version of its body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Format {
    pub(crate) kind: u8,
    pub(crate) schema: u16,
}

/// The newest whole record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Newest {
    /// Address of its slot.
    slot: u32,
    header: Header,
}

/// The fields of a header.
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

    /// Decodes a header; `None` if it is of another kind or damaged. A power cut may leave its last bytes erased: then
    /// the CRC of the body suffices, which was complete before.
    pub(crate) fn decode(row: &[u8; ROW], kind: u8) -> Option<Self> {
        let (words, _) = row.as_chunks();
        let &[_, kind_and_schema, sequence, len, body_crc, ..] = words else { return None };
        let [_, _, v0, v1] = kind_and_schema;
        let header = Self {
            schema: u16::from_le_bytes([v0, v1]),
            sequence: u32::from_le_bytes(sequence),
            len: u32::from_le_bytes(len),
            body_crc: u32::from_le_bytes(body_crc),
        };
        // Compares magic, kind, zeros and CRC at once.
        let expected = header.encode(kind);
        let is_valid =
            |(index, (byte, expected)): (usize, (&u8, &u8))| byte == expected || (index > 28 && *byte == 0xFF);
        row.iter().zip(&expected).enumerate().all(is_valid).then_some(header)
    }
}

/// Returns whether a header that does not [decode](Header::decode) is damage: it was a header, and does not end with
/// erased bytes as after a power cut. Other data is taken for a header with a probability of 1 in 300,000.
fn was_header(row: &[u8; ROW], kind: u8) -> bool {
    let [m0, m1, m2, m3, stored_kind, ..] = row;
    // Not `count`, whose overflow check the compiler cannot remove.
    let matches = [m0, m1, m2, m3]
        .into_iter()
        .zip(&MAGIC)
        .fold(0_u8, |matches, (byte, expected)| matches.saturating_add(u8::from(byte == expected)));
    (matches == 4 || matches >= 2 && (stored_kind ^ kind).count_ones() <= 1) && !row.ends_with(&[0xFF; 4])
}

/// Returns whether the record with sequence number `a` is newer than that with `b`.
pub(crate) fn is_newer(a: u32, b: u32) -> bool {
    a.wrapping_sub(b).cast_signed() > 0
}

/// The content of a slot.
#[derive(Clone, Copy, Debug)]
enum Slot {
    /// No header: never written, erased, or the front of a header after a power cut.
    Blank,
    Whole(Newest),
    /// A damaged header, or a body that does not match; with the sequence number if the header is valid.
    Damaged(Option<u32>),
    /// Reading failed; with the sequence number if the header could be read.
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

    /// Returns whether the slot could not be read, and may be newer than `newest`.
    fn is_unreadable(self, newest: Option<Newest>) -> bool {
        match (self, newest) {
            (Self::Unreadable(Some(sequence)), Some(newest)) => is_newer(sequence, newest.header.sequence),
            (Self::Unreadable(_), _) => true,
            _ => false,
        }
    }

    /// Returns whether the slot is damaged: a power cut cannot leave it beside `newest`.
    fn is_damage(self, newest: Option<Newest>) -> bool {
        match (self, newest) {
            (Self::Damaged(_), None) => true,
            (Self::Damaged(Some(sequence)), Some(newest)) => is_newer(sequence, newest.header.sequence),
            _ => false,
        }
    }
}

/// After this many attempts, a slot that cannot be read is torn, if the other slot has a whole record.
const READ_ATTEMPTS: u8 = 4;
/// The time between two attempts.
const RETRY_PAUSE: Duration = Duration::from_secs(1);
/// The time between attempts after the first [`READ_ATTEMPTS`].
const LONG_RETRY_PAUSE: Duration = Duration::from_secs(10);

/// The state of the slot for the next record.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Spare {
    /// Neither its state nor which slot it is is known.
    Unknown,
    /// It could not be erased or read, or its content is damaged. It is not changed until there is something to write.
    Failing,
    /// Erased up to this offset.
    Dirty(u32),
    Blank,
    /// `written` bytes of this job's body are written.
    Writing {
        job: Job,
        written: u32,
        crc: Crc32,
    },
}

/// The two slots of a record, and the progress of writing the next one.
#[derive(Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Record {
    start: u32,
    slot_len: u32,
    format: Format,
    newest: Option<Newest>,
    /// The sequence number of the newest header, even if its record is damaged.
    sequence: Option<u32>,
    /// Address of the spare slot.
    spare_slot: u32,
    spare: Spare,
    /// The job that is done, while it is still passed to [`step`](Self::step).
    done: Option<u32>,
    /// Number of slots that could not be read and may have the newest record.
    unreadable: u8,
    /// Whether the newest record was not read completely, so that [reading is repeated](Self::retry_reading).
    is_unread: bool,
    is_damaged: bool,
    /// Number of attempts left until a slot that cannot be read is torn.
    attempts_left: u8,
    /// The earliest time of the next attempt.
    retry_from: Instant,
}

/// The erase unit of a storage.
struct Units<F>(core::marker::PhantomData<F>);

impl<F: NorFlash> Units<F> {
    #[allow(clippy::as_conversions, reason = "const-evaluated; checked below")]
    const ERASE: u32 = {
        assert!(F::WRITE_SIZE > 0 && CHUNK.is_multiple_of(F::WRITE_SIZE), "WRITE_SIZE must divide 256");
        assert!(F::READ_SIZE > 0 && ROW.is_multiple_of(F::READ_SIZE), "READ_SIZE must divide 32");
        assert!(F::ERASE_SIZE > 0 && F::ERASE_SIZE <= 1 << 30, "ERASE_SIZE must be 1 to 2^30");
        assert!(F::ERASE_SIZE.is_multiple_of(F::WRITE_SIZE), "ERASE_SIZE must be a multiple of WRITE_SIZE");
        F::ERASE_SIZE as u32
    };
}

/// Returns the address of the first erase unit that begins at or after this one.
const fn aligned<F: NorFlash>(at: u32) -> u32 {
    match at.checked_next_multiple_of(Units::<F>::ERASE) {
        Some(at) => at,
        None => u32::MAX,
    }
}

impl Record {
    /// A record without storage: nothing is read or written.
    pub(crate) const NONE: Self = Self {
        start: 0,
        slot_len: 0,
        format: Format { kind: 0, schema: 0 },
        newest: None,
        sequence: None,
        spare_slot: 0,
        spare: Spare::Unknown,
        done: None,
        unreadable: 0,
        is_unread: false,
        is_damaged: false,
        attempts_left: READ_ATTEMPTS,
        retry_from: Instant::ZERO,
    };

    /// Divides the region into two slots. The rest that does not fill whole erase units is not used.
    pub(crate) const fn new<F: NorFlash>(region: Range<u32>, format: Format) -> Self {
        let start = aligned::<F>(region.start);
        let half = region.end.saturating_sub(start) / 2;
        let slot_len = match half.checked_rem(Units::<F>::ERASE) {
            Some(rest) => half.saturating_sub(rest),
            None => 0,
        };
        Self { start, slot_len, format, spare_slot: start, ..Self::NONE }
    }

    /// Returns the length of the region for a body of up to `len` bytes: a multiple of two erase units, or nothing.
    pub(crate) const fn region_len<F: NorFlash>(len: u32) -> u32 {
        if len == 0 { 0 } else { aligned::<F>(BODY.saturating_add(len)).saturating_mul(2) }
    }

    /// Finds the newest whole record.
    ///
    /// # Errors
    ///
    /// - [`Storage`](RestoreError::Storage): a slot that may have the newest record cannot be read. After
    ///   [`READ_ATTEMPTS`] it is no error if the other slot has a whole record: memory with error correction refuses to
    ///   read what a power cut has left.
    /// - [`Damaged`](RestoreError::Damaged): neither slot has a whole record, and one is damaged. If there is a whole
    ///   record beside the damage, [`is_damaged`](Self::is_damaged) returns true instead.
    /// - [`Foreign`](RestoreError::Foreign): the newest record has another schema version.
    pub(crate) fn open<F: NorFlash>(&mut self, flash: &mut F) -> Result<Option<Header>, RestoreError<F::Error>> {
        let mut error = None;
        let first = self.examine(flash, self.start, &mut error);
        let second = self.examine(flash, self.second_slot(), &mut error);
        match self.judge([first, second], error)? {
            Some(header) if header.schema != self.format.schema => Err(RestoreError::Foreign),
            header => Ok(header),
        }
    }

    /// Returns the address of the second slot.
    const fn second_slot(&self) -> u32 {
        self.start.saturating_add(self.slot_len)
    }

    /// Determines the newest record from both slots. Not inlined: its stack is not needed while slots are read.
    #[inline(never)]
    fn judge<E>(&mut self, slots: [Slot; 2], error: Option<E>) -> Result<Option<Header>, RestoreError<E>> {
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
            self.attempts_left = READ_ATTEMPTS;
        }
        let is_torn = self.attempts_left == 0 && newest.is_some();
        self.is_unread = self.unreadable > 0 && !is_torn;
        // A power cut does not leave a valid header with an unreadable body.
        let is_damage = |slot: &Slot| match slot {
            Slot::Unreadable(Some(_)) => is_torn && slot.is_unreadable(newest),
            _ => slot.is_damage(newest),
        };
        self.is_damaged = slots.iter().any(is_damage);
        // Unreadable or damaged data is not erased until there is something to write.
        let is_failing = self.unreadable > 0 || self.is_damaged;
        self.spare = if is_failing { Spare::Failing } else { Spare::Dirty(0) };
        self.spare_slot = match (newest, slots) {
            (Some(newest), _) if newest.slot == self.start => second_slot,
            // Damaged data is kept until the first record is complete. An unreadable slot is used first, because
            // erasing may repair it.
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

    /// Returns the content of a slot.
    fn examine<F: NorFlash>(&self, flash: &mut F, slot: u32, error: &mut Option<F::Error>) -> Slot {
        if self.slot_len < BODY {
            return Slot::Blank;
        }
        match self.header_at(flash, slot, error) {
            Ok(header) => self.check_body(flash, slot, header, error),
            Err(content) => content,
        }
    }

    /// Reads the header of a slot. Not inlined, so that its stack is free when the body is read.
    #[inline(never)]
    fn header_at<F: NorFlash>(&self, flash: &mut F, slot: u32, error: &mut Option<F::Error>) -> Result<Header, Slot> {
        let mut row = [0; ROW];
        if let Err(failure) = flash.read(slot, &mut row) {
            *error = Some(failure);
            return Err(Slot::Unreadable(None));
        }
        let is_damage = was_header(&row, self.format.kind);
        Header::decode(&row, self.format.kind).ok_or(if is_damage { Slot::Damaged(None) } else { Slot::Blank })
    }

    /// Returns the content of a slot with this header.
    #[inline(never)]
    fn check_body<F: NorFlash>(&self, flash: &mut F, slot: u32, header: Header, error: &mut Option<F::Error>) -> Slot {
        let mut crc = Crc32::new();
        let add = |bytes: &[u8]| {
            crc.add(bytes);
            true
        };
        if self.is_len(header.len)
            && let Err(failure) = scan(flash, slot.saturating_add(BODY), header.len, add)
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

    /// Returns whether a body can have this length.
    fn is_len(&self, len: u32) -> bool {
        const MIN: u32 = 32;
        len >= MIN && len.is_multiple_of(MIN) && len <= self.slot_len.saturating_sub(BODY)
    }

    /// Returns whether a slot could not be read.
    pub(crate) const fn is_impaired(&self) -> bool {
        self.unreadable > 0
    }

    /// Returns whether the next [`step`](Self::step) only repeats a failed read.
    pub(crate) const fn is_unread(&self) -> bool {
        self.is_unread && matches!(self.spare, Spare::Failing)
    }

    /// Returns whether there is damage that a power cut cannot leave.
    pub(crate) const fn is_damaged(&self) -> bool {
        self.is_damaged
    }

    /// Reads a row of the newest record's body. Returns false if it has fewer rows.
    pub(crate) fn row<F: NorFlash>(
        &mut self,
        flash: &mut F,
        index: u32,
        row: &mut [u8; ROW],
    ) -> Result<bool, F::Error> {
        let Some(Newest { slot, header }) = self.newest else { return Ok(false) };
        if index >= header.len / 32 {
            return Ok(false);
        }
        let read = flash.read(slot.saturating_add(BODY).saturating_add(index.saturating_mul(32)), row);
        if read.is_err() {
            // Reading must be repeated before anything else.
            (self.is_unread, self.spare) = (true, Spare::Failing);
        }
        read.map(|()| true)
    }

    /// Erases at most one unit, or writes the header. With a `job`, it is a step towards its record; without one,
    /// towards a blank spare slot.
    #[inline(never)]
    pub(crate) fn step<F: NorFlash>(&mut self, flash: &mut F, now: Instant, job: Option<Job>) -> Step {
        if job.is_none() || self.done != job.map(|job| job.id) {
            self.done = None;
        }
        let job = job.filter(|_| self.done.is_none());
        // The content does not fit; without a job, not even the shortest record would.
        if !self.is_len(job.map_or(32, |job| job.len)) {
            return if job.is_some() { Step::Failed } else { Step::Idle };
        }
        match (self.spare, job) {
            (Spare::Unknown, _) => {
                // Without a record the first one is written. An error occurs again in one of the next steps.
                let _ = self.open(flash);
                Step::Busy
            }
            (Spare::Failing, job) if self.is_unread => self.retry_reading(flash, now, job.is_some()),
            (Spare::Failing | Spare::Blank, None) => Step::Idle,
            (Spare::Failing, Some(_)) => {
                self.spare = Spare::Dirty(0);
                Step::Busy
            }
            (Spare::Dirty(done), _) => self.clear(flash, done),
            (Spare::Blank, Some(job)) => {
                self.spare = Spare::Writing { job, written: 0, crc: Crc32::new() };
                Step::Write(0)
            }
            (Spare::Writing { job: begun, written, crc }, Some(job)) if begun == job => {
                if written < job.len {
                    Step::Write(written / 32)
                } else {
                    self.finish(flash, job, crc)
                }
            }
            // The job has changed.
            (Spare::Writing { .. }, _) => self.clear(flash, 0),
        }
    }

    /// Repeats a failed read, at most once a second. After [`READ_ATTEMPTS`], if there is something to write, it gives
    /// up a slot that still cannot be read, but not both: one of them has the complete record.
    #[inline(never)]
    fn retry_reading<F: NorFlash>(&mut self, flash: &mut F, now: Instant, has_job: bool) -> Step {
        if now < self.retry_from {
            return Step::Idle;
        }
        self.attempts_left = self.attempts_left.saturating_sub(1);
        self.retry_from = now.after(if self.attempts_left > 0 { RETRY_PAUSE } else { LONG_RETRY_PAUSE });
        let _ = self.open(flash);
        if !self.is_unread {
            // The owner also needs to know that there is no record.
            return if self.newest.is_some() || !has_job { Step::Unread } else { Step::Busy };
        }
        match self.unreadable {
            _ if !has_job => return Step::Idle,
            1 if self.attempts_left == 0 => self.spare = Spare::Dirty(0),
            1 => {}
            _ => return Step::Failed,
        }
        Step::Busy
    }

    /// Erases the next unit of the spare slot, unless it is blank.
    fn clear<F: NorFlash>(&mut self, flash: &mut F, offset: u32) -> Step {
        let at = self.spare_slot.saturating_add(offset);
        let next = offset.saturating_add(Units::<F>::ERASE);
        // A unit that cannot be read is not blank.
        let is_blank =
            scan(flash, at, Units::<F>::ERASE, |bytes| bytes.iter().all(|byte| *byte == 0xFF)).unwrap_or(false);
        if !is_blank && flash.erase(at, at.saturating_add(Units::<F>::ERASE)).is_err() {
            self.spare = Spare::Failing;
            return Step::Failed;
        }
        self.spare = if next < self.slot_len { Spare::Dirty(next) } else { Spare::Blank };
        Step::Busy
    }

    /// Writes the next part of the body, which [`step`](Self::step) has asked for: its rows, then 0xFF. `None` aborts
    /// the job.
    #[inline(never)]
    pub(crate) fn write<F: NorFlash>(&mut self, flash: &mut F, chunk: Option<&[u8; CHUNK]>) -> Step {
        // If anything fails, the slot must be erased again.
        let Spare::Writing { job, written, mut crc } = core::mem::replace(&mut self.spare, Spare::Dirty(0)) else {
            return Step::Failed;
        };
        let len = clamped(job.len.saturating_sub(written), CHUNK);
        let part = |len| chunk.and_then(|chunk| chunk.get(..len)).unwrap_or_default();
        crc.add(part(len));
        let bytes = part(len.next_multiple_of(F::WRITE_SIZE));
        let at = self.spare_slot.saturating_add(BODY).saturating_add(written);
        if bytes.is_empty() || flash.write(at, bytes).is_err() || !reads_back(flash, at, bytes) {
            return Step::Failed;
        }
        self.spare = Spare::Writing { job, written: written.saturating_add(BODY), crc };
        Step::Busy
    }

    /// Writes the header, which makes the spare slot the newest record.
    #[inline(never)]
    fn finish<F: NorFlash>(&mut self, flash: &mut F, job: Job, crc: Crc32) -> Step {
        // If anything fails, the slot must be erased again.
        self.spare = Spare::Dirty(0);
        let mut chunk = [0xFF; CHUNK];
        let slot = self.spare_slot;
        let sequence = self.sequence.map_or(1, |sequence| sequence.wrapping_add(1));
        let header = Header { schema: self.format.schema, sequence, len: job.len, body_crc: crc.sum() };
        if let Some(place) = chunk.first_chunk_mut::<ROW>() {
            *place = header.encode(self.format.kind);
        }
        let bytes = chunk.get(..ROW.next_multiple_of(F::WRITE_SIZE)).unwrap_or_default();
        // Ignore the driver's result: what can be read back is valid after a restart.
        let _ = flash.write(slot, bytes);
        if !reads_back(flash, slot, bytes) {
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
        self.attempts_left = READ_ATTEMPTS;
        self.done = Some(job.id);
        Step::Done
    }
}

/// Reads `len` bytes in pieces, until `each` returns false.
fn scan<F: NorFlash>(flash: &mut F, at: u32, len: u32, mut each: impl FnMut(&[u8]) -> bool) -> Result<bool, F::Error> {
    let mut piece = [0; PIECE];
    let mut done = 0;
    let mut result = Ok(true);
    while done < len && matches!(result, Ok(true)) {
        let part = clamped(len.saturating_sub(done), PIECE);
        let bytes = piece.get_mut(..part).unwrap_or_default();
        result = flash.read(at.saturating_add(done), bytes).map(|()| each(bytes));
        done = done.saturating_add(u32::try_from(part).unwrap_or(u32::MAX));
    }
    wipe(&mut piece);
    result
}

/// Returns whether the storage has these bytes.
fn reads_back<F: NorFlash>(flash: &mut F, at: u32, bytes: &[u8]) -> bool {
    let mut at = at;
    let mut row = [0; ROW];
    let (rows, _) = bytes.as_chunks::<ROW>();
    let is_same = rows.iter().all(|expected| {
        let is_same = flash.read(at, &mut row).is_ok() && row == *expected;
        at = at.saturating_add(32);
        is_same
    });
    wipe(&mut row);
    is_same
}

fn clamped(len: u32, most: usize) -> usize {
    usize::try_from(len).unwrap_or(most).min(most)
}
