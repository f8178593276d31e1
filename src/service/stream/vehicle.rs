//! The vehicle's hooks for telemetry.

use super::table::Stream;
use crate::link::Outbox;
use crate::message::{Address, ComponentId, Message};
use crate::service::Cx;
use crate::time::Instant;
use crate::types::{Firmware, LinkId};

/// Telemetry: the messages that the vehicle fills, on request and in streams. For a vehicle that declares `streams` in
/// [`#[stack]`](macro@crate::Stack).
///
/// Start from a message's constant `UNKNOWN` if you fill only a part of it. In most fields zero is a measured value,
/// such as an empty battery, and MAVLink has another value for "unknown". `Default` is zero in every field. The module
/// [`telemetry`](crate::telemetry) makes the usual messages from SI values.
///
/// ```
/// use mavstack::dialect::{Attitude, BatteryStatus, MavDataStream};
/// use mavstack::telemetry::{Battery, Motion};
/// use mavstack::{Duration, Fill, Message, Stream, Telemetry};
///
/// struct Rover { yaw: f32, cells: [f32; 4] }
///
/// impl Telemetry for Rover {
///     const STREAMS: &'static [Stream] = &[
///         Stream::of::<Attitude>().every(Duration::from_millis(250)).onboard(Duration::from_millis(20)),
///         Stream::of::<BatteryStatus>().every(Duration::from_secs(2)).in_group(MavDataStream::EXTRA3),
///     ];
///
///     fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
///         let motion = Motion { attitude: [0.0, 0.0, self.yaw], ..Motion::UNKNOWN };
///         let battery = Battery { cells: &self.cells, ..Battery::UNKNOWN };
///         match id {
///             Attitude::ID => out.put(&motion.attitude(out.now())),
///             // The second pack is not measured.
///             BatteryStatus::ID if out.index() == 0 => out.put(&battery.battery_status()),
///             _ => false,
///         }
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Telemetry`",
    note = "`streams` in `#[stack]` needs `impl Telemetry for {Self}`: write it, or leave `streams` out"
)]
pub trait Telemetry {
    /// The messages that the vehicle can fill, with their default intervals: at most
    /// [`MAX_STREAMS`](crate::limits::MAX_STREAMS). The stack has a slot for each of them on each link. A message that
    /// the stack sends itself does not compile.
    const STREAMS: &'static [Stream] = &[];

    /// Fills message `id` of [`STREAMS`](Self::STREAMS), passes it to [`Fill::put`], and returns its result. Return
    /// false if the message is not available now, such as a position without a fix: a request is then refused (Q-1),
    /// and a stream skips it. Also called to find out whether the message is available, so it must have no side
    /// effects.
    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let _ = (id, out);
        false
    }
}

/// Asks the vehicle for the message of a row, and sends it from its component. `is_probe`: only checks whether it is
/// available.
pub(super) fn fill_row<F: Firmware<Vehicle: Telemetry>>(
    cx: &mut Cx<'_, F>,
    outbox: &mut Outbox,
    stream: &Stream,
    index: u16,
    is_probe: bool,
) -> bool {
    outbox.as_component::<F>(Some(stream.component), |outbox| {
        fill(cx.vehicle, &mut Fill::new(cx.now, stream.id, index, outbox, is_probe))
    })
}

/// Asks the vehicle for a message.
pub(super) fn fill<V: Telemetry>(vehicle: &mut V, out: &mut Fill<'_>) -> bool {
    vehicle.fill(out.id, out)
}

/// Takes the message that a vehicle was asked for; see [`Telemetry::fill`].
#[derive(Debug)]
pub struct Fill<'a> {
    now: Instant,
    id: u32,
    index: u16,
    target: Address,
    outbox: &'a mut Outbox,
    /// Only checks whether the message is available; it is not sent yet.
    is_probe: bool,
}

impl<'a> Fill<'a> {
    pub(crate) fn new(now: Instant, id: u32, index: u16, outbox: &'a mut Outbox, is_probe: bool) -> Self {
        Self { now, id, index, target: Address::new(0, 0), outbox, is_probe }
    }

    /// Sets the address to which the message is sent.
    pub(crate) fn to(mut self, target: Address) -> Self {
        self.target = target;
        self
    }

    /// Returns the time of the call by the firmware's clock, for the time fields.
    pub fn now(&self) -> Instant {
        self.now - self.outbox.lead()
    }

    /// Returns which instance is wanted, such as which battery: parameter 2 of MAV_CMD_REQUEST_MESSAGE, whose meaning
    /// each message defines, the [`instance`](Stream::instance) of a stream, or the index that the vehicle gave to
    /// [`Context::send`](crate::Context::send) (Q-3).
    pub fn index(&self) -> u16 {
        self.index
    }

    /// Returns the address for the target fields of the message: the peer to which the vehicle
    /// [sends](crate::Context::send) it; 0/0, which is everyone, in a stream or on request.
    pub fn target(&self) -> Address {
        self.target
    }

    /// Returns the component that sends it: the autopilot, or the one of the stream's [row](Stream::of_component).
    pub fn component(&self) -> ComponentId {
        self.outbox.component()
    }

    /// Returns the link on which it is sent.
    pub fn link(&self) -> LinkId {
        self.outbox.link()
    }

    /// Sends the message. Returns false if it cannot be sent: it is not the requested message, the link sends MAVLink
    /// 1, which has no such id (S-10), or it is HIGH_LATENCY2, which the stack sends itself (L-2).
    #[must_use]
    pub fn put<M: Message>(&mut self, message: &M) -> bool {
        if M::ID != self.id || !self.outbox.takes(M::ID) {
            return false;
        }
        self.is_probe || self.outbox.send(message)
    }
}
