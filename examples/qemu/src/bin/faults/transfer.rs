//! Uploads that do not come to their end.

use mavstack::dialect::MavMissionResult;
use mavstack::{Duration, Instant};
use mavstack_demo::{COMPANION, TELEMETRY};
use mavstack_qemu::board::Board;
use semihosting::println;

use crate::POSITION;
use crate::flash::{keep, kept};
use crate::station::{Upload, upload};
use crate::world::{OTHER, Parts, STATION, World};

const ITEMS: u16 = 50;
const ACCEPTED: MavMissionResult = MavMissionResult::ACCEPTED;
const DENIED: MavMissionResult = MavMissionResult::DENIED;

/// A ground station falls silent at each item. Somebody else is refused as long as it is waited for.
pub fn dead_station(parts: Parts) -> Parts {
    let mut world = World::fresh(parts);
    assert!(upload(&mut world, TELEMETRY, STATION, ITEMS, 0) == ACCEPTED);
    let (mut longest, mut denied) = (Duration::ZERO, 0);
    for position in 0..ITEMS {
        Upload::new(TELEMETRY, STATION, ITEMS, 1_000 + position).dying_after(position).die(&mut world);
        let died = world.now;
        let mut heir = Upload::new(COMPANION, OTHER, ITEMS, position + 1);
        while !heir.is_asked {
            world.pass(&mut [&mut heir]);
            assert!(world.live(position) == Some(ITEMS), "dead after {position} items: the old plan is gone");
            let waited = world.now.since(died);
            assert!(waited <= Duration::from_secs(8), "dead after {position} items: it is waited for longer than 8 s");
            if let Some(result) = heir.result {
                assert!(result == DENIED, "{result:?}");
                denied += 1;
                world.run(Duration::from_millis(100), &mut []);
                heir = Upload::new(COMPANION, OTHER, ITEMS, position + 1);
            }
        }
        longest = longest.max(world.now.since(died));
        assert!(
            heir.finish(&mut world) == ACCEPTED && world.live(position + 1) == Some(ITEMS),
            "after {position} items"
        );
    }
    assert!(denied > 0, "nobody was refused");
    println!(
        "gcs-dies: after each of 0 to {} items: old plan live, idle after at most {} ms ({denied} times denied until then), the \
         next upload accepted",
        ITEMS - 1,
        longest.as_millis()
    );
    world.end()
}

/// A second one begins at each item of the first one's, on the same line and on another.
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
                assert!(passes < 1_000, "the first one's upload has no end");
                if first.items_sent() == position && second.is_none() {
                    second = Some(Upload::new(link, OTHER, ITEMS, 1_000 + variant));
                }
            }
            let refused = second.and_then(|second| second.result);
            assert!(
                first.result == Some(ACCEPTED) && world.live(variant) == Some(ITEMS),
                "the first: {:?}",
                first.result
            );
            // One that comes with the last item finds the first one gone.
            assert!(refused == Some(DENIED) || position + 1 >= ITEMS, "at item {position} the second: {refused:?}");
            denied += u32::from(refused == Some(DENIED));
        }
    }
    println!(
        "two-gcs: a second one at each of {} items, by the same line and by another: {denied} times denied, the first one's \
              plan live each time",
        ITEMS - 1
    );
    world.end()
}

/// The processor is reset, truly, after each item.
pub fn reset(parts: Parts) -> Parts {
    let position = kept(POSITION) as u16;
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
        keep(POSITION, u32::from(position) + 1);
        Upload::new(COMPANION, STATION, ITEMS, 2).dying_after(position).die(&mut world);
        Board::reset();
    }
    keep(POSITION, 0);
    assert!(upload(&mut world, COMPANION, STATION, ITEMS, 3) == ACCEPTED, "it is in the way of the next");
    println!(
        "reset-in-upload: {} resets of the processor, after 0 to {ITEMS} items: the old plan restored each time",
        ITEMS + 1
    );
    world.end()
}
