//! Generates input: normal traffic, floods, and worst-case byte sequences.

use mavstack::dialect::{
    CommandLong, EncapsulatedData, Heartbeat, MavCmd, MavFrame, MavMissionType, MissionCount, MissionItemInt,
    MissionRequestInt, MissionRequestList, ParamRequestList, ParamRequestRead, ParamSet, Ping, RequestDataStream,
    SystemTime, Timesync,
};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode, encode_signed};
use mavstack::signing::SigningKey;
use mavstack::{Address, Message, Text};

pub const KEY: [u8; 32] = *b"a key for figures, nothing else!";
/// The first signature timestamp.
pub const SIGNED_AT: u64 = 37_000_000_000_000;

/// A kind of input.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Nothing,
    /// A ground station's heartbeat every 200 polls.
    Heartbeats,
    /// The same command from one ground station: two in 90 bytes.
    Commands,
    /// Commands that differ in id, sender and sequence number.
    CommandFlood,
    CountFlood,
    ListFlood,
    ParamListFlood,
    /// An existing parameter and an unknown one, in turn.
    ParamSetFlood,
    /// Unknown names.
    ParamMiss,
    ParamHash,
    ItemFlood,
    /// Complete uploads of different plans.
    Upload,
    /// Complete uploads of fences with one polygon.
    FenceUpload,
    /// Requests for items in random order.
    SeqJumps,
    TimeFlood,
    StreamRequests,
    /// Requests for every stream at the maximum rate.
    AllStreams,
    /// Heartbeats from many senders.
    Crowd,
    /// Broadcasts of the maximum length.
    Largest,
    /// Frames with unknown ids.
    Unknown,
    /// One byte, repeated.
    Byte(u8),
    /// The start of a large MAVLink 1 frame with an unknown id at every other byte.
    Unknown1,
    /// Nested headers of large frames.
    Headers,
    /// Nested headers of large frames, as dense as possible.
    DenseHeaders,
    /// A frame of the maximum length with a wrong checksum, full of start bytes. When the checksum fails, the decoder checks all
    /// of them in one call.
    Nest(u8),
    /// As `Nest`, full of complete frames with a wrong checksum.
    FrameNest,
    /// As `Nest`, full of headers that claim a signature, with unknown ids.
    SignedNest,
    Noise,
    /// Signed heartbeats.
    Signed(Forgery),
    LargestSigned,
}

/// A fault of a signed frame.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Forgery {
    None,
    /// Signed with another key.
    BadKey,
    /// Sent before.
    Replayed,
    /// A new sender each time.
    NewStreams,
    /// Correctly signed, but with an unknown message id.
    UnknownId,
}

/// Generates the bytes of a kind of input.
pub struct Sender {
    kind: Kind,
    frame: [u8; 300],
    len: usize,
    at: usize,
    /// Number of frames so far.
    number: u32,
    random: u32,
}

/// Items of an upload.
const ITEMS: u32 = 250;
const VERTICES: u32 = 64;

const GCS: Address = Address::new(255, 190);

impl Sender {
    pub const fn new(kind: Kind) -> Self {
        Self { kind, frame: [0; 300], len: 0, at: 0, number: 0, random: 0x2545_F491 }
    }

    /// Returns the next byte, or `None` during a pause.
    pub fn next(&mut self) -> Option<u8> {
        if self.at == self.len {
            self.refill();
        }
        let byte = self.frame[..self.len].get(self.at).copied();
        self.at += 1;
        byte
    }

    /// Whether it sends nothing in this poll.
    pub fn is_quiet(&self, poll: u32) -> bool {
        match self.kind {
            Kind::Nothing => true,
            Kind::Heartbeats => !poll.is_multiple_of(200),
            Kind::AllStreams => poll > 100,
            _ => false,
        }
    }

    /// Whether it sends at most one frame per poll.
    pub fn sends_single_frames(&self) -> bool {
        matches!(self.kind, Kind::Heartbeats | Kind::AllStreams)
    }

    /// Whether the current frame was sent completely.
    pub fn is_between_frames(&self) -> bool {
        self.at == self.len
    }

