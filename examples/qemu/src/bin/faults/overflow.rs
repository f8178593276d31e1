//! A stack that is too small, and what becomes of it: it lies below everything else (`flipped.x`), and whoever leaves it leaves
//! the RAM, which is a fault at once. On the emulated board the bus answers there too: a region of the MPU stands in for one
//! that does not.
#![allow(unsafe_code, reason = "the registers of the MPU and of faults, and memory where no stack may be")]

use core::arch::{asm, global_asm};
use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::MPU;
use mavstack::dialect::MavMissionResult;
use mavstack::{Duration, Instant};
use mavstack_demo::TELEMETRY;
use semihosting::{println, process};

use crate::station::{Upload, upload};
use crate::world::{Parts, STATION, World};

unsafe extern "C" {
    /// Where RAM begins, and the stack's place ends.
    static _ram_start: u8;
    static _stack_end: u8;
    static _stack_start: u8;
}

fn address(symbol: &u8) -> u32 {
    core::ptr::from_ref(symbol) as usize as u32
}

/// What a stack without a guard would run into first.
#[unsafe(link_section = ".uninit.canary")]
static CANARY: [AtomicU32; 512] = [const { AtomicU32::new(0) }; 512];
const LIVE: u32 = 0x5A17_C0DE;

/// The stack's size now; 0 when no fault is expected.
static SIZE: AtomicU32 = AtomicU32::new(0);
static WORLD: Mutex<RefCell<Option<World>>> = Mutex::new(RefCell::new(None));

// The stack is gone when this runs: it takes the end of RAM, which is free where the stack is not.
global_asm!(
    ".section .HardFault.faults,\"ax\"",
    ".global HardFault",
    ".type HardFault,%function",
    ".thumb_func",
    "HardFault:",
    "mrs r0, msp",
    "ldr r1, =_ram_end",
    "msr msp, r1",
    "b {handler}",
    ".ltorg",
    ".size HardFault, . - HardFault",
    handler = sym on_fault,
);

/// Below RAM there is nothing.
pub fn guard() {
    const START: u32 = 0x1FFF_0000;
    // 2^16 bytes; never executed, no access; enabled.
    const ATTRIBUTES: u32 = 1 << 28 | 15 << 1 | 1;
    // All else is as without it.
    const DEFAULT_MAP_ENABLED: u32 = 0b101;
    // SAFETY: registers of the processor, which nothing else uses; memory that is in use stays as it is.
    unsafe {
        let mpu = &*MPU::PTR;
        mpu.rnr.write(0);
        mpu.rbar.write(START);
        mpu.rasr.write(ATTRIBUTES);
        mpu.ctrl.write(DEFAULT_MAP_ENABLED);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

const CFSR: usize = 0xE000_ED28;
const MMFAR: usize = 0xE000_ED34;
/// Bits of CFSR: while an exception was entered; at a known address, in MMFAR.
const WHILE_STACKING: u32 = 1 << 4;
const KNOWS_ADDRESS: u32 = 1 << 7;

extern "C" fn on_fault(pointer: u32) -> ! {
    // SAFETY: registers of the processor.
    let [cause, place] =
        [CFSR, MMFAR].map(|register| unsafe { core::ptr::with_exposed_provenance::<u32>(register).read_volatile() });
    let size = SIZE.load(Relaxed);
    let changed = changed();
    // SAFETY: only its address is taken.
    let bottom = address(unsafe { &_ram_start });
    let place = if cause & KNOWS_ADDRESS != 0 { place } else { pointer };
    if size == 0 {
        println!("a fault at {place:#x}, cause {cause:#x}, stack pointer {pointer:#x}");
        process::exit(1);
    }
    let is_guard = cause & (WHILE_STACKING | KNOWS_ADDRESS) != 0 && place < bottom && bottom - place <= 8_192;
    if changed != 0 || !is_guard {
        println!(
            "a stack of {size} bytes: a fault at {place:#x} (cause {cause:#x}), {changed} words of others changed"
        );
        process::exit(1);
    }
    println!("stack-overflow {size} fault {}", bottom - place);
    process::exit(0)
}

/// Words of the canary that are not what they were.
fn changed() -> usize {
    CANARY.iter().filter(|word| word.load(Relaxed) != LIVE).count()
}

/// What the vehicle does all day, and an upload.
extern "C" fn work() {
    free(|cs| {
        if let Some(world) = WORLD.borrow(cs).borrow_mut().as_mut() {
            let mut upload = Upload::new(TELEMETRY, STATION, 10, 2);
            world.run(Duration::from_secs(3), &mut [&mut upload]);
            assert!(upload.result == Some(MavMissionResult::ACCEPTED), "{:?}", upload.result);
        }
    });
}

/// The same on a stack of `size` bytes: it is enough, or there is a fault at once, and nothing else has changed.
pub fn run(parts: Parts, size: u32) -> ! {
    let mut world = World::fresh(parts);
    world.run(Duration::from_secs(1), &mut []);
    assert!(upload(&mut world, TELEMETRY, STATION, 10, 1) == MavMissionResult::ACCEPTED && world.now > Instant::ZERO);
    free(|cs| WORLD.borrow(cs).replace(Some(world)));
    CANARY.iter().for_each(|word| word.store(LIVE, Relaxed));
    // SAFETY: only their addresses are taken.
    let (bottom, top) = unsafe { (address(&_stack_end), address(&_stack_start)) };
    assert!(size.is_multiple_of(8) && bottom + size + 1_024 <= top, "a stack of {size} bytes: it has {}", top - bottom);
    SIZE.store(size, Relaxed);
    let entry = work as extern "C" fn();
    // SAFETY: the stack pointer goes to within the stack's place, far below what is in use of it; and comes back.
    unsafe {
        asm!(
            "mov r4, sp",
            "mov sp, r0",
            "blx r1",
            "mov sp, r4",
            inlateout("r0") bottom + size => _,
            inlateout("r1") entry => _,
            out("r2") _, out("r3") _, out("r4") _, out("r12") _, out("lr") _,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
        );
    }
    SIZE.store(0, Relaxed);
    let changed = changed();
    assert!(changed == 0, "a stack of {size} bytes: no fault, and {changed} words of others changed");
    println!("stack-overflow {size} enough 0");
    process::exit(0)
}
