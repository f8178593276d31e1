//! The peers that were heard, and whether a ground station is alive (H-11).

use super::{Declares, PeerMemory, Stack};
use crate::network::PeerInfo;
use crate::service::manual_control::ControlSource;

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the peers that were heard, with their link quality: at most as many as `peers` in
    /// [`stack!`](crate::stack) declares. [`PeerInfo`](PeerInfo#eviction-from-a-full-table) says which peer is evicted
    /// when the table is full.
    pub fn peers(&self) -> &[PeerInfo] {
        self.peers.view()
    }

    /// Whether any ground station is alive: it has sent a heartbeat of type GCS within
    /// [`peer_timeout`](crate::Config::peer_timeout), on any link but a high-latency one (H-11). A station with two links is
    /// alive while one of them works.
    ///
    /// Ask in each pass of the loop, after [`poll`](Self::poll), for the failsafe of a vehicle that any station may fly.
    /// [`has_controller`](Self::has_controller) is for one that a certain station flies. [`Vehicle::peer`](crate::Vehicle::peer) is called for each
    /// peer on each link: use it for texts and for a display, because `Lost` there may be only one of two links.
    pub fn has_ground_station(&self) -> bool {
        self.peers().iter().any(PeerInfo::is_living_station)
    }

    /// Whether a ground station in control is alive, on any link: as [`has_ground_station`](Self::has_ground_station), but only
    /// the stations of `source` count. Take the source that the vehicle permits to command and to steer, for example the
    /// [source of manual control](crate::manual_control::ManualInput::source). Other components of such a system do not count:
    /// an antenna tracker may outlive its station.
    ///
    /// ```
    /// use mavstack::manual_control::ControlSource;
    /// use mavstack::message::SystemId;
    /// # use mavstack::*;
    /// # struct Rover { is_stopped: bool }
    /// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
    /// # impl Commands for Rover {
    /// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { dialect::MavResult::UNSUPPORTED.into() }
    /// # }
    /// # stack! {
    /// #     struct Mavlink for Rover { links: 2 }
    /// # }
    /// /// Called in each pass of the loop.
    /// fn failsafe(stack: &Mavlink, rover: &mut Rover) {
    ///     if !stack.has_controller(ControlSource::System(SystemId(255))) {
    ///         rover.is_stopped = true;
    ///     }
    /// }
    /// ```
    pub fn has_controller(&self, source: ControlSource) -> bool {
        source.is_alive(self.peers.view())
    }
}
