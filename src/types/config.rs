//! The configuration of a stack.

use core::num::Wrapping;

use super::identity::Identity;
use crate::dialect::{MavAutopilot, MavType};
use crate::frame::Decoder;
use crate::message::{Address, SystemId};
use crate::pulse::Pulse;
use crate::time::Duration;

/// The budget of one [`poll_link`](crate::Stack::poll_link) (D-2, SEC-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PollBudget {
    /// The maximum number of bytes read from the transport. 0 reads nothing.
    pub rx_bytes: u32,
    /// The cost of the call, in cost units of about ten instructions on a Cortex-M4:
    ///
    /// | step | cost units |
    /// |---|---|
    /// | a byte put through the checksum, or copied for another link | 1 |
    /// | a byte moved aside for new ones | 0.5 |
    /// | a header examined | 17 |
    /// | a header with an unknown id | 34 |
    /// | a frame handled, and its answer sent | 520 |
    /// | any other frame sent | 220 |
    /// | each 64 bytes hashed for a signature | 150 |
    ///
    /// Received frames are handled first, at least one. Then frames are sent, at least one and as many as were handled,
    /// and more as long as budget is left. A value below [`Decoder::MIN_BUDGET`] counts as that.
    pub work: u32,
    /// The maximum number of frames handled, if [`work`](Self::work) is not used up before. The others stay in the
    /// decoder. 0 counts as 1. No more frames are handled either after they have called so many hooks of the vehicle,
    /// or 16 if that is more (X-6).
    pub frames: u32,
    /// The maximum number of bytes handed to the transport. 0 sends nothing.
    pub tx_bytes: u32,
}

impl PollBudget {
    /// The default: 128 bytes received, 280 sent, and work for three frames, or for two signed ones.
    ///
    /// It is enough for the traffic of a ground station at 1 Mbit/s with a poll every millisecond, or at 57,600 bit/s
    /// with a poll every 20 ms. More frames than that are not handled, however short they are: 150 a second with a poll
    /// every 20 ms. For a link that others keep fully loaded, use [`for_link`](Self::for_link).
    pub const DEFAULT: Self = Self { rx_bytes: 128, work: 1_700, frames: 8, tx_bytes: 280 };

    /// Returns a budget for a link of `baud` bit/s, ten bits for each byte, that is polled every `period`. It is enough for
    /// a link that is fully loaded, with frames of any length, signed or not. It adds a quarter, for the backlog after a
    /// late poll, and is never less than [`DEFAULT`](Self::DEFAULT).
    ///
    /// For USB full speed, use 12 Mbit/s: it carries up to 1,216 bytes a millisecond.
    ///
    /// ```
    /// use mavstack::Duration;
    /// use mavstack::config::PollBudget;
    /// const BUDGET: PollBudget = PollBudget::for_link(115_200, Duration::from_millis(20));
    /// assert_eq!(BUDGET.rx_bytes, 288);
    /// const USB: PollBudget = PollBudget::for_link(12_000_000, Duration::from_millis(1));
    /// assert_eq!(USB.rx_bytes, 1_500);
    /// ```
    ///
    /// # Panics
    ///
    /// Panics if more than 45 MB arrive between two polls, which no budget can express. In a `const` this is a compile
    /// error.
    #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; each value fits its narrower type")]
    #[must_use]
    pub const fn for_link(baud: u32, period: Duration) -> Self {
        /// The length of the shortest frame: MAVLink 1 without a payload. No other has a higher cost for each byte.
        const SHORTEST: u64 = 8;
        /// The cost of the shortest frame: also of its bytes, with some slack.
        const WORK: u64 = (HANDLED + LOOKED_AT + 40) as u64;
        /// A byte takes ten bits on the line. Two less are a margin of a quarter, for polls that are late.
        const BITS: u64 = 8;
        const fn at_least(least: u32, value: u64) -> u32 {
            if value < least as u64 { least } else { value as u32 }
        }
        let bytes = (baud as u64).saturating_mul(period.as_micros()).div_ceil(BITS * 1_000_000);
        let frames = bytes.div_ceil(SHORTEST);
        let work = frames.saturating_mul(WORK);
        assert!(
            work <= u32::MAX as u64,
            "no budget is enough for so many bytes between two polls: poll the link more often"
        );
        let least = Self::DEFAULT;
        Self {
            rx_bytes: at_least(least.rx_bytes, bytes),
            work: at_least(least.work, work),
            frames: at_least(least.frames, frames),
            tx_bytes: at_least(least.tx_bytes, bytes),
        }
    }

