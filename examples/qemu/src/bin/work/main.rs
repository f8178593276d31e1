//! How much work a poll is: instructions of the processor, counted by the emulator, while others send the worst that there is.
//! `cargo xtask work` runs it. Nobody flies with it.
//!
//! The vehicle is the demo's, on the ground, with three links; what is forwarded leaves by the other two. Time goes on by 1 ms
//! from poll to poll.
#![no_std]
#![no_main]

use core::convert::Infallible;
use core::fmt::Write as _;
use core::mem::MaybeUninit;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::dialect::{
    CommandLong, EncapsulatedData, Heartbeat, MavCmd, MissionCount, MissionItemInt, MissionRequestList,
    ParamRequestList, ParamSet,
};
use mavstack::{
    Address, Config, Duration, Instant, LinkConfig, LinkId, Message, PollBudget, Pulse, Stack, Text, Version, encode,
};
use mavstack_demo::{LINKS, Quadrotor};
use mavstack_qemu::board::{Board, Uart};
use mavstack_qemu::memory::DemoPlans;

static PULSE: Pulse = Pulse::new();
const US: Address = Address::new(1, 1);
/// SysTick goes on by one in so many instructions, at one a nanosecond.
const INSTRUCTIONS: u32 = 40;
const LONGEST: u32 = 0x00FF_FFFF;
const POLLS: u32 = 600;

type Subject = Stack<LINKS, DemoPlans>;

/// What the others send.
#[derive(Clone, Copy)]
enum Kind {
    Nothing,
    /// A ground station's heartbeat every second, between silence.
    Heartbeats,
    /// Two COMMAND_LONG in each poll's 64 bytes, by nobody in a hurry: the same command again.
    Commands,
    /// Another command, another sender, another sequence number each.
    CommandFlood,
    CountFlood,
    ListFlood,
    ParamListFlood,
    ParamSetFlood,
    ItemFlood,
    /// Heartbeats from everybody there may be.
    Crowd,
    /// The largest frames, for everybody.
    Largest,
    /// Frames whose ids nobody knows.
    Unknown,
    /// One byte, for ever.
    Byte(u8),
    /// Begins of large frames, one in another.
    Headers,
    /// The same, as dense as it goes.
    DenseHeaders,
    Noise,
}

const KINDS: [(&str, Kind); 17] = [
    ("nothing", Kind::Nothing),
    ("heartbeats", Kind::Heartbeats),
    ("two-commands", Kind::Commands),
    ("command-flood", Kind::CommandFlood),
    ("count-flood", Kind::CountFlood),
    ("list-flood", Kind::ListFlood),
    ("param-list-flood", Kind::ParamListFlood),
    ("param-set-flood", Kind::ParamSetFlood),
    ("item-flood", Kind::ItemFlood),
    ("crowd", Kind::Crowd),
    ("largest", Kind::Largest),
    ("unknown-ids", Kind::Unknown),
    ("all-stx-2", Kind::Byte(0xFD)),
    ("all-stx-1", Kind::Byte(0xFE)),
    ("false-headers", Kind::Headers),
    ("dense-headers", Kind::DenseHeaders),
    ("noise", Kind::Noise),
];

/// The other end of a line.
struct Source {
    kind: Kind,
    frame: [u8; 280],
    len: usize,
    at: usize,
    /// Of frames.
    number: u32,
    /// Bytes that may still be read in this poll.
    left: usize,
    /// Frames, or pieces of them, that may still be written in this poll.
    room: usize,
    random: u32,
}

impl Source {
    fn new(kind: Kind) -> Self {
        Self { kind, frame: [0; 280], len: 0, at: 0, number: 0, left: 0, room: 0, random: 0x2545_F491 }
    }

