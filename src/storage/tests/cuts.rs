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
        rig.now = rig.now.after(Duration::from_secs(1));
        rig.settle();
    }
    rig.flash.power_on();
    (rig.flash, is_saved)
}

/// A log that holds these, whose next append begins at each place of a segment in turn.
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
    let (mut was_old, mut was_new) = (0, 0);
    for fuel in 0..cost {
        let (cut, is_saved) = cut_save(flash, kind, &new, is_secret, Some(fuel));
        let found = Rig::restarted(&cut);
        assert!(found == *model || found == changed, "cut after {fuel} of {cost}: neither old nor new");
        assert!(!is_saved || found == changed, "cut after {fuel}: saved but lost");
        if found == changed {
            was_new += 1
        } else {
            was_old += 1
        }
        second(&cut, if found == changed { &changed } else { model });
    }
    assert!(was_old > 0, "{kind}");
    let _ = was_new;
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
