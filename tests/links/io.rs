//! The stack behind interrupt queues and behind circular DMA, on lines of realistic speed. Rules D-2, S-20.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::atomic::{AtomicU8, Ordering};

use crate::support::*;
use embedded_io::{Read, ReadReady, Write, WriteReady};
use mavstack::__private::Declares;
use mavstack::config::PollBudget;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::io::{CircularReader, LoopEnd, SerialCounters, SerialError, SerialQueues, queue_len};
use mavstack::network::LinkError;
use mavstack::{Address, Duration, Instant, LinkConfig, LinkId, Stack, plan_memory};

const LINK: LinkId = LinkId(0);

/// A vehicle and a ground station at the ends of a line, in steps of a tenth of a byte at 921,600 bit/s.
struct Rig<D: Declares = Tested> {
    clock: Clock,
    stack: Box<Stack<D, 1>>,
    vehicle: D::Vehicle,
    setup: Setup<1>,
    /// The line at the pins of the UART.
    pins: Port,
    gcs: Gcs,
    poll_every: Duration,
    next_poll: Instant,
    errors: Vec<LinkError<SerialError>>,
}

impl<D: Declares<Vehicle = TestVehicle>> Rig<D> {
    fn new(baud: u32, poll_every: Duration) -> Self {
        let clock = Clock::default();
        let setup = Setup { links: [LinkConfig::uart(baud)], ..Setup::new() };
        // The UART has one byte of transmit buffer, and its interrupt is served before a second byte arrives.
        let up = Wire { bytes_per_second: u64::from(baud) / 10, ..Wire::default() };
        let line = LineConfig { up, down: Wire { tx_fifo: 1, ..up } };
        let (pins, far) = Line::new(&clock, line, 1).ends();
        Self {
            clock,
            stack: begun(setup.config, setup.links),
            vehicle: TestVehicle::default(),
            setup,
            pins,
            gcs: Gcs::new(far),
            poll_every,
            next_poll: Instant::ZERO,
            errors: Vec::new(),
        }
    }

    /// Advances to the next moment at which a byte may arrive or leave. Returns whether the loop is due.
    fn step(&mut self, by: Duration) -> bool {
        let now = self.clock.now() + by;
        self.clock.set(now);
        self.gcs.poll(now);
        if now < self.next_poll {
            return false;
        }
        self.next_poll = now + self.poll_every;
        self.setup.config.pulse.expect("a setup has a pulse").tick();
        self.stack.poll(now, &mut self.vehicle);
        true
    }

    /// Returns a byte from the pins, if one arrived.
    fn received(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.pins.readable() > 0 && self.pins.read(&mut byte) == Ok(1)).then_some(byte[0])
    }

    /// Runs with the interrupt's queues until `done`, or for `within`, which returns false.
    fn run<const RX: usize, const TX: usize>(
        &mut self,
        queues: &SerialQueues<RX, TX>,
        within: Duration,
        mut done: impl FnMut(&mut Self) -> bool,
    ) -> bool {
        let end = self.clock.now() + within;
        while self.clock.now() < end {
            let is_due = self.step(Duration::from_micros(10));
            // The interrupt handler: moves the received byte, and one byte to send if the UART is ready.
            let mut interrupt = queues.interrupt_end();
            while let Some(byte) = self.received() {
                interrupt.received(byte);
            }
            if self.pins.write_ready() == Ok(true)
                && let Some(byte) = interrupt.next_to_send()
            {
                assert_eq!(self.pins.write(&[byte]), Ok(1));
            }
            if is_due {
                let now = self.clock.now();
                let result = self.stack.poll_link(now, LINK, &mut queues.loop_end(), &mut self.vehicle);
                self.errors.extend(result.err());
            }
            if done(self) {
                return true;
            }
        }
        false
    }
}

