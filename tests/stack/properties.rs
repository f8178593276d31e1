//! Whatever peers send on any link, and however transports accept bytes: each sent frame was pending, is sent once, in order,
//! and is current when its first byte is sent. Rules C-3, D-3, D-4, H-1, H-6, L-4, P-14, P-16, Q-4 to.
//!
//! The byte-level calls drive the stack, so that each frame is seen when it is encoded.

use crate::support::*;
use mavstack::__private::NoPlans;
use mavstack::config::{LinkClass, StreamProfile};
use mavstack::dialect::*;
use mavstack::frame::{Version, encode};
use mavstack::param::ParamTable;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Message, Stack, Text};
use proptest::prelude::*;
use std::collections::{BTreeMap, VecDeque};

/// A wired companion computer, a radio of 9,600 baud, a satellite.
const LINKS: [LinkConfig; 3] = [
    LinkConfig::uart(115_200).with_streams(StreamProfile::Onboard),
    LinkConfig::uart(9_600),
    LinkConfig::uart(9_600).with_class(LinkClass::HighLatency),
];
const SATELLITE: usize = 2;

#[derive(Clone, Debug)]
enum Request {
    /// A command that the vehicle carries out, with a unique number.
    Command,
    SetInterval(u32, f32),
    GetInterval(u32),
    Message(u32),
    Set(usize, f32),
    Read(i16),
    List,
    Ping,
    Radio(u8),
}

#[derive(Clone, Debug)]
enum Step {
    Send {
        link: usize,
        other: bool,
        request: Request,
    },
    /// The transport accepts this many bytes.
    Take {
        link: usize,
        bytes: usize,
    },
    Wait(u64),
    /// The vehicle sets a parameter by itself.
    Own(f32),
    Text(u8),
}

fn any_request() -> impl Strategy<Value = Request> {
    let stream = prop::sample::select(vec![Attitude::ID, GlobalPositionInt::ID, BatteryStatus::ID, 404]);
    let micros = vec![-1.0, 0.0, 0.5, 999.0, 1_000.0, 20_000.0, 33_333.0, 5e6, 1e9, -2.0, f32::NAN];
    let param = prop::sample::select(vec![-1.0f32, 0.0, 1.0, 5.0, 10.0, 30.0, 1e9, f32::NAN]);
    prop_oneof![
        4 => Just(Request::Command),
        3 => (stream.clone(), prop::sample::select(micros)).prop_map(|(id, micros)| Request::SetInterval(id, micros)),
        3 => stream.clone().prop_map(Request::GetInterval),
        2 => stream.prop_map(Request::Message),
        3 => (0usize..9, param).prop_map(|(index, value)| Request::Set(index, value)),
        2 => (0i16..10).prop_map(Request::Read),
        1 => Just(Request::List),
        2 => Just(Request::Ping),
        3 => prop::sample::select(vec![0u8, 10, 40, 70, 95, 100]).prop_map(Request::Radio),
    ]
}

fn any_step() -> impl Strategy<Value = Step> {
    prop_oneof![
        8 => (0usize..3, any::<bool>(), any_request())
            .prop_map(|(link, other, request)| Step::Send { link, other, request }),
        8 => (0usize..3, prop_oneof![Just(1_000), 1usize..120]).prop_map(|(link, bytes)| Step::Take { link, bytes }),
        4 => prop_oneof![0u64..20, 0u64..400].prop_map(Step::Wait),
        1 => (-180.0f32..180.0).prop_map(Step::Own),
        1 => (0u8..8).prop_map(Step::Text),
    ]
}

/// What the far end of a link expects.
struct Line {
    config: LinkConfig,
    /// Bytes of the current frame that the transport has not accepted.
    rest: usize,
    /// Pending acknowledgements, in order: target, command, and result if it is known.
    acks: VecDeque<(Address, u16, Option<MavResult>)>,
    heartbeat: Instant,
    /// The intervals that were set, and whether RADIO_STATUS may have lengthened them.
    intervals: BTreeMap<u32, i32>,
    has_radio: bool,
    /// The last value sent for each parameter, as bits.
    told: BTreeMap<u16, u32>,
}

