//! Who gets logs, and when: rules LOG-5 to LOG-8.

use super::*;
use mavstack::config::LinkClass;
use mavstack::dialect::{Heartbeat, MavCmd};
use mavstack::logs::LogCounters;

/// LOG-6: while the vehicle is armed, logs are neither listed, read nor erased, and one text says so.
#[test]
fn nothing_is_read_in_flight() {
    let mut field = field(&[5_000]);
    set_armed(&mut field, true);
    for _ in 0..3 {
        send(&mut field, 0, STATION, &ALL);
        send(&mut field, 0, STATION, &data(0, 0, 90));
        send(&mut field, 0, STATION, &ERASE);
        field.run_for(millis(200));
    }
    assert_eq!(all::<LogEntry>(&field, 0).len() + all::<LogData>(&field, 0).len(), 0);
    assert_eq!(texts(&field, 0), ["Logs refused: disarm first", "Logs not erased: disarm first"]);
    assert_eq!(field.stack.logs().counters(), counted(|counters: &mut LogCounters| counters.armed = 9));
    set_armed(&mut field, false);
    assert_eq!(answers::<_, LogEntry>(&mut field, &ALL).len(), 1);
    assert_eq!(field.vehicle.logs.content.len(), 1);
}

/// LOG-6: a download ends when the vehicle is armed; if the vehicle lets logs be read in flight, it goes on. They are not erased then.
#[test]
fn arming_ends_a_download() {
    for is_read_in_flight in [false, true] {
        let mut field = field(&[60_000]);
        field.vehicle.logs.is_read_in_flight = is_read_in_flight;
        send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
        field.run_for(millis(50));
        set_armed(&mut field, true);
        field.gcs[0].forget();
        field.run_for(millis(500));
        assert_eq!(all::<LogData>(&field, 0).len() > 50, is_read_in_flight);
        send(&mut field, 0, STATION, &ERASE);
        assert_eq!(field.vehicle.logs.content.len(), 1);
    }
}

/// Flies, and the new log evicts the oldest one.
fn fly(field: &mut Field) {
    set_armed(field, true);
    field.vehicle.logs.content.remove(0);
    field.vehicle.logs.content.push(content(9, 9_000));
    field.run_for(secs(1));
    set_armed(field, false);
}

/// LOG-16, LOG-6: a client that repeats its requests through a flight gets nothing of the log that has its number now, until it has
/// listed the logs again. Each flight has one text for it, and one after it.
#[test]
fn a_flight_ends_what_was_listed() {
    for kind in [Client::Mavsdk, Client::QGroundControl, Client::MavProxy] {
        let mut field = field(&[60_000, 60_000]);
        let mut client = Talk::new(kind, STATION, Fetch::new(0).with_patience(secs(100)));
        let mut run = |field: &mut Field, duration| {
            let (end, mut is_done) = (field.now() + duration, false);
            field.run_until(secs(60), |field| {
                let now = field.now();
                is_done |= client.poll(now, &mut field.gcs[0]).is_some();
                is_done || now >= end
            });
            is_done
        };
        assert!(!run(&mut field, millis(300)));
        for _ in 0..2 {
            set_armed(&mut field, true);
            field.gcs[0].forget();
            field.vehicle.logs.content.remove(0);
            field.vehicle.logs.content.push(content(9, 60_000));
            run(&mut field, secs(20));
            set_armed(&mut field, false);
            run(&mut field, secs(20));
            assert_eq!(parts(&all(&field, 0)), [], "{kind:?}");
            let expected = ["Logs refused: disarm first", "Logs refused: list them again first"];
            assert_eq!(texts(&field, 0), expected, "{kind:?}");
        }
        assert!(field.stack.logs().counters().outdated > 40);
        assert_eq!(answers::<_, LogEntry>(&mut field, &ALL).len(), 2);
        let sent: Vec<LogData> = answers(&mut field, &data(1, 0, 90));
        assert_eq!(sent[0].data[..], content(9, 60_000)[..90]);
    }
}

