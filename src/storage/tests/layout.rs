//! The stored format as documented: later versions must read what earlier versions have stored.

use super::flash::RamFlash;
use super::*;

type Flash = RamFlash<4, 256>;

/// A slot as documented, built independently of the store.
fn slot(schema: u16, sequence: u32, body: &[u8]) -> Vec<u8> {
    let crc = |bytes: &[u8]| {
        let mut crc = crc_any::CRCu32::crc32();
        crc.digest(bytes);
        crc.get_crc()
    };
    let mut slot = std::vec![0xFF; 256 + body.len()];
    slot[..4].copy_from_slice(b"MVSR");
    slot[4..6].copy_from_slice(&[1, 0]);
    slot[6..8].copy_from_slice(&schema.to_le_bytes());
    slot[8..12].copy_from_slice(&sequence.to_le_bytes());
    slot[12..16].copy_from_slice(&(body.len() as u32).to_le_bytes());
    slot[16..20].copy_from_slice(&crc(body).to_le_bytes());
    slot[20..28].fill(0);
    let sum = crc(&slot[..28]);
    slot[28..32].copy_from_slice(&sum.to_le_bytes());
    slot[256..].copy_from_slice(body);
    slot
}

/// Sequence numbers wrap. Of two equal ones none is newer.
#[test]
fn sequence_numbers_wrap() {
    use crate::storage::record::is_newer;
    assert!(is_newer(6, 5) && is_newer(0, u32::MAX) && is_newer(5, u32::MAX));
    assert!(!is_newer(5, 6) && !is_newer(u32::MAX, 0) && !is_newer(5, 5));
}

/// The body of schema 1.
fn body(content: &Content) -> Vec<u8> {
    let mut head = [0; 32];
    for plan in 0..3 {
        head[2 * plan..][..2].copy_from_slice(&(content.items[plan].len() as u16).to_le_bytes());
        head[6 + 4 * plan..][..4].copy_from_slice(&content.ids[plan].to_le_bytes());
    }
    let mut body = head.to_vec();
    for item in content.items.iter().flatten() {
        body.push(item.frame.0);
        body.extend(item.command.0.to_le_bytes());
        body.push(item.autocontinue);
        item.params.iter().for_each(|param| body.extend(param.to_bits().to_le_bytes()));
        body.extend(item.x.to_le_bytes());
        body.extend(item.y.to_le_bytes());
        body.extend(item.z.to_bits().to_le_bytes());
    }
    body
}

/// Flash of 4096 bytes with these slots.
fn flash(slots: [&[u8]; 2]) -> Flash {
    let mut flash = Flash::new(4096);
    for (place, slot) in flash.bytes.chunks_mut(2048).zip(slots) {
        place[..slot.len()].copy_from_slice(slot);
    }
    flash
}

/// Sequence numbers of the slots that have a header, whether or not their record is whole.
pub(super) fn sequences(bytes: &[u8], slot_len: usize) -> [Option<u32>; 2] {
    [0, slot_len].map(|slot| {
        let header = &bytes[slot..slot + 32];
        header.starts_with(b"MVSR").then(|| u32::from_le_bytes(header[8..12].try_into().unwrap()))
    })
}

/// Changes the sequence number of the record in a slot.
pub(super) fn set_sequence(bytes: &mut [u8], at: usize, slot_len: usize, sequence: u32) {
    let len = u32::from_le_bytes(bytes[at + 12..at + 16].try_into().unwrap()) as usize;
    let schema = u16::from_le_bytes(bytes[at + 6..at + 8].try_into().unwrap());
    let slot = slot(schema, sequence, &bytes[at + 256..at + 256 + len]);
    assert!(slot.len() <= slot_len);
    bytes[at..at + slot.len()].copy_from_slice(&slot);
}

#[test]
fn bytes_are_as_documented() {
    let (first, second) = (Content::new([9, 2, 1], 5), Content::new([1, 0, 8], 6));
    let mut store = store(Flash::new(4096));
    assert_eq!(write(&mut store, 1, &first), Step::Done);
    assert_eq!(write(&mut store, 2, &second), Step::Done);
    let expected = flash([&slot(1, 1, &body(&first)), &slot(1, 2, &body(&second))]);
    assert_eq!(store.flash().bytes, expected.bytes);
    assert_eq!(restart(expected), Some(second));
}

