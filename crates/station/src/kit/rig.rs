//! A vehicle with its lines and stations, in simulated time.

use std::fmt;

use mavstack::{Duration, Instant};

use super::board::Board;
use super::flash::FlashChip;
use super::line::{Clock, Line, LineConfig, Port};
use crate::{Drive, Failure, Seen, Station};

/// The environment variable with the seed of all rigs; 1 if it is not set.
pub const SEED: &str = "MAVSTACK_SEED";

/// The texts that a failing test prints for each line.
const LAST_TEXTS: usize = 5;

/// A firmware as a rig runs it: its stack, its vehicle and its storage.
///
/// ```
/// use mavstack::dialect::MavResult;
/// use mavstack::prelude::*;
/// use mavstack_station::Client;
/// use mavstack_station::kit::{self, Board, Firmware, LineConfig, Port, Rig};
///
/// # struct Boat;
/// # impl Boat { fn sail(&mut self, _: Instant) {} }
/// # impl Vehicle for Boat { fn state(&self) -> Option<VehicleState> { Some(VehicleState::new(false)) } }
/// # impl Commands for Boat {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
/// #[derive(Stack)]
/// #[stack(vehicle: Boat, links: 1)]
/// struct Mavlink;
///
/// struct Tested {
///     pulse: &'static Pulse,
///     stack: Box<StackOf<Mavlink>>,
///     boat: Boat,
/// }
///
/// impl Tested {
///     fn boot(_: &Board) -> Self {
///         let pulse = kit::pulse();
///         let config = Config::new(Address::new(1, 1), pulse);
///         Self { pulse, stack: Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::uart(57_600)])), boat: Boat }
///     }
/// }
///
/// impl Firmware for Tested {
///     fn fly(&mut self, now: Instant) {
///         self.boat.sail(now);
///         self.pulse.tick();
///     }
///
///     fn poll(&mut self, now: Instant, ports: &mut [Port]) {
///         self.stack.poll(now, &mut self.boat);
///         for (link, port) in (0..).map(LinkId).zip(ports) {
///             let _ = self.stack.poll_link(now, link, port, &mut self.boat);
///         }
///     }
/// }
///
/// let mut rig = Rig::new(Tested::boot).with_line(LineConfig::uart(57_600), Client::QGroundControl);
/// rig.until(Duration::from_secs(2), |rig| rig.seen().vehicles().count() == 1);
/// ```
pub trait Firmware {
    /// Runs one pass of the flight loop: sensors, control, motors, [`Pulse::tick`](mavstack::Pulse::tick). `now` is the time since boot.
    fn fly(&mut self, now: Instant);

    /// Polls the stack, its links and its storage, as the main loop does. `ports` are the vehicle's ends of the lines, in order of the links.
    fn poll(&mut self, now: Instant, ports: &mut [Port]);

    /// Whether to reset now: a reboot was ordered, its acknowledgement was sent and the storage is idle. The rig asks after each poll.
    fn wants_reboot(&self) -> bool {
        false
    }
}

/// A firmware with its board, its lines and a station at each line, in simulated time.
///
/// Every pass takes 1 ms of simulated time by default. In each pass the rig runs the flight loop, polls the stack, and then lets the
/// stations receive and send. All of it is deterministic.
///
/// A rig is a [`Drive`] of the first line, so it has all of [`GroundStation`](crate::GroundStation). [`on`](Self::on) is the same for the
/// other lines.
///
/// See [`Firmware`] for an example.
pub struct Rig<F> {
    boot: Box<dyn FnMut(&Board) -> F>,
    /// `None` while the power is off.
    firmware: Option<F>,
    board: Board,
    ends: Vec<End>,
    ports: Vec<Port>,
    clock: Clock,
    booted: Instant,
    pass: Duration,
    poll_interval: Duration,
    poll_due: Instant,
    stalled_until: Instant,
    flight_loop: FlightLoop,
    seed: u64,
}

/// A line and the station at its far end.
struct End {
    line: Line,
    station: Station,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FlightLoop {
    Runs,
    Hangs,
}

impl<F: Firmware> Rig<F> {
    /// Boots a firmware, which has no line yet. `boot` builds it from scratch, as a reset does; it is called again for every reset.
    ///
    /// # Panics
    ///
    /// The variable [`SEED`] is no number.
    pub fn new(boot: impl FnMut(&Board) -> F + 'static) -> Self {
        let mut rig = Self {
            boot: Box::new(boot),
            firmware: None,
            board: Board::default(),
            ends: Vec::new(),
            ports: Vec::new(),
            clock: Clock::default(),
            booted: Instant::ZERO,
            pass: Duration::from_millis(1),
            poll_interval: Duration::ZERO,
            poll_due: Instant::ZERO,
            stalled_until: Instant::ZERO,
            flight_loop: FlightLoop::Runs,
            seed: std::env::var(SEED).map_or(1, |seed| seed.parse().expect("MAVSTACK_SEED is a number")),
        };
        rig.start();
        rig
    }

