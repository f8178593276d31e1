//! A script of saves, power cuts and damage, beside a model that says what must be there.

use super::pages::{self, PAGE};
use super::{Device, KINDS, Values};
use crate::flash::{Fault, RamFlash};
use arbitrary::{Result, Unstructured};
use std::collections::BTreeSet;

/// What the model knows of a kind.
#[derive(Clone, Debug, Default)]
struct Known {
    /// All values that were ever saved, and none.
    history: BTreeSet<Vec<u8>>,
    value: Vec<u8>,
    /// Whether it is damaged for certain, or may be: the vehicle's own records share an error.
    is_damaged: bool,
    may_be_damaged: bool,
    /// Whether the only evidence of damage is where the next segment will be.
    is_fragile: bool,
}

/// A byte of a page that is changed.
struct Flip {
    at: usize,
    mask: u8,
}

/// Plays a script. A step is
///
/// ```text
///   0 to 5   a save of the kind with this index: variant, steps until the power cut (2 bytes)
///   6        as many saves of one kind: kind, number
///   7        damage: page (2 bytes, from the newest one on), byte, mask; up to three of them
/// ```
pub(super) fn play<const W: usize, const E: usize>(flash: RamFlash<W, E>, mut u: Unstructured<'_>) -> Result<()> {
    let mut model = KINDS.map(|_| Known { history: BTreeSet::from([Vec::new()]), ..Known::default() });
    let mut device = Device::boot(flash);
    // Each save restarts the vehicle, which takes most of the time.
    let mut saves = 14;
    for _ in 0..16 {
        if u.is_empty() {
            break;
        }
        let step = u.arbitrary::<u8>()? % 8;
        device = match step {
            0..6 => {
                let (variant, fuel): (u8, u16) = (u.arbitrary()?, u.arbitrary()?);
                let fuel = (fuel < 0xF000).then_some(u64::from(fuel % 4_096));
                save(device, &mut model, usize::from(step), variant.max(1), fuel)
            }
            6 => {
                let (kind, count): (u8, u8) = (u.arbitrary()?, u.arbitrary()?);
                let mut device = device;
                let count = (count % 16).min(saves);
                saves -= count;
                for variant in 1..=count {
                    device = save(device, &mut model, usize::from(kind) % KINDS.len(), variant, None);
                }
                device
            }
            _ => {
                let bytes = &device.store.flash().bytes;
                let open = pages::open(bytes);
                let mut flips = Vec::new();
                let more: u8 = u.arbitrary()?;
                for _ in 0..=more % 3 {
                    let (page, byte, mask): (u16, u8, u8) = (u.arbitrary()?, u.arbitrary()?, u.arbitrary()?);
                    // Usually one of the open segment, otherwise any.
                    let at = match open.iter().rev().nth(usize::from(page)) {
                        Some(page) => page.at,
                        None => usize::from(page) * PAGE % bytes.len(),
                    };
                    // What is damaged is not hit again: that could mend it, or hide it.
                    if !pages::is_damaged(&bytes[at..at + PAGE]) {
                        flips.push(Flip { at: at + usize::from(byte), mask: mask.max(1) });
                    }
                }
                damage(device, &mut model, &flips)
            }
        };
    }
    Ok(())
}

fn values(model: &[Known; KINDS.len()]) -> Values {
    std::array::from_fn(|index| model[index].value.clone())
}

/// Saves a new value, with a power cut. Afterwards it is the old value or the new one, and everything else is as it was.
fn save<const W: usize, const E: usize>(
    mut device: Device<W, E>,
    model: &mut [Known; KINDS.len()],
    index: usize,
    variant: u8,
    fuel: Option<u64>,
) -> Device<W, E> {
    let is_first = pages::open(&device.store.flash().bytes).is_empty();
    device.store.flash_mut().fuel = fuel;
    let new = device.change(index, variant);
    device.settle();
    let was_cut = device.store.flash().is_off();
    let device = device.reboot();
    let found = device.values();
    if std::env::var_os("MAVSTACK_SHOW").is_some() {
        let short = |value: &Vec<u8>| format!("{}x{:?}", value.len(), value.first());
        println!(
            "save {index} variant {variant} fuel {fuel:?} cut {was_cut}: {:?} {:?}",
            found.each_ref().map(short),
            device.errors()
        );
    }
    if was_cut {
        adopt_fragile(model, &found, &device);
    } else {
        model.iter_mut().for_each(|known| known.is_fragile = false);
    }
    let mut expected = values(model);
    model[index].history.insert(new.clone());
    if !was_cut || found[index] == new {
        expected[index].clone_from(&new);
        // A write that was cut off may have been one of the old value, which is stored again.
        if found[index] != model[index].value || !was_cut {
            (model[index].is_damaged, model[index].may_be_damaged) = (false, false);
        }
        model[index].value = new;
    }
    // If the first page of all cannot be read, nobody knows what it was.
    if was_cut && is_first {
        model.iter_mut().zip(device.damaged()).for_each(|(known, is_reported)| known.may_be_damaged |= is_reported);
    }
    assert_eq!(found, expected, "kind {} of variant {variant}, cut: {was_cut}", KINDS[index]);
    check_damage(&device, model, was_cut.then_some(index));
    device
}

