//! A flight loop that hangs while a timer interrupt runs the stack, in real (emulated) time.

use core::cell::{Cell, RefCell};
use core::sync::atomic::{AtomicBool, Ordering::Relaxed};

use cortex_m::interrupt::{Mutex, free};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;
use mavstack::dialect::{MavMissionResult, MavParamType, ParamSet};
use mavstack::{Duration, Instant, Text};
use mavstack_demo::{COMPANION, TELEMETRY};
use mavstack_qemu::board::{self, CLOCK_HZ};
use semihosting::println;

use crate::station::{Pinger, Upload};
use crate::world::{OTHER, Parts, STATION, World};

/// The default of `Config::max_loop_gap`.
const MAX_LOOP_GAP: Duration = Duration::from_millis(500);
/// Time from the start: shortly before a heartbeat, which is still sent.
const HANGS_AT: Duration = Duration::from_millis(3_600);
const RESUMES_AT: Duration = Duration::from_secs(9);
const ENDS_AT: Duration = Duration::from_secs(12);

/// The state of the interrupt.
struct Scene {
    world: World,
    began: Instant,
    pinger: Pinger,
    /// Starts while flight hangs.
    upload: Upload,
    /// Whether the commands to hang and to resume were sent.
    is_sent: [bool; 2],
    /// When flight hung.
    hung: Option<Instant>,
    pings_before: u32,
    last_heartbeat: Duration,
    resumed: Option<Instant>,
    first_heartbeat: Duration,
    pings: u32,
}

static SCENE: Mutex<RefCell<Option<Scene>>> = Mutex::new(RefCell::new(None));
static HANGS: AtomicBool = AtomicBool::new(false);
static IS_OVER: AtomicBool = AtomicBool::new(false);
static HUNG: Mutex<Cell<Option<Instant>>> = Mutex::new(Cell::new(None));

/// Every millisecond.
#[exception]
fn SysTick() {
    free(|cs| {
        if let Some(scene) = SCENE.borrow(cs).borrow_mut().as_mut() {
            scene.hung = HUNG.borrow(cs).get();
            scene.step(board::now());
        }
    });
}

impl Scene {
    fn step(&mut self, now: Instant) {
        let since = now - self.began;
        let set_hang = |world: &mut World, param_value| {
            let set = ParamSet {
                target_system: 1,
                target_component: 1,
                param_id: Text::new("SIM_HANG"),
                param_type: MavParamType::INT32,
                // Integers are sent bytewise.
                param_value: f32::from_bits(param_value),
            };
            world.network.send(TELEMETRY, STATION, &set);
        };
        for (at, value, index) in [(HANGS_AT, 1, 0), (RESUMES_AT, 0, 1)] {
            if since >= at && !self.is_sent[index] {
                self.is_sent[index] = true;
                set_hang(&mut self.world, value);
                if value == 0 {
                    self.pings = self.pinger.answers - self.pings_before;
                } else {
                    self.pings_before = self.pinger.answers;
                }
            }
        }
        let heartbeats = self.world.tally[0].heartbeats;
        if self.hung.is_some() {
            self.world.serve(now, &mut [&mut self.pinger, &mut self.upload]);
        } else {
            self.world.serve(now, &mut [&mut self.pinger]);
        }
        let has_heartbeat = self.world.tally[0].heartbeats > heartbeats;
        if let Some(hung) = self.hung
            && has_heartbeat
        {
            if HANGS.load(Relaxed) {
                self.last_heartbeat = now - hung;
            } else if self.first_heartbeat == Duration::ZERO {
                self.first_heartbeat = self.resumed.map_or(Duration::MAX, |resumed| now - resumed);
            }
        }
        // The parameter was reset: flight resumes.
        if HANGS.load(Relaxed) && self.is_sent[1] && !self.world.app().simulates_hang() {
            self.resumed = Some(now);
            HANGS.store(false, Relaxed);
        }
        if since >= ENDS_AT {
            IS_OVER.store(true, Relaxed);
        }
    }
}

/// Runs flight in the main loop and the stack in an interrupt, and hangs the main loop.
pub fn hung_loop(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    world.step = Duration::from_millis(1);
    let began = board::now();
    let scene = Scene {
        world,
        began,
        pinger: Pinger::new(COMPANION, OTHER, Duration::from_millis(50)),
        upload: Upload::new(COMPANION, OTHER, 30, 1),
        is_sent: [false; 2],
        hung: None,
        pings_before: 0,
        last_heartbeat: Duration::ZERO,
        resumed: None,
        first_heartbeat: Duration::ZERO,
        pings: 0,
    };
    free(|cs| SCENE.borrow(cs).replace(Some(scene)));
    let mut syst = cortex_m::Peripherals::take().expect("not taken before").SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(CLOCK_HZ / 1_000 - 1);
    syst.clear_current();
    syst.enable_interrupt();
    syst.enable_counter();
    let mut due = began;
    while !IS_OVER.load(Relaxed) {
        let now = board::now();
        if now < due {
            cortex_m::asm::wfi();
            continue;
        }
        due = now + Duration::from_millis(10);
        let hangs = free(|cs| {
            let mut scene = SCENE.borrow(cs).borrow_mut();
            let Some(Scene { world, .. }) = scene.as_mut() else { return false };
            world.app().fly(now);
            world.app().simulates_hang()
        });
        if hangs {
            free(|cs| HUNG.borrow(cs).set(Some(board::now())));
            HANGS.store(true, Relaxed);
            // Hangs until the interrupt ends it.
            #[allow(clippy::missing_spin_loop, reason = "the emulator stops at each hint, which is six times slower")]
            while HANGS.load(Relaxed) {}
        }
    }
    syst.disable_interrupt();
    syst.disable_counter();
    let scene = free(|cs| SCENE.borrow(cs).replace(None)).expect("stored above");
    let Scene { world, pinger, upload, last_heartbeat, first_heartbeat, pings, hung, resumed, .. } = scene;
    let (Some(hung), Some(resumed)) = (hung, resumed) else { panic!("flight did not hang or did not resume") };
    assert!(last_heartbeat <= MAX_LOOP_GAP, "a heartbeat {} ms after flight hung", last_heartbeat.as_millis());
    assert!(
        first_heartbeat <= Duration::from_millis(1_000),
        "no heartbeat for {} ms after flight resumed",
        first_heartbeat.as_millis()
    );
    assert!(pings > 100 && pinger.answers + 1 >= pinger.sent, "{pings} pings while flight hung");
    assert!(upload.result == Some(MavMissionResult::ACCEPTED), "the upload while flight hung: {:?}", upload.result);
    assert!(world.tally[0].heartbeats >= 5, "{} heartbeats in total", world.tally[0].heartbeats);
    println!(
        "hung-loop: flight hangs for {} ms: last heartbeat {} ms after that, first one {} ms after it resumes; meanwhile {pings} \
         pings answered within {} ms and an upload accepted, in a timer interrupt",
        (resumed - hung).as_millis(),
        last_heartbeat.as_millis(),
        first_heartbeat.as_millis(),
        pinger.slowest.as_millis()
    );
    world.end()
}
