//! A vehicle with message signing, driven by bytes, and a peer that signs its frames.

#![allow(dead_code, reason = "each test binary uses its own part")]

use crate::support::tested::Options;
use crate::support::{STATION, Signed, TestVehicle, Tested, VEHICLE, begun, millis};
use mavstack::__private::NoPlans;
use mavstack::__private::SigningStreams;
use mavstack::dialect::Common;
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Signature, Version, encode, encode_signed};
use mavstack::message::Dialect;
use mavstack::signing::{Signing, SigningCounters, SigningKey};
use mavstack::{Address, Config, Duration, Instant, LinkConfig, LinkId, Message, Pulse, Stack};
use sha2::{Digest, Sha256};

pub const KEY: [u8; 32] = *b"a key for tests, and nothing els";
pub const OTHER_KEY: [u8; 32] = *b"another key, that nobody gave us";
/// The initial timestamp, in 2026.
pub const NOW: u64 = 37_000_000_000_000;
pub const LINKS: [LinkId; 2] = [LinkId(0), LinkId(1)];

/// A peer that signs its frames. By default it is the ground station on its link 0, one second ahead.
#[derive(Clone, Debug)]
pub struct Signer {
    pub key: [u8; 32],
    pub address: Address,
    pub link_id: u8,
    /// Timestamp of the next frame.
    pub timestamp: u64,
    pub seq: u8,
}

impl Signer {
    pub fn new(key: [u8; 32]) -> Self {
        Self { key, address: STATION, link_id: 0, timestamp: NOW + 100_000, seq: 0 }
    }

    pub fn of(mut self, address: Address) -> Self {
        self.address = address;
        self
    }

    pub fn at(mut self, timestamp: u64) -> Self {
        self.timestamp = timestamp;
        self
    }

    pub fn link(mut self, link_id: u8) -> Self {
        self.link_id = link_id;
        self
    }

    /// Returns the next frame, signed.
    pub fn frame<M: Message>(&mut self, message: &M) -> Vec<u8> {
        let mut out = [0; MAX_FRAME_LEN];
        let (seq, timestamp) = (self.seq, self.timestamp);
        (self.seq, self.timestamp) = (seq.wrapping_add(1), timestamp + 1);
        let key = SigningKey::new(self.key);
        let len = encode_signed(message, self.address, seq, &key, self.link_id, timestamp, &mut out);
        out[..len.expect("every message fits")].to_vec()
    }

    /// Returns the next frame, unsigned.
    pub fn unsigned<M: Message>(&mut self, version: Version, message: &M) -> Vec<u8> {
        let mut out = [0; MAX_FRAME_LEN];
        let len = encode(message, version, self.address, self.seq, &mut out).expect("every message fits");
        self.seq = self.seq.wrapping_add(1);
        out[..len].to_vec()
    }

    /// Returns the next frame, signed, with an unknown message id.
    pub fn frame_of(&mut self, id: u32, payload: &[u8]) -> Vec<u8> {
        let [a, b, c, _] = id.to_le_bytes();
        let mut raw = vec![0xFD, payload.len() as u8, 1, 0, self.seq];
        raw.extend([self.address.system.wire(), self.address.component.wire(), a, b, c]);
        raw.extend(payload);
        raw.extend([0x12, 0x34, self.link_id]);
        raw.extend(&self.timestamp.to_le_bytes()[..6]);
        (self.seq, self.timestamp) = (self.seq.wrapping_add(1), self.timestamp + 1);
        let hash = Sha256::new().chain_update(self.key).chain_update(&raw).finalize();
        raw.extend(&hash[..6]);
        raw
    }
}

/// A frame sent by the vehicle.
#[derive(Clone, Debug)]
pub struct Sent {
    pub raw: Vec<u8>,
}

impl Sent {
    fn with<T>(&self, look: impl FnOnce(&mavstack::Frame<'_>) -> T) -> T {
        let mut decoder = Decoder::default();
        assert_eq!(decoder.push(&self.raw, Instant::ZERO), self.raw.len());
        let frame = decoder.next(Instant::ZERO, Common::MESSAGES, &mut u32::MAX.clone(), |_| false);
        look(&frame.expect("what the vehicle sends is a frame"))
    }

    pub fn id(&self) -> u32 {
        self.with(|frame| frame.id())
    }

    pub fn is_signed(&self) -> bool {
        self.with(|frame| frame.header().is_signed())
    }

    pub fn is_signed_with(&self, key: [u8; 32]) -> bool {
        self.with(|frame| frame.is_signed_with(&SigningKey::new(key)))
    }

    pub fn signature(&self) -> Signature {
        self.with(|frame| frame.signature()).expect("it is signed")
    }

    pub fn decode<M: Message>(&self) -> Option<M> {
        self.with(|frame| frame.decode())
    }
}

/// A vehicle with `N` links that accept all output at once.
pub struct Rig<const N: usize = 2, O: Options<Tested<NoPlans, 8, O>> + 'static = Signed> {
    pub stack: Box<Stack<Tested<NoPlans, 8, O>, N>>,
    pub vehicle: TestVehicle,
    pub now: Instant,
    pulse: &'static Pulse,
}

