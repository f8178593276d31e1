//! Tests the custom messages and the custom command against pymavlink, generated from the same XML: the vehicle reads pymavlink's
//! frames, and pymavlink reads the vehicle's.

#[path = "../../../../tests/support/pymavlink.rs"]
mod pymavlink;

use example_own_xml::crane::{CraneControl, CraneHook, CraneReport, commands};
use example_own_xml::{Mavlink, Vessel};
use mavstack::dialect::{CommandAck, MavResult};
use mavstack::{Address, Config, Instant, LinkConfig, LinkId, Message, Pulse, StackOf};
use std::path::Path;
use std::process::Command;

const LINK: LinkId = LinkId(0);

/// CRANE_CONTROL and MAV_CMD_CRANE_HOOK, as `reference.py` prints them.
const CONTROL: &str = "fd06000000ffbe09cf00000000bf070141e6";
const COMMAND: &str = "fd20000000ffbe4c00000000803f0000004000000000000000000000000000000000000000007c7907011ebc";

struct Bench {
    stack: StackOf<Mavlink>,
    pulse: &'static Pulse,
    vessel: Vessel,
    now: Instant,
}

impl Bench {
    fn new() -> Self {
        let pulse = Box::leak(Box::new(Pulse::new()));
        let stack = StackOf::<Mavlink>::new(Config::new(Address::new(7, 1), pulse), [LinkConfig::uart(57_600)]);
        Self { stack, pulse, vessel: Vessel::default(), now: Instant::from_millis(1) }
    }

    fn receive(&mut self, frame: &str) {
        self.stack.receive(self.now, LINK, &bytes(frame), &mut self.vessel);
    }

    /// Returns the bytes that the vehicle sends within `millis`.
    fn sent(&mut self, millis: u64) -> Vec<u8> {
        let mut sent = Vec::new();
        for _ in 0..millis {
            // A link begins with HEARTBEAT, which needs a tick.
            self.pulse.tick();
            self.stack.poll(self.now, &mut self.vessel);
            let pending = self.stack.transmit(self.now, LINK, &mut self.vessel);
            let len = pending.len();
            sent.extend_from_slice(pending);
            self.stack.transmitted(LINK, len);
            self.now += mavstack::Duration::from_millis(1);
        }
        sent
    }
}

fn bytes(hex: &str) -> Vec<u8> {
    let digits = |at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal");
    (0..hex.len()).step_by(2).map(digits).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Runs `reference.py` and returns its output; `None` if pymavlink is not available.
fn reference(frames: &[u8]) -> Option<Vec<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let output = Command::new(pymavlink::python()?)
        .arg(root.join("tests/reference.py"))
        .args([root.join("crane.xml"), root.join("../../../dialect/definitions")])
        .arg(hex(frames))
        .output()
        .expect("python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8(output.stdout).expect("text").lines().map(str::to_owned).collect())
}

#[test]
fn frames_of_the_reference_implementation_are_decoded() {
    let mut bench = Bench::new();
    bench.receive(CONTROL);
    assert_eq!(bench.vessel.speed, -0.5);
    bench.receive(COMMAND);
    assert_eq!(bench.vessel.hook, CraneHook::OPEN);
    let counters = bench.stack.link_counters(LINK).expect("the link");
    assert_eq!((counters.unknown, counters.not_ours), (0, 0));
}

#[test]
fn a_parameter_that_the_xml_does_not_allow_is_denied() {
    let params = |hook| mavstack::Item {
        command: example_own_xml::crane::mav_cmd::CRANE_HOOK,
        params: [hook, 0.0, 0.0, 0.0],
        ..Default::default()
    };
    assert_eq!(params(1.0).decode(), Ok(commands::CraneHook { hook: CraneHook::OPEN, delay: 0.0 }));
    assert!(params(2.0).decode::<commands::CraneHook>().is_err());
}

#[test]
fn the_reference_implementation_decodes_the_vehicles_frames() {
    let mut bench = Bench::new();
    bench.vessel.result = MavResult::FAILED;
    bench.receive(COMMAND);
    let sent = bench.sent(1_000);
    let Some(lines) = reference(&sent) else { return };
    assert_eq!(lines[..2], [CONTROL, COMMAND], "the frames above are up to date");
    let ack = lines.iter().find(|line| line.contains("COMMAND_ACK")).expect("an answer");
    assert!(ack.contains("'command': 31100, 'result': 0"), "{ack}");
    let reports: Vec<_> = lines.iter().filter(|line| line.contains("CRANE_REPORT")).collect();
    assert!(reports.len() >= 2, "{lines:?}");
    for field in
        ["'line_out': 12.5", "'tension': -3", "'hook': 1", "'result': 4", "'cargo': 'anchor'", "'temperature': 41"]
    {
        assert!(reports[0].contains(field), "{field}: {}", reports[0]);
    }
}

#[test]
fn the_wire_format_matches_the_definition() {
    assert_eq!(
        (CraneReport::ID, CraneReport::CRC_EXTRA, CraneReport::BASE_LEN, CraneReport::MAX_LEN),
        (53_000, 104, 28, 29)
    );
    assert_eq!((CraneControl::ID, CraneControl::CRC_EXTRA, CraneControl::MAX_LEN), (53_001, 139, 6));
    // Types of common are not generated again.
    assert_eq!(CommandAck::default().result, CraneReport::default().result);
}
