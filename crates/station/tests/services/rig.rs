//! The boat and its stack in one process with a station, on a line that loses frames.

use std::collections::VecDeque;
use std::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::prelude::*;
use mavstack_station::{Client, Drive, Failure, Station};

use crate::vehicle::{Boat, Mavlink};

/// The vehicle's end of a line without a rate.
#[derive(Default)]
struct Uart {
    received: VecDeque<u8>,
    sent: Vec<u8>,
}

impl ErrorType for Uart {
    type Error = Infallible;
}

impl ReadReady for Uart {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.received.is_empty())
    }
}

impl Read for Uart {
    fn read(&mut self, buf: &mut [u8]) -> Result<usize, Infallible> {
        let len = buf.len().min(self.received.len());
        for (to, from) in buf.iter_mut().zip(self.received.drain(..len)) {
            *to = from;
        }
        Ok(len)
    }
}

impl WriteReady for Uart {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}

impl Write for Uart {
    fn write(&mut self, buf: &[u8]) -> Result<usize, Infallible> {
        self.sent.extend(buf);
        Ok(buf.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// The vehicle, the line and the station.
pub struct Rig {
    pub stack: Box<StackOf<Mavlink>>,
    pub vehicle: Boat,
    pub now: Instant,
    station: Station,
    uart: Uart,
    pulse: &'static Pulse,
    /// The probability that a frame is lost, in each direction.
    pub loss: f64,
    rng: fastrand::Rng,
    down: Vec<u8>,
}

impl Rig {
    pub fn new(client: Client, loss: f64, seed: u64) -> Self {
        let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
        let config = Config::new(Address::new(1, 1), pulse);
        Self {
            stack: Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::uart(115_200)])),
            vehicle: Boat::default(),
            now: Instant::ZERO,
            station: Station::new(client),
            uart: Uart::default(),
            pulse,
            loss,
            rng: fastrand::Rng::with_seed(seed),
            down: Vec::new(),
        }
    }

    /// Loses some of the whole frames in `bytes`, which it takes.
    fn lossy(&mut self, bytes: &mut Vec<u8>) -> Vec<u8> {
        let mut kept = Vec::new();
        while let Some(len) = frame_len(bytes) {
            let frame: Vec<u8> = bytes.drain(..len).collect();
            if self.rng.f64() >= self.loss {
                kept.extend(frame);
            }
        }
        kept
    }
}

/// Returns the length of the first frame in `bytes` if it is whole.
fn frame_len(bytes: &[u8]) -> Option<usize> {
    let len = match *bytes {
        [0xFE, len, ..] => usize::from(len) + 8,
        [0xFD, len, flags, ..] => usize::from(len) + 12 + if flags & 1 != 0 { 13 } else { 0 },
        _ => return None,
    };
    (bytes.len() >= len).then_some(len)
}

impl Drive for Rig {
    fn station(&mut self) -> &mut Station {
        &mut self.station
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        self.now += Duration::from_millis(5);
        let mut up = self.station.take_output();
        let up = self.lossy(&mut up);
        self.uart.received.extend(up);
        self.pulse.tick();
        self.stack.poll(self.now, &mut self.vehicle);
        let _ = self.stack.poll_link(self.now, LinkId(0), &mut self.uart, &mut self.vehicle);
        self.down.append(&mut self.uart.sent);
        let mut down = std::mem::take(&mut self.down);
        let received = self.lossy(&mut down);
        self.down = down;
        self.station.receive(self.now, &received);
        self.station.poll(self.now);
        Ok(self.now)
    }
}
