//! Pages of the journal, as `src/storage/format.md` documents them: what the tests read from flash and write to it.

/// Length of a page in bytes.
pub const PAGE: usize = 256;
/// Length of a page's payload in bytes.
pub const PAYLOAD: usize = 224;

/// The kinds of records.
pub const PLANS: u8 = 1;
#[cfg(feature = "signing")]
pub const PARAMETERS: u8 = 2;
#[cfg(feature = "signing")]
pub const KEY: u8 = 3;

/// Flags of a page: it is the last one of its record; its record is a copy from the previous segment.
pub const LAST: u8 = 1;
pub const COPY: u8 = 2;

/// A page of a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogPage {
    pub segment: u32,
    pub position: u16,
    pub index: u16,
    pub schema: u16,
    pub kind: u8,
    pub flags: u8,
    pub before: u8,
    pub count: u16,
    pub previous: u32,
    pub payload: Vec<u8>,
}

fn crc(bytes: &[u8]) -> u32 {
    let mut crc = crc_any::CRCu32::crc32();
    crc.digest(bytes);
    crc.get_crc()
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes"))
}

fn half(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(bytes[at..at + 2].try_into().expect("2 bytes"))
}

impl LogPage {
    /// Returns the bytes of the page. All checksums are correct.
    pub fn encode(&self) -> [u8; PAGE] {
        let mut bytes = [0xFF; PAGE];
        bytes[..4].copy_from_slice(&[b'M', b'L', 1, self.kind]);
        bytes[4..4 + self.payload.len()].copy_from_slice(&self.payload);
        bytes[228..232].copy_from_slice(&self.segment.to_le_bytes());
        bytes[232..234].copy_from_slice(&self.position.to_le_bytes());
        bytes[234..236].copy_from_slice(&self.index.to_le_bytes());
        bytes[236..238].copy_from_slice(&self.schema.to_le_bytes());
        bytes[238..241].copy_from_slice(&[self.kind, self.flags | 1 << 4, self.payload.len() as u8]);
        bytes[241] = self.before;
        bytes[242..244].copy_from_slice(&self.count.to_le_bytes());
        bytes[244..248].copy_from_slice(&self.previous.to_le_bytes());
        seal(&mut bytes);
        bytes
    }

    /// Reads a page; `None` if it is not whole.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let page = Self {
            segment: word(bytes, 228),
            position: half(bytes, 232),
            index: half(bytes, 234),
            schema: half(bytes, 236),
            kind: bytes[238],
            flags: bytes[239] & 0x0F,
            before: bytes[241],
            count: half(bytes, 242),
            previous: word(bytes, 244),
            payload: bytes.get(4..4 + usize::from(bytes[240]).min(PAYLOAD))?.to_vec(),
        };
        (page.encode() == *bytes).then_some(page)
    }
}

/// Corrects the checksums of a page: of all of it, and of its footer.
pub fn seal(bytes: &mut [u8; PAGE]) {
    let sum = crc(&bytes[..248]);
    bytes[248..252].copy_from_slice(&sum.to_le_bytes());
    let sum = crc(&bytes[228..252]);
    bytes[252..].copy_from_slice(&sum.to_le_bytes());
}

/// Returns the whole pages in flash, each with its address.
pub fn pages(flash: &[u8]) -> Vec<(usize, LogPage)> {
    let page = |(index, bytes)| Some((index * PAGE, LogPage::decode(bytes)?));
    flash.chunks_exact(PAGE).enumerate().filter_map(page).collect()
}

/// Returns the newest page of this kind in flash, and its address.
pub fn newest(flash: &[u8], kind: u8) -> (usize, LogPage) {
    let of_kind = pages(flash).into_iter().filter(|(_, page)| page.kind == kind);
    of_kind.max_by_key(|(_, page)| (page.segment, page.position)).expect("there is a page of this kind")
}

/// Returns the pages of a record that is the first one in this segment.
pub fn record(kind: u8, segment: u32, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut previous = 0;
    for (index, payload) in content.chunks(PAYLOAD).enumerate() {
        let is_last = (index + 1) * PAYLOAD >= content.len();
        let page = LogPage {
            segment,
            position: index as u16,
            index: index as u16,
            schema: 1,
            kind,
            flags: if is_last { LAST } else { 0 },
            previous,
            payload: payload.to_vec(),
            ..LogPage::default()
        };
        let page = page.encode();
        previous = word(&page, 248);
        bytes.extend(page);
    }
    bytes
}
