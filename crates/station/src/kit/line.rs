//! A serial line or a radio in simulated time.

use std::cell::{RefCell, RefMut};
use std::collections::VecDeque;
use std::fmt;
use std::rc::Rc;

use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Duration, Instant};

use super::random::Random;

/// The properties of one direction of a line. Faults are probabilities from 0 to 1.
///
/// Faults of frames and of bytes may be combined: the faults of bytes then apply to the frames that are left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wire {
    /// The rate in bit/s, with ten bits a byte; 0 is infinitely fast.
    pub rate: u32,
    /// The time from the end of a byte at the sender to its arrival.
    pub delay: Duration,
    /// The bytes that the sender may write ahead of the rate. A sender that is further ahead is not ready to write.
    pub tx_fifo: usize,
    /// The bytes that the receiver buffers. Further bytes are lost as an overrun. `None` is unlimited.
    pub rx_fifo: Option<usize>,
    /// The most bytes of one read or write, which takes a random number of bytes up to this; `None` is unlimited.
    pub chunk: Option<usize>,
    /// A frame is lost.
    pub frame_loss: f64,
    /// A frame arrives twice.
    pub frame_duplicates: f64,
    /// A frame is delayed by up to [`late_by`](Self::late_by), so later frames overtake it.
    pub frame_late: f64,
    /// The longest extra delay of a late frame.
    pub late_by: Duration,
    /// A byte is lost.
    pub byte_loss: f64,
    /// A bit of a byte is flipped.
    pub bit_flips: f64,
    /// Random bytes, up to 16, arrive before a byte.
    pub noise: f64,
    /// The line stalls after a byte for [`stall_for`](Self::stall_for).
    pub stalls: f64,
    /// The length of a random stall.
    pub stall_for: Duration,
}

impl Wire {
    /// An infinitely fast direction without a fault and without a limit of the receiver.
    pub const IDEAL: Self = Self {
        rate: 0,
        delay: Duration::ZERO,
        tx_fifo: 1_024,
        rx_fifo: None,
        chunk: None,
        frame_loss: 0.0,
        frame_duplicates: 0.0,
        frame_late: 0.0,
        late_by: Duration::ZERO,
        byte_loss: 0.0,
        bit_flips: 0.0,
        noise: 0.0,
        stalls: 0.0,
        stall_for: Duration::ZERO,
    };

    fn has_frame_faults(&self) -> bool {
        self.frame_loss > 0.0 || self.frame_duplicates > 0.0 || self.frame_late > 0.0
    }

    /// Returns the time that a byte takes, in ns.
    fn byte_nanos(&self) -> u64 {
        10_000_000_000_u64.checked_div(self.rate.into()).unwrap_or(0)
    }
}

impl Default for Wire {
    fn default() -> Self {
        Self::IDEAL
    }
}

/// The properties of both directions of a line.
///
/// ```
/// use mavstack::Duration;
/// use mavstack_station::kit::LineConfig;
///
/// let radio = LineConfig::uart(57_600).with_delay(Duration::from_millis(40)).with_loss(0.2);
/// assert_eq!((radio.up.rate, radio.down.frame_loss), (57_600, 0.2));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LineConfig {
    /// From the station to the vehicle.
    pub up: Wire,
    /// From the vehicle to the station.
    pub down: Wire,
}

impl LineConfig {
    /// An infinitely fast line without a fault.
    pub const IDEAL: Self = Self { up: Wire::IDEAL, down: Wire::IDEAL };

    /// Returns a wire of this rate in bit/s, without a fault.
    pub const fn uart(rate: u32) -> Self {
        let wire = Wire { rate, ..Wire::IDEAL };
        Self { up: wire, down: wire }
    }

    /// Delays the bytes in each direction.
    pub fn with_delay(self, delay: Duration) -> Self {
        self.both(|wire| wire.delay = delay)
    }

    /// Loses frames in each direction with this probability.
    pub fn with_loss(self, probability: f64) -> Self {
        self.both(|wire| wire.frame_loss = probability)
    }

    /// Duplicates frames in each direction with this probability.
    pub fn with_duplicates(self, probability: f64) -> Self {
        self.both(|wire| wire.frame_duplicates = probability)
    }

