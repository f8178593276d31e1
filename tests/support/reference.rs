//! Framing written a second time, from MAVLink's guide alone and without regard to speed: what the decoder is compared
//! with, and how the tests make frames that the encoder would not.

use crc::{CRC_16_MCRF4XX, Crc, Table};
use mavstack::MessageTable;

/// MAVLink's checksum by a crate of the host, sixteen bytes at a time: it is most of what the fuzzer would wait for otherwise.
static CRC: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_MCRF4XX);

/// CRC-16/MCRF4XX.
pub fn crc(bytes: &[u8]) -> u16 {
    CRC.checksum(bytes)
}

/// The checksum of what lies between a start byte and a checksum, and of what the sender's definition says.
fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    let mut digest = CRC.digest();
    digest.update(bytes);
    digest.update(&[crc_extra]);
    digest.finalize()
}

/// Appends the checksum to `frame`, which begins with its start byte and ends with its payload.
pub fn seal(mut frame: Vec<u8>, crc_extra: u8) -> Vec<u8> {
    let sum = checksum(&frame[1..], crc_extra);
    frame.extend(sum.to_le_bytes());
    frame
}

/// A v2 frame of any id, flags, source and payload.
pub fn v2(id: u32, flags: [u8; 2], source: [u8; 2], payload: &[u8], crc_extra: u8) -> Vec<u8> {
    let [a, b, c, _] = id.to_le_bytes();
    let header = [0xFD, payload.len() as u8, flags[0], flags[1], 7, source[0], source[1], a, b, c];
    seal([&header, payload].concat(), crc_extra)
}

/// A v1 frame of any id, source and payload.
pub fn v1(id: u8, source: [u8; 2], payload: &[u8], crc_extra: u8) -> Vec<u8> {
    seal([&[0xFE, payload.len() as u8, 7, source[0], source[1], id], payload].concat(), crc_extra)
}

/// A frame that was found: its bytes, and whether its checksum could be checked.
pub type Found = (Vec<u8>, bool);

/// All frames of a stream that no byte will follow for a while: what the candidate at `at` is does not depend on time.
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

/// What the header of a candidate says.
struct Claim {
    source: [u8; 2],
    id: u32,
    /// Where the payload begins and ends, and where the frame does.
    payload: [usize; 2],
    len: usize,
}

/// What the bytes from a start byte on say, unless no frame begins so.
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

/// Length of the frame at the front of `bytes`, and whether it could be checked.
fn frame_at(bytes: &[u8], table: MessageTable, is_known: impl Fn([u8; 2]) -> bool) -> Option<(usize, bool)> {
    let Claim { source, id, payload: [header, end], len } = claim(bytes)?;
    if bytes.len() < len {
        return None;
    }
    let Some(info) = table.get(id) else {
        // Nothing to check it with: taken when its sender is known and another frame seems to follow at once.
        let followed = matches!(bytes.get(len), Some(0xFD | 0xFE));
        return (is_known(source) && followed).then_some((len, false));
    };
    let fits = header == 10 || (usize::from(info.base_len())..=usize::from(info.max_len())).contains(&(end - header));
    let sum = checksum(&bytes[1..end], info.crc_extra());
    (fits && bytes[end..end + 2] == sum.to_le_bytes()).then_some((len, true))
}

/// Puts right checksums on what looks like frames of known messages: on those whose bit, one of four in turn, is set in `which`.
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
