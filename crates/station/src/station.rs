//! The ground station: bytes to frames and back, heartbeats, and what was seen.

use crate::habits::Habits;
use crate::{Client, Dialogue, Failure, Io, Seen, SeenVehicle};
use mavstack::dialect::{Heartbeat, Ping};
use mavstack::frame::{Decoder, Header, MAX_FRAME_LEN, RxCounters, SigningKey, Version, encode, encode_signed};
use mavstack::message::{Dialect, MessageTable};
use mavstack::{Address, Duration, Frame, Instant, Message};
use std::collections::VecDeque;

mavstack::dialect! {
    /// The messages that a station understands: all of common, and those of `development.xml` that it has dialogues for.
    struct Known: [crate::control::ControlStatus] + mavstack::dialect::Common;
}

/// The most frames that are kept for the next dialogue; the oldest are dropped.
const MAX_INBOX: usize = 10_000;

/// A received frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// When its last byte was received.
    pub at: Instant,
    /// Its header.
    pub header: Header,
    /// Its payload as sent, without trailing zeros.
    pub payload: Vec<u8>,
    /// Whether it has a signature made with the station's key.
    pub is_signed: bool,
}

impl Received {
    /// Returns the message if it is an `M`.
    pub fn decode<M: Message>(&self) -> Option<M> {
        (self.header.id == M::ID).then(|| M::decode(&self.payload))
    }

    /// Returns the sender.
    pub fn source(&self) -> Address {
        self.header.source
    }
}

/// A ground station on one link: a state machine without a clock and without a transport.
///
/// Give it the bytes that arrive ([`receive`](Self::receive)) and the time ([`poll`](Self::poll)), and send what
/// [`take_output`](Self::take_output) returns. [`advance`](Self::advance) drives a [`Dialogue`]. Usually a
/// [`Drive`](crate::Drive) does all of that.
///
/// ```
/// use mavstack::dialect::{Heartbeat, MavAutopilot, MavType};
/// use mavstack::frame::{Version, encode};
/// use mavstack::{Address, Instant};
/// use mavstack_station::{Client, Station};
/// let mut station = Station::new(Client::QGroundControl);
/// station.poll(Instant::ZERO);
/// assert_eq!(station.take_output().len(), 21, "its first heartbeat");
///
/// // The vehicle's heartbeat arrives.
/// let heartbeat = Heartbeat { r#type: MavType::GROUND_ROVER, autopilot: MavAutopilot::GENERIC, ..Heartbeat::default() };
/// let mut frame = [0; 64];
/// let len = encode(&heartbeat, Version::V2, Address::new(7, 1), 0, &mut frame)?;
/// station.receive(Instant::from_millis(20), &frame[..len]);
/// assert_eq!(station.target(), Some(Address::new(7, 1)));
/// # Ok::<(), mavstack::frame::EncodeError>(())
/// ```
#[derive(Debug)]
pub struct Station {
    decoder: Decoder,
    messages: MessageTable,
    inbox: VecDeque<Received>,
    /// The number of frames that were put into the inbox.
    heard: u64,
    now: Instant,
    seen: Seen,
    sender: Sender,
    heartbeats: Heartbeats,
    habits: Habits,
    sending: Sending,
}

/// When a station sends at all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sending {
    /// Always, as real clients do.
    #[default]
    Always,
    /// Until a heartbeat says that a vehicle is armed.
    UnlessArmed,
    /// Only while the last heartbeat of the [target](Station::target) says that it is disarmed, and no vehicle is armed.
    WhileDisarmed,
    /// Never: it only listens.
    Never,
}

/// When a station sends heartbeats.
#[derive(Clone, Copy, Debug)]
struct Heartbeats {
    interval: Option<Duration>,
    due: Instant,
}

/// The sending half of a station.
#[derive(Debug)]
pub(crate) struct Sender {
    pub(crate) client: Client,
    pub(crate) address: Address,
    pub(crate) target: Option<Address>,
    version: Version,
    seq: u8,
    signing: Option<Signing>,
    /// The session and the number of pymavlink's next packet of MAVLink FTP.
    pub(crate) file_session: (u8, u16),
    /// Whether nothing is sent, see [`Sending`].
    is_silent: bool,
    output: Vec<u8>,
}