/// G-18: a record of another schema version is distinguished from no record and from damage.
#[test]
fn another_schema_version_is_foreign() {
    let content = Content::new([2, 0, 0], 5);
    for (schema, expected) in [(1, Ok(Some(content.clone()))), (2, Err(RestoreError::Foreign))] {
        assert_eq!(found(flash([&slot(schema, 1, &body(&content)), &[]])), expected);
    }
    assert_eq!(found(Flash::new(4096)), Ok(None));
}

/// G-18: bytes after a record that is too short are ignored, and the record does not count as empty.
#[cfg(feature = "signing")]
#[test]
fn a_short_key_record_is_damaged() {
    let mut short = slot(1, 1, &[7; 32]);
    short[4] = 3;
    let mut crc = crc_any::CRCu32::crc32();
    crc.digest(&short[..28]);
    short[28..32].copy_from_slice(&crc.get_crc().to_le_bytes());
    let mut store = crate::storage::SigningStore::new(flash([&short, &[]]), 0..4096);
    assert!(matches!(store.open(), Err(RestoreError::Damaged)));
}

/// The bytes of version 1: all later versions must read them in the same way.
#[test]
fn version_1_remains_readable() {
    let mut record = std::vec![0xFF; 320];
    record[..32].copy_from_slice(&OLD_HEADER);
    record[256..].copy_from_slice(&OLD_BODY);
    let item = Item {
        frame: MavFrame::GLOBAL_RELATIVE_ALT,
        command: MavCmd::NAV_WAYPOINT,
        autocontinue: 1,
        params: [0.5, 2.0, 0.0, f32::from_bits(0x7FC0_0000)],
        x: 473_977_432,
        y: -85_455_942,
        z: 50.0,
    };
    let content = Content { items: [std::vec![item], Vec::new(), Vec::new()], ids: [0x1234_5678, 0, 0] };
    assert_eq!(restart(flash([&record, &[]])), Some(content.clone()));
    assert_eq!(slot(1, 7, &body(&content)), record);
}

#[rustfmt::skip]
const OLD_BODY: [u8; 64] = [
    1, 0, 0, 0, 0, 0, 0x78, 0x56, 0x34, 0x12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    3, 0x10, 0, 1, 0, 0, 0, 0x3F, 0, 0, 0, 0x40, 0, 0, 0, 0, 0, 0, 0xC0, 0x7F, 0x58, 0x52, 0x40, 0x1C, 0xBA, 0x0B, 0xE8, 0xFA, 0, 0, 0x48, 0x42,
];

#[rustfmt::skip]
const OLD_HEADER: [u8; 32] = [
    b'M', b'V', b'S', b'R', 1, 0, 1, 0, 7, 0, 0, 0, 0x40, 0, 0, 0, 0xDB, 0x5F, 0xEA, 0x8F, 0, 0, 0, 0, 0, 0, 0, 0, 0x6E, 0x7C, 0xBC, 0x4E,
];

/// Of two whole records the newer one is valid, also when the sequence number wraps.
#[test]
fn the_newer_record_is_valid() {
    let (a, b) = (Content::new([1, 0, 0], 1), Content::new([2, 0, 0], 2));
    for (older, newer) in [(1, 2), (u32::MAX, 0), (u32::MAX - 1, 1), (0x7FFF_FFFF, 0x8000_0000), (5, 0x8000_0004)] {
        let (old, new) = (slot(1, older, &body(&a)), slot(1, newer, &body(&b)));
        assert_eq!(restart(flash([&old, &new])), Some(b.clone()), "{older}, {newer}");
        assert_eq!(restart(flash([&new, &old])), Some(b.clone()), "{newer}, {older}");
    }
}

