//! The running log, streamed: rules LOG-10 to LOG-14.

use super::*;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::{
    Attitude, CommandAck, GlobalPositionInt, Heartbeat, LoggingAck, LoggingData, LoggingDataAcked, MavCmd, MavResult,
    SysStatus,
};
use mavstack::logs::StreamingCounters;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// Returns a message of a log, with this much content.
fn message(kind: u8, len: usize) -> Vec<u8> {
    let mut bytes = (len as u16).to_le_bytes().to_vec();
    bytes.push(kind);
    bytes.extend((0..len).map(|i| (i * 7) as u8));
    bytes
}

/// Returns the header and the definitions of a log.
fn definitions(sizes: &[usize]) -> Vec<u8> {
    let mut bytes = b"ULog\x01\x12\x35\x01\0\0\0\0\0\0\0\0".to_vec();
    sizes.iter().for_each(|len| bytes.extend(message(b'F', *len)));
    bytes
}

/// A vehicle with a running log.
fn streaming(link: LinkConfig, line: LineConfig, seed: u64) -> Field {
    let mut field = with_logs(Setup { links: [link; 2], lines: [line; 2], seed, ..Setup::new() }, &[]);
    field.vehicle.logs.definitions = definitions(&[40, 200, 300, 0, 77]);
    field
}

fn ideal() -> Field {
    streaming(LinkConfig::uart(921_600).with_streams(StreamProfile::Off), LineConfig::default(), 1)
}