    /// Returns the same budget, with which at least one frame can be handled.
    pub(crate) fn at_least_a_frame(self) -> Self {
        Self { work: self.work.max(Decoder::MIN_BUDGET), frames: self.frames.max(1), ..self }
    }

    /// Returns the allowance of one poll.
    pub(crate) const fn allowance(&self) -> Allowance {
        Allowance { work: self.work, frames: self.frames, hooks: Wrapping(0), answers: 0, has_sent: false }
    }
}

impl Default for PollBudget {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The cost of a frame that is handled, and of its answer.
const HANDLED: u32 = 520;
/// What a frame costs besides: a look at its sender, and at what it has caused. A frame is begun without it, or random bytes, in which
/// false frames are frequent, would be taken more slowly than a line of 115,200 baud brings them.
const LOOKED_AT: u32 = 40;
/// The cost of a frame that is sent and is no answer.
const MADE: u32 = 220;

/// The rest of a [`PollBudget`], except its bytes.
pub(crate) struct Allowance {
    pub(crate) work: u32,
    /// The number of frames that may still be handled.
    pub(crate) frames: u32,
    /// The number of hooks that received frames have called (X-6).
    pub(crate) hooks: Wrapping<u32>,
    /// The number of answers whose cost was already spent.
    answers: u32,
    /// Whether a frame was sent.
    has_sent: bool,
}

impl Allowance {
    /// Whether another frame may be handled. The first always may.
    pub(crate) fn may_handle(&self) -> bool {
        self.frames > 0 && (self.answers == 0 || self.work >= HANDLED)
    }

    /// Spends the cost of a frame that is handled.
    pub(crate) fn handle(&mut self) {
        self.frames = self.frames.saturating_sub(1);
        self.answers = self.answers.saturating_add(1);
        self.spend(HANDLED + LOOKED_AT);
    }

    /// Whether another frame may be sent. The first always may, and an answer to each frame that was handled.
    pub(crate) fn may_send(&self) -> bool {
        !self.has_sent || self.answers > 0 || self.work >= MADE
    }

    /// Spends the cost of a frame that is sent, and of its signature.
    pub(crate) fn send(&mut self, signature: u32) {
        self.has_sent = true;
        self.spend(if self.answers > 0 { signature } else { MADE.saturating_add(signature) });
        self.answers = self.answers.saturating_sub(1);
    }

    pub(crate) fn spend(&mut self, work: u32) {
        self.work = self.work.saturating_sub(work);
    }

