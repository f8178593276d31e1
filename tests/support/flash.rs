//! Simulates NOR flash in RAM, with the faults of real flash: only erased bytes can be written, the power can be cut at any byte,
//! and operations fail on demand.

#![allow(dead_code, reason = "each test binary uses its own part")]

use std::ops::Range;
use std::vec::Vec;

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};

/// A simulated NOR flash. `WRITE` and `ERASE` are the sizes of its units, in bytes.
#[derive(Clone, Debug)]
pub struct RamFlash<const WRITE: usize, const ERASE: usize> {
    pub bytes: Vec<u8>,
    /// Steps left until the power cut: writing a byte costs 1, erasing a unit [`Self::ERASE_COST`].
    pub fuel: Option<u64>,
    /// The contents of a write unit after a power cut.
    pub torn: Torn,
    /// The injected fault.
    pub fault: Fault,
    pub reads: u32,
    pub erases: u32,
    /// The unit at this address cannot be erased.
    pub bad_erase: Option<u32>,
    /// Worn units, by index.
    pub worn: Vec<(usize, Worn)>,
    /// Places that cannot be read until they are erased.
    pub bad: Vec<Range<u32>>,
    /// The number of erases of each unit.
    pub erases_of: Vec<u32>,
    pub writes: u32,
    pub bytes_written: u64,
}

/// The contents of a write unit after a power cut during its write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Torn {
    /// The first bytes.
    Prefix,
    /// Garbage.
    Garbage,
    /// Unreadable: reads fail with an ECC error until the unit is erased.
    Unreadable,
}

/// What a worn unit no longer does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Worn {
    /// Erasing fails without an effect.
    Erase,
    /// Writing fails without an effect.
    Write,
    /// A written byte is wrong, without an error.
    Keep,
}

/// A fault to inject.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    /// Every erase fails without an effect.
    Erase,
    /// Every write after this many fails without an effect.
    Write(u32),
    /// Every write after this many fails and writes half of the bytes.
    HalfWrite(u32),
    /// Every write after this many writes all bytes but returns an error.
    LyingWrite(u32),
    /// Every write after this many writes a wrong bit and returns no error.
    WrongWrite(u32),
    /// Reads of this range fail.
    Read(Range<u32>),
    /// The read with this index returns a wrong bit.
    WrongRead(u32),
    /// The reads with these indices fail, as counted by [`RamFlash::reads`].
    Reads(Range<u32>),
}

/// An error of the simulated flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The call violates the rules of the trait.
    Call(NorFlashErrorKind),
    /// The bytes to write are not erased.
    NotErased,
    /// The power is off.
    Off,
    /// An injected fault.
    Fault,
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Call(kind) => *kind,
            _ => NorFlashErrorKind::Other,
        }
    }
}

impl<const WRITE: usize, const ERASE: usize> RamFlash<WRITE, ERASE> {
    /// The cost of erasing a unit. A power cut can leave it unchanged, half erased, as garbage, or erased with the cut directly after.
    pub const ERASE_COST: u64 = 3;

    /// Creates erased flash.
    pub fn new(len: u32) -> Self {
        Self::of(std::vec![0xFF; len as usize])
    }

    /// Creates flash with these contents.
    pub fn of(bytes: Vec<u8>) -> Self {
        let (fuel, torn, fault) = (None, Torn::Prefix, Fault::None);
        let erases_of = std::vec![0; bytes.len() / ERASE];
        Self {
            bytes,
            fuel,
            torn,
            fault,
            bad_erase: None,
            worn: Vec::new(),
            bad: Vec::new(),
            reads: 0,
            erases: 0,
            erases_of,
            writes: 0,
            bytes_written: 0,
        }
    }

    /// Whether the power was cut.
    pub fn is_off(&self) -> bool {
        self.fuel == Some(0)
    }

    /// Restores the power.
    pub fn power_on(&mut self) {
        self.fuel = None;
    }

    /// Returns the total cost so far. A run with less fuel is cut.
    pub fn cost(&self) -> u64 {
        self.bytes_written + Self::ERASE_COST * u64::from(self.erases)
    }

    /// Whether a unit among these bytes is worn in this way.
    fn is_worn(&self, bytes: Range<u32>, worn: Worn) -> bool {
        let units = bytes.start as usize / ERASE..(bytes.end as usize).div_ceil(ERASE);
        self.worn.iter().any(|(unit, how)| units.contains(unit) && *how == worn)
    }

    fn check_power(&self) -> Result<(), FlashError> {
        if self.is_off() { Err(FlashError::Off) } else { Ok(()) }
    }

    /// Uses fuel. Returns the part of `cost` that the fuel covered.
    fn burn(&mut self, cost: u64) -> u64 {
        let Some(fuel) = &mut self.fuel else { return cost };
        let burnt = cost.min(*fuel);
        *fuel -= burnt;
        burnt
    }

