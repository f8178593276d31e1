//! A W25Q on SPI, whose erases the processor does not wait for.

use embedded_hal::spi::{Operation, SpiDevice};
use mavstack::storage::{Job, JobSlot, Region};
use mavstack::{Duration, Instant};

/// Longer than any erase.
const PATIENCE: Duration = Duration::from_millis(500);
/// The first 64 KiB, in units of 4 KiB.
const REGION: Region = Region::new(0..0x1_0000, 1, 4_096);

struct W25q<S> {
    spi: S,
    slot: JobSlot,
    /// The chip erases or programs. At startup it may still run an operation from before a reset.
    is_busy: bool,
    /// When it must have finished.
    deadline: Instant,
}

impl<S: SpiDevice> W25q<S> {
    fn new(spi: S) -> Self {
        Self { spi, slot: JobSlot::new(), is_busy: true, deadline: Instant::ZERO + PATIENCE }
    }

    /// Checks whether the chip has finished, and begins the next job. Returns true while a job runs.
    fn poll(&mut self, now: Instant) -> bool {
        let Self { spi, slot, is_busy, deadline } = self;
        if *is_busy {
            let mut status = [0xFF];
            let asked = spi.transaction(&mut [Operation::Write(&[0x05]), Operation::Read(&mut status)]);
            if asked.is_err() || status[0] & 1 != 0 {
                // After the deadline, a job without a result counts as failed.
                return now < *deadline;
            }
            *is_busy = false;
            slot.finish(true);
        }
        let Some((job, page)) = slot.take() else { return false };
        *deadline = now + PATIENCE;
        let at = |code, offset: u32| {
            let [_, high, middle, low] = offset.to_be_bytes();
            [code, high, middle, low]
        };
        let result = match job {
            Job::Read { offset, range } => {
                let bytes = &mut page.bytes_mut()[range];
                spi.transaction(&mut [Operation::Write(&at(0x03, offset)), Operation::Read(bytes)])
            }
            Job::Write { offset, range } => spi.write(&[0x06]).and_then(|()| {
                *is_busy = true;
                let bytes = &page.bytes()[range];
                spi.transaction(&mut [Operation::Write(&at(0x02, offset)), Operation::Write(bytes)])
            }),
            Job::Erase { offset, .. } => spi.write(&[0x06]).and_then(|()| {
                *is_busy = true;
                spi.write(&at(0x20, offset))
            }),
        };
        if result.is_err() || !*is_busy {
            slot.finish(result.is_ok());
        }
        *is_busy
    }
}

/// In each pass of the loop, after the links. At startup, `stack.attach_storage(now, REGION, &mut rover)`.
fn pass<S: SpiDevice>(now: Instant, stack: &mut StackOf<Mavlink>, chip: &mut W25q<S>, rover: &mut Rover) {
    if !chip.poll(now) {
        stack.exchange_job(now, &mut chip.slot, rover);
    }
}

use super::{Mavlink, Rover};
use mavstack::StackOf;

#[cfg(test)]
mod tests {
    use super::super::Tuning;
    use super::*;
    use mavstack::prelude::*;
    use std::boxed::Box;
    use std::vec;
    use std::vec::Vec;

    static PULSE: Pulse = Pulse::new();

    /// A chip that is busy for three questions after each erase and write, and hears nothing else meanwhile.
    struct Chip {
        memory: Vec<u8>,
        busy: u32,
        enabled: bool,
    }

    impl Chip {
        fn new(busy: u32) -> W25q<Self> {
            W25q::new(Self { memory: vec![0xFF; 0x1_0000], busy, enabled: false })
        }
    }

    impl embedded_hal::spi::ErrorType for Chip {
        type Error = core::convert::Infallible;
    }

    impl SpiDevice for Chip {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
            let offset = |command: &[u8]| u32::from_be_bytes([0, command[1], command[2], command[3]]) as usize;
            match operations {
                [Operation::Write([0x05]), Operation::Read(status)] => {
                    status[0] = u8::from(self.busy > 0);
                    self.busy = self.busy.saturating_sub(1);
                }
                other if self.busy > 0 => panic!("it is busy: {other:?}"),
                [Operation::Write([0x06])] => self.enabled = true,
                [Operation::Write(command), Operation::Read(bytes)] if command[0] == 0x03 => {
                    bytes.copy_from_slice(&self.memory[offset(command)..][..bytes.len()]);
                }
                [Operation::Write(command), Operation::Write(bytes)] if command[0] == 0x02 => {
                    assert!(core::mem::take(&mut self.enabled));
                    assert!(offset(command) % 256 + bytes.len() <= 256, "it would wrap around");
                    for (cell, byte) in self.memory[offset(command)..].iter_mut().zip(bytes.iter()) {
                        *cell &= byte;
                    }
                    self.busy = 3;
                }
                [Operation::Write(command)] if command[0] == 0x20 => {
                    assert!(core::mem::take(&mut self.enabled));
                    self.memory[offset(command)..][..4096].fill(0xFF);
                    self.busy = 3;
                }
                other => panic!("{other:?}"),
            }
            Ok(())
        }
    }

    fn stack() -> Box<StackOf<Mavlink>> {
        let config = Config::new(Address::new(1, 1), &PULSE);
        let mut stack = Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::uart(57_600)]));
        stack.attach_storage(Instant::ZERO, REGION, &mut Rover { may_arm: true });
        stack
    }

    fn run(stack: &mut StackOf<Mavlink>, chip: &mut W25q<Chip>, times: core::ops::Range<u64>) {
        for now in times {
            pass(Instant::from_millis(now), stack, chip, &mut Rover { may_arm: true });
        }
    }

    #[test]
    fn a_parameter_is_stored_while_the_chip_works_by_itself() {
        let (mut chip, mut first) = (Chip::new(5), stack());
        run(&mut first, &mut chip, 0..4_000);
        first.parameters_mut().set(Tuning::CRUISE, 7.0);
        first.save_parameters(Instant::from_millis(20_000));
        run(&mut first, &mut chip, 20_000..40_000);

        let (mut chip, mut second) = (W25q::new(chip.spi), stack());
        run(&mut second, &mut chip, 0..4_000);
        assert!(!second.is_restoring());
        assert_eq!(second.parameters().get(Tuning::CRUISE), 7.0);
    }

    #[test]
    fn a_dead_chip_is_reported() {
        let (mut chip, mut stack) = (Chip::new(u32::MAX), stack());
        run(&mut stack, &mut chip, 0..2_000);
        assert!(!stack.is_restoring() && stack.restore_errors().parameters.is_some());
    }
}