struct Bench {
    stack: Box<Stack<Tested<NoPlans, 8, Timed>, 3>>,
    vehicle: TestVehicle,
    pulse: &'static mavstack::Pulse,
    now: Instant,
    number: u16,
    seq: u8,
    lines: [Line; 3],
}

impl Bench {
    fn new() -> Self {
        let config = Setup::<3>::new().config;
        let mut stack: Box<Stack<Tested<NoPlans, 8, Timed>, 3>> = Box::new(Stack::VACANT);
        stack.begin(config, LINKS);
        let line = |config| Line {
            config,
            rest: 0,
            acks: VecDeque::new(),
            heartbeat: Instant::ZERO,
            intervals: BTreeMap::new(),
            has_radio: false,
            told: BTreeMap::new(),
        };
        let mut bench = Self {
            stack,
            vehicle: TestVehicle::new(),
            pulse: config.pulse.expect("given"),
            now: Instant::ZERO,
            number: 50_000,
            seq: 0,
            lines: LINKS.map(line),
        };
        bench.wait(1);
        bench
    }

    fn wait(&mut self, millis: u64) {
        self.now += Duration::from_millis(millis);
        self.pulse.tick();
        self.stack.poll(self.now, &mut self.vehicle);
    }

    /// Receives a frame. Returns whether it was accepted, and not dropped for want of room for its answer.
    fn receive<M: Message>(&mut self, link: usize, from: Address, message: &M) -> bool {
        let mut frame = [0; 280];
        let len = encode(message, Version::V2, from, self.seq, &mut frame).expect("it fits");
        self.seq = self.seq.wrapping_add(1);
        let id = LinkId(link as u8);
        let dropped = |bench: &Self| bench.stack.link_counters(id).unwrap().no_answer_slot;
        let before = dropped(self);
        assert_eq!(self.stack.receive(self.now, id, &frame[..len], &mut self.vehicle), len);
        dropped(self) == before
    }

    fn command(&mut self, link: usize, from: Address, command: MavCmd, [param1, param2]: [f32; 2]) -> bool {
        let (target_system, target_component) = (1, 1);
        let command =
            CommandLong { command, target_system, target_component, param1, param2, ..CommandLong::default() };
        self.receive(link, from, &command)
    }

    fn owe(&mut self, link: usize, from: Address, command: MavCmd, result: Option<MavResult>) {
        self.lines[link].acks.push_back((from, command.0, result));
    }