/// LOG-16: before the first flight nothing has to be listed. After one, each client lists for itself, and they do not disturb each
/// other; nor does a refused one disturb a client that is served.
#[test]
fn each_client_lists_for_itself() {
    let mut field = field(&[9_000, 9_000]);
    assert_eq!(parts(&answers(&mut field, &data(0, 0, 90))), [(0, 90)]);
    fly(&mut field);
    let others = [(1, STATION), (0, OTHER_STATION), (1, OTHER_STATION), (1, Address::new(253, 190))];
    for (link, from) in others {
        send(&mut field, link, from, &ALL);
        field.run_for(millis(50));
    }
    assert_eq!(answers::<_, LogData>(&mut field, &data(0, 0, 90)), []);
    for (link, from) in others {
        field.gcs[link].forget();
        send(&mut field, link, from, &data(0, 0, 180));
        send(&mut field, 0, STATION, &data(0, 0, 90));
        field.run_for(millis(50));
        assert_eq!(parts(&all(&field, link)), [(0, 90), (90, 90)], "{link} {from:?}");
    }
    assert_eq!(field.stack.logs().counters().outdated, 5);
}

/// LOG-16, LOG-7: the same after an erasure by another client, when a new log has the number. One that was refused changes nothing.
#[test]
fn an_erasure_ends_what_was_listed() {
    let mut field = field(&[9_000]);
    assert_eq!(answers::<_, LogEntry>(&mut field, &ALL).len(), 1);
    field.vehicle.logs.owner = Some(STATION);
    send(&mut field, 1, OTHER_STATION, &ERASE);
    assert_eq!(parts(&answers(&mut field, &data(0, 0, 90))), [(0, 90)]);
    field.vehicle.logs.owner = None;
    send(&mut field, 1, OTHER_STATION, &ERASE);
    field.vehicle.logs.content = vec![content(7, 9_000)];
    assert_eq!(answers::<_, LogData>(&mut field, &data(0, 90, 90)), []);
    assert_eq!(answers::<_, LogEntry>(&mut field, &ALL).len(), 1);
    assert_eq!(parts(&answers(&mut field, &data(0, 90, 90))), [(90, 90)]);
}

/// LOG-7: an authorised client erases all logs. A text has the result, and the next list is empty.
#[test]
fn logs_are_erased() {
    let mut field = field(&[9_000, 90]);
    field.vehicle.logs.owner = Some(OTHER_STATION);
    send(&mut field, 0, STATION, &ERASE);
    field.run_for(millis(50));
    assert_eq!(texts(&field, 0), ["Logs not erased"]);
    field.vehicle.logs.owner = None;
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    send(&mut field, 0, STATION, &ERASE);
    assert_eq!(answers::<_, LogEntry>(&mut field, &ALL), [LogEntry::default()]);
    assert_eq!(texts(&field, 0), ["Logs erased"]);
    assert_eq!(all::<LogData>(&field, 0).len(), 0, "the download has ended");
}

/// LOG-7, O-5: a ground station that is not in control erases nothing, but it may read.
#[test]
fn only_the_operator_in_control_erases() {
    let mut field = field(&[90]);
    let request = field.gcs[0].long(MavCmd(32_100), [1.0, 1.0, 10.0, 254.0, 0.0, 0.0, 0.0]);
    send(&mut field, 0, OTHER_STATION, &Gcs::heartbeat());
    send(&mut field, 0, OTHER_STATION, &request);
    field.run_for(millis(20));
    send(&mut field, 0, STATION, &ERASE);
    assert_eq!(field.vehicle.logs.content.len(), 1);
    assert_eq!(field.stack.operator_control().counters().messages, 1);
    assert_eq!(answers::<_, LogEntry>(&mut field, &ALL).len(), 1);
    field.run_for(secs(4));
    send(&mut field, 0, OTHER_STATION, &ERASE);
    assert_eq!(field.vehicle.logs.content.len(), 0);
}

/// LOG-7: a broadcast has no effect: it is meant for no vehicle in particular.
#[test]
fn a_broadcast_has_no_effect() {
    let mut field = field(&[90]);
    send(&mut field, 0, STATION, &LogErase { target_system: 0, ..ERASE });
    assert_eq!(field.vehicle.logs.content.len(), 1);
    assert_eq!(answers::<_, LogEntry>(&mut field, &LogRequestList { target_system: 0, ..ALL }), []);
    assert_eq!(answers::<_, LogData>(&mut field, &LogRequestData { target_system: 0, ..data(0, 0, 90) }), []);
}

