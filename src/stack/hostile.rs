//! What hostile and clumsy peers may cause: rules over all services. Messages with random payloads cover a new
//! service without a line of its own; its requests in the list of [`requests`] cover it better.

mod amplification;
mod properties;

use std::vec;
use std::vec::Vec;

use super::deadlines::world::{Request, command, file_request, of, requests, waypoint};
use super::deadlines::{COMPANION, Everything, LINKS, Rover, STATION, WINGMAN};
use crate::StackOf;
use crate::config::StreamProfile;
use crate::dialect::*;
use crate::frame::Version;
use crate::message::{Address, Item, Message};
use crate::time::{Duration, Instant};
use crate::{Config, LinkConfig, LinkId, PlanType, Pulse, VehicleState};

/// The rates of the attacker's link, and of the others (bytes/s).
const FAST: u32 = 5_760;
const SLOW: u32 = 1_920;

/// The link of the one who asks, one without streams, and one that streams fill.
const ASKING: usize = 0;
const IDLE: usize = 1;
const BUSY: usize = 2;

/// The messages that the busy link sends as streams: ATTITUDE, SYS_STATUS, BATTERY_STATUS, VFR_HUD,
/// GIMBAL_DEVICE_ATTITUDE_STATUS.
const STREAMS: [u32; 5] = [30, 1, 147, 74, 285];

/// One that nobody knows.
const STRANGER: Address = Address::new(77, 190);

/// A sent frame.
struct Sent {
    link: usize,
    /// Whether it is another system's.
    is_forwarded: bool,
    id: u32,
    len: usize,
}

/// A vehicle with everything, and its lines.
struct Field {
    stack: StackOf<Everything>,
    rover: Rover,
    pulse: &'static Pulse,
    now: Instant,
    step: Duration,
    seq: u8,
    /// The bytes that each line takes now, times 10^6.
    room: [i64; LINKS],
    sent: Vec<Sent>,
    /// The item that each link asked for last.
    asked: [Option<MissionRequestInt>; LINKS],
    /// The most hooks in a poll, or in a call of `receive`.
    hooks: u32,
}

impl Field {
    fn new(links: [LinkConfig; LINKS]) -> Self {
        let pulse: &'static Pulse = std::boxed::Box::leak(std::boxed::Box::new(Pulse::new()));
        let state = VehicleState {
            base_mode: MavModeFlag::CUSTOM_MODE_ENABLED,
            custom_mode: 1,
            system_status: MavState::STANDBY,
        };
        let mut field = Self {
            stack: StackOf::<Everything>::new(Config::new(Address::new(1, 1), pulse), links),
            rover: Rover::new(state),
            pulse,
            now: Instant::from_millis(10),
            step: Duration::from_millis(20),
            seq: 0,
            room: [0; LINKS],
            sent: Vec::new(),
            asked: [const { None }; LINKS],
            hooks: 0,
        };
        let items = vec![Item::from_int(&waypoint()); 2];
        let loaded = field.stack.load_plan(field.now, PlanType::Mission, items, &mut field.rover);
        assert!(loaded.is_ok());
        field
    }

    /// Receives a frame now.
    fn receive(&mut self, link: usize, frame: &[u8]) {
        let link = LinkId(u8::try_from(link).expect("a link"));
        let mut rest = frame;
        while !rest.is_empty() {
            let taken = self.stack.receive(self.now, link, rest, &mut self.rover);
            self.hooks = self.hooks.max(self.stack.shared.hooks.0);
            rest = &rest[taken..];
        }
        self.seq = self.seq.wrapping_add(1);
    }

    /// Receives a request now. Returns its length.
    fn request(&mut self, link: usize, from: Address, request: &Request) -> usize {
        let frame = request.frame(Version::V2, from, self.seq);
        self.receive(link, &frame);
        frame.len()
    }

    /// A HEARTBEAT of a ground station.
    fn beat(&mut self, link: usize, from: Address) {
        let station = Heartbeat { r#type: MavType::GCS, autopilot: MavAutopilot::INVALID, ..Heartbeat::default() };
        self.request(link, from, &of(station));
    }

    /// Runs one pass, then has each line take what it can.
    fn step(&mut self) {
        self.now += self.step;
        self.pulse.tick();
        self.stack.poll(self.now, &mut self.rover);
        self.hooks = self.hooks.max(self.stack.shared.hooks.0);
        for link in 0..LINKS {
            let rate = i64::from(self.stack.links[link].port.config.bytes_per_second);
            self.room[link] = (self.room[link] + rate * self.step.as_micros().cast_signed()).min(rate * 20_000);
            while self.room[link] > 0 {
                let len = self.transmit(link);
                if len == 0 {
                    break;
                }
                self.room[link] -= i64::try_from(len).expect("a frame") * 1_000_000;
            }
        }
    }

    /// Takes a frame of a link. Returns its length.
    fn transmit(&mut self, link: usize) -> usize {
        let id = LinkId(u8::try_from(link).expect("a link"));
        let frame = self.stack.transmit(self.now, id, &mut self.rover);
        let (system, message) = match *frame {
            [0xFD, _, _, _, _, system, _, a, b, c, ..] => (system, u32::from_le_bytes([a, b, c, 0])),
            [0xFE, _, _, system, _, id, ..] => (system, u32::from(id)),
            _ => return 0,
        };
        let len = frame.len();
        if message == MissionRequestInt::ID {
            self.asked[link] = Some(MissionRequestInt::decode(&frame[10..len - 2]));
        }
        self.sent.push(Sent { link, is_forwarded: system != 1, id: message, len });
        self.stack.transmitted(id, len);
        len
    }

    /// As a sleeping loop does it: runs passes when something is due.
    fn sleep_for(&mut self, time: Duration) {
        let (end, step) = (self.now + time, self.step);
        while self.now < end {
            let next = self.stack.next_deadline(self.now).min(end).min(self.now + Duration::from_millis(200));
            self.step = (next - self.now).max(step);
            self.step();
        }
        self.step = step;
    }

    fn run_for(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.step();
        }
    }

