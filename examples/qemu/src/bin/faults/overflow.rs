//! Stack overflow. The stack lies below all statics (`flipped.x`), so an overflow leaves the RAM and faults at once. The
//! emulated bus responds below the RAM too, so an MPU region makes the access fault.
#![allow(unsafe_code, reason = "registers of the MPU and fault status, and the stack pointer")]

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
    /// Start of RAM, and the bounds of the stack.
    static _ram_start: u8;
    static _stack_end: u8;
    static _stack_start: u8;
}

fn address(symbol: &u8) -> u32 {
    core::ptr::from_ref(symbol) as usize as u32
}

/// Memory that an unguarded stack would overwrite first.
#[unsafe(link_section = ".uninit.canary")]
static CANARY: [AtomicU32; 512] = [const { AtomicU32::new(0) }; 512];
const LIVE: u32 = 0x5A17_C0DE;

/// The size of the stack under test; 0 when no fault is expected.
static SIZE: AtomicU32 = AtomicU32::new(0);
static WORLD: Mutex<RefCell<Option<World>>> = Mutex::new(RefCell::new(None));

// The stack pointer is invalid when this runs. The handler uses the end of RAM, which is free.
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

/// Makes accesses below RAM fault.
pub fn guard() {
    const START: u32 = 0x1FFF_0000;
    // 2^16 bytes, execute-never, no access, enabled.
    const ATTRIBUTES: u32 = 1 << 28 | 15 << 1 | 1;
    // Enables the MPU; all other memory keeps the default map.
    const DEFAULT_MAP_ENABLED: u32 = 0b101;
    // SAFETY: registers of the processor, which nothing else uses. Access to memory in use does not change.
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
// Bits of CFSR: a fault during exception entry; a valid address in MMFAR.
const WHILE_STACKING: u32 = 1 << 4;
const KNOWS_ADDRESS: u32 = 1 << 7;

extern "C" fn on_fault(pointer: u32) -> ! {
    // SAFETY: registers of the processor.
    let [cause, address_register] =
        [CFSR, MMFAR].map(|register| unsafe { core::ptr::with_exposed_provenance::<u32>(register).read_volatile() });
    let size = SIZE.load(Relaxed);
    let changed = changed();
    // SAFETY: only its address is taken.
    let bottom = address(unsafe { &_ram_start });
    let location = if cause & KNOWS_ADDRESS != 0 { address_register } else { pointer };
    if size == 0 {
        println!("fault at {location:#x}, cause {cause:#x}, stack pointer {pointer:#x}");
        process::exit(1);
    }
    let is_guard = cause & (WHILE_STACKING | KNOWS_ADDRESS) != 0 && location < bottom && bottom - location <= 8_192;
    if changed != 0 || !is_guard {
        println!("stack of {size} bytes: fault at {location:#x} (cause {cause:#x}), {changed} canary words changed");
        process::exit(1);
    }
    println!("stack-overflow {size} fault {}", bottom - location);
    process::exit(0)
}

/// Returns the number of canary words that have changed.
fn changed() -> usize {
    CANARY.iter().filter(|word| word.load(Relaxed) != LIVE).count()
}

/// Normal operation, and an upload.
extern "C" fn work() {
    free(|cs| {
        if let Some(world) = WORLD.borrow(cs).borrow_mut().as_mut() {
            let mut upload = Upload::new(TELEMETRY, STATION, 10, 2);
            world.run(Duration::from_secs(3), &mut [&mut upload]);
            assert!(upload.result == Some(MavMissionResult::ACCEPTED), "{:?}", upload.result);
        }
    });
}

/// Runs `work` on a stack of `size` bytes. It must succeed, or fault at once without changing other memory.
pub fn run(parts: Parts, size: u32) -> ! {
    let mut world = World::fresh(parts);
    world.run(Duration::from_secs(1), &mut []);
    assert!(upload(&mut world, TELEMETRY, STATION, 10, 1) == MavMissionResult::ACCEPTED && world.now > Instant::ZERO);
    free(|cs| WORLD.borrow(cs).replace(Some(world)));
    CANARY.iter().for_each(|word| word.store(LIVE, Relaxed));
    // SAFETY: only their addresses are taken.
    let (bottom, top) = unsafe { (address(&_stack_end), address(&_stack_start)) };
    assert!(
        size.is_multiple_of(8) && bottom + size + 1_024 <= top,
        "stack of {size} bytes: only {} available",
        top - bottom
    );
    SIZE.store(size, Relaxed);
    let entry = work as extern "C" fn();
    // SAFETY: the new stack pointer lies within the stack, far below the part in use, and is restored afterwards.
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
    assert!(changed == 0, "stack of {size} bytes: no fault, but {changed} canary words changed");
    println!("stack-overflow {size} enough 0");
    process::exit(0)
}
