//! Any flash content reads as empty, as a record with correct checksums, or as reported damage, and never panics
//! (G-18).

#[path = "../../../tests/support/rng.rs"]
#[allow(dead_code, reason = "shared with other tests")]
mod rng;

use super::flash::RamFlash;
use super::*;
use rng::Rng;

type Flash = RamFlash<4, 64>;

const SLOT: usize = 512;

fn crc(bytes: &[u8]) -> [u8; 4] {
    let mut crc = crc_any::CRCu32::crc32();
    crc.digest(bytes);
    crc.get_crc().to_le_bytes()
}

fn word(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// Accepts a CRC whose last three bytes may be erased.
fn is_crc(bytes: &[u8], crc: [u8; 4]) -> bool {
    bytes[0] == crc[0] && (1..4).all(|at| [crc[at], 0xFF].contains(&bytes[at]))
}

/// An independent reader: sequence number, schema and body of a slot, if it is whole.
fn whole(slot: &[u8]) -> Option<(u32, u32, &[u8])> {
    let len = word(slot, 12) as usize;
    let is_header = slot[..4] == *b"MVSR"
        && slot[4..6] == [1, 0]
        && slot[20..28] == [0; 8]
        && is_crc(&slot[28..32], crc(&slot[..28]));
    if !is_header || len == 0 || !len.is_multiple_of(32) || len > SLOT - 256 {
        return None;
    }
    let body = &slot[256..256 + len];
    (slot[16..20] == crc(body)).then_some((word(slot, 8), word(slot, 4) >> 16, body))
}

/// The numbers of items and the ids that the independent reader finds.
fn expected(image: &[u8]) -> Option<([u16; 3], [u32; 3])> {
    let (_, schema, body) = match (whole(&image[..SLOT]), whole(&image[SLOT..])) {
        (Some(a), Some(b)) => {
            if (b.0.wrapping_sub(a.0) as i32) > 0 {
                b
            } else {
                a
            }
        }
        (a, b) => a.or(b)?,
    };
    let counts = [0, 2, 4].map(|at| u16::from_le_bytes([body[at], body[at + 1]]));
    let rows = 1 + counts.iter().map(|count| usize::from(*count)).sum::<usize>();
    (schema == 1 && rows * 32 == body.len()).then(|| (counts, [6, 10, 14].map(|at| word(body, at))))
}

/// Returns whether the slot was a header, by its magic and kind.
fn was_header(slot: &[u8]) -> bool {
    let matches = (0..4).filter(|at| slot[*at] == b"MVSR"[*at]).count();
    matches == 4 || matches > 1 && [0, 1, 3, 5, 9, 17, 33, 65, 129].contains(&slot[4])
}

/// Asserts that the store finds the same as the independent reader, and that it reports an error unless storage is
/// blank. Returns whether there is a record.
fn check(image: Vec<u8>) -> bool {
    let expected = expected(&image);
    let is_blank = image.chunks(SLOT).all(|slot| slot[28..32] == [0xFF; 4] || !was_header(slot));
    let found = found(Flash::of(image));
    let counts = |content: &Content| [0, 1, 2].map(|plan| content.items[plan].len() as u16);
    let content = found.as_ref().ok().and_then(Option::as_ref);
    assert_eq!(content.map(|content| (counts(content), content.ids)), expected);
    assert!(found != Ok(None) || is_blank, "damage reads as empty");
    expected.is_some()
}

fn fill(rng: &mut Rng, bytes: &mut [u8]) {
    bytes.chunks_mut(8).for_each(|chunk| chunk.copy_from_slice(&rng.next().to_le_bytes()[..chunk.len()]));
}

/// An image of two records, either of which may be missing.
fn image(rng: &mut Rng) -> Vec<u8> {
    let mut counts = || [rng.below(3) as u16, rng.below(3) as u16, rng.below(3) as u16];
    let (a, b) = (Content::new(counts(), 3), Content::new(counts(), 4));
    let mut store = store(Flash::new(2 * SLOT as u32));
    assert_eq!(write(&mut store, 1, &a), Step::Done);
    if rng.chance(0.8) {
        assert_eq!(write(&mut store, 2, &b), Step::Done);
    }
    store.into_inner().bytes
}

/// Corrects the checksums of a slot, so that no CRC detects the change.
fn sign(slot: &mut [u8]) {
    let len = (word(slot, 12) as usize).min(SLOT - 256);
    let sum = crc(&slot[256..256 + len]);
    slot[16..20].copy_from_slice(&sum);
    let sum = crc(&slot[..28]);
    slot[28..32].copy_from_slice(&sum);
}

/// G-18: data that never was a record, such as old code in the region, reads as empty and not as damage.
#[test]
fn random_bytes_read_as_empty() {
    let mut rng = Rng::new(1);
    let mut bytes = std::vec![0; 2 * SLOT];
    let mut blank = 0;
    for _ in 0..50_000 {
        fill(&mut rng, &mut bytes);
        assert!(!check(bytes.clone()));
        blank += u32::from(found(Flash::of(bytes.clone())) == Ok(None));
    }
    assert!(blank > 49_990, "{blank}");
}

/// Records with a few bytes changed, some of them with corrected checksums.
#[test]
fn damaged_records_are_detected() {
    let mut rng = Rng::new(2);
    let images: Vec<_> = (0..64).map(|_| image(&mut rng)).collect();
    let (mut found, mut none) = (0, 0);
    for _ in 0..50_000 {
        let mut bytes = images[rng.below(64) as usize].clone();
        for _ in 0..=rng.below(4) {
            // Half of the changes are in the header and the first row.
            let at = match rng.below(4) {
                0 => rng.below(32),
                1 => 256 + rng.below(32),
                _ => rng.below(SLOT as u64),
            } as usize;
            let slot = rng.below(2) as usize * SLOT;
            match rng.below(4) {
                0 => bytes[slot + at..slot + SLOT].fill(0xFF),
                1 => bytes[slot..slot + at].fill(0xFF),
                2 => bytes[slot + at] = rng.byte(),
                _ => bytes[slot + at] ^= 1 << rng.below(8),
            }
        }
        for slot in bytes.chunks_mut(SLOT) {
            if rng.chance(0.3) {
                sign(slot);
            }
        }
        if check(bytes) { found += 1 } else { none += 1 }
    }
    assert!(found > 5_000 && none > 5_000, "{found} found, {none} none");
}

/// The next commit succeeds with any content before it.
#[test]
fn garbage_is_overwritten() {
    let mut rng = Rng::new(3);
    let content = Content::new([2, 1, 1], 8);
    for round in 0..1_000 {
        let mut bytes = image(&mut rng);
        let at = rng.below(2 * SLOT as u64) as usize;
        fill(&mut rng, &mut bytes[at..]);
        let mut store = store(Flash::of(bytes));
        if round % 2 == 0 {
            assert!(!matches!(store.open(), Err(RestoreError::Storage(_))));
        }
        assert_eq!(write(&mut store, 1, &content), Step::Done);
        assert_eq!(restart(store.into_inner()), Some(content.clone()));
    }
}
