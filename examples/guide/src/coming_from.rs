//! Frames and messages alone: `docs/coming-from.md`.

use mavstack::dialect::{CommandLong, Common, Heartbeat};
use mavstack::frame::{Decoder, EncodeError, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Instant};

fn on_bytes(decoder: &mut Decoder, now: Instant, mut bytes: &[u8]) {
    loop {
        let taken = decoder.push(bytes, now);
        bytes = &bytes[taken..];
        let mut budget = 1_000; // a header costs 16 units, a checked byte 1
        while let Some(frame) = decoder.next(now, Common::MESSAGES, &mut budget, |_| false) {
            if let Some(command) = frame.decode::<CommandLong>() {
                on_command(frame.header().source, &command);
            }
        }
        if bytes.is_empty() || taken == 0 {
            return;
        }
    }
}

fn heartbeat(seq: u8, out: &mut [u8]) -> Result<usize, EncodeError> {
    encode(&Heartbeat { mavlink_version: 3, ..Default::default() }, Version::V2, Address::new(1, 1), seq, out)
}

fn on_command(_: Address, _: &CommandLong) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoded_frame_is_decoded() {
        let mut bytes = [0; 32];
        let len = heartbeat(0, &mut bytes).unwrap();
        let mut decoder = Decoder::default();
        on_bytes(&mut decoder, Instant::ZERO, &bytes[..len]);
        assert!(decoder.next(Instant::ZERO, Common::MESSAGES, &mut 1_000, |_| false).is_none());
    }
}