    /// Spends `work`, but leaves enough for the longest frame if there was that much.
    pub(crate) fn spend_but_for_a_frame(&mut self, work: u32) {
        let least = self.work.min(Decoder::MIN_BUDGET);
        self.work = self.work.saturating_sub(work).max(least);
    }
}

/// Whether an accepted upload or clear is stored before or after it is answered (M-44).
///
/// ```text
///                        ┌─ Durable:  committing ── written and read back ──▶ live, ACK ACCEPTED
///   last item, or clear ─┤                 └─── write failed, or refused ───▶ old plan stays, ACK ERROR or DENIED
///                        ├─ Deferred: live, ACK ACCEPTED; written when the vehicle permits
///                        └─ no storage: live, ACK ACCEPTED
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Durability {
    /// ACCEPTED means that the change survives a power cut: it is written first, and then goes live. While
    /// [`may_persist`](crate::Vehicle::may_persist) returns false, as it does by default while armed, changes are DENIED when
    /// they begin, and uploads also at their last item.
    Durable,
    /// The change goes live and is answered at once. It is written when the vehicle permits; a text reports a failure.
    Deferred,
}

/// The configuration of a [`Stack`](struct@crate::Stack). Make it a `const`: then the compiler refuses invalid values.
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
    /// Our system (1 to 254) and component (1 to 255): the source of every frame that the stack sends (H-2). A parameter that is
    /// declared as the system id replaces the system: see [`parameters!`](crate::parameters).
    pub address: VehicleAddress,
    /// The pulse that the flight loop ticks. Without ticks there are no heartbeats (H-5). `None`: no heartbeats at all.
    pub pulse: Option<&'static Pulse>,
    /// HEARTBEAT.type: [`MavType::QUADROTOR`] by default. Ground stations ignore a type that is not a vehicle's (H-3).
    pub r#type: MavType,
    /// HEARTBEAT.autopilot: [`MavAutopilot::GENERIC`] by default. Change it only if the firmware has the mode numbers
    /// and parameters of that autopilot (H-3).
    pub autopilot: MavAutopilot,
    /// The content of AUTOPILOT_VERSION.
    pub identity: Identity,
    /// The time between heartbeats on a link: 1 s by default (H-1). A value below 10 ms counts as that.
    pub heartbeat_period: Duration,
    /// How long a pass of the flight loop may take before the heartbeats stop: 500 ms by default (H-5). Poll the stack
    /// more often than this, or as [`next_deadline`](crate::Stack::next_deadline) requires.
    pub max_loop_gap: Duration,
    /// The time without a heartbeat after which a peer has timed out: 5 s by default (H-11).
    pub peer_timeout: Duration,
    /// How far a peer's clock may be ahead of the time that the vehicle has set by `Signing::set_time` (feature
    /// `signing`): ten minutes by default. A signed frame from further ahead is refused (G-17).
    pub max_signing_lead: Duration,
    /// The time without a new byte after which the start of a frame is dropped: 500 ms by default (SEC-4).
    pub stale_after: Duration,
    /// Whether a link's streams wait until a peer on the link is alive (H-8); heartbeats never wait. False by default:
    /// ground stations need not ask for telemetry that is already there.
    pub streams_wait_for_peer: bool,
    /// Whether frames with source component 0 are accepted: true by default (S-11). MAVLink does not allow them, but
    /// pymavlink's `mavlink_connection` sends them unless `source_component` is given. PX4 and ArduPilot answer them.
    /// Answers are addressed to component 0 of that system. If false, such frames are dropped and counted in
    /// [`zero_source`](crate::frame::RxCounters::zero_source).
    pub accepts_component_0: bool,
    /// The budget of one [`poll_link`](crate::Stack::poll_link).
    pub budget: PollBudget,
    /// Whether the old MISSION_REQUEST is answered by the old MISSION_ITEM, whose positions are floats: true by default,
    /// because a client that uses the old request expects the old item. PX4 and ArduPilot do the same. If false, the answer
    /// is MISSION_ITEM_INT, as the current definitions require (M-61).
    pub float_mission_items: bool,
    /// Whether the MISSION_ACK that accepts an upload is sent again 400 ms later, for lossy links: false by default.
    /// QGroundControl fails an upload whose final answer is lost, and does not ask again (M-31). A client that clears
    /// the same plan within these 400 ms takes the second MISSION_ACK for the answer to that.
    pub second_mission_ack: bool,
    /// How many times MISSION_ITEM_REACHED is repeated, once a second, for lossy links: 0 by default. A value above 3
    /// counts as 3 (M-91).
    pub item_reached_repeats: u8,
    /// The time in which a store regains one token for a write that a peer causes: 15 minutes by default (C-15).
    /// [`Duration::ZERO`] disables the limit, for FRAM.
    ///
    /// Each store (plans, parameters, key) has a token bucket of 128 tokens, which is full at the start. These writes
    /// take tokens:
    ///
    /// | write | tokens |
    /// |---|---|
    /// | the parameters, the key, the clearing of a plan | 1 |
    /// | a plan of up to a quarter of plan memory | 1 |
    /// | a plan that fills plan memory | 4 |
    ///
    /// Without a token, a plan is DENIED at its beginning, MAV_CMD_PREFLIGHT_STORAGE is TEMPORARILY_REJECTED,
    /// SETUP_SIGNING is refused with a text, and changed parameters are written later. Writes by the vehicle itself are
    /// never refused.
    ///
    /// By default, a flooding peer causes 128 writes, then 96 a day. In a region of 64 KiB, that erases each unit some
    /// twenty times a day; with SETUP_SIGNING, which erases all units for each new key, some hundred times. In regular use, a day with 20 uploads that fill plan memory
    /// takes 80 tokens; 100 single parameter changes take 100 tokens of another bucket. A restart refills the buckets,
    /// so a peer that may restart the vehicle may cause more writes.
    pub storage_refill: Duration,
    /// Whether plans are stored before or after an upload is answered, if there is storage: [`Durability::Durable`] by
    /// default.
    pub durability: Durability,
    /// A random number that nobody else knows, such as one of the microcontroller's generator: 0 by default, which is none. It is
    /// the key by which forwarding recognises duplicates (X-8), together with the arrival times of frames and
    /// [`uid`](Identity::uid).
    pub seed: u64,
}

/// An address that a vehicle may have. No other can be configured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VehicleAddress(Address);

