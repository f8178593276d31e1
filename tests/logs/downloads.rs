//! Whole downloads, over bad lines: rules LOG-3, LOG-4, LOG-5.

use super::*;
use proptest::prelude::*;

const CLIENTS: [Client; 3] = [Client::Mavsdk, Client::QGroundControl, Client::MavProxy];

/// A vehicle with a log on lines that lose this share of frames, and duplicate and reorder some.
fn lossy(loss: f64, disorder: f64, seed: u64, sizes: &[usize]) -> Field {
    let faults = Faults {
        frame_loss: loss,
        frame_duplicate: disorder,
        frame_reorder: disorder,
        reorder_by: millis(40),
        ..Faults::default()
    };
    let wire = Wire { bytes_per_second: 11_520, latency: millis(15), faults, ..Wire::default() };
    let link = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let mut field =
        with_logs(Setup { links: [link; 2], lines: [LineConfig::both(wire); 2], seed, ..Setup::new() }, sizes);
    for gcs in &mut field.gcs {
        gcs.heartbeat_period = Some(secs(1));
    }
    field
}

/// Runs clients at the same time, each on its link, until all have ended. Returns the milliseconds that it took.
fn run(field: &mut Field, clients: &mut [(usize, Talk<Fetch>)]) -> u64 {
    let begin = field.now();
    let ended = field.run_until(secs(3_000), |field| {
        let now = field.now();
        let mut is_done = true;
        for (link, client) in clients.iter_mut() {
            is_done &= client.poll(now, &mut field.gcs[*link]).is_some();
        }
        is_done
    });
    assert!(ended, "{clients:?}");
    (field.now() - begin).as_millis()
}

/// LOG-3, LOG-4: each client downloads a log with 0, 10 and 20 % loss, and with duplicates and reordering.
#[test]
fn downloads_survive_loss() {
    for (loss, disorder) in [(0.0, 0.0), (0.1, 0.0), (0.2, 0.0), (0.1, 0.1)] {
        for client in CLIENTS {
            let sizes = [1_000, 60_000, 900];
            let mut field = lossy(loss, disorder, 3, &sizes);
            let mut clients = [(0, Talk::new(client, STATION, Fetch::new(1)))];
            let ms = run(&mut field, &mut clients);
            let talk = &clients[0].1;
            println!("{client}, {loss} lost, {disorder} disordered: {ms} ms");
            assert!(*talk.output() == content(1, 60_000), "{client}");
            assert_eq!(talk.dialogue.logs.iter().map(|log| log.size as usize).collect::<Vec<_>>(), sizes);
            // MAVSDK waits half a second for each gap if the last block of a chunk was lost, and MAVProxy 0.7 s.
            let limit = if client == Client::QGroundControl { 60 } else { 150 };
            assert!(ms < limit * 1_000, "{client}: {ms} ms");
            if loss + disorder == 0.0 {
                // 60,000 bytes in frames of 109 bytes, for 90 each.
                assert!(ms < 8_500, "{client}: {ms} ms");
            }
        }
    }
}

/// LOG-5: two clients get their logs one after the other, on one link or on two; so does one whose predecessor died.
#[test]
fn two_clients_take_turns() {
    for loss in [0.0, 0.1, 0.2] {
        for other_link in [0, 1] {
            let mut field = lossy(loss, loss / 2.0, 5, &[70_000, 8_000]);
            field.gcs[other_link].heartbeat_period = None;
            let mut clients = [
                (0, Talk::new(Client::Mavsdk, STATION, Fetch::new(0))),
                (other_link, Talk::new(Client::QGroundControl, OTHER_STATION, Fetch::new(1))),
            ];
            run(&mut field, &mut clients);
            assert!(*clients[0].1.output() == content(0, 70_000));
            assert!(*clients[1].1.output() == content(1, 8_000));
        }
    }
    let mut field = lossy(0.0, 0.0, 7, &[1_000_000, 8_000]);
    field.gcs[0].heartbeat_period = None;
    field.gcs[0].send_from(OTHER_STATION, &data(0, 0, u32::MAX));
    field.run_for(secs(2));
    let mut clients = [(0, Talk::new(Client::QGroundControl, STATION, Fetch::new(1)))];
    let ms = run(&mut field, &mut clients);
    assert!(*clients[0].1.output() == content(1, 8_000));
    assert!((6_000..16_000).contains(&ms), "{ms} ms");
}

