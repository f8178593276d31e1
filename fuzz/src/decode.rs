//! Any bytes, in any pieces, with any budget: what the decoder finds is what the reference finds (S-13, S-20, SEC-1, SEC-2,
//! SEC-5, R-9).
//!
//! ```text
//!   budget  number of pieces  their lengths …  the stream
//! ```

use crate::support::{Receiver, reference};
use arbitrary::Unstructured;
use mavstack::dialect::Common;
use mavstack::{Address, Decoder, Dialect};

/// So many bytes behind a stream end every candidate in it.
const FILLER: [u8; 300] = [0; 300];
/// Longer streams show nothing new, and cost time.
const MAX_LEN: usize = 2_048;

/// Decodes.
pub fn run(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let budget: u8 = u.arbitrary().unwrap_or(0);
    let pieces = usize::from(u.arbitrary::<u8>().unwrap_or(0) % 16);
    let pieces = u.bytes(pieces.min(u.len())).unwrap_or(&[]);
    let stream = u.take_rest();
    let stream = [&stream[..stream.len().min(MAX_LEN)], &FILLER].concat();

    let budget = (budget != 0).then(|| Decoder::MIN_BUDGET + u32::from(budget));
    let mut receiver = Receiver { known: vec![Address::new(2, 1)], budget, ..Receiver::default() };
    let mut rest = &stream[..];
    for piece in pieces {
        let (piece, behind) = rest.split_at(usize::from(*piece).min(rest.len()));
        receiver.receive(piece);
        rest = behind;
    }
    receiver.receive(rest);
    assert_eq!(receiver.found, reference::decode(&stream, Common::MESSAGES, |source| source == [2, 1]));

    // Every frame and every refused candidate is counted once.
    let counters = receiver.decoder.counters();
    let checked = receiver.found.iter().filter(|(_, is_checked)| *is_checked).count();
    assert_eq!((counters.frames as usize, counters.unchecked as usize), (checked, receiver.found.len() - checked));
    let found: usize = receiver.found.iter().map(|(raw, _)| raw.len()).sum();
    let refused = [
        counters.skipped,
        counters.incompat_flags,
        counters.zero_source,
        counters.length,
        counters.checksum,
        counters.unknown_id,
        counters.stale,
    ];
    let refused: u32 = refused.iter().sum();
    assert_eq!(found + refused as usize, stream.len(), "every byte is in a frame, or was given up: {counters:?}");
}
