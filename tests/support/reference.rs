//! A reference decoder, written independently from MAVLink's guide and without regard to speed. It also encodes frames that the
//! library's encoder would refuse.

use crc::{CRC_16_MCRF4XX, Crc, Table};
use mavstack::message::MessageTable;

/// MAVLink's checksum by slicing-by-16, from a host crate. A slower one would dominate the time of the fuzzer.
static CRC: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_MCRF4XX);

/// Returns CRC-16/MCRF4XX.
pub fn crc(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// Returns the checksum of the bytes between the start byte and the checksum, followed by CRC_EXTRA.
fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    let mut digest = CRC.digest();
    digest.update(bytes);
    digest.update(&[crc_extra]);
    digest.finalize()
}

/// Appends the checksum to `frame`, which starts with the start byte and ends with the payload.
pub fn seal(mut frame: Vec<u8>, crc_extra: u8) -> Vec<u8> {
    let sum = checksum(&frame[1..], crc_extra);
    frame.extend(sum.to_le_bytes());
    frame
}

/// Returns a v2 frame with any id, flags, source and payload.
pub fn v2(id: u32, flags: [u8; 2], source: [u8; 2], payload: &[u8], crc_extra: u8) -> Vec<u8> {
    let [a, b, c, _] = id.to_le_bytes();
    let header = [0xFD, payload.len() as u8, flags[0], flags[1], 7, source[0], source[1], a, b, c];
    seal([&header, payload].concat(), crc_extra)
}

/// Returns a v1 frame with any id, source and payload.
pub fn v1(id: u8, source: [u8; 2], payload: &[u8], crc_extra: u8) -> Vec<u8> {
    seal([&[0xFE, payload.len() as u8, 7, source[0], source[1], id], payload].concat(), crc_extra)
}

/// A frame that was found: its bytes, and whether its checksum was verified.
pub type Found = (Vec<u8>, bool);

/// Returns all frames of a complete stream. Whether a candidate is a frame depends only on the bytes, not on time.
pub fn decode(stream: &[u8], table: MessageTable, is_known: impl Fn([u8; 2]) -> bool) -> Vec<Found> {
    let (mut found, mut at) = (Vec::new(), 0);
    while at < stream.len() {
        match frame_at(&stream[at..], table, &is_known) {
            Some((len, checked)) => {
                found.push((stream[at..at + len].to_vec(), checked));
                at += len;
            }
            None => at += 1,
        }
    }
    found
}

/// The contents of a candidate's header.
struct Claim {
    source: [u8; 2],
    id: u32,
    /// Start and end of the payload.
    payload: [usize; 2],
    /// Length of the frame.
    len: usize,
}

/// Parses a header; `None` if no frame can start like this.
fn claim(bytes: &[u8]) -> Option<Claim> {
    let (header, source, id, signature) = match *bytes {
        [0xFD, _, flags, ..] if flags & 0xFE != 0 => return None,
        [0xFD, _, flags, _, _, system, component, a, b, c, ..] => {
            (10, [system, component], u32::from_le_bytes([a, b, c, 0]), if flags == 1 { 13 } else { 0 })
        }
        [0xFE, _, _, system, component, id, ..] => (6, [system, component], u32::from(id), 0),
        _ => return None,
    };
    let end = header + usize::from(bytes[1]);
    Some(Claim { source, id, payload: [header, end], len: end + 2 + signature }).filter(|_| source[0] != 0)
}

/// Returns the length of the frame at the start of `bytes`, and whether its checksum was verified.
fn frame_at(bytes: &[u8], table: MessageTable, is_known: impl Fn([u8; 2]) -> bool) -> Option<(usize, bool)> {
    let Claim { source, id, payload: [header, end], len } = claim(bytes)?;
    if bytes.len() < len {
        return None;
    }
    let Some(info) = table.get(id) else {
        // Without CRC_EXTRA the frame is accepted if its sender is known and a start byte follows.
        let followed = matches!(bytes.get(len), Some(0xFD | 0xFE));
        return (is_known(source) && followed).then_some((len, false));
    };
    let fits = header == 10 || (usize::from(info.base_len())..=usize::from(info.max_len())).contains(&(end - header));
    let sum = checksum(&bytes[1..end], info.crc_extra());
    (fits && bytes[end..end + 2] == sum.to_le_bytes()).then_some((len, true))
}

/// Corrects the checksums of candidates with a known id. `which` selects them: bit n selects candidates n, n + 4, n + 8 and so on.
pub fn mend(stream: &mut [u8], table: MessageTable, which: u8) {
    let (mut at, mut bit) = (0, 1);
    while at < stream.len() && which != 0 {
        let bytes = &mut stream[at..];
        at += 1;
        let Some(Claim { id, payload: [_, end], len, .. }) = claim(bytes) else { continue };
        let (Some(info), true) = (table.get(id), len <= bytes.len()) else { continue };
        if which & bit != 0 {
            let sum = checksum(&bytes[1..end], info.crc_extra());
            bytes[end..end + 2].copy_from_slice(&sum.to_le_bytes());
            at += len - 1;
        }
        bit = if bit == 8 { 1 } else { bit << 1 };
    }
}
