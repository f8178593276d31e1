//! Two clients download logs by turns: rules X-3 and LOG-5.

use super::*;
use mavstack::dialect::{Heartbeat, MavCmd};

/// A vehicle with two logs, on links of this rate.
fn two_logs(baud: u32, size: usize, step: u64) -> Field {
    let link = LinkConfig::uart(baud).with_streams(StreamProfile::Off);
    let down = Wire { bytes_per_second: u64::from(baud / 10), tx_fifo: 128, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }; 2];
    with_logs(Setup { links: [link; 2], lines, step: millis(step), ..Setup::new() }, &[size, size])
}

/// Returns how many bytes of a log were received.
fn received(field: &Field, id: u16) -> usize {
    let parts = [0, 1].into_iter().flat_map(|link| all::<LogData>(field, link));
    parts.filter(|part| part.id == id).map(|part| usize::from(part.count)).sum()
}

/// Has both clients send a heartbeat each second.
fn live(field: &mut Field, other_link: usize, seconds: usize) {
    for _ in 0..seconds {
        send(field, 0, STATION, &Heartbeat::default());
        send(field, other_link, OTHER_STATION, &Heartbeat::default());
        field.run_for(secs(1));
    }
}

/// one LOG_REQUEST_DATA and heartbeats kept the logs for as long as they lasted: a second client got 0 bytes in two minutes. Now it
/// is served after the first has got 64 kB, and gets half from then on, on the same link or on another one.
#[test]
fn a_second_client_gets_half() {
    for other_link in [0, 1] {
        let mut field = two_logs(57_600, 1_000_000, 5);
        send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
        field.run_for(millis(100));
        send(&mut field, other_link, OTHER_STATION, &data(1, 0, u32::MAX));
        let mut first = 0;
        for _ in 0..20 {
            live(&mut field, other_link, 1);
            first = received(&field, 0);
            if received(&field, 1) > 0 {
                break;
            }
        }
        assert!((60_000..70_000).contains(&first), "{first} bytes before the second client");
        field.gcs.iter_mut().for_each(|gcs| gcs.forget());
        live(&mut field, other_link, 120);
        let [first, second] = [0, 1].map(|id| received(&field, id));
        println!("{first} and {second} bytes in two minutes");
        let share = second * 100 / (first + second);
        assert!((40..=60).contains(&share), "{share} % of {} bytes", first + second);
        assert!(first + second > 120 * 5_760 * 80 / 109, "{} bytes: the link is used", first + second);
    }
}

/// a client that has had its turn alone gives way at once; and a turn lasts 30 s at most, so that a slow link keeps no fast one.
#[test]
fn a_turn_has_an_end() {
    let mut field = two_logs(9_600, 1_000_000, 5);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    live(&mut field, 1, 5);
    send(&mut field, 1, OTHER_STATION, &data(1, 0, u32::MAX));
    live(&mut field, 1, 20);
    assert_eq!(received(&field, 1), 0);
    live(&mut field, 1, 6);
    assert!(received(&field, 1) > 0);
    send(&mut field, 1, OTHER_STATION, &END);
    live(&mut field, 1, 40);
    field.gcs[1].forget();
    send(&mut field, 1, OTHER_STATION, &data(1, 0, u32::MAX));
    live(&mut field, 1, 1);
    assert!(received(&field, 1) > 0, "the first one has had its turn");
}

/// a download that takes an hour beside another one ends whole, and so does the other one.
#[test]
fn an_hour_beside_a_second_client() {
    const SIZE: usize = 1_400_000;
    let mut field = two_logs(9_600, SIZE, 20);
    field.gcs[0].heartbeat_period = Some(secs(1));
    let fetch = |id| Fetch::new(id).with_patience(secs(60));
    let mut clients =
        [Talk::new(Client::MavProxy, STATION, fetch(0)), Talk::new(Client::Mavsdk, OTHER_STATION, fetch(1))];
    let begin = field.now();
    let ended = field.run_until(secs(5_000), |field| {
        let now = field.now();
        let is_done = clients.each_mut().map(|client| client.poll(now, &mut field.gcs[0]).is_some());
        is_done == [true; 2]
    });
    let seconds = (field.now() - begin).as_millis() / 1_000;
    println!("{seconds} s");
    assert!(ended, "not in {seconds} s");
    assert!(*clients[0].output() == content(0, SIZE) && *clients[1].output() == content(1, SIZE));
    assert!((3_400..4_300).contains(&seconds), "{seconds} s");
}

/// Has a station take control.
fn take_control(field: &mut Field, from: Address) {
    let id = f32::from(from.system.wire());
    let request = field.gcs[0].long(MavCmd(32_100), [1.0, 1.0, 10.0, id, 0.0, 0.0, 0.0]);
    send(field, 0, from, &Gcs::heartbeat());
    send(field, 0, from, &request);
    field.run_for(millis(20));
    assert_eq!(field.stack.operator(field.now()), Some(from.system));
}

