//! How much of a link a burst uses, and what it must not delay: rules D-4, F-8, F-11, H-15, P-11.

use super::*;
use mavstack::dialect::{Attitude, GlobalPositionInt, Heartbeat, MavCmd, SysStatus};
use mavstack::{Instant, Message};

fn world_at(baud: u32) -> Shelf {
    let link = LinkConfig::uart(baud).with_streams(StreamProfile::Off);
    let mut line = LineConfig::radio(baud, millis(10));
    line.down.tx_fifo = 256;
    let mut world = Shelf::of(Setup { links: [link; 2], lines: [line; 2], ..Setup::new() });
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(100_000));
    world.run_for(millis(1_500));
    world
}

/// The largest time between two heartbeats.
fn gap_between_heartbeats(world: &Shelf) -> u64 {
    let beats: Vec<Instant> = world.gcs[0].all::<Heartbeat>().iter().map(|(at, _)| *at).collect();
    beats.windows(2).map(|pair| (pair[1] - pair[0]).as_millis()).max().unwrap_or(0)
}

/// F-8, H-15: a burst uses at least 90 % of an idle link, and heartbeats are not late.
#[test]
fn burst_uses_the_link() {
    for (baud, longest) in [(57_600u32, 1_090), (921_600, 1_030)] {
        let mut world = world_at(baud);
        world.gcs[0].forget();
        let begin = world.now();
        let mut transfer = Talk::new(mavstack_station::Client::QGroundControl, STATION, Download::new("big.bin"));
        let ended = world.run_until(secs(60), |world| {
            let now = world.now();
            transfer.poll(now, &mut world.gcs[0]).is_some()
        });
        assert!(ended && *transfer.output() == pattern(100_000));
        let micros = (world.now() - begin).as_micros();
        let sent: usize = world.gcs[0].received.iter().map(|frame| frame.raw.len()).sum();
        let share = sent as u64 * 100 * 1_000_000 / micros / u64::from(baud / 10);
        println!("{baud} baud: 100 kB in {} ms, {share} % of the line", micros / 1_000);
        assert!(share >= 90, "{baud}: {share} %");
        world.run_for(secs(2));
        let gap = gap_between_heartbeats(&world);
        assert!(gap <= longest, "{baud}: {gap} ms between heartbeats");
    }
}

/// D-4: a mission is uploaded beside a burst in hardly more time than without it.
#[test]
fn burst_does_not_delay_a_mission() {
    let time = |with_burst: bool| {
        let mut world = world_at(57_600);
        if with_burst {
            let mut client = Client::new(OTHER_STATION, 0, 4);
            client.open(&mut world, "big.bin").unwrap();
            client.send(&mut world, &request(40, 4, MavFtpOpcode::BURSTREADFILE, 239, 0, &[]));
        }
        let begin = world.now();
        let items = plan(20, 0);
        world.upload(0, &items).unwrap();
        (world.now() - begin).as_millis()
    };
    let (alone, beside) = (time(false), time(true));
    println!("20 items at 57,600 baud: {alone} ms alone, {beside} ms beside a burst");
    // Each item waits for one packet on the line, and for what is queued.
    assert!(beside <= alone + 21 * 70, "{alone} ms alone, {beside} ms beside a burst");
}

/// D-4, P-11: on a link that streams fill, a burst still has about 30 % of the rate, and the streams have the rest.
#[test]
fn burst_keeps_its_share_beside_streams() {
    for step in [1, 20] {
        let link = LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard);
        let down = Wire { bytes_per_second: 5_760, tx_fifo: 512, ..Wire::default() };
        let lines = [LineConfig { down, ..LineConfig::default() }; 2];
        let mut world = Shelf::of(Setup { links: [link; 2], lines, step: millis(step), ..Setup::new() });
        world.vehicle.files.content.insert("big.bin".to_string(), pattern(100_000));
        for id in [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID] {
            world.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
            world.run_for(millis(200));
        }
        let mut client = client();
        let open = request(1, 0, MavFtpOpcode::OPENFILERO, 7, 0, b"big.bin");
        client.send(&mut world, &open);
        world.run_for(millis(1_000));
        client.seq = 2;
        client.send(&mut world, &request(2, 0, MavFtpOpcode::BURSTREADFILE, 239, 0, &[]));
        world.gcs[0].forget();
        world.run_for(secs(4));
        let bytes = |is_file: bool| -> usize {
            let frames = world.gcs[0].received.iter();
            frames
                .filter(|frame| (frame.header.id == FileTransferProtocol::ID) == is_file)
                .map(|frame| frame.raw.len())
                .sum()
        };
        let share = |bytes: usize| bytes * 100 / (4 * 5_760);
        let (file, rest) = (share(bytes(true)), share(bytes(false)));
        assert!((25..=40).contains(&file), "polls {step} ms apart: {file} % for the file");
        assert!(rest >= 50, "polls {step} ms apart: {rest} % for the streams");
    }
}

/// F-11: while a client is busy with an open file, streams on its link are sent a quarter as often. Heartbeats and the streams of
/// other links are not slowed. When the file is closed, or the client was silent for three seconds, the streams are as fast as before.
#[test]
fn transfer_slows_streams_of_its_link() {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let mut world = Shelf::of(Setup { links: [link; 2], ..Setup::new() });
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(100_000));
    world.run_for(millis(1_500));
    for link in 0..2 {
        world.gcs[link]
            .command_long(MavCmd::SET_MESSAGE_INTERVAL, [Attitude::ID as f32, 50_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
    world.run_for(secs(1));
    // Counts the messages on each link, and the heartbeats on the first one, in two seconds. Every 200 ms the client reads.
    let count = |world: &mut Shelf, mut reader: Option<&mut Client>| {
        world.run_for(millis(300));
        let (mut counts, mut beats) = ([0; 2], 0);
        for _ in 0..10 {
            if let Some(client) = reader.as_deref_mut() {
                client.read(world, 0, 100).unwrap();
            }
            world.gcs.iter_mut().for_each(|gcs| gcs.forget());
            world.run_for(millis(200));
            beats += world.gcs[0].all::<Heartbeat>().len();
            counts = [0, 1].map(|link| counts[link] + world.gcs[link].all::<Attitude>().len());
        }
        (counts, beats)
    };
    let is_full = |count: usize| (39..=41).contains(&count);
    let is_slow = |count: usize| (9..=11).contains(&count);

    let (counts, _) = count(&mut world, None);
    assert!(counts.into_iter().all(is_full), "before: {counts:?}");
    let mut client = client();
    client.open(&mut world, "big.bin").unwrap();
    let (counts, beats) = count(&mut world, Some(&mut client));
    assert!(is_slow(counts[0]) && is_full(counts[1]), "with an open file: {counts:?}");
    assert!((1..=3).contains(&beats), "{beats} heartbeats in 2.5 s");
    world.run_for(millis(3_000));
    let (counts, _) = count(&mut world, None);
    assert!(counts.into_iter().all(is_full), "the client is silent: {counts:?}");
    let (counts, _) = count(&mut world, Some(&mut client));
    assert!(is_slow(counts[0]), "the client reads again: {counts:?}");
    client.end(&mut world).unwrap();
    let (counts, _) = count(&mut world, None);
    assert!(counts.into_iter().all(is_full), "closed: {counts:?}");
}
