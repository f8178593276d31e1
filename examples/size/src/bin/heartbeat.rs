//! The smallest vehicle: heartbeat, commands and peers on one link, no texts, no streams, no plans.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::{Instant, LinkConfig, LinkId, NoPlans, Stack};
use mavstack_size::{CONFIG, PULSE, Rover, Uart, now_micros};

#[cortex_m_rt::entry]
fn main() -> ! {
    // A static, so that its RAM is counted.
    static mut STACK: MaybeUninit<Stack<1, NoPlans, 8, 0, 0>> = MaybeUninit::uninit();

    let mut uart = Uart;
    let mut rover = Rover::default();
    let stack = STACK.write(Stack::with_capacities(CONFIG, [LinkConfig::uart(57_600)]));
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.poll(now, &mut rover);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, &mut rover);
    }
}