/// How sent frames are signed.
#[derive(Clone, Debug)]
struct Signing {
    key: SigningKey,
    /// The timestamp at `since`, in units of 10 µs.
    timestamp: u64,
    since: Instant,
    /// The timestamp of the last frame.
    last: u64,
}

impl Station {
    /// Creates a station that behaves as `client`, with its address, its heartbeats and its MAVLink version.
    pub fn new(client: Client) -> Self {
        Self {
            // Ground stations wait for the rest of a frame without a timeout.
            decoder: Decoder::new(Duration::MAX),
            messages: Known::MESSAGES,
            inbox: VecDeque::new(),
            heard: 0,
            now: Instant::ZERO,
            seen: Seen::default(),
            sender: Sender {
                client,
                address: client.address(),
                target: None,
                // pymavlink speaks MAVLink 1 until it hears MAVLink 2.
                version: if client == Client::Pymavlink { Version::V1 } else { Version::V2 },
                seq: 0,
                signing: None,
                file_session: (0, 0),
                is_silent: false,
                output: Vec::new(),
            },
            heartbeats: Heartbeats { interval: client.heartbeat_interval(), due: Instant::ZERO },
            habits: Habits::default(),
            sending: Sending::Always,
        }
    }

    /// Uses another address.
    #[must_use]
    pub fn with_address(mut self, address: Address) -> Self {
        self.sender.address = address;
        self
    }

    /// Speaks with this vehicle; by default with the first autopilot that it hears.
    #[must_use]
    pub fn with_target(mut self, target: Address) -> Self {
        self.sender.target = Some(target);
        self
    }

    /// Sends another MAVLink version.
    #[must_use]
    pub fn with_version(mut self, version: Version) -> Self {
        self.sender.version = version;
        self
    }

    /// Receives the messages of another dialect, which must contain common: frames with other ids cannot be verified, and are dropped.
    #[must_use]
    pub fn with_messages(mut self, messages: MessageTable) -> Self {
        self.messages = messages;
        self
    }

    /// Sends heartbeats at another interval, or none.
    #[must_use]
    pub fn with_heartbeats(mut self, interval: Option<Duration>) -> Self {
        self.heartbeats.interval = interval;
        self
    }

    /// Sends no REQUEST_DATA_STREAM by itself, which MAVProxy does otherwise: ArduPilot keeps the rates after the client has gone.
    #[must_use]
    pub fn without_stream_requests(mut self) -> Self {
        self.habits.leave_streams_alone();
        self
    }

    /// Signs sent frames with this key, see [`set_signing`](Self::set_signing).
    #[must_use]
    pub fn with_signing(mut self, key: [u8; 32], timestamp: u64) -> Self {
        self.set_signing(Some((key, timestamp)));
        self
    }

    /// Sets the key with which sent frames are signed from now on, or none. `timestamp` is that of the next frame, in units of
    /// 10 µs since 2015-01-01 00:00 UTC. It grows with the time.
    pub fn set_signing(&mut self, key: Option<([u8; 32], u64)>) {
        self.sender.set_signing(self.now, key);
    }

    /// Sends heartbeats at another interval from now on, or none.
    pub fn set_heartbeats(&mut self, interval: Option<Duration>) {
        self.heartbeats = Heartbeats { interval, due: self.now };
    }

    /// Speaks with this vehicle from now on.
    pub fn set_target(&mut self, target: Address) {
        self.sender.target = Some(target);
        self.obey();
    }

    /// Sets when it sends at all. While it may not, it drops what it is told to send, and what
    /// [`take_output`](Self::take_output) has not taken.
    pub fn set_sending(&mut self, sending: Sending) {
        self.sending = sending;
        self.obey();
    }

    /// Returns whether it may send now, see [`set_sending`](Self::set_sending).
    pub fn may_send(&self) -> bool {
        let target = self.target().and_then(|target| self.seen.component(target));
        let is_disarmed = target.is_some_and(|target| target.heartbeat.is_some());
        match self.sending {
            Sending::Always => true,
            Sending::UnlessArmed => !self.is_any_armed(),
            Sending::WhileDisarmed => is_disarmed && !self.is_any_armed(),
            Sending::Never => false,
        }
    }

