//! One vehicle, its lines, and who is at their other ends, in simulated time.

use super::{
    Clear, Clock, Download, Gcs, LineConfig, Rng, SerialEnd, SimError, SimSerial, TestVehicle, TransferError, Upload,
    VEHICLE, millis,
};
use mavstack::dialect::{MavMissionType, MissionAck, MissionItemInt};
use mavstack::{
    Autopilot, Config, Duration, Instant, LinkConfig, LinkError, LinkId, Message, NoPlans, PlanStorage, Pulse, Stack,
};

/// What a [`World`] is made from; change what matters by struct update.
#[derive(Clone, Copy, Debug)]
pub struct Setup<const N: usize> {
    /// What the vehicle is told once. Its pulse is the world's own.
    pub config: Config,
    /// What the vehicle is told of its links: MAVLink 2 at 115,200 bit/s at first.
    pub links: [LinkConfig; N],
    /// What the lines really are: perfect and infinitely fast at first.
    pub lines: [LineConfig; N],
    /// When the world begins: at boot, at first.
    pub start: Instant,
    /// From one pass of the loop to the next: 1 ms at first.
    pub step: Duration,
    /// By up to so much is a pass late, at random.
    pub jitter: Duration,
    /// What all randomness is drawn from.
    pub seed: u64,
}

impl<const N: usize> Setup<N> {
    pub fn new() -> Self {
        Self {
            config: Config::new(VEHICLE, Box::leak(Box::new(Pulse::new()))),
            links: [LinkConfig::uart(115_200); N],
            lines: [LineConfig::default(); N],
            start: Instant::ZERO,
            step: millis(1),
            jitter: Duration::ZERO,
            seed: 1,
        }
    }
}

/// A stack with `N` links, plan memory `P` and `PEERS` places in the peer table, the vehicle `V`, and everything around them.
pub struct World<const N: usize, P: PlanStorage = NoPlans, const PEERS: usize = 8, V = TestVehicle> {
    pub stack: Box<Stack<N, P, PEERS>>,
    pub vehicle: V,
    /// The lines, by link.
    pub lines: Vec<SimSerial>,
    /// The vehicle's ends of the lines, by link.
    pub uarts: Vec<SerialEnd>,
    /// One ground station a line, by link.
    pub gcs: Vec<Gcs>,
    /// What the stack reported of its transports.
    pub errors: Vec<(LinkId, LinkError<SimError>)>,
    /// What the flight loop ticks.
    pub pulse: &'static Pulse,
    /// Whether the flight loop runs; the stack is polled either way.
    pub loop_runs: bool,
    pub clock: Clock,
    step: Duration,
    jitter: Duration,
    rng: Rng,
}

impl<const N: usize> World<N> {
    /// A world without plans.
    pub fn new(setup: Setup<N>) -> Self {
        Self::with_plans(setup)
    }
}

impl<const N: usize, P: PlanStorage, const PEERS: usize, V: Autopilot + Default> World<N, P, PEERS, V> {
    /// A world with plan memory, peer table and vehicle of its own.
    pub fn with_plans(setup: Setup<N>) -> Self {
        let clock = Clock::new(setup.start);
        let line = |(i, config): (usize, LineConfig)| SimSerial::new(&clock, config, setup.seed ^ ((i as u64) << 32));
        let lines: Vec<_> = setup.lines.into_iter().enumerate().map(line).collect();
        let (uarts, far): (Vec<_>, Vec<_>) = lines.iter().map(SimSerial::ends).unzip();
        Self {
            stack: Box::new(Stack::with_capacities(setup.config, setup.links)),
            vehicle: V::default(),
            lines,
            uarts,
            gcs: far.into_iter().map(Gcs::new).collect(),
            errors: Vec::new(),
            pulse: setup.config.pulse,
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

    /// One pass of the flight loop, then everybody on the ground.
    pub fn step(&mut self) {
        let late = self.rng.below(self.jitter.as_micros() + 1);
        let now = self.now().after(self.step).after(Duration::from_micros(late));
        self.step_to(now);
    }

    /// The same, at a time of your own.
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

    /// A pass at the next moment at which anybody has something to do, `due` at the latest; what the stack says of that is
    /// believed. Passes in between are left out, which saves most of the time of a test that takes minutes.
    pub fn skip_to(&mut self, due: Instant) {
        // The flight loop may not seem to hang.
        let now = self.now();
        let mut next = due.min(now.after(millis(200))).min(self.stack.next_deadline(now));
        for (uart, gcs) in self.uarts.iter().zip(&self.gcs) {
            next = next.min(uart.next_arrival()).min(gcs.end.next_arrival());
            next = if gcs.is_idle() { next } else { now };
        }
        self.step_to(next.max(now.after(self.step)));
    }

    /// Runs for `duration`.
    pub fn run_for(&mut self, duration: Duration) {
        self.run_until(duration, |_| false);
    }

    /// Runs until `done`, which is asked after every step; false when it was not so `within` that time.
    pub fn run_until(&mut self, within: Duration, mut done: impl FnMut(&mut Self) -> bool) -> bool {
        let end = self.now().after(within);
        while self.now() < end {
            self.step();
            if done(self) {
                return true;
            }
        }
        false
    }

    /// Runs until the ground station of `link` has an `M` that no test took before, and takes it.
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

    /// Runs for `within` and requires that the ground station of `link` gets no `M` that was not taken before.
    pub fn expect_no<M: Message>(&mut self, link: usize, within: Duration) {
        self.run_for(within);
        assert!(self.gcs[link].take::<M>().is_none(), "a {} came", M::NAME);
    }

    /// Uploads a plan from the ground station of `link`, as [`Upload`] does.
    pub fn upload(&mut self, link: usize, items: &[MissionItemInt]) -> Result<MissionAck, TransferError> {
        let mut upload = Upload::new(&self.gcs[link], items);
        self.run_until(Duration::from_secs(3_600), |world| {
            let now = world.now();
            upload.poll(now, &mut world.gcs[link]).is_some()
        });
        upload.result().expect("an upload ends within an hour")
    }

    /// Downloads a plan to the ground station of `link`, as [`Download`] does.
    pub fn download(&mut self, link: usize, plan: MavMissionType) -> Result<Vec<MissionItemInt>, TransferError> {
        let mut download = Download::new(&self.gcs[link], plan);
        self.run_until(Duration::from_secs(3_600), |world| {
            let now = world.now();
            download.poll(now, &mut world.gcs[link]).is_some()
        });
        download.result().expect("a download ends within an hour")
    }

    /// Clears a plan from the ground station of `link`, as [`Clear`] does.
    pub fn clear(&mut self, link: usize, plan: MavMissionType) -> Result<MissionAck, TransferError> {
        let mut clear = Clear::new(&self.gcs[link], plan);
        self.run_until(Duration::from_secs(3_600), |world| {
            let now = world.now();
            clear.poll(now, &mut world.gcs[link]).is_some()
        });
        clear.result().expect("a clear ends within an hour")
    }
}
