//! A complete vehicle with four links, its flash and its peers, driven by a script of times, messages, line faults and power cuts.
//! [`script`] defines the bytes of the script, [`checks`] the invariants.

mod checks;
mod declared;
mod hostile;
mod line;
mod script;

use crate::flash::RamFlash;
use crate::signer::{KEY, NOW, Signer};
use crate::support::{Call, TestVehicle, VEHICLE, reference};
use arbitrary::Unstructured;
use checks::Checks;
use declared::Declared;
use line::Uart;
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::plan::Durability;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::storage::{RestoreError, Store};
use mavstack::{Address, Config, Duration, Instant, Item, LinkConfig, LinkId, Message, Pulse, Stack};

/// Number of links of the vehicle.
const LINKS: usize = 4;
const SATELLITE: usize = 2;

type Flash = RamFlash<8, 512>;

const MAX_STEPS: usize = 64;
/// Maximum number of polls per script.
const MAX_POLLS: u32 = 450;
/// The same for a vehicle with all services: each poll has more to do.
const MAX_FULL_POLLS: u32 = 100;

static PULSE: Pulse = Pulse::new();

struct Session<D: Declared> {
    setup: [u8; 2],
    stack: Box<Stack<D, LINKS>>,
    vehicle: TestVehicle,
    store: Store<Flash>,
    lines: [Uart; LINKS],
    now: Instant,
    loop_runs: bool,
    polls: u32,
    timestamp: u64,
    seq: u8,
    /// The upload of each link's client, and the number of items requested so far.
    uploads: [Option<(Tag, u16)>; LINKS],
    /// Whether frames of each link's client may be lost.
    loses: [bool; LINKS],
    last_tag: u16,
    /// Whether hostile peers have acted.
    has_hostile: bool,
    checks: Checks,
}

/// Identifies an upload. Every item contains it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tag {
    plan: MavMissionType,
    count: u16,
    number: u16,
}

/// What is left of a session.
#[cfg_attr(not(test), allow(dead_code, reason = "the tests look at it"))]
struct Played {
    live: [Vec<Item>; 3],
    lines: [Uart; LINKS],
    checks: Checks,
}

/// Runs the target.
pub fn run(data: &[u8]) {
    play(data);
}

fn play(data: &[u8]) -> Played {
    let mut u = Unstructured::new(data);
    let setup = [u.arbitrary().unwrap_or(0), u.arbitrary().unwrap_or(0)];
    let [a, _] = setup;
    match (a & 0x20 != 0, a & 0x40 != 0) {
        (false, false) => Session::<declared::Plain>::play(setup, u),
        (true, false) => Session::<declared::Satellite>::play(setup, u),
        (false, true) => Session::<declared::Forwarding>::play(setup, u),
        (true, true) => Session::<declared::Both>::play(setup, u),
    }
}

fn links([a, _]: [u8; 2]) -> [LinkConfig; LINKS] {
    let version = [TxVersion::V2, TxVersion::Auto, TxVersion::V1, TxVersion::V2][usize::from(a & 3)];
    let class = if a & 4 != 0 { LinkClass::Private } else { LinkClass::Normal };
    let signing = if a & 8 != 0 { LinkSigning::REQUIRED.with_provisioning() } else { LinkSigning::SIGNED };
    [
        LinkConfig::uart(115_200).with_streams(StreamProfile::Onboard),
        LinkConfig::uart(57_600).with_version(version).with_class(class),
        LinkConfig::uart(9_600).with_class(LinkClass::HighLatency),
        LinkConfig::unlimited().with_signing(signing),
    ]
}

impl<D: Declared> Session<D> {
    fn play(setup: [u8; 2], mut u: Unstructured<'_>) -> Played {
        let mut session = Self::new(setup);
        for _ in 0..MAX_STEPS {
            let most = if D::IS_FULL { MAX_FULL_POLLS } else { MAX_POLLS };
            if u.is_empty() || session.polls > most || session.step(&mut u).is_err() {
                break;
            }
        }
        session.finish();
        Played { live: session.live(), lines: session.lines, checks: session.checks }
    }

