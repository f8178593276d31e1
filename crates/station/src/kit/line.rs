//! A serial line or a radio in simulated time.

use std::cell::{Cell, RefCell, RefMut};
use std::collections::VecDeque;
use std::fmt;
use std::rc::Rc;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Duration, Instant};

use super::random::Random;

/// The simulated time, which all parts of a simulation share. Clones show the same time.
#[derive(Clone, Debug, Default)]
pub struct Clock(Rc<Cell<Instant>>);

impl Clock {
    /// Creates a clock that shows this time.
    pub fn new(start: Instant) -> Self {
        Self(Rc::new(Cell::new(start)))
    }

    /// Returns the time.
    pub fn now(&self) -> Instant {
        self.0.get()
    }

    /// Sets the time.
    pub fn set(&self, now: Instant) {
        self.0.set(now);
    }
}

/// The faults of one direction of a line, as probabilities from 0 to 1; none by default.
///
/// Faults of frames and of bytes may be combined: the faults of bytes then apply to the frames that are left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// A byte is lost.
    pub byte_loss: f64,
    /// One bit of a byte is flipped.
    pub byte_flip: f64,
    /// A byte is duplicated.
    pub byte_duplicate: f64,
    /// 1 to [`burst_len`](Self::burst_len) random bytes are inserted before a byte.
    pub burst: f64,
    /// See [`burst`](Self::burst).
    pub burst_len: u64,
    /// After a byte the line stalls for [`stall_for`](Self::stall_for).
    pub stall: f64,
    /// See [`stall`](Self::stall).
    pub stall_for: Duration,
    /// A frame is lost.
    pub frame_loss: f64,
    /// A frame is duplicated.
    pub frame_duplicate: f64,
    /// A frame is delayed by up to [`reorder_by`](Self::reorder_by), so later frames may overtake it.
    pub frame_reorder: f64,
    /// See [`frame_reorder`](Self::frame_reorder).
    pub reorder_by: Duration,
}

impl Faults {
    /// Returns the faults of a radio that loses and duplicates frames with these probabilities.
    pub fn frames(loss: f64, duplicate: f64) -> Self {
        Self { frame_loss: loss, frame_duplicate: duplicate, ..Self::default() }
    }

    fn are_per_frame(&self) -> bool {
        self.frame_loss > 0.0 || self.frame_duplicate > 0.0 || self.frame_reorder > 0.0
    }
}

/// The properties of one direction of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wire {
    /// The rate in bytes/s: a tenth of a UART's baud rate. 0 is infinitely fast.
    pub bytes_per_second: u64,
    /// The time from the end of a byte at the sender until it can be read.
    pub latency: Duration,
    /// The capacity of the transmit FIFO, in bytes. When it is full, the sender is not ready to write.
    pub tx_fifo: usize,
    /// The capacity of the receive FIFO, in bytes. When it is full, further bytes are lost as an overrun.
    pub rx_fifo: usize,
    /// The most bytes of one read or write, which takes a random number of bytes up to this; `usize::MAX` is no limit.
    pub chunk: usize,
    /// The faults.
    pub faults: Faults,
}

impl Default for Wire {
    /// Infinitely fast, with a transmit FIFO of 1 KiB, a receive FIFO of 4 KiB, and without faults.
    fn default() -> Self {
        Self {
            bytes_per_second: 0,
            latency: Duration::ZERO,
            tx_fifo: 1_024,
            rx_fifo: 4_096,
            chunk: usize::MAX,
            faults: Faults::default(),
        }
    }
}

/// The properties of both directions of a line. By default it is infinitely fast and has no faults.
///
/// ```
/// use mavstack::Duration;
/// use mavstack_station::kit::LineConfig;
///
/// let radio = LineConfig::radio(57_600, Duration::from_millis(40)).with_loss(0.2);
/// assert_eq!((radio.up.bytes_per_second, radio.down.faults.frame_loss), (5_760, 0.2));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineConfig {
    /// From the station to the vehicle.
    pub up: Wire,
    /// From the vehicle to the station.
    pub down: Wire,
}

