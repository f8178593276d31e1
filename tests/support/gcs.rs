//! A simulated client at the far end of a line.

use super::{Port, STATION, VEHICLE};
use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavstack::dialect::{CommandInt, CommandLong, Common, Heartbeat, MavAutopilot, MavCmd, MavState, MavType};
use mavstack::frame::{Decoder, Header, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Duration, Instant, Message};
use std::collections::{BTreeMap, VecDeque};

/// A frame received from the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// When the last byte was read.
    pub at: Instant,
    pub header: Header,
    /// The payload as sent, without trailing zeros.
    pub payload: Vec<u8>,
    /// All bytes of the frame.
    pub raw: Vec<u8>,
    taken: bool,
}

impl Received {
    /// Decodes the message if it is an `M`.
    pub fn decode<M: Message>(&self) -> Option<M> {
        (self.header.id == M::ID).then(|| M::decode(&self.payload))
    }
}

/// One or more ground stations on a line.
#[derive(Debug)]
pub struct Gcs {
    /// Its own address; [`STATION`] by default.
    pub address: Address,
    /// The address of the vehicle; [`VEHICLE`] by default.
    pub vehicle: Address,
    /// The MAVLink version that it sends; 2 by default.
    pub version: Version,
    /// Interval of its heartbeats; `None` (the default) sends none.
    pub heartbeat_period: Option<Duration>,
    /// All frames received, in order.
    pub received: Vec<Received>,
    /// Whether it accepts frames with an unknown id; false by default.
    pub takes_unknown: bool,
    /// Its end of the line.
    pub end: Port,
    decoder: Decoder,
    outgoing: VecDeque<u8>,
    seqs: BTreeMap<Address, u8>,
    heartbeat_due: Instant,
}

impl Gcs {
    pub fn new(end: Port) -> Self {
        Self {
            address: STATION,
            vehicle: VEHICLE,
            version: Version::V2,
            heartbeat_period: None,
            received: Vec::new(),
            takes_unknown: false,
            end,
            // Ground stations wait for the rest of a frame without a timeout.
            decoder: Decoder::new(Duration::from_secs(1 << 30)),
            outgoing: VecDeque::new(),
            seqs: BTreeMap::new(),
            heartbeat_due: Instant::ZERO,
        }
    }

    /// Encodes a message with the next sequence number of `from`, without sending it.
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

    /// Sends `message` from another address.
    pub fn send_from<M: Message>(&mut self, from: Address, message: &M) {
        let frame = self.frame_from(from, message);
        self.send_raw(&frame);
    }

    /// Sends raw bytes.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.outgoing.extend(bytes);
    }

    /// Skips sequence numbers of `from`, as if frames were lost on the way.
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
            target_system: self.vehicle.system.wire(),
            target_component: self.vehicle.component.wire(),
            command,
            param1,
            param2,
            param3,
            param4,
            ..CommandInt::default()
        });
    }

    /// Returns a COMMAND_LONG to the vehicle, without sending it.
    pub fn long(&self, command: MavCmd, params: [f32; 7]) -> CommandLong {
        let [param1, param2, param3, param4, param5, param6, param7] = params;
        CommandLong {
            target_system: self.vehicle.system.wire(),
            target_component: self.vehicle.component.wire(),
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

    /// Returns the heartbeat of a ground station.
    pub fn heartbeat() -> Heartbeat {
        Heartbeat {
            r#type: MavType::GCS,
            autopilot: MavAutopilot::INVALID,
            system_status: MavState::ACTIVE,
            mavlink_version: 3,
            ..Heartbeat::default()
        }
    }

    /// Whether all bytes to send were written to the line.
    pub fn is_idle(&self) -> bool {
        self.outgoing.is_empty()
    }

    /// Takes the oldest `M` that was not taken before, with its time.
    pub fn take<M: Message>(&mut self) -> Option<(Instant, M)> {
        let frame = self.received.iter_mut().find(|frame| !frame.taken && frame.header.id == M::ID)?;
        frame.taken = true;
        Some((frame.at, M::decode(&frame.payload)))
    }

    /// Returns every `M` received, with its time.
    pub fn all<M: Message>(&self) -> Vec<(Instant, M)> {
        self.received.iter().filter_map(|frame| Some((frame.at, frame.decode::<M>()?))).collect()
    }

    /// Returns the number of `M` received.
    pub fn count_of<M: Message>(&self) -> usize {
        self.received.iter().filter(|frame| frame.header.id == M::ID).count()
    }

    /// Discards all received frames.
    pub fn forget(&mut self) {
        self.received.clear();
    }

    /// Reads and writes as far as the line is ready.
    pub fn poll(&mut self, now: Instant) {
        if let Some(period) = self.heartbeat_period
            && now >= self.heartbeat_due
        {
            self.heartbeat_due = now + period;
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
                Ok(len) => self.decoder.filled(len, now),
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

    /// Returns the counters of this end's decoder.
    pub fn counters(&self) -> mavstack::frame::RxCounters {
        self.decoder.counters()
    }
}
