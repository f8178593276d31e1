//! Hostile and odd peers: who they are, and what they do.
//!
//! Each step names an actor, a link, and whether the frame is signed; so anyone's address may be forged on any link. What they send
//! is anything that costs the vehicle, or that is worth something to an attacker.

use super::checks::ASKED;
use super::{Declared, LINKS, MAX_FULL_POLLS, Session, VEHICLE, parts};
use crate::support::TestVehicle;
use arbitrary::{Result, Unstructured};
use mavstack::camera::{Image, Shot};
use mavstack::dialect::*;
use mavstack::ext_parameters::ExtValue;
use mavstack::gimbal::GimbalSetpoint;
use mavstack::{
    Address, Camera, CommandClient, CommandReply, Context, Duration, ExtParameters, GimbalManager, Message,
    OutgoingCommand, Peer, Text,
};

use crate::support::Call;

/// The name of the extended parameter.
const SETTING: &str = "CAM_ISO";

impl CommandClient for TestVehicle {
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
        Some(OutgoingCommand::long(MavCmd::DO_SET_SERVO, [f32::from(token); 7]))
    }

    fn command_answered(&mut self, _: &mut Context<'_>, token: u16, reply: CommandReply) {
        if matches!(reply, CommandReply::Done { .. } | CommandReply::InProgress(_)) {
            self.calls.push(Call::Answered(token));
        }
    }
}

impl GimbalManager for TestVehicle {
    const DEVICE: u8 = 154;
    const IS_REMOTE: bool = true;

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation::default()
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags::EMPTY
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, _: &GimbalSetpoint) -> MavResult {
        MavResult::ACCEPTED
    }

    fn device_moved(&mut self, _: &mut Context<'_>, _: &GimbalDeviceAttitudeStatus) {
        self.calls.push(Call::DeviceMoved);
    }
}

impl Camera for TestVehicle {
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;

    fn camera_information(&self, _: &mut CameraInformation) {}

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        Shot::Taken(Image::at(cx.now()))
    }
}

impl ExtParameters for TestVehicle {
    fn ext_param_count(&self) -> u16 {
        1
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        (index == 0).then_some((SETTING, ExtValue::U8(1)))
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, _: ExtValue<'_>, from: Peer) -> ParamAck {
        self.calls.push(Call::SetExtParam(from));
        ParamAck::ACCEPTED
    }
}

/// The addresses: two stations that take control from each other, the components that the vehicle asks, a companion, a radio, another
/// vehicle; and invented stations.
const ACTORS: [Address; 7] = [
    Address::new(255, 190),
    Address::new(254, 190),
    ASKED[0],
    ASKED[1],
    Address::new(1, 191),
    Address::new(51, 68),
    Address::new(2, 1),
];

/// One that was never there before.
const LATE: Address = Address::new(249, 190);

const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);
const TO_US: (u8, u8) = (1, 1);

fn long(command: MavCmd, params: [f32; 4]) -> CommandLong {
    let (target_system, target_component) = TO_US;
    let [param1, param2, param3, param4] = params;
    CommandLong { command, param1, param2, param3, param4, target_system, target_component, ..CommandLong::default() }
}

fn file_request(seq: u16, opcode: MavFtpOpcode, content: &[u8]) -> FileTransferProtocol {
    let mut payload = [0; 251];
    payload[..2].copy_from_slice(&seq.to_le_bytes());
    payload[3] = opcode.0;
    payload[4] = content.len() as u8;
    payload[12..12 + content.len()].copy_from_slice(content);
    let (target_system, target_component) = TO_US;
    FileTransferProtocol { payload, target_network: 0, target_system, target_component }
}

