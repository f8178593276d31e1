//! Simulated serial lines with a UART's data rate and configurable damage.

use core::convert::Infallible;

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack::Duration;

/// Reproducible randomness: xorshift.
pub struct Random(u32);

impl Random {
    pub const fn new(seed: u32) -> Self {
        Self(seed | 1)
    }

    pub fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    pub fn below(&mut self, end: usize) -> usize {
        self.next() as usize % end
    }

    pub fn byte(&mut self) -> u8 {
        self.next().to_le_bytes()[2]
    }

    pub fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }
}

/// A ring buffer of bytes in transit.
pub struct Ring<const LEN: usize> {
    bytes: [u8; LEN],
    at: usize,
    len: usize,
}

impl<const LEN: usize> Ring<LEN> {
    const fn new() -> Self {
        Self { bytes: [0; LEN], at: 0, len: 0 }
    }

    pub fn room(&self) -> usize {
        LEN - self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub fn push(&mut self, byte: u8) {
        assert!(self.len < LEN, "the line's buffer is full");
        self.bytes[(self.at + self.len) % LEN] = byte;
        self.len += 1;
    }

    pub fn pop(&mut self) -> Option<u8> {
        self.len = self.len.checked_sub(1)?;
        let byte = self.bytes[self.at];
        self.at = (self.at + 1) % LEN;
        Some(byte)
    }
}

/// The kinds of damage on a line.
#[derive(Clone, Copy, Default)]
pub struct Damage {
    pub flips: bool,
    pub losses: bool,
    pub bursts: bool,
}

/// A line, as the vehicle sees it.
pub struct Line {
    /// Bytes to the vehicle.
    pub up: Ring<2048>,
    /// Bytes from the vehicle.
    pub down: Ring<1024>,
    /// Data rate in thousandths of a byte per millisecond.
    rate: u32,
    /// Thousandths of a byte that the vehicle may read now.
    may_read: u32,
    /// Thousandths of a byte that the vehicle may write now.
    may_write: u32,
    /// Stalled in both directions.
    pub is_stuck: bool,
    /// Stalled in the direction from the vehicle.
    pub is_full: bool,
    pub damage: Damage,
    /// Number of frames to the vehicle without damage.
    pub intact: u32,
}

impl Line {
    pub const fn new(baud: u32) -> Self {
        Self {
            up: Ring::new(),
            down: Ring::new(),
            rate: baud / 10,
            may_read: 0,
            may_write: 0,
            is_stuck: false,
            is_full: false,
            damage: Damage { flips: false, losses: false, bursts: false },
            intact: 0,
        }
    }

    /// Advances the time and refills the budget of bytes. At most one unused byte carries over.
    pub fn pass(&mut self, time: Duration) {
        let some = (time.as_micros() as u32) * self.rate / 1_000;
        self.may_read = some + self.may_read.min(1_000);
        self.may_write = some + self.may_write.min(1_000);
    }

    /// Sends a frame to the vehicle, damaged or not.
    pub fn send(&mut self, frame: &[u8], random: &mut Random) {
        let Damage { flips, losses, bursts } = self.damage;
        let mut is_intact = true;
        let (mut flipped, mut lost) = ([usize::MAX; 3], [usize::MAX; 2]);
        if flips && random.one_in(10) {
            flipped.fill_with(|| random.below(frame.len()));
            is_intact = false;
        }
        if losses && random.one_in(10) {
            lost.fill_with(|| random.below(frame.len()));
            is_intact = false;
        }
        // A burst before the first byte leaves the frame intact.
        let burst = if bursts && random.one_in(10) { random.below(frame.len()) } else { usize::MAX };
        is_intact &= burst == usize::MAX || burst == 0;
        self.intact += u32::from(is_intact);
        for (at, byte) in frame.iter().enumerate() {
            if at == burst {
                for _ in 0..random.below(80) {
                    // Every fourth byte is a start byte.
                    let byte = if random.one_in(4) { 0xFD } else { random.byte() };
                    self.up.push(byte);
                }
                // The burst must not end with the frame's previous byte, or the frame could still be found intact.
                self.up.push(frame.get(at.wrapping_sub(1)).map_or(0, |byte| !byte));
            }
            if !lost.contains(&at) {
                self.up.push(if flipped.contains(&at) { byte ^ (1 << random.below(8)) } else { *byte });
            }
        }
    }

    /// Takes the next byte from the vehicle, damaged or not.
    pub fn take(&mut self, random: &mut Random) -> Option<u8> {
        loop {
            let byte = self.down.pop()?;
            let Damage { flips, losses, bursts } = self.damage;
            // Hits about one in ten frames of thirty bytes.
            if losses && random.one_in(300) {
                continue;
            }
            if (flips || bursts) && random.one_in(300) {
                return Some(random.byte());
            }
            return Some(byte);
        }
    }
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.is_stuck && !self.up.is_empty() && self.may_read >= 1_000)
    }
}

impl Read for Line {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        assert!(self.read_ready() == Ok(true), "the stack would block on a read");
        let mut read = 0;
        while read < bytes.len()
            && self.may_read >= 1_000
            && let Some(byte) = self.up.pop()
        {
            bytes[read] = byte;
            read += 1;
            self.may_read -= 1_000;
        }
        Ok(read)
    }
}

impl WriteReady for Line {
    fn write_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.is_stuck && !self.is_full && self.may_write >= 1_000 && self.down.room() > 0)
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        assert!(self.write_ready() == Ok(true), "the stack would block on a write");
        let len = bytes.len().min(self.down.room()).min(self.may_write as usize / 1_000);
        for byte in &bytes[..len] {
            self.down.push(*byte);
        }
        self.may_write -= len as u32 * 1_000;
        Ok(len)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
