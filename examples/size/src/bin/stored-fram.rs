//! The vehicle of `plans`, whose missions are kept in an FRAM.
#![no_std]
#![no_main]

use core::mem::MaybeUninit;

use mavstack::{Durability, Fram, Instant, LinkConfig, LinkId, PlanStore, Stack, plan_memory};
use mavstack_size::storage::Spi;
use mavstack_size::{CONFIG, PULSE, Rover, Uart, now_micros};

#[cortex_m_rt::entry]
fn main() -> ! {
    // A static, so that its RAM is counted.
    static mut STACK: MaybeUninit<Stack<1, plan_memory!(mission: 100)>> = MaybeUninit::uninit();

    let mut uart = Uart;
    let mut rover = Rover::default();
    let stack = STACK.write(Stack::new(CONFIG, [LinkConfig::uart(57_600)]));
    let Ok(fram) = Fram::new(Spi) else {
        loop {
            cortex_m::asm::wfi();
        }
    };
    let mut store = PlanStore::new(fram, 0..PlanStore::<Fram<Spi>>::region_len(100, 0, 0));
    let _ = stack.restore_plans(Instant::ZERO, &mut store, Durability::Durable, &mut rover);
    loop {
        let now = Instant::from_micros(now_micros());
        PULSE.tick();
        stack.poll(now, &mut rover);
        let _ = stack.poll_link(now, LinkId(0), &mut uart, &mut rover);
        stack.persist_plans(now, &mut store, &mut rover);
    }
}
