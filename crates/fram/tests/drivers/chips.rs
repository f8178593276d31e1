//! FRAM of other makers, and FRAM without an id: what they answer, and that nothing else is taken for one.

use crate::bus::*;
use embedded_hal_mock::eh1::spi::Mock;
use embedded_storage::nor_flash::{NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use mavstack_fram::{Error, Fram};

/// An id of nine bytes; behind a shorter one the line reads as `fill`.
fn id(bytes: &[u8], fill: u8) -> [u8; 9] {
    let mut id = [fill; 9];
    id[..bytes.len()].copy_from_slice(bytes);
    id
}

/// Ids from the datasheets.
#[test]
fn chips_of_all_makers_are_recognised() {
    const C: [u8; 7] = [0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2];
    let cypress = |product, revision| id(&[&C[..], &[product, revision]].concat(), 0);
    let reversed = |product, revision| {
        let mut id = cypress(product, revision);
        id.reverse();
        id
    };
    for (name, id, kib) in [
        ("MB85RS16", id(&[0x04, 0x7F, 0x01, 0x01], 0), 2),
        ("MB85RS64V", id(&[0x04, 0x7F, 0x03, 0x02], 0xFF), 8),
        ("MB85RS64T", id(&[0x04, 0x7F, 0x23, 0x03], 0), 8),
        ("MB85RS128TY", id(&[0x04, 0x7F, 0x24, 0x03], 0), 16),
        ("MB85RS256B", id(&[0x04, 0x7F, 0x05, 0x09], 0), 32),
        ("MB85RS256TY", id(&[0x04, 0x7F, 0x25, 0x03], 0xFF), 32),
        ("MB85RS1MT", id(&[0x04, 0x7F, 0x27, 0x03], 0), 128),
        ("MB85RS2MTA", id(&[0x04, 0x7F, 0x48, 0x03], 0), 256),
        ("MB85RS4MT", id(&[0x04, 0x7F, 0x49, 0x03], 0), 512),
        ("MB85RS4MTY", id(&[0x04, 0x7F, 0x49, 0x0B], 0), 512),
        ("CY15B104Q", cypress(0x26, 0x08), 512),
        ("CY15B104QN", cypress(0x2C, 0x00), 512),
        ("CY15B104QN automotive", cypress(0x2C, 0x40), 512),
        ("CY15B102QN", reversed(0x2A, 0x60), 256),
        ("CY15B108QN", reversed(0x2E, 0x03), 1024),
        ("CY15B116QN", cypress(0x30, 0x00), 2048),
        ("MR45V064B", id(&[0xAE, 0x83, 0x05], 0), 8),
        ("MR45V100A", id(&[0xAE, 0x83, 0x09], 0xFF), 128),
    ] {
        let mut mock = Mock::new(&[question(&[0x9F], &id), question(&[0x05], &[0x40])].concat());
        assert_eq!(Fram::new(&mut mock).unwrap().capacity(), kib * 1024, "{name}");
        mock.done();
    }
}

/// Flash and EEPROM have ids too, and a write of FRAM to them would be lost.
#[test]
fn what_is_no_fram_is_refused() {
    for (name, id) in [
        ("W25Q128", id(&[0xEF, 0x40, 0x18], 0)),
        ("W25Q128", id(&[0xEF, 0x40, 0x18], 0xFF)),
        ("25Q of Fujitsu's id without continuation", id(&[0x04, 0x00, 0x27, 0x03], 0)),
        ("Fujitsu's id without density", id(&[0x04, 0x7F, 0x20, 0x03], 0)),
        ("Fujitsu's id with an unknown density", id(&[0x04, 0x7F, 0x0C, 0x03], 0)),
        ("Lapis, another product", id(&[0xAE, 0x82, 0x09], 0)),
        ("Lapis, an unknown density", id(&[0xAE, 0x83, 0x0D], 0)),
        ("Cypress, another family", id(&[0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2, 0x4C, 0], 0)),
        ("Cypress, an unknown density", id(&[0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0x7F, 0xC2, 0x32, 0], 0)),
        ("reversed, with a gap", id(&[0x03, 0x2E, 0xC2, 0x7F, 0x7F, 0x00, 0x7F, 0x7F, 0x7F], 0)),
    ] {
        let mut mock = Mock::new(&question(&[0x9F], &id));
        assert_eq!(Fram::new(&mut mock).err(), Some(Error::Id(id)), "{name}");
        mock.done();
    }
}

/// What `with_capacity` asks, with this answer of the status register.
fn probe(status: u8) -> Bus {
    [command(&[0x06]), question(&[0x05], &[status])].concat()
}

/// A chip without an id: the latch for writing says whether it is there.
#[test]
fn a_chip_without_id_is_probed() {
    for status in [0x02, 0x42, 0x82] {
        let mut mock = Mock::new(&[probe(status), command(&[0x04])].concat());
        assert_eq!(Fram::with_capacity(&mut mock, 0x2000).unwrap().capacity(), 0x2000);
        mock.done();
    }
    for (status, error) in [
        (0x00, Error::NoAnswer(0x00)),
        (0xFF, Error::NoAnswer(0xFF)),
        (0x40, Error::NoAnswer(0x40)),
        (0x06, Error::Protected),
        (0x8E, Error::Protected),
    ] {
        let mut mock = Mock::new(&probe(status));
        assert_eq!(Fram::with_capacity(&mut mock, 0x2000).err(), Some(error), "{status:02X}");
        mock.done();
    }
    let mut mock =
        Mock::new(&[question(&[0x9F], &id(&[0x04, 0x7F, 0x27, 0x03], 0)), question(&[0x05], &[0xFF])].concat());
    assert_eq!(Fram::new(&mut mock).err(), Some(Error::NoAnswer(0xFF)));
    mock.done();
    assert_eq!(Error::<()>::NoAnswer(0).kind(), NorFlashErrorKind::Other);
    assert_eq!(
        Error::<()>::NoAnswer(0xFF).to_string(),
        "no chip answers, its status reads as 0xFF: check the wiring and the chip select"
    );
}

/// One byte of address and a bit of the operation code up to 512 bytes, two bytes up to 64 KiB, three beyond.
#[test]
fn the_capacity_decides_the_address() {
    for (capacity, offset, read, write) in [
        (0x200, 0x0FE, &[0x03, 0xFE][..], &[0x02, 0xFE][..]),
        (0x200, 0x1FE, &[0x0B, 0xFE], &[0x0A, 0xFE]),
        (0x800, 0x7FE, &[0x03, 0x07, 0xFE], &[0x02, 0x07, 0xFE]),
        (0x1_0000, 0xFFFE, &[0x03, 0xFF, 0xFE], &[0x02, 0xFF, 0xFE]),
        (0x2_0000, 0x1_FFFE, &[0x03, 0x01, 0xFF, 0xFE], &[0x02, 0x01, 0xFF, 0xFE]),
        (0x20_0000, 0x12_3456, &[0x03, 0x12, 0x34, 0x56], &[0x02, 0x12, 0x34, 0x56]),
    ] {
        let bus = [probe(0x02), command(&[0x04]), question(read, &[7, 8]), command(&[0x06]), written(write, &[1, 2])]
            .concat();
        let mut mock = Mock::new(&bus);
        let mut fram = Fram::with_capacity(&mut mock, capacity).unwrap();
        let mut bytes = [0; 2];
        fram.read(offset, &mut bytes).unwrap();
        assert_eq!(bytes, [7, 8]);
        fram.write(offset, &[1, 2]).unwrap();
        assert_eq!(fram.read(capacity, &mut bytes), Err(Error::OutOfBounds));
        mock.done();
    }
}
