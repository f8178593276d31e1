//! What the libraries are measured with: the same streams, read from files that the program `streams` writes, and the same
//! works. Each library has a program of its own, which `cargo xtask compare` runs in turns.
//!
//! ```text
//! PROGRAM FOLDER time            ns per frame of each work, the median of a few passes
//! PROGRAM FOLDER once WORK N     the work N times, for a counter of instructions
//! PROGRAM FOLDER recover         per damaged stream: name, intact frames, those of them found, false accepts
//! ```

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Frames of the clean stream.
pub const FRAMES: usize = 100_000;
/// The sender of all frames.
pub const SOURCE: (u8, u8) = (1, 1);
/// The sender of the damaged ones.
pub const DAMAGED_SOURCE: (u8, u8) = (2, 1);
/// The damaged streams.
pub const DAMAGED: [&str; 5] = ["flips", "losses", "bursts", "all", "noise"];
/// So many bytes behind a damaged stream end every candidate in it.
pub const FILLER: [u8; 300] = [0; 300];

/// The works in the order of the tables, and the bytes per piece of those that are framing alone.
pub const WORKS: [(&str, Option<usize>); 5] =
    [("whole", Some(usize::MAX)), ("16", Some(16)), ("1", Some(1)), ("decode", None), ("encode", None)];

/// A library, used as its documentation has it.
pub trait Peer {
    /// The stream's messages in the library's own form.
    type Messages;

    /// Finds frames whose checksum is right in a stream that comes in pieces of so many bytes; returns their number.
    fn frames(stream: &[u8], piece: usize) -> usize;
    /// The same for the whole stream, with the message of each frame decoded and every field of it looked at.
    fn decode(stream: &[u8]) -> usize;
    /// What [`encode`](Self::encode) writes again.
    fn messages(stream: &[u8]) -> Self::Messages;
    /// Writes each message as a frame, numbered from 0.
    fn encode(messages: &Self::Messages, each: impl FnMut(&[u8]));
    /// Hands over the frames that are found in a damaged stream and whose checksum is right, in pieces of 64 bytes.
    fn recover(stream: &[u8], each: impl FnMut(&[u8]));
}

/// A stream of bytes that gives at most a piece at a time.
#[derive(Debug)]
pub struct Source<'a> {
    rest: &'a [u8],
    piece: usize,
    left: usize,
}

impl<'a> Source<'a> {
    /// Pieces of `piece` bytes.
    pub fn new(stream: &'a [u8], piece: usize) -> Self {
        Self { rest: stream, piece, left: piece }
    }

    /// Fills the front of `out` with what is left of the piece; 0 at the end.
    #[inline]
    pub fn take(&mut self, out: &mut [u8]) -> usize {
        let len = out.len().min(self.left).min(self.rest.len());
        if let ([out], [byte, ..]) = (&mut out[..len], self.rest) {
            *out = *byte;
        } else {
            out[..len].copy_from_slice(&self.rest[..len]);
        }
        self.rest = &self.rest[len..];
        self.left -= len;
        if self.left == 0 {
            self.left = self.piece;
        }
        len
    }

    /// Fills all of `out`; false when the stream ends before.
    #[inline]
    pub fn take_exact(&mut self, mut out: &mut [u8]) -> bool {
        while !out.is_empty() {
            let len = self.take(out);
            if len == 0 {
                return false;
            }
            out = &mut out[len..];
        }
        true
    }
}

#[cfg(feature = "mavlink-no-std")]
impl embedded_io::ErrorType for Source<'_> {
    type Error = core::convert::Infallible;
}

#[cfg(feature = "mavlink-no-std")]
impl embedded_io::Read for Source<'_> {
    #[inline]
    fn read(&mut self, out: &mut [u8]) -> Result<usize, Self::Error> {
        Ok(self.take(out))
    }
}

impl std::io::Read for Source<'_> {
    #[inline]
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        Ok(self.take(out))
    }
}

/// The program of a library.
pub fn run<P: Peer>() {
    let mut arguments = std::env::args().skip(1);
    let mut next = || arguments.next().expect("FOLDER time, FOLDER once WORK N, or FOLDER recover");
    let folder = PathBuf::from(next());
    match next().as_str() {
        "time" => time::<P>(&folder),
        "once" => {
            let (work, passes) = (next(), next().parse().expect("a number"));
            let stream = read(&folder, "frames");
            let messages = P::messages(&stream);
            (0..passes).for_each(|_| pass::<P>(&work, &stream, &messages));
        }
        "recover" => recover::<P>(&folder),
        other => panic!("{other}: what is that?"),
    }
}

fn read(folder: &Path, name: &str) -> Vec<u8> {
    let path = folder.join(name).with_extension("bin");
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn pass<P: Peer>(work: &str, stream: &[u8], messages: &P::Messages) {
    let (_, piece) = WORKS.into_iter().find(|(name, _)| *name == work).expect("one of the works");
    match piece {
        Some(piece) => assert_eq!(P::frames(black_box(stream), piece), FRAMES),
        None if work == "decode" => assert_eq!(P::decode(black_box(stream)), FRAMES),
        None => P::encode(black_box(messages), |frame| _ = black_box(frame)),
    }
}

/// What this thread has had so far.
fn processor_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::try_from(now).expect("it is positive")
}

fn time<P: Peer>(folder: &Path) {
    let stream = read(folder, "frames");
    let messages = P::messages(&stream);
    // All do the same work.
    let mut rest = &stream[..];
    P::encode(&messages, |frame| rest = rest.strip_prefix(frame).expect("the frame as it was"));
    assert!(rest.is_empty());
    for (work, _) in WORKS {
        let mut took: Vec<_> = (0..7)
            .map(|_| {
                let began = processor_time();
                pass::<P>(work, &stream, &messages);
                processor_time() - began
            })
            .skip(2)
            .collect();
        took.sort_unstable();
        println!("{work} {:.2}", took[took.len() / 2].as_nanos() as f64 / FRAMES as f64);
    }
}

fn recover<P: Peer>(folder: &Path) {
    for name in DAMAGED {
        let stream = read(folder, name);
        let intact = read(folder, &format!("{name}-intact"));
        let mut intact: Vec<&[u8]> = split(&intact);
        let all = intact.len();
        intact.reverse();
        let (mut found, mut false_accepts) = (0, 0);
        P::recover(&stream, |frame| {
            // They come in order; those before it were lost.
            match intact.iter().rposition(|it| *it == frame) {
                Some(at) => {
                    intact.truncate(at);
                    found += 1;
                }
                None => false_accepts += 1,
            }
        });
        println!("{name} {all} {found} {false_accepts}");
    }
}

/// Clean MAVLink 2 frames without signatures.
fn split(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut frames = Vec::new();
    while let [_, len, ..] = bytes {
        let (frame, rest) = bytes.split_at(usize::from(*len) + 12);
        frames.push(frame);
        bytes = rest;
    }
    frames
}
