//! Measures mavstack.

use mavstack::dialect::Common;
use mavstack::frame::{Decoder, MAX_FRAME_LEN};
use mavstack::message::Dialect;
use mavstack::{Address, Frame, Instant};
use mavstack_compare::{DAMAGED_SOURCE, Peer, SOURCE, run};

#[path = "../../../../crates/station/src/kit/random.rs"]
#[allow(dead_code, reason = "shared with the tests")]
mod random;
#[path = "../../../../tests/support/stream.rs"]
#[allow(dead_code, reason = "shared with the tests")]
mod stream;
use random::Random as Rng;
use stream::Mixed;

struct Ours;

/// The known sender.
const SENDER: Address = Address::new(DAMAGED_SOURCE.0, DAMAGED_SOURCE.1);

/// Feeds `stream` to a decoder in pieces and calls `each` with every frame.
#[inline(always)]
fn decode(stream: &[u8], piece: usize, mut each: impl FnMut(&Frame<'_>)) {
    let now = Instant::ZERO;
    let mut decoder = Decoder::default();
    let mut drain = |decoder: &mut Decoder| {
        let mut budget = u32::MAX;
        while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut budget, |source| source == SENDER) {
            each(&frame);
        }
    };
    if piece == 1 {
        // As in a firmware with an interrupt for each byte.
        for byte in stream {
            let _ = decoder.push(std::slice::from_ref(byte), now);
            drain(&mut decoder);
        }
    } else {
        for mut piece in stream.chunks(piece) {
            while !piece.is_empty() {
                let pushed = decoder.push(piece, now);
                piece = &piece[pushed..];
                drain(&mut decoder);
            }
        }
    }
}

impl Peer for Ours {
    type Messages = Vec<Mixed>;

    fn frames(stream: &[u8], piece: usize) -> usize {
        let mut frames = 0;
        let each = |frame: &Frame<'_>| {
            std::hint::black_box(frame.raw());
            frames += usize::from(frame.is_checked());
        };
        // A separate call, so that the compiler sees the constant.
        if piece == 1 {
            decode(stream, 1, each)
        } else {
            decode(stream, piece, each)
        }
        frames
    }

    fn decode(stream: &[u8]) -> usize {
        let mut frames = 0;
        decode(stream, usize::MAX, |frame| {
            Mixed::read(frame);
            frames += 1;
        });
        frames
    }

    fn messages(stream: &[u8]) -> Vec<Mixed> {
        let mut messages = Vec::new();
        decode(stream, usize::MAX, |frame| messages.push(Mixed::decode(frame).expect("a message of the stream")));
        messages
    }

    fn encode(messages: &Vec<Mixed>, mut each: impl FnMut(&[u8])) {
        let mut out = [0; MAX_FRAME_LEN];
        let mut seq = 0u8;
        for message in messages {
            let len = message.encode(Address::new(SOURCE.0, SOURCE.1), seq, &mut out).expect("every message fits");
            each(&out[..len]);
            seq = seq.wrapping_add(1);
        }
    }

    fn recover(stream: &[u8], mut each: impl FnMut(&[u8])) {
        decode(stream, 64, |frame| {
            if frame.is_checked() {
                each(frame.raw());
            }
        });
    }
}

fn main() {
    run::<Ours>();
}
