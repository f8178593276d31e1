//! A whole vehicle with four links, its flash and everybody around it, driven by a script: times, messages, faults of lines,
//! cuts of the power. [`script`] says what its bytes mean, [`checks`] what must hold.

mod checks;
mod line;
mod script;

use crate::flash::RamFlash;
use crate::signer::{KEY, NOW, Signer};
use crate::support::{Call, TestVehicle, VEHICLE, reference};
use arbitrary::Unstructured;
use checks::Checks;
use line::Uart;
use mavstack::dialect::*;
use mavstack::{
    Address, Config, ControlSource, Durability, Duration, ForwardQueues, HighLatency, HighLatencyConfig, Instant, Item,
    LinkClass, LinkConfig, LinkId, LinkSigning, MAX_FRAME_LEN, ManualInput, Message, ParamStore, PlanStore, Pulse,
    SigningKey, SigningMemory, SigningStore, Stack, StreamProfile, SystemId, TimeSlots, TxVersion, Version, encode,
    plan_memory,
};

/// Links of the vehicle.
const LINKS: usize = 4;
const SATELLITE: usize = 2;

type Plans = plan_memory!(mission: 8, fence: 4, rally: 4);
type TestStack = Stack<LINKS, Plans, 6, 3, 8>;
type Flash = RamFlash<8, 512>;

const PLANS: u32 = PlanStore::<Flash>::region_len(8, 4, 4);
const PARAMS: u32 = ParamStore::<Flash>::region_len(9);
const SIGNING: u32 = SigningStore::<Flash>::REGION_LEN;

const MAX_STEPS: usize = 64;
/// Polls of one script.
const MAX_POLLS: u32 = 600;

static PULSE: Pulse = Pulse::new();

struct Session {
    setup: [u8; 2],
    stack: Box<TestStack>,
    vehicle: TestVehicle,
    plans: PlanStore<Flash>,
    params: ParamStore<Flash>,
    signing: SigningStore<Flash>,
    lines: [Uart; LINKS],
    now: Instant,
    loop_runs: bool,
    polls: u32,
    timestamp: u64,
    seq: u8,
    /// The upload of each link's client, and how many of its items were asked for.
    uploads: [Option<(Tag, u16)>; LINKS],
    /// Whether frames of a link's client may be lost.
    loses: [bool; LINKS],
    last_tag: u16,
    checks: Checks,
}

/// An upload, which all of its items name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tag {
    plan: MavMissionType,
    count: u16,
    number: u16,
}

/// Runs the script.
pub fn run(data: &[u8]) {
    play(data);
}

fn play(data: &[u8]) -> Session {
    let mut u = Unstructured::new(data);
    let setup = [u.arbitrary().unwrap_or(0), u.arbitrary().unwrap_or(0)];
    let mut session = Session::new(setup);
    for _ in 0..MAX_STEPS {
        if u.is_empty() || session.polls > MAX_POLLS || session.step(&mut u).is_err() {
            break;
        }
    }
    session.finish();
    session
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

impl Session {
    fn new(setup: [u8; 2]) -> Self {
        // Times that wrap in 32 bits, of milliseconds and of microseconds.
        let start = [0, (1 << 32) - 2_000_000, ((1 << 32) - 3_000) * 1_000, 5_000_000][usize::from(setup[1] & 3)];
        let mut new = Self {
            setup,
            stack: Box::new(stack(setup)),
            vehicle: vehicle(setup),
            plans: PlanStore::new(Flash::new(PLANS), 0..PLANS),
            params: ParamStore::new(Flash::new(PARAMS), 0..PARAMS),
            signing: SigningStore::new(Flash::new(SIGNING), 0..SIGNING),
            lines: Default::default(),
            now: Instant::from_micros(start),
            loop_runs: true,
            polls: 0,
            timestamp: NOW + 100_000,
            seq: 0,
            uploads: [None; LINKS],
            loses: [false; LINKS],
            last_tag: 0,
            checks: Checks::new(Instant::from_micros(start), setup[1] & 4 == 0),
        };
        new.restore();
        if setup[0] & 0x10 != 0 {
            let signing = new.vehicle.signing.as_mut().expect("a memory for signing");
            signing.set_key(new.now, SigningKey::new(KEY), NOW);
        }
        new
    }

    /// What a start does.
    fn restore(&mut self) {
        let durability = if self.setup[1] & 4 == 0 { Durability::Durable } else { Durability::Deferred };
        let Self { stack, vehicle, now, .. } = self;
        // What cannot be read is told, and otherwise as if it were not there.
        let _ = stack.restore_plans(*now, &mut self.plans, durability, vehicle);
        let _ = stack.restore_parameters(*now, &mut self.params, vehicle);
        let _ = stack.restore_signing(*now, &mut self.signing, vehicle);
    }

    /// The power goes and comes back.
    fn reboot(&mut self) {
        for flash in [self.plans.flash_mut(), self.params.flash_mut(), self.signing.flash_mut()] {
            flash.power_on();
        }
        *self.stack = stack(self.setup);
        self.vehicle = vehicle(self.setup);
        self.lines.iter_mut().for_each(Uart::cut);
        self.restore();
        self.vehicle.calls.clear();
        let found = self.live();
        self.checks.restarted(self.now, found);
    }

    fn live(&self) -> [Vec<Item>; 3] {
        [self.stack.mission(), self.stack.fence(), self.stack.rally()].map(|plan| plan.items().to_vec())
    }

    /// One pass of the vehicle's loop, `dt` after the last.
    fn pass(&mut self, dt: Duration) {
        self.polls += 1;
        self.now = self.now.after(dt);
        if self.loop_runs {
            PULSE.tick();
            self.checks.ticked(self.now);
        }
        let Self { stack, vehicle, now, .. } = self;
        let now = *now;
        stack.poll(now, vehicle);
        for link in 0..LINKS {
            let line = &mut self.lines[link];
            line.begin();
            // What a line reports is counted, and otherwise nothing happens.
            let _ = stack.poll_link(now, LinkId(link as u8), line, vehicle);
        }
        stack.persist_plans(now, &mut self.plans, vehicle);
        stack.persist_parameters(now, &mut self.params, vehicle);
        stack.persist_signing(now, &mut self.signing, vehicle);
        assert!(stack.next_deadline(now) >= now);

        let calls = std::mem::take(&mut self.vehicle.calls);
        calls.into_iter().for_each(|call| self.checks.called(call));
        let live = [self.stack.mission(), self.stack.fence(), self.stack.rally()];
        self.checks.is_live(&live.map(|plan| plan.items()));
        let is_well = self.loop_runs && self.vehicle.state.is_some() && dt <= Duration::from_millis(50);
        for link in 0..LINKS {
            while let Some(frame) = self.lines[link].next_frame() {
                self.checks.sent(self.now, link, &frame, &self.lines);
                self.answer(link, &frame);
                self.lines[link].sent(frame);
            }
            let is_free = self.lines[link].is_free();
            self.checks.passed(self.now, link, dt, is_well && is_free);
        }
        let flashes = [self.plans.flash(), self.params.flash(), self.signing.flash()];
        if flashes.iter().any(|flash| flash.is_off()) {
            self.reboot();
        }
    }

    /// The client of a link is asked for an item of its upload.
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
        let is_me = (request.target_system, request.target_component) == (me.system.0, me.component.0);
        // Whatever is asked for, as QGroundControl does it; but where its COUNT may be lost, from the first item on, as MAVSDK does
        // it: it would complete the plan that it gave up.
        let is_wanted = request.seq < tag.count && (request.seq <= asked || !self.loses[link]);
        if is_me && request.mission_type == tag.plan && is_wanted {
            self.uploads[link] = Some((tag, asked.max(request.seq + 1)));
            self.send(link, me, link == 3, &tag.item(request.seq));
        }
    }

    /// A message arrives.
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

    /// In the end all lines are free, and everything that is owed goes out.
    fn finish(&mut self) {
        self.loop_runs = true;
        self.vehicle.state = vehicle(self.setup).state;
        self.lines.iter_mut().for_each(Uart::mend);
        for flash in [self.plans.flash_mut(), self.params.flash_mut(), self.signing.flash_mut()] {
            flash.fuel = None;
        }
        if !self.checks.has_commands() {
            return;
        }
        // What is still to be received, too.
        while self.lines.iter().any(Uart::has_input) {
            self.pass(Duration::from_millis(20));
        }
        (0..20).for_each(|_| self.pass(Duration::from_millis(50)));
        self.checks.finish();
    }
}

