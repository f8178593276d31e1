//! What a firmware tells the stack once.

use crate::dialect::{MavAutopilot, MavType};
use crate::frame::{Address, Decoder};
use crate::pulse::Pulse;
use crate::service::identity::Identity;
use crate::time::Duration;

/// How much one [`poll_link`](crate::Stack::poll_link) may do (D-2, SEC-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PollBudget {
    /// Bytes read from the transport. 0 reads nothing.
    pub rx_bytes: u32,
    /// Work, of which a unit is about ten instructions of a Cortex-M4. A byte put through the checksum, or copied for another
    /// link, takes 1, a byte moved aside for new ones a half, a header looked at 16, one with an unknown id 32, a frame handled
    /// with its answer 500, any other frame sent 220, and each 64 bytes that are hashed for a signature 150. What came is handled
    /// first, a frame at least; then as many frames are sent, and one at least, and more of them as long as something is left.
    /// Less than [`Decoder::MIN_BUDGET`] counts as that.
    pub work: u32,
    /// Frames handled, if [`work`](Self::work) does not end it before; what is left waits in the decoder. 0 counts as 1.
    pub frames: u32,
    /// Bytes handed to the transport. 0 sends nothing.
    pub tx_bytes: u32,
}

impl PollBudget {
    /// 128 bytes in, 280 out, and work for three frames, or two that are signed: enough for what a ground station sends by
    /// 1 Mbit/s at a poll a millisecond, and by 57,600 bit/s at one every 20 ms. No more than that many frames come through however
    /// short they are, 150 a second at a poll every 20 ms; for lines that others fill there is [`for_line`](Self::for_line).
    pub const DEFAULT: Self = Self { rx_bytes: 128, work: 1_700, frames: 8, tx_bytes: 280 };

    /// Enough for a line of `baud` bit/s that is full of short frames, signed or not, and polled every `period`; plus a quarter,
    /// for the backlog after a late poll. Never less than [`DEFAULT`](Self::DEFAULT).
    ///
    /// ```
    /// use mavstack::{Duration, PollBudget};
    /// const BUDGET: PollBudget = PollBudget::for_line(115_200, Duration::from_millis(20));
    /// assert_eq!(BUDGET.rx_bytes, 288);
    /// ```
    ///
    /// # Panics
    ///
    /// Panics when the line delivers more than 98 MB between two polls, which no budget can express. In a `const` this is
    /// a compile error.
    #[allow(
        clippy::as_conversions,
        reason = "const fn: `From` cannot be called; what is made narrower is no larger than its type"
    )]
    #[must_use]
    pub const fn for_line(baud: u32, period: Duration) -> Self {
        /// What a byte of the shortest frames takes of the budget: 16 bytes are a MISSION_REQUEST_INT, which takes 545.
        const WORK: u64 = 35;
        const SHORTEST: u64 = 16;
        const fn at_least(least: u32, value: u64) -> u32 {
            if value < least as u64 { least } else { value as u32 }
        }
        // A byte is ten bits.
        let bytes = (baud as u64).saturating_mul(period.as_micros()).div_ceil(8_000_000);
        let work = bytes.saturating_mul(WORK);
        assert!(
            work <= u32::MAX as u64,
            "no budget is enough for so many bytes between two polls: poll the link more often"
        );
        let least = Self::DEFAULT;
        Self {
            rx_bytes: at_least(least.rx_bytes, bytes),
            work: at_least(least.work, work),
            frames: at_least(least.frames, bytes.div_ceil(SHORTEST)),
            tx_bytes: at_least(least.tx_bytes, bytes),
        }
    }

    /// What one poll may still do.
    pub(crate) fn allowance(&self) -> Allowance {
        let work = self.work.max(Decoder::MIN_BUDGET);
        Allowance { work, frames: self.frames.max(1), answers: 0, has_sent: false }
    }
}

