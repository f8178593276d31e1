//! The flight logs, and streams of the running log: rules LOG-1, LOG-10, LOG-12.

use crate::support::wire::{STATION, Wire};
use mavstack::dialect::*;
use mavstack_demo::{LogMemory, TELEMETRY};

/// Returns number, size and time of each log.
fn entries(wire: &mut Wire) -> Vec<(u16, u32, u32)> {
    let list = LogRequestList { start: 0, end: u16::MAX, target_system: 1, target_component: 1 };
    wire.take::<LogEntry>();
    wire.send(TELEMETRY, &list);
    wire.run(500);
    wire.take::<LogEntry>().iter().map(|(_, entry)| (entry.id, entry.size, entry.time_utc)).collect()
}

/// LOG-1, LOG-10, LOG-12: the log is streamed on the ground for as long as the client wants, and this neither evicts the log of a flight
/// nor keeps clients from downloading it.
#[test]
fn a_stream_on_the_ground_evicts_no_flight() {
    let mut wire = Wire::booted();
    wire.app.keep_logs(Box::leak(Box::new(LogMemory::new())));
    for _ in 0..2 {
        assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
        wire.run(2_000);
        assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[0.0]), MavResult::ACCEPTED);
        wire.run(500);
    }
    let flights = entries(&mut wire);
    assert!(flights.len() == 2 && flights.iter().all(|(_, size, _)| *size > 1_000), "{flights:?}");

    assert_eq!(wire.long(MavCmd::LOGGING_START, &[0.0; 7]), MavResult::ACCEPTED);
    let mut bytes = Vec::new();
    for second in 0..60 {
        wire.send(TELEMETRY, &Heartbeat { r#type: MavType::GCS, ..Heartbeat::default() });
        for _ in 0..10 {
            wire.run(100);
            for (_, packet) in wire.take::<LoggingDataAcked>() {
                assert_eq!(packet.target_system, STATION.system.wire());
                bytes.extend(&packet.data[..usize::from(packet.length)]);
                let sequence = packet.sequence;
                wire.send(TELEMETRY, &LoggingAck { sequence, target_system: 1, target_component: 1 });
            }
        }
        let data: Vec<LoggingData> = wire.take().into_iter().map(|(_, packet)| packet).collect();
        assert!(second < 2 || !data.is_empty(), "the stream has ended after {second} s");
        bytes.extend(data.iter().flat_map(|packet| &packet.data[..usize::from(packet.length)]));
    }
    assert_eq!(entries(&mut wire), flights);
    wire.send(TELEMETRY, &LogRequestData { ofs: 0, count: 90, id: 1, target_system: 1, target_component: 1 });
    wire.run(500);
    assert_eq!(wire.take::<LogData>().len(), 1);

    // Whole messages from the header on: the size counts what follows it and the kind. No time was left out.
    assert!(bytes.starts_with(b"ULog"));
    let (mut rest, mut attitudes) = (&bytes[16..], 0);
    while let [low, high, kind, content @ ..] = rest {
        let len = usize::from(u16::from_le_bytes([*low, *high]));
        assert!(b"BIFADL".contains(kind), "{kind}");
        attitudes += usize::from(*kind == b'D' && content.starts_with(&[0, 0]));
        rest = content.get(len..).unwrap_or_default();
    }
    assert!((280..=300).contains(&attitudes), "{attitudes} in 60 s");
}
