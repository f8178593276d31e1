//! The common workloads for all libraries. The streams are read from files that the program `streams` writes. Each library has
//! its own program, and `cargo measure compare` runs them in turn.
//!
//! ```text
//! PROGRAM FOLDER time               ns per frame of each workload, the median of several passes
//! PROGRAM FOLDER once WORKLOAD N    runs the workload N times, for an instruction counter
//! PROGRAM FOLDER recover            for each damaged stream: name, intact frames, intact frames found, false accepts
//! ```

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Frames of the clean stream.
pub const FRAMES: usize = 100_000;
/// The sender of all frames.
pub const SOURCE: (u8, u8) = (1, 1);
/// The sender of the frames in damaged streams.
pub const DAMAGED_SOURCE: (u8, u8) = (2, 1);
/// The names of the damaged streams.
pub const DAMAGED: [&str; 5] = ["flips", "losses", "bursts", "all", "noise"];
/// Bytes after a damaged stream, enough to complete every candidate in it.
pub const FILLER: [u8; 300] = [0; 300];

/// The workloads in the order of the tables. Workloads of framing alone have a piece size in bytes.
pub const WORKLOADS: [(&str, Option<usize>); 5] =
    [("whole", Some(usize::MAX)), ("16", Some(16)), ("1", Some(1)), ("decode", None), ("encode", None)];

/// A library, used as documented.
pub trait Peer {
    /// The messages of the stream in the library's representation.
    type Messages;

    /// Finds frames with a valid checksum in a stream that arrives in pieces of `piece` bytes. Returns their number.
    fn frames(stream: &[u8], piece: usize) -> usize;
    /// Finds the frames of the whole stream, decodes each message and uses every field. Returns the number of frames.
    fn decode(stream: &[u8]) -> usize;
    /// Decodes the messages for [`encode`](Self::encode).
    fn messages(stream: &[u8]) -> Self::Messages;
    /// Encodes each message as a frame, with sequence numbers from 0.
    fn encode(messages: &Self::Messages, each: impl FnMut(&[u8]));
    /// Calls `each` with every frame with a valid checksum found in a damaged stream, which arrives in pieces of 64 bytes.
    fn recover(stream: &[u8], each: impl FnMut(&[u8]));
}

/// A byte stream that returns at most one piece at a time.
#[derive(Debug)]
pub struct Source<'a> {
    rest: &'a [u8],
    piece: usize,
    left: usize,
}

impl<'a> Source<'a> {
    /// Splits `stream` into pieces of `piece` bytes.
    pub fn new(stream: &'a [u8], piece: usize) -> Self {
        Self { rest: stream, piece, left: piece }
    }

    /// Copies the rest of the current piece to `out`. Returns the number of bytes; 0 at the end.
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

    /// Fills all of `out`. Returns false if the stream ends before.
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

/// Runs the program of a library.
pub fn run<P: Peer>() {
    let mut arguments = std::env::args().skip(1);
    let mut next = || arguments.next().expect("FOLDER time, FOLDER once WORKLOAD N, or FOLDER recover");
    let folder = PathBuf::from(next());
    match next().as_str() {
        "time" => time::<P>(&folder),
        "once" => {
            let (workload, passes) = (next(), next().parse().expect("a number"));
            let stream = read(&folder, "frames");
            let messages = P::messages(&stream);
            (0..passes).for_each(|_| pass::<P>(&workload, &stream, &messages));
        }
        "recover" => recover::<P>(&folder),
        other => panic!("unknown argument {other}; use time, once or recover"),
    }
}

fn read(folder: &Path, name: &str) -> Vec<u8> {
    let path = folder.join(name).with_extension("bin");
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn pass<P: Peer>(workload: &str, stream: &[u8], messages: &P::Messages) {
    let (_, piece) = WORKLOADS.into_iter().find(|(name, _)| *name == workload).expect("a known workload");
    match piece {
        Some(piece) => assert_eq!(P::frames(black_box(stream), piece), FRAMES),
        None if workload == "decode" => assert_eq!(P::decode(black_box(stream)), FRAMES),
        None => P::encode(black_box(messages), |frame| _ = black_box(frame)),
    }
}

/// Returns the processor time of this thread.
fn processor_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::try_from(now).expect("a positive time")
}

fn time<P: Peer>(folder: &Path) {
    let stream = read(folder, "frames");
    let messages = P::messages(&stream);
    // Check that encoding reproduces the stream, so that all libraries do the same work.
    let mut rest = &stream[..];
    P::encode(&messages, |frame| rest = rest.strip_prefix(frame).expect("the original frame"));
    assert!(rest.is_empty());
    for (workload, _) in WORKLOADS {
        let mut took: Vec<_> = (0..7)
            .map(|_| {
                let began = processor_time();
                pass::<P>(workload, &stream, &messages);
                processor_time() - began
            })
            .skip(2)
            .collect();
        took.sort_unstable();
        println!("{workload} {:.2}", took[took.len() / 2].as_nanos() as f64 / FRAMES as f64);
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
            // Frames arrive in order, so the frames before this one were not found.
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

/// Splits a clean stream of unsigned MAVLink 2 frames.
fn split(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut frames = Vec::new();
    while let [_, len, ..] = bytes {
        let (frame, rest) = bytes.split_at(usize::from(*len) + 12);
        frames.push(frame);
        bytes = rest;
    }
    frames
}
