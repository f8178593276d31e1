//! Power cuts at every byte written and in every erase, and second cuts after them (SEC-11).

use super::flash::Torn;
use super::*;

/// Saves `kind`, with a power cut after `fuel`; then erases ahead. Returns whether the record was complete.
fn cut_save<const W: usize, const E: usize>(
    flash: &RamFlash<W, E>,
    kind: u8,
    new: &[u8],
    is_secret: bool,
    fuel: Option<u64>,
) -> (RamFlash<W, E>, bool) {
    let mut rig = Rig::start(flash.clone());
    rig.flash.fuel = fuel;
    let is_saved = rig.save_with(kind, new, is_secret, |_, _| {}) == Saved::Yes;
    if !rig.flash.is_off() {
        rig.now += Duration::from_secs(1);
        rig.settle();
    }
    rig.flash.power_on();
    (rig.flash, is_saved)
}

/// A journal that holds these, whose next append begins at each place of a segment in turn.
fn filled<const W: usize, const E: usize>(units: u32, appends: u32, torn: Torn) -> (RamFlash<W, E>, Model) {
    let mut rig = Rig::<W, E>::blank(units * E as u32);
    rig.flash.torn = torn;
    let mut model = Model::from([(1, content(3 * PAYLOAD - 5, 1)), (2, content(40, 2)), (3, content(41, 3))]);
    for (kind, content) in &model {
        assert_eq!(rig.save(*kind, content), Saved::Yes);
    }
    for salt in 0..appends {
        let new = content(40, 100 + salt);
        assert_eq!(rig.save(2, &new), Saved::Yes);
        model.insert(2, new);
    }
    (rig.flash, model)
}

/// Cuts a save at every byte. A restart finds the old or the new content, and can save again; `second` is called with
/// each flash after the cut.
fn each_cut<const W: usize, const E: usize>(
    flash: &RamFlash<W, E>,
    model: &Model,
    (kind, len, is_secret): (u8, usize, bool),
    mut second: impl FnMut(&RamFlash<W, E>, &Model),
) {
    let new = content(len, 77);
    let mut changed = model.clone();
    changed.insert(kind, new.clone());
    let (whole, is_saved) = cut_save(flash, kind, &new, is_secret, None);
    assert!(is_saved);
    assert_eq!(Rig::restarted(&whole), changed);
    let cost = whole.cost() - flash.cost();
    let mut was_old = 0;
    // Without optimisation, the larger geometries take minutes.
    let step = if cfg!(debug_assertions) && flash.bytes.len() > 16_384 { 13 } else { 1 };
    for fuel in (0..cost).step_by(step) {
        let (cut, is_saved) = cut_save(flash, kind, &new, is_secret, Some(fuel));
        let found = Rig::restarted(&cut);
        assert!(found == *model || found == changed, "cut after {fuel} of {cost}: neither old nor new");
        assert!(!is_saved || found == changed, "cut after {fuel}: saved but lost");
        was_old += u32::from(found == *model);
        second(&cut, if found == changed { &changed } else { model });
    }
    assert!(was_old > 0, "{kind}");
}

fn check<const W: usize, const E: usize>(units: u32, appends: core::ops::Range<u32>) {
    for torn in [Torn::Prefix, Torn::Garbage, Torn::Unreadable] {
        for appends in appends.clone() {
            let (flash, model) = filled::<W, E>(units, appends, torn);
            for save in [(2, 40, false), (1, 3 * PAYLOAD, false), (3, 41, true)] {
                // After each cut another save succeeds, and is there.
                let mut each = 0;
                each_cut(&flash, &model, save, |cut, model| {
                    each += 1;
                    if each % 7 == 0 {
                        let (flash, is_saved) = cut_save(cut, 2, &content(50, 78), false, None);
                        assert!(is_saved);
                        let mut model = model.clone();
                        model.insert(2, content(50, 78));
                        assert_eq!(Rig::restarted(&flash), model);
                    }
                });
            }
        }
    }
}

/// SEC-11: 4 KiB × 16, write unit 4.
#[test]
fn cuts_of_many_small_units() {
    check::<4, 4096>(16, 122..124);
}

/// SEC-11: 128 KiB × 2, write unit 4: the two large sectors of a microcontroller.
#[test]
fn cuts_of_two_large_units() {
    check::<4, 131_072>(2, 506..508);
}