/// S-20: queues of the documented length lose no byte: neither of an upload of 100 items nor of an answer.
#[test]
fn queues_of_the_documented_length_lose_nothing() {
    const SLOW: usize = queue_len(57_600, Duration::from_millis(4));
    const FAST: usize = queue_len(921_600, Duration::from_millis(1));
    let slow: SerialQueues<SLOW, SLOW> = SerialQueues::new();
    let fast: SerialQueues<FAST, FAST> = SerialQueues::new();
    fn fly<const N: usize>(queues: &SerialQueues<N, N>, baud: u32, poll_every: Duration) {
        let mut rig: Rig<Tested<plan_memory!(mission: 100)>> = Rig::new(baud, poll_every);
        let mut upload = Upload::new(&rig.gcs, &plan(100, 1));
        let is_done = rig.run(queues, secs(30), |rig| upload.poll(rig.clock.now(), &mut rig.gcs).is_some());
        assert!(is_done && upload.result().unwrap().is_ok(), "{baud} baud: {:?}", upload.result());
        for _ in 0..20 {
            rig.gcs.command_long(MavCmd::NAV_LAND, [1.0; 7]);
            rig.run(queues, millis(50), |_| false);
        }
        assert_eq!(rig.gcs.count_of::<CommandAck>(), 20, "{baud} baud");
        assert_eq!((rig.gcs.counters().checksum, rig.gcs.counters().skipped), (0, 0), "{baud} baud");
        assert_eq!(rig.errors, []);
        assert_eq!(queues.loop_end().counters(), SerialCounters::default(), "{baud} baud");
    }
    fly(&slow, 57_600, millis(4));
    fly(&fast, 921_600, millis(1));
}

/// S-20: a loop that runs too rarely loses bytes. Each overrun is reported and counted, and what was not lost is handled in
/// every pass but the first.
#[test]
fn overrun_is_counted_and_reported() {
    let queues: SerialQueues<128, 256> = SerialQueues::new();
    // 2,300 bytes arrive between two polls, and the queue holds 128.
    let mut rig: Rig = Rig::new(115_200, millis(200));
    for _ in 0..200 {
        rig.gcs.command_long(MavCmd::NAV_LAND, [1.0; 7]);
    }
    rig.run(&queues, secs(2), |_| false);
    let lost = queues.loop_end().counters();
    assert!(lost.overrun_bytes > 5_000 && lost.line_errors == 0, "{lost:?}");
    // Until the commands end, at most one error is reported per pass.
    assert!((3..=10).contains(&rig.errors.len()), "{:?}", rig.errors);
    assert!(rig.errors.iter().all(|error| *error == LinkError::Read(SerialError::Overrun)), "{:?}", rig.errors);
    assert_eq!(rig.stack.link_counters(LINK).unwrap().read_errors as usize, rig.errors.len());
    assert!(rig.vehicle.commands().len() >= 3, "{} commands", rig.vehicle.commands().len());
    // Afterwards no error is reported, and every command is answered.
    rig.errors.clear();
    rig.gcs.forget();
    rig.poll_every = millis(4);
    rig.gcs.command_long(MavCmd::NAV_LAND, [1.0; 7]);
    rig.run(&queues, secs(1), |_| false);
    assert_eq!((rig.errors.len(), rig.gcs.count_of::<CommandAck>()), (0, 1));
    assert_eq!(queues.loop_end().counters(), lost);
}

/// S-20: an error is reported once, after the bytes that precede it, and never so often that it blocks reading.
#[test]
fn error_is_reported_once_in_order_with_the_bytes() {
    let queues: SerialQueues<4, 2> = SerialQueues::new();
    let (mut interrupt, mut end) = (queues.interrupt_end(), queues.loop_end());
    let mut buffer = [0; 8];
    // An error without bytes before or after it.
    assert_eq!(end.read_ready(), Ok(false));
    interrupt.line_error();
    assert_eq!(end.read_ready(), Ok(true));
    assert_eq!(end.read(&mut []), Ok(0), "an empty buffer");
    assert_eq!(end.read(&mut buffer), Err(SerialError::Line));
    assert_eq!(end.read_ready(), Ok(false));
    assert_eq!(end.read(&mut buffer), Err(SerialError::WouldBlock), "which is not the end of the stream");
    // Six bytes where four fit.
    for _ in 0..3 {
        interrupt.received_all(b"abcdef");
        assert!(interrupt.is_full());
        assert_eq!(end.read(&mut buffer), Ok(4), "first the pending bytes");
        assert_eq!(&buffer[..4], b"abcd");
        assert_eq!(end.read(&mut buffer), Err(SerialError::Overrun));
        assert_eq!(end.read_ready(), Ok(false));
    }
    // A new end of the same queues reports no error twice.
    assert_eq!(queues.loop_end().read_ready(), Ok(false));
    assert_eq!(
        end.counters(),
        counted::<SerialCounters>(|counters| {
            counters.overrun_bytes = 6;
            counters.line_errors = 1
        })
    );
}