    /// Returns whether the last heartbeat of the target, or of any autopilot, said that it is armed.
    pub fn is_any_armed(&self) -> bool {
        let target = self.target().and_then(|target| self.seen.component(target));
        self.seen.vehicles().chain(target).any(SeenVehicle::is_armed)
    }

    /// Stops or resumes sending, after something has changed on which it depends.
    fn obey(&mut self) {
        self.sender.is_silent = !self.may_send();
        if self.sender.is_silent {
            self.sender.output.clear();
        }
    }

    /// Returns the client that it behaves as.
    pub fn client(&self) -> Client {
        self.sender.client
    }

    /// Returns its own address.
    pub fn address(&self) -> Address {
        self.sender.address
    }

    /// Returns the vehicle that it speaks with: the one that was set, or the first autopilot heard.
    pub fn target(&self) -> Option<Address> {
        self.sender.target
    }

    /// Returns the time of the last call.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Takes received bytes.
    pub fn receive(&mut self, now: Instant, mut bytes: &[u8]) {
        self.now = self.now.max(now);
        while !bytes.is_empty() {
            let taken = self.decoder.push(bytes, now);
            bytes = &bytes[taken..];
            self.decode(now);
        }
    }

    fn decode(&mut self, now: Instant) {
        while let Some(frame) = self.decoder.next(now, self.messages, &mut u32::MAX.clone(), |_| false) {
            let received = self.sender.accept(now, &frame);
            self.seen.note(&received);
            let sender = self.seen.component(received.source());
            if self.sender.target.is_none() && sender.is_some_and(SeenVehicle::is_autopilot) {
                self.sender.target = Some(received.source());
            }
            if received.header.id == Heartbeat::ID {
                self.obey();
            }
            self.sender.answer_ping(now, &received);
            if self.inbox.len() == MAX_INBOX {
                self.inbox.pop_front();
            }
            self.inbox.push_back(received);
            self.heard += 1;
        }
    }

    /// Sends what is due: heartbeats, and what the client sends by itself to a vehicle that it knows. MAVSDK sends PING at once and
    /// every 5 s, except to ArduPilot. MAVProxy requests all streams of all components at 4 Hz every 15 s, which overrides intervals that
    /// were set, and asks for the home position every 2 s until it has heard it. A station without heartbeats is silent.
    pub fn poll(&mut self, now: Instant) {
        self.now = self.now.max(now);
        let Some(interval) = self.heartbeats.interval.filter(|_| !self.sender.is_silent) else { return };
        if now >= self.heartbeats.due {
            self.heartbeats.due = now + interval;
            self.send(&self.client().heartbeat());
        }
        if let Some(target) = self.target() {
            let Self { habits, seen, sender, .. } = self;
            habits.poll(now, target, seen, sender);
        }
    }

    /// Returns whether the client takes the vehicle for connected: it has heard it lately, see
    /// [`Client::lost_after`]. MAVSDK counts heartbeats only, the others count all frames.
    pub fn is_connected(&self) -> bool {
        let Some(component) = self.target().and_then(|target| self.seen.component(target)) else { return false };
        let last = match self.client() {
            Client::Mavsdk => component.heartbeats.last().copied(),
            _ => Some(component.last),
        };
        last.is_some_and(|last| self.now - last < self.client().lost_after())
    }

    /// Sends a message.
    pub fn send<M: Message>(&mut self, message: &M) {
        self.sender.send(self.now, message);
    }

