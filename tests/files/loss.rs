//! Bad lines: rules F-4, F-8, F-13.

use super::*;
use mavstack::Duration;
use proptest::prelude::*;

/// A line that loses this share of frames, and duplicates and reorders some.
pub fn line(loss: f64, disorder: f64) -> LineConfig {
    let faults = Faults {
        frame_loss: loss,
        frame_duplicate: disorder,
        frame_reorder: disorder,
        reorder_by: millis(40),
        ..Faults::default()
    };
    let wire = Wire { bytes_per_second: 11_520, latency: millis(15), faults, ..Wire::default() };
    LineConfig::both(wire)
}

pub fn lossy(line: LineConfig, seed: u64) -> Shelf {
    let link = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let mut world = Shelf::of(Setup { links: [link; 2], lines: [line; 2], seed, ..Setup::new() });
    world.run_for(millis(100));
    world
}

/// Runs transfers at the same time, each on its link, until all have ended.
pub fn run(world: &mut Shelf, transfers: &mut [(usize, Transfer)]) -> Duration {
    let begin = world.now();
    let mut left: Vec<usize> = (0..transfers.len()).collect();
    let ended = world.run_until(secs(900), |world| {
        let now = world.now();
        left.retain(|number| {
            let (link, transfer) = &mut transfers[*number];
            match transfer.poll(now, &mut world.gcs[*link]) {
                Some(result) => {
                    assert_eq!(result, Ok(()), "{transfer:?}");
                    false
                }
                None => true,
            }
        });
        assert!(world.vehicle.files.open.len() <= 2, "F-6");
        left.is_empty()
    });
    assert!(ended, "{left:?} do not end");
    world.now() - begin
}

/// F-4, F-8: a download and an upload are right with 0, 10 and 20 % loss, duplicates and reordering.
#[test]
fn transfers_survive_loss() {
    for (loss, disorder) in [(0.0, 0.0), (0.1, 0.1), (0.2, 0.1), (0.0, 0.3)] {
        for seed in 1..6 {
            let mut world = lossy(line(loss, disorder), seed);
            let content = pattern(9_000 + seed as usize);
            world.vehicle.files.content.insert("big.bin".to_string(), content.clone());
            let mut transfers = [(0, Transfer::download(STATION, 0, 0, "big.bin"))];
            run(&mut world, &mut transfers);
            assert!(transfers[0].1.content() == content, "{loss}");
            let mut transfers = [(0, Transfer::upload(STATION, 0, 1_000, "up.bin", &content))];
            run(&mut world, &mut transfers);
            assert!(world.vehicle.files.content["up.bin"] == content, "{loss}");
            world.run_for(secs(11));
            assert!(world.vehicle.files.open.is_empty());
        }
    }
}

/// F-6: four clients share two sessions, on two links. Each of them gets its file.
#[test]
fn four_clients_get_their_files() {
    for loss in [0.0, 0.1, 0.2] {
        let mut world = lossy(line(loss, loss / 2.0), 7);
        let names = ["a.bin", "b.bin", "c.bin", "d.bin"];
        for (number, name) in names.iter().enumerate() {
            world.vehicle.files.content.insert((*name).to_string(), pattern(2_000 + number));
        }
        let client = |number: usize| {
            let address = Address::new(200 + (number / 2) as u8, 190);
            (number % 2, Transfer::download(address, number as u8 / 2, 0, names[number]))
        };
        let mut transfers = [client(0), client(1), client(2), client(3)];
        run(&mut world, &mut transfers);
        for (number, (_, transfer)) in transfers.iter().enumerate() {
            assert!(transfer.content() == pattern(2_000 + number), "client {number}");
        }
    }
}

proptest! {
    #![proptest_config(cases(40))]

    /// F-8: under any loss, duplication and reordering, what a client has in the end is the file.
    #[test]
    fn download_equals_the_file(
        loss in 0.0..0.3f64,
        disorder in 0.0..0.3f64,
        len in 0..3_000usize,
        block in 20..240u8,
        seed in any::<u64>(),
    ) {
        let mut world = lossy(line(loss, disorder), seed);
        world.vehicle.files.content.insert("any.bin".to_string(), pattern(len));
        let mut transfer = Transfer::download(STATION, 2, seed as u16, "any.bin");
        transfer.block = block;
        let mut transfers = [(0, transfer)];
        run(&mut world, &mut transfers);
        prop_assert!(transfers[0].1.content() == pattern(len));
    }
}
