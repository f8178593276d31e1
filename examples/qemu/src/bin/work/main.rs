//! How much work a poll is: instructions of the processor, counted by the emulator, while others send the worst that there is.
//! `cargo xtask work` runs it. Nobody flies with it.
//!
//! The vehicle is the demo's, on the ground, with three links; what is forwarded leaves by the other two. Time goes on by 1 ms
//! from poll to poll.
#![no_std]
#![no_main]

mod corpus;
mod traffic;

use core::fmt::Write as _;
use core::mem::MaybeUninit;

use corpus::Corpus;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use mavstack::{
    Address, Config, Duration, Instant, LinkClass, LinkConfig, LinkId, LinkSigning, PollBudget, Pulse, SigningKey,
    Stack, StreamProfile, Vehicle,
};
use mavstack_demo::{LINKS, Quadrotor};
use mavstack_qemu::board::{Board, Uart};
use mavstack_qemu::line;
use mavstack_qemu::memory::DemoPlans;
use traffic::{Forgery, KEY, Kind, SIGNED_AT, Sender};

static PULSE: Pulse = Pulse::new();
const US: Address = Address::new(1, 1);
/// SysTick goes on by one in so many instructions, at one a nanosecond.
const INSTRUCTIONS: u32 = 40;
const LONGEST: u32 = 0x00FF_FFFF;
const POLLS: u32 = 600;
/// A minute.
const NOISY_POLLS: u32 = 60_000;
/// 1 Mbit/s, ten bits a byte, for a millisecond.
const NOISE: usize = 100;

type Subject = Stack<LINKS, DemoPlans>;

/// How the vehicle stands when it begins.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Scene {
    Plain,
    /// All places of its plan are taken.
    Loaded,
    /// It has a key, and accepts nothing unsigned.
    Signed,
    /// The line takes nothing.
    Stalled,
    /// The line is as fast as it is polled.
    Unlimited,
    /// By satellite.
    Satellite,
    /// The same comes by the other links too.
    Everywhere,
}

const ROWS: [(&str, Kind, Scene); 44] = [
    ("nothing", Kind::Nothing, Scene::Plain),
    ("heartbeats", Kind::Heartbeats, Scene::Plain),
    ("two-commands", Kind::Commands, Scene::Plain),
    ("command-flood", Kind::CommandFlood, Scene::Plain),
    ("command-flood-stalled", Kind::CommandFlood, Scene::Stalled),
    ("command-flood-satellite", Kind::CommandFlood, Scene::Satellite),
    ("count-flood", Kind::CountFlood, Scene::Plain),
    ("list-flood", Kind::ListFlood, Scene::Plain),
    ("list-flood-loaded", Kind::ListFlood, Scene::Loaded),
    ("list-seq-jumps", Kind::SeqJumps, Scene::Loaded),
    ("list-seq-jumps-stalled", Kind::SeqJumps, Scene::Stalled),
    ("item-flood", Kind::ItemFlood, Scene::Plain),
    ("upload-250", Kind::Upload, Scene::Plain),
    ("upload-fence-64", Kind::FenceUpload, Scene::Plain),
    ("param-list-flood", Kind::ParamListFlood, Scene::Plain),
    ("param-set-flood", Kind::ParamSetFlood, Scene::Plain),
    ("param-miss", Kind::ParamMiss, Scene::Plain),
    ("param-hash", Kind::ParamHash, Scene::Plain),
    ("time-flood", Kind::TimeFlood, Scene::Plain),
    ("stream-requests", Kind::StreamRequests, Scene::Plain),
    ("all-streams", Kind::AllStreams, Scene::Unlimited),
    ("crowd", Kind::Crowd, Scene::Plain),
    ("crowd-everywhere", Kind::Crowd, Scene::Everywhere),
    ("largest", Kind::Largest, Scene::Plain),
    ("largest-everywhere", Kind::Largest, Scene::Everywhere),
    ("unknown-ids", Kind::Unknown, Scene::Plain),
    ("all-stx-2", Kind::Byte(0xFD), Scene::Plain),
    ("all-stx-1", Kind::Byte(0xFE), Scene::Plain),
    ("unknown-headers", Kind::Unknown1, Scene::Plain),
    ("false-headers", Kind::Headers, Scene::Plain),
    ("dense-headers", Kind::DenseHeaders, Scene::Plain),
    ("nest-stx-2", Kind::Nest(0xFD), Scene::Plain),
    ("nest-stx-1", Kind::Nest(0xFE), Scene::Plain),
    ("nest-frames", Kind::FrameNest, Scene::Plain),
    ("noise", Kind::Noise, Scene::Plain),
    ("signed", Kind::Signed(Forgery::None), Scene::Signed),
    ("signed-bad-key", Kind::Signed(Forgery::BadKey), Scene::Signed),
    ("signed-replayed", Kind::Signed(Forgery::Replayed), Scene::Signed),
    ("signed-new-streams", Kind::Signed(Forgery::NewStreams), Scene::Signed),
    ("signed-unknown-id", Kind::Signed(Forgery::UnknownId), Scene::Signed),
    ("signed-largest", Kind::LargestSigned, Scene::Signed),
    ("signed-nest", Kind::SignedNest, Scene::Signed),
    ("signed-crowd", Kind::Crowd, Scene::Signed),
    ("signed-nest-stx-1", Kind::Nest(0xFE), Scene::Signed),
];