    fn random(&mut self) -> u32 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 17;
        self.random ^= self.random << 5;
        self.random
    }

    fn put<M: Message>(&mut self, message: &M, from: Address, seq: u8) {
        self.len = encode(message, Version::V2, from, seq, &mut self.frame).unwrap_or(0);
    }

    /// Another frame, or piece of none.
    fn refill(&mut self) {
        self.at = 0;
        self.number = self.number.wrapping_add(1);
        let n = self.number;
        let some = self.random();
        let [byte, other, ..] = some.to_le_bytes();
        let gcs = Address::new(255, 190);
        let crowd = Address::new(2 + byte % 250, 1 + other % 200);
        let target = (1, 1);
        match self.kind {
            Kind::Nothing | Kind::Heartbeats => {
                self.put(&Heartbeat { mavlink_version: 3, ..Default::default() }, gcs, n as u8);
            }
            Kind::Commands | Kind::CommandFlood => {
                let (from, command, seq) = match self.kind {
                    Kind::Commands => (gcs, MavCmd::REQUEST_PROTOCOL_VERSION, n as u8),
                    _ => {
                        let commands = [
                            MavCmd::COMPONENT_ARM_DISARM,
                            MavCmd::REQUEST_MESSAGE,
                            MavCmd::SET_MESSAGE_INTERVAL,
                            MavCmd::NAV_TAKEOFF,
                            MavCmd::DO_SET_MODE,
                            MavCmd::DO_SET_HOME,
                            MavCmd(byte.into()),
                        ];
                        (crowd, commands[n as usize % commands.len()], byte)
                    }
                };
                let params = CommandLong { param1: f32::from(byte), param2: 1.0, param7: 1.0, ..Default::default() };
                let message = CommandLong { target_system: target.0, target_component: target.1, command, ..params };
                self.put(&message, from, seq);
            }
            Kind::CountFlood => {
                let count = 1 + some as u16 % 250;
                let message =
                    MissionCount { count, target_system: target.0, target_component: target.1, ..Default::default() };
                self.put(&message, if n.is_multiple_of(2) { gcs } else { crowd }, byte);
            }
            Kind::ListFlood => {
                let message =
                    MissionRequestList { target_system: target.0, target_component: target.1, ..Default::default() };
                self.put(&message, crowd, byte);
            }
            Kind::ParamListFlood => {
                self.put(&ParamRequestList { target_system: target.0, target_component: target.1 }, crowd, byte);
            }
            Kind::ParamSetFlood => {
                let id = if n.is_multiple_of(2) { "MAV_HL_LOSS_T" } else { "ZZZ_NOT_THERE_ZZ" };
                let message = ParamSet {
                    param_id: Text::new(id),
                    param_value: f32::from(byte),
                    target_system: target.0,
                    target_component: target.1,
                    ..Default::default()
                };
                self.put(&message, crowd, byte);
            }
            Kind::ItemFlood => {
                let message = MissionItemInt {
                    seq: byte.into(),
                    command: MavCmd::NAV_WAYPOINT,
                    target_system: target.0,
                    target_component: target.1,
                    ..Default::default()
                };
                self.put(&message, gcs, byte);
            }
            Kind::Crowd => self.put(&Heartbeat { mavlink_version: 3, ..Default::default() }, crowd, byte),
            Kind::Largest => self.put(&EncapsulatedData { seqnr: n as u16, data: [byte | 1; 253] }, crowd, byte),
            Kind::Unknown => {
                self.put(&Heartbeat { mavlink_version: 3, ..Default::default() }, crowd, byte);
                self.frame[7..10].copy_from_slice(&[byte, other, 0x70]);
            }
            Kind::Byte(byte) => {
                self.frame.fill(byte);
                self.len = 280;
            }
            Kind::Headers => self.repeat(&[0xFD, 255, 0, 0, 7, 255, 190, 131, 0, 0]),
            Kind::DenseHeaders => self.repeat(&[0xFD, 0xFD, 0, 0, 0, 0, 0xFD, 131, 0, 0]),
            Kind::Noise => {
                for at in 0..280 {
                    self.frame[at] = self.random() as u8;
                }
                self.len = 280;
            }
        }
    }

    fn repeat(&mut self, piece: &[u8]) {
        for (byte, piece) in self.frame.iter_mut().zip(piece.iter().cycle()) {
            *byte = *piece;
        }
        self.len = 280;
    }
}