/// In the other direction, bytes without room are not accepted, and the call does not block.
#[test]
fn written_bytes_are_sent_in_order() {
    let queues: SerialQueues<4, 8> = SerialQueues::new();
    let (mut interrupt, mut end) = (queues.interrupt_end(), queues.loop_end());
    assert_eq!((end.has_to_send(), interrupt.next_to_send()), (false, None));
    assert_eq!(end.write(b"0123456789"), Ok(8));
    assert_eq!(end.write_ready(), Ok(false));
    assert_eq!((end.write(b"89"), end.write(b"")), (Err(SerialError::WouldBlock), Ok(0)));
    assert_eq!(end.flush(), Err(SerialError::WouldBlock));
    assert!(end.has_to_send());
    let mut dma = [0; 3];
    assert_eq!((interrupt.take_to_send(&mut dma), &dma), (3, b"012"));
    assert_eq!(interrupt.next_to_send(), Some(b'3'));
    assert_eq!(end.write(b"89"), Ok(2));
    let mut dma = [0; 10];
    assert_eq!(interrupt.take_to_send(&mut dma), 6);
    assert_eq!(&dma[..6], b"456789");
    assert_eq!((end.has_to_send(), end.flush()), (false, Ok(())));
}

/// Both ends can be moved to a task or an interrupt handler.
#[test]
fn ends_can_be_moved_to_other_contexts() {
    static QUEUES: SerialQueues<32, 32> = SerialQueues::new();
    fn is_send<T: Send + 'static>(end: T) -> T {
        end
    }
    let mut end: LoopEnd<'static> = is_send(QUEUES.loop_end());
    let mut interrupt = is_send(QUEUES.interrupt_end());
    std::thread::spawn(move || interrupt.received(7)).join().unwrap();
    assert_eq!((end.read(&mut [0; 2]), end.read_ready()), (Ok(1), Ok(false)));
}

/// D-2: with circular DMA and the byte-level calls every command is answered. A loop that stalls for longer than the buffer
/// lasts gets the overrun error and recovers.
#[test]
fn circular_dma_works_through_the_byte_level_calls() {
    const LEN: usize = queue_len(115_200, Duration::from_millis(4));
    let mut rig: Rig = Rig::new(115_200, millis(4));
    let buffer = [const { AtomicU8::new(0) }; LEN];
    let mut written = 0;
    let mut reader = CircularReader::new();
    let mut errors = Vec::new();
    let mut sending = Vec::new();
    for step in 0..400_000u32 {
        if step < 200_000 && step % 5_000 == 0 {
            rig.gcs.command_long(MavCmd::NAV_LAND, [1.0; 7]);
        }
        if step == 250_000 {
            // Four times the buffer's length, while the loop stalls.
            rig.next_poll = rig.clock.now() + millis(60);
            for _ in 0..12 {
                rig.gcs.command_long(MavCmd::NAV_LAND, [2.0; 7]);
            }
        }
        if step == 350_000 {
            rig.gcs.command_long(MavCmd::NAV_TAKEOFF, [3.0; 7]);
        }
        let is_due = rig.step(Duration::from_micros(10));
        while let Some(byte) = rig.received() {
            buffer[written % LEN].store(byte, Ordering::Relaxed);
            written += 1;
        }
        if !sending.is_empty() && rig.pins.write_ready() == Ok(true) {
            assert_eq!(rig.pins.write(&[sending.remove(0)]), Ok(1));
        }
        if is_due {
            let now = rig.clock.now();
            let (stack, vehicle) = (&mut rig.stack, &mut rig.vehicle);
            let laps = (written / LEN) as u32;
            let result = reader.poll(&buffer, laps, written % LEN, stack.receiver(now, LINK, vehicle));
            errors.extend(result.err());
            if sending.is_empty() {
                sending.extend(stack.transmit(now, LINK, vehicle));
                stack.transmitted(LINK, sending.len());
            }
        }
    }
    assert_eq!(errors, [SerialError::Overrun]);
    assert_eq!(reader.overruns(), 1);
    let commands = rig.vehicle.commands();
    assert_eq!(commands.iter().filter(|command| command.params[0] == 1.0).count(), 40);
    assert!(commands.iter().filter(|command| command.params[0] == 2.0).count() < 12);
    assert_eq!(commands.iter().filter(|command| command.params[0] == 3.0).count(), 1);
    assert_eq!(rig.gcs.count_of::<CommandAck>(), commands.len());
    assert_eq!((rig.gcs.counters().checksum, rig.gcs.counters().skipped), (0, 0));
}

