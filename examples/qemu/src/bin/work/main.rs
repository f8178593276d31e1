//! Measures the cost of a poll: instructions, counted by the emulator, under worst-case input. `cargo measure work` runs it. For
//! measurements only.
//!
//! The demo vehicle is on the ground, with three links. Forwarded frames are sent on the other two. Each poll advances the time
//! by 1 ms.
#![no_std]
#![no_main]

mod corpus;
mod traffic;

use core::fmt::Write as _;

use corpus::Corpus;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use mavstack::config::{LinkClass, PollBudget, StreamProfile};
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{Address, Config, Duration, Instant, LinkConfig, LinkId, Pulse, StackOf};
use mavstack_demo::{Mavlink, Quadrotor};
use mavstack_qemu::board::{Board, Uart};
use mavstack_qemu::line;
use mavstack_qemu::memory::STACK;
use traffic::{Forgery, KEY, Kind, SIGNED_AT, Sender};

static PULSE: Pulse = Pulse::new();
const ADDRESS: Address = Address::new(1, 1);
/// Instructions per tick of SysTick, at one nanosecond per instruction.
const INSTRUCTIONS: u32 = 40;
const LONGEST: u32 = 0x00FF_FFFF;
const POLLS: u32 = 600;
/// Number of polls with noise: one minute.
const NOISY_POLLS: u32 = 60_000;
/// Bytes per millisecond at 1 Mbit/s, with ten bits per byte.
const NOISE: usize = 100;

/// The state of the vehicle and its links at the start of a measurement.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Scene {
    Plain,
    /// The mission has its maximum length.
    Loaded,
    /// A key is set, and unsigned frames are refused.
    Signed,
    /// The link accepts no output.
    Stalled,
    /// The link has no rate limit.
    Unlimited,
    /// The link is a satellite link.
    Satellite,
    /// The other links receive the same input.
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

/// A poll receives at most 128 bytes.
type Line = line::Line<128>;

/// A vehicle under measurement.
struct Bench<'a> {
    stack: &'a mut StackOf<Mavlink>,
    vehicle: Quadrotor,
    now: Instant,
    line: Line,
    others: [Line; 2],
    polls: u32,
    max: u32,
    sum: u64,
    max_timers: u32,
}

/// Returns the number of instructions of `work`.
fn count(work: impl FnOnce()) -> u32 {
    let before = SYST::get_current();
    work();
    (before.wrapping_sub(SYST::get_current()) & LONGEST) * INSTRUCTIONS
}

impl<'a> Bench<'a> {
    #[inline(never)]
    fn new(stack: &'a mut StackOf<Mavlink>, budget: PollBudget, scene: Scene) -> Self {
        let config = Config { budget, ..Config::new(ADDRESS, &PULSE) };
        let link = match scene {
            Scene::Unlimited => LinkConfig::unlimited().with_streams(StreamProfile::Onboard),
            Scene::Satellite => LinkConfig::uart(921_600).with_class(LinkClass::HighLatency),
            Scene::Signed => LinkConfig::uart(921_600).with_signing(LinkSigning::SIGNED),
            _ => LinkConfig::uart(921_600),
        };
        *stack = StackOf::<Mavlink>::VACANT;
        stack.begin(config, [link, LinkConfig::uart(921_600), LinkConfig::uart(921_600)]);
        let mut bench = Self {
            stack,
            vehicle: Quadrotor::new(),
            now: Instant::from_millis(10_000),
            line: Line::SILENT,
            others: [Line::SILENT, Line::SILENT],
            polls: 0,
            max: 0,
            sum: 0,
            max_timers: 0,
        };
        if scene == Scene::Loaded {
            let mut sender = Sender::new(Kind::Upload);
            while bench.stack.mission().items().is_empty() {
                bench.poll(budget.rx_bytes as usize, || sender.next());
            }
            (bench.polls, bench.max, bench.sum, bench.max_timers) = (0, 0, 0, 0);
        }
        if scene == Scene::Signed {
            bench.stack.signing_mut().set_key(bench.now, SigningKey::new(KEY), SIGNED_AT);
        }
        bench.line.accepts = scene != Scene::Stalled;
        bench
    }

    /// Runs one millisecond, in which up to `bytes` bytes arrive on the first link.
    fn poll(&mut self, bytes: usize, next: impl FnMut() -> Option<u8>) {
        self.now += Duration::from_millis(1);
        let Self { stack, vehicle, line, now, .. } = self;
        PULSE.tick();
        line.now = *now;
        line.fill(bytes, next);
        let timers = count(|| stack.poll(*now, vehicle));
        let work = count(|| {
            let _ = stack.poll_link(*now, LinkId(0), line, vehicle);
        });
        for (link, line) in [LinkId(1), LinkId(2)].into_iter().zip(&mut self.others) {
            let _ = stack.poll_link(*now, link, line, vehicle);
        }
        self.polls += 1;
        self.max = self.max.max(work);
        self.sum += u64::from(work);
        self.max_timers = self.max_timers.max(timers);
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
                is_quiet |= sender.sends_single_frames() && sender.is_between_frames();
                byte
            });
        }
    }

    fn report(&self, out: &mut Report<'_>, budget: &str, row: &str) {
        let (average, polls) = (self.sum / u64::from(self.polls.max(1)), self.polls);
        let Self { max, max_timers, .. } = self;
        let gap = self.line.gap.as_micros();
        let _ = writeln!(out, "{budget} {row} {polls} {average} {max} {max_timers} {gap}");
    }
}

#[entry]
fn main() -> ! {
    let (Some(core), Some(mut board)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let stack = STACK.take();
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
            let mut bench = Bench::new(stack, budget, scene);
            bench.run(kind, scene, bytes);
            bench.report(&mut out, name, what);
        }
        corpus.rewind();
        let mut bench = Bench::new(stack, budget, Scene::Plain);
        while !corpus.is_at_end() {
            bench.poll(bytes, || corpus.next());
        }
        bench.report(&mut out, name, "corpus");
        let mut bench = Bench::new(stack, budget, Scene::Plain);
        let mut sender = Sender::new(Kind::Noise);
        for _ in 0..NOISY_POLLS {
            // One poll may not read all of it.
            bench.poll(NOISE, || sender.next());
        }
        bench.report(&mut out, name, "noise-1-mbaud-60-s");
    }
    let _ = writeln!(out, "end");
    loop {
        cortex_m::asm::wfi();
    }
}

/// Writes lines to the host.
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