    /// Sends bytes as they are, for tests of frames that no client sends.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        if !self.sender.is_silent {
            self.sender.output.extend(bytes);
        }
    }

    /// Takes the bytes to send: whole frames.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.sender.output)
    }

    /// Drops the frames that no dialogue has taken. [`seen`](Self::seen) still knows them.
    pub fn forget_inbox(&mut self) {
        self.inbox.clear();
    }

    /// Hands a dialogue the frames received since the last call, then the time. Returns its result once it has ended.
    pub fn advance<D: Dialogue>(&mut self, now: Instant, dialogue: &mut D) -> Option<Result<D::Output, Failure>> {
        self.now = self.now.max(now);
        let mut io = Io::new(self.now, &mut self.sender, &self.seen);
        while let Some(frame) = self.inbox.pop_front() {
            dialogue.receive(&mut io, &frame);
        }
        dialogue.poll(&mut io)
    }

    /// Returns the number of frames that dialogues could take so far: a mark for [`overhear`](Self::overhear).
    pub fn frames_heard(&self) -> u64 {
        self.heard
    }

    /// Hands a dialogue the frames received since `heard`, which it moves on, then the time. The frames stay for
    /// [`advance`](Self::advance). Returns the dialogue's result once it has ended.
    pub fn overhear<D: Dialogue>(
        &mut self,
        now: Instant,
        dialogue: &mut D,
        heard: &mut u64,
    ) -> Option<Result<D::Output, Failure>> {
        self.now = self.now.max(now);
        let new = usize::try_from(self.heard - *heard).unwrap_or(usize::MAX).min(self.inbox.len());
        *heard = self.heard;
        let mut io = Io::new(self.now, &mut self.sender, &self.seen);
        for frame in self.inbox.iter().skip(self.inbox.len() - new) {
            dialogue.receive(&mut io, frame);
        }
        dialogue.poll(&mut io)
    }

    /// Returns what was received.
    pub fn seen(&self) -> &Seen {
        &self.seen
    }

    /// Returns the counters of received bytes and frames.
    pub fn counters(&self) -> RxCounters {
        self.decoder.counters()
    }
}

/// A station that behaves as this client.
impl From<Client> for Station {
    fn from(client: Client) -> Self {
        Self::new(client)
    }
}

impl Sender {
    /// Takes a frame. The first one decides the version of pymavlink, as it does in `mavutil`.
    fn accept(&mut self, now: Instant, frame: &Frame<'_>) -> Received {
        if self.client == Client::Pymavlink && frame.header().version == Version::V2 {
            self.version = Version::V2;
        }
        Received { at: now, header: *frame.header(), payload: frame.payload().to_vec(), is_signed: self.verify(frame) }
    }

    /// Whether a frame is signed with the station's key. Its timestamp then raises the station's.
    fn verify(&mut self, frame: &Frame<'_>) -> bool {
        let (Some(signing), Some(signature)) = (&mut self.signing, frame.signature()) else { return false };
        let is_signed = frame.is_signed_with(&signing.key);
        if is_signed {
            signing.last = signing.last.max(signature.timestamp);
        }
        is_signed
    }

    pub(crate) fn set_signing(&mut self, now: Instant, key: Option<([u8; 32], u64)>) {
        self.signing =
            key.map(|(key, timestamp)| Signing { key: SigningKey::new(key), timestamp, since: now, last: 0 });
    }

    /// Answers a PING to all, as QGroundControl and MAVSDK do.
    fn answer_ping(&mut self, now: Instant, frame: &Received) {
        let answers = matches!(self.client, Client::QGroundControl | Client::Mavsdk);
        let is_to_all = |ping: &Ping| ping.target_system == 0 && ping.target_component == 0;
        if let Some(ping) = frame.decode::<Ping>().filter(is_to_all).filter(|_| answers) {
            let Address { system, component } = frame.source();
            self.send(now, &Ping { target_system: system.wire(), target_component: component.wire(), ..ping });
        }
    }

    /// Sends a message. With MAVLink 1, a message that needs MAVLink 2 is not sent, as the real clients do.
    pub(crate) fn send<M: Message>(&mut self, now: Instant, message: &M) {
        if self.is_silent {
            return;
        }
        let mut frame = [0; MAX_FRAME_LEN];
        let len = match &mut self.signing {
            Some(signing) => {
                let elapsed = (now - signing.since).as_micros() / 10;
                signing.last = (signing.timestamp + elapsed).max(signing.last + 1);
                encode_signed(message, self.address, self.seq, &signing.key, 0, signing.last, &mut frame)
            }
            None => encode(message, self.version, self.address, self.seq, &mut frame),
        };
        if let Ok(len) = len {
            self.seq = self.seq.wrapping_add(1);
            self.output.extend(&frame[..len]);
        }
    }
}
