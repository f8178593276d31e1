//! Random traffic for the vehicle: frames of its peers, calls of the firmware, and the times at which it wakes.

use crate::StackOf;
use std::boxed::Box;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::stack::Memory;

/// A frame that peers may send.
pub(in super::super) struct Request {
    /// The message, or the command in it.
    pub(in super::super) name: &'static str,
    make: Box<dyn Fn(Version, Address, u8) -> Vec<u8>>,
}

impl Request {
    /// Makes a frame of this version, if it can carry the message, from this sender with this sequence number.
    pub(in super::super) fn frame(&self, version: Version, from: Address, seq: u8) -> Vec<u8> {
        (self.make)(version, from, seq)
    }
}

pub(in super::super) fn of<M: Message + 'static>(message: M) -> Request {
    let make = move |version, from, seq| {
        let mut frame = [0; 280];
        let len = encode(&message, version, from, seq, &mut frame);
        let len = len.or_else(|_| encode(&message, Version::V2, from, seq, &mut frame)).expect("a frame");
        frame[..len].to_vec()
    };
    Request { name: M::NAME, make: Box::new(make) }
}

/// The names of these values of a type.
macro_rules! names {
    ($value:expr, $type:ident: $($name:ident)*) => {
        match $value { $($type::$name => stringify!($name),)* $type(other) => panic!("no name for {other}") }
    };
}

fn name_of(command: MavCmd) -> &'static str {
    const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);
    if command == REQUEST_OPERATOR_CONTROL {
        return "REQUEST_OPERATOR_CONTROL";
    }
    names!(command, MavCmd: REQUEST_MESSAGE GET_MESSAGE_INTERVAL SET_MESSAGE_INTERVAL RUN_PREARM_CHECKS PREFLIGHT_CALIBRATION
        DO_MOTOR_TEST DO_REPEAT_SERVO PREFLIGHT_STORAGE CONTROL_HIGH_LATENCY DO_SET_MODE DO_SET_MISSION_CURRENT MISSION_START
        LOGGING_START LOGGING_STOP NAV_LAND DO_SET_ROI_NONE DO_GIMBAL_MANAGER_CONFIGURE IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE
        VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE STORAGE_FORMAT REQUEST_CAMERA_IMAGE_CAPTURE DO_SET_HOME)
}

pub(in super::super) fn command(command: MavCmd, params: [f32; 3]) -> Request {
    let [param1, param2, param3] = params;
    let message =
        CommandLong { param1, param2, param3, command, target_system: 1, target_component: 1, ..Default::default() };
    Request { name: name_of(command), ..of(message) }
}

pub(in super::super) fn file_request(session: u8, opcode: MavFtpOpcode, path: &str) -> Request {
    let mut payload = [0; 251];
    payload[2] = session;
    payload[3] = opcode.0;
    payload[4] = u8::try_from(path.len()).expect("a short path");
    payload[12..12 + path.len()].copy_from_slice(path.as_bytes());
    let message = FileTransferProtocol { payload, target_network: 0, target_system: 1, target_component: 1 };
    let name = names!(opcode, MavFtpOpcode: OPENFILERO CREATEFILE READFILE BURSTREADFILE WRITEFILE LISTDIRECTORY CALCFILECRC
        TERMINATESESSION RESETSESSION);
    Request { name, ..of(message) }
}

