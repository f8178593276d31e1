//! The order in which a link sends, as observed on the wire: rules D-4, P-11, R-14. The list is `turns!` in `src/service/turn.rs`.
//! `docs/architecture.md` shows it as a table, which these tests read.

use crate::support::*;
use mavstack::camera::{Image, Shot};
use mavstack::command::CommandPolicy;
use mavstack::config::StreamProfile;
use mavstack::dialect::*;
use mavstack::ext_parameters::ExtValue;
use mavstack::files::StaticFile;
use mavstack::gimbal::GimbalSetpoint;
use mavstack::logs::{LogInfo, LogRead};
use mavstack::param::ParamTable;
use mavstack::{
    Address, Camera, CommandClient, CommandReply, Commands, Context, Duration, ExtParameters, Files, Fill, FlightMode,
    Frame, GimbalDevice, GimbalManager, Instant, LinkConfig, LinkId, LogStreaming, Logs, Message, ModeRequest, Modes,
    Outcome, OutgoingCommand, Stream, Telemetry, Vehicle, VehicleState,
};
use std::collections::{BTreeMap, VecDeque};

/// Another vehicle, behind the second link.
pub(super) const WINGMAN: Address = Address::new(2, 1);

#[derive(mavstack::Stack)]
#[stack(
    vehicle: Moded,
    links: 2,
    plans: { mission: 4 },
    parameters: Tuning,
    streams,
    messages,
    command_client: { slots: 1 },
    operator_control,
    logs,
    modes,
    commands: { slots: 3 },
    forwarding,
    files: { sessions: 1 },
)]
pub(super) struct Full {
    time: mavstack::clock::Time,
    gimbal_manager: mavstack::gimbal::ManagerService,
    gimbal_device: mavstack::gimbal::DeviceService,
    log_streaming: mavstack::logs::LogStreamer,
    camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 16]>,
    ext_parameters: mavstack::ext_parameters::ExtParamServer,
}

/// The vehicle of the tests, with flight modes.
#[derive(Default)]
pub(super) struct Moded(TestVehicle);

impl Vehicle for Moded {
    fn state(&self) -> Option<VehicleState> {
        self.0.state()
    }

    fn message(&mut self, cx: &mut Context<'_>, frame: &Frame<'_>, link: LinkId) -> bool {
        self.0.message(cx, frame, link)
    }
}

impl Commands for Moded {
    const POLICIES: &'static [CommandPolicy] = TestVehicle::POLICIES;

    fn command(&mut self, cx: &mut Context<'_>, command: &mavstack::Command) -> Outcome {
        self.0.command(cx, command)
    }
}

impl CommandClient for Moded {
    fn command_for(&mut self, _: u16) -> Option<OutgoingCommand> {
        Some(OutgoingCommand::long(MavCmd::REQUEST_MESSAGE, [0.0; 7]))
    }

    fn command_answered(&mut self, _: &mut Context<'_>, _: u16, _: CommandReply) {}
}

impl Modes for Moded {
    const MODES: &'static [FlightMode] = pilot::MODES;

    fn set_mode(&mut self, _: &mut Context<'_>, _: &'static FlightMode, _: &ModeRequest) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl GimbalManager for Moded {
    const DEVICE: u8 = 1;

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation::default()
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags::EMPTY
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, _: &GimbalSetpoint) -> MavResult {
        MavResult::ACCEPTED
    }
}

impl GimbalDevice for Moded {
    const ID: u8 = 1;

    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation::default()
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        Some(GimbalDeviceAttitudeStatus::default())
    }
}

wrap_plans!(Moded);

impl Camera for Moded {
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;

    fn camera_information(&self, _: &mut CameraInformation) {}

    fn take_image(&mut self, _: &mut Context<'_>, _: u32) -> Shot {
        Shot::Failed
    }
}

impl ExtParameters for Moded {
    fn ext_param_count(&self) -> u16 {
        1
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        (index == 0).then_some(("CAM_ISO", ExtValue::U8(1)))
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, _: ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
        ParamAck::ACCEPTED
    }
}

impl Files for Moded {
    const FILES: &'static [StaticFile] = crate::support::files::STATIC;
}

impl Logs for Moded {
    fn log_count(&self) -> u16 {
        1
    }

    fn log_info(&self, _: u16) -> Option<LogInfo> {
        None
    }

    fn read_log(&mut self, _: u16, _: u32, _: &mut [u8]) -> LogRead {
        LogRead::Failed
    }
}

impl LogStreaming for Moded {
    fn start_log_stream(&mut self, _: &mut Context<'_>, _: mavstack::Peer) -> MavResult {
        MavResult::ACCEPTED
    }

