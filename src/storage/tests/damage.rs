//! Damaged pages: lost content is reported, never read as empty, and costs nothing else (G-18).

use super::*;

const W: usize = 8;
const E: usize = 1024;

/// A journal of 8 units whose open segment has records of three kinds, one of them of several pages, and the model.
fn filled(saves: u32) -> (RamFlash<W, E>, Model) {
    let mut rig = Rig::<W, E>::blank(8 * E as u32);
    let mut model = Model::new();
    for salt in 0..saves {
        let kind = (salt % 3 + 1) as u8;
        let new = content(if kind == 1 { 3 * PAYLOAD } else { 40 }, salt);
        assert_eq!(rig.save(kind, &new), Saved::Yes);
        model.insert(kind, new);
    }
    (rig.flash, model)
}

/// Returns the last page that was written.
fn newest_page(flash: &RamFlash<W, E>) -> usize {
    let pages = flash.bytes.chunks(256).enumerate().filter(|(_, page)| page.starts_with(b"ML\x01"));
    let key = |page: &[u8]| (page[228..232].to_vec(), page[232..234].to_vec());
    pages.max_by_key(|(_, page)| key(page)).unwrap().0
}

/// Whichever bit flips: each record is the newest one, or its kind is reported as damaged. The report outlasts other saves;
/// a save of that kind ends it, and the other records are still there.
#[test]
fn every_flipped_bit_is_reported() {
    for saves in [1, 2, 3, 7, 11, 16] {
        let (flash, model) = filled(saves);
        for bit in (0..flash.bytes.len() * 8).filter(|bit| flash.bytes[bit / 8 / 256 * 256] != 0xFF) {
            let mut damaged = flash.clone();
            damaged.bytes[bit / 8] ^= 1 << (bit % 8);
            let mut rig = Rig::start(damaged);
            let lost = rig.damaged();
            for (kind, content) in &model {
                let found = rig.load(*kind);
                assert!(
                    found.as_ref() == Some(content) || lost.contains(kind),
                    "{saves} saves, bit {bit}, kind {kind}: {lost:?}"
                );
            }
            if bit % 257 != 0 {
                continue;
            }
            // Through several segments.
            for salt in 0..20 {
                assert_eq!(rig.save(9, &content(2 * PAYLOAD, salt)), Saved::Yes);
            }
            let mut rig = Rig::start(rig.flash);
            assert_eq!(rig.damaged(), lost, "bit {bit}");
            for kind in lost {
                assert_eq!(rig.save(kind, &content(50, 3)), Saved::Yes);
            }
            let mut rig = Rig::start(rig.flash);
            assert_eq!(rig.damaged(), [0u8; 0]);
            assert!(model.keys().all(|kind| rig.load(*kind).is_some()), "bit {bit}");
        }
    }
}

/// A unit that reads as erased, or has other data, though it had records: their kinds are reported.
#[test]
fn a_lost_unit_is_reported() {
    let (flash, model) = filled(11);
    for unit in 0..8 {
        for fill in [0xFF, 0x00, 0xA5] {
            let mut damaged = flash.clone();
            damaged.bytes[unit * E..(unit + 1) * E].fill(fill);
            let newest = newest_page(&flash) * 256 / E;
            let mut rig = Rig::start(damaged);
            let lost = rig.damaged();
            for (kind, content) in &model {
                let found = rig.load(*kind);
                assert!(
                    found.as_ref() == Some(content) || lost.contains(kind) || unit == newest,
                    "{unit} {fill} {kind}"
                );
            }
        }
    }
}

/// Garbage in any form is read within bounds, and a record saved afterwards is found.
#[test]
fn garbage_is_no_log() {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 8
    };
    for round in 0..2_000 {
        let (mut flash, _) = if round % 2 == 0 { filled(5) } else { (RamFlash::new(8 * E as u32), Model::new()) };
        for _ in 0..next() % 40 {
            let (at, len) = (next() as usize % flash.bytes.len(), next() as usize % 700);
            let value = next();
            for byte in flash.bytes.iter_mut().skip(at).take(len) {
                *byte = if value % 5 == 0 { value as u8 } else { next() as u8 };
            }
        }
        let mut rig = Rig::start(flash);
        let _ = rig.all();
        let new = content(60, round);
        assert_eq!(rig.save(7, &new), Saved::Yes);
        let mut rig = Rig::start(rig.flash);
        assert_eq!(rig.load(7), Some(new), "round {round}");
    }
}

/// A region with other data is reported; erased flash and zeroed FRAM are not.
#[test]
fn other_data_is_reported() {
    for (fill, is_other) in [(0xFF, false), (0x00, false), (0x55, true)] {
        let rig = Rig::<W, E>::start(RamFlash::of(std::vec![fill; 4 * E]));
        assert_eq!(rig.journal.has_other_data(), is_other, "{fill:x}");
    }
    let (flash, _) = filled(9);
    assert!(!Rig::start(flash).journal.has_other_data());
}

/// A journal of another version of the format is neither read nor written.
#[test]
fn a_log_of_another_version_is_left_alone() {
    let (mut flash, _) = filled(5);
    for page in flash.bytes.chunks_mut(256).filter(|page| page.starts_with(b"ML\x01")) {
        // The version in front and in the flags, and the footer's checksum.
        page[2] = 2;
        page[239] = page[239] & 0x0F | 0x20;
        let mut crc = crc_any::CRCu32::crc32();
        crc.digest(&page[228..252]);
        page[252..].copy_from_slice(&crc.get_crc().to_le_bytes());
    }
    let before = flash.bytes.clone();
    let mut rig = Rig::start(flash);
    assert!(rig.journal.is_foreign() && !rig.journal.is_idle());
    assert!(matches!(rig.journal.next(rig.now, true, &mut rig.page), Next::Idle));
    assert_eq!(rig.flash.bytes, before);
}