    /// Adds a line to the vehicle's next link, with a station at its far end: a [`Client`](crate::Client) or a [`Station`].
    pub fn with_line(mut self, config: LineConfig, station: impl Into<Station>) -> Self {
        let line = Line::new(&self.clock, config, self.seed_of(self.ends.len()));
        self.ports.push(line.ends().0);
        self.ends.push(End { line, station: at(self.now(), station.into()) });
        self
    }

    /// Sets the seed of all faults, in place of [`SEED`].
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        for (index, end) in self.ends.iter().enumerate() {
            end.line.set_seed(self.seed_of(index));
        }
        self
    }

    /// Sets the time from one pass to the next; 1 ms by default.
    ///
    /// # Panics
    ///
    /// `pass` is zero.
    pub fn with_pass(mut self, pass: Duration) -> Self {
        assert!(pass > Duration::ZERO, "a pass takes time");
        self.pass = pass;
        self
    }

    fn seed_of(&self, line: usize) -> u64 {
        self.seed ^ ((line as u64) << 32)
    }

    /// Polls the stack at this interval instead of in each pass. The flight loop is not affected.
    pub fn set_poll_interval(&mut self, interval: Duration) {
        self.poll_interval = interval;
        self.poll_due = self.now();
    }

    /// Returns the simulated time since the rig was created.
    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Returns the simulated time since the vehicle booted, as the firmware sees it.
    pub fn since_boot(&self) -> Instant {
        Instant::ZERO + (self.now() - self.booted)
    }

    /// Returns the firmware.
    ///
    /// # Panics
    ///
    /// The power is off.
    pub fn firmware(&self) -> &F {
        self.firmware.as_ref().expect("the power is off")
    }

    /// Returns the firmware, for a change that no station can make: a sensor that fails, a place to start from.
    ///
    /// # Panics
    ///
    /// The power is off.
    pub fn firmware_mut(&mut self) -> &mut F {
        self.firmware.as_mut().expect("the power is off")
    }

    /// Returns what the first line's station has received.
    pub fn seen(&self) -> &Seen {
        self.ends[0].station.seen()
    }

    /// Returns a line, by the number of the link: [`cut`](Line::cut), [`stall`](Line::stall), [`set_loss`](Line::set_loss).
    pub fn line(&self, link: usize) -> &Line {
        &self.ends[link].line
    }

