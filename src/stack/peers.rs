//! The peers that were heard, and whether a ground station is alive (H-11, H-18).

use super::{Declares, PeerMemory, Stack};
use crate::network::PeerInfo;
use crate::service::holder::ControlSource;
use crate::time::Instant;

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the peers that were heard, as they are at `now`, with their link quality: at most as many as `peers` in
    /// [`#[stack]`](macro@crate::Stack) declares. [`PeerInfo`](PeerInfo#eviction-from-a-full-table) says which peer is evicted
    /// when the table is full.
    pub fn peers(&self, now: Instant) -> impl Iterator<Item = PeerInfo> {
        let (clock, timeout) = (self.shared.clock, self.config().peer_timeout);
        let now = clock.peek(now);
        self.peers.view().iter().map(move |info| info.at(now, timeout, &clock))
    }

    /// Whether any ground station is alive at `now`: it has sent a heartbeat of type GCS within
    /// [`peer_timeout`](crate::Config::peer_timeout), on any link but a high-latency one (H-11). A station with two links is
    /// alive while one of them works. The answer does not depend on the last [`poll`](Self::poll) (H-18).
    ///
    /// Ask in each pass of the loop, after [`poll`](Self::poll), for the failsafe of a vehicle that any station may fly.
    /// [`has_controller`](Self::has_controller) is for one that a certain station flies. [`Vehicle::peer`](crate::Vehicle::peer) is called for each
    /// peer on each link: use it for texts and for a display, because `Lost` there may be only one of two links.
    pub fn has_ground_station(&self, now: Instant) -> bool {
        self.has_controller(now, ControlSource::GroundStation)
    }

    /// Whether a ground station in control is alive at `now`, on any link: as [`has_ground_station`](Self::has_ground_station), but only
    /// the stations of `source` count. Take the source that the vehicle permits to command and to steer, for example the
    /// [source of manual control](crate::manual_control::ManualInput::source). Other components of such a system do not count:
    /// an antenna tracker may outlive its station.
    ///
    /// ```
    /// use mavstack::manual_control::ControlSource;
    /// use mavstack::message::SystemId;
    /// # use mavstack::prelude::*;
    /// # use mavstack::dialect;
    /// # struct Rover { is_stopped: bool }
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
    /// # }
    /// # #[derive(Stack)]
    /// # #[stack(vehicle: Rover, links: 2)]
    /// # struct Mavlink;
    /// /// Called in each pass of the loop.
    /// fn failsafe(stack: &StackOf<Mavlink>, now: Instant, rover: &mut Rover) {
    ///     if !stack.has_controller(now, ControlSource::System(SystemId::new(255))) {
    ///         rover.is_stopped = true;
    ///     }
    /// }
    /// ```
    pub fn has_controller(&self, now: Instant, source: ControlSource) -> bool {
        source.is_alive(self.peers(now))
    }
}
