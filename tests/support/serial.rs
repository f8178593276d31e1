//! A simulated full-duplex serial line with faults.

use super::Rng;
use embedded_io::{ErrorKind, ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::{Duration, Instant};
use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    rc::Rc,
};

/// The simulated time, shared by all parts of a simulation.
#[derive(Clone, Debug, Default)]
pub struct Clock(Rc<Cell<Instant>>);

impl Clock {
    pub fn new(start: Instant) -> Self {
        Self(Rc::new(Cell::new(start)))
    }

    pub fn now(&self) -> Instant {
        self.0.get()
    }

    pub fn set(&self, now: Instant) {
        self.0.set(now);
    }
}

/// The faults of one direction of a line, as probabilities; 0 by default.
#[derive(Clone, Copy, Debug, Default)]
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
    /// After a byte the writer stalls for [`stall_for`](Self::stall_for).
    pub stall: f64,
    /// See [`stall`](Self::stall).
    pub stall_for: Duration,
    /// A frame is lost.
    pub frame_loss: f64,
    /// A frame is duplicated.
    pub frame_duplicate: f64,
    /// A frame is delayed by up to [`reorder_by`](Self::reorder_by), so that frames may be reordered.
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

/// One direction of a line.
#[derive(Clone, Copy, Debug)]
pub struct Wire {
    /// Data rate (bytes/s); 0 is infinitely fast.
    pub bytes_per_second: u64,
    /// Time from writing a byte until it can be read.
    pub latency: Duration,
    /// Capacity of the transmit FIFO, in bytes. When it is full, the writer is not ready.
    pub tx_fifo: usize,
    /// Capacity of the receive FIFO, in bytes. When it is full, bytes overrun it.
    pub rx_fifo: usize,
    /// Maximum bytes per read or write, drawn from 1 to this number; 0 means no limit.
    pub piece: usize,
    /// The faults.
    pub faults: Faults,
}

impl Default for Wire {
    /// Infinitely fast, with FIFOs of 1 KiB (transmit) and 4 KiB (receive), and without faults.
    fn default() -> Self {
        Self {
            bytes_per_second: 0,
            latency: Duration::ZERO,
            tx_fifo: 1_024,
            rx_fifo: 4_096,
            piece: 0,
            faults: Faults::default(),
        }
    }
}

/// Both directions of a line.
#[derive(Clone, Copy, Debug, Default)]
pub struct LineConfig {
    /// From the ground station to the vehicle.
    pub up: Wire,
    /// From the vehicle to the ground station.
    pub down: Wire,
}

impl LineConfig {
    /// Uses the same properties for both directions.
    pub fn both(wire: Wire) -> Self {
        Self { up: wire, down: wire }
    }

    /// Returns a radio of `baud` bit/s with `latency` in each direction.
    pub fn radio(baud: u64, latency: Duration) -> Self {
        Self::both(Wire { bytes_per_second: baud / 10, latency, ..Wire::default() })
    }
}

/// An error of an end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimError {
    /// Bytes arrived faster than they were read and were lost.
    Overrun,
    /// Injected by the test.
    Injected,
    /// The far side is closed.
    Closed,
}

impl core::fmt::Display for SimError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{self:?}")
    }
}

impl core::error::Error for SimError {}

impl embedded_io::Error for SimError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Other
    }
}

/// Controls a serial line. Its [ends](Self::ends) are read and written; this handle injects faults.
#[derive(Clone, Debug)]
pub struct SimSerial {
    up: Rc<RefCell<Direction>>,
    down: Rc<RefCell<Direction>>,
}

impl SimSerial {
    pub fn new(clock: &Clock, config: LineConfig, seed: u64) -> Self {
        let direction = |wire, seed| Rc::new(RefCell::new(Direction::new(clock.clone(), wire, seed)));
        Self { up: direction(config.up, seed), down: direction(config.down, !seed) }
    }

    /// Returns the vehicle's end and the ground station's end.
    pub fn ends(&self) -> (SerialEnd, SerialEnd) {
        let end = |rx: &Rc<_>, tx: &Rc<_>| SerialEnd { rx: Rc::clone(rx), tx: Rc::clone(tx) };
        (end(&self.up, &self.down), end(&self.down, &self.up))
    }

    /// Changes the direction to the vehicle from now on.
    pub fn set_up(&self, change: impl FnOnce(&mut Wire)) {
        change(&mut self.up.borrow_mut().wire);
    }