    fn new(setup: [u8; 2]) -> Self {
        // Times at which 32 bits of microseconds or milliseconds wrap.
        let start = [0, (1 << 32) - 2_000_000, ((1 << 32) - 3_000) * 1_000, 5_000_000][usize::from(setup[1] & 3)];
        let len = Store::<Flash>::region_len::<D>();
        let mut new = Self {
            setup,
            stack: stack(setup),
            vehicle: vehicle(setup),
            store: Store::new(Flash::new(len), 0..len),
            lines: Default::default(),
            now: Instant::from_micros(start),
            loop_runs: true,
            polls: 0,
            timestamp: NOW + 100_000,
            seq: 0,
            uploads: [None; LINKS],
            loses: [false; LINKS],
            last_tag: 0,
            has_hostile: false,
            checks: Checks::new(Instant::from_micros(start), setup[1] & 4 == 0),
        };
        new.restore();
        if setup[0] & 0x10 != 0 {
            new.stack.signing_mut().set_key(new.now, SigningKey::new(KEY), NOW);
        }
        new
    }

    /// Restores everything from flash, as at boot. Returns whether the plans could be read: if not, this is reported, and they are
    /// missing.
    fn restore(&mut self) -> bool {
        let restored = self.stack.restore(self.now, &mut self.store, &mut self.vehicle);
        restored.err().and_then(|errors| errors.plans) != Some(RestoreError::Unreadable)
    }

    /// Cuts the power and boots again.
    fn reboot(&mut self) {
        self.store.flash_mut().power_on();
        self.stack = stack(self.setup);
        self.vehicle = vehicle(self.setup);
        self.lines.iter_mut().for_each(Uart::cut);
        let is_readable = self.restore();
        self.vehicle.calls.clear();
        let found = self.live();
        self.checks.restarted(self.now, found, is_readable);
    }

    fn live(&self) -> [Vec<Item>; 3] {
        [self.stack.mission(), self.stack.fence(), self.stack.rally()].map(|plan| plan.items().to_vec())
    }

    /// Runs one pass of the vehicle's loop, `dt` after the last one.
    fn pass(&mut self, dt: Duration) {
        self.polls += 1;
        self.now += dt;
        if self.loop_runs {
            PULSE.tick();
            self.checks.ticked(self.now);
        }
        let Self { stack, vehicle, now, .. } = self;
        let now = *now;
        let operator = D::operator(stack, now);
        stack.poll(now, vehicle);
        checks::assert_bounded(&vehicle.calls);
        for link in 0..LINKS {
            let line = &mut self.lines[link];
            line.begin();
            // Line errors are counted and have no other effect.
            let before = vehicle.calls.len();
            let _ = stack.poll_link(now, LinkId(link as u8), line, vehicle);
            checks::assert_bounded(&vehicle.calls[before..]);
        }
        let operator = operator.filter(|system| D::operator(stack, now) == Some(*system));
        stack.persist(now, &mut self.store, vehicle);
        assert!(stack.next_deadline(now) >= now);

        let calls = std::mem::take(&mut self.vehicle.calls);
        for call in &calls {
            self.checks.assert_may(call, operator, &self.lines, self.is_private());
            self.checks.called(call);
        }
        let live = [self.stack.mission(), self.stack.fence(), self.stack.rally()];
        self.checks.assert_live(&live.map(|plan| plan.items()));
        let is_healthy = self.loop_runs && self.vehicle.state.is_some() && dt <= Duration::from_millis(50);
        for link in 0..LINKS {
            while let Some(frame) = self.lines[link].next_frame() {
                self.checks.sent(self.now, link, &frame, &self.lines);
                self.answer(link, &frame);
                self.lines[link].sent(frame);
            }
            let is_free = self.lines[link].is_free();
            self.checks.passed(self.now, link, dt, is_healthy && is_free);
        }
        // After the frames: the answer to a request may be handled in the poll that sends it.
        for call in &calls {
            self.checks.assert_asked(call, &self.lines, self.is_private());
        }
        if self.store.flash().is_off() {
            self.reboot();
        }
    }