    /// Flips bits in each direction, with this probability for each byte.
    pub fn with_damage(self, probability: f64) -> Self {
        self.both(|wire| wire.bit_flips = probability)
    }

    /// Reads and writes at most this number of bytes at once.
    pub fn with_chunks(self, most: usize) -> Self {
        self.both(|wire| wire.chunk = Some(most))
    }

    /// Buffers at most this number of received bytes at the vehicle, as the FIFO or the ring buffer of its UART does.
    pub fn with_rx_fifo(mut self, bytes: usize) -> Self {
        self.up.rx_fifo = Some(bytes);
        self
    }

    fn both(mut self, change: impl Fn(&mut Wire)) -> Self {
        change(&mut self.up);
        change(&mut self.down);
        self
    }
}

/// An error at the vehicle's end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineError {
    /// Received bytes were lost, because [`Wire::rx_fifo`] was full.
    Overrun,
    /// Injected by [`Line::fail_read`] or [`Line::fail_write`].
    Injected,
}

impl fmt::Display for LineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Overrun => "received bytes were lost because the receive FIFO was full",
            Self::Injected => "an injected error",
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
/// The station's end is [`send`](Self::send) and [`receive`](Self::receive); the vehicle's is a [`Port`]. The line has no clock: call
/// [`advance`](Self::advance) first. Equal seeds and calls give equal faults.
#[derive(Clone, Debug)]
pub struct Line {
    up: Rc<RefCell<Direction>>,
    down: Rc<RefCell<Direction>>,
}

impl Line {
    /// Creates a line.
    pub fn new(config: LineConfig, seed: u64) -> Self {
        let direction = |wire, seed| Rc::new(RefCell::new(Direction::new(wire, seed)));
        Self { up: direction(config.up, seed), down: direction(config.down, !seed) }
    }

    /// Returns the vehicle's end.
    pub fn port(&self) -> Port {
        Port { rx: Rc::clone(&self.up), tx: Rc::clone(&self.down) }
    }

    /// Sets the time. Time that goes back is ignored.
    pub fn advance(&self, now: Instant) {
        self.each(|direction| direction.now = direction.now.max(now));
    }

    /// Sends bytes to the vehicle. A station buffers without a limit, so all of them are taken.
    pub fn send(&self, bytes: &[u8]) {
        let mut up = self.up.borrow_mut();
        bytes.iter().for_each(|&byte| up.send(byte));
    }

    /// Takes the bytes from the vehicle that have arrived.
    pub fn receive(&self) -> Vec<u8> {
        let mut down = self.down.borrow_mut();
        down.deliver();
        down.received.drain(..).collect()
    }

    /// Returns the properties.
    pub fn config(&self) -> LineConfig {
        LineConfig { up: self.up.borrow().wire, down: self.down.borrow().wire }
    }

    /// Replaces the properties from the next byte on.
    pub fn configure(&self, config: LineConfig) {
        self.up.borrow_mut().wire = config.up;
        self.down.borrow_mut().wire = config.down;
    }

