//! The speed of plan transfers: what a line permits, and what the vehicle adds.
//!
//! A plan transfer is half-duplex: each request waits for the previous item and each item for its request. The minimum per item
//! is therefore the transmission time of request and item, plus twice the latency; the simulated client needs no time. The rest
//! is the vehicle's: it sees a message at its next poll, up to a period later, and must answer in that poll.

use crate::support::*;
use mavstack::dialect::{MavMissionType, MissionCount, MissionItemInt, MissionRequestInt, MissionRequestList};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::{Duration, LinkConfig, Message, plan_memory};

type Plans = Tested<plan_memory!(mission: 500)>;
type TestWorld = World<1, Plans>;

/// The vehicle's poll period.
const PERIOD: Duration = millis(1);

/// A line, and the same values in the vehicle's configuration.
#[derive(Clone, Copy)]
struct Line {
    baud: u32,
    latency: Duration,
}

impl Line {
    fn world(self) -> TestWorld {
        let lines = [LineConfig::radio(self.baud, self.latency)];
        World::of(Setup { links: [LinkConfig::uart(self.baud)], lines, step: PERIOD, ..Setup::new() })
    }

    /// Returns the time from the first byte of a message until its last byte arrives (µs).
    fn micros_of<M: Message>(self, message: &M) -> u64 {
        let len = encode(message, Version::V2, VEHICLE, 0, &mut [0; MAX_FRAME_LEN]).expect("every message fits");
        len as u64 * (1_000_000 / (u64::from(self.baud) / 10)) + self.latency.as_micros()
    }

    /// Returns the time in transit of the items and their requests (µs).
    fn micros_of_items(self, items: &[MissionItemInt]) -> u64 {
        let request = |item: &MissionItemInt| MissionRequestInt {
            seq: item.seq,
            target_system: STATION.system.wire(),
            target_component: STATION.component.wire(),
            mission_type: item.mission_type,
        };
        items.iter().map(|item| self.micros_of(&request(item)) + self.micros_of(item)).sum()
    }
}

/// Polls the vehicle once in each [`PERIOD`] and the client whenever a byte arrives, until `poll`, the client, is done. Returns
/// the duration.
fn run(world: &mut TestWorld, mut poll: impl FnMut(&mut TestWorld) -> bool) -> Duration {
    let began = world.now();
    let mut next_pass = began;
    loop {
        let now = world.gcs[0].end.next_arrival().max(world.now()).min(next_pass);
        if now == next_pass {
            world.step_to(now);
            next_pass += PERIOD;
        }
        world.clock.set(now);
        // Receives, then sends.
        world.gcs[0].poll(now);
        let is_done = poll(world);
        world.gcs[0].poll(now);
        if is_done {
            return now - began;
        }
    }
}

fn upload(world: &mut TestWorld, items: &[MissionItemInt]) -> Duration {
    let mut upload = Upload::new(&world.gcs[0], items);
    let took = run(world, |world| upload.poll(world.now(), &mut world.gcs[0]).is_some());
    upload.result().expect("an end").expect("accepted");
    took
}

fn download(world: &mut TestWorld) -> (Vec<MissionItemInt>, Duration) {
    let mut download = Download::new(&world.gcs[0], MavMissionType::MISSION);
    let took = run(world, |world| download.poll(world.now(), &mut world.gcs[0]).is_some());
    (download.result().expect("an end").expect("complete"), took)
}

/// Returns how much longer a transfer took than its frames were in transit (µs).
fn added(took: Duration, physical: u64) -> u64 {
    let added = took.as_micros().checked_sub(physical);
    added.unwrap_or_else(|| panic!("{} µs are less than the line allows: {physical} µs", took.as_micros()))
}

/// Beside the transfer, heartbeats and MISSION_CURRENT are sent once a second each. The wait for the next poll is half a period
/// per item on average.
#[test]
fn download_uses_nine_tenths_of_a_telemetry_radio() {
    let line = Line { baud: 57_600, latency: Duration::ZERO };
    let mut world = line.world();
    upload(&mut world, &plan(100, 1));
    let (items, took) = download(&mut world);
    assert_eq!(items.len(), 100);
    let list = MissionRequestList { target_system: 1, target_component: 1, ..Default::default() };
    let count = MissionCount { count: 100, target_system: 1, target_component: 1, opaque_id: !0, ..Default::default() };
    let physical = line.micros_of(&list) + line.micros_of(&count) + line.micros_of_items(&items);
    let share = 100.0 * physical as f64 / took.as_micros() as f64;
    println!("{share:.1} %: {} ms, of which {} ms in transit", took.as_millis(), physical / 1_000);
    assert!((90.0..=100.0).contains(&share), "{share:.1} %");
}

/// On slow, fast and distant links the vehicle adds less than a poll period per item: every message is answered in the first
/// poll that sees it.
#[test]
fn vehicle_adds_less_than_a_poll_period_per_item() {
    for (baud, latency) in [(57_600, millis(0)), (57_600, millis(40)), (921_600, millis(0)), (10_000_000, millis(3))] {
        let line = Line { baud, latency };
        let mut world = line.world();
        let items = plan(500, 1);
        let physical = line.micros_of_items(&items);
        let uploaded = upload(&mut world, &items);
        let (_, downloaded) = download(&mut world);
        for (way, took) in [("up", uploaded), ("down", downloaded)] {
            let added = added(took, physical);
            let rate = 500.0 / (took.as_micros() as f64 / 1e6);
            println!(
                "{baud} bit/s, {} ms: {way} {rate:.0} items/s, {} µs added each",
                latency.as_millis(),
                added / 500
            );
            assert!(added < 500 * PERIOD.as_micros(), "{baud} bit/s, {way}: {added} µs");
        }
    }
}
