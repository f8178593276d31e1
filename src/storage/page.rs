//! A page of the journal: 256 bytes, which are whole or not there. `format.md` in this folder documents each byte.
//!
//! A page has its magic in front, so that a page that was begun does not look erased, and its checksums at the end, so
//! that a page whose write was cut off does not match them.

use crate::crc32::Crc32;

/// Length of a page in bytes: a multiple of every supported write unit.
pub(crate) const PAGE: usize = 256;
/// Length of a page's payload in bytes.
pub(crate) const PAYLOAD: usize = 224;
/// Length of the end of a page that has the footer.
pub(crate) const TAIL: usize = 32;

const MAGIC: [u8; 2] = *b"ML";
/// The version of the format.
pub(crate) const VERSION: u8 = 1;
/// Where the payload begins.
const START: usize = 4;
/// Where the checksum of the page is, which follows everything it covers.
const CRC: usize = PAGE - 8;

/// Flags of a page.
pub(crate) mod flag {
    /// It is the last page of its record.
    pub(crate) const LAST: u8 = 1;
    /// Its record is a copy from the segment before.
    pub(crate) const COPY: u8 = 2;
    /// It has no content: it says that a record of this kind was lost.
    pub(crate) const LOST: u8 = 4;
    /// Its record has opened its segment because a key was replaced: everything older is erased.
    pub(crate) const SECRET: u8 = 8;
}

/// The buffer for one page: the only large buffer that storage needs. The code that runs the [jobs](super::Job) owns
/// it.
///
/// It is word-aligned, and so is the part that a job reads or writes. A driver that needs words or DMA can thus use it
/// directly: esp-storage would otherwise copy through a buffer of 4 KiB on the call stack.
#[derive(Clone)]
#[repr(align(4))]
pub struct Page([u8; PAGE]);

/// The end of a page, behind its payload.
// Its fields are in the order of the page, which takes less code to read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(crate) struct Footer {
    /// The number of its segment.
    pub(crate) segment: u32,
    /// Its position in the segment, in pages.
    pub(crate) position: u16,
    /// Its position in the record, in pages.
    pub(crate) index: u16,
    /// The version of the record's content.
    pub(crate) schema: u16,
    pub(crate) kind: u8,
    /// With the version of the format in the upper half.
    pub(crate) flags: u8,
    /// The length of its payload in bytes.
    pub(crate) len: u8,
    /// The kind of the record before in the segment; 0 if it is the first.
    pub(crate) before: u8,
    /// The number of records before in the segment, modulo 2^16.
    pub(crate) count: u16,
    /// The checksum of the record's page before; 0 in its first page.
    pub(crate) previous_crc: u32,
    /// The checksum of the page. [`Page::seal`] computes it.
    pub(crate) crc: u32,
}

/// The state of a page that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PageState {
    /// It is erased.
    Blank,
    /// It was not written completely, or is no page, or its footer is damaged, too.
    Bad,
    /// It is damaged. At most one bit of its footer was wrong.
    Damaged(Footer),
    Whole(Footer),
}

impl Footer {
    /// Returns the words before the checksums.
    fn words(&self) -> [u32; 5] {
        let pair = |low: u16, high: u16| u32::from(low) | u32::from(high) << 16;
        let bytes = |low: u8, high: u8| u16::from(low) | u16::from(high) << 8;
        [
            self.segment,
            pair(self.position, self.index),
            pair(self.schema, bytes(self.kind, self.flags)),
            pair(bytes(self.len, self.before), self.count),
            self.previous_crc,
        ]
    }

    /// Reads the end of a page. Returns `None` if the footer is not whole.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn read(tail: &[u8; TAIL]) -> Option<Self> {
        let (words, _) = tail.as_chunks::<4>();
        let &[_, segment, [p0, p1, i0, i1], [s0, s1, kind, flags], [len, before, c0, c1], previous, crc, sum] = words
        else {
            return None;
        };
        if sum_of_tail(tail) != u32::from_le_bytes(sum) {
            return None;
        }
        Some(Self {
            segment: u32::from_le_bytes(segment),
            position: u16::from_le_bytes([p0, p1]),
            index: u16::from_le_bytes([i0, i1]),
            schema: u16::from_le_bytes([s0, s1]),
            kind,
            flags,
            len,
            before,
            count: u16::from_le_bytes([c0, c1]),
            previous_crc: u32::from_le_bytes(previous),
            crc: u32::from_le_bytes(crc),
        })
    }

    /// Whether the page is of this version of the format.
    pub(crate) const fn is_ours(&self) -> bool {
        self.flags >> 4 == VERSION
    }

    pub(crate) const fn is_last(&self) -> bool {
        self.flags & flag::LAST != 0
    }

    pub(crate) const fn is_copy(&self) -> bool {
        self.flags & flag::COPY != 0
    }

    /// Whether the page has no content, and says that a record of its kind was lost.
    pub(crate) const fn is_loss_report(&self) -> bool {
        self.flags & flag::LOST != 0
    }

    /// Whether it requests the erasure of everything older than its segment.
    pub(crate) const fn is_secret(&self) -> bool {
        self.flags & flag::SECRET != 0
    }
}