    /// Loses frames with this probability, in both directions.
    pub fn set_loss(&self, probability: f64) {
        self.configure(self.config().with_loss(probability));
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

    /// Lets the next read at the vehicle fail.
    pub fn fail_read(&self) {
        self.up.borrow_mut().read_error = Some(LineError::Injected);
    }

    /// Lets the next write at the vehicle fail.
    pub fn fail_write(&self) {
        self.down.borrow_mut().write_error = Some(LineError::Injected);
    }

    /// Returns the number of bytes that have overrun the vehicle's [`Wire::rx_fifo`].
    pub fn overruns(&self) -> u64 {
        self.up.borrow().overruns
    }

    /// Returns the number of bytes that the vehicle has written, before faults.
    pub fn written(&self) -> u64 {
        self.down.borrow().written
    }

    /// Restarts the random faults.
    pub(super) fn set_seed(&self, seed: u64) {
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

/// The vehicle's end of a [`Line`], for [`Stack::poll_link`](mavstack::Stack::poll_link).
///
/// # Panics
///
/// A read without a received byte and a write without room would block for ever, because simulated time stands still: they panic. Ask
/// `read_ready` and `write_ready` first.
#[derive(Clone, Debug)]
pub struct Port {
    rx: Rc<RefCell<Direction>>,
    tx: Rc<RefCell<Direction>>,
}

impl Port {
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
        let rx = self.receiver();
        Ok(!rx.received.is_empty() || rx.read_error.is_some())
    }
}

impl Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, LineError> {
        let mut rx = self.receiver();
        if let Some(error) = rx.read_error.take() {
            return Err(error);
        }
        if bytes.is_empty() {
            return Ok(0);
        }
        assert!(!rx.received.is_empty(), "the read would block: ask read_ready first");
        let most = bytes.len().min(rx.received.len());
        let len = rx.chunk(most);
        bytes.iter_mut().zip(rx.received.drain(..len)).for_each(|(to, from)| *to = from);
        Ok(len)
    }
}

impl WriteReady for Port {
    fn write_ready(&mut self) -> Result<bool, LineError> {
        let mut tx = self.tx.borrow_mut();
        Ok(tx.room() > 0 || tx.write_error.is_some())
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        let mut tx = self.tx.borrow_mut();
        if let Some(error) = tx.write_error.take() {
            return Err(error);
        }
        if bytes.is_empty() {
            return Ok(0);
        }
        let room = tx.room();
        assert!(room > 0, "the write would block: ask write_ready first");
        let len = tx.chunk(bytes.len().min(room));
        bytes[..len].iter().for_each(|&byte| tx.send(byte));
        tx.written += len as u64;
        Ok(len)
    }

    /// Returns at once: waiting for the line would block.
    fn flush(&mut self) -> Result<(), LineError> {
        Ok(())
    }
}

#[derive(Debug)]
struct Direction {
    now: Instant,
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
    read_error: Option<LineError>,
    write_error: Option<LineError>,
    overruns: u64,
    written: u64,
}

impl Direction {
    fn new(wire: Wire, seed: u64) -> Self {
        Self {
            now: Instant::ZERO,
            wire,
            random: Random::new(seed),
            free_nanos: 0,
            departures: VecDeque::new(),
            in_flight: VecDeque::new(),
            received: VecDeque::new(),
            unfinished: Vec::new(),
            is_cut: false,
            read_error: None,
            write_error: None,
            overruns: 0,
            written: 0,
        }
    }

    fn now_nanos(&self) -> u64 {
        self.now.as_micros() * 1_000
    }

    fn stall(&mut self, duration: Duration) {
        self.free_nanos = self.free_nanos.max(self.now_nanos() + duration.as_micros() * 1_000);
    }

    /// Moves arrived bytes to the receive FIFO.
    fn deliver(&mut self) {
        while let Some(&(at, byte)) = self.in_flight.front()
            && at <= self.now
        {
            self.in_flight.pop_front();
            if self.wire.rx_fifo.is_none_or(|most| self.received.len() < most) {
                self.received.push_back(byte);
            } else {
                self.overruns += 1;
                self.read_error = Some(LineError::Overrun);
            }
        }
    }

    /// Returns the free space of the transmit FIFO.
    fn room(&mut self) -> usize {
        let now = self.now_nanos();
        while self.departures.front().is_some_and(|&at| at <= now) {
            self.departures.pop_front();
        }
        self.wire.tx_fifo.saturating_sub(self.departures.len())
    }

    /// Returns the bytes of one call, from 1 to `most`.
    fn chunk(&mut self, most: usize) -> usize {
        match self.wire.chunk {
            None => most,
            Some(chunk) => most.min(1 + self.random.below(chunk as u64) as usize),
        }
    }

