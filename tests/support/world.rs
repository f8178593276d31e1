//! One vehicle, its lines, and the ground stations at their other ends, in simulated time.

use super::{
    Clear, Clock, Download, Gcs, Line, LineConfig, LineError, Port, Rng, Tested, TransferError, Upload, VEHICLE, begun,
    millis,
};
use mavstack::__private::{Declares, Firmware};
use mavstack::dialect::{MavMissionType, MissionAck, MissionItemInt};
use mavstack::network::LinkError;
use mavstack::{Config, Duration, Instant, LinkConfig, LinkId, Message, Pulse, Stack};

/// The configuration of a [`World`]. Change single fields with struct update syntax.
#[derive(Clone, Copy, Debug)]
pub struct Setup<const N: usize> {
    /// The configuration of the stack, with the world's own pulse.
    pub config: Config,
    /// The configured links; MAVLink 2 at 115,200 bit/s by default.
    pub links: [LinkConfig; N],
    /// The actual properties of the lines; ideal and infinitely fast by default.
    pub lines: [LineConfig; N],
    /// The start of the simulated time; boot by default.
    pub start: Instant,
    /// Period of the loop; 1 ms by default.
    pub step: Duration,
    /// Maximum random delay of a pass.
    pub jitter: Duration,
    /// The seed of all randomness.
    pub seed: u64,
}

impl<const N: usize> Setup<N> {
    pub fn new() -> Self {
        Self {
            config: Config::new(VEHICLE, Box::leak(Box::new(Pulse::new()))),
            links: [LinkConfig::uart(115_200).with_own_system(true); N],
            lines: [LineConfig::default(); N],
            start: Instant::ZERO,
            step: millis(1),
            jitter: Duration::ZERO,
            seed: 1,
        }
    }
}

/// A stack with `N` links of the declaration `D`, its vehicle, and their surroundings.
pub struct World<const N: usize, D: Declares = Tested> {
    pub stack: Box<Stack<D, N>>,
    pub vehicle: D::Vehicle,
    /// The lines, by link.
    pub lines: Vec<Line>,
    /// The vehicle's ends of the lines, by link.
    pub uarts: Vec<Port>,
    /// One ground station per line, by link.
    pub gcs: Vec<Gcs>,
    /// Errors of the transports that the stack reported.
    pub errors: Vec<(LinkId, LinkError<LineError>)>,
    /// The pulse that the flight loop ticks.
    pub pulse: &'static Pulse,
    /// Whether the flight loop runs. The stack is polled in any case.
    pub loop_runs: bool,
    pub clock: Clock,
    step: Duration,
    jitter: Duration,
    rng: Rng,
}

impl<const N: usize> World<N> {
    /// Creates a world of [`Tested`], without plans.
    pub fn new(setup: Setup<N>) -> Self {
        Self::of(setup)
    }
}

impl<const N: usize, D: Declares<Vehicle: Default>> World<N, D> {
    /// Creates a world of any declaration.
    pub fn of(setup: Setup<N>) -> Self {
        let clock = Clock::new(setup.start);
        let line = |(i, config): (usize, LineConfig)| Line::new(&clock, config, setup.seed ^ ((i as u64) << 32));
        let lines: Vec<_> = setup.lines.into_iter().enumerate().map(line).collect();
        let (uarts, far): (Vec<_>, Vec<_>) = lines.iter().map(Line::ends).unzip();
        Self {
            stack: begun(setup.config, setup.links),
            vehicle: <D as Firmware>::Vehicle::default(),
            lines,
            uarts,
            gcs: far.into_iter().map(Gcs::new).collect(),
            errors: Vec::new(),
            pulse: setup.config.pulse.expect("a world has a pulse"),
            loop_runs: true,
            clock,
            step: setup.step,
            jitter: setup.jitter,
            rng: Rng::new(setup.seed),
        }
    }

    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Runs one pass of the flight loop, then the ground stations.
    pub fn step(&mut self) {
        let late = self.rng.below(self.jitter.as_micros() + 1);
        let now = (self.now() + self.step) + Duration::from_micros(late);
        self.step_to(now);
    }

