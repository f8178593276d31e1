//! A simulated ground station: what it requests, how often, how long it waits, and what it does then.
//!
//! Every request is entered in its [`Books`]: at the end each transmission was answered once, or is counted as unanswered.

use crate::support::{Download, Gcs, Received, Rng, TransferError, Upload, plan};
use mavstack::dialect::*;
use mavstack::{Address, Duration, Instant, Message, Text};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// What distinguishes ground stations. The times are those of the real programs.
#[derive(Clone, Copy, Debug)]
pub struct Habits {
    pub address: Address,
    /// The time until a command is retransmitted, and how often.
    pub command_timeout: Duration,
    pub command_retries: u32,
    /// The same for PARAM_SET and PARAM_REQUEST_READ.
    pub param_timeout: Duration,
    /// PARAM_REQUEST_LIST is addressed to this component.
    pub list_component: u8,
    /// The parameters that it sets, with types and bounds; no other client sets them.
    pub params: &'static [(&'static str, MavParamType, f32, f32)],
    pub transfers: Transfers,
    /// What it does on its own, and how often.
    pub routine: &'static [(Duration, Act)],
}

/// The style of plan transfers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transfers {
    QGroundControl,
    Mavsdk,
    /// With five requests in flight.
    MavProxy,
}

/// An action of a ground station.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Act {
    /// Sends this many commands that are answered at once.
    Commands(u32),
    /// Sets the intervals of its streams (µs).
    SetRates(&'static [(u32, f32)]),
    /// Starts a long-running command.
    Calibrate,
    SetMode,
    RequestDataStreams(u16),
    List,
    Read,
    Set,
    Transfer,
    Ping,
    Timesync,
}

/// The outcomes of all requests.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Books {
    /// Transmitted commands, and final COMMAND_ACKs.
    pub commands: u64,
    pub acks: u64,
    /// Long-running commands that ended.
    pub calibrations: u64,
    pub sets: u64,
    pub reads: u64,
    pub lists: u64,
    pub times: u64,
    pub uploads: u64,
    pub downloads: u64,
    /// Transfers that the vehicle refused because of another client.
    pub refused: u64,
    /// Transmitted requests without an answer.
    pub in_vain: u64,
}

#[derive(Clone, Debug)]
struct Pending {
    message: CommandLong,
    due: Instant,
    retries: u32,
    is_running: bool,
}

#[derive(Clone, Debug)]
struct Param {
    name: &'static str,
    /// The index, if the name is empty.
    index: i16,
    /// The value to set.
    set: Option<(MavParamType, f32)>,
    is_refused: bool,
    due: Instant,
}

/// A download with five requests in flight, as MAVProxy does it.
#[derive(Clone, Debug, Default)]
struct Window {
    count: Option<u16>,
    asked: BTreeMap<u16, Instant>,
    got: BTreeSet<u16>,
    due: Option<Instant>,
    repeats: u32,
    end: Option<Result<(), TransferError>>,
}

#[derive(Debug)]
enum Transfer {
    Up(Upload),
    Down(Download),
    Window(Window),
}

#[derive(Debug)]
pub struct Client {
    pub habits: Habits,
    pub books: Books,
    /// Uploads that the vehicle accepted.
    pub accepted: u32,
    /// Whether it starts anything new.
    pub is_busy: bool,
    /// Whether an answer belongs to the oldest request, because none was dropped recently.
    pub is_sure: bool,
    /// Streams whose interval (µs) it set.
    pub rates: Vec<(u32, f32)>,
    rng: Rng,
    due: Vec<Instant>,
    commands: VecDeque<Pending>,
    /// Messages that were announced by an ACK.
    promised: Vec<(u32, Instant)>,
    params: Vec<Param>,
    list: Option<(BTreeSet<u16>, Instant)>,
    transfer: Option<Transfer>,
    pings: BTreeMap<u32, Instant>,
    syncs: BTreeMap<i64, Instant>,
    number: u32,
    heartbeat: Instant,
}

const LATE: Duration = Duration::from_secs(5);

