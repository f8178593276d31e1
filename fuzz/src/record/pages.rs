//! The journal's pages by the letter of `src/storage/format.md`, independent of the library: what damage must be reported, and records
//! that a fuzzer cannot find because of their checksums.

use crate::flash::RamFlash;
use arbitrary::{Result, Unstructured};
use std::collections::BTreeMap;

pub(crate) const PAGE: usize = 256;
/// Where the payload begins and ends.
const PAYLOAD: std::ops::Range<usize> = 4..228;
const LAST: u8 = 1;
const COPY: u8 = 2;
const LOST: u8 = 4;

/// A page whose footer is whole.
#[derive(Clone, Debug)]
pub(crate) struct Page {
    pub(crate) segment: u32,
    pub(crate) position: u16,
    pub(crate) index: u16,
    pub(crate) kind: u8,
    flags: u8,
    payload: Vec<u8>,
    previous: u32,
    crc: u32,
    /// Whether its payload is whole, too.
    is_whole: bool,
    /// Its address.
    pub(crate) at: usize,
}

impl Page {
    pub(crate) fn is_last(&self) -> bool {
        self.flags & LAST != 0
    }

    /// Whether it is the last page of a record that is no copy: its segment is complete.
    pub(crate) fn opens(&self) -> bool {
        self.is_last() && self.flags & COPY == 0
    }
}

pub(crate) fn crc(bytes: &[u8]) -> u32 {
    let mut crc = crc_any::CRCu32::crc32();
    crc.digest(bytes);
    crc.get_crc()
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"))
}

fn half(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(bytes[at..at + 2].try_into().expect("two bytes"))
}

/// Reads a page whose footer is whole.
fn read(page: &[u8], at: usize) -> Option<Page> {
    let is_footer_whole = page[239] >> 4 == 1 && page[240] <= 224 && crc(&page[228..252]) == word(page, 252);
    is_footer_whole.then(|| Page {
        segment: word(page, 228),
        position: half(page, 232),
        index: half(page, 234),
        kind: page[238],
        flags: page[239] & 0x0F,
        payload: page[PAYLOAD][..usize::from(page[240])].to_vec(),
        previous: word(page, 244),
        crc: word(page, 248),
        is_whole: page[..4] == [b'M', b'L', 1, page[238]] && crc(&page[..248]) == word(page, 248),
        at,
    })
}

/// Whether a page is neither erased nor whole.
pub(crate) fn is_damaged(page: &[u8]) -> bool {
    page.iter().any(|byte| *byte != 0xFF) && read(page, 0).is_none_or(|page| !page.is_whole)
}

/// Returns the pages of the open segment whose footers are whole, in their order.
pub(crate) fn open(flash: &[u8]) -> Vec<Page> {
    let pages = flash.chunks_exact(PAGE).enumerate().filter_map(|(index, page)| read(page, index * PAGE));
    let mut pages: Vec<_> = pages.collect();
    let newest = pages.iter().filter(|page| page.opens()).map(|page| page.segment).max();
    pages.retain(|page| Some(page.segment) == newest);
    pages.sort_by_key(|page| page.position);
    pages
}

/// Returns the newest records of kinds that the vehicle does not know.
pub(crate) fn kept(flash: &[u8]) -> BTreeMap<u8, Vec<u8>> {
    let mut records = BTreeMap::new();
    let mut record: Option<(u8, u16, u32, Vec<u8>)> = None;
    for page in open(flash).into_iter().filter(|page| page.is_whole) {
        let content = match record.take() {
            _ if page.index == 0 => Some(page.payload.clone()),
            Some((kind, index, crc, content)) if (kind, index, crc) == (page.kind, page.index, page.previous) => {
                Some([content, page.payload.clone()].concat())
            }
            _ => None,
        };
        let Some(content) = content else { continue };
        if page.is_last() && page.flags & LOST == 0 && !super::KINDS.contains(&page.kind) {
            records.insert(page.kind, content);
        } else if !page.is_last() {
            record = Some((page.kind, page.index + 1, page.crc, content));
        }
    }
    records
}

/// Returns flash with valid records: the open segment is the first half.
pub(crate) fn records<const W: usize, const E: usize>(
    mut flash: RamFlash<W, E>,
    u: &mut Unstructured<'_>,
) -> Result<RamFlash<W, E>> {
    let segment = flash.bytes.len() / E / 2 * E / PAGE;
    let (mut position, mut before, mut count) = (0usize, 0u8, 0u16);
    while !u.is_empty() && usize::from(count) < 8 {
        // Of newer firmware, too.
        let kind = [1, 2, 3, 128, 129, 130, 77, 131][usize::from(u.arbitrary::<u8>()? % 8)];
        let options: u8 = u.arbitrary()?;
        let is_lost = options & 0x80 != 0;
        let (schema, version) = (if options & 0x40 != 0 { 2 } else { u16::from(kind < 128) }, 1 + (options >> 4 & 1));
        let content: Vec<u8> = if is_lost {
            Vec::new()
        } else {
            let len = usize::from(u.arbitrary::<u8>()?) * 2;
            let len = len.min(u.len());
            u.bytes(len)?.to_vec()
        };
        let chunks = content.chunks(PAYLOAD.len()).collect::<Vec<_>>();
        let chunks = if chunks.is_empty() { vec![&[][..]] } else { chunks };
        // Half of the segment stays free.
        if position + chunks.len() > segment / 2 {
            break;
        }
        let mut previous = 0;
        for (index, chunk) in chunks.iter().enumerate() {
            let last = if index + 1 == chunks.len() { LAST } else { 0 };
            let flags = last | if is_lost { LOST | COPY } else { options & COPY };
            let mut page = b"ML\x01".to_vec();
            page.push(kind);
            page.extend(*chunk);
            page.resize(PAYLOAD.end, 0xFF);
            page.extend(5u32.to_le_bytes());
            page.extend((position as u16).to_le_bytes());
            page.extend((index as u16).to_le_bytes());
            page.extend(schema.to_le_bytes());
            page.extend([kind, flags | version << 4, chunk.len() as u8, before]);
            page.extend(count.to_le_bytes());
            page.extend(u32::to_le_bytes(previous));
            previous = crc(&page);
            page.extend(previous.to_le_bytes());
            page.extend(crc(&page[228..]).to_le_bytes());
            flash.bytes[position * PAGE..][..PAGE].copy_from_slice(&page);
            position += 1;
        }
        (before, count) = (kind, count + 1);
    }
    Ok(flash)
}