    /// Runs one pass at a given time.
    pub fn step_to(&mut self, now: Instant) {
        self.clock.set(now);
        if self.loop_runs {
            self.pulse.tick();
        }
        self.stack.poll(now, &mut self.vehicle);
        for (link, uart) in (0..).map(LinkId).zip(&mut self.uarts) {
            if let Err(error) = self.stack.poll_link(now, link, uart, &mut self.vehicle) {
                self.errors.push((link, error));
            }
        }
        for gcs in &mut self.gcs {
            gcs.poll(now);
        }
    }

    /// Runs one pass at the next deadline of the stack, the lines or the ground stations, but no later than `due`. Skipping idle
    /// passes saves most of the run time of a test of several minutes.
    pub fn skip_to(&mut self, due: Instant) {
        // The flight loop must not seem to hang.
        let now = self.now();
        let mut next = due.min(now + millis(200)).min(self.stack.next_deadline(now));
        for (uart, gcs) in self.uarts.iter().zip(&self.gcs) {
            next = next.min(uart.next_arrival()).min(gcs.end.next_arrival());
            next = if gcs.is_idle() { next } else { now };
        }
        self.step_to(next.max(now + self.step));
    }

    /// Runs for `duration`.
    pub fn run_for(&mut self, duration: Duration) {
        self.run_until(duration, |_| false);
    }

    /// Runs until `done` returns true, which is called after every step. Returns false if that did not happen `within` the
    /// time.
    pub fn run_until(&mut self, within: Duration, mut done: impl FnMut(&mut Self) -> bool) -> bool {
        let end = self.now() + within;
        while self.now() < end {
            self.step();
            if done(self) {
                return true;
            }
        }
        false
    }

    /// Runs until the ground station of `link` has received an `M` that was not taken before, and takes it.
    pub fn expect<M: Message>(&mut self, link: usize, within: Duration) -> M {
        let mut taken = self.gcs[link].take::<M>();
        if taken.is_none() {
            self.run_until(within, |world| {
                taken = world.gcs[link].take::<M>();
                taken.is_some()
            });
        }
        let Some((_, message)) = taken else { panic!("no {} within {} ms", M::NAME, within.as_millis()) };
        message
    }

    /// Runs for `within` and asserts that the ground station of `link` receives no new `M`.
    pub fn expect_no<M: Message>(&mut self, link: usize, within: Duration) {
        self.run_for(within);
        assert!(self.gcs[link].take::<M>().is_none(), "{} was received", M::NAME);
    }

    /// Runs for `duration` as a sleeping loop does, and returns the number of passes.
    pub fn sleep_for(&mut self, duration: Duration) -> usize {
        let end = self.now() + duration;
        let mut passes = 0;
        while self.now() < end {
            self.skip_to(end);
            passes += 1;
        }
        passes
    }

    /// Uploads a plan from the ground station of `link`, as [`Upload`] does.
    pub fn upload(&mut self, link: usize, items: &[MissionItemInt]) -> Result<MissionAck, TransferError> {
        let mut upload = Upload::new(&self.gcs[link], items);
        self.transfer(link, |gcs, now| upload.poll(now, gcs))
    }

    /// Downloads a plan to the ground station of `link`, as [`Download`] does.
    pub fn download(&mut self, link: usize, plan: MavMissionType) -> Result<Vec<MissionItemInt>, TransferError> {
        let mut download = Download::new(&self.gcs[link], plan);
        self.transfer(link, |gcs, now| download.poll(now, gcs))
    }

    /// Clears a plan from the ground station of `link`, as [`Clear`] does.
    pub fn clear(&mut self, link: usize, plan: MavMissionType) -> Result<MissionAck, TransferError> {
        let mut clear = Clear::new(&self.gcs[link], plan);
        self.transfer(link, |gcs, now| clear.poll(now, gcs))
    }

    /// Runs until `poll` returns a result.
    fn transfer<R>(&mut self, link: usize, mut poll: impl FnMut(&mut Gcs, Instant) -> Option<R>) -> R {
        let mut result = None;
        self.run_until(Duration::from_secs(3_600), |world| {
            let now = world.now();
            result = poll(&mut world.gcs[link], now);
            result.is_some()
        });
        result.expect("a transfer ends within an hour")
    }
}