impl ErrorType for Source {
    type Error = Infallible;
}

impl ReadReady for Source {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.left > 0)
    }
}

impl Read for Source {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let len = bytes.len().min(self.left).min(self.len - self.at);
        bytes[..len].copy_from_slice(&self.frame[self.at..self.at + len]);
        self.at += len;
        self.left -= len;
        Ok(len)
    }
}

impl WriteReady for Source {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(self.room > 0)
    }
}

impl Write for Source {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.room -= 1;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The next bytes lie ready: a whole frame's, or at most what one poll reads. So making them is not counted.
fn feed(source: &mut Source, poll: u32, bytes: usize) {
    let is_quiet = match source.kind {
        Kind::Nothing => true,
        Kind::Heartbeats => !poll.is_multiple_of(200),
        _ => false,
    };
    if is_quiet {
        source.left = 0;
        return;
    }
    // The frames that fit in, one behind the other.
    let mut piece = [0; 280];
    let mut len = 0;
    while len < bytes {
        if source.at == source.len {
            source.refill();
        }
        let take = (source.len - source.at).min(bytes - len);
        piece[len..len + take].copy_from_slice(&source.frame[source.at..source.at + take]);
        source.at += take;
        len += take;
        if matches!(source.kind, Kind::Heartbeats) {
            break;
        }
    }
    source.staged(&piece[..len]);
}

impl Source {
    /// Keeps what is left of its frame behind what is to be read now.
    fn staged(&mut self, piece: &[u8]) {
        let mut frame = [0; 280];
        let rest = self.len - self.at;
        let rest = rest.min(280 - piece.len());
        frame[..piece.len()].copy_from_slice(piece);
        frame[piece.len()..piece.len() + rest].copy_from_slice(&self.frame[self.at..self.at + rest]);
        self.frame = frame;
        (self.at, self.len, self.left) = (0, piece.len() + rest, piece.len());
    }
}

/// Instructions that `work` takes.
fn count(work: impl FnOnce()) -> u32 {
    let before = SYST::get_current();
    work();
    (before.wrapping_sub(SYST::get_current()) & LONGEST) * INSTRUCTIONS
}

#[inline(never)]
fn make<'a>(
    stack: &'a mut MaybeUninit<Subject>,
    vehicle: &'a mut MaybeUninit<Quadrotor>,
    config: Config,
) -> (&'a mut Subject, &'a mut Quadrotor) {
    (stack.write(Stack::new(config, [LinkConfig::uart(921_600); LINKS])), vehicle.write(Quadrotor::new()))
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
    for (name, budget, frames_out) in [
        ("small", PollBudget { rx_bytes: 64, frames: 2, ..PollBudget::DEFAULT }, 1),
        ("default", PollBudget::DEFAULT, usize::MAX),
    ] {
        for (what, kind) in KINDS {
            let config = Config { budget, accepts_component_0: true, ..Config::new(US, &PULSE) };
            let (stack, vehicle) = make(STACK, VEHICLE, config);
            let mut source = Source::new(kind);
            let mut others = Source::new(Kind::Nothing);
            let mut now = Instant::from_millis(10_000);
            let (mut most, mut sum, mut most_timers) = (0, 0, 0);
            for poll in 0..POLLS {
                now = now.after(Duration::from_millis(1));
                PULSE.tick();
                feed(&mut source, poll, budget.rx_bytes.into());
                source.room = frames_out;
                others.room = frames_out;
                most_timers = most_timers.max(count(|| stack.poll(now, vehicle)));
                let work = count(|| {
                    let _ = stack.poll_link(now, LinkId(0), &mut source, vehicle);
                });
                most = most.max(work);
                sum += work;
                for link in [1, 2] {
                    let _ = stack.poll_link(now, LinkId(link), &mut others, vehicle);
                }
            }
            let _ = writeln!(out, "{name} {what} {} {most} {most_timers}", sum / POLLS);
        }
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