impl LineConfig {
    /// Uses the same properties for both directions.
    pub fn both(wire: Wire) -> Self {
        Self { up: wire, down: wire }
    }

    /// Returns a wire of this rate in bit/s, without faults.
    pub fn uart(baud: u32) -> Self {
        Self::radio(baud, Duration::ZERO)
    }

    /// Returns a radio of this rate in bit/s, with this latency in each direction and without faults.
    pub fn radio(baud: u32, latency: Duration) -> Self {
        Self::both(Wire { bytes_per_second: u64::from(baud) / 10, latency, ..Wire::default() })
    }

    /// Loses frames with this probability, in both directions.
    pub fn with_loss(self, probability: f64) -> Self {
        self.with(|wire| wire.faults.frame_loss = probability)
    }

    /// Duplicates frames with this probability, in both directions.
    pub fn with_duplicates(self, probability: f64) -> Self {
        self.with(|wire| wire.faults.frame_duplicate = probability)
    }

    /// Flips a bit of a byte with this probability, in both directions.
    pub fn with_damage(self, probability: f64) -> Self {
        self.with(|wire| wire.faults.byte_flip = probability)
    }

    /// Reads and writes at most this number of bytes at once, at least one.
    pub fn with_chunks(self, most: usize) -> Self {
        self.with(|wire| wire.chunk = most)
    }

    /// Buffers at most this number of received bytes at the vehicle, as the FIFO or the ring buffer of its UART does.
    pub fn with_rx_fifo(mut self, bytes: usize) -> Self {
        self.up.rx_fifo = bytes;
        self
    }

    fn with(mut self, change: impl Fn(&mut Wire)) -> Self {
        change(&mut self.up);
        change(&mut self.down);
        self
    }
}

/// An error at an end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineError {
    /// Received bytes were lost, because [`Wire::rx_fifo`] was full.
    Overrun,
    /// Injected by the test.
    Injected,
    /// The far side is closed.
    Closed,
}

impl fmt::Display for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Overrun => "received bytes were lost because the receive FIFO was full",
            Self::Injected => "an injected error",
            Self::Closed => "the far side is closed",
        })
    }
}

impl std::error::Error for LineError {}

impl embedded_io::Error for LineError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// The line between a station and the vehicle. Clones are handles of the same line.
///
/// Equal seeds and calls give equal faults.
#[derive(Clone, Debug)]
pub struct Line {
    up: Rc<RefCell<Direction>>,
    down: Rc<RefCell<Direction>>,
}

impl Line {
    /// Creates a line.
    pub fn new(clock: &Clock, config: LineConfig, seed: u64) -> Self {
        let direction = |wire, seed| Rc::new(RefCell::new(Direction::new(clock.clone(), wire, seed)));
        Self { up: direction(config.up, seed), down: direction(config.down, !seed) }
    }

    /// Returns the vehicle's end and the station's end.
    pub fn ends(&self) -> (Port, Port) {
        let end = |rx: &Rc<_>, tx: &Rc<_>| Port { rx: Rc::clone(rx), tx: Rc::clone(tx) };
        (end(&self.up, &self.down), end(&self.down, &self.up))
    }

    /// Sends bytes to the vehicle, in place of the station's end. It takes all of them, whatever the transmit FIFO holds.
    pub fn send(&self, bytes: &[u8]) {
        self.up.borrow_mut().send_all(bytes);
    }

    /// Takes the bytes from the vehicle that have arrived, in place of the station's end.
    pub fn receive(&self) -> Vec<u8> {
        let mut down = self.down.borrow_mut();
        down.deliver();
        down.received.drain(..).collect()
    }

    /// Changes the direction to the vehicle from now on.
    pub fn set_up(&self, change: impl FnOnce(&mut Wire)) {
        change(&mut self.up.borrow_mut().wire);
    }

    /// Changes the direction to the station from now on.
    pub fn set_down(&self, change: impl FnOnce(&mut Wire)) {
        change(&mut self.down.borrow_mut().wire);
    }

    /// Loses frames with this probability, in both directions, from now on.
    pub fn set_loss(&self, probability: f64) {
        self.each(|direction| direction.wire.faults.frame_loss = probability);
    }

