//! The file server, with any requests of three clients: no file stays open too long or is closed twice, no more are open than
//! there are sessions, and what is read is what is in the file.
//!
//! The input is a script. The first byte of a step selects the action:
//!
//! ```text
//!   0  a request            client, session, sequence number, operation, size, offset, number of a path
//!   1  a part of an upload  client, session, sequence number, offset, length, bytes
//!   2  any payload          client, length, bytes
//!   3  time passes          20 ms × n
//!   4  a link is stalled, or not any more
//!   5  a link is opened again
//! ```

use crate::support::files::{Packet, STATIC, request};
use crate::support::{TestVehicle, Tuning, millis};
use arbitrary::{Result, Unstructured};
use mavstack::config::StreamProfile;
use mavstack::dialect::{FileTransferProtocol, MavFtpOpcode};
use mavstack::frame::{Version, encode};
use mavstack::{Address, Config, Instant, LinkConfig, LinkId, Message, Pulse, StackOf};

const MAX_STEPS: usize = 64;
const SESSIONS: usize = 2;

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 2,
    parameters: Tuning,
    commands: { slots: 2 },
    files: { sessions: SESSIONS, upload: 200 },
)]
struct Served;

/// What clients ask for.
const PATHS: [&[u8]; 12] = [
    b"",
    b"/",
    b"log.bin",
    b"general.json",
    b"docs",
    b"docs/licence.txt",
    b"@PARAM",
    b"@PARAM/param.pck",
    b"@PARAM/param.pck?withdefaults=1&start=2",
    b"../log.bin",
    b"log.bin\0new.bin",
    b"new.bin",
];
/// A client: its address, and its link.
const CLIENTS: [(Address, u8); 3] =
    [(Address::new(255, 190), 0), (Address::new(254, 190), 0), (Address::new(255, 190), 1)];

struct Case {
    stack: Box<StackOf<Served>>,
    vehicle: TestVehicle,
    now: Instant,
    pulse: Pulse,
    seq: u8,
    is_stalled: [bool; 2],
    /// When a client was last heard, or was last sent something.
    heard: Instant,
}

/// Runs the target.
pub fn run(data: &[u8]) {
    static PULSE: Pulse = Pulse::new();
    let link = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let mut vehicle = TestVehicle::new();
    vehicle.files.content.insert("log.bin".to_string(), content());
    let mut case = Case {
        stack: Box::new(StackOf::<Served>::new(Config::new(Address::new(1, 1), &PULSE), [link; 2])),
        vehicle,
        now: Instant::from_millis(100),
        pulse: Pulse::new(),
        seq: 0,
        is_stalled: [false; 2],
        heard: Instant::ZERO,
    };
    let mut script = Unstructured::new(data);
    for _ in 0..MAX_STEPS {
        if script.is_empty() || case.step(&mut script).is_err() {
            break;
        }
    }
    case.end();
}

/// The file that is read.
fn content() -> Vec<u8> {
    (0..700u32).map(|i| (i * i / 5) as u8).collect()
}

impl Case {
    fn step(&mut self, script: &mut Unstructured<'_>) -> Result<()> {
        match script.int_in_range(0..=5)? {
            0 => {
                let client = script.choose_index(CLIENTS.len())?;
                let (session, seq) = (script.int_in_range(0..=2)?, script.arbitrary::<u8>()?);
                let (opcode, size) = (MavFtpOpcode(script.int_in_range(0..=18)?), script.arbitrary()?);
                let offset = script.int_in_range(0..=800)?;
                let path = PATHS[script.choose_index(PATHS.len())?];
                let size = if matches!(opcode.0, 5 | 15) { size } else { path.len() as u8 };
                self.send(client, &request(seq.into(), session, opcode, size, offset, path));
            }
            1 => {
                let client = script.choose_index(CLIENTS.len())?;
                let (session, seq) = (script.int_in_range(0..=2)?, script.arbitrary::<u8>()?);
                let (offset, len) = (script.int_in_range(0..=210)?, script.int_in_range(0..=60)?);
                let bytes = script.bytes(len)?;
                self.send(client, &request(seq.into(), session, MavFtpOpcode::WRITEFILE, len as u8, offset, bytes));
            }
            2 => {
                let (client, len) = (script.choose_index(CLIENTS.len())?, script.int_in_range(0..=251)?);
                let mut payload = [0; 251];
                payload[..len].copy_from_slice(script.bytes(len)?);
                let (target_system, target_component) = (1, 1);
                self.send(
                    client,
                    &FileTransferProtocol { payload, target_network: 0, target_system, target_component },
                );
            }
            3 => {
                for _ in 0..script.int_in_range(1..=40)? {
                    self.now += millis(20);
                    self.poll();
                }
            }
            4 => {
                let link = script.choose_index(2)?;
                self.is_stalled[link] = !self.is_stalled[link];
            }
            _ => self.stack.restart_link(LinkId(script.int_in_range(0..=1)?)),
        }
        self.poll();
        Ok(())
    }