impl<const N: usize, O: Options<Tested<NoPlans, 8, O>>> Rig<N, O> {
    /// Creates a vehicle without a key.
    pub fn new(links: [LinkConfig; N]) -> Self {
        let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
        let stack = begun(Config::new(VEHICLE, pulse), links);
        Self { stack, vehicle: TestVehicle::new(), now: Instant::from_millis(5_000), pulse }
    }

    /// Delivers bytes to the vehicle.
    pub fn receive(&mut self, link: usize, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let taken = self.stack.receive(self.now, LinkId(link as u8), rest, &mut self.vehicle);
            rest = &rest[taken..];
        }
        self.stack.receive(self.now, LinkId(link as u8), &[], &mut self.vehicle);
    }

    /// Returns all frames that the vehicle sends on a link now.
    pub fn transmit(&mut self, link: usize) -> Vec<Sent> {
        self.pulse.tick();
        self.stack.poll(self.now, &mut self.vehicle);
        let mut frames = Vec::new();
        loop {
            let raw = self.stack.transmit(self.now, LinkId(link as u8), &mut self.vehicle).to_vec();
            if raw.is_empty() {
                return frames;
            }
            self.stack.transmitted(LinkId(link as u8), raw.len());
            frames.push(Sent { raw });
        }
    }

    /// Like [`transmit`](Self::transmit), but returns only messages of type `M`.
    pub fn sent<M: Message>(&mut self, link: usize) -> Vec<Sent> {
        self.transmit(link).into_iter().filter(|frame| frame.id() == M::ID).collect()
    }

    /// Sends the first `len` bytes of the next frame. Returns the complete frame.
    pub fn begin(&mut self, link: usize, len: usize) -> Vec<u8> {
        let frame = self.stack.transmit(self.now, LinkId(link as u8), &mut self.vehicle).to_vec();
        self.stack.transmitted(LinkId(link as u8), len);
        frame
    }

    /// Resets a link.
    pub fn restart(&mut self, link: usize) {
        self.stack.restart_link(LinkId(link as u8));
    }

    /// Runs the flight loop for `duration`, without sending.
    pub fn run_for(&mut self, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            self.now = (self.now + millis(100)).min(end);
            self.pulse.tick();
            self.stack.poll(self.now, &mut self.vehicle);
            for link in 0..N {
                self.stack.receive(self.now, LinkId(link as u8), &[], &mut self.vehicle);
            }
        }
    }
}

impl<const N: usize, O: Options<Tested<NoPlans, 8, O>, Signing = SigningStreams<16>>> Rig<N, O> {
    /// Sets a key and the time [`NOW`].
    pub fn set_key(&mut self, key: [u8; 32]) {
        let now = self.now;
        self.signing().set_key(now, SigningKey::new(key), NOW);
    }

    pub fn signing(&mut self) -> &mut Signing {
        self.stack.signing_mut()
    }

    pub fn counters(&mut self) -> SigningCounters {
        self.signing().counters()
    }

    /// Returns the vehicle's timestamp.
    pub fn timestamp(&mut self) -> u64 {
        let now = self.now;
        self.signing().timestamp(now)
    }
}

/// Corrects the checksum of a changed frame, if its message is known.
pub fn repair(raw: &mut [u8]) {
    let end = usize::from(raw[1]) + 10;
    let id = u32::from_le_bytes([raw[7], raw[8], raw[9], 0]);
    if let (Some(info), true) = (Common::MESSAGES.get(id), end + 2 <= raw.len()) {
        let mut crc = crc_any::CRCu16::crc16mcrf4cc();
        crc.digest(&raw[1..end]);
        crc.digest(&[info.crc_extra()]);
        raw[end..end + 2].copy_from_slice(&crc.get_crc().to_le_bytes());
    }
}