/// If the ends of all pages that opened a segment are damaged, the segment before it may be in use, and the next one replaces the
/// evidence. A power cut meanwhile leaves the older values, and nobody can know of the damage.
fn adopt_fragile<const W: usize, const E: usize>(
    model: &mut [Known; KINDS.len()],
    found: &Values,
    device: &Device<W, E>,
) {
    for ((known, value), is_reported) in model.iter_mut().zip(found).zip(device.damaged()) {
        if known.is_fragile && known.history.contains(value) {
            known.value.clone_from(value);
            (known.is_damaged, known.may_be_damaged) = (false, is_reported);
        }
    }
}

/// Damage is reported until there is new content, and nothing else is.
fn check_damage<const W: usize, const E: usize>(
    device: &Device<W, E>,
    model: &mut [Known; KINDS.len()],
    cut: Option<usize>,
) {
    let reported = device.damaged();
    for (index, is_reported) in reported.into_iter().enumerate() {
        let service = if index < super::OWN { index..index + 1 } else { super::OWN..KINDS.len() };
        let known = &mut model[service.clone()];
        if is_reported {
            assert!(known.iter().any(|known| known.may_be_damaged), "kind {}: not damaged, but reported", KINDS[index]);
        } else {
            // If a record that was cut off is there, nobody can see it if its value is the old one.
            let is_cut = cut.is_some_and(|cut| service.contains(&cut));
            assert!(
                is_cut || !known.iter().any(|known| known.is_damaged),
                "kind {}: damage is no longer reported",
                KINDS[index]
            );
            for known in known {
                (known.is_damaged, known.may_be_damaged) = (false, false);
            }
        }
    }
}

/// Changes bytes in the flash. Each kind then has its value, or reports damage and has an older value or none.
fn damage<const W: usize, const E: usize>(
    device: Device<W, E>,
    model: &mut [Known; KINDS.len()],
    flips: &[Flip],
) -> Device<W, E> {
    let mut flash = device.store.into_inner();
    let open = pages::open(&flash.bytes);
    for Flip { at, mask } in flips {
        flash.bytes[*at] ^= mask;
    }
    flash.fault = Fault::None;
    // A last page whose footer is damaged looks like one whose write was cut off, unless another record follows that is whole so
    // far.
    let is_hit = |page: &pages::Page| flips.iter().any(|flip| (page.at + 228..page.at + PAGE).contains(&flip.at));
    let mut like_cut_off = BTreeSet::new();
    for page in open.iter().rev() {
        if is_hit(page) {
            like_cut_off.insert(page.kind);
        } else if (page.index == 0 || page.is_last()) && !flips.iter().any(|flip| flip.at / PAGE == page.at / PAGE) {
            break;
        }
    }
    let is_fragile = open.iter().filter(|page| page.opens()).all(is_hit);
    if is_fragile {
        // Nothing shows that the segment is open: its records look like writes that were cut off. So may the newest ones of the
        // segment before, which is then in use.
        like_cut_off.extend(KINDS);
    }
    let device = Device::boot(flash);
    let (found, reported) = (device.values(), device.damaged());
    if std::env::var_os("MAVSTACK_SHOW").is_some() {
        let short = |value: &Vec<u8>| format!("{}x{:?}", value.len(), value.first());
        let flips: Vec<_> = flips.iter().map(|flip| (flip.at / PAGE, flip.at % PAGE, flip.mask)).collect();
        println!(
            "damage {flips:?} open {:?}: {:?} {:?}",
            open.iter().map(|p| (p.at / PAGE, p.kind, p.index)).collect::<Vec<_>>(),
            found.each_ref().map(short),
            device.errors()
        );
    }
    for (index, known) in model.iter_mut().enumerate() {
        let (kind, value) = (KINDS[index], &found[index]);
        if *value != known.value {
            assert!(
                // With an older segment, a record that was damaged in the newer one may be whole.
                reported[index] || like_cut_off.contains(&kind) || (known.may_be_damaged && is_fragile),
                "kind {kind} is damaged, and reads as {}: {:?}",
                if value.is_empty() { "empty" } else { "an older value" },
                flips.iter().map(|flip| (flip.at / PAGE, flip.at % PAGE)).collect::<Vec<_>>()
            );
            assert!(known.history.contains(value), "kind {kind}: content that was never saved");
        }
        // What looks like a write that was cut off is not damage, and may be reported because of another kind.
        let is_certain = index < super::OWN || *value != known.value && !like_cut_off.contains(&kind);
        known.is_damaged = reported[index] && is_certain;
        known.may_be_damaged = reported[index];
        known.is_fragile |= is_fragile;
        known.value.clone_from(value);
    }
    device
}
