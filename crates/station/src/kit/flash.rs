//! NOR flash in RAM, with the faults of real flash.

use std::cell::RefCell;
use std::fmt;
use std::ops::Range;
use std::rc::Rc;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use mavstack::Duration;

/// The steps that erasing a unit takes, of those that [`FlashChip::cut_power_after`] counts. A power cut leaves the unit unchanged, half
/// erased, as garbage, or erased.
pub const ERASE_STEPS: u64 = 3;

/// The contents of a write unit after a power cut during its write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Torn {
    /// The first bytes are written, and the rest is erased.
    #[default]
    Prefix,
    /// Garbage.
    Garbage,
    /// Unreadable: reads fail, as with an ECC error, until the unit is erased.
    Unreadable,
}

/// What an erase unit no longer does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Worn {
    /// Erasing fails without an effect.
    Erase,
    /// Writing fails without an effect.
    Write,
    /// A written byte is wrong, without an error.
    Keep,
}

/// An error of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The call violates the rules of the trait: it is out of bounds or not aligned.
    Call(NorFlashErrorKind),
    /// The bytes to write are not erased.
    NotErased,
    /// The power is off.
    Off,
    /// The unit is worn.
    Worn,
    /// The bytes cannot be read: a power cut has torn them.
    Torn,
}

impl fmt::Display for FlashError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Call(kind) => write!(f, "an invalid call: {kind:?}"),
            Self::NotErased => f.write_str("the bytes to write are not erased"),
            Self::Off => f.write_str("the power is off"),
            Self::Worn => f.write_str("the unit is worn"),
            Self::Torn => f.write_str("a power cut has torn the bytes"),
        }
    }
}

impl std::error::Error for FlashError {}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Call(kind) => *kind,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// How long the flash keeps the processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FlashTimes {
    /// For an erase unit.
    pub erase: Duration,
    /// For 256 bytes. Shorter writes take their share.
    pub page: Duration,
}

impl FlashTimes {
    /// No time.
    pub const ZERO: Self = Self { erase: Duration::ZERO, page: Duration::ZERO };
    /// The typical times of a W25Q128 with sectors of 4 KiB: 45 ms and 400 µs.
    pub const SERIAL: Self = Self { erase: Duration::from_millis(45), page: Duration::from_micros(400) };
}

/// A flash chip: its contents and its faults. Clones are handles of the same chip. [`driver`](Self::driver) reads and writes it.
///
/// A rig has the chips that the firmware takes from its [`Board`](super::Board). They keep their contents through resets and power cuts,
/// and the firmware stands still while they are busy.
#[derive(Clone, Debug)]
pub struct FlashChip(Rc<RefCell<Chip>>);

#[derive(Debug)]
struct Chip {
    bytes: Vec<u8>,
    times: FlashTimes,
    /// The time of the operations since [`FlashChip::take_busy`].
    busy: Duration,
    /// Steps left until the power cut.
    fuel: Option<u64>,
    torn: Torn,
    /// Worn erase units, by any byte in them.
    worn: Vec<(u32, Worn)>,
    /// Places that cannot be read until they are erased.
    unreadable: Vec<Range<u32>>,
    /// The erases of each erase unit. The size of the units is known at the first erase.
    erases: Vec<u32>,
    steps: u64,
}

impl FlashChip {
    /// Creates an erased chip of this many bytes, with the times [`FlashTimes::SERIAL`].
    pub fn new(len: u32) -> Self {
        Self::of(vec![0xFF; len as usize])
    }

    /// Creates a chip with these contents.
    pub fn of(bytes: Vec<u8>) -> Self {
        Self(Rc::new(RefCell::new(Chip {
            bytes,
            times: FlashTimes::SERIAL,
            busy: Duration::ZERO,
            fuel: None,
            torn: Torn::default(),
            worn: Vec::new(),
            unreadable: Vec::new(),
            erases: Vec::new(),
            steps: 0,
        })))
    }

    /// Returns a driver with these units, in bytes.
    pub fn driver<const WRITE: usize, const ERASE: usize>(&self) -> RamFlash<WRITE, ERASE> {
        RamFlash(self.clone())
    }

    /// Returns a copy of the contents.
    pub fn bytes(&self) -> Vec<u8> {
        self.0.borrow().bytes.clone()
    }

    /// Changes the contents, as a bootloader or a fault would.
    pub fn change(&self, change: impl FnOnce(&mut [u8])) {
        change(&mut self.0.borrow_mut().bytes);
    }

    /// Sets how long operations take.
    pub fn set_times(&self, times: FlashTimes) {
        self.0.borrow_mut().times = times;
    }

    /// Cuts the power after this many steps from now: a byte written is one, a unit erased [`ERASE_STEPS`]. All operations then fail until
    /// [`power_on`](Self::power_on). What is written in that moment is torn.
    pub fn cut_power_after(&self, steps: u64) {
        self.0.borrow_mut().fuel = Some(steps);
    }

    /// Sets what a power cut leaves of a write unit.
    pub fn set_torn(&self, torn: Torn) {
        self.0.borrow_mut().torn = torn;
    }