    /// Lets the client of a link answer a request for an item of its upload.
    fn answer(&mut self, link: usize, frame: &[u8]) {
        let Some((tag, asked)) = self.uploads[link] else { return };
        let Some((source, id, payload)) = parts(frame) else { return };
        if source != VEHICLE {
            return;
        }
        let request = match id {
            MissionRequestInt::ID => MissionRequestInt::decode(payload),
            MissionRequest::ID => {
                let MissionRequest { seq, target_system, target_component, mission_type } =
                    MissionRequest::decode(payload);
                MissionRequestInt { seq, target_system, target_component, mission_type }
            }
            _ => return,
        };
        let me = client(link);
        let is_me = (request.target_system, request.target_component) == (me.system.wire(), me.component.wire());
        // Like QGroundControl, the client answers any request. If its MISSION_COUNT may be lost, it starts with the first item, like
        // MAVSDK: it would otherwise complete a plan that it has abandoned.
        let is_wanted = request.seq < tag.count && (request.seq <= asked || !self.loses[link]);
        if is_me && request.mission_type == tag.plan && is_wanted {
            self.uploads[link] = Some((tag, asked.max(request.seq + 1)));
            self.send(link, me, link == 3, &tag.item(request.seq));
        }
    }

    /// Sends a message to the vehicle.
    fn send<M: Message>(&mut self, link: usize, from: Address, is_signed: bool, message: &M) {
        let frame = if is_signed {
            let mut signer = Signer { seq: self.seq, ..Signer::new(KEY).of(from).link(link as u8).at(self.timestamp) };
            self.timestamp += 1;
            signer.frame(message)
        } else {
            let mut out = [0; MAX_FRAME_LEN];
            let len = encode(message, Version::V2, from, self.seq, &mut out).expect("every message fits");
            out[..len].to_vec()
        };
        self.seq = self.seq.wrapping_add(1);
        self.lines[link].receive(&frame);
    }

    /// Repairs all lines and runs until all pending answers are sent.
    fn finish(&mut self) {
        self.loop_runs = true;
        self.vehicle.state = vehicle(self.setup).state;
        self.lines.iter_mut().for_each(Uart::repair);
        self.store.flash_mut().fuel = None;
        if self.has_hostile && D::IS_FULL {
            self.assert_serves();
        }
        if !self.checks.has_commands() {
            return;
        }
        // Received bytes may be pending too.
        while self.lines.iter().any(Uart::has_input) {
            self.pass(Duration::from_millis(20));
        }
        (0..20).for_each(|_| self.pass(Duration::from_millis(50)));
        self.checks.finish();
    }

    /// Whether the second link is private, so that it carries components of our own system.
    fn is_private(&self) -> bool {
        self.setup[0] & 4 != 0
    }
}

fn stack<D: Declared>(setup: [u8; 2]) -> Box<Stack<D, LINKS>> {
    let config = Config {
        second_mission_ack: setup[1] & 8 != 0,
        float_mission_items: setup[1] & 0x10 != 0,
        streams_wait_for_peer: setup[1] & 0x20 != 0,
        accepts_component_0: setup[1] & 0x40 == 0,
        durability: if setup[1] & 4 == 0 { Durability::Durable } else { Durability::Deferred },
        item_reached_repeats: setup[1] >> 6,
        ..Config::new(VEHICLE, &PULSE)
    };
    let mut stack: Box<Stack<D, LINKS>> = Box::new(Stack::VACANT);
    stack.begin(config, links(setup));
    let manual = stack.manual_input_mut();
    manual.set_source(ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) });
    manual.set_timeout(Duration::from_secs(1));
    D::set_up(&mut stack);
    stack
}

fn vehicle(setup: [u8; 2]) -> TestVehicle {
    let mut vehicle = TestVehicle::new();
    vehicle.long.insert(MavCmd::NAV_LAND.0);
    vehicle.outcomes.remove(&MavCmd::NAV_LAND.0);
    vehicle.has_home = setup[0] & 0x80 != 0;
    vehicle
}

