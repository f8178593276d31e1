//! The far end of a line: whoever the test wants there.

use super::{STATION, SerialEnd, VEHICLE};
use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavstack::dialect::{CommandInt, CommandLong, Common, Heartbeat, MavAutopilot, MavCmd, MavState, MavType};
use mavstack::{Address, Decoder, Dialect, Duration, Header, Instant, MAX_FRAME_LEN, Message, Version, encode};
use std::collections::{BTreeMap, VecDeque};

/// A frame as it came down the line.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// When its last byte was read.
    pub at: Instant,
    pub header: Header,
    /// As sent, trailing zeros cut off.
    pub payload: Vec<u8>,
    /// All its bytes.
    pub raw: Vec<u8>,
    taken: bool,
}

impl Received {
    /// The message `M`, if this is one.
    pub fn decode<M: Message>(&self) -> Option<M> {
        (self.header.id == M::ID).then(|| M::decode(&self.payload))
    }
}

/// A ground station, or several behind one line.
#[derive(Debug)]
pub struct Gcs {
    /// What it calls itself: [`STATION`] at first.
    pub address: Address,
    /// Whom it talks to: [`VEHICLE`] at first.
    pub vehicle: Address,
    /// What it sends: MAVLink 2 at first.
    pub version: Version,
    /// Time between its heartbeats; `None`, as at first, sends none.
    pub heartbeat_period: Option<Duration>,
    /// All that it received, in order.
    pub received: Vec<Received>,
    /// Whether it takes frames whose id it does not know; not at first.
    pub takes_unknown: bool,
    /// Its end of the line.
    pub end: SerialEnd,
    decoder: Decoder,
    outgoing: VecDeque<u8>,
    seqs: BTreeMap<Address, u8>,
    heartbeat_due: Instant,
}

impl Gcs {
    pub fn new(end: SerialEnd) -> Self {
        Self {
            address: STATION,
            vehicle: VEHICLE,
            version: Version::V2,
            heartbeat_period: None,
            received: Vec::new(),
            takes_unknown: false,
            end,
            // Ground stations wait for the rest of a frame for as long as it takes.
            decoder: Decoder::new(Duration::from_secs(1 << 30)),
            outgoing: VecDeque::new(),
            seqs: BTreeMap::new(),
            heartbeat_due: Instant::ZERO,
        }
    }

    /// A frame of its own version with the next sequence number of `from`, not sent.
    pub fn frame_from<M: Message>(&mut self, from: Address, message: &M) -> Vec<u8> {
        let seq = self.seqs.entry(from).or_default();
        let mut frame = vec![0; MAX_FRAME_LEN];
        let len = encode(message, self.version, from, *seq, &mut frame).expect("every message fits");
        *seq = seq.wrapping_add(1);
        frame.truncate(len);
        frame
    }

    /// Sends `message`.
    pub fn send<M: Message>(&mut self, message: &M) {
        self.send_from(self.address, message);
    }

    /// Sends `message` as somebody else.
    pub fn send_from<M: Message>(&mut self, from: Address, message: &M) {
        let frame = self.frame_from(from, message);
        self.send_raw(&frame);
    }

    /// Sends bytes as they are.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.outgoing.extend(bytes);
    }

    /// Frames of `from` that are lost on the way before they reach the line.
    pub fn skip_seq(&mut self, from: Address, frames: u8) {
        let seq = self.seqs.entry(from).or_default();
        *seq = seq.wrapping_add(frames);
    }

    /// Sends a COMMAND_LONG to the vehicle.
    pub fn command_long(&mut self, command: MavCmd, params: [f32; 7]) {
        let message = self.long(command, params);
        self.send(&message);
    }

    /// Sends a COMMAND_INT to the vehicle, without a location.
    pub fn command_int(&mut self, command: MavCmd, params: [f32; 4]) {
        let [param1, param2, param3, param4] = params;
        self.send(&CommandInt {
            target_system: self.vehicle.system.0,
            target_component: self.vehicle.component.0,
            command,
            param1,
            param2,
            param3,
            param4,
            ..CommandInt::default()
        });
    }

    /// A COMMAND_LONG to the vehicle, not sent.
    pub fn long(&self, command: MavCmd, params: [f32; 7]) -> CommandLong {
        let [param1, param2, param3, param4, param5, param6, param7] = params;
        CommandLong {
            target_system: self.vehicle.system.0,
            target_component: self.vehicle.component.0,
            command,
            confirmation: 0,
            param1,
            param2,
            param3,
            param4,
            param5,
            param6,
            param7,
        }
    }

    /// A ground station's heartbeat.
    pub fn heartbeat() -> Heartbeat {
        Heartbeat {
            r#type: MavType::GCS,
            autopilot: MavAutopilot::INVALID,
            system_status: MavState::ACTIVE,
            mavlink_version: 3,
            ..Heartbeat::default()
        }
    }

    /// Whether all that was sent is on the line.
    pub fn is_idle(&self) -> bool {
        self.outgoing.is_empty()
    }

    /// The oldest `M` that was not taken yet, and when it came.
    pub fn take<M: Message>(&mut self) -> Option<(Instant, M)> {
        let frame = self.received.iter_mut().find(|frame| !frame.taken && frame.header.id == M::ID)?;
        frame.taken = true;
        Some((frame.at, M::decode(&frame.payload)))
    }

    /// Every `M` that was received, and when.
    pub fn all<M: Message>(&self) -> Vec<(Instant, M)> {
        self.received.iter().filter_map(|frame| Some((frame.at, frame.decode::<M>()?))).collect()
    }

    /// How many `M` were received.
    pub fn count_of<M: Message>(&self) -> usize {
        self.received.iter().filter(|frame| frame.header.id == M::ID).count()
    }

    /// Forgets what was received.
    pub fn forget(&mut self) {
        self.received.clear();
    }

    /// Reads and writes what the line is ready for.
    pub fn poll(&mut self, now: Instant) {
        if let Some(period) = self.heartbeat_period
            && now >= self.heartbeat_due
        {
            self.heartbeat_due = now.after(period);
            self.send(&Self::heartbeat());
        }
        while !self.outgoing.is_empty() && self.end.write_ready() == Ok(true) {
            let (front, _) = self.outgoing.as_slices();
            let written = self.end.write(front).unwrap_or(front.len());
            self.outgoing.drain(..written);
        }
        while self.end.read_ready() == Ok(true) {
            match self.end.read(self.decoder.spare()) {
                Ok(0) => break,
                Ok(len) => self.decoder.commit(len, now),
                Err(_) => continue,
            }
            self.decode(now);
        }
        self.decode(now);
    }

    fn decode(&mut self, now: Instant) {
        let takes_unknown = self.takes_unknown;
        while let Some(frame) = self.decoder.next(now, Common::MESSAGES, &mut u32::MAX.clone(), |_| takes_unknown) {
            let (payload, raw) = (frame.payload().to_vec(), frame.raw().to_vec());
            self.received.push(Received { at: now, header: *frame.header(), payload, raw, taken: false });
        }
    }

    /// Bytes and candidates that were no frames, as this end saw them.
    pub fn counters(&self) -> mavstack::RxCounters {
        self.decoder.counters()
    }
}