    /// Sends a byte. A lost one takes its time too.
    fn send(&mut self, byte: u8) {
        self.free_nanos = self.free_nanos.max(self.now_nanos()) + self.wire.byte_nanos();
        if self.free_nanos > self.now_nanos() {
            self.departures.push_back(self.free_nanos);
        }
        let arrival = Instant::from_micros(self.free_nanos.div_ceil(1_000)) + self.wire.delay;
        if self.random.chance(self.wire.stalls) {
            self.free_nanos += self.wire.stall_for.as_micros() * 1_000;
        }
        if !self.wire.has_frame_faults() {
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
        if self.random.chance(self.wire.frame_loss) {
            return;
        }
        let copies = if self.random.chance(self.wire.frame_duplicates) { 2 } else { 1 };
        for _ in 0..copies {
            let is_late = self.random.chance(self.wire.frame_late);
            let late = if is_late { self.random.below(self.wire.late_by.as_micros() + 1) } else { 0 };
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
        for &byte in bytes {
            if self.random.chance(self.wire.noise) {
                for _ in 0..=self.random.below(16) {
                    let noise = self.random.byte();
                    self.in_flight.push_back((arrival, noise));
                }
            }
            let flip = if self.random.chance(self.wire.bit_flips) { 1 << self.random.below(8) } else { 0 };
            if !self.random.chance(self.wire.byte_loss) {
                self.in_flight.push_back((arrival, byte ^ flip));
            }
        }
        self.in_flight.extend(rest);
    }
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
        let line = Line::new(LineConfig::uart(10_000).with_delay(Duration::from_millis(5)), 1);
        let mut port = line.port();
        line.send(b"ab");
        for (millis, expected) in [(5, &b""[..]), (6, b"a"), (7, b"b")] {
            line.advance(ms(millis));
            assert_eq!(read(&mut port), expected, "{millis} ms");
        }
    }

    #[test]
    fn a_full_transmit_fifo_is_not_ready() {
        let mut config = LineConfig::uart(10_000);
        config.down.tx_fifo = 4;
        let line = Line::new(config, 1);
        let mut port = line.port();
        assert_eq!(port.write(b"abcdef"), Ok(4));
        assert_eq!(port.write_ready(), Ok(false));
        line.advance(ms(2));
        assert_eq!((port.write(b"ef"), line.receive()), (Ok(2), b"ab".to_vec()));
    }

    #[test]
    fn overruns_lose_the_newest_bytes_and_are_reported() {
        let line = Line::new(LineConfig::IDEAL.with_rx_fifo(3), 1);
        let mut port = line.port();
        line.send(b"abcde");
        assert_eq!(port.read(&mut [0; 8]), Err(LineError::Overrun));
        assert_eq!((read(&mut port), line.overruns()), (b"abc".to_vec(), 2));
    }

    #[test]
    fn a_cut_line_loses_everything_until_it_is_restored() {
        let line = Line::new(LineConfig::IDEAL.with_delay(Duration::from_millis(5)), 1);
        let mut port = line.port();
        line.send(b"a");
        line.cut();
        line.send(b"b");
        assert_eq!(port.write(b"c"), Ok(1));
        line.restore();
        line.send(b"d");
        line.advance(ms(5));
        assert_eq!((read(&mut port), line.receive()), (b"d".to_vec(), vec![]));
    }

    #[test]
    fn a_stall_delays_and_loses_nothing() {
        let line = Line::new(LineConfig::IDEAL, 1);
        line.stall(Duration::from_millis(30));
        line.send(b"a");
        line.advance(ms(29));
        assert_eq!(read(&mut line.port()), b"");
        line.advance(ms(30));
        assert_eq!(read(&mut line.port()), b"a");
    }

    /// Whole frames are lost and duplicated, also if they are written in pieces, and equally for the same seed.
    #[test]
    fn frames_are_lost_as_a_whole() {
        let run = |seed| {
            let line = Line::new(LineConfig::IDEAL.with_loss(0.2).with_duplicates(0.1).with_chunks(5), seed);
            let mut port = line.port();
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
        let line = Line::new(LineConfig::IDEAL.with_damage(0.1), 3);
        line.send(&[0; 1_000]);
        let bytes = read(&mut line.port());
        let damaged = bytes.iter().filter(|byte| **byte != 0).count();
        assert!(bytes.len() == 1_000 && (60..140).contains(&damaged), "{damaged}");
        assert!(bytes.iter().all(|byte| byte.count_ones() <= 1));
    }
}
