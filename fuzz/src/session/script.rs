//! The format of a script.
//!
//! The first two bytes are the setup of the vehicle. Steps follow. The first byte of a step selects the action:
//!
//! ```text
//!   0  time passes                    steps, ms each
//!   1  a long pause                   0.1 s × n
//!   2  a usual message                route, which, two numbers
//!   3  any message                    route, id (2 bytes), length, payload
//!   4  any bytes                      link, length, bytes
//!   5  a sent frame returns           link, which
//!   6  a line fault                   link, which
//!   7  a flash fault                  which, for how long (2 bytes)
//!   8  an event in the vehicle        which, number
//!   9  a command with a unique id     route
//!  10  an upload starts               link, plan and items
//!  11  a second passes
//!
//! 240 and above: a hostile or an odd peer does something repeatedly: who, what, how often, how far apart (ms)
//! ```
//!
//! A route is a link (bits 0 and 1), a sender (bits 2 to 4) and a flag for signed frames (bit 7).

use super::{Declared, LINKS, Session, Tag, checks, client, vehicle};
use crate::flash::{Fault, Torn};
use crate::signer::KEY;
use crate::support::{Tuning, reference};
use arbitrary::{Result, Unstructured};
use mavstack::dialect::*;
use mavstack::message::Dialect;
use mavstack::param::ParamTable;
use mavstack::{Address, Duration, LinkId, Message, Text};

/// Commands that the stack or the vehicle handles.
const COMMANDS: [u16; 20] =
    [400, 22, 21, 300, 512, 511, 510, 246, 245, 176, 262, 2600, 519, 520, 521, 184, 192, 209, 42_428, 224];

impl<D: Declared> Session<D> {
    /// Executes the next step.
    pub fn step(&mut self, u: &mut Unstructured<'_>) -> Result<()> {
        let what: u8 = u.arbitrary()?;
        if what >= 240 {
            return self.hostile(u);
        }
        match what % 12 {
            0 => {
                let (steps, ms): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                for _ in 0..=steps % 32 {
                    self.pass(Duration::from_millis(u64::from(ms % 50) + 1));
                }
            }
            1 => self.pass(Duration::from_millis(100 * (u64::from(u.arbitrary::<u8>()?) + 1))),
            2 => {
                let (route, which, a, b) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
                self.usual(route, which, a, b);
            }
            3 => {
                let (route, id, len): (u8, u16, u8) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
                let payload = &unmarked(u.bytes(usize::from(len).min(u.len()))?);
                let rows = Common::MESSAGES.rows();
                // A known message, or any other id.
                let (id, extra) = match rows.get(usize::from(id)) {
                    Some(row) => (row.id(), row.crc_extra()),
                    None => (u32::from(id), Common::MESSAGES.get(id.into()).map_or(0, |row| row.crc_extra())),
                };
                let from = sender(route);
                if id == SetupSigning::ID {
                    self.loses = [true; LINKS];
                }
                let frame = reference::v2(id, [0, 0], [from.system.wire(), from.component.wire()], payload, extra);
                self.lines[usize::from(route & 3)].receive(&frame);
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
                let flash = self.store.flash_mut();
                // One kind of flash per script, or unreadable contents would never be repaired.
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
                let route: u8 = u.arbitrary()?;
                let link = usize::from(route & 3);
                let command = MavCmd(self.checks.new_command(link));
                if route & 0x40 == 0 {
                    let long = CommandLong { command, target_system: 1, target_component: 1, ..CommandLong::default() };
                    self.send(link, sender(route), route & 0x80 != 0, &long);
                } else {
                    let int = CommandInt { command, target_system: 1, target_component: 1, ..CommandInt::default() };
                    self.send(link, sender(route), route & 0x80 != 0, &int);
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

    /// Sends a message that ground stations send.
    fn usual(&mut self, route: u8, which: u8, a: u8, b: u8) {
        let (link, from, signed) = (usize::from(route & 3), sender(route), route & 0x80 != 0);
        let (target_system, target_component) = if route & 0x20 == 0 { (1, 1) } else { (b & 3, a & 1) };
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
                let secret_key = mavstack::message::Secret(if a == 0 { [0; 32] } else { KEY });
                let initial_timestamp = self.timestamp + (u64::from(b) << 20);
                let setup = SetupSigning { target_system, target_component, initial_timestamp, secret_key };
                self.send(link, from, signed, &setup);
            }
            21 => self.send(
                link,
                from,
                signed,
                &SetMode { target_system, custom_mode: a.into(), base_mode: MavModeFlag(b) },
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

    /// Executes an event in the vehicle.
    fn on_board(&mut self, kind: u8, number: u8) {
        let now = self.now;
        match kind % 12 {
            0 => self.loop_runs = !self.loop_runs,
            1 => {
                let healthy = vehicle(self.setup).state;
                self.vehicle.state = if self.vehicle.state.is_some() { None } else { healthy };
            }
            2 => self.vehicle.may_persist = number & 1 == 0,
            3 => self.vehicle.may_change = if number & 1 == 0 { Ok(()) } else { Err(MavMissionResult::DENIED) },
            4 => self.vehicle.plan_verdict = if number & 1 == 0 { Ok(()) } else { Err(MavMissionResult::INVALID) },
            5 => {
                self.stack.long_commands_mut().finish(MavCmd::NAV_LAND, MavResult(number % 7));
            }
            6 => self.stack.long_commands_mut().progress(MavCmd::NAV_LAND, number),
            7 => {
                self.stack.parameters_mut().set(Tuning::YAW_NOW, f32::from(number) / 2.0);
            }
            8 => self.stack.text(now, MavSeverity(number & 7), &[b'x'; 60][..usize::from(number % 61)]),
            9 => self.stack.save_parameters(now),
            10 => self.vehicle.progress.current = number.into(),
            _ => self.reboot(),
        }
    }
}

/// Returns the sender of a route.
fn sender(route: u8) -> Address {
    let (system, component) =
        [(255, 190), (254, 190), (1, 154), (1, 1), (51, 68), (2, 1), (255, 0), (3, 3)][usize::from(route >> 2 & 7)];
    Address::new(system, component)
}

/// Replaces bytes that occur in unique command ids and in the addresses of uploading clients. The fuzzer sees the operands of
/// comparisons and would otherwise impersonate them.
fn unmarked(bytes: &[u8]) -> Vec<u8> {
    let [_, mark] = checks::FIRST.to_le_bytes();
    let is_mark = |byte: u8| byte == mark || (0..LINKS).any(|link| client(link).system.wire() == byte);
    bytes.iter().map(|byte| if is_mark(*byte) { 0 } else { *byte }).collect()
}