    /// Whether the power was cut.
    pub fn is_off(&self) -> bool {
        self.0.borrow().fuel == Some(0)
    }

    /// Restores the power. A cut that was ordered and did not happen is forgotten.
    pub fn power_on(&self) {
        self.0.borrow_mut().fuel = None;
    }

    /// Wears out the erase unit of this address.
    pub fn wear_out(&self, address: u32, worn: Worn) {
        self.0.borrow_mut().worn.push((address, worn));
    }

    /// Returns the steps done so far, as [`cut_power_after`](Self::cut_power_after) counts them. A test that cuts the power at each of them
    /// has tried every place.
    pub fn steps(&self) -> u64 {
        self.0.borrow().steps
    }

    /// Returns the number of erases of each erase unit; empty before the first erase.
    pub fn erases(&self) -> Vec<u32> {
        self.0.borrow().erases.clone()
    }

    /// Takes the time of the operations since the last call.
    pub fn take_busy(&self) -> Duration {
        std::mem::take(&mut self.0.borrow_mut().busy)
    }
}

impl Chip {
    fn check_power(&self) -> Result<(), FlashError> {
        if self.fuel == Some(0) { Err(FlashError::Off) } else { Ok(()) }
    }

    /// Does steps. Returns how many the power lasted for.
    fn step(&mut self, steps: u64) -> u64 {
        let done = self.fuel.map_or(steps, |fuel| steps.min(fuel));
        self.fuel = self.fuel.map(|fuel| fuel - done);
        self.steps += done;
        done
    }

    /// Whether an erase unit among these bytes is worn in this way.
    fn is_worn(&self, bytes: &Range<u32>, unit: usize, worn: Worn) -> bool {
        let unit_of = |address: u32| address as usize / unit;
        let units = unit_of(bytes.start)..=unit_of(bytes.end.saturating_sub(1));
        self.worn.iter().any(|(address, how)| *how == worn && units.contains(&unit_of(*address)))
    }

    /// Erases one unit, from `start` on.
    fn erase(&mut self, start: usize, unit: usize) -> Result<(), FlashError> {
        self.erases.resize(self.bytes.len() / unit, 0);
        self.erases[start / unit] += 1;
        self.busy += self.times.erase;
        let done = self.step(ERASE_STEPS);
        let bytes = &mut self.bytes[start..start + unit];
        match done {
            0 => {}
            1 => bytes[..unit / 2].fill(0xFF),
            2 => bytes.iter_mut().enumerate().for_each(|(at, byte)| *byte |= (at as u8).wrapping_mul(0x6B)),
            _ => bytes.fill(0xFF),
        }
        if done < ERASE_STEPS { Err(FlashError::Off) } else { Ok(()) }
    }

    /// Writes erased bytes as far as the power lasts, and tears the write unit at its end.
    fn write(&mut self, start: usize, unit: usize, bytes: &[u8]) -> Result<(), FlashError> {
        let share = self.times.page.as_micros() * bytes.len() as u64 / 256;
        self.busy += Duration::from_micros(share);
        let done = self.step(bytes.len() as u64) as usize;
        let whole = done - done % unit;
        self.bytes[start..start + whole].copy_from_slice(&bytes[..whole]);
        if whole < done {
            let torn = start + whole..start + whole + unit;
            match self.torn {
                Torn::Prefix => self.bytes[start + whole..start + done].copy_from_slice(&bytes[whole..done]),
                Torn::Garbage => {
                    for (index, byte) in self.bytes[torn].iter_mut().enumerate() {
                        *byte = (index as u8).wrapping_mul(0x9D) ^ (done as u8) ^ 0x5A;
                    }
                }
                Torn::Unreadable => {
                    self.bytes[torn.clone()].fill(0);
                    self.unreadable.push(torn.start as u32..torn.end as u32);
                }
            }
        }
        if done < bytes.len() { Err(FlashError::Off) } else { Ok(()) }
    }
}

/// The driver of a [`FlashChip`]. `WRITE` and `ERASE` are the sizes of its units, in bytes.
///
/// ```
/// use embedded_storage::nor_flash::NorFlash;
/// use mavstack_station::kit::{FlashChip, FlashError};
///
/// let chip = FlashChip::new(8_192);
/// let mut flash = chip.driver::<4, 4_096>();
/// chip.cut_power_after(2);
/// assert_eq!(flash.write(0, b"abcd"), Err(FlashError::Off));
/// chip.power_on();
/// assert_eq!(&chip.bytes()[..4], b"ab\xFF\xFF");
/// ```
#[derive(Clone, Debug)]
pub struct RamFlash<const WRITE: usize, const ERASE: usize>(FlashChip);

impl<const WRITE: usize, const ERASE: usize> RamFlash<WRITE, ERASE> {
    /// Returns the chip.
    pub fn chip(&self) -> &FlashChip {
        &self.0
    }
}

impl<const WRITE: usize, const ERASE: usize> ErrorType for RamFlash<WRITE, ERASE> {
    type Error = FlashError;
}

