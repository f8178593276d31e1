//! How much of a link a download uses, and what it must not delay: rules D-4, LOG-8.

use super::*;
use mavstack::Instant;
use mavstack::dialect::{Attitude, CommandAck, GlobalPositionInt, Heartbeat, MavCmd, SysStatus};

fn field_at(baud: u32, streams: StreamProfile) -> Field {
    let link = LinkConfig::uart(baud).with_streams(streams);
    let down = Wire { bytes_per_second: u64::from(baud / 10), tx_fifo: 256, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }; 2];
    let mut field = with_logs(Setup { links: [link; 2], lines, ..Setup::new() }, &[1_000_000]);
    field.gcs[0].heartbeat_period = Some(secs(1));
    field.run_for(millis(1_500));
    field
}

/// Returns the part of the line that LOG_DATA takes, and that of everything else (%).
fn shares(field: &Field, seconds: usize, baud: u32) -> (usize, usize) {
    let bytes = |is_log: bool| -> usize {
        let frames = field.gcs[0].received.iter().filter(|frame| (frame.header.id == LogData::ID) == is_log);
        frames.map(|frame| frame.raw.len()).sum::<usize>() * 100 / seconds / (baud / 10) as usize
    };
    (bytes(true), bytes(false))
}

/// LOG-8, H-15: a download uses at least 90 % of an idle link, and heartbeats are not late.
#[test]
fn a_download_uses_the_link() {
    for (baud, longest) in [(57_600, 1_090), (921_600, 1_030)] {
        let mut field = field_at(baud, StreamProfile::Off);
        field.gcs[0].forget();
        send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
        field.run_for(secs(5));
        let (log, _) = shares(&field, 5, baud);
        assert!(log >= 90, "{baud}: {log} %");
        let beats: Vec<Instant> = field.gcs[0].all::<Heartbeat>().iter().map(|(at, _)| *at).collect();
        let gap = beats.windows(2).map(|pair| (pair[1] - pair[0]).as_millis()).max().unwrap();
        assert!(gap <= longest, "{baud}: {gap} ms between heartbeats");
    }
}

/// LOG-8, D-4: an answer waits for the frame that is being sent, and for what is queued on the line.
#[test]
fn a_download_delays_no_answer() {
    let mut field = field_at(57_600, StreamProfile::Off);
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    field.run_for(millis(500));
    let command = field.gcs[0].long(MavCmd::COMPONENT_ARM_DISARM, [0.0; 7]);
    let begin = field.now();
    send(&mut field, 0, STATION, &command);
    field.expect::<CommandAck>(0, secs(1));
    let ms = (field.now() - begin).as_millis();
    assert!(ms <= 70, "{ms} ms");
}

/// LOG-8, D-4: on a link that streams fill, a download still has about 30 % of the rate, and the streams have the rest.
#[test]
fn a_download_keeps_its_share_beside_streams() {
    let mut field = field_at(57_600, StreamProfile::Onboard);
    for id in [Attitude::ID, GlobalPositionInt::ID, SysStatus::ID] {
        field.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        field.run_for(millis(200));
    }
    send(&mut field, 0, STATION, &data(0, 0, u32::MAX));
    field.run_for(millis(500));
    field.gcs[0].forget();
    field.run_for(secs(4));
    let (log, rest) = shares(&field, 4, 57_600);
    assert!((25..=40).contains(&log), "{log} % for the log");
    assert!(rest >= 50, "{rest} % for the streams");
}
