//! Storage: `docs/storage.md`, and the recipes in `docs/storage/`.

mod fram;
mod partition;
mod rp2040;
mod stm32h7;
mod stm32l4;
mod w25q;

use core::ops::Range;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use mavstack::prelude::*;
use mavstack::storage::Store;

#[derive(Stack)]
#[stack(vehicle: Rover, links: 1, parameters: Tuning, storage)]
struct Mavlink;

const REGION: Range<u32> = 0xC_0000..0x10_0000;
const _: () = assert!(Store::<Flash>::region_len::<Mavlink>() <= REGION.end - REGION.start);

fn start(now: Instant, stack: &mut StackOf<Mavlink>, rover: &mut Rover) -> Store<Flash> {
    let mut store = Store::new(Flash, REGION);
    let _ = stack.restore(now, &mut store, rover); // `pass` looks at the errors
    store
}

fn pass(now: Instant, stack: &mut StackOf<Mavlink>, store: &mut Store<Flash>, rover: &mut Rover) {
    // A geofence that cannot be read is not an empty geofence. It may be restored later.
    rover.may_arm = stack.restore_errors().is_empty();
    // … fly, poll the stack and its links
    stack.persist(now, store, rover);
}

mavstack::parameters! { pub struct Tuning { CRUISE: f32 = 5.0, 0.5..=15.0, "m/s"; } }

struct Rover {
    may_arm: bool,
}

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Parameters for Rover {
    type Table = Tuning;
}

/// An erased flash that forgets what is written.
struct Flash;

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, _: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.fill(0xFF);
        Ok(())
    }

    fn capacity(&self) -> usize {
        0x20_0000
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 1;
    const ERASE_SIZE: usize = 0x1000;

    fn erase(&mut self, _: u32, _: u32) -> Result<(), NorFlashErrorKind> {
        Ok(())
    }

    fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;

    #[test]
    fn an_empty_region_lets_the_rover_arm() {
        static PULSE: Pulse = Pulse::new();
        let config = Config::new(Address::new(1, 1), &PULSE);
        let mut stack = Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::uart(57_600)]));
        let mut rover = Rover { may_arm: false };
        let mut store = start(Instant::ZERO, &mut stack, &mut rover);
        pass(Instant::ZERO, &mut stack, &mut store, &mut rover);
        assert!(rover.may_arm);
    }
}
