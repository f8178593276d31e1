//! The vehicle with its stack, and peers at the other ends of its links.

use mavstack::dialect::*;
use mavstack::frame::{Decoder, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Duration, Instant, Item, LinkId, Message, StackOf};
use mavstack_demo::{App, COMPANION, LINKS, Mavlink, Quadrotor, TELEMETRY};
use mavstack_station::kit::{self, Clock, Line, LineConfig, Port};

mavstack::message! {
    /// CONTROL_STATUS of MAVLink's `development.xml` (O-5).
    pub struct ControlStatus: CONTROL_STATUS = 512 {
        flags: u8,
        gcs_main: u8,
        gcs_secondary: [u8; 10],
    }
}
mavstack::dialect! {
    /// All that the vehicle sends.
    pub struct Sent: [ControlStatus] + Common;
}

pub const STATION: Address = Address::new(255, 190);
/// The vehicle's own camera and gimbal.
pub const CAMERA: Address = Address::new(1, 100);
pub const GIMBAL: Address = Address::new(1, 154);

/// A message from the vehicle, with its time (ms) and link.
pub struct Received {
    pub millis: u64,
    pub link: LinkId,
    pub source: Address,
    pub id: u32,
    pub raw: Vec<u8>,
    pub payload: Vec<u8>,
}

impl Received {
    /// Decodes the message if it is an `M`.
    pub fn decode<M: Message>(&self) -> Option<M> {
        (self.id == M::ID).then(|| M::decode(&self.payload))
    }
}

/// The vehicle, its lines and the simulated time.
pub struct Wire {
    pub app: App<Box<StackOf<Mavlink>>>,
    pub millis: u64,
    /// The time from one pass of the flight loop to the next (ms).
    pub pass: u64,
    clock: Clock,
    pub lines: [Line; LINKS],
    /// The vehicle's ends of the lines.
    pub uarts: [Port; LINKS],
    /// Number of bytes received on each link.
    pub bytes: [usize; LINKS],
    decoders: [Decoder; LINKS],
    seq: u8,
    pub received: Vec<Received>,
}

impl Wire {
    pub fn new() -> Self {
        let clock = Clock::default();
        let lines = [(); LINKS].map(|()| Line::new(&clock, LineConfig::default(), 1));
        Self {
            app: App::in_fleet(Box::new(StackOf::<Mavlink>::VACANT), kit::pulse(), 1),
            millis: 0,
            pass: 1,
            uarts: lines.each_ref().map(|line| line.ends().0),
            lines,
            clock,
            bytes: [0; LINKS],
            decoders: [(); LINKS].map(|()| Decoder::new(Duration::from_secs(1))),
            seq: 0,
            received: Vec::new(),
        }
    }

    /// Returns a vehicle with a GPS fix, without its camera and its gimbal.
    pub fn alone() -> Self {
        let mut wire = Self::new();
        wire.app.leave_out_components();
        wire.run(2_500);
        wire
    }

    /// Returns a vehicle with a GPS fix.
    pub fn booted() -> Self {
        let mut wire = Self::new();
        wire.run(2_500);
        wire
    }

    /// Returns a vehicle that hovers at 10 m.
    pub fn airborne() -> Self {
        let mut wire = Self::booted();
        assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        assert_eq!(wire.long(MavCmd::NAV_TAKEOFF, &[]), MavResult::ACCEPTED);
        wire.until("up", 20, |vehicle| vehicle.mode() == mavstack_demo::Mode::Hold);
        wire
    }

    /// Runs the flight loop for at least this long.
    pub fn run(&mut self, millis: u64) {
        for _ in 0..millis.div_ceil(self.pass) {
            self.millis += self.pass;
            let now = Instant::from_millis(self.millis);
            self.clock.set(now);
            self.app.control(now);
            for (index, decoder) in self.decoders.iter_mut().enumerate() {
                let link = LinkId(index as u8);
                self.app.serve(now, link, &mut self.uarts[index]).unwrap();
                let bytes = self.lines[index].receive();
                self.bytes[index] += bytes.len();
                let mut rest = &bytes[..];
                while !rest.is_empty() {
                    rest = &rest[decoder.push(rest, now)..];
                    while let Some(frame) = decoder.next(now, Sent::MESSAGES, &mut u32::MAX.clone(), |_| true) {
                        self.received.push(Received {
                            millis: self.millis,
                            link,
                            source: frame.source(),
                            id: frame.id(),
                            raw: frame.raw().to_vec(),
                            payload: frame.payload().to_vec(),
                        });
                    }
                }
            }
        }
    }

    /// Runs until `condition` holds; panics after `seconds`.
    pub fn until(&mut self, what: &str, seconds: u64, condition: impl Fn(&Quadrotor) -> bool) {
        let deadline = self.millis + seconds * 1_000;
        while !condition(self.app.vehicle()) {
            assert!(self.millis < deadline, "not {what} after {seconds} s: {:?}", self.app.vehicle());
            self.run(10);
        }
    }

    pub fn send<M: Message>(&mut self, link: LinkId, message: &M) {
        self.send_as(link, STATION, message);
    }