impl Default for PollBudget {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What a frame counts as work that is handled, and its answer sent.
const HANDLED: u32 = 500;
/// The same of one that is sent without that.
const MADE: u32 = 220;

/// What is left of a [`PollBudget`], but for bytes.
pub(crate) struct Allowance {
    pub(crate) work: u32,
    /// That may be handled.
    pub(crate) frames: u32,
    /// Answers that are paid for.
    answers: u32,
    /// Whether a frame was sent.
    has_sent: bool,
}

impl Allowance {
    /// Whether one more frame may be handled: the first in any case.
    pub(crate) fn may_handle(&self) -> bool {
        self.frames > 0 && (self.answers == 0 || self.work >= HANDLED)
    }

    /// A frame is handled.
    pub(crate) fn handle(&mut self) {
        self.frames = self.frames.saturating_sub(1);
        self.answers = self.answers.saturating_add(1);
        self.spend(HANDLED);
    }

    /// Whether a frame may be begun that is to be sent.
    pub(crate) fn may_send(&self) -> bool {
        !self.has_sent || self.answers > 0 || self.work > 0
    }

    /// A frame is sent, whose signature costs so much.
    pub(crate) fn send(&mut self, signature: u32) {
        self.has_sent = true;
        self.spend(if self.answers > 0 { signature } else { MADE.saturating_add(signature) });
        self.answers = self.answers.saturating_sub(1);
    }

    pub(crate) fn spend(&mut self, work: u32) {
        self.work = self.work.saturating_sub(work);
    }

    /// The same; but enough for the longest frame is left, if there was that much.
    pub(crate) fn spend_but_for_a_frame(&mut self, work: u32) {
        let least = self.work.min(Decoder::MIN_BUDGET);
        self.work = self.work.saturating_sub(work).max(least);
    }
}

/// What a firmware tells its [`Stack`](crate::Stack). Make it a `const`: what it refuses is then refused by the compiler.
///
/// ```
/// use mavstack::{Address, Config, Pulse, dialect::MavType};
/// static PULSE: Pulse = Pulse::new();
/// const CONFIG: Config = Config {
///     r#type: MavType::GROUND_ROVER,
///     ..Config::new(Address::new(1, 1), &PULSE)
/// };
/// ```
///
/// An address that a vehicle cannot have does not compile:
///
/// ```compile_fail
/// # use mavstack::{Address, Config, Pulse};
/// # static PULSE: Pulse = Pulse::new();
/// const CONFIG: Config = Config::new(Address::new(0, 1), &PULSE);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Our system (1 to 254) and component (1 to 255): what every frame is sent from (H-2).
    pub address: VehicleAddress,
    /// What the flight loop ticks: without ticks there are no heartbeats (H-5).
    pub pulse: &'static Pulse,
    /// HEARTBEAT.type: a vehicle's, or ground stations look past it (H-3). [`MavType::QUADROTOR`] at first.
    pub r#type: MavType,
    /// HEARTBEAT.autopilot: [`MavAutopilot::GENERIC`], unless the firmware has another one's mode numbers and
    /// parameters (H-3).
    pub autopilot: MavAutopilot,
    /// What AUTOPILOT_VERSION says of the vehicle.
    pub identity: Identity,
    /// Time between heartbeats on a link: 1 s (H-1). Less than 10 ms counts as that.
    pub heartbeat_period: Duration,
    /// How long the flight loop may take for one pass before the heartbeats stop: 500 ms (H-5). The stack must be polled more
    /// often than this, or whenever [`next_deadline`](crate::Stack::next_deadline) says.
    pub max_loop_gap: Duration,
    /// After how long without a heartbeat a peer is lost: 5 s (H-11).
    pub peer_timeout: Duration,
    /// After how long without a new byte the front of a frame is dropped: 500 ms (SEC-4).
    pub stale_after: Duration,
    /// Whether a link's streams wait until a peer on it is alive (H-8); heartbeats never do. False at first: ground stations
    /// that find telemetry need not ask for it.
    pub streams_wait_for_peer: bool,
    /// Whether frames with source component 0 are accepted: true (S-11). MAVLink does not allow them, but pymavlink's
    /// `mavlink_connection` sends them unless `source_component` is given, and PX4 and ArduPilot answer them. Answers are
    /// addressed to component 0 of that system. Otherwise such frames are dropped and counted in
    /// [`zero_source`](crate::RxCounters::zero_source).
    pub accepts_component_0: bool,
    /// The bound of one [`poll_link`](crate::Stack::poll_link).
    pub budget: PollBudget,
    /// Whether the old MISSION_REQUEST is answered by the old MISSION_ITEM, whose positions are floats: true by default,
    /// because a client that uses the old request expects the old item. PX4 and ArduPilot do the same. If false, the answer
    /// is MISSION_ITEM_INT, as the current definitions require (M-61).
    pub float_mission_items: bool,
    /// Whether the MISSION_ACK that accepts an upload is sent once more 400 ms later, for lossy lines: QGroundControl fails
    /// an upload whose final answer is lost, and does not ask again (M-31). A client that clears the same plan within these
    /// 400 ms takes it for the answer to that. False at first.
    pub second_mission_ack: bool,
    /// How many more times MISSION_ITEM_REACHED is sent, once a second, for lossy lines: none at first; more than 3 count
    /// as 3 (M-91).
    pub item_reached_repeats: u8,
    /// The time in which a store regains one token for a write that a peer causes: 15 minutes by default (C-15).
    /// [`Duration::ZERO`] disables the limit, for FRAM.
    ///
    /// Each store (plans, parameters, key) has a token bucket of 128 tokens, which is full at the start. A write of the
    /// parameters or of the key, a clear, and a plan of up to a quarter of plan memory each take one token; a plan that fills
    /// plan memory takes four. Without a token, a plan is DENIED at its beginning, MAV_CMD_PREFLIGHT_STORAGE is
    /// TEMPORARILY_REJECTED, SETUP_SIGNING is refused with a text, and changed parameters are written later. Writes by the
    /// vehicle itself are never refused.
    ///
    /// With the default, a flooding peer causes 128 writes, then 96 a day. Two slots of flash rated for 10,000 erases take 20,000
    /// writes: 207 days of uninterrupted flood. In regular use, a day with 20 uploads that fill plan memory takes 80 tokens; 100
    /// single parameter changes take 100 tokens of another bucket. A restart refills the buckets: a peer that may restart the
    /// vehicle may cause more writes.
    pub storage_refill: Duration,
}

