//! L-2, L-4: whatever peers and the firmware request, only commands, their answers and HIGH_LATENCY2 are sent on a
//! high-latency link, and HIGH_LATENCY2 only while it is switched on.

use std::collections::BTreeSet;

use crate::support::*;
use mavstack::camera::{Image, Shot};
use mavstack::config::{CreditConfig, LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::ext_parameters::ExtValue;
use mavstack::gimbal::GimbalSetpoint;
use mavstack::high_latency::{HighLatencyConfig, HighLatencySample};
use mavstack::logs::{LogInfo, LogRead};
use mavstack::message::Dialect;
use mavstack::{
    Camera, Command, Commands, Context, CustomMode, ExtParameters, Fill, FlightMode, GimbalDevice, GimbalManager,
    Instant, LinkConfig, LinkId, LogStreaming, Logs, Message, ModeRequest, Modes, Outcome, Peer, PlanType, StackOf,
    Stream, Telemetry, Vehicle, VehicleState,
};

/// A vehicle with every service: [`TestVehicle`], and modes.
#[derive(Default)]
struct Everything(TestVehicle);

impl Vehicle for Everything {
    fn state(&self) -> Option<VehicleState> {
        self.0.state()
    }
}

impl Commands for Everything {
    const POLICIES: &'static [mavstack::command::CommandPolicy] = TestVehicle::POLICIES;

    fn cancel_command(&mut self, cx: &mut Context<'_>, command: MavCmd, from: Peer) -> bool {
        self.0.cancel_command(cx, command, from)
    }

    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        self.0.command(cx, command)
    }
}

impl Modes for Everything {
    const MODES: &'static [FlightMode] = pilot::MODES;
    const CUSTOM_MODE: CustomMode = CustomMode::MainSub;

    fn set_mode(&mut self, _: &mut Context<'_>, mode: &'static FlightMode, _: &ModeRequest) -> Outcome {
        if let Some(state) = &mut self.0.state {
            state.custom_mode = mode.custom_mode;
        }
        MavResult::ACCEPTED.into()
    }
}

/// Its gimbal device is heard on every link.
impl GimbalManager for Everything {
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

    fn device_setpoint(&mut self, _: Instant) -> Option<GimbalDeviceSetAttitude> {
        Some(GimbalDeviceSetAttitude::UNKNOWN)
    }

    fn autopilot_state(&mut self, _: Instant) -> Option<AutopilotStateForGimbalDevice> {
        Some(AutopilotStateForGimbalDevice::UNKNOWN)
    }
}

impl GimbalDevice for Everything {
    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation::default()
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        Some(GimbalDeviceAttitudeStatus::default())
    }
}

wrap_plans!(Everything);

impl Camera for Everything {
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;

    fn camera_information(&self, _: &mut CameraInformation) {}

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        Shot::Taken(Image::at(cx.now()))
    }
}

impl ExtParameters for Everything {
    fn ext_param_count(&self) -> u16 {
        2
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        (index < 2).then_some(("CAM", ExtValue::U16(index)))
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, _: u16, _: ExtValue<'_>, _: mavstack::Peer) -> ParamAck {
        ParamAck::ACCEPTED
    }
}

impl Logs for Everything {
    fn log_count(&self) -> u16 {
        1
    }

    fn log_info(&self, _: u16) -> Option<LogInfo> {
        Some(LogInfo { size: 200, time_utc: 0 })
    }

    fn read_log(&mut self, _: u16, _: u32, out: &mut [u8]) -> LogRead {
        out.fill(7);
        LogRead::Done
    }
}

impl LogStreaming for Everything {
    fn start_log_stream(&mut self, _: &mut Context<'_>, _: mavstack::Peer) -> MavResult {
        MavResult::ACCEPTED
    }

    fn stop_log_stream(&mut self, _: &mut Context<'_>) {}

    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize {
        out.len().min(300_usize.saturating_sub(offset as usize))
    }

    fn log_data_len(&self) -> usize {
        90
    }

    fn take_log_data(&mut self, out: &mut [u8]) -> usize {
        out.len().min(90)
    }
}

impl Telemetry for Everything {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<Attitude>().onboard(millis(20)),
        Stream::of::<SysStatus>().onboard(millis(500)),
        Stream::of::<HomePosition>(),
        // Declared by mistake.
        Stream::of::<HighLatency2>().onboard(millis(50)),
        Stream::of::<HighLatency>().onboard(millis(50)),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        match id {
            HighLatency2::ID => out.put(&HighLatency2::default()),
            HighLatency::ID => out.put(&HighLatency::default()),
            _ => self.0.fill(id, out),
        }
    }
}

