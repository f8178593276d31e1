//! A vehicle on a board: `docs/start.md`.

use mavstack::config::Identity;
use mavstack::dialect::MavType;
use mavstack::firmware_version;
use mavstack::io::{SerialQueues, queue_len};
use mavstack::prelude::*;
use static_cell::ConstStaticCell;

use crate::vehicle::{Boat, Mavlink};

static PULSE: Pulse = Pulse::new();

const CONFIG: Config = Config {
    r#type: MavType::SURFACE_BOAT,
    identity: Identity {
        flight_sw_version: firmware_version!(), // the version of the crate that this line is in
        board_version: 3,
        ..Identity::NONE
    },
    ..Config::new(Address::new(1, 1), &PULSE)
};

/// A timer of 32 bits at 1 MHz, extended to 64 bits. Read it at least once between two wraps.
struct Clock {
    high: u64,
    last: u32,
}

impl Clock {
    fn now(&mut self, timer: u32) -> Instant {
        if timer < self.last {
            self.high += 1 << 32;
        }
        self.last = timer;
        Instant::from_micros(self.high + u64::from(timer))
    }
}

const TELEM: LinkId = StackOf::<Mavlink>::link(0);
const QUEUE: usize = queue_len(57_600, Duration::from_millis(4));
static QUEUES: SerialQueues<QUEUE, QUEUE> = SerialQueues::new();
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);

fn run(board: &mut impl Board, boat: &mut Boat) -> ! {
    let mut clock = Clock { high: 0, last: 0 };
    let mut telem = QUEUES.loop_end();
    let stack = STACK.take();
    let identity = Identity { uid: board.unique_number(), ..CONFIG.identity };
    stack.begin(Config { identity, ..CONFIG }, [LinkConfig::uart(57_600)]);
    // With storage: `stack.restore(…)`, which takes the stored system id too.
    board.enable_uart_interrupt(); // last: it may fire at once
    loop {
        let now = clock.now(board.timer());
        boat.drive(now, stack); // sensors, control, motors
        PULSE.tick();
        stack.poll(now, boat);
        if let Err(error) = stack.poll_link(now, TELEM, &mut telem, boat) {
            let _ = error; // such as an overrun: counted in `stack.link_counters(TELEM)`, and the link keeps working
        }
        if telem.has_to_send() {
            board.enable_transmit_interrupt();
        }
    }
}

/// What a HAL has.
trait Board {
    fn timer(&mut self) -> u32;
    fn unique_number(&self) -> u64;
    fn enable_uart_interrupt(&mut self);
    fn enable_transmit_interrupt(&mut self);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::Tuning;
    use std::boxed::Box;

    #[test]
    fn the_clock_survives_a_wrap() {
        let mut clock = Clock { high: 0, last: 0 };
        clock.now(u32::MAX);
        assert_eq!(clock.now(1), Instant::from_micros((1 << 32) + 1));
    }

    #[test]
    fn the_parameter_is_the_system_id() {
        let stack = Box::new(StackOf::<Mavlink>::new(CONFIG, [LinkConfig::uart(57_600)]));
        assert_eq!(i32::from(stack.address().system.wire()), stack.parameters().get(Tuning::SYS_ID));
    }
}
