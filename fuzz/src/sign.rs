//! Signed frames, changed and repeated: what was not made with the key is accepted never, and what was is accepted once
//! (G-6, G-7, G-10, GOAL-6).
//!
//! A script of steps, of which the first byte says what is done:
//!
//! ```text
//!   0  the next frame              stream  step of time
//!   1  a frame with bits changed   which   number of changes, each: where (2 bytes), bits
//!   2  a frame once more           which
//!   3  time goes by                0.1 s × n
//!   4  the link is opened anew
//!   5  the vehicle restarts with the time that it has stored
//!   6  a frame without a signature, or with another's key
//!   7  any bytes                   length, bytes
//! ```

use crate::signer::{KEY, OTHER_KEY, Rig, Signer, repair};
use crate::support::millis;
use arbitrary::{Result, Unstructured};
use mavstack::dialect::{CommandLong, MavCmd};
use mavstack::{Address, LinkConfig, LinkSigning, Version};

const MAX_STEPS: usize = 48;
const LINKS: [LinkConfig; 2] = [
    LinkConfig::uart(115_200).with_signing(LinkSigning::REQUIRED),
    LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN),
];

/// A frame that was made with the key.
struct Made {
    frame: Vec<u8>,
    /// The command that only it has.
    number: u16,
    is_accepted: bool,
}

struct Case {
    rig: Rig,
    signers: [Signer; 4],
    /// What was made with the key.
    made: Vec<Made>,
    /// The number of the next command.
    number: u16,
    /// All that came, by link.
    history: [Vec<u8>; 2],
    /// The commands of frames that came by the open link without a signature, made so by changed bits.
    unsigned: Vec<u16>,
}

/// Runs the script.
pub fn run(data: &[u8]) {
    // Another key for each script: the fuzzer sees what is compared, and has brought along a good frame of another run.
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
        // Open links accept what is unsigned, but nothing with a wrong signature.
        let link = usize::from(what >> 7);
        match what & 7 {
            0 => {
                let (stream, ahead): (u8, i8) = (u.arbitrary()?, u.arbitrary()?);
                let signer = &mut self.signers[usize::from(stream % 4)];
                // Up to two minutes, also backwards.
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
                    // So that nothing but the signature is wrong.
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
                self.rig.signing().set_key(now, mavstack::SigningKey::new(self.signers[0].key), stored);
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

    /// No more frames were verified than came as they were made.
    fn finish(&mut self) {
        let came = |made: &Made| self.history.iter().any(|history| contains(history, &made.frame));
        let came = self.made.iter().filter(|made| came(made)).count();
        let verified = self.rig.counters().verified;
        assert!(verified as usize <= came, "{verified} frames of {came} were verified");
    }

    fn pick(&self, which: u8) -> Option<Vec<u8>> {
        self.made.get(usize::from(which) % self.made.len().max(1)).map(|made| made.frame.clone())
    }

    /// Bytes come, and the vehicle does what it does. On the link that requires signatures nothing is carried out but what came
    /// as it was made with the key, for the first time; on the open one the same goes for frames that say they are signed, and what
    /// is carried out may have come before, too.
    fn deliver(&mut self, link: usize, bytes: &[u8]) {
        self.rig.vehicle.calls.clear();
        self.rig.receive(link, bytes);
        // A frame may have come before, behind what seemed to be the front of a longer one.
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
                "command {number} of a frame that nobody signed: {bytes:02X?}"
            );
            assert!(!made.is_accepted, "command {number} was accepted twice");
            made.is_accepted = true;
        }
        // What it has to say, so that answers find room.
        for link in 0..2 {
            while !self.rig.transmit(link).is_empty() {}
        }
    }
}

fn contains(bytes: &[u8], frame: &[u8]) -> bool {
    bytes.windows(frame.len()).any(|window| window == frame)
}

/// One that no other frame has.
fn command(number: u16) -> CommandLong {
    CommandLong { command: MavCmd(number), target_system: 1, target_component: 1, ..CommandLong::default() }
}