impl<D: Declared> Session<D> {
    /// Executes the step of a hostile or an odd peer.
    pub fn hostile(&mut self, u: &mut Unstructured<'_>) -> Result<()> {
        let (actor, what, times, gap): (u8, u8, u8, u8) =
            (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
        self.has_hostile = true;
        let link = usize::from(actor & 3);
        for number in 0..=times % 8 {
            let invented = Address::new(100 + (times ^ number) % 32, 190);
            let from = *ACTORS.get(usize::from(actor >> 2 & 7)).unwrap_or(&invented);
            self.attack(link, from, actor & 0x80 != 0, what, number);
            if gap > 0 && self.polls < MAX_FULL_POLLS {
                self.pass(Duration::from_millis(4 * u64::from(gap)));
            }
        }
        Ok(())
    }

    /// Sends something in the name of `from`.
    fn attack(&mut self, link: usize, from: Address, signed: bool, what: u8, number: u8) {
        let (target_system, target_component) = TO_US;
        let mission_type = MavMissionType(number & 1);
        let answer = |result| CommandAck {
            command: MavCmd::DO_SET_SERVO,
            result,
            target_system,
            target_component,
            ..CommandAck::default()
        };
        let command = |command, params| long(command, params);
        let file = |opcode, content| file_request(u16::from(number) + u16::from(what & 0xE0), opcode, content);
        match what & 31 {
            0 => self.send(link, from, signed, &Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() }),
            1 => self.send(link, from, signed, &Heartbeat { r#type: MavType::GIMBAL, ..Heartbeat::default() }),
            2 => {
                let params = [1.0, f32::from(what >> 5 & 1), 3.0, f32::from(from.system.wire())];
                self.send(link, from, signed, &command(REQUEST_OPERATOR_CONTROL, params));
            }
            3 => self.send(link, from, signed, &command(REQUEST_OPERATOR_CONTROL, [0.0; 4])),
            4 => self.send(link, from, signed, &answer(MavResult::ACCEPTED)),
            5 => self.send(link, from, signed, &answer(MavResult::IN_PROGRESS)),
            6 => self.send(link, from, signed, &GimbalDeviceAttitudeStatus::default()),
            7 => self.send(link, from, signed, &GimbalDeviceInformation::default()),
            8 => {
                let (tc1, ts1) = (1, i64::from(what));
                self.send(link, from, signed, &Timesync { tc1, ts1, target_system, target_component });
            }
            9 => {
                self.send(link, from, signed, &SystemTime { time_boot_ms: u32::from(number), ..SystemTime::default() })
            }
            10 => self.send(link, from, signed, &command(MavCmd::NAV_TAKEOFF, [f32::from(number); 4])),
            11 => self.send(link, from, signed, &command(MavCmd::NAV_LAND, [0.0; 4])),
            12 => {
                let command = MavCmd::NAV_LAND;
                self.send(link, from, signed, &CommandCancel { command, target_system, target_component });
            }
            13 => {
                let count = u16::from(what >> 5 & 3) + 1;
                let opaque_id = 0;
                let count = MissionCount { count, target_system, target_component, mission_type, opaque_id };
                self.send(link, from, signed, &count);
            }
            14 => {
                let (command, frame) = (MavCmd::NAV_WAYPOINT, MavFrame::GLOBAL_RELATIVE_ALT);
                let (seq, z) = (u16::from(number), 20.0);
                let item =
                    MissionItemInt { seq, command, frame, z, target_system, target_component, ..Default::default() };
                self.send(link, from, signed, &item);
            }
            15 => self.send(link, from, signed, &MissionClearAll { target_system, target_component, mission_type }),
            16 => {
                let (param_id, param_type) = (Text::new(SETTING), MavParamExtType::UINT8);
                let set = ParamExtSet { target_system, target_component, param_id, param_type, ..Default::default() };
                self.send(link, from, signed, &set);
            }
            17 => self.send(link, from, signed, &file(MavFtpOpcode::OPENFILERO, b"@PARAM/param.pck")),
            18 => self.send(link, from, signed, &file(MavFtpOpcode::CREATEFILE, b"@PARAM/param.pck")),
            19 => self.send(link, from, signed, &file(MavFtpOpcode::WRITEFILE, &[0x1B, 0x67, 1, 0, 1, 0])),
            20 => self.send(link, from, signed, &file(MavFtpOpcode::BURSTREADFILE, b"")),
            21 => self.send(link, from, signed, &file(MavFtpOpcode::TERMINATESESSION, b"")),
            22 => {
                let (ofs, count, id) = (0, u32::MAX, 0);
                self.send(link, from, signed, &LogRequestData { ofs, count, id, target_system, target_component });
            }
            23 => {
                let (start, end) = (0, u16::MAX);
                self.send(link, from, signed, &LogRequestList { start, end, target_system, target_component });
            }
            24 => self.send(link, from, signed, &command(MavCmd::LOGGING_START, [0.0; 4])),
            25 => self.send(link, from, signed, &command(MavCmd::LOGGING_STOP, [0.0; 4])),
            26 => self.send(link, from, signed, &command(MavCmd::IMAGE_START_CAPTURE, [0.0, 0.5, 0.0, 0.0])),
            27 => self.send(link, from, signed, &command(MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0, 0.0])),
            28 => {
                let [to, ..] = ACTORS;
                let (target_system, target_component) = (to.system.wire(), to.component.wire());
                let command = command(MavCmd::DO_SET_SERVO, [f32::from(number); 4]);
                self.send(link, from, signed, &CommandLong { target_system, target_component, ..command });
            }
            29 => {
                let token = u16::from(number);
                D::ask(&mut self.stack, ASKED[usize::from(token % 2)], token);
            }
            30 => self.send(link, from, signed, &command(MavCmd::SET_MESSAGE_INTERVAL, [30.0, 2_000.0, 0.0, 0.0])),
            _ => self.send(link, from, signed, &RadioStatus { txbuf: number, ..RadioStatus::default() }),
        }
    }

    /// Asserts that one that was never there before is served within 20 s: its command, its request for a plan, and its file.
    pub fn assert_serves(&mut self) {
        const LINK: usize = 0;
        let [mut has_command, mut has_plan, mut has_file] = [false; 3];
        let (target_system, target_component) = TO_US;
        while self.lines.iter().any(super::Uart::has_input) {
            self.pass(Duration::from_millis(20));
        }
        for pass in 0..400u16 {
            if pass % 20 == 0 {
                let mission_type = MavMissionType::MISSION;
                self.send(LINK, LATE, false, &long(MavCmd::NAV_TAKEOFF, [f32::from(pass); 4]));
                self.send(LINK, LATE, false, &MissionRequestList { target_system, target_component, mission_type });
                let open = file_request(pass, MavFtpOpcode::OPENFILERO, b"@PARAM/param.pck");
                self.send(LINK, LATE, false, &open);
            }
            self.lines[LINK].frames.clear();
            self.pass(Duration::from_millis(50));
            for frame in &self.lines[LINK].frames {
                let Some((VEHICLE, id, payload)) = parts(frame) else { continue };
                match id {
                    CommandAck::ID => {
                        let ack = CommandAck::decode(payload);
                        has_command |= ack.command == MavCmd::NAV_TAKEOFF && ack.target_system == LATE.system.wire();
                    }
                    MissionCount::ID => {
                        has_plan |= MissionCount::decode(payload).target_system == LATE.system.wire();
                    }
                    FileTransferProtocol::ID => {
                        let answer = FileTransferProtocol::decode(payload);
                        has_file |=
                            answer.payload[3] == MavFtpOpcode::ACK.0 && answer.target_system == LATE.system.wire();
                    }
                    _ => {}
                }
            }
            if has_command && has_plan && has_file {
                return;
            }
        }
        panic!("a late station has a command: {has_command}, a plan: {has_plan}, a file: {has_file}");
    }
}

const _: () = assert!(LINKS == 4, "a route has two bits for the link");
