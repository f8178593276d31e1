//! A whole vehicle with four links, its flash and everybody around it, driven by a script: times, messages, faults of lines,
//! cuts of the power. [`checks`] says what must hold.
//!
//! The first two bytes say how the vehicle is set up; then come steps, of which the first byte says what is done:
//!
//! ```text
//!   0  time goes by              steps, ms each
//!   1  much time at once         0.1 s × n
//!   2  a usual message           way, which, two numbers
//!   3  any message               way, id (2 bytes), length, payload
//!   4  any bytes                 link, length, bytes
//!   5  what the vehicle sent comes back           link, which
//!   6  a fault of a line         link, what
//!   7  a fault of the flash      which, for how long (2 bytes)
//!   8  something on board        what, number
//!   9  a command that nobody else gives           way
//!  10  an upload begins          link, plan and items
//!  11  a second goes by
//! ```
//!
//! A way is link (bits 0, 1), sender (bits 2 to 4), and whether it is signed (bit 7).

mod checks;
mod line;

use crate::flash::{Fault, RamFlash, Torn};
use crate::signer::{KEY, NOW, Signer};
use crate::support::{Call, TestVehicle, Tuning, VEHICLE, reference};
use arbitrary::{Result, Unstructured};
use checks::Checks;
use line::Uart;
use mavstack::dialect::*;
use mavstack::{
    Address, Config, ControlSource, Dialect, Durability, Duration, ForwardQueues, HighLatency, HighLatencyConfig,
    Instant, Item, LinkClass, LinkConfig, LinkId, LinkSigning, MAX_FRAME_LEN, ManualInput, Message, ParamStore,
    ParamTable, PlanStore, Pulse, SigningKey, SigningMemory, SigningStore, Stack, StreamProfile, SystemId, Text,
    TimeSlots, TxVersion, Version, encode, plan_memory,
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
        self.stack = Box::new(stack(self.setup));
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

    fn step(&mut self, u: &mut Unstructured<'_>) -> Result<()> {
        let what: u8 = u.arbitrary()?;
        match what % 12 {
            0 => {
                let (steps, ms): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                for _ in 0..=steps % 32 {
                    self.pass(Duration::from_millis(u64::from(ms % 50) + 1));
                }
            }
            1 => self.pass(Duration::from_millis(100 * (u64::from(u.arbitrary::<u8>()?) + 1))),
            2 => {
                let (way, which, a, b) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
                self.usual(way, which, a, b);
            }
            3 => {
                let (way, id, len): (u8, u16, u8) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
                let payload = &unmarked(u.bytes(usize::from(len).min(u.len()))?);
                let rows = Common::MESSAGES.rows();
                // One of the known ones, or any other.
                let (id, extra) = match rows.get(usize::from(id)) {
                    Some(row) => (row.id(), row.crc_extra()),
                    None => (u32::from(id), Common::MESSAGES.get(id.into()).map_or(0, |row| row.crc_extra())),
                };
                let from = sender(way);
                if id == SetupSigning::ID {
                    self.loses = [true; LINKS];
                }
                let frame = reference::v2(id, [0, 0], [from.system.0, from.component.0], payload, extra);
                self.lines[usize::from(way & 3)].receive(&frame);
            }
            4 => {
                let (link, len): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                let bytes = u.bytes(usize::from(len).min(u.len()))?;
                self.loses[usize::from(link & 3)] = true;
                self.lines[usize::from(link & 3)].receive(&unmarked(bytes));
            }
            5 => {
                let (link, which): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                let frames = &self.lines[usize::from(link >> 2 & 3)].frames;
                if let Some(frame) = frames.get(usize::from(which) % frames.len().max(1)).cloned() {
                    self.lines[usize::from(link & 3)].receive(&frame);
                }
            }
            6 => {
                let (link, kind): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                let id = usize::from(link & 3);
                if kind % 8 == 7 {
                    self.stack.restart_link(LinkId(id as u8));
                    self.loses[id] = true;
                    self.lines[id].cut();
                    self.checks.restarted_link(id);
                } else {
                    self.lines[id].fail(kind);
                }
            }
            7 => {
                let (which, fuel): (u8, u16) = (u.arbitrary()?, u.arbitrary()?);
                let flash = if which & 1 == 0 { self.plans.flash_mut() } else { self.params.flash_mut() };
                // One kind of flash, or what was unreadable would never be mended.
                flash.torn = [Torn::Prefix, Torn::Garbage, Torn::Unreadable][usize::from(self.setup[0] >> 6) % 3];
                match which >> 3 & 7 {
                    0..=3 => flash.fuel = Some(u64::from(fuel % 2_048) + 1),
                    _ if flash.torn == Torn::Unreadable => {}
                    4 => flash.fault = Fault::None,
                    5 => flash.fault = Fault::Write(flash.writes + u32::from(fuel % 8)),
                    6 => flash.fault = Fault::HalfWrite(flash.writes + u32::from(fuel % 8)),
                    _ => flash.fault = Fault::Erase,
                }
                self.checks.has_faults |= which & 1 == 0 && which >> 3 & 7 > 4;
            }
            8 => {
                let (kind, number) = (u.arbitrary()?, u.arbitrary()?);
                self.on_board(kind, number);
            }
            9 => {
                let way: u8 = u.arbitrary()?;
                let link = usize::from(way & 3);
                let command = MavCmd(self.checks.new_command(link));
                if way & 0x40 == 0 {
                    let long = CommandLong { command, target_system: 1, target_component: 1, ..CommandLong::default() };
                    self.send(link, sender(way), way & 0x80 != 0, &long);
                } else {
                    let int = CommandInt { command, target_system: 1, target_component: 1, ..CommandInt::default() };
                    self.send(link, sender(way), way & 0x80 != 0, &int);
                }
            }
            10 => {
                let (link, what): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                let link = usize::from(link & 3);
                let plan =
                    [MavMissionType::MISSION, MavMissionType::FENCE, MavMissionType::RALLY, MavMissionType::MISSION];
                self.last_tag += 1;
                let (plan, count) = (plan[usize::from(what & 3)], u16::from(what >> 2) % 9);
                let tag = Tag { plan, count, number: self.last_tag };
                self.uploads[link] = Some((tag, 0));
                self.checks.tags.push(tag);
                let (target_system, target_component) = (1, 1);
                let count = MissionCount { count, target_system, target_component, mission_type: plan, opaque_id: 0 };
                self.send(link, client(link), link == 3, &count);
            }
            _ => (0..20).for_each(|_| self.pass(Duration::from_millis(50))),
        }
        Ok(())
    }

    /// What ground stations send.
    fn usual(&mut self, way: u8, which: u8, a: u8, b: u8) {
        let (link, from, signed) = (usize::from(way & 3), sender(way), way & 0x80 != 0);
        let (target_system, target_component) = if way & 0x20 == 0 { (1, 1) } else { (b & 3, a & 1) };
        let mission_type = MavMissionType(if a == 0xFF { 255 } else { a & 3 });
        match which % 24 {
            0 => self.send(link, from, signed, &Heartbeat { r#type: MavType(a), ..Heartbeat::default() }),
            1 => {
                let list = MissionRequestList { target_system, target_component, mission_type };
                self.send(link, from, signed, &list);
            }
            2 => {
                let request = MissionRequestInt { target_system, target_component, seq: b.into(), mission_type };
                self.send(link, from, signed, &request);
            }
            3 => {
                let request = MissionRequest { target_system, target_component, seq: b.into(), mission_type };
                self.send(link, from, signed, &request);
            }
            4 => {
                let r#type = MavMissionResult(b);
                let ack = MissionAck { target_system, target_component, r#type, mission_type, opaque_id: 0 };
                self.send(link, from, signed, &ack);
            }
            5 => self.send(link, from, signed, &MissionClearAll { target_system, target_component, mission_type }),
            6 => {
                let count = u16::from(b) << (a >> 4);
                let count = MissionCount { target_system, target_component, count, mission_type, opaque_id: 0 };
                self.send(link, from, signed, &count);
            }
            7 => {
                let item = MissionItemInt {
                    target_system,
                    target_component,
                    seq: b.into(),
                    mission_type,
                    command: MavCmd(if a & 0x80 == 0 { 16 } else { u16::from(a) + 100 }),
                    frame: MavFrame(a >> 2 & 7),
                    ..MissionItemInt::default()
                };
                self.send(link, from, signed, &item);
            }
            8 => self.send(link, from, signed, &MissionSetCurrent { target_system, target_component, seq: b.into() }),
            9 => self.send(link, from, signed, &ParamRequestList { target_system, target_component }),
            10 => {
                let param_id = Text::new(Tuning::INFO[usize::from(b) % 9].name());
                let param_index = if a & 1 == 0 { -1 } else { i16::from(b.cast_signed()) };
                let read = ParamRequestRead { target_system, target_component, param_index, param_id };
                self.send(link, from, signed, &read);
            }
            11 => {
                let index = usize::from(b) % 9;
                let param_id = Text::new(Tuning::INFO[index].name());
                let param_value =
                    if [0, 1, 3, 4, 8].contains(&index) { f32::from(a) / 4.0 } else { f32::from_bits(a.into()) };
                let param_type = [9, 9, 6, 9, 9, 5, 1, 2, 9][index];
                let param_type = MavParamType(param_type);
                let set = ParamSet { target_system, target_component, param_value, param_id, param_type };
                self.send(link, from, signed, &set);
            }
            12 => {
                let command = MavCmd(COMMANDS[usize::from(a) % COMMANDS.len()]);
                let param1 = [f32::from(b), 0.0, -1.0, f32::NAN, 30.0, 147.0, 148.0, 435.0][usize::from(b & 7)];
                let param2 = f32::from(b >> 3) * 10_000.0;
                let confirmation = b & 3;
                let long = CommandLong {
                    command,
                    target_system,
                    target_component,
                    confirmation,
                    param1,
                    param2,
                    ..CommandLong::default()
                };
                self.send(link, from, signed, &long);
            }
            13 => {
                let command = MavCmd(COMMANDS[usize::from(a) % COMMANDS.len()]);
                let frame = MavFrame(b);
                let int = CommandInt { command, target_system, target_component, frame, ..CommandInt::default() };
                self.send(link, from, signed, &int);
            }
            14 => {
                let command = MavCmd(COMMANDS[usize::from(a) % COMMANDS.len()]);
                self.send(link, from, signed, &CommandCancel { command, target_system, target_component });
            }
            15 => self.send(link, from, signed, &Ping { seq: a.into(), target_system: b & 1, ..Ping::default() }),
            16 => {
                let sync = Timesync { tc1: i64::from(a & 1), ts1: i64::from(b), target_system, target_component };
                self.send(link, from, signed, &sync);
            }
            17 => self.send(link, from, signed, &RadioStatus { txbuf: a, remrssi: b, ..RadioStatus::default() }),
            18 => {
                let control = ManualControl {
                    target: target_system,
                    x: i16::from(a) << 3,
                    buttons: b.into(),
                    ..Default::default()
                };
                self.send(link, from, signed, &control);
            }
            19 => {
                let chan1_raw = u16::from(a) << 8 | u16::from(b);
                let rc = RcChannelsOverride { target_system, target_component, chan1_raw, ..Default::default() };
                self.send(link, from, signed, &rc);
            }
            20 => {
                self.loses = [true; LINKS];
                let secret_key = mavstack::Secret(if a == 0 { [0; 32] } else { KEY });
                let initial_timestamp = self.timestamp + (u64::from(b) << 20);
                let setup = SetupSigning { target_system, target_component, initial_timestamp, secret_key };
                self.send(link, from, signed, &setup);
            }
            21 => self.send(
                link,
                from,
                signed,
                &SetMode { target_system, custom_mode: a.into(), base_mode: MavModeFlag(b).into() },
            ),
            22 => {
                let req_stream_id = MavDataStream(a);
                let rate = RequestDataStream {
                    target_system,
                    target_component,
                    req_stream_id,
                    req_message_rate: b.into(),
                    start_stop: a >> 7,
                };
                self.send(link, from, signed, &rate);
            }
            _ => self.send(link, from, signed, &HighLatency2 { custom_mode: a.into(), ..HighLatency2::default() }),
        }
    }

    /// What happens in the vehicle.
    fn on_board(&mut self, kind: u8, number: u8) {
        let now = self.now;
        match kind % 12 {
            0 => self.loop_runs = !self.loop_runs,
            1 => {
                let well = vehicle(self.setup).state;
                self.vehicle.state = if self.vehicle.state.is_some() { None } else { well };
            }
            2 => self.vehicle.may_persist = number & 1 == 0,
            3 => self.vehicle.may_change = if number & 1 == 0 { Ok(()) } else { Err(MavMissionResult::DENIED) },
            4 => self.vehicle.plan_verdict = if number & 1 == 0 { Ok(()) } else { Err(MavMissionResult::INVALID) },
            5 => {
                self.vehicle.memory.finish(MavCmd::NAV_LAND, MavResult(number % 7));
            }
            6 => self.vehicle.memory.progress(MavCmd::NAV_LAND, number),
            7 => {
                self.vehicle.tuning.set(Tuning::YAW_NOW, f32::from(number) / 2.0);
            }
            8 => self.stack.send_text(now, MavSeverity(number & 7), &[b'x'; 60][..usize::from(number % 61)]),
            9 => self.stack.save_parameters(now, &mut self.vehicle),
            10 => self.vehicle.progress.current = number.into(),
            _ => self.reboot(),
        }
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

/// Those that the stack, or the vehicle, does something about.
const COMMANDS: [u16; 20] =
    [400, 22, 21, 300, 512, 511, 510, 246, 245, 176, 262, 2600, 519, 520, 521, 184, 192, 209, 42_428, 224];

fn stack(setup: [u8; 2]) -> TestStack {
    let config = Config {
        second_mission_ack: setup[1] & 8 != 0,
        float_mission_items: setup[1] & 0x10 != 0,
        streams_wait_for_peer: setup[1] & 0x20 != 0,
        accepts_component_0: setup[1] & 0x40 != 0,
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

/// Who sends.
fn sender(way: u8) -> Address {
    let (system, component) =
        [(255, 190), (254, 190), (1, 154), (1, 1), (51, 68), (2, 1), (255, 0), (3, 3)][usize::from(way >> 2 & 7)];
    Address::new(system, component)
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

/// Without what only the numbers of commands have that are given once, and the addresses of clients that upload: the fuzzer sees what
/// is compared, and has spoken for them.
fn unmarked(bytes: &[u8]) -> Vec<u8> {
    let [_, mark] = checks::FIRST.to_le_bytes();
    let is_mark = |byte: u8| byte == mark || (0..LINKS).any(|link| client(link).system.0 == byte);
    bytes.iter().map(|byte| if is_mark(*byte) { 0 } else { *byte }).collect()
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
    use crate::seeds;
    use std::fs;
    use std::path::Path;

    /// What came by each link in the sessions of the corpus, and the corpus of `decode`: streams, each behind its length in four
    /// bytes, the last one behind 0xFFFF_FFFF. `cargo xtask work` puts them to the firmware.
    #[test]
    #[ignore = "writes the file that MAVSTACK_STREAMS names"]
    fn write_streams() {
        let corpus = |target: &str| {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
            let files = fs::read_dir(folder).expect("a corpus").map(|file| file.expect("a file").path());
            let mut files: Vec<_> = files.collect();
            files.sort();
            files.into_iter().map(|path| fs::read(path).expect("a file that can be read"))
        };
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
