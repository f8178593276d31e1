//! Measures the cost per frame of decoding bytes to frames, decoding frames to messages, and encoding messages.
//!
//! The stream is 100,000 MAVLink 2 frames of fourteen messages of common, 38 bytes on average. Every time is for the whole
//! stream, so 1 ms means 10 ns per frame. The throughput column shows frames per second.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mavstack::frame::{Decoder, MAX_FRAME_LEN};
use mavstack::message::Dialect;
use mavstack::{Address, Frame, Instant, dialect::Common};
use std::hint::black_box;

#[allow(dead_code, reason = "shared with the tests")]
#[path = "../tests/support/stream.rs"]
mod stream;
use mavstack_station::kit::Random as Rng;
use stream::Mixed;

const FRAMES: usize = 100_000;
const SOURCE: Address = Address::new(1, 1);

/// Feeds `stream` to a decoder in pieces of `LEN` bytes and calls `use_frame` with each frame.
#[inline(always)]
fn decode<const LEN: usize>(stream: &[u8], mut use_frame: impl FnMut(&Frame<'_>)) {
    let now = Instant::ZERO;
    let mut decoder = Decoder::default();
    let mut drain = |decoder: &mut Decoder| {
        let mut budget = u32::MAX;
        while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut budget, |_| false) {
            use_frame(&frame);
        }
    };
    if LEN == 1 {
        for byte in stream {
            let _ = decoder.push(std::slice::from_ref(byte), now);
            drain(&mut decoder);
        }
    } else {
        for mut piece in stream.chunks(LEN) {
            while !piece.is_empty() {
                let pushed = decoder.push(piece, now);
                piece = &piece[pushed..];
                drain(&mut decoder);
            }
        }
    }
    assert_eq!(decoder.counters().frames as usize, FRAMES);
}

fn frames(criterion: &mut Criterion) {
    let stream = stream::frames(1, FRAMES, SOURCE).concat();
    let messages = stream::messages(1, FRAMES);
    println!("{} bytes, {:.1} per frame", stream.len(), stream.len() as f64 / FRAMES as f64);

    let mut group = criterion.benchmark_group("frames");
    group.throughput(Throughput::Elements(FRAMES as u64));
    macro_rules! decode {
        ($($name:literal: $len:expr),+) => { $(
            group.bench_function(concat!("decode/", $name), |bencher| {
                bencher.iter(|| decode::<{ $len }>(black_box(&stream), |frame| _ = black_box(frame.raw())));
            });
            group.bench_function(concat!("decode_typed/", $name), |bencher| {
                bencher.iter(|| decode::<{ $len }>(black_box(&stream), Mixed::read));
            });
        )+ };
    }
    decode!("whole": usize::MAX, "64": 64, "16": 16, "1": 1);
    group.bench_function("encode", |bencher| {
        let mut out = [0; MAX_FRAME_LEN];
        bencher.iter(|| {
            let mut seq = 0u8;
            for message in black_box(&messages) {
                let _ = black_box(message.encode(SOURCE, seq, black_box(&mut out)));
                seq = seq.wrapping_add(1);
            }
        });
    });
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
