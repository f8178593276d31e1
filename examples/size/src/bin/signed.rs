//! The vehicle of `heartbeat`, which signs, and wants signatures.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::{Instant, LinkConfig, LinkId, LinkSigning, NoPlans, Stack};
use mavstack_size::{CONFIG, PULSE, Rover, Uart, now_micros};

#[cortex_m_rt::entry]
fn main() -> ! {
    // Statics, so that their RAM is counted.
    static mut STACK: MaybeUninit<Stack<1, NoPlans, 8, 0, 0>> = MaybeUninit::uninit();
    static mut ROVER: MaybeUninit<Rover> = MaybeUninit::uninit();

    const LINK: LinkConfig = LinkConfig::uart(57_600).with_signing(LinkSigning::SIGNED.with_provisioning());

    let mut uart = Uart;
    let rover = ROVER.write(Rover::default());
    let stack = STACK.write(Stack::with_capacities(CONFIG, [LINK]));
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.poll(now, rover);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, rover);
    }
}
