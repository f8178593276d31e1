//! The rover in a rig.

use mavstack::prelude::*;
use mavstack::storage::Store;
use mavstack_rover::{LINKS, Mavlink, Rover, config};
use mavstack_station::Station;
use mavstack_station::kit::{self, Board, Firmware, LineConfig, Port, RamFlash, Rig};

/// The flash of the board: 4 KiB sectors, words of 4 bytes.
type Flash = RamFlash<4, 4_096>;

/// The rover as the rig runs it: what `main` has on a board.
pub struct Tested {
    pub stack: Box<StackOf<Mavlink>>,
    pub rover: Rover,
    store: Store<Flash>,
}

impl Tested {
    /// Starts as `main` does after a reset.
    fn boot(board: &Board) -> Self {
        let (pulse, len) = (kit::pulse(), Store::<Flash>::region_len::<Mavlink>());
        let stack = StackOf::<Mavlink>::new(config(pulse), [LinkConfig::uart(57_600); LINKS]);
        let store = Store::new(board.flash(len), 0..len);
        let mut tested = Self { stack: Box::new(stack), rover: Rover::new(pulse), store };
        let _ = tested.stack.restore(Instant::ZERO, &mut tested.store, &mut tested.rover);
        tested
    }
}

impl Firmware for Tested {
    fn fly(&mut self, now: Instant) {
        self.rover.drive(now, &mut self.stack);
    }

    fn poll(&mut self, now: Instant, ports: &mut [Port]) {
        self.stack.poll(now, &mut self.rover);
        for (link, port) in (0..).map(LinkId).zip(ports) {
            let _ = self.stack.poll_link(now, link, port, &mut self.rover);
        }
        self.stack.persist(now, &mut self.store, &mut self.rover);
    }
}

/// Returns a rover with one line.
pub fn rig(line: LineConfig, station: impl Into<Station>) -> Rig<Tested> {
    Rig::new(Tested::boot).with_line(line, station)
}