/// D-2: all that one poll of a circular buffer passes to the stack has the budget of one poll, also across the buffer's end. What
/// exceeds the budget stays in the buffer, and no byte is lost.
#[test]
fn poll_of_circular_dma_has_one_budget() {
    const LEN: usize = 1_024;
    // Where the reader begins, and the budget that ends a poll: of frames, of bytes, of work.
    for (begin, frames, rx_bytes, work) in
        [(0, 3, 4_000, 9_000), (900, 3, 4_000, 9_000), (900, 100, 90, 90_000), (0, 100, 4_000, 1_700)]
    {
        let mut setup = Setup { links: [LinkConfig::uart(921_600)], ..Setup::<1>::new() };
        setup.config.budget = PollBudget { rx_bytes, work, frames, tx_bytes: 280 };
        let mut stack: Box<Stack<Tested, 1>> = begun(setup.config, setup.links);
        let mut vehicle = TestVehicle::default();
        let buffer = [const { AtomicU8::new(0) }; LEN];
        let mut reader = CircularReader::new();
        assert_eq!(reader.poll(&buffer, 0, begin, <[u8]>::len), Ok(()));

        let command = CommandLong { command: MavCmd::NAV_LAND, target_system: 1, ..Default::default() };
        let mut written = begin;
        let mut sent = 0;
        while written - begin < 950 {
            let mut frame = [0; MAX_FRAME_LEN];
            let len = encode(&command, Version::V2, Address::new(255, 190), sent, &mut frame).unwrap();
            for (at, byte) in (written..).zip(&frame[..len]) {
                buffer[at % LEN].store(*byte, Ordering::Relaxed);
            }
            (written, sent) = (written + len, sent + 1);
        }
        let (laps, position, len) = ((written / LEN) as u32, written % LEN, (written - begin) / usize::from(sent));
        let most = (frames as usize).min(rx_bytes as usize / len + 1).min(work as usize / 500 + 1);
        for poll in 0.. {
            let before = vehicle.commands().len();
            if before == usize::from(sent) {
                break;
            }
            let now = Instant::from_millis(poll);
            assert_eq!(reader.poll(&buffer, laps, position, stack.receiver(now, LINK, &mut vehicle)), Ok(()));
            let handled = vehicle.commands().len() - before;
            assert!(handled <= most, "{handled} frames in a poll, {most} are the budget");
            assert!(poll < 40, "{before} of {sent} frames");
            while !stack.transmit(now, LINK, &mut vehicle).is_empty() {
                stack.transmitted(LINK, MAX_FRAME_LEN);
            }
        }
        assert_eq!(stack.rx_counters(LINK).unwrap().frames, u32::from(sent));
    }
}

/// A queue that an interrupt fills; bytes are lost while it is full.
struct Queue {
    bytes: VecDeque<u8>,
    len: usize,
    lost: usize,
}

impl embedded_io::ErrorType for Queue {
    type Error = Infallible;
}

impl Read for Queue {
    fn read(&mut self, into: &mut [u8]) -> Result<usize, Infallible> {
        let len = into.len().min(self.bytes.len());
        into.iter_mut().zip(self.bytes.drain(..len)).for_each(|(to, byte)| *to = byte);
        Ok(len)
    }
}

impl ReadReady for Queue {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.bytes.is_empty())
    }
}