/// Returns the checksum of a footer, which begins behind the last bytes of the payload.
fn sum_of_tail(tail: &[u8; TAIL]) -> u32 {
    Crc32::of(tail.get(4..TAIL - 4).unwrap_or_default())
}

/// Whether all bytes have this value.
pub(crate) fn is_all(bytes: &[u8], value: u8) -> bool {
    bytes.iter().all(|byte| *byte == value)
}

impl Default for Page {
    fn default() -> Self {
        Self::new()
    }
}

/// Omits the content, which may be the signing key (SEC-15).
impl core::fmt::Debug for Page {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Page")
    }
}

impl Page {
    /// Returns a page of zeros.
    pub const fn new() -> Self {
        Self([0; PAGE])
    }

    /// Returns the bytes of a [job](super::Job) that writes.
    pub const fn bytes(&self) -> &[u8; PAGE] {
        &self.0
    }

    /// Returns the place for the bytes of a [job](super::Job) that reads.
    pub const fn bytes_mut(&mut self) -> &mut [u8; PAGE] {
        &mut self.0
    }

    /// Returns the place of the payload: [`PAYLOAD`] bytes.
    pub(crate) fn payload_mut(&mut self) -> &mut [u8] {
        self.0.get_mut(START..START + PAYLOAD).unwrap_or_default()
    }

    /// Returns the end of the page, with the footer.
    pub(crate) fn tail(&self) -> &[u8; TAIL] {
        self.0.last_chunk().unwrap_or(&[0; TAIL])
    }

    /// Returns the first `len` bytes of the payload.
    pub(crate) fn payload(&self, len: u8) -> &[u8] {
        self.0.get(START..).and_then(|rest| rest.get(..usize::from(len).min(PAYLOAD))).unwrap_or_default()
    }

    /// Completes a page, whose payload is in place.
    pub(crate) fn seal(&mut self, footer: &Footer) {
        let [m0, m1] = MAGIC;
        if let Some(front) = self.0.first_chunk_mut() {
            *front = [m0, m1, VERSION, footer.kind];
        }
        for byte in self.payload_mut().iter_mut().skip(footer.len.into()) {
            // Not `fill`, which takes 220 bytes of flash in a firmware that needs it for nothing else.
            *byte = core::hint::black_box(0xFF);
        }
        let words = self.0.get_mut(START + PAYLOAD..CRC).unwrap_or_default().as_chunks_mut().0;
        for (place, word) in words.iter_mut().zip(footer.words()) {
            *place = word.to_le_bytes();
        }
        let crc = self.sum();
        if let Some(place) = self.0.get_mut(CRC..).and_then(<[u8]>::first_chunk_mut) {
            *place = crc.to_le_bytes();
        }
        let sum = sum_of_tail(self.tail());
        if let Some(place) = self.0.last_chunk_mut() {
            *place = sum.to_le_bytes();
        }
    }

    /// Returns the checksum of a page.
    fn sum(&self) -> u32 {
        Crc32::of(self.0.get(..CRC).unwrap_or_default())
    }

    /// Returns the state of a page that was read.
    // Out of line: it has several callers.
    #[inline(never)]
    pub(crate) fn open(&self) -> PageState {
        let Some(footer) = Footer::read(self.tail()) else {
            let is_blank = is_all(&self.0, 0xFF);
            return if is_blank {
                PageState::Blank
            } else {
                self.repaired_footer().map_or(PageState::Bad, PageState::Damaged)
            };
        };
        let [m0, m1] = MAGIC;
        let is_whole = footer.is_ours()
            && self.0.first_chunk() == Some(&[m0, m1, VERSION, footer.kind])
            && usize::from(footer.len) <= PAYLOAD
            && self.sum() == footer.crc;
        if is_whole { PageState::Whole(footer) } else { PageState::Damaged(footer) }
    }