    /// Sends a message from `source`. Returns the frame.
    pub fn send_as<M: Message>(&mut self, link: LinkId, source: Address, message: &M) -> Vec<u8> {
        let mut frame = [0; 280];
        self.seq = self.seq.wrapping_add(1);
        let len = encode(message, Version::V2, source, self.seq, &mut frame).unwrap();
        self.send_raw(link, &frame[..len]);
        frame[..len].to_vec()
    }

    pub fn send_raw(&mut self, link: LinkId, bytes: &[u8]) {
        self.lines[usize::from(link.0)].send(bytes);
    }

    /// Takes the messages of one type received since the last call, with their times. Heartbeats of the vehicle's camera and gimbal
    /// are left.
    pub fn take<M: Message>(&mut self) -> Vec<(u64, M)> {
        let is_payload = |frame: &Received| [CAMERA, GIMBAL].contains(&frame.source);
        let is_it = |frame: &Received| frame.id == M::ID && !(M::ID == Heartbeat::ID && is_payload(frame));
        let (found, rest) = std::mem::take(&mut self.received).into_iter().partition(is_it);
        self.received = rest;
        let found: Vec<Received> = found;
        found.into_iter().map(|frame| (frame.millis, M::decode(&frame.payload))).collect()
    }

    /// Counts the messages of one type received on a link and not taken yet.
    pub fn count<M: Message>(&self, link: LinkId) -> usize {
        self.received.iter().filter(|frame| frame.link == link && frame.id == M::ID).count()
    }

    /// Takes the texts received since the last call. Waits 20 ms for texts that are on their way.
    pub fn texts(&mut self) -> Vec<String> {
        self.run(20);
        // Every text is sent on all links; keep one of each.
        self.received.retain(|frame| frame.link == TELEMETRY || frame.id != Statustext::ID);
        self.take::<Statustext>().into_iter().map(|(_, text)| text.text.as_str().unwrap().to_owned()).collect()
    }

    /// Sends COMMAND_LONG with NaN for omitted parameters, as MAVSDK does. Returns the result of the first answer.
    pub fn long(&mut self, command: MavCmd, params: &[f32]) -> MavResult {
        self.long_by(TELEMETRY, 1, command, params)
    }

    pub fn long_by(&mut self, link: LinkId, target_system: u8, command: MavCmd, params: &[f32]) -> MavResult {
        self.send(link, &command_long(target_system, command, params));
        self.answer(command).result
    }

    /// Sends COMMAND_INT. Returns the result of the first answer.
    pub fn int(&mut self, command: MavCmd, frame: MavFrame, params: [f32; 4], x: i32, y: i32, z: f32) -> MavResult {
        let [param1, param2, param3, param4] = params;
        let message = CommandInt {
            target_system: 1,
            target_component: 1,
            frame: MavFrame(frame.0),
            command,
            param1,
            param2,
            param3,
            param4,
            x,
            y,
            z,
            ..CommandInt::default()
        };
        self.send(TELEMETRY, &message);
        self.answer(command).result
    }

    pub fn answer(&mut self, command: MavCmd) -> CommandAck {
        self.take::<CommandAck>();
        for _ in 0..200 {
            self.run(1);
            if let Some((_, ack)) = self.take::<CommandAck>().pop() {
                assert_eq!(ack.command, command);
                return ack;
            }
        }
        panic!("no answer to {command:?}");
    }

    /// Uploads a mission on the telemetry link, which is accepted.
    pub fn upload(&mut self, plan: &[Item]) {
        assert_eq!(self.try_upload(plan), MavMissionResult::ACCEPTED);
    }

    /// Uploads a mission on the telemetry link. Returns the answer.
    pub fn try_upload(&mut self, plan: &[Item]) -> MavMissionResult {
        let (target_system, target_component) = (1, 1);
        let count = plan.len() as u16;
        self.send(TELEMETRY, &MissionCount { count, target_system, target_component, ..Default::default() });
        loop {
            self.run(20);
            if let Some((_, ack)) = self.take::<MissionAck>().pop() {
                return ack.r#type;
            }
            let Some((_, MissionRequestInt { seq, .. })) = self.take::<MissionRequestInt>().pop() else { continue };
            let Item { frame, command, autocontinue, params: [param1, param2, param3, param4], x, y, z } =
                plan[usize::from(seq)];
            self.send(
                TELEMETRY,
                &MissionItemInt {
                    seq,
                    frame,
                    command,
                    autocontinue,
                    param1,
                    param2,
                    param3,
                    param4,
                    x,
                    y,
                    z,
                    target_system,
                    target_component,
                    ..Default::default()
                },
            );
        }
    }

    pub fn vehicle(&self) -> &Quadrotor {
        self.app.vehicle()
    }

    pub fn height(&self) -> f32 {
        -self.vehicle().local_position().down
    }
}

pub fn command_long(target_system: u8, command: MavCmd, params: &[f32]) -> CommandLong {
    let mut all = [f32::NAN; 7];
    all[..params.len()].copy_from_slice(params);
    let [param1, param2, param3, param4, param5, param6, param7] = all;
    CommandLong {
        target_system,
        target_component: 1,
        command,
        param1,
        param2,
        param3,
        param4,
        param5,
        param6,
        param7,
        ..CommandLong::default()
    }
}

/// The links that carry streams.
pub const NORMAL: [LinkId; 2] = [TELEMETRY, COMPANION];
