//! Measures how late flight starts when MAVLink runs in another task: the common part of the firmwares `tasks-loop`, `tasks-rtic` and
//! `tasks-embassy`. `cargo xtask jitter` runs them. For tests only.
//!
//! The vehicle is `examples/tasks`. Flight runs in each tick of SysTick, every millisecond, and the counter itself tells how late. The
//! other task runs five times as often. It has one of two loads: the stack, flooded by two ground stations, or a delay loop of random
//! length. The difference between the two is what the stack adds.

use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use mavstack::dialect::{
    CommandLong, Heartbeat, MavCmd, MissionRequestList, ParamRequestList, ParamRequestRead, Timesync,
};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{Address, Instant, LinkId, Message, StackOf, Text};
use mavstack_tasks::{Between, Copter, Flight, LINKS, Mavlink};
use semihosting::experimental::env;
use semihosting::{println, process};
use static_cell::ConstStaticCell;

use crate::board::{self, CLOCK_HZ, COMPANION_BAUD, TELEMETRY_BAUD};
use crate::line::Line;

/// Period of flight (µs).
const FLIGHT_PERIOD: u32 = 1_000;
/// Period of the MAVLink task (µs). It has no common divisor with that of flight, so that flight meets it in every phase.
pub const MAVLINK_PERIOD: u32 = 197;
/// The longest delay, in instructions of 8 ns: two thirds of the period.
const LONGEST_DELAY: u32 = 16_000;
/// Length of a tick of SysTick (ns).
const TICK_NS: u32 = 1_000_000_000 / CLOCK_HZ;
/// Ticks of SysTick in a period of flight.
const TICKS: u32 = CLOCK_HZ / 1_000_000 * FLIGHT_PERIOD;
/// Number of measured passes of flight: 10 s.
const PASSES: u32 = 10_000;
/// Baud rates of the lines.
const BAUDS: [u32; 2] = [TELEMETRY_BAUD, COMPANION_BAUD];

static BETWEEN: ConstStaticCell<Between> = ConstStaticCell::new(Between::new());
static STACK: ConstStaticCell<StackOf<Mavlink>> = ConstStaticCell::new(StackOf::<Mavlink>::VACANT);
static RECEIVED: AtomicU32 = AtomicU32::new(0);
static SENT: AtomicU32 = AtomicU32::new(0);

/// Returns the two tasks. Call it once. `name` is that of the firmware.
pub fn start(name: &'static str) -> (FlightTask, MavlinkTask) {
    let load = Load::from_command_line();
    let (flight, copter, config) = BETWEEN.take().split();
    let stack = STACK.take();
    stack.begin(config, LINKS);
    let lines = [2, 3].map(|system| (Line::SILENT, Station::new(system)));
    (
        FlightTask { name, load, flight, began: 0, passes: 0, least: u32::MAX, most: 0 },
        MavlinkTask { load, stack, copter, lines, clock: Clock { last: board::ticks(), ticks: 0 }, random: 1 },
    )
}

/// Starts the timer of flight. From now on, SysTick is raised every millisecond.
pub fn start_timer(mut syst: SYST) {
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(TICKS - 1);
    syst.clear_current();
    syst.enable_interrupt();
    syst.enable_counter();
}

/// The load of the MAVLink task.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Load {
    /// The stack and its ground stations.
    Stack,
    /// A delay loop.
    Delay,
}

impl Load {
    fn from_command_line() -> Self {
        let arguments = env::args::<64>().expect("arguments from the emulator");
        match (&arguments).flatten().nth(1) {
            Some("stack") => Self::Stack,
            Some("delay") => Self::Delay,
            other => panic!("expected `stack` or `delay`, not {other:?}"),
        }
    }
}

/// Flight, and the measurement.
pub struct FlightTask {
    name: &'static str,
    load: Load,
    flight: Flight,
    began: u32,
    passes: u32,
    /// The shortest and the longest delay (ticks).
    least: u32,
    most: u32,
}

impl FlightTask {
    /// Returns the ticks since the timer was due. Call it first.
    #[inline(always)]
    pub fn late() -> u32 {
        // The counter stops at 0 for one tick, then it is reloaded.
        let current = SYST::get_current();
        if current == 0 { 0 } else { TICKS - current }
    }

    /// Runs a pass that started `late` ticks after it was due. The last pass prints the result and exits the emulator.
    pub fn pass(&mut self, late: u32) {
        if self.passes == 0 {
            self.began = board::ticks();
        }
        self.least = self.least.min(late);
        self.most = self.most.max(late);
        self.passes += 1;
        self.flight.step();
        if self.passes == PASSES {
            self.report();
        }
    }

    /// Prints the result. Exits with an error if passes were missed, or if there was no load.
    fn report(&self) -> ! {
        let Self { name, load, least, most, .. } = *self;
        let (received, sent, takeoffs) = (RECEIVED.load(Relaxed), SENT.load(Relaxed), self.flight.state().takeoffs);
        let load = if load == Load::Stack { "stack" } else { "delay" };
        println!(
            "{name} {load}: flight late by {} to {} ns in {PASSES} passes; {received} frames received, {sent} sent, {takeoffs} \
             takeoffs",
            least * TICK_NS,
            most * TICK_NS
        );
        let elapsed = board::ticks().wrapping_sub(self.began);
        if elapsed.abs_diff((PASSES - 1) * TICKS) > TICKS / 2 {
            println!("{name}: {PASSES} passes took {elapsed} ticks: some were missed");
            process::exit(1);
        }
        let is_tried = received > 2 * PASSES && sent > PASSES && takeoffs > 2;
        process::exit(if is_tried || self.load == Load::Delay { 0 } else { 1 })
    }
}

