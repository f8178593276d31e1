//! The same vehicle with texts, and missions of up to 100 items.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::{Instant, LinkConfig, LinkId, Stack, plan_memory};
use mavstack_size::{CONFIG, PULSE, Rover, Uart, now_micros};

#[cortex_m_rt::entry]
fn main() -> ! {
    // A static, so that its RAM is counted.
    static mut STACK: MaybeUninit<Stack<1, plan_memory!(mission: 100)>> = MaybeUninit::uninit();

    let mut uart = Uart;
    let mut rover = Rover::default();
    let stack = STACK.write(Stack::new(CONFIG, [LinkConfig::uart(57_600)]));
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.poll(now, &mut rover);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, &mut rover);
    }
}