/// LOG-5, X-3: a download that takes an hour of a slow link is whole, though another client lists the logs and requests a part each
/// minute. Heartbeats alone say that the client is there.
#[test]
fn download_of_an_hour() {
    const SIZE: usize = 255_000;
    let link = LinkConfig::uart(1_200).with_streams(StreamProfile::Off);
    let lines = [LineConfig::radio(1_200, millis(50)), LineConfig::default()];
    let mut field = with_logs(Setup { links: [link; 2], lines, step: millis(100), ..Setup::new() }, &[SIZE, 200]);
    field.gcs.iter_mut().for_each(|gcs| gcs.heartbeat_period = Some(secs(5)));
    field.gcs[1].address = OTHER_STATION;
    field.gcs[0].send(&ALL);
    field.run_for(secs(2));
    let (mut log, mut silent) = (Vec::<u8>::new(), 100);
    while log.len() < SIZE && field.now() < mavstack::Instant::from_millis(4_500_000) {
        if silent >= 100 {
            field.gcs[0].send(&data(0, log.len() as u32, u32::MAX));
            silent = 0;
        }
        if field.now().as_millis().is_multiple_of(60_000) {
            field.gcs[1].send(&ALL);
            field.gcs[1].send(&data(1, 0, u32::MAX));
        }
        field.step();
        silent += 1;
        while let Some((_, block)) = field.gcs[0].take::<LogData>() {
            silent = 0;
            if block.ofs as usize == log.len() {
                log.extend(&block.data[..usize::from(block.count)]);
            }
        }
        field.gcs[0].forget();
    }
    assert!(log == content(0, SIZE), "{} bytes", log.len());
    assert!((3_300..4_500).contains(&(field.now().as_millis() / 1_000)), "{:?}", field.now());
}

proptest! {
    #![proptest_config(cases(40))]

    /// LOG-3, LOG-4: under any loss, duplication and reordering, each byte that a client has is the log's.
    #[test]
    fn every_downloaded_byte_is_the_logs(
        loss in 0.0..0.3f64,
        disorder in 0.0..0.3f64,
        sizes in prop::collection::vec(0..4_000usize, 1..4),
        whole in any::<bool>(),
        client in 0..3usize,
        seed in any::<u64>(),
    ) {
        let sizes: Vec<usize> = sizes.iter().map(|size| if whole { size / 90 * 90 } else { *size }).collect();
        let id = seed as usize % sizes.len();
        let mut field = lossy(loss, disorder, seed, &sizes);
        let mut clients = [(0, Talk::new(CLIENTS[client], STATION, Fetch::new(id as u16)))];
        run(&mut field, &mut clients);
        prop_assert!(*clients[0].1.output() == content(id, sizes[id]));
    }

    /// LOG-3: whatever is requested, each LOG_DATA has bytes of the log, inside of what was requested, and in order.
    #[test]
    fn any_part_is_answered_with_its_bytes(len in 0..2_000usize, ofs in 0..2_100u32, count in 0..2_100u32) {
        let mut field = field(&[len]);
        let sent: Vec<LogData> = answers(&mut field, &data(0, ofs, count));
        let end = (ofs as usize + count as usize).min(len);
        let mut at = ofs as usize;
        for part in &sent {
            prop_assert_eq!(part.ofs as usize, at);
            prop_assert_eq!(&part.data[..usize::from(part.count)], &content(0, len)[at.min(len)..][..usize::from(part.count)]);
            at += usize::from(part.count);
        }
        prop_assert_eq!(at, end.max(ofs as usize));
        prop_assert_eq!(sent.iter().any(|part| part.count == 0), ofs as usize >= len);
    }
}
