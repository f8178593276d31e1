//! A decoder by itself, fed by hand.

use super::reference::Found;
use mavstack::dialect::Common;
use mavstack::{Address, Decoder, Dialect, Duration, Instant};

/// A decoder and what came out of it.
#[derive(Default)]
pub struct Receiver {
    pub decoder: Decoder,
    pub now: Instant,
    /// What each call may cost; `None` for no limit.
    pub budget: Option<u32>,
    /// Who was heard before.
    pub known: Vec<Address>,
    pub found: Vec<Found>,
}

impl Receiver {
    /// `bytes` come in at once.
    pub fn receive(&mut self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            rest = &rest[self.decoder.push(rest, self.now)..];
            self.drain();
        }
    }

    /// Takes out all frames there are.
    pub fn drain(&mut self) {
        // A call may spend its budget on a header, and the next one on that frame's checksum: two of them that drop nothing have
        // nothing to do.
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

    /// Nothing comes for so long.
    pub fn wait(&mut self, duration: Duration) {
        self.now = self.now.after(duration);
        self.drain();
    }

    /// The frames whose checksum was checked.
    pub fn checked(&self) -> Vec<Vec<u8>> {
        self.found.iter().filter(|(_, checked)| *checked).map(|(raw, _)| raw.clone()).collect()
    }
}

/// What a decoder without limits finds in `bytes`.
pub fn decode(bytes: &[u8]) -> Vec<Found> {
    let mut receiver = Receiver::default();
    receiver.receive(bytes);
    receiver.found
}