/// Frames that peers may send.
pub(in super::super) fn requests() -> Vec<Request> {
    let (target_system, target_component) = (1, 1);
    let mut pool = Vec::new();
    let station = Heartbeat { r#type: MavType::GCS, autopilot: MavAutopilot::INVALID, ..Default::default() };
    // Peers are alive most of the time.
    for _ in 0..4 {
        pool.push(of(station));
    }
    pool.push(of(Heartbeat { r#type: MavType::QUADROTOR, ..station }));

    for id in [
        Heartbeat::ID,
        AutopilotVersion::ID,
        ProtocolVersion::ID,
        Attitude::ID,
        BatteryStatus::ID,
        AvailableModes::ID,
        CurrentMode::ID,
        AvailableModesMonitor::ID,
        MissionCurrent::ID,
        MessageInterval::ID,
        HighLatency2::ID,
        Tunnel::ID,
        CameraInformation::ID,
        CameraSettings::ID,
        StorageInformation::ID,
        CameraCaptureStatus::ID,
        CameraImageCaptured::ID,
        VideoStreamInformation::ID,
        VideoStreamStatus::ID,
        GimbalManagerInformation::ID,
        GimbalManagerStatus::ID,
        GimbalDeviceInformation::ID,
        GimbalDeviceAttitudeStatus::ID,
    ] {
        pool.push(command(MavCmd::REQUEST_MESSAGE, [id as f32, 0.0, 0.0]));
        pool.push(command(MavCmd::GET_MESSAGE_INTERVAL, [id as f32, 0.0, 0.0]));
    }
    pool.push(command(MavCmd::REQUEST_MESSAGE, [BatteryStatus::ID as f32, 1.0, 0.0]));
    for id in [Attitude::ID, SysStatus::ID, VfrHud::ID, GimbalManagerStatus::ID, GimbalDeviceAttitudeStatus::ID] {
        for micros in [-1.0, 0.0, 1_000.0, 7_300.0, 300_000.0, 2_500_000.0] {
            pool.push(command(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, micros, 0.0]));
        }
    }
    for (id, params) in [
        (MavCmd::RUN_PREARM_CHECKS, [0.0; 3]),
        (MavCmd::PREFLIGHT_CALIBRATION, [1.0, 0.0, 0.0]),
        (MavCmd::DO_MOTOR_TEST, [1.0, 0.0, 0.0]),
        (MavCmd::DO_REPEAT_SERVO, [1.0, 1_500.0, 1.0]),
        (MavCmd::PREFLIGHT_STORAGE, [2.0, -1.0, 0.0]),
        (MavCmd::CONTROL_HIGH_LATENCY, [0.0; 3]),
        (MavCmd::CONTROL_HIGH_LATENCY, [1.0, 0.0, 0.0]),
        (MavCmd::DO_SET_MODE, [1.0, 2.0, 0.0]),
        (MavCmd::DO_SET_MODE, [1.0, 7.0, 0.0]),
        (MavCmd::DO_SET_MISSION_CURRENT, [0.0; 3]),
        (MavCmd::MISSION_START, [0.0; 3]),
        (MavCmd::LOGGING_START, [0.0; 3]),
        (MavCmd::LOGGING_STOP, [0.0; 3]),
        (MavCmd::NAV_LAND, [0.0; 3]),
        (MavCmd::DO_SET_ROI_NONE, [0.0; 3]),
        (MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, [-3.0, -3.0, 255.0]),
        (MavCmd(32_100), [1.0, 0.0, 10.0]),
        (MavCmd(32_100), [1.0, 1.0, 10.0]),
        (MavCmd(32_100), [0.0; 3]),
        (MavCmd::IMAGE_START_CAPTURE, [0.0, 0.0, 1.0]),
        (MavCmd::IMAGE_START_CAPTURE, [0.0, 0.6, 0.0]),
        (MavCmd::IMAGE_STOP_CAPTURE, [0.0; 3]),
        (MavCmd::VIDEO_START_CAPTURE, [0.0, 3.0, 0.0]),
        (MavCmd::VIDEO_STOP_CAPTURE, [0.0; 3]),
        (MavCmd::STORAGE_FORMAT, [1.0, 0.0, 1.0]),
        (MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE, [1.0, 0.0, 0.0]),
        (MavCmd::SET_MESSAGE_INTERVAL, [CameraCaptureStatus::ID as f32, 150_000.0, 0.0]),
    ] {
        pool.push(command(id, params));
    }
    for (id, param1) in [(MavCmd::REQUEST_MESSAGE, 0.0), (MavCmd::DO_MOTOR_TEST, 1.0), (MavCmd::REQUEST_MESSAGE, 74.0)]
    {
        let (target_component, command) = (154, id);
        let message = CommandLong { param1, command, target_system, target_component, ..Default::default() };
        pool.push(Request { name: name_of(command), ..of(message) });
    }
    for result in [MavResult::ACCEPTED, MavResult::IN_PROGRESS] {
        pool.push(of(CommandAck { command: MavCmd(1), result, target_system, target_component, ..Default::default() }));
    }
    for (opcode, path) in [
        (MavFtpOpcode::OPENFILERO, "a"),
        (MavFtpOpcode::OPENFILERO, "@PARAM/param.pck"),
        (MavFtpOpcode::CREATEFILE, "@PARAM/param.pck"),
        (MavFtpOpcode::OPENFILERO, "b"),
        (MavFtpOpcode::READFILE, ""),
        (MavFtpOpcode::BURSTREADFILE, ""),
        (MavFtpOpcode::WRITEFILE, "x"),
        (MavFtpOpcode::LISTDIRECTORY, "/"),
        (MavFtpOpcode::CALCFILECRC, "a"),
        (MavFtpOpcode::TERMINATESESSION, ""),
        (MavFtpOpcode::RESETSESSION, ""),
    ] {
        pool.extend([0, 1].map(|session| file_request(session, opcode, path)));
    }
    for end in [0, u16::MAX] {
        pool.push(of(LogRequestList { start: 0, end, target_system, target_component }));
    }
    for (id, ofs, count) in [(0, 0, u32::MAX), (1, 90, 90), (1, 200, 90), (2, 0, 90)] {
        pool.push(of(LogRequestData { ofs, count, id, target_system, target_component }));
    }
    for sequence in 0..3 {
        pool.push(of(LoggingAck { sequence, target_system, target_component }));
    }
    pool.push(of(LogRequestEnd { target_system, target_component }));
    pool.push(of(LogErase { target_system, target_component }));
    let param_id = Text::new("TRIM");
    pool.push(of(ParamValue { param_id, ..Default::default() }));
    pool.push(of(ParamExtValue { param_id, ..Default::default() }));
    pool.push(of(ParamExtRequestList { target_system, target_component }));
    for param_type in [MavParamExtType::UINT16, MavParamExtType::UINT8] {
        pool.push(of(ParamExtSet { target_system, target_component, param_id, param_type, ..Default::default() }));
    }
    for param_index in [-1, 1, 9] {
        pool.push(of(ParamExtRequestRead { param_index, target_system, target_component, param_id }));
    }
    pool.push(of(CommandCancel { command: MavCmd::DO_MOTOR_TEST, target_system, target_component }));
    pool.push(of(SetMode { custom_mode: 1, target_system, base_mode: MavModeFlag::CUSTOM_MODE_ENABLED }));

    for (id, param_index) in [("", 0), ("", 9), ("TRIM", -1), ("NONE", -1), ("_HASH_CHECK", -1)] {
        let param_id = Text::new(id);
        pool.push(of(ParamRequestRead { param_index, target_system, target_component, param_id }));
    }
    pool.push(of(ParamRequestList { target_system, target_component }));
    for (id, param_value) in [("CRUISE", 3.0), ("CRUISE", 4.0), ("CRUISE", 99.0), ("STARTS", 1.0), ("_HASH_CHECK", 1.0)]
    {
        let (param_id, param_type) = (Text::new(id), MavParamType::REAL32);
        pool.push(of(ParamSet { param_value, target_system, target_component, param_id, param_type }));
    }

    for mission_type in [MavMissionType::MISSION, MavMissionType::FENCE, MavMissionType(77)] {
        for count in [0, 1, 3, 9] {
            pool.push(of(MissionCount { count, target_system, target_component, mission_type, opaque_id: 0 }));
        }
        pool.push(of(MissionRequestList { target_system, target_component, mission_type }));
        pool.push(of(MissionClearAll { target_system, target_component, mission_type }));
        for seq in [0, 5] {
            pool.push(of(MissionRequestInt { seq, target_system, target_component, mission_type }));
            pool.push(of(MissionRequest { seq, target_system, target_component, mission_type }));
        }
    }
    pool.push(of(MissionAck { target_system, target_component, ..Default::default() }));
    pool.push(of(MissionSetCurrent { seq: 1, target_system, target_component }));

    pool.push(of(PlayTune::default()));
    pool.push(of(Ping { seq: 3, ..Default::default() }));
    pool.push(of(Timesync { ts1: 5, ..Default::default() }));
    pool.push(of(Timesync { ts1: 5, tc1: 9, ..Default::default() }));
    for (start_stop, req_message_rate) in [(0, 0), (1, 10)] {
        let req_stream_id = MavDataStream::ALL;
        let request =
            RequestDataStream { req_message_rate, target_system, target_component, req_stream_id, start_stop };
        pool.push(of(request));
    }
    for (first_sequence, last_sequence) in [(0, 0), (1, 3), (2, 1), (40_000, 2)] {
        pool.push(of(RequestEvent { first_sequence, last_sequence, target_system, target_component }));
    }
    for txbuf in [5, 99] {
        pool.push(of(RadioStatus { txbuf, ..Default::default() }));
    }
    pool.push(of(GimbalDeviceInformation::default()));
    pool.push(of(GimbalManagerSetPitchyaw { target_system, target_component, ..Default::default() }));
    pool.push(of(ManualControl { x: 0, y: 0, z: 500, r: 0, target: 1, ..Default::default() }));
    for flags in [RadioRcChannelsFlags::EMPTY, RadioRcChannelsFlags::FAILSAFE] {
        pool.push(of(RadioRcChannels { flags, target_system, target_component, count: 4, ..Default::default() }));
    }
    for to in [STATION, WINGMAN, Address::new(0, 0)] {
        let (target_system, target_component) = (to.system.wire(), to.component.wire());
        pool.push(of(Tunnel { target_system, target_component, ..Default::default() }));
    }
    pool.push(command(MavCmd::DO_SET_HOME, [1.0, 0.0, 0.0]));
    pool.push(of(CommandLong { target_system: 2, target_component: 1, ..Default::default() }));
    pool.push(of(PlayTune { target_system, target_component, ..Default::default() }));
    for (secret_key, initial_timestamp) in [([7; 32], 1_000), ([0; 32], 0)] {
        let secret_key = Secret(secret_key);
        pool.push(of(SetupSigning { initial_timestamp, target_system, target_component, secret_key }));
    }
    pool
}

#[derive(Clone, Debug)]
pub(in super::super) enum Event {
    /// A link receives a request of the pool.
    Request { link: u8, from: Address, is_v1: bool, number: prop::sample::Index },
    /// A link receives the item that was asked for there last.
    Item { link: u8 },
    /// The firmware does something of itself.
    Firmware { link: u8, what: u8 },
    /// Time passes (µs).
    Wait(u64),
    /// The firmware wakes, and sends all there is to send.
    Wake,
    /// The vehicle gets into a fault, or out of it.
    Fault,
    /// The firmware wakes, and each turn but one may send: the messages of that one stay pending.
    Turns(Option<Turn>),
}

pub(in super::super) fn event() -> impl Strategy<Value = Event> {
    let link = 0..3u8;
    let from = prop_oneof![6 => Just(STATION), 1 => Just(COMPANION), 2 => Just(WINGMAN)];
    let request = (link.clone(), from, any::<bool>(), any::<prop::sample::Index>());
    const TIMES: &[u64] = &[1, 64, 1_000, 20_000, 100_000, 1_000_000, 4_000_000, 31_000_000];
    // Values that the list sends stay pending where the turn of answers is not asked.
    let but_one = TABLE.iter().map(|(turn, ..)| *turn).filter(|turn| *turn != Turn::ParamAnswer);
    let but_one: Vec<_> = but_one.map(Some).collect();
    prop_oneof![
        12 => request.prop_map(|(link, from, is_v1, number)| Event::Request { link, from, is_v1, number }),
        3 => link.clone().prop_map(|link| Event::Item { link }),
        4 => (link, 0..FIRMWARE).prop_map(|(link, what)| Event::Firmware { link, what }),
        4 => prop::sample::select(TIMES).prop_map(Event::Wait),
        4 => (0..200_000u64).prop_map(Event::Wait),
        6 => Just(Event::Wake),
        1 => Just(Event::Fault),
        3 => Just(Event::Turns(None)),
        6 => prop::sample::select(but_one).prop_map(Event::Turns),
    ]
}

/// So many things the firmware may do of itself.
const FIRMWARE: u8 = 30;

pub(in super::super) struct World {
    stack: StackOf<Everything>,
    rover: Rover,
    pulse: &'static Pulse,
    is_standing: bool,
    now: Instant,
    seq: u8,
    pool: Vec<Request>,
    /// The item that each link asked for last.
    asked: [Option<MissionRequestInt>; LINKS],
    /// Turns that sent something.
    pub(super) seen: Vec<Turn>,
    /// The sent frames: link, id and payload.
    sent: Vec<(usize, u32, Vec<u8>)>,
}

impl World {
    pub(in super::super) fn new(streams_wait_for_peer: bool) -> Self {
        let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
        let config =
            Config { streams_wait_for_peer, item_reached_repeats: 2, ..Config::new(Address::new(1, 1), pulse) };
        let onboard = LinkConfig::unlimited().with_streams(StreamProfile::Onboard).with_own_system(true);
        #[cfg(feature = "signing")]
        let onboard = onboard.with_signing(crate::signing::LinkSigning::OPEN.with_provisioning());
        let satellite = LinkConfig::unlimited().with_class(LinkClass::HighLatency);
        let mut stack = StackOf::<Everything>::new(
            config,
            [onboard, LinkConfig::uart(115_200).with_version(TxVersion::Auto), satellite],
        );
        stack.manual_input_mut().set_receivers(&[Peer { address: COMPANION, link: LinkId(0) }]);
        stack.manual_input_mut().set_source(ControlSource::System(STATION.system));
        stack.high_latency.set_config(HighLatencyConfig {
            announce_once: true,
            on_link_loss_after: Some(Duration::from_secs(5)),
            ..HighLatencyConfig::DEFAULT
        });
        let state = VehicleState {
            base_mode: MavModeFlag::CUSTOM_MODE_ENABLED,
            custom_mode: 1,
            system_status: MavState::STANDBY,
        };
        Self {
            stack,
            rover: Rover::new(state),
            pulse,
            is_standing: false,
            now: Instant::from_millis(10),
            seq: 0,
            pool: requests(),
            asked: [const { None }; LINKS],
            seen: Vec::new(),
            sent: Vec::new(),
        }
    }

    fn receive(&mut self, link: u8, frame: &[u8]) {
        let mut rest = frame;
        while !rest.is_empty() {
            let taken = self.stack.receive(self.now, LinkId(link), rest, &mut self.rover);
            assert!(taken > 0);
            rest = &rest[taken..];
        }
        self.seq = self.seq.wrapping_add(1);
    }

    pub(in super::super) fn on(&mut self, event: &Event) {
        match event {
            Event::Request { link, from, is_v1, number } => {
                let version = if *is_v1 { Version::V1 } else { Version::V2 };
                let frame = number.get(&self.pool).frame(version, *from, self.seq);
                self.receive(*link, &frame);
            }
            Event::Item { link } => {
                let Some(MissionRequestInt { seq, mission_type, .. }) = self.asked[usize::from(*link)].take() else {
                    return;
                };
                let frame = MavFrame::GLOBAL_RELATIVE_ALT;
                let command = if seq == 2 { MavCmd::NAV_LAND } else { MavCmd::NAV_WAYPOINT };
                let (target_system, target_component) = (1, 1);
                let item = MissionItemInt { seq, command, frame, target_system, target_component, ..waypoint() };
                let item = of(MissionItemInt { mission_type, ..item }).frame(Version::V2, STATION, self.seq);
                self.receive(*link, &item);
            }
            Event::Firmware { link, what } => self.act(*link, *what),
            Event::Wait(micros) => self.now += Duration::from_micros(*micros),
            Event::Wake => self.wake(),
            Event::Fault => {
                self.rover.state = if self.rover.state.is_some() { None } else { Some(VehicleState::ZERO) };
            }
            Event::Turns(skipped) => self.turns(*skipped),
        }
    }

    /// A call that the firmware makes by itself.
    fn act(&mut self, link: u8, what: u8) {
        let (now, stack) = (self.now, &mut self.stack);
        match what {
            0 if link == 0 => stack.text(now, MavSeverity::CRITICAL, "Engine failed"),
            0 => stack.text(now, MavSeverity::INFO, "Gear down"),
            1 => stack.text(now, MavSeverity::NOTICE, &[b'x'; 70][..]),
            2 => stack.announce::<BatteryStatus>(),
            3 => stack.with_context(now, |cx| cx.announce::<VfrHud, Rover>()),
            4 => stack.time.ask(LinkId(link)),
            5 => stack.long_commands_mut().progress(MavCmd::DO_MOTOR_TEST, self.seq % 100),
            6 => {
                stack.long_commands_mut().finish(MavCmd::DO_MOTOR_TEST, MavResult::ACCEPTED);
            }
            7 => {
                stack.long_commands_mut().finish(MavCmd::PREFLIGHT_CALIBRATION, MavResult::FAILED);
            }
            8 => {
                stack.parameters_mut().set(Tuning::TRIM, link.cast_signed());
            }
            9 => {
                stack.with_context(now, |cx| cx.mission_item_reached(1));
            }
            10 => stack.mission_item_reached(now, 2),
            11 => {
                let state = VehicleState { custom_mode: u32::from(link), ..VehicleState::ZERO };
                self.rover.state = self.rover.state.map(|_| state);
            }
            12 => self.is_standing = !self.is_standing,
            13 => stack.high_latency.start(),
            14 => stack.high_latency.sample(now, &HighLatencySample::UNKNOWN),
            15 => stack.restart_link(LinkId(link)),
            16 => {
                let _ = stack.send::<BatteryStatus>(LinkId(link), u16::from(self.seq % 16));
            }
            18 => {
                let _ = stack.send_command(STATION, u16::from(self.seq % 4));
            }
            20 => {
                let _ = match link {
                    0 => stack.read_param(COMPANION, u16::from(self.seq)),
                    _ => stack.read_ext_param(Peer { address: STATION, link: LinkId(link) }, u16::from(self.seq % 2)),
                };
            }
            19 => {
                let _ = stack.with_context(now, |cx| cx.cancel_sent_command(u16::from(link)));
            }
            17 => {
                let peer = Peer { address: STATION, link: LinkId(link) };
                let _ = stack.with_context(now, |cx| cx.send::<Attitude>(peer, 0));
            }
            22 => {
                stack.camera.take_image();
            }
            23 => stack.camera.image_captured(Image::at(now)),
            24 => stack.camera.settings_changed(),
            26 => stack.event(now, &Turned { angle: 0.5 }),
            27 => stack.with_context(now, |cx| (0..12).for_each(|_| cx.event(&Turned { angle: 0.5 }))),
            28 => self.rover.current = u16::from(link) * 4,
            29 => {
                self.rover.is_slow = !self.rover.is_slow;
                for (opcode, path) in
                    [(MavFtpOpcode::OPENFILERO, "@MAV_LOG/log_0.ulg"), (MavFtpOpcode::BURSTREADFILE, "")]
                {
                    let frame = file_request(0, opcode, path).frame(Version::V2, STATION, self.seq);
                    self.receive(link, &frame);
                }
            }
            25 => stack.ext_parameters.finish(u16::from(link), ParamAck::ACCEPTED),
            _ => {
                self.rover.current = u16::from(link);
                let items = [Item::from_int(&waypoint()); 2];
                let _ = stack.load_plan(now, PlanType::Mission, items, &mut self.rover);
            }
        }
    }

    /// Takes the frames that were sent since the last time, in an order of its own.
    pub(in super::super) fn sent(&mut self) -> Vec<(usize, u32, Vec<u8>)> {
        let mut sent = core::mem::take(&mut self.sent);
        sent.sort();
        sent
    }

    pub(in super::super) fn poll(&mut self) {
        if !self.is_standing {
            self.pulse.tick();
        }
        self.stack.poll(self.now, &mut self.rover);
    }

    /// Takes a frame out of an outbox, but not out of the link's byte budget: there is always room.
    fn take(&mut self, link: usize) -> bool {
        let outbox = &mut self.stack.links[link].port.outbox;
        let frame = outbox.pending().to_vec();
        outbox.advance(frame.len());
        let (id, payload) = match *frame {
            [0xFD, _, _, _, _, _, _, a, b, c, ..] => (u32::from_le_bytes([a, b, c, 0]), &frame[10..frame.len() - 2]),
            [0xFE, _, _, _, _, id, ..] => (u32::from(id), &frame[6..frame.len() - 2]),
            _ => return false,
        };
        self.sent.push((link, id, payload.to_vec()));
        if id == MissionRequestInt::ID || id == MissionRequest::ID {
            self.asked[link] = Some(MissionRequestInt::decode(payload));
        }
        true
    }

    /// The number of forwarded frames that waited for too long. A frame is found to be too old when its turn comes.
    fn stale(&self) -> u32 {
        (0..3).filter_map(|link| self.stack.forward_counters(LinkId(link))).map(|counters| counters.stale).sum()
    }

    /// The same, the number of reads of logs that had no data yet, and the links that wait for a heartbeat.
    fn dropped_or_later(&self) -> (u32, u32, usize) {
        let ports = self.stack.links.iter().map(|link| &link.port);
        let held = ports.filter(|port| self.stack.shared.holds(port)).count();
        (self.stale(), self.rover.later, held)
    }

    /// Whether hooks have requested something that the next poll takes up.
    fn has_requests(&self) -> bool {
        self.stack.requests.view().is_due()
    }

    /// Wakes and sends as long as there is something to send.
    pub(in super::super) fn wake(&mut self) {
        self.poll();
        // Work that takes several polls is due, and sends nothing.
        while self.stack.services.files.is_working()
            || self.stack.services.param.is_working()
            || self.stack.shared.pending_resets > 0
            || self.has_requests()
        {
            self.poll();
        }
        for _ in 0..1_000 {
            let (is_due, stale) = (self.stack.next_deadline(self.now) <= self.now, self.dropped_or_later());
            let mut is_sent = false;
            for link in 0..LINKS {
                let id = LinkId(u8::try_from(link).expect("a link"));
                self.stack.transmit(self.now, id, &mut self.rover);
                is_sent |= self.take(link);
            }
            let is_stale = self.dropped_or_later() != stale;
            assert_eq!(is_due, is_sent || is_stale, "a frame is due, and one is sent");
            if !is_due {
                return;
            }
        }
        panic!("it never stops sending");
    }

    /// The same, and looks at each turn but `skipped`.
    pub(super) fn turns(&mut self, skipped: Option<Turn>) {
        self.poll();
        for link in 0..LINKS {
            let mut count = 0;
            while self.turn(link, skipped) {
                count += 1;
                assert!(count < 1_000, "it never stops sending");
            }
        }
    }

    /// Asks the turns of a link in their order.
    fn turn(&mut self, link: usize, skipped: Option<Turn>) -> bool {
        let (stale, later, _) = self.dropped_or_later();
        let mut wrong = Vec::new();
        let is_sent = self.stack.ask(self.now, link, skipped, &mut self.rover, &mut |turn, due, is_sent| {
            if (due <= self.now) != is_sent {
                wrong.push((turn, due, is_sent));
            }
            if is_sent && !self.seen.contains(&turn) {
                self.seen.push(turn);
            }
        });
        if self.stale() != stale {
            wrong.retain(|(turn, ..)| !matches!(turn, Turn::Forwarded | Turn::ForwardedFirst));
        }
        if self.rover.later != later {
            wrong.retain(|(turn, ..)| !matches!(turn, Turn::Bulk | Turn::LateBulk));
        }
        assert!(wrong.is_empty(), "link {link} at {:?}: {wrong:?}", self.now);
        assert_eq!(self.take(link), is_sent);
        is_sent
    }
}

pub(in super::super) fn waypoint() -> MissionItemInt {
    MissionItemInt {
        command: MavCmd::NAV_WAYPOINT,
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        x: 470_000_000,
        y: 80_000_000,
        z: 20.0,
        autocontinue: 1,
        ..Default::default()
    }
}