/// SEC-11: 8 KiB × 8, write unit 32, as flash with ECC has.
#[test]
fn cuts_of_write_units_of_32_bytes() {
    check::<32, 8192>(8, 122..124);
}

/// SEC-11: 2 KiB × 8, write unit 8.
#[test]
fn cuts_of_double_words() {
    check::<8, 2048>(8, 24..28);
}

/// The result of a cut and the recovery from it: the flash after a save that was cut twice, and its possible content.
fn second_cut<const W: usize, const E: usize>(
    (flash, model): (&RamFlash<W, E>, &Model),
    first: u64,
    second: Option<u64>,
    is_secret: bool,
) -> u64 {
    let (new, newer) = (content(3 * PAYLOAD, 77), content(45, 78));
    let (cut, _) = cut_save(flash, 1, &new, is_secret, Some(first));
    let found = Rig::restarted(&cut);
    let mut changed = model.clone();
    changed.insert(1, new);
    assert!(found == *model || found == changed, "cut after {first}");
    let (again, is_saved) = cut_save(&cut, 2, &newer, false, second);
    let mut then = found.clone();
    then.insert(2, newer);
    let last = Rig::restarted(&again);
    assert!(last == found || last == then, "cuts after {first} and {second:?}");
    assert!(!is_saved || last == then, "cuts after {first} and {second:?}: saved but lost");
    // However often the power was cut, there is room to save.
    let (whole, is_saved) = cut_save(&again, 3, &content(41, 79), false, None);
    assert!(is_saved, "cuts after {first} and {second:?}");
    let mut model = last;
    model.insert(3, content(41, 79));
    assert_eq!(Rig::restarted(&whole), model, "cuts after {first} and {second:?}");
    again.cost() - cut.cost()
}

/// SEC-11: 2 KiB × 8, write unit 8: a second cut at every write unit of the save after each first cut.
#[test]
#[ignore = "takes minutes; `cargo measure nightly` runs it"]
fn second_cuts_at_every_write_unit() {
    for torn in [Torn::Prefix, Torn::Garbage, Torn::Unreadable] {
        let (flash, model) = filled::<8, 2048>(8, 26, torn);
        let (whole, _) = cut_save(&flash, 1, &content(3 * PAYLOAD, 77), false, None);
        for first in (0..whole.cost() - flash.cost()).step_by(4) {
            let cost = second_cut((&flash, &model), first, None, false);
            for second in (0..cost).step_by(4) {
                second_cut((&flash, &model), first, Some(second), false);
            }
        }
    }
}

/// Two seeded cuts a round, for each geometry.
fn seeded_cuts<const W: usize, const E: usize>(units: u32, appends: u32, rounds: u32) {
    let mut state = 0x9E37_79B9_7F4A_7C15u64 ^ E as u64;
    let mut next = |below: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % below.max(1)
    };
    for torn in [Torn::Prefix, Torn::Garbage, Torn::Unreadable] {
        for is_secret in [false, true] {
            let (flash, model) = filled::<W, E>(units, appends, torn);
            let (whole, _) = cut_save(&flash, 1, &content(3 * PAYLOAD, 77), is_secret, None);
            let cost = whole.cost() - flash.cost();
            for _ in 0..rounds / 6 {
                let first = next(cost);
                let second = next(1_200);
                second_cut((&flash, &model), first, Some(second), is_secret);
            }
        }
    }
}

/// SEC-11: second cuts at seeded places.
#[test]
fn second_cuts() {
    seeded_cuts::<4, 4096>(4, 26, 60);
    seeded_cuts::<32, 2048>(8, 26, 120);
    seeded_cuts::<8, 2048>(8, 26, 120);
    seeded_cuts::<1, 256>(33, 10, 120);
}

/// SEC-11: 10^6 second cuts at seeded places, for the larger geometries.
#[test]
#[ignore = "takes hours; `cargo measure nightly` runs it"]
fn a_million_second_cuts() {
    seeded_cuts::<4, 4096>(16, 122, 500_000);
    seeded_cuts::<32, 8192>(8, 122, 500_000);
    seeded_cuts::<4, 131_072>(2, 506, 6_000);
}