    /// Receives the item that a link has asked for, if it has.
    fn answer_with_item(&mut self, link: usize, from: Address) {
        if let Some(MissionRequestInt { seq, mission_type, .. }) = self.asked[link].take() {
            let (target_system, target_component) = (1, 1);
            let z = f32::from(from.system.wire());
            let item = MissionItemInt { seq, mission_type, target_system, target_component, z, ..waypoint() };
            self.request(link, from, &of(item));
        }
    }

    /// The bytes of the frames that a link has sent, of those that `is_counted`.
    fn bytes(&self, link: usize, is_counted: impl Fn(&Sent) -> bool) -> usize {
        self.sent.iter().filter(|sent| sent.link == link && is_counted(sent)).map(|sent| sent.len).sum()
    }
}

/// A link without streams.
fn quiet(rate: u32) -> LinkConfig {
    LinkConfig::uart(rate * 10).with_streams(StreamProfile::Off)
}

/// A vehicle and a station on its first link. The station has already sent what other requests depend on: it has listed logs and plans,
/// and has opened a file.
fn prepared() -> Field {
    let mut field = Field::new([quiet(FAST), quiet(SLOW), quiet(SLOW)]);
    field.beat(ASKING, STATION);
    field.run_for(Duration::from_millis(500));
    let (target_system, target_component) = (1, 1);
    field.request(ASKING, STATION, &file_request(0, MavFtpOpcode::OPENFILERO, "a"));
    field.request(ASKING, STATION, &of(LogRequestList { start: 0, end: u16::MAX, target_system, target_component }));
    let mission_type = MavMissionType::MISSION;
    field.request(ASKING, STATION, &of(MissionRequestList { target_system, target_component, mission_type }));
    field.run_for(Duration::from_millis(1_500));
    field.sent.clear();
    field
}

/// What a link sends in a flood (bytes).
#[derive(Clone, Copy, Debug, Default)]
struct Shares {
    streams: usize,
    forwarded: usize,
    rest: usize,
}

/// Has streams fill the busy link, and requests another one of this rate, for so many seconds. `send` makes the vehicle receive a request, and
/// returns its length; 0 ends the requests. Returns what the busy link sends.
fn flood(field: &mut Field, rate: u32, seconds: usize, mut send: impl FnMut(&mut Field) -> usize) -> Shares {
    const PASSES: usize = 200;
    field.step = Duration::from_millis(5);
    for id in STREAMS {
        field.request(BUSY, WINGMAN, &command(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 2_000.0, 0.0]));
        field.run_for(Duration::from_millis(100));
    }
    field.run_for(Duration::from_millis(200));
    field.sent.clear();
    let mut room = 0;
    for _ in 0..seconds * PASSES {
        room += i64::from(rate) * 5;
        while room > 0 {
            let len = send(field);
            if len == 0 {
                break;
            }
            room -= 1_000 * i64::try_from(len).expect("a frame");
        }
        field.step();
    }
    let is_stream = |sent: &Sent| STREAMS.contains(&sent.id);
    Shares {
        streams: field.bytes(BUSY, |sent| !sent.is_forwarded && is_stream(sent)),
        forwarded: field.bytes(BUSY, |sent| sent.is_forwarded),
        rest: field.bytes(BUSY, |sent| !sent.is_forwarded && !is_stream(sent)),
    }
}

/// Checks a flood of `seconds` against a calm time: others' requests have a tenth, forwarded frames half, streams keep half.
fn check(calm: &Shares, flooded: &Shares, seconds: usize, what: &str) {
    const LONG_FRAME: usize = 280;
    let rate = usize::try_from(SLOW).expect("a rate") * seconds;
    let rest = flooded.rest.saturating_sub(calm.rest);
    assert!(rest <= rate / 10 + LONG_FRAME, "{what}: {rest} bytes of {rate}");
    assert!(flooded.forwarded <= rate / 2 + LONG_FRAME, "{what}: {flooded:?} of {rate}");
    assert!(2 * flooded.streams + LONG_FRAME >= calm.streams, "{what}: {flooded:?}, calm {calm:?}");
}

/// Pseudorandom numbers, the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    fn below(&mut self, end: usize) -> usize {
        usize::try_from(self.next()).expect("31 bits") % end
    }
}