fn stack(setup: [u8; 2]) -> TestStack {
    let config = Config {
        second_mission_ack: setup[1] & 8 != 0,
        float_mission_items: setup[1] & 0x10 != 0,
        streams_wait_for_peer: setup[1] & 0x20 != 0,
        accepts_component_0: setup[1] & 0x40 == 0,
        item_reached_repeats: setup[1] >> 6,
        ..Config::new(VEHICLE, &PULSE)
    };
    Stack::with_capacities(config, links(setup))
}

fn vehicle(setup: [u8; 2]) -> TestVehicle {
    let mut vehicle = TestVehicle::new();
    vehicle.long.insert(MavCmd::NAV_LAND.0);
    vehicle.outcomes.remove(&MavCmd::NAV_LAND.0);
    vehicle.time = Some(TimeSlots::new());
    vehicle.manual = Some(ManualInput::new(
        ControlSource::Systems { first: SystemId(1), last: SystemId(255) },
        Duration::from_secs(1),
    ));
    vehicle.signing = Some(SigningMemory::new());
    vehicle.satellite = (setup[0] & 0x20 != 0).then(|| {
        HighLatency::new(HighLatencyConfig {
            period: Duration::from_secs(5),
            announce_once: true,
            ..HighLatencyConfig::DEFAULT
        })
    });
    vehicle.queues = (setup[0] & 0x40 != 0).then(|| Box::new(ForwardQueues::new()));
    vehicle.has_home = setup[0] & 0x80 != 0;
    vehicle
}

/// The client of a link that uploads, and nothing else.
fn client(link: usize) -> Address {
    Address::new(240 + link as u8, 190)
}

impl Tag {
    /// Behind all positions of others.
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

/// Sender, id and payload of a frame.
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

    /// What came by each link in the sessions of the corpus, and the corpus of `decode`: streams, each behind its length in four
    /// bytes, the last one behind 0xFFFF_FFFF. `cargo xtask work` puts them to the firmware.
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
        fs::write(path, out).expect("a file that can be written");
    }

    /// The scripts do what they are written for, so what is checked does happen.
    #[test]
    fn seeds_get_far() {
        let sessions: Vec<_> = seeds::session().iter().map(|seed| play(seed)).collect();
        let first = &sessions[0].stack;
        assert_eq!([first.mission(), first.fence(), first.rally()].map(|plan| plan.items().len()), [5, 2, 3]);
        assert!(sessions[3].checks.answered() >= 5, "commands");
        assert!(sessions.iter().any(|session| session.checks.forwarded > 0), "frames of others");
        let has_plans = |index: usize| !sessions[index].stack.mission().items().is_empty();
        let cut = sessions.iter().filter(|session| session.checks.restarts > 0).count();
        assert!(cut >= 8, "{cut} cuts");
        assert!((0..sessions.len()).any(|index| sessions[index].checks.restarts > 0 && has_plans(index)), "kept");
    }
}