/// Sends a command now, and returns its result.
fn command(field: &mut Field, link: usize, from: Address, id: MavCmd, param1: f32) -> MavResult {
    let message = field.gcs[link].long(id, [param1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let before = all::<CommandAck>(field, link).len();
    send(field, link, from, &message);
    field.run_for(millis(10));
    let acks = all::<CommandAck>(field, link);
    assert_eq!(acks.len(), before + 1);
    acks[before].result
}

fn start(field: &mut Field, link: usize, from: Address) -> MavResult {
    command(field, link, from, MavCmd::LOGGING_START, 0.0)
}

fn stop(field: &mut Field, link: usize, from: Address) -> MavResult {
    command(field, link, from, MavCmd::LOGGING_STOP, 0.0)
}

/// A client of a stream: the packets by sequence number, with the first message of each.
#[derive(Debug, Default)]
struct Client {
    packets: BTreeMap<u16, (u8, Vec<u8>)>,
    seen: usize,
    /// So many packets with definitions are not acknowledged.
    ignored: usize,
}

impl Client {
    /// Takes what was received on the first link, and acknowledges it.
    fn poll(&mut self, gcs: &mut Gcs) {
        while let Some(frame) = gcs.received.get(self.seen).cloned() {
            self.seen += 1;
            let packet = frame.decode::<LoggingData>();
            let acked = frame.decode::<LoggingDataAcked>();
            let (sequence, first, len, data) = match (packet, acked) {
                (Some(packet), _) => (packet.sequence, packet.first_message_offset, packet.length, packet.data),
                (_, Some(acked)) => {
                    if self.ignored > 0 {
                        self.ignored -= 1;
                        continue;
                    }
                    let sequence = acked.sequence;
                    gcs.send(&LoggingAck { sequence, target_system: 1, target_component: 1 });
                    (acked.sequence, acked.first_message_offset, acked.length, acked.data)
                }
                _ => continue,
            };
            let packet = (first, data[..usize::from(len)].to_vec());
            assert!(*self.packets.entry(sequence).or_insert_with(|| packet.clone()) == packet, "{sequence}");
        }
    }

    /// Returns all bytes, if no packet is missing.
    fn content(&self) -> Vec<u8> {
        assert!(self.packets.keys().enumerate().all(|(index, sequence)| index == usize::from(*sequence)));
        self.packets.values().flat_map(|(_, bytes)| bytes.clone()).collect()
    }
}

fn run(field: &mut Field, client: &mut Client, millis: u64) {
    for _ in 0..millis {
        field.step();
        client.poll(&mut field.gcs[0]);
    }
}

/// Returns where the messages of a log begin, its header first.
fn beginnings(log: &[u8]) -> Vec<usize> {
    let (mut found, mut at) = (vec![0], 16);
    while at + 2 < log.len() {
        found.push(at);
        at += 3 + usize::from(u16::from_le_bytes([log[at], log[at + 1]]));
    }
    found
}

/// Checks that each packet names the first message that begins in it.
fn check_beginnings(client: &Client, log: &[u8]) {
    let beginnings = beginnings(log);
    let mut at = 0;
    for (sequence, (first, bytes)) in &client.packets {
        let range = at..at + bytes.len();
        let expected = beginnings.iter().find(|begin| range.contains(*begin)).map_or(255, |begin| begin - at);
        assert_eq!(usize::from(*first), expected, "packet {sequence}");
        at = range.end;
    }
}

/// LOG-10, LOG-11, LOG-12: the definitions come first, then the data as it is recorded, in packets with consecutive numbers. Each
/// names the first message that begins in it.
#[test]
fn a_log_is_streamed() {
    let mut field = ideal();
    let mut client = Client::default();
    assert_eq!(start(&mut field, 0, STATION), MavResult::ACCEPTED);
    assert!(field.stack.log_streaming.is_streaming());
    let mut log = field.vehicle.logs.definitions.clone();
    for number in 0..200 {
        let data = message(b'D', number * 37 % 130);
        log.extend(&data);
        field.vehicle.logs.data.extend(data);
        run(&mut field, &mut client, 20);
    }
    run(&mut field, &mut client, 300);
    assert!(client.content() == log);
    check_beginnings(&client, &log);
    let acked = all::<LoggingDataAcked>(&field, 0);
    assert_eq!(acked.len(), log.len().min(field.vehicle.logs.definitions.len()).div_ceil(249));
    assert!(acked.iter().all(|packet| (packet.target_system, packet.target_component) == (255, 190)));
    // What is recorded slowly is not sent in many small packets.
    let packets = client.packets.len() - acked.len();
    assert!(packets * 150 < log.len() - field.vehicle.logs.definitions.len(), "{packets}");
    assert_eq!(stop(&mut field, 0, STATION), MavResult::ACCEPTED);
    assert_eq!((field.vehicle.logs.streams.len(), field.vehicle.logs.ended), (1, 1));
    assert_eq!(stop(&mut field, 0, STATION), MavResult::ACCEPTED, "there is none any more");
    field.vehicle.logs.data = vec![1; 500];
    field.gcs[0].forget();
    field.run_for(secs(1));
    assert_eq!(all::<LoggingData>(&field, 0), []);
}

/// LOG-10: other formats are DENIED, and so is a link of MAVLink 1, which has no room for the messages. The vehicle may refuse.
#[test]
fn a_stream_is_refused() {
    let mut field = ideal();
    assert_eq!(command(&mut field, 0, STATION, MavCmd::LOGGING_START, 1.0), MavResult::DENIED);
    field.vehicle.logs.refuses_stream = true;
    assert_eq!(start(&mut field, 0, STATION), MavResult::FAILED);
    assert!(!field.stack.log_streaming.is_streaming());
    let old = LinkConfig::uart(115_200).with_version(TxVersion::V1);
    let mut field = streaming(old, LineConfig::default(), 1);
    assert_eq!(start(&mut field, 0, STATION), MavResult::DENIED);
    assert!(field.vehicle.logs.streams.is_empty());
}

/// LOG-10: a retransmission of the command starts nothing again. A client that was restarted gets the definitions again.
#[test]
fn a_repeated_command_starts_once() {
    let mut field = ideal();
    let mut client = Client::default();
    for _ in 0..3 {
        assert_eq!(start(&mut field, 0, STATION), MavResult::ACCEPTED);
        run(&mut field, &mut client, 500);
    }
    assert_eq!(field.vehicle.logs.streams.len(), 1);
    run(&mut field, &mut client, 2_000);
    assert_eq!(start(&mut field, 0, STATION), MavResult::ACCEPTED);
    let mut client = Client { seen: client.seen, ..Client::default() };
    run(&mut field, &mut client, 500);
    assert_eq!((field.vehicle.logs.streams.len(), field.vehicle.logs.ended), (2, 1));
    assert!(client.content() == field.vehicle.logs.definitions);
}

/// LOG-10, LOG-13: another client waits, and ends no stream but its own. A text says why (C-16).
#[test]
fn one_stream_at_a_time() {
    let mut field = ideal();
    assert_eq!(start(&mut field, 0, STATION), MavResult::ACCEPTED);
    for (link, from) in [(1, STATION), (0, OTHER_STATION)] {
        assert_eq!(start(&mut field, link, from), MavResult::TEMPORARILY_REJECTED);
        assert_eq!(stop(&mut field, link, from), MavResult::DENIED);
    }
    field.run_for(millis(50));
    let texts = all::<Statustext>(&field, 1);
    let texts: Vec<_> = texts.iter().map(|text| text.text.as_str().unwrap()).collect();
    assert_eq!(texts, ["Command 2510 refused: another station has control"], "one a second");
    let expected = counted(|counters: &mut StreamingCounters| (counters.started, counters.busy) = (1, 2));
    assert_eq!(field.stack.log_streaming.counters(), expected);
    assert_eq!(stop(&mut field, 0, STATION), MavResult::ACCEPTED);
    assert_eq!(start(&mut field, 1, OTHER_STATION), MavResult::ACCEPTED);
}

/// LOG-11: a packet is sent every 500 ms until it is acknowledged, by its client and with its number.
#[test]
fn definitions_are_repeated() {
    let mut field = ideal();
    let mut client = Client { ignored: 4, ..Client::default() };
    start(&mut field, 0, STATION);
    for (from, sequence) in [(OTHER_STATION, 0), (STATION, 1), (STATION, u16::MAX)] {
        send(&mut field, 0, from, &LoggingAck { sequence, target_system: 1, target_component: 1 });
    }
    run(&mut field, &mut client, 2_600);
    let sent: Vec<u64> = field.gcs[0].all::<LoggingDataAcked>().iter().map(|(at, _)| at.as_millis()).collect();
    let pauses: Vec<u64> = sent.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(pauses[..4].iter().all(|pause| (499..=502).contains(pause)), "{pauses:?}");
    assert!(pauses[4..].iter().all(|pause| *pause < 10), "{pauses:?}");
    assert!(client.content() == field.vehicle.logs.definitions);
    assert_eq!(field.stack.log_streaming.counters().resent, 4);
}

/// LOG-13: a stream ends ten seconds after its client was last heard, or when the same packet was sent 20 times, and when its link
/// is opened again.
#[test]
fn a_stream_ends_without_its_client() {
    let mut field = ideal();
    field.gcs[0].heartbeat_period = Some(secs(1));
    start(&mut field, 0, STATION);
    field.run_for(millis(9_900));
    assert!(field.stack.log_streaming.is_streaming());
    field.run_for(millis(300));
    assert!(!field.stack.log_streaming.is_streaming(), "nothing was acknowledged");
    assert_eq!(all::<LoggingDataAcked>(&field, 0).len(), 20);

    let mut client = Client { seen: field.gcs[0].received.len(), ..Client::default() };
    start(&mut field, 0, STATION);
    run(&mut field, &mut client, 15_000);
    assert!(field.stack.log_streaming.is_streaming());
    field.gcs[0].heartbeat_period = None;
    run(&mut field, &mut client, 8_900);
    send(&mut field, 1, STATION, &Heartbeat::default());
    assert!(field.stack.log_streaming.is_streaming());
    run(&mut field, &mut client, 1_200);
    assert!(!field.stack.log_streaming.is_streaming());
    assert_eq!(field.stack.log_streaming.counters().timed_out, 2);

    // Before the stream it does not matter.
    field.stack.restart_link(LinkId(0));
    start(&mut field, 0, STATION);
    assert!(field.stack.log_streaming.is_streaming());
    field.stack.restart_link(LinkId(0));
    field.gcs[0].forget();
    field.run_for(secs(1));
    assert!(!field.stack.log_streaming.is_streaming() && all::<LoggingDataAcked>(&field, 0).is_empty());
    assert_eq!((field.vehicle.logs.streams.len(), field.vehicle.logs.ended), (3, 3));
}

/// LOG-14, D-4: on a link that telemetry fills, the log still has about 30 % of the rate. A high-latency link carries none.
#[test]
fn a_stream_keeps_its_share() {
    let link = LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard);
    let down = Wire { bytes_per_second: 5_760, tx_fifo: 512, ..Wire::default() };
    let mut field = streaming(link, LineConfig { down, ..LineConfig::default() }, 1);
    for id in [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID] {
        field.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        field.run_for(millis(200));
    }
    let mut client = Client::default();
    field.gcs[0].command_long(MavCmd::LOGGING_START, [0.0; 7]);
    run(&mut field, &mut client, 2_000);
    field.vehicle.logs.data = vec![3; 100_000];
    field.gcs[0].forget();
    field.run_for(secs(5));
    let frames = field.gcs[0].received.iter();
    let bytes: usize = frames.filter(|frame| frame.header.id == LoggingData::ID).map(|frame| frame.raw.len()).sum();
    let share = bytes * 100 / (5 * 5_760);
    assert!((25..=40).contains(&share), "{share} %");

    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let mut field = streaming(satellite, LineConfig::default(), 1);
    assert_eq!(start(&mut field, 0, STATION), MavResult::DENIED);
}

proptest! {
    #![proptest_config(cases(40))]

    /// LOG-11, LOG-12: with any loss, duplicates and reordering, the definitions are complete, and each packet of data that arrives has
    /// its place and its bytes. What is lost shows as a gap in the numbers.
    #[test]
    fn any_stream_is_put_together(
        loss in 0.0..0.3f64,
        disorder in 0.0..0.3f64,
        parts in prop::collection::vec(0..600usize, 0..12),
        data in prop::collection::vec(0..400usize, 0..40),
        seed in any::<u64>(),
    ) {
        let faults =
            Faults { frame_loss: loss, frame_duplicate: disorder, frame_reorder: disorder, reorder_by: millis(40), ..Faults::default() };
        let wire = Wire { bytes_per_second: 11_520, latency: millis(15), faults, ..Wire::default() };
        let link = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
        let mut field = streaming(link, LineConfig::both(wire), seed);
        field.vehicle.logs.definitions = definitions(&parts);
        field.gcs[0].heartbeat_period = Some(millis(500));
        let mut log = field.vehicle.logs.definitions.clone();
        let mut client = Client::default();
        // The command may be lost.
        while !field.stack.log_streaming.is_streaming() {
            field.gcs[0].command_long(MavCmd::LOGGING_START, [0.0; 7]);
            run(&mut field, &mut client, 200);
        }
        for len in data {
            let data = message(b'D', len);
            log.extend(&data);
            field.vehicle.logs.data.extend(data);
            run(&mut field, &mut client, 30);
        }
        let length = field.vehicle.logs.definitions.len();
        for _ in 0..200 {
            run(&mut field, &mut client, 300);
            if field.vehicle.logs.data.is_empty() && client.packets.len() >= length.div_ceil(249) {
                break;
            }
        }
        run(&mut field, &mut client, 600);
        let acked: Vec<u8> =
            (0..length.div_ceil(249)).flat_map(|sequence| client.packets[&(sequence as u16)].1.clone()).collect();
        prop_assert!(acked == log[..length]);
        let taken = log.len() - field.vehicle.logs.data.len();
        let total: usize = client.packets.values().map(|(_, bytes)| bytes.len()).sum();
        prop_assert!(total <= taken);
        if loss == 0.0 || total == taken {
            prop_assert!(client.content() == log[..taken]);
            check_beginnings(&client, &log);
        }
        // A reader finds its way back after a gap: a message begins where the packet says.
        for (first, bytes) in client.packets.values().filter(|(first, _)| *first != 255) {
            prop_assert!(usize::from(*first) < bytes.len());
        }
    }
}

/// the stream of a client on a link that takes no bytes went on for as long as the client's heartbeats were received, and
/// another client's 20 STARTs were refused. Now the first after ten seconds is accepted.
#[test]
fn dead_link_holds_no_stream() {
    let mut field = ideal();
    assert_eq!(start(&mut field, 0, STATION), MavResult::ACCEPTED);
    field.uarts[0].stall_writes_until(mavstack::Instant::NEVER);
    let accepted = (0..20).find(|_| {
        send(&mut field, 0, STATION, &Gcs::heartbeat());
        field.run_for(millis(990));
        start(&mut field, 1, OTHER_STATION) == MavResult::ACCEPTED
    });
    assert!(accepted.is_some_and(|second| second <= 11), "{accepted:?}");
}

/// X-3, LOG-13: the stream of a flight of 20 minutes goes on and is whole, though a stranger asks for the stream, for its end, for
/// logs and for messages all the time.
#[test]
fn stream_of_a_flight() {
    let link = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
    let lines = [LineConfig::radio(57_600, millis(20)); 2];
    let setup = Setup { links: [link; 2], lines, step: millis(20), ..Setup::new() };
    let mut field = with_logs(setup, &[]);
    field.vehicle.logs.definitions = definitions(&[40, 200]);
    field.gcs.iter_mut().for_each(|gcs| gcs.heartbeat_period = Some(secs(1)));
    field.gcs[1].address = OTHER_STATION;
    let (mut client, mut recorded) = (Client::default(), field.vehicle.logs.definitions.len());
    field.gcs[0].command_long(MavCmd::LOGGING_START, [0.0; 7]);
    for second in 0..1_200u32 {
        match second % 4 {
            0 => field.gcs[1].command_long(MavCmd::LOGGING_START, [0.0; 7]),
            1 => field.gcs[1].command_long(MavCmd::LOGGING_STOP, [0.0; 7]),
            2 => field.gcs[1].send(&ALL),
            _ => field.gcs[1].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        }
        let data = message(b'D', 200);
        recorded += data.len();
        field.vehicle.logs.data.extend(data);
        for _ in 0..50 {
            field.step();
            client.poll(&mut field.gcs[0]);
        }
        client.seen = 0;
        field.gcs.iter_mut().for_each(Gcs::forget);
    }
    assert!(field.stack.log_streaming.is_streaming());
    assert_eq!((field.vehicle.logs.streams.len(), field.vehicle.logs.ended), (1, 0));
    let sent = client.content().len();
    assert!(recorded - sent <= 1_000, "{sent} of {recorded} bytes");
}