    fn send(&mut self, link: usize, from: Address, request: &Request) {
        let (target_system, target_component) = (1, 1);
        let is_satellite = link == SATELLITE;
        let yes =
            |is_valid: bool| Some(if is_valid && !is_satellite { MavResult::ACCEPTED } else { MavResult::DENIED });
        match *request {
            Request::Command => {
                self.number += 1;
                let command = MavCmd(self.number);
                let before = self.vehicle.commands().len();
                let is_taken = self.command(link, from, command, [0.0; 2]);
                assert_eq!(self.vehicle.commands().len() - before, usize::from(is_taken), "carried out at most once");
                if is_taken {
                    self.owe(link, from, command, Some(MavResult::UNSUPPORTED));
                }
            }
            Request::SetInterval(id, micros) => {
                if self.command(link, from, MavCmd::SET_MESSAGE_INTERVAL, [id as f32, micros]) {
                    let is_valid = id != 404 && (micros >= 0.0 || micros == -1.0);
                    self.owe(link, from, MavCmd::SET_MESSAGE_INTERVAL, yes(is_valid));
                    if is_valid {
                        let clamped = (micros as i32).clamp(1_000, 60_000_000);
                        let interval = if micros > 0.0 { clamped } else { micros as i32 };
                        self.lines[link].intervals.insert(id, interval);
                    }
                }
            }
            Request::GetInterval(id) => {
                if self.command(link, from, MavCmd::GET_MESSAGE_INTERVAL, [id as f32, 0.0]) {
                    let denied = is_satellite.then_some(MavResult::DENIED);
                    self.owe(link, from, MavCmd::GET_MESSAGE_INTERVAL, denied);
                }
            }
            Request::Message(id) => {
                if self.command(link, from, MavCmd::REQUEST_MESSAGE, [id as f32, 0.0]) {
                    self.owe(link, from, MavCmd::REQUEST_MESSAGE, yes(id != 404));
                }
            }
            Request::Set(index, value) => {
                let info = &Tuning::INFO[index];
                let (param_id, param_type) = (Text::new(info.name()), info.param_type());
                let is_float = param_type == MavParamType::REAL32;
                let param_value = if is_float { value } else { f32::from_bits(value as i32 as u32) };
                let set = ParamSet { param_value, target_system, target_component, param_id, param_type };
                self.receive(link, from, &set);
            }
            Request::Read(param_index) => {
                let param_id = Text::EMPTY;
                let read = ParamRequestRead { param_index, target_system, target_component, param_id };
                self.receive(link, from, &read);
            }
            Request::List => {
                self.receive(link, from, &ParamRequestList { target_system, target_component });
            }
            Request::Ping => {
                self.receive(link, from, &Ping { seq: u32::from(self.seq), ..Ping::default() });
            }
            Request::Radio(txbuf) => {
                self.lines[link].has_radio = true;
                self.receive(link, Address::new(51, 68), &RadioStatus { txbuf, ..RadioStatus::default() });
            }
        }
    }

    /// The transport accepts up to this many bytes. Returns whether it got any.
    fn take(&mut self, link: usize, mut bytes: usize) -> bool {
        let mut got_any = false;
        while bytes > 0 {
            let pending = self.stack.transmit(self.now, LinkId(link as u8), &mut self.vehicle).to_vec();
            if pending.is_empty() {
                assert_eq!(self.lines[link].rest, 0);
                // D-4, Q-8: neither a byte budget nor a radio defers an acknowledgement or a heartbeat.
                assert!(self.lines[link].acks.is_empty(), "an acknowledgement is deferred");
                assert!(!self.is_heartbeat_due(link), "a heartbeat is deferred");
                break;
            }
            if self.lines[link].rest == 0 {
                self.see(link, &pending);
            }
            assert!(self.lines[link].rest == 0 || self.lines[link].rest == pending.len());
            let len = bytes.min(pending.len());
            self.stack.transmitted(LinkId(link as u8), len);
            self.lines[link].rest = pending.len() - len;
            bytes -= len;
            got_any = true;
        }
        got_any
    }

    fn is_heartbeat_due(&self, link: usize) -> bool {
        link != SATELLITE && self.now >= self.lines[link].heartbeat
    }