/// LOG-5, X-3: while one client is served, a second one waits, and gets what it requested last when the first one has all of its own.
/// Others are refused, and one text says so. LOG_REQUEST_END ends nothing of other clients.
#[test]
fn one_client_at_a_time() {
    let mut field = field(&[90_000]);
    send(&mut field, 0, STATION, &data(0, 0, 45_000));
    field.run_for(millis(100));
    for (link, from) in [(1, STATION), (0, OTHER_STATION), (1, OTHER_STATION)] {
        send(&mut field, link, from, &END);
        send(&mut field, link, from, &ALL);
        send(&mut field, link, from, &data(0, 45_000, 180));
        send(&mut field, link, from, &ERASE);
    }
    field.run_for(millis(300));
    assert!(all::<LogData>(&field, 1).is_empty(), "it waits");
    field.run_for(millis(1_200));
    let sent = parts(&all(&field, 0));
    assert_eq!(sent, (0..500).map(|block| (block * 90, 90)).collect::<Vec<_>>());
    let expected = ["Logs not erased: a client reads one", "Logs refused: other clients read them"];
    assert_eq!(texts(&field, 0), expected);
    let counters = field.stack.logs().counters();
    assert_eq!(counters.busy, 7, "three erasures, and four requests of two clients");
    assert_eq!(counters.requests, 2, "only what was accepted");
    assert!(all::<LogEntry>(&field, 0).is_empty() && all::<LogEntry>(&field, 1).is_empty());
    assert_eq!(parts(&all(&field, 1)), [(45_000, 90), (45_090, 90)]);

    send(&mut field, 1, OTHER_STATION, &data(0, 0, u32::MAX));
    field.run_for(millis(20));
    assert_eq!(parts(&all(&field, 1))[2], (0, 90));
    assert_eq!(answers::<_, LogData>(&mut field, &data(0, 90, 90)), []);
    send(&mut field, 1, OTHER_STATION, &END);
    field.run_for(millis(300));
    assert_eq!(parts(&all(&field, 0)), [(90, 90)]);
}

/// LOG-5: what was requested ends ten seconds after its client was last heard. A client that sends heartbeats is alive.
#[test]
fn a_dead_client_is_not_served() {
    for lives in [false, true] {
        let link = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
        let down = Wire { bytes_per_second: 5_760, tx_fifo: 128, ..Wire::default() };
        let lines = [LineConfig { down, ..LineConfig::default() }; 2];
        let mut field = with_logs(Setup { links: [link; 2], lines, ..Setup::new() }, &[1_000_000]);
        send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
        for _ in 0..15 {
            field.run_for(secs(1));
            if lives {
                send(&mut field, 0, STATION, &Heartbeat::default());
            }
            // Others prove nothing.
            send(&mut field, 0, OTHER_STATION, &Heartbeat::default());
            send(&mut field, 1, STATION, &Heartbeat::default());
        }
        field.gcs[0].forget();
        field.run_for(secs(1));
        assert_eq!(all::<LogData>(&field, 0).len() > 20, lives);
        assert_eq!(field.stack.logs().counters().timed_out, u32::from(!lives));
    }
}

/// LOG-5: a link that was opened again has other clients, which do not wait.
#[test]
fn a_restarted_link_is_free() {
    let mut field = field(&[90_000]);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    field.run_for(millis(20));
    field.stack.restart_link(LinkId(0));
    field.gcs[0].forget();
    field.run_for(millis(200));
    assert!(all::<LogData>(&field, 0).len() <= 1);
    send(&mut field, 1, OTHER_STATION, &data(0, 0, 90));
    field.run_for(millis(20));
    assert_eq!(parts(&all(&field, 1)), [(0, 90)]);
}

/// LOG-8, L-4: a high-latency link carries no logs.
#[test]
fn satellites_carry_no_logs() {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut field = with_logs(Setup { links: [satellite; 2], ..Setup::new() }, &[90]);
    for _ in 0..3 {
        send(&mut field, 0, STATION, &ALL);
        send(&mut field, 0, STATION, &data(0, 0, 90));
        send(&mut field, 0, STATION, &ERASE);
        field.run_for(millis(100));
    }
    assert!(field.gcs[0].received.is_empty());
    assert_eq!(field.vehicle.logs.content.len(), 1);
}

/// a client on a link that takes no bytes kept the logs for as long as its heartbeats were received, and another client's 20
/// requests were refused. Now they are read on a living link after ten seconds.
#[test]
fn dead_link_holds_no_logs() {
    let mut field = field(&[60_000]);
    field.uarts[0].stall_writes_until(mavstack::Instant::NEVER);
    field.run_for(millis(50));
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    let served = (0..20).find(|_| {
        send(&mut field, 0, STATION, &Gcs::heartbeat());
        send(&mut field, 1, OTHER_STATION, &data(0, 0, 90));
        field.run_for(secs(1));
        !all::<LogData>(&field, 1).is_empty()
    });
    assert!(served.is_some_and(|second| second <= 11), "{served:?}");
}
