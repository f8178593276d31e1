//! A decoder alone, without a stack.

use super::reference::Found;
use mavstack::dialect::Common;
use mavstack::frame::Decoder;
use mavstack::message::Dialect;
use mavstack::{Address, Duration, Instant};

/// A decoder and the frames it has found.
#[derive(Default)]
pub struct Receiver {
    pub decoder: Decoder,
    pub now: Instant,
    /// The budget of each call; `None` for no limit.
    pub budget: Option<u32>,
    /// The known senders.
    pub known: Vec<Address>,
    pub found: Vec<Found>,
}

impl Receiver {
    /// Receives `bytes` at once.
    pub fn receive(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            rest = &rest[self.decoder.push(rest, self.now)..];
            self.drain();
        }
    }

    /// Takes all pending frames.
    pub fn drain(&mut self) {
        // One call may spend its budget on a header, and the next call on the checksum. So decoding has finished after two calls
        // without a frame and without a change of the counters.
        let mut idle = 0;
        while idle < 2 {
            let mut budget = self.budget.unwrap_or(u32::MAX);
            let before = self.decoder.counters();
            let known = |source| self.known.contains(&source);
            let frame = self.decoder.next(self.now, Common::MESSAGES, &mut budget, known);
            let found = frame.map(|frame| (frame.raw().to_vec(), frame.is_checked()));
            idle = if found.is_none() && self.decoder.counters() == before { idle + 1 } else { 0 };
            self.found.extend(found);
        }
    }

    /// Receives nothing for `duration`.
    pub fn wait(&mut self, duration: Duration) {
        self.now += duration;
        self.drain();
    }

    /// Returns the frames with a verified checksum.
    pub fn checked(&self) -> Vec<Vec<u8>> {
        self.found.iter().filter(|(_, checked)| *checked).map(|(raw, _)| raw.clone()).collect()
    }
}

/// Returns the frames that a decoder without limits finds in `bytes`.
pub fn decode(bytes: &[u8]) -> Vec<Found> {
    let mut receiver = Receiver::default();
    receiver.receive(bytes);
    receiver.found
}
