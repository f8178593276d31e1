//! Any bytes, in any pieces, with any budget: the decoder finds the same frames as the reference decoder (S-13, S-20, SEC-1,
//! SEC-2, SEC-5, R-9).
//!
//! ```text
//!   budget  number of pieces and checksums to correct  their lengths …  stream
//! ```
//!
//! Few mutations leave a checksum valid, so the target corrects checksums. Bits 4 to 7 of the second byte select the candidates to
//! correct, modulo four.

use crate::support::{Receiver, reference};
use arbitrary::Unstructured;
use mavstack::Address;
use mavstack::dialect::Common;
use mavstack::frame::{Decoder, MAX_FRAME_LEN};
use mavstack::message::Dialect;

/// Maximum stream length. Longer streams find nothing new and take time.
const MAX_LEN: usize = 2_048;
/// Maximum overhead of a frame, and one byte after it, which confirms a frame with an unknown id.
const BEYOND: usize = MAX_FRAME_LEN - 255 + 1;

/// Runs the target.
pub fn run(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let budget: u8 = u.arbitrary().unwrap_or(0);
    let how: u8 = u.arbitrary().unwrap_or(0);
    let pieces = u.bytes(usize::from(how % 16).min(u.len())).unwrap_or(&[]);
    let stream = u.take_rest();
    let stream = &stream[..stream.len().min(MAX_LEN)];
    // Zeros after the stream complete every candidate in it.
    let mut buffer = [0; MAX_LEN + 255 + BEYOND];
    buffer[..stream.len()].copy_from_slice(stream);
    reference::mend(&mut buffer[..stream.len()], Common::MESSAGES, how >> 4);
    let stream = &buffer[..end_of_candidates(&buffer[..stream.len()])];

    let budget = (budget != 0).then(|| Decoder::MIN_BUDGET + u32::from(budget));
    let mut receiver = Receiver { known: vec![Address::new(2, 1)], budget, ..Receiver::default() };
    let mut rest = stream;
    for piece in pieces {
        let (piece, behind) = rest.split_at(usize::from(*piece).min(rest.len()));
        receiver.receive(piece);
        rest = behind;
    }
    receiver.receive(rest);
    assert_eq!(receiver.found, reference::decode(stream, Common::MESSAGES, |source| source == [2, 1]));

    // Every frame and every rejected candidate is counted once.
    let counters = receiver.decoder.counters();
    let checked = receiver.found.iter().filter(|(_, is_checked)| *is_checked).count();
    assert_eq!((counters.frames as usize, counters.unchecked as usize), (checked, receiver.found.len() - checked));
    let found: usize = receiver.found.iter().map(|(raw, _)| raw.len()).sum();
    let rejected = [
        counters.skipped,
        counters.incompat_flags,
        counters.zero_source,
        counters.length,
        counters.checksum,
        counters.unknown_id,
        counters.stale,
    ];
    let rejected: u32 = rejected.iter().sum();
    assert_eq!(found + rejected as usize, stream.len(), "every byte is in a frame or rejected: {counters:?}");
}

/// Returns the end of the last candidate by the lengths in the headers.
fn end_of_candidates(stream: &[u8]) -> usize {
    let longest = |(at, bytes): (usize, &[u8])| match *bytes {
        [0xFD | 0xFE, len] => at + usize::from(len) + BEYOND,
        _ => 0,
    };
    // The last byte of the stream is not followed by a length.
    stream.windows(2).enumerate().map(longest).fold(stream.len() + BEYOND, usize::max)
}
