//! Signed frames, changed and repeated: frames not signed with the key are never accepted, and signed ones are accepted once
//! (G-6, G-7, G-10).
//!
//! The input is a script. The first byte of a step selects the action:
//!
//! ```text
//!   0  a new frame                 stream, time step
//!   1  a frame with changed bits   which, number of changes; for each: offset (2 bytes), bits
//!   2  a repeated frame            which
//!   3  time passes                 0.1 s × n
//!   4  the link is reset
//!   5  the vehicle reboots with its stored timestamp
//!   6  an unsigned frame, or one with another key
//!   7  any bytes                   length, bytes
//! ```

use crate::signer::{KEY, OTHER_KEY, Rig, Signer, repair};
use crate::support::millis;
use arbitrary::{Result, Unstructured};
use mavstack::dialect::{CommandLong, MavCmd};
use mavstack::frame::Version;
use mavstack::signing::LinkSigning;
use mavstack::{Address, LinkConfig};

const MAX_STEPS: usize = 48;
const LINKS: [LinkConfig; 2] = [
    LinkConfig::uart(115_200).with_signing(LinkSigning::REQUIRED),
    LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN),
];

/// A frame signed with the key.
struct Made {
    frame: Vec<u8>,
    /// The unique command id in the frame.
    number: u16,
    is_accepted: bool,
}

struct Case {
    rig: Rig,
    signers: [Signer; 4],
    /// All frames signed with the key.
    made: Vec<Made>,
    /// The next command id.
    number: u16,
    /// All bytes received, by link.
    history: [Vec<u8>; 2],
    /// Commands of frames that lost their signature by a mutation and were received on the open link.
    unsigned: Vec<u16>,
}

/// Runs the target.
pub fn run(data: &[u8]) {
    // Each script has its own key. The fuzzer sees the operands of comparisons and could otherwise replay a valid frame of another
    // run.
    let mut key = KEY;
    let mut crc = crc_any::CRCu64::crc64();
    crc.digest(data);
    key[..8].copy_from_slice(&crc.get_crc().to_le_bytes());
    let mut rig = Rig::new(LINKS);
    rig.set_key(key);
    let signer = |address, link| Signer::new(key).of(address).link(link);
    let (near, far) = (Address::new(255, 190), Address::new(7, 1));
    let signers = [signer(near, 0), signer(near, 1), signer(far, 0), signer(Address::new(255, 191), 255)];
    let mut case =
        Case { rig, signers, made: Vec::new(), number: 50_000, history: Default::default(), unsigned: Vec::new() };
    let mut u = Unstructured::new(data);
    for _ in 0..MAX_STEPS {
        if u.is_empty() || case.step(&mut u).is_err() {
            break;
        }
    }
    case.finish();
}

impl Case {
    fn step(&mut self, u: &mut Unstructured<'_>) -> Result<()> {
        let what: u8 = u.arbitrary()?;
        // Open links accept unsigned frames, but none with an invalid signature.
        let link = usize::from(what >> 7);
        match what & 7 {
            0 => {
                let (stream, ahead): (u8, i8) = (u.arbitrary()?, u.arbitrary()?);
                let signer = &mut self.signers[usize::from(stream % 4)];
                // Up to two minutes forwards or backwards.
                signer.timestamp = signer.timestamp.saturating_add_signed(i64::from(ahead) * 100_000);
                let frame = signer.frame(&command(self.number));
                self.made.push(Made { frame: frame.clone(), number: self.number, is_accepted: false });
                self.number += 1;
                self.deliver(link, &frame);
            }
            1 => {
                let (which, changes): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                let Some(mut frame) = self.pick(which) else { return Ok(()) };
                for _ in 0..=changes % 4 {
                    let (at, bits): (u16, u8) = (u.arbitrary()?, u.arbitrary()?);
                    let at = usize::from(at) % frame.len();
                    frame[at] ^= bits;
                }
                if changes & 0x80 != 0 && frame.len() > 12 && frame[0] == 0xFD {
                    // Correct the checksum, so that only the signature is invalid.
                    repair(&mut frame);
                }
                self.deliver(link, &frame);
            }
            2 => {
                let which = u.arbitrary()?;
                let Some(frame) = self.pick(which) else { return Ok(()) };
                self.deliver(link, &frame);
            }
            3 => self.rig.run_for(millis(100 * u64::from(u.arbitrary::<u8>()?))),
            4 => self.rig.restart(link),
            5 => {
                let stored = self.rig.timestamp() + 6_000_000;
                let now = self.rig.now;
                self.rig.signing().set_key(now, mavstack::signing::SigningKey::new(self.signers[0].key), stored);
            }
            6 => {
                let mut other = self.signers[0].clone();
                other.key = OTHER_KEY;
                let frame = if u.arbitrary::<bool>()? {
                    other.frame(&command(1))
                } else {
                    other.unsigned(Version::V2, &command(1))
                };
                self.deliver(0, &frame);
            }
            _ => {
                let len: u8 = u.arbitrary()?;
                let bytes = u.bytes(usize::from(len).min(u.len()))?.to_vec();
                self.deliver(0, &bytes);
            }
        }
        Ok(())
    }

    /// Checks that no more frames were verified than were received unchanged.
    fn finish(&mut self) {
        let is_received = |made: &Made| self.history.iter().any(|history| contains(history, &made.frame));
        let received = self.made.iter().filter(|made| is_received(made)).count();
        let verified = self.rig.counters().verified;
        assert!(verified as usize <= received, "{verified} frames verified, {received} received unchanged");
    }

    fn pick(&self, which: u8) -> Option<Vec<u8>> {
        self.made.get(usize::from(which) % self.made.len().max(1)).map(|made| made.frame.clone())
    }

    /// Delivers bytes to the vehicle and checks the commands that it executes. On the link that requires signatures it executes
    /// only frames signed with the key, unchanged, and once. On the open link the same holds for frames that claim to be signed.
    fn deliver(&mut self, link: usize, bytes: &[u8]) {
        self.rig.vehicle.calls.clear();
        self.rig.receive(link, bytes);
        // A frame may have been received earlier, inside the candidate of a longer one.
        self.history[link].extend(bytes);
        if let (1, Some(0), Some(&[low, high])) = (link, bytes.get(2).map(|flags| flags & 1), bytes.get(38..40)) {
            self.unsigned.push(u16::from_le_bytes([low, high]));
        }
        for command in self.rig.vehicle.commands() {
            let number = command.id.0;
            let made = self.made.iter_mut().find(|made| made.number == number);
            if link == 1 && self.unsigned.contains(&number) {
                continue;
            }
            let Some(made) = made else { panic!("command {number} was never signed: {bytes:02X?}") };
            assert!(
                contains(&self.history[link], &made.frame),
                "command {number} of a frame that was not signed: {bytes:02X?}"
            );
            assert!(!made.is_accepted, "command {number} was accepted twice");
            made.is_accepted = true;
        }
        // Send pending output, so that there is room for answers.
        for link in 0..2 {
            while !self.rig.transmit(link).is_empty() {}
        }
    }
}

fn contains(bytes: &[u8], frame: &[u8]) -> bool {
    bytes.windows(frame.len()).any(|window| window == frame)
}

/// Returns a command with a unique id.
fn command(number: u16) -> CommandLong {
    CommandLong { command: MavCmd(number), target_system: 1, target_component: 1, ..CommandLong::default() }
}
