//! Uploads that are interrupted.

use mavstack::dialect::MavMissionResult;
use mavstack::{Duration, Instant};
use mavstack_demo::{COMPANION, TELEMETRY};
use mavstack_qemu::board::Board;
use semihosting::println;

use crate::POSITION;
use crate::flash::{retain, retained};
use crate::station::{Upload, upload};
use crate::world::{OTHER, Parts, STATION, World};

const ITEMS: u16 = 50;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;
const DENIED: MavMissionResult = MavMissionResult::DENIED;

/// A ground station falls silent after each item. Until its upload times out, other clients are refused.
pub fn silent_station(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    assert!(upload(&mut world, TELEMETRY, STATION, ITEMS, 0) == ACCEPTED);
    let (mut longest, mut denied) = (Duration::ZERO, 0);
    for position in 0..ITEMS {
        Upload::new(TELEMETRY, STATION, ITEMS, 1_000 + position).silent_after(position).run_until_silent(&mut world);
        let fell_silent = world.now;
        let mut successor = Upload::new(COMPANION, OTHER, ITEMS, position + 1);
        while !successor.has_request {
            world.pass(&mut [&mut successor]);
            assert!(world.live(position) == Some(ITEMS), "silent after {position} items: the old plan is lost");
            let waited = world.now - fell_silent;
            assert!(waited <= Duration::from_secs(8), "silent after {position} items: no timeout within 8 s");
            if let Some(result) = successor.result {
                assert!(result == DENIED, "{result:?}");
                denied += 1;
                world.run(Duration::from_millis(100), &mut []);
                successor = Upload::new(COMPANION, OTHER, ITEMS, position + 1);
            }
        }
        longest = longest.max(world.now - fell_silent);
        assert!(
            successor.finish(&mut world) == ACCEPTED && world.live(position + 1) == Some(ITEMS),
            "after {position} items"
        );
    }
    assert!(denied > 0, "no client was refused");
    println!(
        "gcs-dies: silent after 0 to {} items: old plan live, upload timed out after at most {} ms ({denied} other uploads denied \
         until then), next upload accepted",
        ITEMS - 1,
        longest.as_millis()
    );
    world.end()
}

/// A second client starts at each item of the first client's upload, on the same link and on another.
pub fn two_stations(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    let mut denied = 0;
    for link in [TELEMETRY, COMPANION] {
        for position in 1..ITEMS {
            let variant = position + 100 * u16::from(link.0);
            let mut first = Upload::new(TELEMETRY, STATION, ITEMS, variant);
            let mut second = None;
            let mut passes = 0;
            while first.result.is_none() {
                match &mut second {
                    Some(second) => world.pass(&mut [&mut first, second]),
                    None => world.pass(&mut [&mut first]),
                }
                passes += 1;
                assert!(passes < 1_000, "the first upload does not end");
                if first.items_sent() == position && second.is_none() {
                    second = Some(Upload::new(link, OTHER, ITEMS, 1_000 + variant));
                }
            }
            let refused = second.and_then(|second| second.result);
            assert!(
                first.result == Some(ACCEPTED) && world.live(variant) == Some(ITEMS),
                "the first upload: {:?}",
                first.result
            );
            // At the last item the first upload has ended, so the second one is not refused.
            assert!(
                refused == Some(DENIED) || position + 1 >= ITEMS,
                "at item {position} the second upload: {refused:?}"
            );
            denied += u32::from(refused == Some(DENIED));
        }
    }
    println!(
        "two-gcs: a second upload at each of {} items, on the same link and on another: {denied} times denied, the first plan live \
         each time",
        ITEMS - 1
    );
    world.end()
}

/// Resets the processor after each item.
pub fn reset(parts: Parts) -> Parts {
    let position = retained(POSITION) as u16;
    let mut world;
    if position == 0 {
        world = World::fresh(parts);
        assert!(upload(&mut world, COMPANION, STATION, ITEMS, 1) == ACCEPTED);
    } else {
        world = World::start(parts, Instant::ZERO);
        let is_old = world.live(1) == Some(ITEMS);
        assert!(is_old || (position > ITEMS && world.live(2) == Some(ITEMS)), "reset after {} items", position - 1);
    }
    if position <= ITEMS {
        retain(POSITION, u32::from(position) + 1);
        Upload::new(COMPANION, STATION, ITEMS, 2).silent_after(position).run_until_silent(&mut world);
        Board::reset();
    }
    retain(POSITION, 0);
    assert!(upload(&mut world, COMPANION, STATION, ITEMS, 3) == ACCEPTED, "the next upload is refused");
    println!(
        "reset-in-upload: {} processor resets, after 0 to {ITEMS} items: the old plan restored each time",
        ITEMS + 1
    );
    world.end()
}