    /// Changes the direction to the ground station from now on.
    pub fn set_down(&self, change: impl FnOnce(&mut Wire)) {
        change(&mut self.down.borrow_mut().wire);
    }
}

/// One end of a [`SimSerial`]. Panics where a real end would block.
#[derive(Clone, Debug)]
pub struct SerialEnd {
    rx: Rc<RefCell<Direction>>,
    tx: Rc<RefCell<Direction>>,
}

impl SerialEnd {
    /// Stalls reads until this time. Bytes keep arriving.
    pub fn stall_reads_until(&self, until: Instant) {
        self.rx.borrow_mut().read_stalled = until;
    }

    /// Stalls writes until this time.
    pub fn stall_writes_until(&self, until: Instant) {
        self.tx.borrow_mut().write_stalled = until;
    }

    /// Lets the next read fail.
    pub fn fail_next_read(&self, error: SimError) {
        self.rx.borrow_mut().read_error = Some(error);
    }

    /// Lets the next write fail.
    pub fn fail_next_write(&self, error: SimError) {
        self.tx.borrow_mut().write_error = Some(error);
    }

    /// Closes or reopens the far side. While it is closed, reads return `Ok(0)` and writes fail. Bytes in transit are lost.
    pub fn set_closed(&self, closed: bool) {
        for direction in [&self.rx, &self.tx] {
            let mut direction = direction.borrow_mut();
            direction.closed = closed;
            direction.in_flight.clear();
            direction.received.clear();
            direction.unfinished.clear();
        }
    }

    /// Returns the number of bytes written to this end so far, before faults.
    pub fn written(&self) -> u64 {
        self.tx.borrow().written
    }

    /// Returns when the next byte can be read; in the past if it can be read now.
    pub fn next_arrival(&self) -> Instant {
        self.rx.borrow().next_arrival()
    }

    /// Returns the number of bytes that can be read now.
    pub fn readable(&self) -> usize {
        let mut direction = self.rx.borrow_mut();
        direction.deliver();
        direction.received.len()
    }
}

impl ErrorType for SerialEnd {
    type Error = SimError;
}

impl ReadReady for SerialEnd {
    fn read_ready(&mut self) -> Result<bool, SimError> {
        Ok(self.rx.borrow_mut().read_ready())
    }
}

impl Read for SerialEnd {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, SimError> {
        self.rx.borrow_mut().read(buf)
    }
}

impl WriteReady for SerialEnd {
    fn write_ready(&mut self) -> Result<bool, SimError> {
        Ok(self.tx.borrow_mut().write_ready())
    }
}

impl Write for SerialEnd {
    fn write(&mut self, buf: &[u8]) -> Result<usize, SimError> {
        self.tx.borrow_mut().write(buf)
    }

    fn flush(&mut self) -> Result<(), SimError> {
        panic!("flush blocks");
    }
}

#[derive(Debug)]
struct Direction {
    clock: Clock,
    wire: Wire,
    rng: Rng,
    /// Bytes in transit with their times of arrival, the earliest first.
    in_flight: VecDeque<(Instant, u8)>,
    /// When each byte leaves the transmit FIFO.
    departures: VecDeque<Instant>,
    received: VecDeque<u8>,
    /// The bytes of an incomplete frame, if faults apply to frames.
    unfinished: Vec<u8>,
    written: u64,
    read_stalled: Instant,
    write_stalled: Instant,
    read_error: Option<SimError>,
    write_error: Option<SimError>,
    closed: bool,
}

