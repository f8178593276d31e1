//! A flight loop that hangs, while an interrupt speaks for the vehicle: in the processor's own time.

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

/// Config::max_loop_gap.
const MAX_LOOP_GAP: Duration = Duration::from_millis(500);
/// From the beginning; not long before a heartbeat, which still goes out then.
const HANGS_AT: Duration = Duration::from_millis(3_600);
const RESUMES_AT: Duration = Duration::from_secs(9);
const ENDS_AT: Duration = Duration::from_secs(12);

/// What the interrupt works with.
struct Scene {
    world: World,
    began: Instant,
    pinger: Pinger,
    /// Begun while it hangs.
    upload: Upload,
    is_told: [bool; 2],
    /// When it hung, before which the last heartbeat was.
    hung: Option<Instant>,
    pings_before: u32,
    last_beat: Duration,
    resumed: Option<Instant>,
    first_beat: Duration,
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
            scene.go_on(board::now());
        }
    });
}

impl Scene {
    fn go_on(&mut self, now: Instant) {
        let since = now.since(self.began);
        let set_hang = |world: &mut World, param_value| {
            let set = ParamSet {
                target_system: 1,
                target_component: 1,
                param_id: Text::new("SIM_HANG"),
                param_type: MavParamType::UINT8,
                // An integer's bytes, as the vehicle encodes them.
                param_value: f32::from_bits(param_value),
            };
            world.air.send(TELEMETRY, STATION, &set);
        };
        for (at, value, is_told) in [(HANGS_AT, 1, 0), (RESUMES_AT, 0, 1)] {
            if since >= at && !self.is_told[is_told] {
                self.is_told[is_told] = true;
                set_hang(&mut self.world, value);
                if value == 0 {
                    self.pings = self.pinger.answers - self.pings_before;
                } else {
                    self.pings_before = self.pinger.answers;
                }
            }
        }
        let beats = self.world.tally[0].beats;
        if self.hung.is_some() {
            self.world.talk(now, &mut [&mut self.pinger, &mut self.upload]);
        } else {
            self.world.talk(now, &mut [&mut self.pinger]);
        }
        let beat = self.world.tally[0].beats > beats;
        if let Some(hung) = self.hung
            && beat
        {
            if HANGS.load(Relaxed) {
                self.last_beat = now.since(hung);
            } else if self.first_beat == Duration::ZERO {
                self.first_beat = self.resumed.map_or(Duration::MAX, |resumed| now.since(resumed));
            }
        }
        // Whoever set it back has his answer: flight goes on.
        if HANGS.load(Relaxed) && self.is_told[1] && !self.world.app().hangs() {
            self.resumed = Some(now);
            HANGS.store(false, Relaxed);
        }
        if since >= ENDS_AT {
            IS_OVER.store(true, Relaxed);
        }
    }
}

/// Flight in the loop below, the stack in the interrupt above; the loop hangs.
pub fn hung_loop(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    world.step = Duration::from_millis(1);
    let began = board::now();
    let scene = Scene {
        world,
        began,
        pinger: Pinger::new(COMPANION, OTHER, Duration::from_millis(50)),
        upload: Upload::new(COMPANION, OTHER, 30, 1),
        is_told: [false; 2],
        hung: None,
        pings_before: 0,
        last_beat: Duration::ZERO,
        resumed: None,
        first_beat: Duration::ZERO,
        pings: 0,
    };
    free(|cs| SCENE.borrow(cs).replace(Some(scene)));
    let mut syst = cortex_m::Peripherals::take().expect("nobody else has it").SYST;
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
        due = now.after(Duration::from_millis(10));
        let hangs = free(|cs| {
            let mut scene = SCENE.borrow(cs).borrow_mut();
            let Some(Scene { world, .. }) = scene.as_mut() else { return false };
            world.app().fly(now);
            world.app().hangs()
        });
        if hangs {
            free(|cs| HUNG.borrow(cs).set(Some(board::now())));
            HANGS.store(true, Relaxed);
            // For ever, as far as this loop can do anything about it.
            #[allow(
                clippy::missing_spin_loop,
                reason = "the emulator stops at each hint, which takes it six times as long"
            )]
            while HANGS.load(Relaxed) {}
        }
    }
    syst.disable_interrupt();
    syst.disable_counter();
    let scene = free(|cs| SCENE.borrow(cs).replace(None)).expect("it was put there");
    let Scene { world, pinger, upload, last_beat, first_beat, pings, hung, resumed, .. } = scene;
    let (Some(hung), Some(resumed)) = (hung, resumed) else { panic!("it did not hang, or did not go on") };
    assert!(last_beat <= MAX_LOOP_GAP, "a heartbeat {} ms after flight hung", last_beat.as_millis());
    assert!(
        first_beat <= Duration::from_millis(1_000),
        "no heartbeat for {} ms after it went on",
        first_beat.as_millis()
    );
    assert!(pings > 100 && pinger.answers + 1 >= pinger.sent, "{pings} pings while it hung");
    assert!(upload.result == Some(MavMissionResult::ACCEPTED), "the upload while it hung: {:?}", upload.result);
    assert!(world.tally[0].beats >= 5, "{} heartbeats in all", world.tally[0].beats);
    println!(
        "hung-loop: flight hangs for {} ms: last heartbeat {} ms later, first one {} ms after it goes on; meanwhile {pings} pings \
         answered within {} ms and an upload accepted, from a timer's interrupt",
        resumed.since(hung).as_millis(),
        last_beat.as_millis(),
        first_beat.as_millis(),
        pinger.slowest.as_millis()
    );
    world.end()
}
