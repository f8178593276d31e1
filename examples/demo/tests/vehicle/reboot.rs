//! A reboot on command: no accepted change is lost.

use crate::support::wire::Wire;
use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use mavstack::Instant;
use mavstack::dialect::*;
use mavstack::storage::Store;
use mavstack_demo::{Mavlink, TELEMETRY, Tuning};

struct RamFlash(Vec<u8>);

impl ErrorType for RamFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for RamFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for RamFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        self.0[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        self.0[offset as usize..].iter_mut().zip(bytes).for_each(|(cell, byte)| *cell &= byte);
        Ok(())
    }
}

/// C-30, P-17: parameters set just before a reboot are written before it, without the usual delay.
#[test]
fn parameters_set_before_a_reboot_survive_it() {
    let len = Store::<RamFlash>::region_len::<Mavlink>();
    let mut store = Store::new(RamFlash(vec![0xFF; len as usize]), 0..len);
    for speed in [5.0, 6.0, 7.0] {
        let mut wire = Wire::new();
        wire.app.restore(Instant::ZERO, &mut store).unwrap();
        wire.run(100);
        let set = ParamSet {
            target_system: 1,
            target_component: 1,
            param_id: mavstack::Text::new("MPC_XY_CRUISE"),
            param_type: MavParamType::REAL32,
            param_value: speed,
        };
        wire.send(TELEMETRY, &set);
        assert_eq!(wire.long(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]), MavResult::ACCEPTED);
        let requested = wire.millis;
        while !wire.app.wants_reboot() {
            assert!(wire.millis < requested + 500, "no reboot");
            wire.run(1);
            wire.app.persist(Instant::from_millis(wire.millis), &mut store);
        }
        store = Store::new(store.into_inner(), 0..len);
        let mut wire = Wire::new();
        wire.app.restore(Instant::ZERO, &mut store).unwrap();
        assert_eq!(wire.app.stack().parameters().get(Tuning::MPC_XY_CRUISE), speed);
        store = Store::new(store.into_inner(), 0..len);
    }
}
