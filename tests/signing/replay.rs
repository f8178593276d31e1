//! A recorder on both links for ten minutes at a time (G-6 to G-8): frames that it replays, unchanged, changed or recombined,
//! are never carried out.

use std::collections::BTreeMap;

use crate::support::signer::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{Address, LinkConfig};

/// A unique command.
fn command(number: u32) -> CommandLong {
    let command = MavCmd::NAV_LAND;
    CommandLong { target_system: 1, target_component: 1, command, param1: number as f32, ..CommandLong::default() }
}

/// Runs `streams` signing senders, and one without the key.
fn session(seed: u64, streams: u8) {
    let mut rng = Rng::new(seed);
    let link = LinkConfig::uart(115_200);
    let mut rig: Rig = Rig::new([LinkSigning::SIGNED, LinkSigning::REQUIRED].map(|signing| link.with_signing(signing)));
    rig.set_key(KEY);
    let mut signers: Vec<_> =
        (0..streams).map(|n| Signer::new(KEY).of(Address::new(100 + n / 4, 1 + n % 2)).link(n / 2 % 2)).collect();
    let mut recorded: Vec<Vec<u8>> = Vec::new();
    let (mut number, mut last) = (0u32, 0);
    for _ in 0..3_000 {
        rig.run_for(millis(rng.below(400)));
        let link = rng.below(2) as usize;
        match rng.below(6) {
            // A sender whose clock is right, or up to half a minute slow. Sometimes only the recorder receives the frame.
            0 | 1 => {
                let now = rig.timestamp();
                let signer = &mut signers[rng.below(u64::from(streams)) as usize];
                signer.timestamp = signer.timestamp.max(now - rng.below(3_000_000));
                number += 1;
                let frame = signer.frame(&command(number));
                if rng.below(4) > 0 {
                    rig.receive(link, &frame);
                }
                recorded.push(frame);
            }
            2 if !recorded.is_empty() => {
                // A frame is replayed, of any age.
                let frame = &recorded[rng.below(recorded.len() as u64) as usize];
                rig.receive(link, frame);
            }
            3 if !recorded.is_empty() => {
                // Another frame's signature, a newer timestamp, another sequence number.
                let mut frame = recorded[rng.below(recorded.len() as u64) as usize].clone();
                let other = &recorded[rng.below(recorded.len() as u64) as usize];
                let (at, from) = (frame.len() - 13, other.len() - 13);
                let part = rng.below(14) as usize;
                frame[at..at + part].copy_from_slice(&other[from..from + part]);
                frame[4] = rng.byte();
                repair(&mut frame);
                rig.receive(link, &frame);
            }
            4 => {
                let mut stranger = Signer::new(OTHER_KEY).of(Address::new(100, 1)).at(rig.timestamp() + 1_000);
                rig.receive(link, &stranger.frame(&command(90_000)));
                rig.receive(link, &stranger.unsigned(Version::V2, &command(90_001)));
                rig.receive(link, &stranger.unsigned(Version::V1, &command(90_002)));
            }
            5 if rng.below(10) == 0 => {
                // The same key again, with any time; or another key or none for a while, and then the same key with a time a
                // minute ahead of every signed frame, which leaves no window (G-17).
                let mut time = rng.below(NOW);
                let ahead = signers.iter().map(|signer| signer.timestamp).fold(rig.timestamp(), u64::max) + 6_000_000;
                match rng.below(3) {
                    0 => {
                        rig.set_key(OTHER_KEY);
                        rig.run_for(millis(rng.below(400)));
                        time = ahead;
                    }
                    1 => {
                        rig.signing().clear_key();
                        time = ahead;
                    }
                    _ => {}
                }
                let now = rig.now;
                rig.signing().set_key(now, SigningKey::new(KEY), time);
            }
            _ => {
                rig.transmit(link);
            }
        }
        rig.transmit(link);
        assert!(rig.timestamp() >= last, "the time went back");
        last = rig.timestamp();
    }
    let mut times: BTreeMap<u32, u32> = BTreeMap::new();
    for command in rig.vehicle.commands() {
        *times.entry(command.params[0] as u32).or_default() += 1;
    }
    assert!(times.values().all(|times| *times == 1), "seed {seed}: carried out twice");
    assert!(times.keys().all(|command| *command <= number), "seed {seed}: not from a sender");
    assert!(times.len() > 200, "seed {seed}: {} carried out", times.len());
    let counters = rig.counters();
    assert!(counters.replayed > 0 && counters.bad_signature > 0 && counters.unsigned > 0, "{counters:?}");
    assert_eq!(counters.no_stream_slot > 0, streams > 16, "{counters:?}");
}

#[test]
fn no_replay_is_carried_out_with_few_streams() {
    for seed in 0..6 {
        session(seed, 5);
    }
}

/// More streams than the table holds.
#[test]
fn no_replay_is_carried_out_with_many_streams() {
    for seed in 0..6 {
        session(seed, 40);
    }
}