    /// Cuts the line: what is on it and what is sent from now on is lost. Neither end learns of it.
    pub fn cut(&self) {
        self.each(|direction| {
            direction.is_cut = true;
            direction.in_flight.clear();
        });
    }

    /// Restores a line that was cut.
    pub fn restore(&self) {
        self.each(|direction| direction.is_cut = false);
    }

    /// Whether the line is cut.
    pub fn is_cut(&self) -> bool {
        self.up.borrow().is_cut
    }

    /// Carries nothing for this long, in both directions. Bytes wait at the senders, and none is lost.
    pub fn stall(&self, duration: Duration) {
        self.each(|direction| direction.stall(duration));
    }

    /// Returns the number of bytes that have overrun the vehicle's [`Wire::rx_fifo`].
    pub fn overruns(&self) -> u64 {
        self.up.borrow().overruns
    }

    /// Draws the faults from another seed from now on.
    pub fn set_seed(&self, seed: u64) {
        self.up.borrow_mut().random = Random::new(seed);
        self.down.borrow_mut().random = Random::new(!seed);
    }

    /// Empties the vehicle's FIFOs, as a reset does. The last frame may end in the middle.
    pub(super) fn reset_vehicle(&self) {
        let mut up = self.up.borrow_mut();
        up.deliver();
        up.received.clear();
        up.read_error = None;
        let mut down = self.down.borrow_mut();
        down.unfinished.clear();
        down.write_error = None;
    }

    fn each(&self, mut change: impl FnMut(&mut Direction)) {
        change(&mut self.up.borrow_mut());
        change(&mut self.down.borrow_mut());
    }
}

/// One end of a [`Line`]: for the vehicle, what [`Stack::poll_link`](mavstack::Stack::poll_link) takes.
///
/// # Panics
///
/// A read without a received byte, a write without room and a flush would block for ever, because simulated time stands still: they panic.
/// So every test also proves that the firmware does not block.
#[derive(Clone, Debug)]
pub struct Port {
    rx: Rc<RefCell<Direction>>,
    tx: Rc<RefCell<Direction>>,
}

impl Port {
    /// Stalls reads until this time: nothing is ready. Bytes keep arriving.
    pub fn stall_reads_until(&self, until: Instant) {
        self.rx.borrow_mut().read_stalled = until;
    }

    /// Stalls writes until this time: there is no room.
    pub fn stall_writes_until(&self, until: Instant) {
        self.tx.borrow_mut().write_stalled = until;
    }

    /// Lets the next read fail.
    pub fn fail_next_read(&self, error: LineError) {
        self.rx.borrow_mut().read_error = Some(error);
    }

    /// Lets the next write fail.
    pub fn fail_next_write(&self, error: LineError) {
        self.tx.borrow_mut().write_error = Some(error);
    }

    /// Closes or reopens the far side, as of a TCP connection. While it is closed, reads return `Ok(0)` and writes fail. Bytes on the line
    /// are lost.
    pub fn set_closed(&self, is_closed: bool) {
        for direction in [&self.rx, &self.tx] {
            let mut direction = direction.borrow_mut();
            direction.is_closed = is_closed;
            direction.in_flight.clear();
            direction.received.clear();
            direction.unfinished.clear();
        }
    }

    /// Returns the number of bytes written to this end so far, before faults.
    pub fn written(&self) -> u64 {
        self.tx.borrow().written
    }

    /// Returns when the next byte can be read; in the past if it can be read now, [`Instant::NEVER`] if none is on the line.
    pub fn next_arrival(&self) -> Instant {
        self.rx.borrow().next_arrival()
    }

    /// Returns the number of bytes that can be read now.
    pub fn readable(&self) -> usize {
        self.receiver().received.len()
    }

    fn receiver(&self) -> RefMut<'_, Direction> {
        let mut rx = self.rx.borrow_mut();
        rx.deliver();
        rx
    }
}

impl ErrorType for Port {
    type Error = LineError;
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, LineError> {
        Ok(self.receiver().read_ready())
    }
}