#[cfg(not(feature = "signing"))]
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Everything,
    links: LINKS,
    plans: { mission: 10, fence: 8, rally: 2 },
    parameters: Tuning,
    streams,
    modes,
    commands: { slots: 3 },
    forwarding,
    manual_control,
    operator_control,
    logs,
)]
struct Mavlink {
    time: mavstack::clock::Time,
    setpoints: mavstack::setpoints::Setpoints,
    gimbal_manager: mavstack::gimbal::ManagerService,
    gimbal_device: mavstack::gimbal::DeviceService,
    high_latency: mavstack::high_latency::HighLatency,
    log_streaming: mavstack::logs::LogStreamer,
    camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 16]>,
    ext_parameters: mavstack::ext_parameters::ExtParamServer,
}

#[cfg(feature = "signing")]
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Everything,
    links: LINKS,
    plans: { mission: 10, fence: 8, rally: 2 },
    parameters: Tuning,
    streams,
    modes,
    commands: { slots: 3 },
    forwarding,
    signing,
    manual_control,
    operator_control,
    logs,
)]
struct Mavlink {
    time: mavstack::clock::Time,
    setpoints: mavstack::setpoints::Setpoints,
    gimbal_manager: mavstack::gimbal::ManagerService,
    gimbal_device: mavstack::gimbal::DeviceService,
    high_latency: mavstack::high_latency::HighLatency,
    log_streaming: mavstack::logs::LogStreamer,
    camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 16]>,
    ext_parameters: mavstack::ext_parameters::ExtParamServer,
}

const LINKS: usize = 4;
const ALLOWED: [u32; 5] = [CommandLong::ID, CommandInt::ID, CommandAck::ID, CommandCancel::ID, HighLatency2::ID];

/// What the far end of a link received.
#[derive(Default)]
struct Line {
    /// The received part of a frame.
    front: Vec<u8>,
    /// A frame is encoded, and none of its bytes was taken yet.
    is_made: bool,
    /// Ids of our own frames.
    ids: BTreeSet<u32>,
    /// How many frames came from others.
    forwarded: u64,
    frames: u64,
    reports: u64,
}

impl Line {
    /// Takes bytes from the link, and checks id and source as soon as they are known.
    fn take(&mut self, bytes: &[u8], may_leave: impl Fn(u32, bool) -> bool) {
        for byte in bytes {
            self.front.push(*byte);
            let (id, source, len) = match *self.front {
                [0xFD, len, flags, _, _, system, component, a, b, c, ..] => {
                    let signature = if flags & 1 == 1 { 13 } else { 0 };
                    (u32::from_le_bytes([a, b, c, 0]), [system, component], usize::from(len) + 12 + signature)
                }
                [0xFE, len, _, system, component, id, ..] => (u32::from(id), [system, component], usize::from(len) + 8),
                _ => continue,
            };
            let is_own = source == [1, 1];
            assert!(may_leave(id, is_own), "message {id} is not allowed on this link");
            if self.front.len() == len {
                self.front.clear();
                self.frames += 1;
                self.forwarded += u64::from(!is_own);
                if is_own {
                    self.ids.insert(id);
                    self.reports += u64::from(id == HighLatency2::ID);
                }
            }
        }
    }
}