    fn send(&mut self, client: usize, message: &FileTransferProtocol) {
        let (from, link) = CLIENTS[client];
        let mut frame = [0; 280];
        let len = encode(message, Version::V2, from, self.seq, &mut frame).expect("a frame");
        self.seq = self.seq.wrapping_add(1);
        self.stack.receive(self.now, LinkId(link), &frame[..len], &mut self.vehicle);
        self.heard = self.now;
    }

    fn poll(&mut self) {
        self.pulse.tick();
        self.stack.poll(self.now, &mut self.vehicle);
        for link in 0..2u8 {
            // What the link takes in the time.
            for _ in 0..2 {
                if !self.is_stalled[usize::from(link)] {
                    self.transmit(link);
                }
            }
        }
        // One more is open while its checksum is computed.
        assert!(self.vehicle.files.open.len() <= SESSIONS + 1, "F-6: {:?}", self.vehicle.files.open);
        let tuning = self.stack.parameters();
        assert!((9.0..=12.6).contains(&tuning.get(Tuning::BAT_LOW)), "P-14");
    }

    fn transmit(&mut self, link: u8) {
        let frame = self.stack.transmit(self.now, LinkId(link), &mut self.vehicle).to_vec();
        self.stack.transmitted(LinkId(link), frame.len());
        if frame.get(7).copied() != Some(110) {
            return;
        }
        self.heard = self.now;
        let message = FileTransferProtocol::decode(&frame[10..frame.len() - 2]);
        let packet = Packet::of(&message);
        let to = (Address::new(message.target_system, message.target_component), link);
        assert!(CLIENTS.contains(&to), "an answer to somebody else");
        if let Some(error) = packet.error() {
            assert!((1..=10).contains(&error.0), "F-3: {packet:?}");
            return;
        }
        if !matches!(packet.request, MavFtpOpcode::READFILE | MavFtpOpcode::BURSTREADFILE) {
            return;
        }
        assert!(!packet.data.is_empty(), "F-8: an end instead");
        let offset = packet.offset as usize;
        let is_of = |bytes: &[u8]| bytes.get(offset..).is_some_and(|rest| rest.starts_with(&packet.data));
        let is_static = STATIC.iter().any(|file| is_of(file.bytes()));
        // The parameters begin with this, and have their names in them.
        let is_params = offset > 0 || packet.data.first().is_some_and(|byte| matches!(byte, 0x1B | 0x1C));
        let is_hook = self.vehicle.files.content.values().any(|bytes| is_of(bytes));
        assert!(is_static || is_hook || is_params, "{packet:?}");
    }

    /// F-6: all files are closed after the time of an idle session.
    fn end(&mut self) {
        self.is_stalled = [false; 2];
        for _ in 0..36 {
            self.now += millis(500);
            self.poll();
        }
        assert!(self.vehicle.files.open.is_empty(), "F-6: {:?}", self.vehicle.files.open);
    }
}

#[cfg(test)]
mod tests {
    /// Scripts of random bytes.
    #[test]
    fn random_scripts_pass() {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        let count = std::env::var("SCRIPTS").map_or(500, |count| count.parse().expect("a number"));
        for _ in 0..count {
            let script: Vec<u8> = (0..300).map(|_| next()).collect();
            super::run(&script);
        }
    }
}