    fn tear(&mut self, unit: Range<usize>, written: usize, bytes: &[u8]) {
        match self.torn {
            Torn::Prefix => self.bytes[unit.start..unit.start + written].copy_from_slice(&bytes[..written]),
            Torn::Garbage => {
                for (index, byte) in self.bytes[unit].iter_mut().enumerate() {
                    *byte = (index as u8).wrapping_mul(0x9D) ^ (written as u8) ^ 0x5A;
                }
            }
            Torn::Unreadable => {
                self.bytes[unit.clone()].fill(0);
                self.bad.push(unit.start as u32..unit.end as u32);
            }
        }
    }
}

impl<const WRITE: usize, const ERASE: usize> ErrorType for RamFlash<WRITE, ERASE> {
    type Error = FlashError;
}

impl<const WRITE: usize, const ERASE: usize> ReadNorFlash for RamFlash<WRITE, ERASE> {
    const READ_SIZE: usize = if WRITE < 4 { WRITE } else { 4 };

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.check_power()?;
        check_read(self, offset, bytes.len()).map_err(FlashError::Call)?;
        let end = offset + bytes.len() as u32;
        let count = self.reads;
        self.reads += 1;
        if matches!(&self.fault, Fault::Reads(bad) if bad.contains(&count)) {
            return Err(FlashError::Fault);
        }
        if matches!(&self.fault, Fault::Read(bad) if bad.start < end && offset < bad.end) {
            return Err(FlashError::Fault);
        }
        if self.bad.iter().any(|bad| bad.start < end && offset < bad.end) {
            return Err(FlashError::Fault);
        }
        bytes.copy_from_slice(&self.bytes[offset as usize..end as usize]);
        if self.fault == Fault::WrongRead(count) {
            bytes[bytes.len() / 2] ^= 4;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl<const WRITE: usize, const ERASE: usize> NorFlash for RamFlash<WRITE, ERASE> {
    const WRITE_SIZE: usize = WRITE;
    const ERASE_SIZE: usize = ERASE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.check_power()?;
        check_erase(self, from, to).map_err(FlashError::Call)?;
        if self.fault == Fault::Erase || self.bad_erase.is_some_and(|bad| (from..to).contains(&bad)) {
            return Err(FlashError::Fault);
        }
        if self.is_worn(from..to, Worn::Erase) {
            return Err(FlashError::Fault);
        }
        for start in (from as usize..to as usize).step_by(ERASE) {
            let burnt = self.burn(Self::ERASE_COST);
            self.erases += 1;
            self.erases_of[start / ERASE] += 1;
            let unit = &mut self.bytes[start..start + ERASE];
            match burnt {
                0 => {}
                1 => unit[..ERASE / 2].fill(0xFF),
                2 => unit.iter_mut().enumerate().for_each(|(at, byte)| *byte |= (at as u8).wrapping_mul(0x6B)),
                _ => unit.fill(0xFF),
            }
            if burnt < Self::ERASE_COST {
                return Err(FlashError::Off);
            }
        }
        self.bad.retain(|bad| bad.end <= from || to <= bad.start);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.check_power()?;
        check_write(self, offset, bytes.len()).map_err(FlashError::Call)?;
        let range = offset as usize..offset as usize + bytes.len();
        if self.bytes[range.clone()].iter().any(|byte| *byte != 0xFF) {
            return Err(FlashError::NotErased);
        }
        let count = self.writes;
        self.writes += 1;
        let place = offset..offset + bytes.len() as u32;
        match self.fault {
            _ if self.is_worn(place.clone(), Worn::Write) => return Err(FlashError::Fault),
            Fault::Write(after) if count >= after => return Err(FlashError::Fault),
            Fault::HalfWrite(after) if count >= after => {
                let half = bytes.len() / 2;
                self.bytes[range.start..range.start + half].copy_from_slice(&bytes[..half]);
                return Err(FlashError::Fault);
            }
            _ => {}
        }
        let power = self.burn(bytes.len() as u64) as usize;
        self.bytes_written += power as u64;
        let whole = power - power % WRITE;
        self.bytes[range.start..range.start + whole].copy_from_slice(&bytes[..whole]);
        if whole < power {
            let unit = range.start + whole..range.start + whole + WRITE;
            self.tear(unit, power - whole, &bytes[whole..]);
        }
        if power < bytes.len() {
            return Err(FlashError::Off);
        }
        match self.fault {
            Fault::LyingWrite(after) if count >= after => return Err(FlashError::Fault),
            Fault::WrongWrite(after) if count >= after => self.bytes[range.start + bytes.len() / 2] ^= 0x10,
            _ if self.is_worn(place, Worn::Keep) => self.bytes[range.start + bytes.len() / 2] ^= 0x10,
            _ => {}
        }
        Ok(())
    }
}