impl Direction {
    fn new(clock: Clock, wire: Wire, seed: u64) -> Self {
        Self {
            clock,
            wire,
            rng: Rng::new(seed),
            in_flight: VecDeque::new(),
            departures: VecDeque::new(),
            received: VecDeque::new(),
            unfinished: Vec::new(),
            written: 0,
            read_stalled: Instant::ZERO,
            write_stalled: Instant::ZERO,
            read_error: None,
            write_error: None,
            closed: false,
        }
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
                self.read_error = Some(SimError::Overrun);
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

    fn read_ready(&mut self) -> bool {
        self.deliver();
        let readable = !self.received.is_empty() || self.read_error.is_some() || self.closed;
        readable && self.clock.now() >= self.read_stalled
    }

    fn read(&mut self, buf: &mut [u8]) -> Result<usize, SimError> {
        assert!(self.read_ready(), "the read would block");
        assert!(!buf.is_empty(), "a read of nothing");
        if let Some(error) = self.read_error.take() {
            return Err(error);
        }
        let len = self.piece(buf.len().min(self.received.len()));
        for (to, from) in buf.iter_mut().zip(self.received.drain(..len)) {
            *to = from;
        }
        Ok(len)
    }

    /// Returns the free space of the transmit FIFO.
    fn room(&mut self) -> usize {
        let now = self.clock.now();
        while self.departures.front().is_some_and(|&at| at <= now) {
            self.departures.pop_front();
        }
        self.wire.tx_fifo.saturating_sub(self.departures.len())
    }

    fn write_ready(&mut self) -> bool {
        self.room() > 0 && self.clock.now() >= self.write_stalled
    }

    fn write(&mut self, buf: &[u8]) -> Result<usize, SimError> {
        assert!(self.write_ready(), "the write would block");
        assert!(!buf.is_empty(), "a write of nothing");
        if let Some(error) = self.write_error.take() {
            return Err(error);
        }
        if self.closed {
            return Err(SimError::Closed);
        }
        let len = buf.len().min(self.room());
        let len = self.piece(len);
        for &byte in &buf[..len] {
            self.send(byte);
        }
        self.written += len as u64;
        Ok(len)
    }

    /// Returns a random number of bytes, from 1 to `len`.
    fn piece(&mut self, len: usize) -> usize {
        match self.wire.piece {
            0 => len,
            most => len.min(1 + self.rng.below(most as u64) as usize),
        }
    }

    fn send(&mut self, byte: u8) {
        // A lost byte takes its time on the line too.
        let now = self.clock.now();
        let begin = self.departures.back().copied().unwrap_or(now).max(now);
        let micros = 1_000_000_u64.checked_div(self.wire.bytes_per_second).unwrap_or(0);
        let departure = begin + Duration::from_micros(micros);
        if micros > 0 {
            self.departures.push_back(departure);
        }
        let arrival = departure + self.wire.latency;
        if self.wire.faults.are_per_frame() {
            self.unfinished.push(byte);
            if self.unfinished.len() == frame_len(&self.unfinished) {
                let frame = std::mem::take(&mut self.unfinished);
                self.send_frame(arrival, &frame);
            }
        } else {
            self.send_byte(arrival, byte);
        }
    }

    fn send_byte(&mut self, arrival: Instant, byte: u8) {
        let faults = self.wire.faults;
        if self.rng.chance(faults.stall) {
            self.write_stalled = self.clock.now() + faults.stall_for;
        }
        if self.rng.chance(faults.burst) {
            for _ in 0..=self.rng.below(faults.burst_len) {
                let garbage = self.rng.byte();
                self.in_flight.push_back((arrival, garbage));
            }
        }
        if self.rng.chance(faults.byte_loss) {
            return;
        }
        let flip = if self.rng.chance(faults.byte_flip) { 1 << self.rng.below(8) } else { 0 };
        self.in_flight.push_back((arrival, byte ^ flip));
        if self.rng.chance(faults.byte_duplicate) {
            self.in_flight.push_back((arrival, byte ^ flip));
        }
    }

    /// A frame arrives with its last byte.
    fn send_frame(&mut self, arrival: Instant, frame: &[u8]) {
        let faults = self.wire.faults;
        if self.rng.chance(faults.frame_loss) {
            return;
        }
        let copies = if self.rng.chance(faults.frame_duplicate) { 2 } else { 1 };
        for _ in 0..copies {
            let late = self.rng.chance(faults.frame_reorder);
            let late = if late { self.rng.below(faults.reorder_by.as_micros() + 1) } else { 0 };
            let arrival = arrival + Duration::from_micros(late);
            let place = self.in_flight.partition_point(|&(at, _)| at <= arrival);
            let rest = self.in_flight.split_off(place);
            self.in_flight.extend(frame.iter().map(|&byte| (arrival, byte)));
            self.in_flight.extend(rest);
        }
    }
}

/// Returns the length of the frame that starts like this, or 0 while it is unknown. A byte outside a frame counts as a frame of one
/// byte.
fn frame_len(bytes: &[u8]) -> usize {
    match *bytes {
        [0xFE, len, ..] => usize::from(len) + 8,
        [0xFD, len, flags, ..] => usize::from(len) + 12 + if flags & 1 != 0 { 13 } else { 0 },
        [0xFD | 0xFE, ..] => 0,
        _ => 1,
    }
}