    /// Checks a frame that was encoded now.
    fn see(&mut self, link: usize, frame: &[u8]) {
        let [0xFD, len, _, _, _, _, _, id0, id1, id2, ..] = *frame else { panic!("{frame:?}") };
        let id = u32::from_le_bytes([id0, id1, id2, 0]);
        let payload = &frame[10..10 + usize::from(len)];
        let is_heartbeat_due = self.is_heartbeat_due(link);
        let line = &mut self.lines[link];
        // L-4
        assert!(link != SATELLITE || id == CommandAck::ID, "message {id} by satellite");
        // D-4, H-1, H-6: a heartbeat exactly when it is due, then acknowledgements, then everything else.
        assert_eq!(id == Heartbeat::ID, is_heartbeat_due, "message {id}");
        if is_heartbeat_due {
            let next = line.heartbeat + secs(1);
            line.heartbeat = if next > self.now { next } else { self.now + secs(1) };
            return;
        }
        // C-3, D-3: the pending acknowledgements, in order, each once.
        if let Some((to, command, result)) = line.acks.pop_front() {
            assert_eq!(id, CommandAck::ID, "an acknowledgement is pending");
            let ack = CommandAck::decode(payload);
            assert_eq!((Address::new(ack.target_system, ack.target_component), ack.command.0), (to, command));
            assert!(result.is_none_or(|result| result == ack.result), "{ack:?}, not {result:?}");
            return;
        }
        assert_ne!(id, CommandAck::ID, "an acknowledgement without a command");
        if id == ParamValue::ID {
            // P-14, P-16: the current value.
            let value = ParamValue::decode(payload);
            let bits = self.stack.parameters().value(value.param_index);
            assert_eq!(value.param_value.to_bits(), bits, "{value:?}");
            assert_eq!(value.param_id.as_str(), Some(Tuning::INFO[usize::from(value.param_index)].name()));
            line.told.insert(value.param_index, bits);
        } else if id == MessageInterval::ID {
            // the current interval.
            let told = MessageInterval::decode(payload);
            let id = u32::from(told.message_id);
            let default = match (id, line.config.streams) {
                (Attitude::ID, StreamProfile::Onboard) => 20_000,
                (GlobalPositionInt::ID, StreamProfile::Onboard) => 100_000,
                (404, _) => 0,
                _ => -1,
            };
            let interval = line.intervals.get(&id).copied().filter(|micros| *micros != 0).unwrap_or(default);
            let is_stretched = line.has_radio && interval > 0;
            let longest = if is_stretched { interval + 2_000_000 } else { interval };
            assert!((interval..=longest).contains(&told.interval_us), "{told:?}, not {interval}");
        }
    }
}

proptest! {
    #![proptest_config(cases(300))]

    /// No acknowledgement is missing, repeated, late or unsolicited; values and intervals are current when they are sent.
    /// Nothing of that depends on how many bytes transports accept, and when.
    #[test]
    fn sent_frames_are_pending_and_current(steps in prop::collection::vec(any_step(), 1..150)) {
        let mut bench = Bench::new();
        let mut has_changed = false;
        for step in steps {
            match step {
                Step::Send { link, other, request } => {
                    bench.send(link, if other { OTHER_STATION } else { STATION }, &request);
                }
                Step::Take { link, bytes } => {
                    bench.take(link, bytes);
                }
                Step::Wait(millis) => bench.wait(millis),
                Step::Own(yaw) => {
                    has_changed |= yaw != bench.stack.parameters().get(Tuning::YAW_NOW);
                    bench.stack.parameters_mut().set(Tuning::YAW_NOW, yaw);
                }
                Step::Text(severity) => {
                    bench.stack.text(bench.now, MavSeverity(severity), "Something happened");
                }
            }
        }
        // Finally everything is sent, over lines that accept all bytes.
        for _ in 0..400 {
            bench.wait(25);
            for link in 0..3 {
                bench.take(link, 40);
            }
        }
        for line in &bench.lines[..2] {
            prop_assert!(line.acks.is_empty());
            for (index, bits) in &line.told {
                prop_assert_eq!(*bits, bench.stack.parameters().value(*index), "no client is left with an old value");
            }
            prop_assert!(!has_changed || line.told.contains_key(&8), "the vehicle's own change is sent");
        }
        prop_assert!(bench.lines[SATELLITE].acks.is_empty());
    }
}

/// The value of a parameter as bits.
trait Bits {
    fn value(&self, index: u16) -> u32;
}

impl Bits for Tuning {
    fn value(&self, index: u16) -> u32 {
        match index {
            0 => self.get(Tuning::BAT_LOW).to_bits(),
            1 => self.get(Tuning::CRUISE).to_bits(),
            2 => self.get(Tuning::FENCE_ACT).cast_unsigned(),
            3 => self.get(Tuning::LAND_SPEED).to_bits(),
            4 => self.get(Tuning::RTL_ALT).to_bits(),
            5 => self.get(Tuning::STAT_STARTS),
            6 => self.get(Tuning::SYS_ID).into(),
            7 => u32::from(self.get(Tuning::TRIM_ROLL).cast_unsigned()),
            _ => self.get(Tuning::YAW_NOW).to_bits(),
        }
    }
}