impl VehicleAddress {
    /// Returns `None` if the system is not 1 to 254, or the component is 0. System 0 means everyone, and 255 is a
    /// ground station's (H-2). Ground stations take only component 1 for the vehicle.
    pub const fn new(address: Address) -> Option<Self> {
        if address.system.is_all() || address.system.wire() == 255 || address.component.is_all() {
            return None;
        }
        Some(Self(address))
    }

    /// Returns the address.
    pub const fn get(self) -> Address {
        self.0
    }

    /// Returns this address with another system id; the same address if no vehicle may have that.
    pub(crate) fn with_system(self, system: SystemId) -> Self {
        Self::new(Address { system, ..self.get() }).unwrap_or(self)
    }
}

impl Config {
    /// The configuration of a stack before it is begun: all zero bits.
    pub(crate) const VACANT: Self = Self {
        address: VehicleAddress(Address::new(0, 0)),
        pulse: None,
        r#type: MavType(0),
        autopilot: MavAutopilot(0),
        identity: Identity::NONE,
        heartbeat_period: Duration::ZERO,
        max_loop_gap: Duration::ZERO,
        peer_timeout: Duration::ZERO,
        max_signing_lead: Duration::ZERO,
        stale_after: Duration::ZERO,
        streams_wait_for_peer: false,
        accepts_component_0: false,
        budget: PollBudget { rx_bytes: 0, work: 0, frames: 0, tx_bytes: 0 },
        float_mission_items: false,
        second_mission_ack: false,
        item_reached_repeats: 0,
        storage_refill: Duration::ZERO,
        durability: Durability::Durable,
        seed: 0,
    };

    /// Returns the default configuration of a vehicle with this address and pulse. Change other fields by struct
    /// update.
    ///
    /// # Panics
    ///
    /// Panics if [`VehicleAddress::new`] refuses `address`. In a `const` this is a compile error. For an address that
    /// is only known at run time, set [`address`](Self::address) to a checked one.
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
            pulse: Some(pulse),
            r#type: MavType::QUADROTOR,
            autopilot: MavAutopilot::GENERIC,
            identity: Identity::NONE,
            heartbeat_period: Duration::from_secs(1),
            max_loop_gap: Duration::from_millis(500),
            peer_timeout: Duration::from_secs(5),
            max_signing_lead: Duration::from_secs(10 * 60),
            stale_after: Decoder::STALE_AFTER,
            streams_wait_for_peer: false,
            accepts_component_0: true,
            budget: PollBudget::DEFAULT,
            float_mission_items: true,
            second_mission_ack: false,
            item_reached_repeats: 0,
            storage_refill: Duration::from_secs(15 * 60),
            durability: Durability::Durable,
            seed: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// D-2: a budget has a quarter more than the bytes of a period, and handles them as frames of 8 bytes.
    #[test]
    fn budgets_are_those_of_the_line() {
        // Baud, period (ms); bytes received, frames, work.
        for (baud, millis, bytes, frames, work) in [
            (57_600, 20, 144, 18, 10_800),
            (921_600, 1, 128, 15, 9_000),
            (921_600, 20, 2_304, 288, 172_800),
            (12_000_000, 1, 1_500, 188, 112_800),
            (12_000_000, 20, 30_000, 3_750, 2_250_000),
            (12_000_000, 100, 150_000, 18_750, 11_250_000),
        ] {
            let budget = PollBudget::for_link(baud, Duration::from_millis(millis));
            let expected = PollBudget { rx_bytes: bytes, work, frames, tx_bytes: bytes.max(280) };
            assert_eq!(budget, expected, "{baud} baud every {millis} ms");
        }
        // Nothing to receive.
        assert_eq!(PollBudget::for_link(0, Duration::from_secs(1)), PollBudget::DEFAULT);
        assert_eq!(PollBudget::for_link(u32::MAX, Duration::ZERO), PollBudget::DEFAULT);
    }

    /// D-2: no budget is cut off: one is the largest, and there is none beyond it.
    #[test]
    fn budgets_are_exact_up_to_the_last() {
        let largest = PollBudget::for_link(8_000, Duration::from_millis(57_266_224));
        assert_eq!((largest.rx_bytes, largest.frames), (57_266_224, 7_158_278));
        assert_eq!(largest.work, 4_294_966_800);
        let beyond = || PollBudget::for_link(8_000, Duration::from_millis(57_266_225));
        assert!(std::panic::catch_unwind(beyond).is_err());
    }
}
