//! Three vehicles that forward, joined in every way. The behaviour of a single vehicle is in `forwarding.rs`.

use crate::support::*;
use mavstack::dialect::PlayTune;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{Address, Text};
use proptest::prelude::*;

/// A unique frame: its text is `number`.
fn frame(from: Address, to: Address, seq: u8, number: usize) -> Vec<u8> {
    let message = PlayTune {
        target_system: to.system.wire(),
        target_component: to.component.wire(),
        tune: Text::new(&format!("{number}")),
        ..PlayTune::default()
    };
    let mut bytes = vec![0; MAX_FRAME_LEN];
    let len = encode(&message, Version::V2, from, seq, &mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

/// How three vehicles are joined: the number of lines between the first and the second, the second and the third, the third and
/// the first. Each vehicle has a leaf.
#[derive(Clone, Copy, Debug)]
struct Joined {
    lines: [usize; 3],
    rate: u64,
    latency: [u64; 3],
    loss: f64,
    has_heartbeats: bool,
    seed: u64,
}

impl Joined {
    fn network<const PEERS: usize>(&self) -> (Network<PEERS>, [usize; 3]) {
        let mut network = Network::new(3, self.rate as u32 * 1_000, self.seed);
        network.has_heartbeats = self.has_heartbeats;
        for pair in 0..3 {
            for _ in 0..self.lines[pair] {
                let line = network.join(pair, Some((pair + 1) % 3), self.rate, millis(self.latency[pair]));
                network.lines[line].loss = self.loss;
            }
        }
        let leaves = [0, 1, 2].map(|node| network.join(node, None, self.rate, millis(1)));
        // Links without heartbeats wait for them no longer (H-17).
        network.run_for(millis(505));
        (network, leaves)
    }

    /// The most deliveries of a frame: one on its own leaf's line, and one by each vehicle on every line but the one it arrived
    /// on. With up to four lines between vehicles, that is at most the number of lines plus two.
    fn bound(&self) -> usize {
        let between: usize = self.lines.iter().sum();
        let ends = 2 * between + 3;
        let bound = 1 + ends - 3;
        assert!(between > 4 || bound <= between + 3 + 2);
        bound
    }
}

fn joined(loss: f64) -> impl Strategy<Value = Joined> {
    let lines = prop::array::uniform3(0..=2_usize)
        .prop_filter("at least two pairs are joined", |lines| lines.iter().filter(|&&lines| lines > 0).count() >= 2);
    let rate = prop::sample::select(vec![6, 12, 92, 0]);
    (lines, rate, prop::array::uniform3(0..=20_u64), 0.0..=loss, any::<bool>(), any::<u64>()).prop_map(
        |(lines, rate, latency, loss, has_heartbeats, seed)| Joined {
            lines,
            rate,
            latency,
            loss,
            has_heartbeats,
            seed,
        },
    )
}

/// A frame to send: the leaf, the sender, the target (`None` is a broadcast), and the pause after it in milliseconds.
#[derive(Clone, Copy, Debug)]
struct Letter {
    leaf: usize,
    from: u8,
    to: Option<(usize, u8)>,
    pause: u64,
}

fn letters(people: u8, pause: u64, count: core::ops::Range<usize>) -> impl Strategy<Value = Vec<Letter>> {
    let to = prop::option::of((0..3_usize, 0..people));
    let letter = (0..3_usize, 0..people, to, 0..=pause);
    let letter = letter.prop_map(|(leaf, from, to, pause)| Letter { leaf, from, to, pause });
    prop::collection::vec(letter, count)
}

/// Returns the address of component `person` at a leaf.
fn address(leaf: usize, person: u8) -> Address {
    Address::new(10 + 80 * leaf as u8 + person, 1)
}

/// Lets five components of each leaf send a broadcast.
fn introduce_all<const PEERS: usize>(network: &mut Network<PEERS>, leaves: [usize; 3]) {
    for (leaf, line) in leaves.into_iter().enumerate() {
        for person in 0..5 {
            let hello = frame(address(leaf, person), Address::new(0, 0), 100, 1_000 + leaf * 10 + usize::from(person));
            network.send(line, hello);
            network.run_for(millis(40));
        }
    }
}

/// Sends all letters and returns their frames.
fn post<const PEERS: usize>(network: &mut Network<PEERS>, leaves: [usize; 3], letters: &[Letter]) -> Vec<Vec<u8>> {
    let mut frames = Vec::new();
    for (number, letter) in letters.iter().enumerate() {
        let to = letter.to.map_or(Address::new(0, 0), |(leaf, person)| address(leaf, person));
        let bytes = frame(address(letter.leaf, letter.from), to, number as u8, number);
        network.send(leaves[letter.leaf], bytes.clone());
        frames.push(bytes);
        network.run_for(millis(letter.pause));
    }
    frames
}

/// Sends all letters and checks how often each was delivered. With `roams`, every sender was heard at every leaf before.
fn is_bounded<const PEERS: usize>(joined: Joined, letters: &[Letter], roams: bool) -> Result<(), TestCaseError> {
    let (mut network, leaves) = joined.network::<PEERS>();
    for (home, person) in (0..3).flat_map(|home| (0..3).map(move |person| (home, person))).filter(|_| roams) {
        for (leaf, line) in leaves.into_iter().enumerate() {
            let number = 2_000 + 100 * leaf + 10 * home + usize::from(person);
            network.send(line, frame(address(home, person), Address::new(0, 0), leaf as u8, number));
            network.run_for(millis(40));
        }
    }
    let frames = post(&mut network, leaves, letters);
    network.run_for(secs(3));
    for (frame, letter) in frames.iter().zip(letters) {
        let deliveries = network.deliveries(frame);
        prop_assert!(deliveries.iter().flatten().all(|&times| times <= 1), "{letter:?}: {deliveries:?}");
        let all: usize = deliveries.iter().flatten().sum();
        prop_assert!(all <= joined.bound(), "{letter:?}: {all} times");
    }
    prop_assert!(joined.has_heartbeats || network.is_quiet());
    Ok(())
}

proptest! {
    #![proptest_config(cases(60))]

    /// whatever the lines, traffic and losses, and with more senders than the tables hold: a frame is sent at most
    /// once in each direction of a line, and is delivered a bounded number of times.
    #[test]
    fn no_frame_loops(joined in joined(0.3), letters in letters(60, 8, 1..150)) {
        is_bounded::<8>(joined, &letters, false)?;
    }

    /// the same if every sender was heard on every line, where R-4 does not stop loops of addressed frames.
    #[test]
    fn no_frame_loops_if_all_senders_are_heard_everywhere(joined in joined(0.1), letters in letters(3, 8, 100..300), rate in 1..12_u64) {
        is_bounded::<64>(Joined { rate, ..joined }, &letters, true)?;
    }

    /// the same with more traffic than slow lines carry, for longer than frames are remembered.
    #[test]
    fn no_frame_loops_on_saturated_lines(joined in joined(0.3), letters in letters(60, 2, 300..900), rate in 6..12_u64) {
        is_bounded::<8>(Joined { rate, ..joined }, &letters, false)?;
    }

    /// with tables that hold all senders, and without losses, every frame is delivered to its target once.
    #[test]
    fn every_frame_is_delivered_once(joined in joined(0.0), letters in letters(5, 40, 1..100)) {
        let (mut network, leaves) = joined.network::<64>();
        introduce_all(&mut network, leaves);
        network.run_for(secs(1));
        let frames = post(&mut network, leaves, &letters);
        network.run_for(secs(2));
        for (frame, letter) in frames.iter().zip(&letters) {
            let deliveries = network.deliveries(frame);
            for (leaf, line) in leaves.into_iter().enumerate() {
                let expected = match letter.to {
                    _ if leaf == letter.leaf => 0,
                    None => 1,
                    Some((to, _)) => usize::from(to == leaf),
                };
                prop_assert_eq!(deliveries[line][1], expected, "leaf {} of {:?}: {:?}", leaf, letter, deliveries);
            }
        }
    }

    /// while one leaf sends a flood of broadcasts, each of them twice, every addressed frame is delivered to its
    /// target once, and no broadcast is sent on a line twice.
    #[test]
    fn addressed_frames_are_delivered_during_a_flood(
        joined in joined(0.0),
        (rate, every) in prop::sample::select(vec![(12, 9), (92, 2), (0, 1)]),
        storm in 0..3_usize,
        letters in letters(5, 40, 1..40),
    ) {
        let joined = Joined { rate, ..joined };
        let (mut network, leaves) = joined.network::<64>();
        introduce_all(&mut network, leaves);
        let (mut drops, mut frames) = (Vec::new(), Vec::new());
        for (number, letter) in letters.iter().enumerate() {
            let target = letter.to.map_or(Address::new(0, 0), |(leaf, person)| address(leaf, person));
            let bytes = frame(address(letter.leaf, letter.from), target, number as u8, number);
            network.send(leaves[letter.leaf], bytes.clone());
            frames.push(bytes);
            for ms in 0..=letter.pause + 30 {
                if ms % every == 0 {
                    let drop = frame(address(storm, 0), Address::new(0, 0), drops.len() as u8, 10_000 + drops.len());
                    network.send(leaves[storm], drop.clone());
                    network.send(leaves[storm], drop.clone());
                    drops.push(drop);
                }
                network.run_for(millis(1));
            }
        }
        network.run_for(secs(2));
        for (frame, letter) in frames.iter().zip(&letters) {
            let Some((to, _)) = letter.to else { continue };
            let deliveries = network.deliveries(frame);
            for (leaf, line) in leaves.into_iter().enumerate() {
                let expected = usize::from(to == leaf && to != letter.leaf);
                prop_assert_eq!(deliveries[line][1], expected, "leaf {} of {:?}: {:?}", leaf, letter, deliveries);
            }
        }
        for drop in &drops {
            let mut deliveries = network.deliveries(drop);
            deliveries[leaves[storm]][0] = 1;
            prop_assert!(deliveries.iter().flatten().all(|&times| times <= 1), "{deliveries:?}");
        }
    }
}
