//! Bad lines: rules F-4, F-8, F-13.

use super::*;
use mavstack::Duration;
use mavstack_station::Client;
use proptest::prelude::*;

/// The clients that read empty files.
const CLIENTS: [Client; 3] = [Client::QGroundControl, Client::MavProxy, Client::Pymavlink];

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
pub fn run<D: Dialogue>(world: &mut Shelf, transfers: &mut [(usize, Talk<D>)]) -> Duration {
    let begin = world.now();
    let mut left: Vec<usize> = (0..transfers.len()).collect();
    let ended = world.run_until(secs(900), |world| {
        let now = world.now();
        left.retain(|number| {
            let (link, transfer) = &mut transfers[*number];
            let result = transfer.poll(now, &mut world.gcs[*link]);
            if let Some(Err(failure)) = result {
                panic!("{failure}");
            }
            result.is_none()
        });
        assert!(world.vehicle.files.open.len() <= 2, "F-6");
        left.is_empty()
    });
    assert!(ended, "{left:?} do not end");
    world.now() - begin
}

/// How often a user presses the button. Only MAVProxy itself repeats every request: QGroundControl opens a file with one request,
/// pymavlink creates it with one, and MAVSDK fails when the last data of a burst is lost.
fn tries(client: Client) -> u32 {
    if client == Client::MavProxy { 1 } else { 20 }
}

/// A download of such a user.
pub fn download(client: Client, address: Address, path: &str) -> Talk<impl Dialogue<Output = Vec<u8>>> {
    Talk::new(client, address, Again::new(tries(client), move || Download::new(path)))
}

/// An upload likewise.
pub fn upload(client: Client, path: &str, bytes: &[u8]) -> Talk<impl Dialogue<Output = ()>> {
    Talk::new(client, STATION, Again::new(tries(client), move || Upload::new(path, bytes)))
}

/// F-4, F-8: a download and an upload are right with 0, 10 and 20 % loss, duplicates and reordering.
#[test]
fn transfers_survive_loss() {
    for (loss, disorder) in [(0.0, 0.0), (0.1, 0.1), (0.2, 0.1), (0.0, 0.3)] {
        for (seed, client) in (1..3).flat_map(|seed| Client::ALL.map(|client| (seed, client))) {
            let mut world = lossy(line(loss, disorder), seed);
            let content = pattern(9_000 + seed as usize);
            world.vehicle.files.content.insert("big.bin".to_string(), content.clone());
            let mut transfers = [(0, download(client, STATION, "big.bin"))];
            run(&mut world, &mut transfers);
            assert!(*transfers[0].1.output() == content, "{client}, {loss}");
            run(&mut world, &mut [(0, upload(client, "up.bin", &content))]);
            assert!(world.vehicle.files.content["up.bin"] == content, "{client}, {loss}");
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
            let like = [Client::Mavsdk, Client::MavProxy][number / 2];
            (number % 2, download(like, address, names[number]))
        };
        let mut transfers = [client(0), client(1), client(2), client(3)];
        run(&mut world, &mut transfers);
        for (number, (_, transfer)) in transfers.iter().enumerate() {
            assert!(*transfer.output() == pattern(2_000 + number), "client {number}");
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
        client in 0..3usize,
        seed in any::<u64>(),
    ) {
        let mut world = lossy(line(loss, disorder), seed);
        world.vehicle.files.content.insert("any.bin".to_string(), pattern(len));
        let again = Again::new(tries(CLIENTS[client]), || Download::new("any.bin").with_block(block));
        let mut transfers = [(0, Talk::new(CLIENTS[client], STATION, again))];
        run(&mut world, &mut transfers);
        prop_assert!(*transfers[0].1.output() == pattern(len));
    }
}