/// A clock of one task: it needs no lock. It is read at least once in 171 s.
struct Clock {
    last: u32,
    ticks: u64,
}

impl Clock {
    fn now(&mut self) -> Instant {
        let ticks = board::ticks();
        self.ticks += u64::from(ticks.wrapping_sub(self.last));
        self.last = ticks;
        Instant::from_micros(self.ticks / u64::from(CLOCK_HZ / 1_000_000))
    }
}

/// The MAVLink task.
pub struct MavlinkTask {
    load: Load,
    stack: &'static mut StackOf<Mavlink>,
    copter: Copter,
    lines: [(Line<128>, Station); 2],
    clock: Clock,
    random: u32,
}

impl MavlinkTask {
    /// Runs a pass: polls each line, or delays.
    pub fn pass(&mut self) {
        match self.load {
            Load::Stack => self.poll(),
            Load::Delay => {
                self.random = random(self.random);
                cortex_m::asm::delay(self.random % LONGEST_DELAY);
            }
        }
    }

    fn poll(&mut self) {
        let Self { stack, copter, lines, clock, .. } = self;
        copter.refresh(stack);
        stack.poll(clock.now(), copter);
        for ((link, baud), (line, station)) in (0..).map(LinkId).zip(BAUDS).zip(lines) {
            line.fill(station.bytes(baud), || Some(station.next()));
            let _ = stack.poll_link(clock.now(), link, line, copter);
        }
        let links = [0, 1].map(LinkId);
        RECEIVED.store(links.iter().filter_map(|link| Some(stack.rx_counters(*link)?.frames)).sum(), Relaxed);
        SENT.store(links.iter().filter_map(|link| Some(stack.link_counters(*link)?.tx_frames)).sum(), Relaxed);
    }
}

/// A ground station that sends as fast as the line permits, and never waits for an answer.
struct Station {
    address: Address,
    frame: [u8; MAX_FRAME_LEN],
    len: usize,
    at: usize,
    sequence: u8,
    random: u32,
    /// Part of a byte that the line has carried, in bits × 1,000,000.
    rest: u32,
}

impl Station {
    const fn new(system: u8) -> Self {
        Self {
            address: Address::new(system, 190),
            frame: [0; MAX_FRAME_LEN],
            len: 0,
            at: 0,
            sequence: 0,
            random: system as u32,
            rest: 0,
        }
    }

    /// Returns how many bytes the line carries in a period, at ten bits for a byte.
    fn bytes(&mut self, baud: u32) -> usize {
        const BYTE: u32 = 10_000_000;
        self.rest += baud * MAVLINK_PERIOD;
        let bytes = self.rest / BYTE;
        self.rest %= BYTE;
        bytes as usize
    }

    fn next(&mut self) -> u8 {
        if self.at >= self.len {
            self.refill();
        }
        let byte = self.frame[self.at];
        self.at += 1;
        byte
    }

    fn refill(&mut self) {
        self.at = 0;
        self.sequence = self.sequence.wrapping_add(1);
        self.random = random(self.random);
        let (target_system, target_component) = (1, 1);
        match self.random % 12 {
            0 => self.put(&Heartbeat { mavlink_version: 3, ..Default::default() }),
            1 | 2 => self.command(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0], 0.0),
            3 => self.command(MavCmd::COMPONENT_ARM_DISARM, [0.0, 0.0], 0.0),
            4 | 5 => self.command(MavCmd::NAV_TAKEOFF, [0.0, 0.0], 3.0),
            // ATTITUDE every 2 ms.
            6 => self.command(MavCmd::SET_MESSAGE_INTERVAL, [30.0, 2_000.0], 0.0),
            7 => self.put(&ParamRequestList { target_system, target_component }),
            8 => {
                let param_id = Text::new("TAKEOFF_ALT");
                self.put(&ParamRequestRead { param_index: -1, target_system, target_component, param_id });
            }
            9 => self.put(&MissionRequestList { target_system, target_component, ..Default::default() }),
            10 => self.put(&Timesync { ts1: self.random.into(), ..Default::default() }),
            // Noise: headers of large frames, one at every other byte.
            _ => {
                self.len = 100;
                self.frame[..self.len].fill(0xFD);
            }
        }
    }

    fn command(&mut self, command: MavCmd, [param1, param2]: [f32; 2], param7: f32) {
        let (target_system, target_component) = (1, 1);
        let params = CommandLong { param1, param2, param7, ..Default::default() };
        self.put(&CommandLong { target_system, target_component, command, ..params });
    }

    fn put<M: Message>(&mut self, message: &M) {
        self.len = encode(message, Version::V2, self.address, self.sequence, &mut self.frame).unwrap_or(0);
    }
}

/// Returns the number after `last` in a sequence of random numbers (xorshift). `last` is not 0.
const fn random(last: u32) -> u32 {
    let mut random = last;
    random ^= random << 13;
    random ^= random >> 17;
    random ^ (random << 5)
}