    /// Whether the first bytes are those of a page.
    pub(crate) fn is_begun(&self) -> bool {
        let [m0, m1] = MAGIC;
        self.0.first_chunk() == Some(&[m0, m1, VERSION])
    }

    /// Returns the footer of a page in which one bit of the footer is wrong. A write that was cut off does not leave
    /// such a page.
    fn repaired_footer(&self) -> Option<Footer> {
        let mut tail = *self.tail();
        // If the write was cut off within the last checksum, that is right up to there, and blank from there on.
        let found = u32::from_le_bytes(*tail.last_chunk()?);
        let right = (found ^ sum_of_tail(&tail)).trailing_zeros() & !7;
        let is_cut = (!found).checked_shr(right).is_none_or(|rest| rest == 0);
        if is_cut || !self.is_begun() {
            return None;
        }
        (START..TAIL).find_map(|at| {
            (0..8).find_map(|bit| {
                *tail.get_mut(at)? ^= 1 << bit;
                let footer = Footer::read(&tail);
                *tail.get_mut(at)? ^= 1 << bit;
                footer
            })
        })
    }

    /// Overwrites the page, which may have held the signing key (SEC-15).
    pub(crate) fn wipe(&mut self) {
        #[cfg(feature = "signing")]
        zeroize::Zeroize::zeroize(&mut self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn footer() -> Footer {
        Footer {
            segment: 0x0403_0201,
            position: 0x0605,
            index: 0x0807,
            schema: 0x0A09,
            kind: 0x0B,
            flags: VERSION << 4 | flag::LAST | flag::COPY,
            len: 223,
            before: 0x0D,
            count: 0x0F0E,
            previous_crc: 0x1312_1110,
            crc: 0,
        }
    }

    /// Returns a page, and its footer.
    fn sealed() -> (Page, Footer) {
        let mut page = Page::new();
        page.payload_mut().fill(0x55);
        page.seal(&footer());
        let crc = u32::from_le_bytes(page.bytes()[248..252].try_into().unwrap());
        (page, Footer { crc, ..footer() })
    }

    /// `format.md`, byte by byte: other versions of this crate depend on it.
    #[test]
    fn page_is_as_documented() {
        let (page, footer) = sealed();
        let bytes = page.bytes();
        assert_eq!(bytes[..4], [b'M', b'L', 1, 0x0B]);
        assert_eq!(bytes[4..227], [0x55; 223]);
        assert_eq!(bytes[227], 0xFF);
        assert_eq!(bytes[228..236], [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bytes[236..248], [9, 10, 0x0B, 0x13, 223, 0x0D, 0x0E, 0x0F, 0x10, 0x11, 0x12, 0x13]);
        let mut reference = crc_any::CRCu32::crc32();
        reference.digest(&bytes[..248]);
        assert_eq!(reference.get_crc().to_le_bytes(), bytes[248..252]);
        let mut reference = crc_any::CRCu32::crc32();
        reference.digest(&bytes[228..252]);
        assert_eq!(reference.get_crc().to_le_bytes(), bytes[252..]);
        assert_eq!(page.open(), PageState::Whole(footer));
        assert_eq!(Footer::read(page.tail()), Some(footer));
    }

    /// Every bit is covered by a checksum, and the footer of a page with one wrong bit is found.
    #[test]
    fn each_flipped_bit_is_noticed() {
        let (page, footer) = sealed();
        for bit in 0..PAGE * 8 {
            let mut damaged = page.clone();
            damaged.bytes_mut()[bit / 8] ^= 1 << (bit % 8);
            // The last byte is not one bit from 0xFF, which would look like a write that was cut off.
            assert_eq!(damaged.open(), PageState::Damaged(footer), "bit {bit}");
        }
    }

    /// A page that was written in part is never whole, and never blank from its first byte on.
    #[test]
    fn torn_pages_are_neither_whole_nor_blank() {
        let (page, _) = sealed();
        for written in 0..PAGE {
            let mut torn = Page([0xFF; PAGE]);
            torn.bytes_mut()[..written].copy_from_slice(&page.bytes()[..written]);
            let expected = if written == 0 { PageState::Blank } else { PageState::Bad };
            assert_eq!(torn.open(), expected, "{written} bytes");
        }
    }
}