    fn random(&mut self) -> u32 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 17;
        self.random ^= self.random << 5;
        self.random
    }

    fn put<M: Message>(&mut self, message: &M, from: Address, seq: u8) {
        self.len = encode(message, Version::V2, from, seq, &mut self.frame).unwrap_or(0);
    }

    fn put_signed<M: Message>(&mut self, message: &M, from: Address, key: [u8; 32], number: u32) {
        let (key, time) = (SigningKey::new(key), SIGNED_AT + u64::from(number));
        self.len = encode_signed(message, from, number as u8, &key, 0, time, &mut self.frame).unwrap_or(0);
    }

    /// Generates the next frame or piece of noise.
    fn refill(&mut self) {
        (self.at, self.len) = (0, 0);
        self.number = self.number.wrapping_add(1);
        let n = self.number;
        let some = self.random();
        let [byte, other, ..] = some.to_le_bytes();
        let crowd = Address::new(2 + byte % 250, 1 + other % 200);
        let (target_system, target_component) = (1, 1);
        let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
        match self.kind {
            Kind::Nothing | Kind::Heartbeats => self.put(&heartbeat, GCS, n as u8),
            Kind::Commands => self.command(MavCmd::REQUEST_PROTOCOL_VERSION, [1.0; 2], GCS, n as u8),
            Kind::CommandFlood => {
                const COMMANDS: [MavCmd; 6] = [
                    MavCmd::COMPONENT_ARM_DISARM,
                    MavCmd::REQUEST_MESSAGE,
                    MavCmd::SET_MESSAGE_INTERVAL,
                    MavCmd::NAV_TAKEOFF,
                    MavCmd::DO_SET_MODE,
                    MavCmd::DO_SET_HOME,
                ];
                let command = COMMANDS.get(n as usize % 7).copied().unwrap_or(MavCmd(byte.into()));
                self.command(command, [f32::from(byte), 1.0], crowd, byte);
            }
            Kind::CountFlood => {
                let count = 1 + some as u16 % 250;
                let message = MissionCount { count, target_system, target_component, ..Default::default() };
                self.put(&message, if n.is_multiple_of(2) { GCS } else { crowd }, byte);
            }
            Kind::ListFlood => {
                self.put(&MissionRequestList { target_system, target_component, ..Default::default() }, crowd, byte);
            }
            Kind::ParamListFlood => self.put(&ParamRequestList { target_system, target_component }, crowd, byte),
            Kind::ParamSetFlood => {
                let param_id = Text::new(if n.is_multiple_of(2) { "MAV_HL_LOSS_T" } else { "ZZZ_NOT_THERE_ZZ" });
                let param_value = f32::from(byte);
                let set = ParamSet { param_id, param_value, target_system, target_component, ..Default::default() };
                self.put(&set, crowd, byte);
            }
            Kind::ParamMiss => {
                // Names that differ from existing ones in the last character only.
                let names = ["SIM_HANH", "MAV_SYS_IE", "ZZZ_NOT_THERE_ZZ", "MAV_HL_LOSS_TT"];
                let param_id = Text::new(names[n as usize % 4]);
                let read = ParamRequestRead { param_index: -1, target_system, target_component, param_id };
                self.put(&read, crowd, byte);
            }
            Kind::ParamHash => {
                let param_id = Text::new("_HASH_CHECK");
                let read = ParamRequestRead { param_index: -1, target_system, target_component, param_id };
                self.put(&read, crowd, byte);
            }
            Kind::ItemFlood => self.item(byte.into(), n),
            Kind::Upload | Kind::FenceUpload => self.upload(n),
            Kind::SeqJumps => {
                let seq = if n.is_multiple_of(2) { byte.into() } else { 249 - u16::from(byte) % 250 };
                if n.is_multiple_of(16) {
                    let list = MissionRequestList { target_system, target_component, ..Default::default() };
                    self.put(&list, GCS, n as u8);
                } else {
                    let item = MissionRequestInt { seq, target_system, target_component, ..Default::default() };
                    self.put(&item, GCS, n as u8);
                }
            }
            Kind::TimeFlood => match n % 3 {
                0 => self.put(&Timesync { ts1: i64::from(some), ..Default::default() }, crowd, byte),
                1 => self.put(&Ping { time_usec: some.into(), seq: n, ..Default::default() }, crowd, byte),
                // A random boot time: every sender seems to have rebooted.
                _ => self.put(&SystemTime { time_unix_usec: 1 << 50, time_boot_ms: some }, crowd, byte),
            },
            Kind::StreamRequests => {
                let request = RequestDataStream {
                    req_message_rate: 50,
                    target_system,
                    target_component,
                    start_stop: u8::from(!n.is_multiple_of(3)),
                    ..Default::default()
                };
                self.put(&request, GCS, n as u8);
            }
            Kind::AllStreams => {
                let ids =
                    [0, 1, 2, 24, 27, 30, 31, 32, 33, 36, 62, 74, 83, 84, 85, 87, 105, 141, 147, 230, 241, 242, 245];
                let id = ids[n as usize % ids.len()];
                self.command(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 1_000.0], GCS, n as u8);
            }
            Kind::Crowd => self.put(&heartbeat, crowd, byte),
            Kind::Largest => self.put(&EncapsulatedData { seqnr: n as u16, data: [byte | 1; 253] }, crowd, byte),
            Kind::Unknown => {
                self.put(&heartbeat, crowd, byte);
                self.frame[7..10].copy_from_slice(&[byte, other, 0x70]);
            }
            Kind::Byte(byte) => self.repeat(&[byte], 280),
            Kind::Unknown1 => self.repeat(&[0xFE, 0xFF], 280),
            Kind::Headers => self.repeat(&[0xFD, 255, 0, 0, 7, 255, 190, 131, 0, 0], 280),
            Kind::DenseHeaders => self.repeat(&[0xFD, 0xFD, 0, 0, 0, 0, 0xFD, 131, 0, 0], 280),
            Kind::Nest(byte) => self.nest(&[byte]),
            Kind::FrameNest => self.nest(&[0xFE, 9, 0, 255, 190, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]),
            Kind::SignedNest => self.nest(&[0xFD, 1, 1, 0, 7, 255, 190, 0, 0, 0x70]),
            Kind::Noise => {
                for at in 0..280 {
                    self.frame[at] = self.random() as u8;
                }
                self.len = 280;
            }
            Kind::Signed(forgery) => match forgery {
                Forgery::None => self.put_signed(&heartbeat, GCS, KEY, n),
                Forgery::BadKey => self.put_signed(&heartbeat, GCS, [7; 32], n),
                Forgery::Replayed => self.put_signed(&heartbeat, GCS, KEY, 1),
                Forgery::NewStreams => self.put_signed(&heartbeat, crowd, KEY, n),
                Forgery::UnknownId => {
                    self.put_signed(&heartbeat, GCS, KEY, n);
                    self.frame[9] = 0x70;
                }
            },
            Kind::LargestSigned => {
                let data = EncapsulatedData { seqnr: n as u16, data: [byte | 1; 253] };
                self.put_signed(&data, GCS, KEY, n);
            }
        }
    }

    fn command(&mut self, command: MavCmd, [param1, param2]: [f32; 2], from: Address, seq: u8) {
        let (target_system, target_component) = (1, 1);
        let params = CommandLong { param1, param2, param7: 1.0, ..Default::default() };
        self.put(&CommandLong { target_system, target_component, command, ..params }, from, seq);
    }

    fn item(&mut self, seq: u16, n: u32) {
        let item = MissionItemInt {
            seq,
            command: MavCmd::NAV_WAYPOINT,
            frame: MavFrame::GLOBAL_RELATIVE_ALT,
            x: 1 + n as i32,
            y: 2,
            z: 20.0,
            autocontinue: 1,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        };
        self.put(&item, GCS, n as u8);
    }

    /// Sends MISSION_COUNT, then the items in order, without waiting for requests.
    fn upload(&mut self, n: u32) {
        let is_fence = self.kind == Kind::FenceUpload;
        let (items, mission_type) =
            if is_fence { (VERTICES, MavMissionType::FENCE) } else { (ITEMS, MavMissionType::MISSION) };
        let seq = (n - 1) % (items + 1);
        if seq == 0 {
            let count = MissionCount {
                count: items as u16,
                target_system: 1,
                target_component: 1,
                mission_type,
                ..Default::default()
            };
            return self.put(&count, GCS, n as u8);
        }
        if !is_fence {
            return self.item(seq as u16 - 1, n);
        }
        let item = MissionItemInt {
            param1: VERTICES as f32,
            seq: seq as u16 - 1,
            command: MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            x: (seq * seq) as i32,
            y: (n % 1_000) as i32,
            target_system: 1,
            target_component: 1,
            mission_type,
            ..Default::default()
        };
        self.put(&item, GCS, n as u8);
    }

    fn repeat(&mut self, piece: &[u8], len: usize) {
        for (byte, piece) in self.frame[..len].iter_mut().zip(piece.iter().cycle()) {
            *byte = *piece;
        }
        self.len = len;
    }

    /// A frame of the maximum length with a wrong checksum, filled with `piece`.
    fn nest(&mut self, piece: &[u8]) {
        self.repeat(piece, MAX_FRAME_LEN - 13);
        // ENCAPSULATED_DATA.
        self.frame[..10].copy_from_slice(&[0xFD, 255, 0, 0, 7, 255, 190, 131, 0, 0]);
    }
}
