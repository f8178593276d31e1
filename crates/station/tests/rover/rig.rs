//! The rover in a rig.

use mavstack::prelude::*;
use mavstack::storage::Store;
use mavstack_rover::{LINKS, Mavlink, Rover, config};
use mavstack_station::kit::{self, Board, Firmware, LineConfig, Port, RamFlash, Rig};
use mavstack_station::{GroundStation, Station};

/// The flash of the board: 4 KiB sectors, words of 4 bytes.
type Flash = RamFlash<4, 4_096>;

/// The rover as the rig runs it: what `main` has on a board.
pub struct Tested {
    pub stack: Box<StackOf<Mavlink>>,
    pub rover: Rover,
    store: Store<Flash>,
    /// When the rover reaches the item that it drives to.
    arrival: Option<Instant>,
}

impl Tested {
    /// Starts as `main` does after a reset.
    pub fn boot(board: &Board) -> Self {
        let (pulse, len) = (kit::pulse(), Store::<Flash>::region_len::<Mavlink>());
        let stack = StackOf::<Mavlink>::new(config(pulse), [LinkConfig::uart(57_600); LINKS]);
        let store = Store::new(board.flash(len), 0..len);
        let mut tested = Self { stack: Box::new(stack), rover: Rover::new(pulse), store, arrival: None };
        let _ = tested.stack.restore(Instant::ZERO, &mut tested.store, &mut tested.rover);
        tested
    }
}

impl Firmware for Tested {
    fn fly(&mut self, now: Instant) {
        self.rover.drive(now, &mut self.stack);
        // The world: each item is reached in ten seconds.
        let is_driving = self.rover.target(&self.stack).is_some();
        self.arrival = is_driving.then(|| self.arrival.unwrap_or(now + Duration::from_secs(10)));
        if self.arrival.is_some_and(|at| now >= at) {
            self.rover.reached(now, &mut self.stack);
            self.arrival = None;
        }
    }

    fn poll(&mut self, now: Instant, ports: &mut [Port]) {
        self.stack.poll(now, &mut self.rover);
        for (link, port) in (0..).map(LinkId).zip(ports) {
            let _ = self.stack.poll_link(now, link, port, &mut self.rover);
        }
        self.stack.persist(now, &mut self.store, &mut self.rover);
    }
}

/// Returns a rover with a radio, and a station that is connected to it.
pub fn rig(station: impl Into<Station>) -> Rig<Tested> {
    let radio = LineConfig::radio(57_600, Duration::from_millis(20));
    let mut rig = Rig::new(Tested::boot).with_line(radio, station);
    rig.connect().expect("a vehicle");
    rig
}

/// Returns the mode that the station shows.
pub fn mode(rig: &Rig<Tested>) -> Option<u32> {
    Some(rig.seen().vehicles().next()?.heartbeat?.custom_mode)
}
