//! Sessions with pymavlink's signing, in both directions, and which side accepts what (G-1, G-6, G-11).

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use crate::support::signer::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::signing::LinkSigning;
use mavstack::{Address, LinkConfig, Message};

/// The ground station, in a Python process.
struct Peer {
    child: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
}

impl Peer {
    fn start() -> Option<Self> {
        let mut command = Command::new(pymavlink::python()?);
        command.arg("tests/signing/peer.py").stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("python runs");
        let (input, output) = (child.stdin.take(), child.stdout.take().expect("piped"));
        Some(Self { child, input, output: BufReader::new(output) })
    }

    fn ask(&mut self, line: &str) -> String {
        let input = self.input.as_mut().expect("it runs");
        writeln!(input, "{line}").expect("it reads");
        let mut answer = String::new();
        assert!(self.output.read_line(&mut answer).expect("it answers") > 0, "it ended at: {line}");
        answer.trim_end().to_owned()
    }

    fn set_key(&mut self, key: [u8; 32], timestamp: u64) {
        assert_eq!(self.ask(&format!("key {} {timestamp} 3", hex(&key))), "ok");
    }

    /// Returns a frame that pymavlink signed.
    fn frame(&mut self, what: &str) -> Vec<u8> {
        let hex = self.ask(&format!("tx {what}"));
        (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex")).collect()
    }

    /// Passes a frame to pymavlink; returns the message's id if it accepts the frame.
    fn take(&mut self, frame: &[u8]) -> Option<u32> {
        self.ask(&format!("rx {}", hex(frame))).parse().ok()
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // The process ends with its input.
        self.input = None;
        let _ = self.child.wait();
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn rig() -> Rig {
    let wire = LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN.with_provisioning());
    Rig::new([LinkConfig::uart(115_200).with_signing(LinkSigning::REQUIRED), wire])
}

/// Half a minute in both directions: each side accepts every frame of the other once.
#[test]
fn signed_session_with_pymavlink() {
    let Some(mut peer) = Peer::start() else { return };
    let mut rig = rig();
    rig.set_key(KEY);
    peer.set_key(KEY, NOW);
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for second in 0..30 {
        for what in ["heartbeat", "land", "land"] {
            let frame = peer.frame(what);
            rig.receive(0, &frame);
            theirs.push(frame);
        }
        assert_eq!(rig.vehicle.commands().len(), 2 * (second + 1));
        rig.run_for(secs(1));
        let sent = rig.transmit(0);
        assert!(sent.iter().any(|frame| frame.id() == Heartbeat::ID));
        for frame in sent {
            assert_eq!(peer.take(&frame.raw), Some(frame.id()), "{frame:?}");
            ours.push(frame.raw);
        }
    }
    assert_eq!(rig.counters().verified, 90);
    for frame in &ours {
        assert_eq!(peer.take(frame), None, "a replay of ours");
    }
    for frame in &theirs {
        rig.receive(0, frame);
    }
    assert_eq!((rig.counters().verified, rig.counters().replayed), (90, 90));
    // G-6: an accepted frame moves the receiver's time.
    let behind = rig.timestamp() - peer.ask("timestamp").parse::<u64>().expect("a number");
    assert!(behind < 200_000, "{behind}");
}

/// G-11: the ground station sets a key, the next heartbeat shows that it is in use, and the station signs too. Then it removes
/// the key.
#[test]
fn pymavlink_sets_and_removes_a_key() {
    let Some(mut peer) = Peer::start() else { return };
    let mut rig = rig();
    rig.receive(1, &peer.frame(&format!("setup {} {NOW}", hex(&KEY))));
    let first = rig.transmit(1).swap_remove(0);
    peer.set_key(KEY, NOW);
    assert_eq!(peer.take(&first.raw), Some(Heartbeat::ID));
    rig.receive(0, &peer.frame("land"));
    let ack = rig.sent::<CommandAck>(0).swap_remove(0);
    assert_eq!(peer.take(&ack.raw), Some(CommandAck::ID));
    rig.receive(1, &peer.frame(&format!("setup {} 0", hex(&[0; 32]))));
    let first = rig.transmit(1).swap_remove(0);
    assert_eq!((first.id(), first.is_signed()), (Heartbeat::ID, false));
    assert_eq!(peer.take(&first.raw), None, "it still requires signatures");
}

/// G-10: with different keys neither side accepts frames of the other.
#[test]
fn frames_with_another_key_are_refused_by_both() {
    let Some(mut peer) = Peer::start() else { return };
    let mut rig = rig();
    rig.set_key(OTHER_KEY);
    peer.set_key(KEY, NOW);
    for what in ["heartbeat", "land", "ping"] {
        let frame = peer.frame(what);
        rig.receive(0, &frame);
        rig.receive(1, &frame);
    }
    assert_eq!((rig.vehicle.commands().len(), rig.counters().bad_signature), (0, 6));
    for link in 0..2 {
        for frame in rig.transmit(link) {
            assert_eq!(peer.take(&frame.raw), None);
        }
    }
}

/// G-6: both sides accept the same frames of a dozen streams with right signatures and random times.
#[test]
fn both_sides_accept_the_same_frames() {
    let Some(mut peer) = Peer::start() else { return };
    for seed in 0..8 {
        let mut rng = Rng::new(seed);
        let mut rig = rig();
        rig.set_key(KEY);
        peer.set_key(KEY, rig.timestamp());
        let mut accepted = 0;
        for number in 0..500 {
            // Around a minute ago, and seldom ahead, which moves both clocks.
            let span = [100, 100_000, 7_000_000, 20_000_000][rng.below(4) as usize];
            let mut at = rig.timestamp() - rng.below(span);
            if rng.below(20) == 0 {
                at += rng.below(2_000_000);
            }
            let from = Address::new(100 + rng.below(3) as u8, 1 + rng.below(2) as u8);
            let mut signer = Signer::new(KEY).of(from).link(rng.below(2) as u8).at(at);
            signer.seq = number as u8;
            let frame = signer.frame(&Gcs::heartbeat());
            let before = rig.counters().verified;
            rig.receive(0, &frame);
            let is_accepted = rig.counters().verified > before;
            assert_eq!(peer.take(&frame).is_some(), is_accepted, "seed {seed}, frame {number}: {frame:02x?}");
            accepted += u32::from(is_accepted);
        }
        assert!((20..480).contains(&accepted), "seed {seed}: {accepted}");
    }
}