    fn stop_log_stream(&mut self, _: &mut Context<'_>) {}

    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        out.len().min(100_usize.saturating_sub(offset as usize))
    }

    fn log_data_len(&self) -> usize {
        0
    }

    fn take_log_data(&mut self, _: &mut [u8]) -> usize {
        0
    }
}

impl Telemetry for Moded {
    const STREAMS: &'static [Stream] = TestVehicle::STREAMS;

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        self.0.fill(id, out)
    }
}

pub(super) type Loaded = World<2, Full>;

/// Receives `message` on a link.
fn receive<M: Message>(world: &mut Loaded, now: Instant, link: usize, from: Address, message: &M) {
    let frame = world.gcs[link].frame_from(from, message);
    let taken = world.stack.receive(now, LinkId(link as u8), &frame, &mut world.vehicle);
    assert_eq!(taken, frame.len());
}

/// Returns what link 0 sends at `now`: the ids, whether each frame is forwarded, and the lengths.
fn sent(world: &mut Loaded, now: Instant) -> Vec<((u32, bool), i32)> {
    let mut sent = Vec::new();
    loop {
        let bytes = world.stack.transmit(now, LinkId(0), &mut world.vehicle).to_vec();
        if bytes.is_empty() {
            return sent;
        }
        world.stack.transmitted(LinkId(0), bytes.len());
        let id = u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0]);
        sent.push(((id, bytes[5] != VEHICLE.system.wire()), bytes.len() as i32));
    }
}

