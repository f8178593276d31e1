//! Measures the crate mavlink, with or without `std`.

use mavlink::dialects::common::MavMessage;
use mavlink::{MAVLinkMessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkReader};
use mavstack_compare::{Peer, SOURCE, Source, run};

struct Mavlink;

impl Peer for Mavlink {
    type Messages = Vec<MavMessage>;

    fn frames(stream: &[u8], piece: usize) -> usize {
        let mut reader = MavlinkReader::new(Source::new(stream, piece));
        let mut frames = 0;
        while let Ok(raw) = reader.read_any_raw_message::<MavMessage>() {
            std::hint::black_box(&raw);
            frames += 1;
        }
        frames
    }

    fn decode(stream: &[u8]) -> usize {
        let mut reader = MavlinkReader::new(Source::new(stream, usize::MAX));
        let mut frames = 0;
        while let Ok(message) = reader.read_any_message::<MavMessage>() {
            std::hint::black_box(&message);
            frames += 1;
        }
        frames
    }

    fn messages(stream: &[u8]) -> Vec<MavMessage> {
        let mut reader = MavlinkReader::new(Source::new(stream, usize::MAX));
        std::iter::from_fn(|| reader.read_any_message().ok()).map(|(_, message)| message).collect()
    }

    fn encode(messages: &Vec<MavMessage>, mut each: impl FnMut(&[u8])) {
        let mut raw = MAVLinkV2MessageRaw::new();
        let mut header = MavHeader { system_id: SOURCE.0.into(), component_id: SOURCE.1, sequence: 0 };
        for message in messages {
            raw.serialize_message(header, message);
            each(raw.raw_bytes());
            header.sequence = header.sequence.wrapping_add(1);
        }
    }

    fn recover(stream: &[u8], mut each: impl FnMut(&[u8])) {
        let mut reader = MavlinkReader::new(Source::new(stream, 64));
        loop {
            match reader.read_any_raw_message::<MavMessage>() {
                Ok(MAVLinkMessageRaw::V1(raw)) => each(raw.raw_bytes()),
                Ok(MAVLinkMessageRaw::V2(raw)) => each(raw.raw_bytes()),
                Err(_) => break,
            }
        }
    }
}

fn main() {
    run::<Mavlink>();
}
