//! Any message with any content: after encoding it is found and decodes to the same bytes, in both versions (S-5, S-8, S-10,
//! S-17).
//!
//! ```text
//!   message (2 bytes)  sequence number  system  component  payload …
//! ```

use crate::all::{self, Declared, Visit};
use arbitrary::Unstructured;
use mavstack::dialect::Common;
use mavstack::frame::{Decoder, EncodeError, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Instant, Message};
use std::fmt::Debug;

struct RoundTrip<'a> {
    /// Index of the message, counted down.
    left: usize,
    seq: u8,
    source: Address,
    payload: &'a [u8],
}

/// Runs the target.
pub fn run(data: &[u8]) {
    let mut u = Unstructured::new(data);
    let (which, seq) = (u.arbitrary::<u16>().unwrap_or(0), u.arbitrary().unwrap_or(0));
    let (system, component): (u8, u8) = (u.arbitrary().unwrap_or(1), u.arbitrary().unwrap_or(1));
    let left = usize::from(which) % Common::MESSAGES.rows().len();
    let source = Address::new(system.max(1), component.max(1));
    all::each(&mut RoundTrip { left, seq, source, payload: u.take_rest() });
}

impl Visit for RoundTrip<'_> {
    fn visit<M: Message + Declared + Debug + Default + PartialEq>(&mut self) {
        let Some(left) = self.left.checked_sub(1) else {
            self.left = usize::MAX;
            return self.check::<M>();
        };
        self.left = left;
    }
}

impl RoundTrip<'_> {
    fn check<M: Message + Debug>(&self) {
        // The payload may be longer than the message, as from a newer dialect.
        let payload = &self.payload[..self.payload.len().min(255)];
        let mut bytes = [0; 255];
        bytes[..payload.len()].copy_from_slice(payload);
        let message = M::decode(payload);
        for version in [Version::V2, Version::V1] {
            let mut frame = [0; MAX_FRAME_LEN];
            let len = match encode(&message, version, self.source, self.seq, &mut frame) {
                Ok(len) => len,
                Err(EncodeError::NeedsV2) if version == Version::V1 && M::ID > 255 => continue,
                Err(error) => panic!("{}: {error}", M::NAME),
            };
            let frame = &frame[..len];
            let mut decoder = Decoder::default();
            assert_eq!(decoder.push(frame, Instant::ZERO), len);
            let found = decoder.next(Instant::ZERO, Common::MESSAGES, &mut Decoder::MIN_BUDGET.clone(), |_| false);
            let found = found.unwrap_or_else(|| panic!("{}: no frame", M::NAME));
            assert_eq!((found.id(), found.source(), found.header().seq), (M::ID, self.source, self.seq));
            assert_eq!((found.header().version, found.is_checked(), found.raw()), (version, true, frame));
            // The fields cover the payload, so all of it is preserved.
            let kept = if version == Version::V1 { M::BASE_LEN } else { M::MAX_LEN };
            let mut expected = [0; 255];
            expected[..kept].copy_from_slice(&bytes[..kept]);
            let mut got = [0; 255];
            got[..found.payload().len()].copy_from_slice(found.payload());
            assert_eq!(got, expected, "{}", M::NAME);
            // Encoding the decoded message gives the same frame.
            let again: M = found.decode().unwrap_or_else(|| panic!("{}: not decoded", M::NAME));
            let mut second = [0; MAX_FRAME_LEN];
            assert_eq!(encode(&again, version, self.source, self.seq, &mut second), Ok(len));
            assert_eq!(&second[..len], frame, "{}", M::NAME);
        }
    }
}