impl Write for Queue {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl WriteReady for Queue {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

/// D-2: on saturated lines up to USB full speed, with the documented queue and budget, no byte is lost and every frame is
/// received, however short the frames are.
#[test]
fn saturated_lines_are_read_completely() {
    let heartbeat = Heartbeat { mavlink_version: 3, ..Default::default() };
    let request = MissionRequestInt { seq: 3, target_system: 1, target_component: 1, ..Default::default() };
    let command = CommandLong { command: MavCmd::NAV_LAND, target_system: 1, param7: 1.0, ..Default::default() };
    let list = MissionRequestList { target_system: 1, target_component: 1, ..Default::default() };
    let mut frames = [vec![], vec![], vec![], vec![], vec![]];
    for (bytes, which) in frames.iter_mut().zip(0..) {
        let mut buffer = [0; MAX_FRAME_LEN];
        let (version, from) = (Version::V2, Address::new(255, 190));
        let len = match which {
            0 => encode(&heartbeat, version, from, 1, &mut buffer),
            1 => encode(&request, version, from, 1, &mut buffer),
            2 => encode(&command, version, from, 1, &mut buffer),
            // The shortest frame of common, and the shortest frame of all. It has no known message, so its sender must be known.
            3 => encode(&list, Version::V1, from, 1, &mut buffer),
            _ => encode(&heartbeat, version, from, 1, &mut buffer),
        };
        bytes.extend(&buffer[..len.unwrap()]);
    }
    let shortest = reference::v1(3, [255, 190], &[], 0);
    assert_eq!((frames[3].len(), shortest.len()), (10, 8));
    for (baud, millis) in [
        (57_600, 4),
        (57_600, 20),
        (115_200, 4),
        (115_200, 20),
        (921_600, 1),
        (921_600, 4),
        (921_600, 20),
        (1_000_000, 1),
        (2_000_000, 20),
        (3_000_000, 50),
        (12_000_000, 1),
        (12_000_000, 20),
        (12_000_000, 100),
    ] {
        let period = Duration::from_millis(millis);
        for (index, frame) in frames.iter().enumerate() {
            let mut setup = Setup { links: [LinkConfig::uart(baud)], ..Setup::<1>::new() };
            setup.config.budget = PollBudget::for_link(baud, period);
            let mut stack: Box<Stack<Tested, 1>> = begun(setup.config, setup.links);
            let mut vehicle = TestVehicle::default();
            let mut queue = Queue { bytes: VecDeque::new(), len: queue_len(baud, period), lost: 0 };
            let repeated = if index == 4 { &shortest } else { frame };
            let mut line = frame.iter().chain(repeated.iter().cycle()).copied();
            let (mut now, mut sent, mut polls) = (Instant::ZERO, 0, 0);
            // Three seconds; at a high rate 200,000 bytes, but at least twenty polls. Then two polls for what a late one left over.
            let last = (3_000 / millis).min(2_000_000_000 / u64::from(baud) / millis).max(20);
            while polls < last + 2 {
                // Every tenth poll is half a period late.
                polls += 1;
                now += Duration::from_micros(period.as_micros() * if polls % 10 == 0 { 3 } else { 2 } / 2);
                while polls <= last && sent < now.as_micros() * u64::from(baud) / 10_000_000 {
                    sent += 1;
                    let byte = line.next().unwrap();
                    if queue.bytes.len() < queue.len { queue.bytes.push_back(byte) } else { queue.lost += 1 }
                }
                stack.poll(now, &mut vehicle);
                assert_eq!(stack.poll_link(now, LINK, &mut queue, &mut vehicle), Ok(()));
            }
            let len = repeated.len() as u64;
            let (what, whole) = (format!("{baud} every {millis} ms, {len} bytes"), (sent - frame.len() as u64) / len);
            assert_eq!(queue.lost, 0, "{what}");
            let counters = stack.rx_counters(LINK).unwrap();
            let received = counters.frames + counters.unchecked;
            assert!(u64::from(received) + 1 >= whole, "{what}: {received} of {whole}");
            assert_eq!((counters.skipped, counters.checksum), (0, 0), "{what}");
        }
    }
}