impl Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, LineError> {
        let mut rx = self.receiver();
        assert!(rx.read_ready(), "the read would block: ask read_ready first");
        assert!(!bytes.is_empty(), "a read of nothing");
        if let Some(error) = rx.read_error.take() {
            return Err(error);
        }
        let most = bytes.len().min(rx.received.len());
        let len = rx.chunk(most);
        bytes.iter_mut().zip(rx.received.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl WriteReady for Port {
    fn write_ready(&mut self) -> Result<bool, LineError> {
        Ok(self.tx.borrow_mut().write_ready())
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        let mut tx = self.tx.borrow_mut();
        assert!(tx.write_ready(), "the write would block: ask write_ready first");
        assert!(!bytes.is_empty(), "a write of nothing");
        if let Some(error) = tx.write_error.take() {
            return Err(error);
        }
        if tx.is_closed {
            return Err(LineError::Closed);
        }
        let most = bytes.len().min(tx.room());
        let len = tx.chunk(most);
        tx.send_all(&bytes[..len]);
        Ok(len)
    }

    fn flush(&mut self) -> Result<(), LineError> {
        panic!("flush blocks");
    }
}

#[derive(Debug)]
struct Direction {
    clock: Clock,
    wire: Wire,
    random: Random,
    /// When the last byte has left the sender, in ns: at high rates a byte takes few µs.
    free_nanos: u64,
    /// When each byte leaves the transmit FIFO, in ns.
    departures: VecDeque<u64>,
    /// Bytes on the line with their times of arrival, the earliest first.
    in_flight: VecDeque<(Instant, u8)>,
    received: VecDeque<u8>,
    /// The bytes of an incomplete frame, if faults apply to frames.
    unfinished: Vec<u8>,
    is_cut: bool,
    is_closed: bool,
    read_stalled: Instant,
    write_stalled: Instant,
    read_error: Option<LineError>,
    write_error: Option<LineError>,
    overruns: u64,
    written: u64,
}

impl Direction {
    fn new(clock: Clock, wire: Wire, seed: u64) -> Self {
        Self {
            clock,
            wire,
            random: Random::new(seed),
            free_nanos: 0,
            departures: VecDeque::new(),
            in_flight: VecDeque::new(),
            received: VecDeque::new(),
            unfinished: Vec::new(),
            is_cut: false,
            is_closed: false,
            read_stalled: Instant::ZERO,
            write_stalled: Instant::ZERO,
            read_error: None,
            write_error: None,
            overruns: 0,
            written: 0,
        }
    }

    fn now_nanos(&self) -> u64 {
        nanos(self.clock.now() - Instant::ZERO)
    }

    fn stall(&mut self, duration: Duration) {
        self.free_nanos = self.free_nanos.max(self.now_nanos() + nanos(duration));
    }

    /// Moves arrived bytes to the receive FIFO.
    fn deliver(&mut self) {
        let now = self.clock.now();
        while let Some(&(at, byte)) = self.in_flight.front()
            && at <= now
        {
            self.in_flight.pop_front();
            if self.received.len() < self.wire.rx_fifo {
                self.received.push_back(byte);
            } else {
                self.overruns += 1;
                self.read_error = Some(LineError::Overrun);
            }
        }
    }

    fn next_arrival(&self) -> Instant {
        match self.in_flight.front() {
            _ if !self.received.is_empty() => Instant::ZERO,
            Some((at, _)) => *at,
            None => Instant::NEVER,
        }
    }

    fn read_ready(&self) -> bool {
        let is_readable = !self.received.is_empty() || self.read_error.is_some() || self.is_closed;
        is_readable && self.clock.now() >= self.read_stalled
    }

    /// Returns the free space of the transmit FIFO.
    fn room(&mut self) -> usize {
        let now = self.now_nanos();
        while self.departures.front().is_some_and(|&at| at <= now) {
            self.departures.pop_front();
        }
        self.wire.tx_fifo.saturating_sub(self.departures.len())
    }

    fn write_ready(&mut self) -> bool {
        self.room() > 0 && self.clock.now() >= self.write_stalled
    }

    /// Returns the bytes of one call, from 1 to `most`.
    fn chunk(&mut self, most: usize) -> usize {
        match self.wire.chunk {
            usize::MAX => most,
            chunk => most.min(1 + self.random.below(chunk as u64) as usize),
        }
    }

    fn send_all(&mut self, bytes: &[u8]) {
        self.written += bytes.len() as u64;
        bytes.iter().for_each(|&byte| self.send(byte));
    }

    /// Sends a byte. A lost one takes its time too.
    fn send(&mut self, byte: u8) {
        let now = self.now_nanos();
        let byte_nanos = 1_000_000_000_u64.checked_div(self.wire.bytes_per_second).unwrap_or(0);
        self.free_nanos = self.free_nanos.max(now) + byte_nanos;
        if self.free_nanos > now {
            self.departures.push_back(self.free_nanos);
        }
        let arrival = Instant::from_micros(self.free_nanos.div_ceil(1_000)) + self.wire.latency;
        if !self.wire.faults.are_per_frame() {
            return self.carry(arrival, &[byte]);
        }
        self.unfinished.push(byte);
        if self.unfinished.len() == frame_len(&self.unfinished) {
            let frame = std::mem::take(&mut self.unfinished);
            self.send_frame(arrival, &frame);
        }
    }

    /// A frame arrives with its last byte.
    fn send_frame(&mut self, arrival: Instant, frame: &[u8]) {
        let faults = self.wire.faults;
        if self.random.chance(faults.frame_loss) {
            return;
        }
        let copies = if self.random.chance(faults.frame_duplicate) { 2 } else { 1 };
        for _ in 0..copies {
            let is_late = self.random.chance(faults.frame_reorder);
            let late = if is_late { self.random.below(faults.reorder_by.as_micros() + 1) } else { 0 };
            self.carry(arrival + Duration::from_micros(late), frame);
        }
    }

    /// Puts bytes on the line, with the faults of bytes.
    fn carry(&mut self, arrival: Instant, bytes: &[u8]) {
        if self.is_cut {
            return;
        }
        // Behind what arrives before it, which all does unless frames may be late.
        let place = self.in_flight.partition_point(|&(at, _)| at <= arrival);
        let rest = self.in_flight.split_off(place);
        let faults = self.wire.faults;
        for &byte in bytes {
            if self.random.chance(faults.stall) {
                self.stall(faults.stall_for);
            }
            if self.random.chance(faults.burst) {
                for _ in 0..=self.random.below(faults.burst_len) {
                    let noise = self.random.byte();
                    self.in_flight.push_back((arrival, noise));
                }
            }
            if self.random.chance(faults.byte_loss) {
                continue;
            }
            let flip = if self.random.chance(faults.byte_flip) { 1 << self.random.below(8) } else { 0 };
            self.in_flight.push_back((arrival, byte ^ flip));
            if self.random.chance(faults.byte_duplicate) {
                self.in_flight.push_back((arrival, byte ^ flip));
            }
        }
        self.in_flight.extend(rest);
    }
}

fn nanos(duration: Duration) -> u64 {
    duration.as_micros().saturating_mul(1_000)
}

/// Returns the length of the frame that starts with these bytes, or 0 while it is unknown. A byte outside a frame counts as a frame of
/// one byte.
fn frame_len(bytes: &[u8]) -> usize {
    match *bytes {
        [0xFE, len, ..] => usize::from(len) + 8,
        [0xFD, len, flags, ..] => usize::from(len) + 12 + if flags & 1 != 0 { 13 } else { 0 },
        [0xFD | 0xFE, ..] => 0,
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(millis: u64) -> Instant {
        Instant::from_millis(millis)
    }

    /// Returns a line with its clock and the vehicle's end.
    fn line(config: LineConfig, seed: u64) -> (Clock, Line, Port) {
        let clock = Clock::default();
        let line = Line::new(&clock, config, seed);
        let (port, _) = line.ends();
        (clock, line, port)
    }

    /// A MAVLink 1 frame with no payload, and this sequence number.
    fn frame(seq: u8) -> [u8; 8] {
        [0xFE, 0, seq, 1, 1, 0, 0, 0]
    }

    fn read(port: &mut Port) -> Vec<u8> {
        let mut bytes = Vec::new();
        while port.read_ready().unwrap() {
            let mut some = [0; 64];
            let len = port.read(&mut some).unwrap();
            bytes.extend(&some[..len]);
        }
        bytes
    }

    #[test]
    fn bytes_arrive_at_the_rate_after_the_delay() {
        let (clock, line, mut port) = line(LineConfig::radio(10_000, Duration::from_millis(5)), 1);
        line.send(b"ab");
        for (millis, expected) in [(5, &b""[..]), (6, b"a"), (7, b"b")] {
            clock.set(ms(millis));
            assert_eq!(read(&mut port), expected, "{millis} ms");
        }
    }

    #[test]
    fn a_full_transmit_fifo_is_not_ready() {
        let mut config = LineConfig::uart(10_000);
        config.down.tx_fifo = 4;
        let (clock, line, mut port) = line(config, 1);
        assert_eq!(port.write(b"abcdef"), Ok(4));
        assert_eq!(port.write_ready(), Ok(false));
        clock.set(ms(2));
        assert_eq!((port.write(b"ef"), line.receive()), (Ok(2), b"ab".to_vec()));
    }

    #[test]
    fn overruns_lose_the_newest_bytes_and_are_reported() {
        let (_, line, mut port) = line(LineConfig::default().with_rx_fifo(3), 1);
        line.send(b"abcde");
        assert_eq!(port.read(&mut [0; 8]), Err(LineError::Overrun));
        assert_eq!((read(&mut port), line.overruns()), (b"abc".to_vec(), 2));
    }

    #[test]
    fn a_cut_line_loses_everything_until_it_is_restored() {
        let (clock, line, mut port) = line(LineConfig::radio(0, Duration::from_millis(5)), 1);
        line.send(b"a");
        line.cut();
        line.send(b"b");
        assert_eq!(port.write(b"c"), Ok(1));
        line.restore();
        line.send(b"d");
        clock.set(ms(5));
        assert_eq!((read(&mut port), line.receive()), (b"d".to_vec(), vec![]));
    }

    #[test]
    fn a_stall_delays_and_loses_nothing() {
        let (clock, line, mut port) = line(LineConfig::default(), 1);
        line.stall(Duration::from_millis(30));
        line.send(b"a");
        clock.set(ms(29));
        assert_eq!(read(&mut port), b"");
        clock.set(ms(30));
        assert_eq!(read(&mut port), b"a");
    }

    /// Whole frames are lost and duplicated, also if they are written in pieces, and equally for the same seed.
    #[test]
    fn frames_are_lost_as_a_whole() {
        let run = |seed| {
            let (_, line, mut port) =
                line(LineConfig::default().with_loss(0.2).with_duplicates(0.1).with_chunks(5), seed);
            for seq in 0..200 {
                let mut rest = &frame(seq)[..];
                while !rest.is_empty() {
                    let len = port.write(rest).unwrap();
                    rest = &rest[len..];
                }
            }
            line.receive()
        };
        let received = run(1);
        assert!(received.chunks(8).all(|bytes| bytes == frame(bytes[2])));
        let mut seqs: Vec<u8> = received.chunks(8).map(|bytes| bytes[2]).collect();
        assert!((160..200).contains(&seqs.len()), "{}", seqs.len());
        seqs.dedup();
        assert!((140..180).contains(&seqs.len()), "{}", seqs.len());
        assert!(run(1) == received && run(2) != received);
    }

    #[test]
    fn damage_changes_bytes_but_not_their_number() {
        let (_, line, mut port) = line(LineConfig::default().with_damage(0.1), 3);
        line.send(&[0; 1_000]);
        let bytes = read(&mut port);
        let damaged = bytes.iter().filter(|byte| **byte != 0).count();
        assert!(bytes.len() == 1_000 && (60..140).contains(&damaged), "{damaged}");
        assert!(bytes.iter().all(|byte| byte.count_ones() <= 1));
    }
}
