//! Floods of anything: rules.

use super::*;
use crate::crc;
use crate::message::Dialect;

/// Sends a random message of the dialect with random content, mostly to this vehicle. Returns its length.
fn anything(field: &mut Field, random: &mut Random, link: usize, from: Address) -> usize {
    let rows = Common::MESSAGES.rows();
    let info = &rows[random.below(rows.len())];
    let mut payload: Vec<u8> = (0..info.max_len()).map(|_| random.next().to_le_bytes()[0]).collect();
    if random.below(4) > 0 {
        for at in [info.target_system(), info.target_component()].into_iter().flatten() {
            payload[usize::from(at)] = 1;
        }
    }
    let [a, b, c, _] = info.id().to_le_bytes();
    let (system, component) = (from.system.wire(), from.component.wire());
    let mut frame = vec![0xFD, info.max_len(), 0, 0, field.seq, system, component, a, b, c];
    frame.extend(payload);
    let sum = crc::checksum(&frame[1..], info.crc_extra());
    frame.extend(sum.to_le_bytes());
    field.receive(link, &frame);
    frame.len()
}

/// Sends a random request, or any message. Returns its length.
fn hostile(field: &mut Field, random: &mut Random, pool: &[Request], link: usize, from: Address) -> usize {
    if random.below(4) == 0 {
        return anything(field, random, link, from);
    }
    field.request(link, from, &pool[random.below(pool.len())])
}

/// whatever strangers flood a link with, one kind of request at a time or all of them, streams keep half of what they have
/// of a busy link, and others' requests have a tenth of it. No poll calls more than 32 hooks.
#[test]
fn floods_leave_a_busy_link_to_its_own() {
    const SECONDS: usize = 2;
    let pool = requests();
    let calm = flood(&mut prepared(), SECONDS, |_| 0);
    for seed in 0..12 {
        let mut random = Random(seed);
        let chosen: Vec<usize> = (0..4).map(|_| random.below(pool.len())).collect();
        let from = [STATION, STRANGER, Address::new(9, 1)];
        let mut field = prepared();
        let shares = flood(&mut field, SECONDS, |field| {
            let from = from[random.below(from.len())];
            if seed % 3 == 0 {
                return hostile(field, &mut random, &pool, ASKING, from);
            }
            field.request(ASKING, from, &pool[chosen[random.below(chosen.len())]])
        });
        assert!(field.hooks <= 32, "seed {seed}: {} hooks in a poll", field.hooks);
        check(&calm, &shares, SECONDS, &std::format!("seed {seed}"));
    }
}
