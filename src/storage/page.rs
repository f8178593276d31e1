//! A page of the log: 256 bytes, which are whole or not there. `format.md` in this folder documents each byte.
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

/// The buffer for one page: the only large buffer that storage needs. What carries out the [jobs](super::Job) owns it.
#[derive(Clone)]
pub struct Page([u8; PAGE]);

/// What follows the payload of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
    pub(crate) flags: u8,
    /// The length of its payload in bytes.
    pub(crate) len: u8,
    /// The kind of the record before in the segment; 0 if it is the first.
    pub(crate) before: u8,
    /// The number of records before in the segment, modulo 2^16.
    pub(crate) count: u16,
    /// The checksum of the record's page before; 0 in its first page.
    pub(crate) previous: u32,
}

/// What a page contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    /// It is erased.
    Blank,
    /// It was not written completely, or is damaged, or is no page. With the footer if at most one of its bits is wrong.
    Bad(Option<Footer>),
    /// It is whole, and this is its checksum.
    Whole(Footer, u32),
}

impl Footer {
    fn words(&self) -> [[u8; 4]; 5] {
        let [position0, position1] = self.position.to_le_bytes();
        let [index0, index1] = self.index.to_le_bytes();
        let [schema0, schema1] = self.schema.to_le_bytes();
        let [count0, count1] = self.count.to_le_bytes();
        [
            self.segment.to_le_bytes(),
            [position0, position1, index0, index1],
            [schema0, schema1, self.kind, self.flags | const { VERSION << 4 }],
            [self.len, self.before, count0, count1],
            self.previous.to_le_bytes(),
        ]
    }

    /// Reads the end of a page. Returns its footer and the page's checksum, if the footer is whole; the version of the
    /// format is in the upper half of the flags.
    fn decode(tail: &[u8; TAIL]) -> Option<(Self, u32)> {
        let (words, _) = tail.as_chunks::<4>();
        let &[_, segment, [p0, p1, i0, i1], [s0, s1, kind, flags], [len, before, c0, c1], previous, crc, sum] = words
        else {
            return None;
        };
        let footer = Self {
            segment: u32::from_le_bytes(segment),
            position: u16::from_le_bytes([p0, p1]),
            index: u16::from_le_bytes([i0, i1]),
            schema: u16::from_le_bytes([s0, s1]),
            kind,
            flags,
            len,
            before,
            count: u16::from_le_bytes([c0, c1]),
            previous: u32::from_le_bytes(previous),
        };
        (sum_of_tail(tail) == u32::from_le_bytes(sum)).then_some((footer, u32::from_le_bytes(crc)))
    }

    /// Reads the end of a page. Returns its footer, and whether it is of this version of the format.
    pub(crate) fn read(tail: &[u8; TAIL]) -> Option<(Self, bool)> {
        let (mut footer, _) = Self::decode(tail)?;
        let version = footer.flags >> 4;
        footer.flags &= 0x0F;
        Some((footer, version == VERSION))
    }

    pub(crate) const fn is_last(&self) -> bool {
        self.flags & flag::LAST != 0
    }

    pub(crate) const fn is_copy(&self) -> bool {
        self.flags & flag::COPY != 0
    }
}