impl Client {
    pub fn new(habits: Habits, seed: u64) -> Self {
        Self {
            habits,
            books: Books::default(),
            accepted: 0,
            is_busy: true,
            is_sure: true,
            rates: Vec::new(),
            rng: Rng::new(seed),
            due: habits.routine.iter().map(|(period, _)| Instant::ZERO + *period).collect(),
            commands: VecDeque::new(),
            promised: Vec::new(),
            params: Vec::new(),
            list: None,
            transfer: None,
            pings: BTreeMap::new(),
            syncs: BTreeMap::new(),
            number: 0,
            heartbeat: Instant::ZERO,
        }
    }

    /// Returns whether nothing is outstanding.
    pub fn is_idle(&self) -> bool {
        self.commands.is_empty()
            && self.promised.is_empty()
            && self.params.is_empty()
            && self.list.is_none()
            && self.transfer.is_none()
            && self.pings.is_empty()
            && self.syncs.is_empty()
    }

    /// Returns whether it examines earlier frames.
    pub fn is_transferring(&self) -> bool {
        self.transfer.is_some()
    }

    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) {
        if now >= self.heartbeat {
            self.heartbeat = now + Duration::from_secs(1);
            self.send(gcs, &Gcs::heartbeat());
        }
        for (number, (period, act)) in self.habits.routine.iter().enumerate() {
            if now >= self.due[number] && self.is_busy {
                self.due[number] = now + *period;
                self.act(now, gcs, *act);
            }
        }
        self.repeat(now, gcs);
        self.poll_transfer(now, gcs);
    }

    fn send<M: Message>(&self, gcs: &mut Gcs, message: &M) {
        gcs.send_from(self.habits.address, message);
    }

    pub fn act(&mut self, now: Instant, gcs: &mut Gcs, act: Act) {
        let (target_system, target_component) = (1, 1);
        match act {
            Act::Commands(count) => {
                for _ in 0..count {
                    let (command, param1) = self.any_command();
                    self.command(now, gcs, command, [param1, 0.0]);
                }
            }
            Act::SetRates(rates) => {
                for (id, micros) in rates {
                    self.command(now, gcs, MavCmd::SET_MESSAGE_INTERVAL, [*id as f32, *micros]);
                }
            }
            Act::Calibrate => self.command(now, gcs, MavCmd::PREFLIGHT_CALIBRATION, [1.0, 0.0]),
            Act::SetMode => {
                self.command(now, gcs, MavCmd::DO_SET_MODE, [1.0, 4.0]);
            }
            Act::RequestDataStreams(req_message_rate) => {
                let (req_stream_id, start_stop) = (MavDataStream::ALL, 1);
                self.send(
                    gcs,
                    &RequestDataStream { req_message_rate, target_system, target_component, req_stream_id, start_stop },
                );
                let micros = 1e6 / f32::from(req_message_rate);
                self.rates.extend([Attitude::ID, GlobalPositionInt::ID, SysStatus::ID].map(|id| (id, micros)));
            }
            Act::List if self.list.is_none() => {
                let target_component = self.habits.list_component;
                self.send(gcs, &ParamRequestList { target_system, target_component });
                self.list = Some((BTreeSet::new(), now + Duration::from_secs(10)));
                self.books.lists += 1;
            }
            Act::Read => {
                let (name, index) = match self.rng.below(4) {
                    0 => ("BAT_LOW", -1),
                    1 => ("NOT_THERE", -1),
                    _ => ("", self.rng.below(9) as i16),
                };
                self.param(now, gcs, Param { name, index, set: None, is_refused: name == "NOT_THERE", due: now });
            }
            Act::Set => {
                let (name, r#type, low, high) =
                    self.habits.params[self.rng.below(self.habits.params.len() as u64) as usize];
                let value = (low + (high - low) * self.rng.below(1_000) as f32 / 1_000.0).ceil();
                let (name, value, is_refused) = match self.rng.below(8) {
                    0 => ("NOT_THERE", value, true),
                    1 => (name, high + 1.0, true),
                    _ => (name, value, false),
                };
                let value = if r#type == MavParamType::INT32 { f32::from_bits(value as u32) } else { value };
                self.param(now, gcs, Param { name, index: -1, set: Some((r#type, value)), is_refused, due: now });
            }
            Act::Transfer if self.transfer.is_none() => self.begin_transfer(gcs),
            Act::Ping => {
                self.number += 1;
                self.send(gcs, &Ping { time_usec: now.as_micros(), seq: self.number, ..Ping::default() });
                self.pings.insert(self.number, now);
                self.books.times += 1;
            }
            Act::Timesync => {
                let ts1 = now.as_micros() as i64 * 1_000 + i64::from(self.habits.address.system.wire());
                self.send(gcs, &Timesync { tc1: 0, ts1, ..Timesync::default() });
                self.syncs.insert(ts1, now);
                self.books.times += 1;
            }
            Act::List | Act::Transfer => {}
        }
    }

    fn any_command(&mut self) -> (MavCmd, f32) {
        let messages = [AutopilotVersion::ID, HomePosition::ID, 404];
        let message = messages[self.rng.below(3) as usize] as f32;
        [
            (MavCmd::REQUEST_MESSAGE, message),
            (MavCmd::REQUEST_MESSAGE, message),
            (MavCmd::GET_MESSAGE_INTERVAL, 30.0),
            (MavCmd::COMPONENT_ARM_DISARM, 1.0),
            (MavCmd::NAV_TAKEOFF, 0.0),
            (MavCmd::NAV_LAND, 0.0),
            (MavCmd::DO_REPEAT_SERVO, 1.0),
            (MavCmd::DO_SET_MISSION_CURRENT, 0.0),
            (MavCmd::MISSION_START, 0.0),
            (MavCmd(42_424), 0.0),
        ][self.rng.below(10) as usize]
    }

    /// Sends a command, unless an equal one is outstanding.
    fn command(&mut self, now: Instant, gcs: &mut Gcs, command: MavCmd, [param1, param2]: [f32; 2]) {
        let message = gcs.long(command, [param1, param2, 0.0, 0.0, 0.0, 0.0, 0.0]);
        if self.commands.iter().any(|pending| pending.message == message) {
            return;
        }
        self.send(gcs, &message);
        self.books.commands += 1;
        let due = now + self.habits.command_timeout;
        self.commands.push_back(Pending { message, due, retries: self.habits.command_retries, is_running: false });
    }

    fn param(&mut self, now: Instant, gcs: &mut Gcs, mut param: Param) {
        // One request per parameter at a time.
        if self.params.iter().any(|other| (other.name, other.index) == (param.name, param.index)) {
            return;
        }
        param.due = now + self.habits.param_timeout;
        self.send_param(gcs, &param);
        self.params.push(param);
    }

    fn send_param(&mut self, gcs: &mut Gcs, param: &Param) {
        let (target_system, target_component, param_id) = (1, 1, Text::new(param.name));
        if let Some((param_type, param_value)) = param.set {
            self.send(gcs, &ParamSet { param_value, target_system, target_component, param_id, param_type });
            self.books.sets += 1;
        } else {
            let param_index = param.index;
            self.send(gcs, &ParamRequestRead { param_index, target_system, target_component, param_id });
            self.books.reads += 1;
        }
    }

    /// Retransmits requests that timed out, or gives up.
    fn repeat(&mut self, now: Instant, gcs: &mut Gcs) {
        for _ in 0..self.commands.len() {
            let mut pending = self.commands.pop_front().expect("one of them");
            if now >= pending.due {
                assert!(!pending.is_running, "{:?} stopped reporting", pending.message);
                self.books.in_vain += 1;
                let Some(retries) = pending.retries.checked_sub(1) else { continue };
                pending.retries = retries;
                pending.due = now + self.habits.command_timeout;
                pending.message.confirmation = pending.message.confirmation.saturating_add(1);
                self.send(gcs, &pending.message);
                self.books.commands += 1;
            }
            self.commands.push_back(pending);
        }
        for index in 0..self.params.len() {
            if now >= self.params[index].due {
                self.books.in_vain += 1;
                self.params[index].due = now + self.habits.param_timeout;
                let param = self.params[index].clone();
                self.send_param(gcs, &param);
            }
        }
        let before = self.pings.len() + self.syncs.len();
        self.pings.retain(|_, sent| now - *sent < LATE);
        self.syncs.retain(|_, sent| now - *sent < LATE);
        self.books.in_vain += (before - self.pings.len() - self.syncs.len()) as u64;
        if let Some((seen, due)) = &self.list {
            assert!(now < *due, "an incomplete list: {seen:?}");
        }
        let late = self.promised.iter().find(|(_, due)| now >= *due);
        assert_eq!(late, None, "a requested message is missing");
    }

    /// Handles a frame of the vehicle.
    pub fn hear(&mut self, now: Instant, frame: &Received) {
        let is_mine = |system, component| Address::new(system, component) == self.habits.address;
        self.promised.retain(|(id, _)| *id != frame.header.id);
        if let Some(Transfer::Window(window)) = &mut self.transfer {
            window.hear(self.habits.address, frame);
        }
        if let Some(ack) = frame.decode::<CommandAck>() {
            if is_mine(ack.target_system, ack.target_component) {
                self.on_ack(now, &ack);
            }
        } else if let Some(value) = frame.decode::<ParamValue>() {
            self.on_value(&value);
        } else if let Some(error) = frame.decode::<ParamError>() {
            if is_mine(error.target_system, error.target_component) {
                let name = error.param_id.as_str().expect("a name");
                let asked = |param: &Param| param.name == name && param.index == error.param_index && param.is_refused;
                let place = self.params.iter().position(asked);
                self.params.remove(place.unwrap_or_else(|| panic!("no request for {error:?}")));
            }
        } else if let Some(ping) = frame.decode::<Ping>() {
            if is_mine(ping.target_system, ping.target_component) {
                let sent = self.pings.remove(&ping.seq).expect("answered once");
                assert_eq!(ping.time_usec, sent.as_micros());
            }
        } else if let Some(sync) = frame.decode::<Timesync>()
            && is_mine(sync.target_system, sync.target_component)
        {
            let sent = self.syncs.remove(&sync.ts1).expect("answered once");
            let between = sent.as_micros() as i64 * 1_000..=now.as_micros() as i64 * 1_000;
            assert!(between.contains(&sync.tc1), "the vehicle's clock is the same as ours");
        }
    }

    fn on_ack(&mut self, now: Instant, ack: &CommandAck) {
        let place = self.commands.iter().position(|pending| pending.message.command == ack.command);
        let pending = &mut self.commands[place.unwrap_or_else(|| panic!("no command for {ack:?}"))];
        if ack.result == MavResult::IN_PROGRESS {
            pending.is_running = true;
            pending.due = now + Duration::from_secs(3);
            return;
        }
        self.books.acks += 1;
        self.books.calibrations += u64::from(pending.is_running);
        // Answers arrive in the order of the requests.
        let done = self.commands.remove(place.unwrap_or(0)).expect("it is there");
        if ack.command == MavCmd::SET_MESSAGE_INTERVAL {
            assert_eq!(ack.result, MavResult::ACCEPTED);
            self.rates.push((done.message.param1 as u32, done.message.param2));
        }
        let promised = match ack.command {
            MavCmd::REQUEST_MESSAGE => done.message.param1 as u32,
            MavCmd::GET_MESSAGE_INTERVAL => MessageInterval::ID,
            _ => return,
        };
        if self.is_sure && ack.result == MavResult::ACCEPTED {
            self.promised.push((promised, now + Duration::from_secs(1)));
        }
    }

    fn on_value(&mut self, value: &ParamValue) {
        let name = value.param_id.as_str().expect("a name");
        self.params.retain(|param| {
            let is_it = if param.index < 0 { param.name == name } else { param.index as u16 == value.param_index };
            // A refused set waits for the refusal, and an accepted one for its value.
            let is_set = param.set.is_none_or(|(_, wanted)| wanted.to_bits() == value.param_value.to_bits());
            !is_it || param.is_refused || !is_set
        });
        if let Some((seen, _)) = &mut self.list {
            seen.insert(value.param_index);
            if seen.len() == usize::from(value.param_count) {
                self.list = None;
            }
        }
    }

    fn begin_transfer(&mut self, gcs: &Gcs) {
        let from = self.habits.address;
        let is_upload = self.rng.below(2) == 0;
        let items = plan(2 + self.rng.below(40) as u16, self.rng.below(1_000) as u16);
        let kind = self.habits.transfers;
        self.books.uploads += u64::from(is_upload);
        self.books.downloads += u64::from(!is_upload);
        self.transfer = Some(match kind {
            Transfers::QGroundControl if is_upload => {
                Transfer::Up(Upload::new(gcs, &items).by(from).like_qgroundcontrol())
            }
            _ if is_upload => Transfer::Up(Upload::new(gcs, &items).by(from)),
            Transfers::MavProxy => Transfer::Window(Window::default()),
            _ => Transfer::Down(Download::new(gcs, MavMissionType::MISSION).by(from)),
        });
    }

    fn poll_transfer(&mut self, now: Instant, gcs: &mut Gcs) {
        let end = match &mut self.transfer {
            Some(Transfer::Up(upload)) => upload.poll(now, gcs).map(|result| (result.map(|_| ()), upload.repeats())),
            Some(Transfer::Down(download)) => {
                download.poll(now, gcs).map(|result| (result.map(|_| ()), download.repeats()))
            }
            Some(Transfer::Window(window)) => window.poll(now, self.habits.address, gcs),
            None => None,
        };
        let Some((result, repeats)) = end else { return };
        self.books.in_vain += u64::from(repeats);
        match result {
            Ok(()) => self.accepted += u32::from(matches!(self.transfer, Some(Transfer::Up(_)))),
            Err(TransferError::Refused(_)) => self.books.refused += 1,
            Err(TransferError::Timeout) => panic!("{:?}: {:?} does not end", self.habits.address, self.transfer),
        }
        self.transfer = None;
    }
}

impl Window {
    const SIZE: usize = 5;
    const PATIENCE: Duration = Duration::from_secs(2);

    fn poll(&mut self, now: Instant, from: Address, gcs: &mut Gcs) -> Option<(Result<(), TransferError>, u32)> {
        let (target_system, target_component) = (1, 1);
        let Some(count) = self.count else {
            if self.due.is_none_or(|due| now >= due) {
                self.repeats += u32::from(self.due.is_some());
                self.due = Some(now + Self::PATIENCE);
                let mission_type = MavMissionType::MISSION;
                gcs.send_from(from, &MissionRequestList { target_system, target_component, mission_type });
            }
            return None;
        };
        for seq in (0..count).filter(|seq| !self.got.contains(seq)).take(Self::SIZE) {
            let asked = self.asked.get(&seq);
            if asked.is_none_or(|at| now - *at >= Self::PATIENCE) {
                self.repeats += u32::from(asked.is_some());
                self.asked.insert(seq, now);
                let mission_type = MavMissionType::MISSION;
                gcs.send_from(from, &MissionRequestInt { target_system, target_component, seq, mission_type });
            }
        }
        if self.got.len() == usize::from(count) {
            let ack = MissionAck { target_system, target_component, ..MissionAck::default() };
            gcs.send_from(from, &ack);
            self.end = Some(Ok(()));
        }
        Some((self.end?, self.repeats))
    }

    fn hear(&mut self, from: Address, frame: &Received) {
        let is_mine = |system, component| Address::new(system, component) == from;
        if let Some(count) = frame.decode::<MissionCount>() {
            if is_mine(count.target_system, count.target_component) {
                self.count.get_or_insert(count.count);
            }
        } else if let Some(item) = frame.decode::<MissionItemInt>() {
            if is_mine(item.target_system, item.target_component) {
                assert!(self.got.insert(item.seq), "each item is requested once");
            }
        } else if let Some(ack) = frame.decode::<MissionAck>()
            && is_mine(ack.target_system, ack.target_component)
        {
            // The plan has become shorter meanwhile.
            self.end = Some(Err(TransferError::Refused(ack.r#type)));
            // The other requests are refused too.
            self.count = self.count.map(|_| 0);
        }
    }
}