/// A poll is given 128 bytes at most.
type Line = line::Line<128>;

/// A vehicle under measurement.
struct Bench<'a> {
    stack: &'a mut Subject,
    vehicle: &'a mut Quadrotor,
    now: Instant,
    line: Line,
    others: [Line; 2],
    polls: u32,
    most: u32,
    sum: u64,
    most_timers: u32,
}

/// Instructions that `work` takes.
fn count(work: impl FnOnce()) -> u32 {
    let before = SYST::get_current();
    work();
    (before.wrapping_sub(SYST::get_current()) & LONGEST) * INSTRUCTIONS
}

impl<'a> Bench<'a> {
    #[inline(never)]
    fn new(
        stack: &'a mut MaybeUninit<Subject>,
        vehicle: &'a mut MaybeUninit<Quadrotor>,
        budget: PollBudget,
        scene: Scene,
    ) -> Self {
        let config = Config { budget, ..Config::new(US, &PULSE) };
        let link = match scene {
            Scene::Unlimited => LinkConfig::unlimited().with_streams(StreamProfile::Onboard),
            Scene::Satellite => LinkConfig::uart(921_600).with_class(LinkClass::HighLatency),
            Scene::Signed => LinkConfig::uart(921_600).with_signing(LinkSigning::SIGNED),
            _ => LinkConfig::uart(921_600),
        };
        let mut bench = Self {
            stack: stack.write(Stack::new(config, [link, LinkConfig::uart(921_600), LinkConfig::uart(921_600)])),
            vehicle: vehicle.write(Quadrotor::new()),
            now: Instant::from_millis(10_000),
            line: Line::SILENT,
            others: [Line::SILENT, Line::SILENT],
            polls: 0,
            most: 0,
            sum: 0,
            most_timers: 0,
        };
        if scene == Scene::Loaded {
            let mut sender = Sender::new(Kind::Upload);
            while bench.stack.mission().items().is_empty() {
                bench.poll(budget.rx_bytes as usize, || sender.next());
            }
            (bench.polls, bench.most, bench.sum, bench.most_timers) = (0, 0, 0, 0);
        }
        if let Some(signing) = bench.vehicle.signing().filter(|_| scene == Scene::Signed) {
            signing.set_key(bench.now, SigningKey::new(KEY), SIGNED_AT);
        }
        bench.line.takes = scene != Scene::Stalled;
        bench
    }