    /// Returns the station of a line, as a [`GroundStation`](crate::GroundStation).
    pub fn on(&mut self, link: usize) -> OnLine<'_, F> {
        assert!(link < self.ends.len(), "the rig has {} lines", self.ends.len());
        OnLine { rig: self, link }
    }

    /// Returns the board's flash, the first chip that the firmware has taken.
    ///
    /// # Panics
    ///
    /// The firmware has taken none.
    pub fn flash(&self) -> FlashChip {
        self.board.chip(0).expect("the firmware takes a chip from its board")
    }

    /// Hangs the flight loop: it makes no further pass. The stack is polled as before, as from an interrupt or another task.
    pub fn hang_flight_loop(&mut self) {
        self.flight_loop = FlightLoop::Hangs;
    }

    /// Lets the flight loop run again.
    pub fn resume(&mut self) {
        self.flight_loop = FlightLoop::Runs;
    }

    /// Stalls the processor: nothing of the firmware runs for this long, while bytes keep arriving. An erase of internal flash does that.
    pub fn stall(&mut self, duration: Duration) {
        self.stalled_until = self.stalled_until.max(self.now() + duration);
    }

    /// Cuts the vehicle's power. RAM is lost, and time passes without it until [`restore_power`](Self::restore_power).
    pub fn cut_power(&mut self) {
        self.firmware = None;
    }

    /// Restores the power, and boots.
    pub fn restore_power(&mut self) {
        if self.firmware.is_none() {
            self.board.reset();
            self.start();
        }
    }

    /// Resets the processor: RAM is lost, and it boots again at once.
    pub fn reset(&mut self) {
        self.cut_power();
        self.restore_power();
    }

    /// Whether the vehicle has power. A cut ordered by [`FlashChip::cut_power_after`] takes it.
    pub fn has_power(&self) -> bool {
        self.firmware.is_some()
    }

    /// Returns the number of resets and power cuts that the vehicle has come back from.
    pub fn reboots(&self) -> u32 {
        self.board.boots()
    }

    fn start(&mut self) {
        self.ends.iter().for_each(|end| end.line.reset_vehicle());
        self.booted = self.now();
        self.flight_loop = FlightLoop::Runs;
        self.poll_due = self.now();
        self.firmware = Some((self.boot)(&self.board));
        self.stalled_until = self.now() + self.board.take_busy();
    }

    /// Runs for this long.
    pub fn run_for(&mut self, duration: Duration) {
        let end = self.now() + duration;
        while self.now() < end {
            self.step_once();
        }
    }

    /// Runs until `is_reached` returns true, which is asked before the first pass and after each.
    ///
    /// # Panics
    ///
    /// It does not return true within `limit`.
    #[track_caller]
    pub fn until(&mut self, limit: Duration, is_reached: impl FnMut(&Self) -> bool) {
        assert!(self.reaches(limit, is_reached), "not reached within {} ms", limit.as_millis());
    }

    /// Runs until `is_reached` returns true, as [`until`](Self::until) does. Returns false if that does not happen within `limit`.
    pub fn reaches(&mut self, limit: Duration, mut is_reached: impl FnMut(&Self) -> bool) -> bool {
        let end = self.now() + limit;
        loop {
            if is_reached(self) {
                return true;
            }
            if self.now() >= end {
                return false;
            }
            self.step_once();
        }
    }

    /// Runs one pass of the vehicle, then the stations.
    fn step_once(&mut self) {
        let now = self.now() + self.pass;
        self.clock.set(now);
        if now >= self.stalled_until {
            self.run_firmware();
        }
        for End { line, station } in &mut self.ends {
            station.receive(now, &line.receive());
            station.poll(now);
            line.send(&station.take_output());
        }
    }

    fn run_firmware(&mut self) {
        let (now, since_boot) = (self.now(), self.since_boot());
        let Some(firmware) = &mut self.firmware else { return };
        if self.flight_loop == FlightLoop::Runs {
            firmware.fly(since_boot);
        }
        if now < self.poll_due {
            return;
        }
        self.poll_due = now + self.poll_interval;
        firmware.poll(since_boot, &mut self.ports);
        let wants_reboot = firmware.wants_reboot();
        let busy = self.board.take_busy();
        self.stall(busy);
        if self.board.is_off() {
            self.cut_power();
        } else if wants_reboot {
            self.reset();
        }
    }
}

impl<F: Firmware> Drive for Rig<F> {
    fn station(&mut self) -> &mut Station {
        &mut self.ends[0].station
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        self.step_once();
        Ok(self.now())
    }
}

impl<F> fmt::Debug for Rig<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Rig").field("now", &self.clock.now()).field("seed", &self.seed).finish_non_exhaustive()
    }
}

/// Prints what helps to find the cause of a failing test.
impl<F> Drop for Rig<F> {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            return;
        }
        eprintln!("the rig, after {} ms, with {SEED}={}:", self.clock.now().as_millis(), self.seed);
        for (link, End { station, .. }) in self.ends.iter().enumerate() {
            let seen = station.seen();
            for text in seen.texts_since(seen.text_mark().saturating_sub(LAST_TEXTS)) {
                eprintln!("  line {link}, {} ms, {:?}: {}", text.at.as_millis(), text.severity, text.text);
            }
        }
    }
}

/// Tells a new station the time. Otherwise its first dialogue would begin at 0, and time out at once.
fn at(now: Instant, mut station: Station) -> Station {
    station.receive(now, &[]);
    station
}

/// The station of one line of a rig; see [`Rig::on`].
#[derive(Debug)]
pub struct OnLine<'a, F> {
    rig: &'a mut Rig<F>,
    link: usize,
}

impl<F: Firmware> OnLine<'_, F> {
    /// Returns what the station has received.
    pub fn seen(&self) -> &Seen {
        self.rig.ends[self.link].station.seen()
    }

    /// Replaces the station by another one, which has seen nothing.
    pub fn replace_station(&mut self, station: impl Into<Station>) {
        self.rig.ends[self.link].station = at(self.rig.now(), station.into());
    }
}

impl<F: Firmware> Drive for OnLine<'_, F> {
    fn station(&mut self) -> &mut Station {
        &mut self.rig.ends[self.link].station
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        self.rig.step()
    }
}
