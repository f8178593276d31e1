//! The vehicle's hooks for telemetry.

use super::{Fill, Stream};

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
    /// [`MAX_STREAMS`](crate::limits::MAX_STREAMS). The stack has a slot for each of them on each link. A message that the
    /// stack sends itself does not compile.
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