    /// A millisecond, in which so many bytes come by the first link.
    fn poll(&mut self, bytes: usize, next: impl FnMut() -> Option<u8>) {
        self.now = self.now.after(Duration::from_millis(1));
        let Self { stack, vehicle, line, now, .. } = self;
        PULSE.tick();
        line.now = *now;
        line.fill(bytes, next);
        let timers = count(|| stack.poll(*now, *vehicle));
        let work = count(|| {
            let _ = stack.poll_link(*now, LinkId(0), line, *vehicle);
        });
        for (link, line) in [LinkId(1), LinkId(2)].into_iter().zip(&mut self.others) {
            let _ = stack.poll_link(*now, link, line, *vehicle);
        }
        self.polls += 1;
        self.most = self.most.max(work);
        self.sum += u64::from(work);
        self.most_timers = self.most_timers.max(timers);
    }

    fn run(&mut self, kind: Kind, scene: Scene, bytes: usize) {
        let mut sender = Sender::new(kind);
        let mut elsewhere = [Sender::new(kind), Sender::new(kind)];
        for (index, sender) in elsewhere.iter_mut().enumerate() {
            (0..=index * 999).for_each(|_| {
                sender.next();
            });
        }
        for poll in 0..POLLS {
            if scene == Scene::Everywhere {
                for (line, sender) in self.others.iter_mut().zip(&mut elsewhere) {
                    line.fill(bytes, || sender.next());
                }
            }
            let mut is_quiet = sender.is_quiet(poll);
            self.poll(bytes, || {
                let byte = if is_quiet { None } else { sender.next() };
                is_quiet |= sender.is_slow() && sender.is_between();
                byte
            });
        }
    }

    fn report(&self, out: &mut Report<'_>, budget: &str, row: &str) {
        let (average, polls) = (self.sum / u64::from(self.polls.max(1)), self.polls);
        let Self { most, most_timers, .. } = self;
        let gap = self.line.gap.as_micros();
        let _ = writeln!(out, "{budget} {row} {polls} {average} {most} {most_timers} {gap}");
    }
}

#[entry]
fn main() -> ! {
    static mut STACK: MaybeUninit<Subject> = MaybeUninit::uninit();
    static mut VEHICLE: MaybeUninit<Quadrotor> = MaybeUninit::uninit();

    let (Some(core), Some(mut board)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let mut syst = core.SYST;
    syst.set_clock_source(SystClkSource::Core);
    syst.set_reload(LONGEST);
    syst.clear_current();
    syst.enable_counter();
    let mut out = Report(&mut board.uarts[0]);
    let mut corpus = Corpus::new(board.flash);
    for (name, budget) in [
        ("small", PollBudget { rx_bytes: 64, work: 1_100, frames: 2, ..PollBudget::DEFAULT }),
        ("default", PollBudget::DEFAULT),
    ] {
        let bytes = budget.rx_bytes as usize;
        for (what, kind, scene) in ROWS {
            let mut bench = Bench::new(STACK, VEHICLE, budget, scene);
            bench.run(kind, scene, bytes);
            bench.report(&mut out, name, what);
        }
        corpus.rewind();
        let mut bench = Bench::new(STACK, VEHICLE, budget, Scene::Plain);
        while !corpus.is_over() {
            bench.poll(bytes, || corpus.next());
        }
        bench.report(&mut out, name, "corpus");
        let mut bench = Bench::new(STACK, VEHICLE, budget, Scene::Plain);
        let mut sender = Sender::new(Kind::Noise);
        for _ in 0..NOISY_POLLS {
            // Not all of it may be read at once.
            bench.poll(NOISE, || sender.next());
        }
        bench.report(&mut out, name, "noise-1-mbaud-60-s");
    }
    let _ = writeln!(out, "end");
    loop {
        cortex_m::asm::wfi();
    }
}

/// Lines for the host.
struct Report<'a>(&'a mut Uart);

impl core::fmt::Write for Report<'_> {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for byte in text.bytes() {
            while !self.0.has_room() {}
            self.0.send(byte);
        }
        Ok(())
    }
}