impl<const WRITE: usize, const ERASE: usize> ReadNorFlash for RamFlash<WRITE, ERASE> {
    const READ_SIZE: usize = if WRITE < 4 { WRITE } else { 4 };

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        check_read(self, offset, bytes.len()).map_err(FlashError::Call)?;
        let chip = self.0.0.borrow();
        chip.check_power()?;
        let end = offset + bytes.len() as u32;
        if chip.unreadable.iter().any(|bad| bad.start < end && offset < bad.end) {
            return Err(FlashError::Torn);
        }
        bytes.copy_from_slice(&chip.bytes[offset as usize..end as usize]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.0.borrow().bytes.len()
    }
}

impl<const WRITE: usize, const ERASE: usize> NorFlash for RamFlash<WRITE, ERASE> {
    const WRITE_SIZE: usize = WRITE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check_erase(self, from, to).map_err(FlashError::Call)?;
        let mut chip = self.0.0.borrow_mut();
        chip.check_power()?;
        if chip.is_worn(&(from..to), ERASE, Worn::Erase) {
            return Err(FlashError::Worn);
        }
        for start in (from as usize..to as usize).step_by(ERASE) {
            chip.erase(start, ERASE)?;
        }
        chip.unreadable.retain(|bad| bad.end <= from || to <= bad.start);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check_write(self, offset, bytes.len()).map_err(FlashError::Call)?;
        let mut chip = self.0.0.borrow_mut();
        chip.check_power()?;
        let range = offset as usize..offset as usize + bytes.len();
        if chip.bytes[range.clone()].iter().any(|byte| *byte != 0xFF) {
            return Err(FlashError::NotErased);
        }
        let place = offset..offset + bytes.len() as u32;
        if chip.is_worn(&place, ERASE, Worn::Write) {
            return Err(FlashError::Worn);
        }
        chip.write(range.start, WRITE, bytes)?;
        if chip.is_worn(&place, ERASE, Worn::Keep) && !bytes.is_empty() {
            chip.bytes[range.start + bytes.len() / 2] ^= 0x10;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Flash = RamFlash<8, 256>;

    fn chip() -> (FlashChip, Flash) {
        let chip = FlashChip::new(1_024);
        let flash = chip.driver();
        (chip, flash)
    }

    #[test]
    fn only_erased_bytes_can_be_written() {
        let (_, mut flash) = chip();
        assert_eq!(flash.write(8, &[1; 8]), Ok(()));
        assert_eq!(flash.write(8, &[1; 8]), Err(FlashError::NotErased));
        assert_eq!(flash.write(12, &[1; 8]), Err(FlashError::Call(NorFlashErrorKind::NotAligned)));
        assert_eq!(flash.erase(0, 256), Ok(()));
        assert_eq!(flash.write(8, &[2; 8]), Ok(()));
    }

    #[test]
    fn a_power_cut_tears_a_write() {
        for (torn, expected) in [(Torn::Prefix, Ok([7, 7, 7, 0xFF])), (Torn::Unreadable, Err(FlashError::Torn))] {
            let (chip, mut flash) = chip();
            chip.set_torn(torn);
            chip.cut_power_after(11);
            assert_eq!(flash.write(0, &[7; 16]), Err(FlashError::Off));
            assert!(chip.is_off());
            assert_eq!(flash.read(0, &mut [0; 4]), Err(FlashError::Off));
            chip.power_on();
            let mut bytes = [0; 4];
            assert_eq!(flash.read(8, &mut bytes).map(|()| bytes), expected);
            assert_eq!((flash.erase(0, 256), flash.read(8, &mut bytes)), (Ok(()), Ok(())));
            assert_eq!(bytes, [0xFF; 4]);
        }
    }

    #[test]
    fn a_power_cut_tears_an_erase() {
        for (steps, left) in [(0, 256), (1, 128), (3, 0)] {
            let (chip, mut flash) = chip();
            assert_eq!(flash.write(0, &[0; 256]), Ok(()));
            chip.cut_power_after(steps);
            let _ = flash.erase(0, 256);
            assert_eq!(chip.bytes().iter().filter(|byte| **byte == 0).count(), left, "{steps}");
        }
    }

    #[test]
    fn wear_and_time_are_counted() {
        let (chip, mut flash) = chip();
        chip.set_times(FlashTimes { erase: Duration::from_millis(45), page: Duration::from_millis(1) });
        flash.erase(256, 768).unwrap();
        flash.erase(512, 768).unwrap();
        flash.write(256, &[0; 128]).unwrap();
        assert_eq!(chip.erases(), [0, 1, 2, 0]);
        assert_eq!((chip.take_busy(), chip.take_busy()), (Duration::from_micros(135_500), Duration::ZERO));
        assert_eq!(chip.steps(), 3 * ERASE_STEPS + 128);
        chip.wear_out(300, Worn::Write);
        assert_eq!((flash.write(400, &[0; 8]), flash.write(512, &[0; 8])), (Err(FlashError::Worn), Ok(())));
    }
}