/// the one in control is served at once, also while one client is served and another one waits: its requests were refused for as long
/// as the first one was alive (0 of 20). The first one then goes on.
#[test]
fn the_one_in_control_is_served_at_once() {
    let mut field = two_logs(57_600, 20_000, 1);
    take_control(&mut field, OTHER_STATION);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    send(&mut field, 0, Address::new(77, 1), &data(0, 0, u32::MAX));
    field.run_for(millis(500));
    send(&mut field, 1, OTHER_STATION, &data(1, 0, 9_000));
    field.run_for(millis(100));
    assert!(received(&field, 1) > 0);
    live(&mut field, 1, 9);
    assert_eq!([0, 1].map(|id| received(&field, id)), [20_000, 9_000]);
    assert_eq!(field.stack.logs().counters().busy, 0);
}

/// a request for nothing takes no place: it ended the download of a client that waited, which had its turn.
#[test]
fn requests_for_nothing_take_no_place() {
    let mut field = two_logs(57_600, 1_000_000, 5);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    send(&mut field, 1, OTHER_STATION, &data(1, 0, u32::MAX));
    // The first turn ends after 64 kB.
    live(&mut field, 1, 16);
    assert!(received(&field, 1) > 0);
    for nothing in [data(7, 0, 90), data(0, 0, 0)] {
        send(&mut field, 1, Address::new(77, 1), &nothing);
    }
    field.gcs.iter_mut().for_each(|gcs| gcs.forget());
    live(&mut field, 1, 60);
    assert!([0, 1].into_iter().all(|id| received(&field, id) > 60_000));
}

/// LOG-7, X-3: the one in control erases the logs, whoever reads them: its LOG_ERASE was refused. Its LOG_REQUEST_END, which clients send
/// when they connect, ends nothing of others.
#[test]
fn the_one_in_control_erases_at_once() {
    let mut field = two_logs(57_600, 100_000, 1);
    take_control(&mut field, OTHER_STATION);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    send(&mut field, 1, OTHER_STATION, &END);
    live(&mut field, 1, 1);
    assert!(received(&field, 0) > 3_000);
    send(&mut field, 1, OTHER_STATION, &ERASE);
    assert!(field.vehicle.logs.content.is_empty());
    field.run_for(secs(1));
    field.gcs[0].forget();
    live(&mut field, 1, 1);
    assert_eq!(received(&field, 0), 0);
}

/// two strangers that take turns kept a third client out for as long as they were heard (0 bytes in two minutes). Now it takes the
/// place of the one that waits, and all that repeat their requests take turns.
#[test]
fn strangers_keep_no_third_client_out() {
    let mut field = two_logs(57_600, 10_000_000, 5);
    let stranger = Address::new(77, 1);
    for from in [STATION, stranger] {
        send(&mut field, 0, from, &data(0, 0, u32::MAX));
    }
    for second in 0..120 {
        send(&mut field, 0, stranger, &Heartbeat::default());
        if second > 0 {
            send(&mut field, 0, stranger, &data(0, 0, u32::MAX));
        }
        send(&mut field, 1, OTHER_STATION, &data(1, 1_000 * second, u32::MAX));
        live(&mut field, 1, 1);
    }
    let [strangers, third] = [0, 1].map(|id| received(&field, id));
    let share = third * 100 / (strangers + third);
    println!("{share} % for the third client");
    assert!(share >= 30, "{share} %");
}

/// LOG-5: a client that waits and is silent for ten seconds loses its place.
#[test]
fn a_silent_client_does_not_wait() {
    let mut field = two_logs(9_600, 100_000, 5);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    send(&mut field, 0, Address::new(77, 1), &data(0, 0, u32::MAX));
    live(&mut field, 1, 9);
    send(&mut field, 1, OTHER_STATION, &data(1, 0, 90));
    assert_eq!(field.stack.logs().counters().busy, 1);
    live(&mut field, 1, 2);
    send(&mut field, 1, OTHER_STATION, &data(1, 0, 90));
    live(&mut field, 1, 22);
    assert_eq!(received(&field, 1), 90);
    assert_eq!(field.stack.logs().counters().timed_out, 1);
}

/// a transport with a ring of 256 bytes, which is full after each pass, takes bytes. A download over it ended after 10 s.
#[test]
fn a_full_ring_is_not_stalled() {
    for ring in [256, 512] {
        let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
        let down = Wire { bytes_per_second: 1_000_000, tx_fifo: ring, ..Wire::default() };
        let lines = [LineConfig { down, ..LineConfig::default() }; 2];
        let mut field = with_logs(Setup { links: [link; 2], lines, step: millis(10), ..Setup::new() }, &[4_000_000]);
        send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
        for second in 0..20 {
            field.gcs[0].forget();
            live(&mut field, 1, 1);
            assert!(received(&field, 0) > 9_000, "ring of {ring}, {second} s");
        }
    }
}