/// G-18: any bit of header or body is flipped. A damaged newer record does not hide the older one, and without an older
/// one it does not count as empty.
#[test]
fn damage_is_reported() {
    let (a, b) = (Content::new([1, 0, 0], 1), Content::new([1, 1, 0], 2));
    let (old, new) = (slot(1, 1, &body(&a)), slot(1, 2, &body(&b)));
    for bit in (0..32 * 8).chain(256 * 8..new.len() * 8) {
        let mut damaged = new.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        for slots in [[&old[..], &damaged], [&damaged, &old]] {
            let mut store = store(flash(slots));
            let stored = store.open().expect("a record").expect("a record");
            assert_eq!(items(&mut store, stored), a, "bit {bit}");
            // A header with a wrong CRC may be torn. A body is not, because it is read back before its header is
            // written.
            assert_eq!(store.is_damaged(), bit >= 256 * 8, "bit {bit}");
            assert_eq!(settle(&mut store), Step::Idle);
            assert_eq!(store.open().is_ok() && store.is_damaged(), bit >= 256 * 8, "bit {bit}: damage remains");
        }
        for slots in [[&damaged[..], &[]], [&[], &damaged], [&damaged, &damaged], [&damaged, &[0; 32]]] {
            let mut store = store(flash(slots));
            assert_eq!(store.open(), Err(RestoreError::Damaged), "bit {bit}");
            assert_eq!(settle(&mut store), Step::Idle);
            assert_eq!(store.open(), Err(RestoreError::Damaged), "bit {bit}: damage remains");
            assert_eq!(write(&mut store, 1, &b), Step::Done);
            assert_eq!(restart(store.flash().clone()), Some(b.clone()), "bit {bit}");
            assert_eq!(settle(&mut store), Step::Idle);
            assert_eq!(restart(store.into_inner()), Some(b.clone()), "bit {bit}");
        }
    }
}

/// G-18: storage that was never written is empty, whatever its initial bytes: ones in flash, any byte in FRAM.
#[test]
fn new_storage_is_empty() {
    for byte in [0xFF, 0, 0x55] {
        let mut store = store(Flash::of(std::vec![byte; 4096]));
        assert_eq!(store.open(), Ok(None));
        assert!(!store.is_damaged());
    }
}

/// Impossible lengths in headers with correct CRCs.
#[test]
fn impossible_lengths() {
    let one = body(&Content::new([1, 0, 0], 1));
    for body in [&[][..], &one[..31], &one[..63], &one[..32], &[&one[..], &[0; 32]].concat()] {
        assert_eq!(found(flash([&slot(1, 1, body), &[]])), Err(RestoreError::Damaged), "{} bytes", body.len());
    }
    // A body that reaches beyond its slot.
    let long = Content::new([55, 0, 0], 1);
    let long = slot(1, 1, &body(&long));
    assert_eq!(long.len(), 2048);
    assert!(restart(flash([&long, &[]])).is_some());
    let longer = slot(1, 1, &body(&Content::new([56, 0, 0], 1)));
    let mut bytes = std::vec![0xFF; 4096];
    bytes[..longer.len()].copy_from_slice(&longer);
    assert_eq!(found(Flash::of(bytes)), Err(RestoreError::Damaged));
}

/// A record of a later schema version is not read, and not erased before a newer record is complete.
#[test]
fn a_foreign_record_is_kept_until_it_is_replaced() {
    let unknown = slot(2, 9, &[0xAB; 96]);
    let old = slot(1, 8, &body(&Content::new([1, 0, 0], 1)));
    let mut store = store(flash([&old, &unknown]));
    assert_eq!(store.open(), Err(RestoreError::Foreign), "the older record is not restored");
    assert_eq!(settle(&mut store), Step::Idle);
    assert_eq!(store.flash().bytes[2048..][..unknown.len()], unknown);
    assert_eq!(sequences(&store.flash().bytes, 2048), [None, Some(9)]);

    let new = Content::new([2, 0, 0], 2);
    while store.step(later(), Some((1, new.views()))) != Step::Done {
        assert_eq!(store.flash().bytes[2048..][..unknown.len()], unknown);
    }
    assert_eq!(sequences(&store.flash().bytes, 2048), [Some(10), Some(9)]);
    assert_eq!(restart(store.into_inner()), Some(new));
}

/// The lengths with which firmware reserves regions.
#[test]
fn region_lengths() {
    assert_eq!(PlanStore::<RamFlash<1, 64>>::region_len(0, 0, 0), 2 * (256 + 64));
    assert_eq!(PlanStore::<RamFlash<1, 64>>::region_len(1, 1, 1), 2 * (256 + 128));
    assert_eq!(PlanStore::<RamFlash<32, 4096>>::region_len(250, 64, 16), 2 * 3 * 4096);
    assert_eq!(PlanStore::<RamFlash<32, 131_072>>::region_len(250, 64, 16), 2 * 131_072);
    assert_eq!(PlanStore::<Flash>::region_len(usize::MAX, 1, 1), u32::MAX);
}