/// D-4, Q-2, R-14: a link with one pending frame of every kind sends them in the order of the turns.
#[test]
fn pending_frames_are_sent_in_order() {
    let off = LinkConfig::unlimited().with_streams(StreamProfile::Off);
    let links = [LinkConfig::unlimited().with_streams(StreamProfile::Onboard), off];
    let mut world = Loaded::of(Setup { links, ..Setup::new() });
    world.run_for(secs(2));
    // A link has room for four answers to commands, so three are sent before.
    let mut before = 0;
    for (command, id) in [
        (MavCmd::REQUEST_MESSAGE, GimbalManagerInformation::ID),
        (MavCmd::REQUEST_MESSAGE, GimbalDeviceInformation::ID),
        (MavCmd::LOGGING_START, 0),
    ] {
        let now = world.now();
        let message = world.gcs[0].long(command, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        receive(&mut world, now, 0, STATION, &message);
        let answer = world.stack.transmit(now, LinkId(0), &mut world.vehicle).to_vec();
        assert_eq!(u32::from(answer[7]), CommandAck::ID);
        world.stack.transmitted(LinkId(0), answer.len());
        before += answer.len() as i32;
    }
    // Every periodic message is due now.
    let now = world.now() + millis(1_400);
    world.pulse.tick();
    world.stack.poll(now + Duration::ZERO, &mut world.vehicle);
    world.pulse.tick();
    world.vehicle.0.state.as_mut().unwrap().custom_mode = pilot::HOLD;
    world.stack.text(now, MavSeverity::INFO, "Gear down");
    assert!(world.stack.send::<SystemTime>(LinkId(0), 0));
    assert!(world.stack.send_command(STATION, 0));

    for _ in 0..2 {
        receive(&mut world, now, 1, WINGMAN, &Tunnel { payload: [1; 128], ..Tunnel::default() });
    }
    // Only a living component gets commands.
    receive(&mut world, now, 0, STATION, &Heartbeat::default());
    receive(&mut world, now, 0, STATION, &ParamRequestList { target_system: 1, target_component: 1 });
    receive(&mut world, now, 0, STATION, &ParamExtRequestList { target_system: 1, target_component: 1 });
    world.stack.camera.image_captured(Image::at(now));
    for (command, id) in [
        (MavCmd::REQUEST_MESSAGE, AvailableModes::ID),
        (MavCmd::REQUEST_MESSAGE, BatteryStatus::ID),
        (MavCmd::GET_MESSAGE_INTERVAL, Attitude::ID),
        (MavCmd::REQUEST_MESSAGE, AutopilotVersion::ID),
    ] {
        let message = world.gcs[0].long(command, [id as f32, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        receive(&mut world, now, 0, STATION, &message);
    }
    let to_us = ParamRequestRead { param_index: 3, target_system: 1, target_component: 1, ..Default::default() };
    receive(&mut world, now, 0, STATION, &to_us);
    let list = MissionRequestList { target_system: 1, target_component: 1, ..Default::default() };
    receive(&mut world, now, 0, STATION, &list);
    receive(&mut world, now, 0, STATION, &Timesync { ts1: 7, ..Timesync::default() });
    let rally = MissionRequestList { mission_type: MavMissionType::RALLY, ..list };
    receive(&mut world, now, 0, STATION, &rally);
    // A directory, and a file that there is not.
    let file = |opcode| crate::support::files::request(0, 0, opcode, 0, 0, &[]);
    receive(&mut world, now, 0, STATION, &file(MavFtpOpcode::LISTDIRECTORY));
    receive(&mut world, now, 0, STATION, &file(MavFtpOpcode::OPENFILERO));
    let logs = LogRequestList { start: 0, end: u16::MAX, target_system: 1, target_component: 1 };
    receive(&mut world, now, 0, STATION, &logs);
    world.stack.poll(now, &mut world.vehicle);

    let mut sent = sent(&mut world, now);
    // A run of equal frames counts as one that is as long.
    sent.dedup_by(|(id, len), (previous, sum)| {
        *sum += *len * i32::from(id == previous);
        id == previous
    });
    // What is pending, by turn. The list of parameters was asked for just now, and no setting of a key was answered.
    let own = |id| (id, false);
    let pending = [
        ("Heartbeat", vec![own(Heartbeat::ID)]),
        // The scheduled one reports the change of the mode, and no command is running.
        ("ExtraHeartbeat", vec![]),
        ("CommandProgress", vec![]),
        // `vehicle/components` has firmwares of several components.
        ("ComponentHeartbeat", vec![]),
        ("CommandAck", vec![own(CommandAck::ID)]),
        ("MissionAck", vec![own(MissionAck::ID)]),
        ("SigningText", vec![]),
        ("Time", vec![own(Timesync::ID)]),
        ("UrgentText", vec![]),
        ("MissionTransfer", vec![own(MissionCount::ID)]),
        ("ParamAnswer", vec![own(ParamValue::ID)]),
        ("Text", vec![own(Statustext::ID)]),
        ("Identity", vec![own(AutopilotVersion::ID)]),
        ("Request", vec![own(MessageInterval::ID), own(BatteryStatus::ID)]),
        ("Camera", [CameraImageCaptured::ID, CameraCaptureStatus::ID].map(own).to_vec()),
        ("Client", vec![own(CommandLong::ID)]),
        ("OperatorControl", vec![own(512)]),
        ("Gimbal", vec![own(GimbalManagerInformation::ID)]),
        ("GimbalDevice", vec![own(GimbalDeviceInformation::ID)]),
        // This vehicle has no services of other crates.
        ("Answer", vec![]),
        ("Report", vec![]),
        ("CurrentMode", vec![own(CurrentMode::ID)]),
        ("MissionProgress", vec![own(MissionCurrent::ID)]),
        ("ModeList", vec![own(AvailableModes::ID)]),
        ("FileAnswer", vec![own(FileTransferProtocol::ID)]),
        // This vehicle declares no events.
        ("Event", vec![]),
        ("Message", vec![own(SystemTime::ID)]),
        ("ExtParam", vec![own(ParamExtValue::ID)]),
        ("LateParamList", vec![]),
        ("GimbalStatus", vec![own(GimbalManagerStatus::ID)]),
        ("GimbalAttitude", vec![own(GimbalDeviceAttitudeStatus::ID)]),
        // Nothing was sent of the share of bulk data, so its first frame is late.
        ("LateBulk", vec![own(LogEntry::ID)]),
        ("Stream", vec![own(Attitude::ID), own(GlobalPositionInt::ID), own(SysStatus::ID)]),
        ("Forwarded", vec![(Tunnel::ID, true); 2]),
        ("ParamList", vec![own(ParamValue::ID)]),
        ("Bulk", [LoggingDataAcked::ID, FileTransferProtocol::ID].map(own).to_vec()),
    ];
    let (ids, lens): (Vec<_>, Vec<_>) = sent.into_iter().unzip();
    assert_eq!(ids, in_order(&turns(), pending, before, &lens), "not the order in docs/architecture.md");
}

/// Returns the turns of a normal link, from the table in `docs/architecture.md`: a unit test compares it with the stack's
/// own list.
fn turns() -> Vec<&'static str> {
    let page = include_str!("../../docs/architecture.md");
    let (_, behind) = page.split_once("<!-- turns -->").expect("the page has the table");
    let (table, _) = behind.split_once("<!-- end of turns -->").expect("the table has an end");
    let rows = table.lines().map(|row| row.split('|').map(|cell| cell.trim().trim_matches('`')).collect());
    let rows = rows.filter(|row: &Vec<_>| row.len() > 5 && row[1].parse::<u8>().is_ok());
    rows.filter(|row| row[5] != "high-latency").map(|row| row[2]).collect()
}

/// The turns of transfers that are behind their own share.
const LATE: [&str; 2] = ["LateParamList", "LateBulk"];
/// The turns of streams and forwarded frames.
const STREAMS: [&str; 6] = ["GimbalStatus", "GimbalAttitude", "Stream", "Report", "ForwardedFirst", "Forwarded"];
/// The turns of lists, files and logs.
const TRANSFERS: [&str; 4] = ["LateParamList", "ParamList", "LateBulk", "Bulk"];
/// The turns that are sent however busy the link is.
const AT_ONCE: [&str; 5] = ["Heartbeat", "ComponentHeartbeat", "CommandAck", "MissionAck", "SigningText"];

/// Returns what a link sends that always asks the turns in their order, with frames of these lengths. Streams come first when they
/// are a long frame behind the rest; at first they are `behind` by so much. `ForwardedFirst` has the frames of `Forwarded`, if streams have had more.
fn in_order<const N: usize>(
    turns: &[&str],
    pending: [(&str, Vec<(u32, bool)>); N],
    mut behind: i32,
    lens: &[i32],
) -> Vec<(u32, bool)> {
    let mut pending: BTreeMap<_, VecDeque<_>> =
        pending.into_iter().map(|(turn, frames)| (turn, frames.into())).collect();
    for turn in turns {
        assert!(*turn == "ForwardedFirst" || pending.contains_key(turn), "nothing is said about the turn {turn}");
    }
    let (mut sent, mut forwarded) = (Vec::new(), 0);
    for len in lens {
        let comes_first = |turn: &&&str| [&STREAMS[..], &AT_ONCE, &LATE].iter().any(|turns| turns.contains(turn));
        let first = turns.iter().filter(|turn| behind >= 280 && comes_first(turn));
        let next = first.chain(turns).filter(|turn| **turn != "ForwardedFirst" || forwarded > 0).find_map(|turn| {
            let kind = if *turn == "ForwardedFirst" { "Forwarded" } else { turn };
            Some((*turn, pending.get_mut(kind)?.pop_front()?))
        });
        let Some((kind, frame)) = next else { break };
        let is_stream = STREAMS.contains(&kind);
        let eighths = match kind {
            "MissionTransfer" => 1,
            kind if TRANSFERS.contains(&kind) => 3,
            _ => 8,
        };
        behind += if is_stream { -len } else { len * eighths / 8 };
        behind = behind.clamp(0, 560);
        forwarded += match kind {
            "ForwardedFirst" => -len,
            "Forwarded" => 0,
            _ => len * i32::from(is_stream),
        };
        forwarded = forwarded.clamp(-280, 120);
        sent.push(frame);
    }
    sent
}

/// D-4, P-11: on a link that streams saturate, the parameter list gets 30 % of the rate at any poll interval, and the streams
/// get most of the rest.
#[test]
fn list_keeps_its_share_on_a_saturated_link() {
    const RATE: u64 = 5_760;
    for step in [1, 5, 19, 20, 25] {
        let links = [LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard), LinkConfig::uart(57_600)];
        let down = Wire { bytes_per_second: RATE, tx_fifo: 512, ..Wire::default() };
        let lines = [LineConfig { down, ..LineConfig::default() }, LineConfig::default()];
        let mut world = Loaded::of(Setup { links, lines, step: millis(step), ..Setup::new() });
        for id in [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID] {
            world.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            world.run_for(millis(200));
        }
        world.gcs[0].forget();
        let begin = world.now();
        // The times between two values of a list (µs).
        let mut pauses = Vec::new();
        for list in 0..20 {
            world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
            let last = Tuning::INFO.len() as u16 - 1;
            let has_ended = |world: &mut Loaded| {
                let values = world.gcs[0].all::<ParamValue>();
                values.last().is_some_and(|(_, value)| value.param_index == last)
            };
            assert!(world.run_until(secs(5), has_ended), "polls {step} ms apart: list {list} does not end");
            let values = world.gcs[0].all::<ParamValue>();
            pauses.extend(values.windows(2).map(|pair| (pair[1].0 - pair[0].0).as_micros()));
            world.gcs[0].received.retain(|frame| frame.header.id != ParamValue::ID);
        }
        let list = 37 * 1_000_000 * 100 * pauses.len() as u64 / pauses.iter().sum::<u64>() / RATE;
        let rest: usize = world.gcs[0].received.iter().map(|frame| frame.raw.len()).sum();
        let rest = rest as u64 * 100 * 1_000_000 / (world.now() - begin).as_micros() / RATE;
        assert!(list >= 30, "polls {step} ms apart: {list} % for the list");
        assert!(rest >= 40, "polls {step} ms apart: {rest} % for the streams");
    }
}