/// An address that a vehicle may have, so that none other can be configured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VehicleAddress(Address);

impl VehicleAddress {
    /// `None` when the system is not 1 to 254 (0 means everyone, 255 is the ground stations' own; H-2), or the component is
    /// 0. Ground stations take only component 1 for the vehicle.
    pub const fn new(address: Address) -> Option<Self> {
        if address.system.0 == 0 || address.system.0 == 255 || address.component.0 == 0 {
            return None;
        }
        Some(Self(address))
    }

    /// The address.
    pub const fn get(self) -> Address {
        self.0
    }
}

impl Config {
    /// The usual settings for a vehicle with this address and pulse; change the others by struct update.
    ///
    /// # Panics
    ///
    /// When [`VehicleAddress::new`] refuses `address`: in a `const` a compile error. For an address that is only known at
    /// run time, put a checked one in [`address`](Self::address).
    pub const fn new(address: Address, pulse: &'static Pulse) -> Self {
        let address = VehicleAddress::new(address);
        assert!(
            address.is_some(),
            "a system id is 1 to 254 (255: ground stations), a component id 1 to 255: take (1, 1)"
        );
        let address = match address {
            Some(address) => address,
            None => VehicleAddress(Address::new(1, 1)),
        };
        Self {
            address,
            pulse,
            r#type: MavType::QUADROTOR,
            autopilot: MavAutopilot::GENERIC,
            identity: Identity::NONE,
            heartbeat_period: Duration::from_secs(1),
            max_loop_gap: Duration::from_millis(500),
            peer_timeout: Duration::from_secs(5),
            stale_after: Decoder::STALE_AFTER,
            streams_wait_for_peer: false,
            accepts_component_0: true,
            budget: PollBudget::DEFAULT,
            float_mission_items: true,
            second_mission_ack: false,
            item_reached_repeats: 0,
            storage_refill: Duration::from_secs(15 * 60),
        }
    }
}
