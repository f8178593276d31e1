//! FRAM and EEPROM on SPI.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use mavstack::storage::Store;
use mavstack_fram::{Eeprom, Error, Fram};

fn in_fram<S: SpiDevice>(spi: S) -> Result<Store<Fram<S>>, Error<S::Error>> {
    Ok(Store::new(Fram::new(spi)?, 0..0x8000)) // an FM25V02 or MB85RS256: 32 KiB
}

fn in_eeprom<S: SpiDevice, D: DelayNs>(spi: S, delay: D) -> Result<Store<Eeprom<S, D>>, Error<S::Error>> {
    Ok(Store::new(Eeprom::new::<0x1_0000, 128>(spi, delay)?, 0..0x1_0000)) // a 25LC512: 64 KiB
}
