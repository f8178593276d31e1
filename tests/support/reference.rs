//! Framing written a second time, from MAVLink's guide alone and without regard to speed: what the decoder is compared
//! with, and how the tests make frames that the encoder would not.

use mavstack::MessageTable;

/// CRC-16/MCRF4XX, bit by bit.
pub fn crc(bytes: &[u8]) -> u16 {
    let mut sum = 0xFFFF_u16;
    for byte in bytes {
        sum ^= u16::from(*byte);
        for _ in 0..8 {
            sum = if sum & 1 == 1 { sum >> 1 ^ 0x8408 } else { sum >> 1 };
        }
    }
    sum
}

/// Appends the checksum to `frame`, which begins with its start byte and ends with its payload.
pub fn seal(mut frame: Vec<u8>, crc_extra: u8) -> Vec<u8> {
    let sum = crc(&[&frame[1..], &[crc_extra]].concat());
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

/// Length of the frame at the front of `bytes`, and whether it could be checked.
fn frame_at(bytes: &[u8], table: MessageTable, is_known: impl Fn([u8; 2]) -> bool) -> Option<(usize, bool)> {
    let (header, source, id, signature) = match *bytes {
        [0xFD, _, flags, ..] if flags & 0xFE != 0 => return None,
        [0xFD, _, flags, _, _, system, component, a, b, c, ..] => {
            (10, [system, component], u32::from_le_bytes([a, b, c, 0]), if flags == 1 { 13 } else { 0 })
        }
        [0xFE, _, _, system, component, id, ..] => (6, [system, component], u32::from(id), 0),
        _ => return None,
    };
    let (payload, info) = (usize::from(bytes[1]), table.get(id));
    let (sum_at, len) = (header + payload, header + payload + 2 + signature);
    if source.contains(&0) || bytes.len() < len {
        return None;
    }
    let Some(info) = info else {
        // Nothing to check it with: taken when its sender is known and another frame seems to follow at once.
        let followed = matches!(bytes.get(len), Some(0xFD | 0xFE));
        return (is_known(source) && followed).then_some((len, false));
    };
    let fits = header == 10 || payload == usize::from(info.base_len());
    let sum = crc(&[&bytes[1..sum_at], &[info.crc_extra()]].concat());
    (fits && bytes[sum_at..sum_at + 2] == sum.to_le_bytes()).then_some((len, true))
}