/// Returns the checksum of a footer, which begins behind the last bytes of the payload.
fn sum_of_tail(tail: &[u8; TAIL]) -> u32 {
    let mut crc = Crc32::new();
    crc.add(tail.get(4..TAIL - 4).unwrap_or_default());
    crc.sum()
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

    /// Returns the first `len` bytes of the payload.
    pub(crate) fn payload(&self, len: u8) -> &[u8] {
        self.0.get(START..).and_then(|rest| rest.get(..usize::from(len).min(PAYLOAD))).unwrap_or_default()
    }

    /// Completes a page, whose payload is in place, and returns its checksum.
    pub(crate) fn seal(&mut self, footer: &Footer) -> u32 {
        let [m0, m1] = MAGIC;
        if let Some(front) = self.0.first_chunk_mut() {
            *front = [m0, m1, VERSION, footer.kind];
        }
        if let Some(rest) = self.payload_mut().get_mut(usize::from(footer.len)..) {
            rest.fill(0xFF);
        }
        let words = self.0.get_mut(START + PAYLOAD..CRC).unwrap_or_default().as_chunks_mut().0;
        for (place, word) in words.iter_mut().zip(footer.words()) {
            *place = word;
        }
        let crc = self.sum();
        let Some(tail) = self.0.last_chunk_mut::<TAIL>() else { return crc };
        if let [.., place, _] = tail.as_chunks_mut().0 {
            *place = crc.to_le_bytes();
        }
        let sum = sum_of_tail(tail);
        if let Some(place) = tail.last_chunk_mut() {
            *place = sum.to_le_bytes();
        }
        crc
    }

    /// Returns the checksum of a page.
    fn sum(&self) -> u32 {
        let mut crc = Crc32::new();
        crc.add(self.0.get(..CRC).unwrap_or_default());
        crc.sum()
    }

    /// Returns what a page that was read contains.
    #[inline(never)]
    pub(crate) fn open(&self) -> Content {
        let found = self.0.last_chunk().and_then(Footer::decode);
        let Some((mut footer, crc)) = found else {
            let is_blank = self.0.iter().all(|byte| *byte == 0xFF);
            return if is_blank { Content::Blank } else { Content::Bad(self.repaired_footer()) };
        };
        let version = footer.flags >> 4;
        footer.flags &= 0x0F;
        let [m0, m1] = MAGIC;
        let is_whole = version == VERSION
            && self.0.first_chunk() == Some(&[m0, m1, VERSION, footer.kind])
            && usize::from(footer.len) <= PAYLOAD
            && self.sum() == crc;
        if is_whole { Content::Whole(footer, crc) } else { Content::Bad(Some(footer)) }
    }

    /// Whether the first bytes are those of a page.
    pub(crate) fn is_begun(&self) -> bool {
        let [m0, m1] = MAGIC;
        self.0.starts_with(&[m0, m1, VERSION])
    }

    /// Returns the footer of a page in which one bit of the footer is wrong. A write that was cut off does not leave such
    /// a page.
    #[inline(never)]
    fn repaired_footer(&self) -> Option<Footer> {
        let mut tail = *self.0.last_chunk::<TAIL>()?;
        // If the write was cut off within the last checksum, that is right up to there, and blank from there on.
        let sum = tail.last_chunk::<4>()?.iter().zip(sum_of_tail(&tail).to_le_bytes());
        let is_cut = sum.skip_while(|(found, right)| **found == *right).all(|(found, _)| *found == 0xFF);
        if is_cut || !self.is_begun() {
            return None;
        }
        (START..TAIL).find_map(|at| {
            (0..8).find_map(|bit| {
                *tail.get_mut(at)? ^= 1 << bit;
                let footer = Footer::decode(&tail);
                *tail.get_mut(at)? ^= 1 << bit;
                footer.map(|(footer, _)| Footer { flags: footer.flags & 0x0F, ..footer })
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
            flags: flag::LAST | flag::COPY,
            len: 223,
            before: 0x0D,
            count: 0x0F0E,
            previous: 0x1312_1110,
        }
    }

    fn sealed() -> (Page, u32) {
        let mut page = Page::new();
        page.payload_mut().fill(0x55);
        let crc = page.seal(&footer());
        (page, crc)
    }

    /// `format.md`, byte by byte: other versions of this crate depend on it.
    #[test]
    fn page_is_as_documented() {
        let (page, crc) = sealed();
        let bytes = page.bytes();
        assert_eq!(bytes[..4], [b'M', b'L', 1, 0x0B]);
        assert_eq!(bytes[4..227], [0x55; 223]);
        assert_eq!(bytes[227], 0xFF);
        assert_eq!(bytes[228..236], [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bytes[236..248], [9, 10, 0x0B, 0x13, 223, 0x0D, 0x0E, 0x0F, 0x10, 0x11, 0x12, 0x13]);
        let mut reference = crc_any::CRCu32::crc32();
        reference.digest(&bytes[..248]);
        assert_eq!((reference.get_crc(), crc.to_le_bytes()), (crc, bytes[248..252].try_into().unwrap()));
        let mut reference = crc_any::CRCu32::crc32();
        reference.digest(&bytes[228..252]);
        assert_eq!(reference.get_crc().to_le_bytes(), bytes[252..]);
        assert_eq!(page.open(), Content::Whole(footer(), crc));
        assert_eq!(Footer::read(page.bytes().last_chunk().unwrap()), Some((footer(), true)));
    }

    /// Every bit is covered by a checksum, and the footer of a page with one wrong bit is found.
    #[test]
    fn each_flipped_bit_is_noticed() {
        let (page, _) = sealed();
        for bit in 0..PAGE * 8 {
            let mut damaged = page.clone();
            damaged.bytes_mut()[bit / 8] ^= 1 << (bit % 8);
            // The last byte is not one bit from 0xFF, which would look like a write that was cut off.
            assert_eq!(damaged.open(), Content::Bad(Some(footer())), "bit {bit}");
        }
    }

    /// A page that was written in part is never whole, and never blank from its first byte on.
    #[test]
    fn torn_pages_are_neither_whole_nor_blank() {
        let (page, _) = sealed();
        for written in 0..PAGE {
            let mut torn = Page([0xFF; PAGE]);
            torn.bytes_mut()[..written].copy_from_slice(&page.bytes()[..written]);
            let expected = if written == 0 { Content::Blank } else { Content::Bad(None) };
            assert_eq!(torn.open(), expected, "{written} bytes");
        }
    }
}