/// Returns the address of a link's client, which only uploads.
fn client(link: usize) -> Address {
    Address::new(240 + link as u8, 190)
}

impl Tag {
    /// Greater than the positions in all other items.
    const Y: i32 = 1_000_000_000;

    fn item(&self, seq: u16) -> MissionItemInt {
        let (command, param1) = match self.plan {
            MavMissionType::FENCE => (MavCmd::NAV_FENCE_CIRCLE_INCLUSION, 100.0),
            MavMissionType::RALLY => (MavCmd::NAV_RALLY_POINT, 0.0),
            _ => (MavCmd::NAV_WAYPOINT, 0.0),
        };
        MissionItemInt {
            param1,
            x: i32::from(seq),
            y: Self::Y + i32::from(self.number),
            z: 20.0,
            seq,
            command,
            target_system: 1,
            target_component: 1,
            frame: MavFrame::GLOBAL_RELATIVE_ALT,
            autocontinue: 1,
            mission_type: self.plan,
            ..MissionItemInt::default()
        }
    }
}

/// Returns the sender, id and payload of a frame.
fn parts(frame: &[u8]) -> Option<(Address, u32, &[u8])> {
    match *frame {
        [0xFD, len, _, _, _, system, component, a, b, c, ..] => {
            let payload = frame.get(10..10 + usize::from(len))?;
            Some((Address::new(system, component), u32::from_le_bytes([a, b, c, 0]), payload))
        }
        [0xFE, len, _, system, component, id, ..] => {
            Some((Address::new(system, component), id.into(), frame.get(6..6 + usize::from(len))?))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::play;
    use crate::tests::archive;
    use crate::{corpus, seeds};
    use std::fs;

    /// Writes the bytes received on each link in the sessions of the corpus, and the corpus of `decode`. Each stream follows its
    /// length in four bytes; 0xFFFF_FFFF marks the end. `cargo measure work` feeds them to the firmware.
    #[test]
    #[ignore = "writes the file that MAVSTACK_STREAMS names"]
    fn write_streams() {
        let corpus = |target: &str| corpus::read(&archive(target)).expect("a corpus").into_values();
        let received = |script: Vec<u8>| play(&script).lines.map(|line| line.history);
        let streams = corpus("decode").chain(corpus("session").flat_map(received));
        let mut out = Vec::new();
        for stream in streams.filter(|stream| !stream.is_empty()) {
            out.extend((stream.len() as u32).to_le_bytes());
            out.extend(stream);
        }
        out.extend([0xFF; 4]);
        let path = std::env::var_os("MAVSTACK_STREAMS").expect("MAVSTACK_STREAMS names a file");
        fs::write(path, out).expect("a writable file");
    }

    /// The scripts reach what they are written for, so the checks have something to check.
    #[test]
    fn seeds_reach_their_aims() {
        let sessions: Vec<_> = seeds::session().iter().map(|seed| play(seed)).collect();
        assert_eq!([0, 1, 2].map(|plan| sessions[0].live[plan].len()), [5, 2, 3]);
        assert!(sessions[3].checks.answered() >= 5, "commands");
        assert!(sessions.iter().any(|session| session.checks.forwarded > 0), "forwarded frames");
        assert!(sessions.iter().any(|session| session.checks.refused > 3), "another system is in control");
        assert!(sessions.iter().any(|session| session.checks.told > 2), "answers and claims that count");
        assert!(sessions.iter().any(|session| session.checks.credits > 5), "frames forwarded by satellite");
        let has_plans = |index: usize| !sessions[index].live[0].is_empty();
        let cut = sessions.iter().filter(|session| session.checks.restarts > 0).count();
        assert!(cut >= 8, "{cut} cuts");
        assert!(
            (0..sessions.len()).any(|index| sessions[index].checks.restarts > 0 && has_plans(index)),
            "a plan survives"
        );
    }
}