/// Returns a random frame: any message to any target, usually one that the stack acts on.
fn any_frame(rng: &mut Rng) -> Vec<u8> {
    const BUSY: [u32; 36] = [
        0, 4, 11, 117, 119, 20, 21, 23, 40, 41, 43, 44, 45, 47, 51, 66, 69, 70, 73, 75, 76, 76, 76, 76, 76, 77, 80,
        109, 111, 235, 253, 110, 256, 320, 321, 323,
    ];
    const COMMANDS: [u16; 22] = [
        2510, 2600, 2600, 2600, 519, 512, 512, 512, 511, 510, 520, 519, 176, 262, 400, 22, 300, 224, 245, 183, 2000,
        521,
    ];
    let rows = Common::MESSAGES.rows();
    let row = match rng.below(4) {
        0 => &rows[rng.below(rows.len() as u64) as usize],
        _ => Common::MESSAGES.get(BUSY[rng.below(BUSY.len() as u64) as usize]).expect("of the dialect"),
    };
    let mut payload: Vec<u8> = (0..row.max_len()).map(|_| if rng.chance(0.5) { 0 } else { rng.byte() }).collect();
    if row.id() == CommandLong::ID {
        let first = match rng.below(3) {
            0 => rng.below(2) as f32,
            1 => rows[rng.below(rows.len() as u64) as usize].id() as f32,
            _ => [30.0, 148.0, 235.0, 234.0, 242.0, 435.0, 435.0, 436.0][rng.below(8) as usize],
        };
        let command = CommandLong {
            command: MavCmd(COMMANDS[rng.below(22) as usize]),
            param1: first,
            param2: [0.0, 1.0, 10_000.0, f32::NAN][rng.below(4) as usize],
            confirmation: rng.below(2) as u8,
            ..CommandLong::default()
        };
        command.encode(&mut payload).expect("room");
    }
    let (system, component) = [(1, 1), (1, 0), (0, 0), (2, 1)][rng.below(4) as usize];
    for (at, target) in [(row.target_system(), system), (row.target_component(), component)] {
        if let Some(at) = at {
            payload[usize::from(at)] = target;
        }
    }
    let source = [[255, 190], [254, 190], [1, 191], [2, 1], [1, 1]][rng.below(5) as usize];
    match u8::try_from(row.id()) {
        Ok(id) if rng.chance(0.2) => {
            reference::v1(id, source, &payload[..usize::from(row.base_len())], row.crc_extra())
        }
        _ => reference::v2(row.id(), [0, 0], source, &payload, row.crc_extra()),
    }
}

/// Runs random events, all derived from `seed`.
fn run(seed: u64, events: u32) -> [Line; LINKS] {
    let mut rng = Rng::new(seed);
    let frames: Vec<Vec<u8>> = (0..4_000).map(|_| any_frame(&mut rng)).collect();
    let satellite = LinkConfig::uart(2_400).with_class(LinkClass::HighLatency);
    let mut setup = Setup::<LINKS>::new();
    setup.links = [
        LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard),
        satellite.with_streams(StreamProfile::Onboard),
        LinkConfig::unlimited(),
        satellite.with_version(TxVersion::Auto),
    ];
    // A frame that sets a key is answered by a heartbeat and a text, but not on a high-latency link (G-11).
    #[cfg(feature = "signing")]
    for link in &mut setup.links {
        *link = link.with_signing(mavstack::signing::LinkSigning::OPEN.with_provisioning());
    }
    let is_satellite = |link: usize| setup.links[link].class == LinkClass::HighLatency;
    let mut stack = Box::new(StackOf::<Mavlink>::new(setup.config, setup.links));
    // So that many commands are forwarded.
    stack.set_credits(CreditConfig { per_hour: 0, ..CreditConfig::DEFAULT });
    let mut vehicle = Everything(TestVehicle::new());
    stack.manual_input_mut().set_source(mavstack::manual_control::ControlSource::GroundStation);
    vehicle.0.long.insert(MavCmd::DO_SET_SERVO.0);
    let config = HighLatencyConfig { period: secs(5), on_link_loss_after: Some(secs(2)), ..HighLatencyConfig::DEFAULT };
    stack.high_latency.set_config(config);
    let state = vehicle.0.state;
    let (mut now, mut lines) = (Instant::ZERO, [const { None }; LINKS].map(|_: Option<Line>| Line::default()));
    for event in 0..events {
        let link = rng.below(LINKS as u64) as usize;
        let id = LinkId(link as u8);
        let is_on = stack.high_latency.is_on();
        match rng.below(100) {
            0..35 => {
                let frame = &frames[rng.below(4_000) as usize];
                stack.receive(now, id, frame, &mut vehicle);
            }
            35..75 => {
                let line = &mut lines[link];
                let bytes = stack.transmit(now, id, &mut vehicle);
                let is_new = line.front.is_empty() && !line.is_made;
                let len = if rng.chance(0.7) { bytes.len() } else { rng.below(bytes.len() as u64 + 1) as usize };
                line.is_made = len == 0 && !bytes.is_empty();
                line.take(&bytes[..len], |id, is_own| match id {
                    HighLatency2::ID if is_own => is_satellite(link) && (is_on || !is_new),
                    // HIGH_LATENCY2 of others is forwarded to normal links (L-5).
                    HighLatency2::ID => !is_satellite(link),
                    id => !is_satellite(link) || ALLOWED.contains(&id),
                });
                stack.transmitted(id, len);
            }
            75..85 => {
                now += millis(rng.below(60));
                if !rng.chance(0.02) {
                    setup.config.pulse.expect("a pulse").tick();
                }
                stack.poll(now, &mut vehicle);
                assert!(stack.next_deadline(now) >= now);
            }
            85 => {
                stack.restart_link(id);
                let line = &mut lines[link];
                line.front.clear();
                // An interrupted frame may be sent again from its start.
                line.is_made = true;
            }
            86 => stack.text(now, MavSeverity(rng.below(8) as u8), &format!("event {event}")),
            87 => match rng.below(4) {
                0 => stack.announce::<HighLatency2>(),
                1 => stack.announce::<HighLatency>(),
                2 => stack.announce::<HomePosition>(),
                _ => stack.announce::<SysStatus>(),
            },
            88 => stack.mission_item_reached(now, rng.below(10) as u16),
            89 => {
                let item = mavstack::Item {
                    frame: MavFrame::GLOBAL_RELATIVE_ALT,
                    command: MavCmd::NAV_WAYPOINT,
                    autocontinue: 1,
                    params: [0.0; 4],
                    x: 1,
                    y: 1,
                    z: 10.0,
                };
                let items = std::iter::repeat_n(item, rng.below(12) as usize);
                let _ = stack.load_plan(now, PlanType::Mission, items, &mut vehicle);
            }
            #[cfg(feature = "storage")]
            90 => stack.save_parameters(now),
            91 => stack.time.ask(id),
            92 => {
                stack.long_commands_mut().progress(MavCmd::DO_SET_SERVO, rng.byte());
                stack.long_commands_mut().finish(MavCmd::DO_SET_SERVO, MavResult::ACCEPTED);
            }
            93 => vehicle.0.state = if rng.chance(0.1) { None } else { state },
            94 => vehicle.0.state.iter_mut().for_each(|state| state.custom_mode = rng.byte().into()),
            95 => vehicle.0.has_home = rng.chance(0.5),
            96 => stack.set_address(setup.config.address),
            97 => {
                // Random bytes, possibly in the middle of a frame.
                let noise: Vec<u8> = (0..rng.below(60)).map(|_| rng.byte()).collect();
                stack.receive(now, id, &noise, &mut vehicle);
            }
            _ => {
                let satellite = &mut stack.high_latency;
                match rng.below(4) {
                    0 => satellite.start(),
                    1 => satellite.stop(),
                    _ => satellite.sample(now, &HighLatencySample { eph: 1.0, ..HighLatencySample::UNKNOWN }),
                }
            }
        }
        vehicle.0.calls.clear();
    }
    #[cfg(feature = "signing")]
    assert!(stack.signing().counters().setups > 100, "keys were set and cleared");
    lines
}

#[test]
fn only_allowed_messages_are_sent_in_a_million_events() {
    let lines = run(1, 1_000_000);
    for link in [1, 3] {
        let line = &lines[link];
        assert_eq!(line.ids, BTreeSet::from([CommandAck::ID, HighLatency2::ID]), "link {link}");
        assert!(line.forwarded > 100, "{} commands of others", line.forwarded);
        assert!(line.frames > 5_000 && line.reports > 500, "{} frames, {} reports", line.frames, line.reports);
    }
    // The normal link carried everything else: heartbeats, streams, pings, parameters, plans, texts, identity, modes, logs.
    for id in [0, 1, 4, 22, 30, 42, 44, 46, 47, 73, 77, 111, 118, 120, 148, 234, 242, 244, 253, 267, 300, 345, 435, 436]
    {
        assert!(lines[0].ids.contains(&id), "message {id} was never sent");
    }
}

/// L-2, Q-1: a firmware that declares HIGH_LATENCY2 as a stream by mistake does not send it on a normal link. A request for it
/// there is refused.
#[test]
fn high_latency_message_is_not_a_stream() {
    #[derive(mavstack::Stack)]
    #[stack(vehicle: Everything, links: 1, streams, commands: { slots: 1 })]
    struct Single {
        high_latency: mavstack::high_latency::HighLatency,
    }
    let mut setup = Setup::<1>::new();
    setup.links = [LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard)];
    let mut world = World::<1, Single>::of(setup);
    world.run_for(secs(1));
    let id = HighLatency2::ID as f32;
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.expect::<CommandAck>(0, secs(1)).result, MavResult::DENIED);
    assert_eq!(world.gcs[0].count_of::<HighLatency2>(), 0);
    assert!(world.gcs[0].count_of::<Attitude>() > 40);
}
