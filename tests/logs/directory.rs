//! Logs as files: rule LOG-15.

use super::*;
use crate::support::files::{Packet, request};
use mavstack::dialect::{FileTransferProtocol, MavFtpErr, MavFtpOpcode};
use mavstack_station::files::Download;

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 2, streams, commands: { slots: 3 }, files: { sessions: 2 }, logs)]
struct Filed;

type Shelf = World<2, Filed>;

fn shelf(sizes: &[usize]) -> Shelf {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let mut shelf = Shelf::of(Setup { links: [link; 2], ..Setup::new() });
    shelf.vehicle.logs.content = sizes.iter().enumerate().map(|(number, len)| content(number, *len)).collect();
    shelf.run_for(millis(10));
    shelf
}

/// Sends a request with a path, and returns the answer: data, or an error.
fn ask(shelf: &mut Shelf, seq: u16, opcode: MavFtpOpcode, path: &str) -> Result<Vec<u8>, MavFtpErr> {
    shelf.gcs[0].forget();
    shelf.gcs[0].send(&request(seq, 0, opcode, path.len() as u8, 0, path.as_bytes()));
    shelf.run_for(millis(50));
    let packets = shelf.gcs[0].all::<FileTransferProtocol>();
    let [(_, packet)] = &packets[..] else { panic!("one answer: {packets:?}") };
    let packet = Packet::of(packet);
    packet.error().map_or(Ok(packet.data.clone()), Err)
}

/// LOG-15: the root shows the directory, which lists each log with its size and time.
#[test]
fn logs_are_listed_as_files() {
    let mut shelf = shelf(&[100, 90_000]);
    let root = ask(&mut shelf, 1, MavFtpOpcode::LISTDIRECTORY, "/").unwrap();
    assert!(String::from_utf8(root).unwrap().contains("D@MAV_LOG\0"));
    let list = ask(&mut shelf, 2, MavFtpOpcode::LISTDIRECTORY, "@MAV_LOG").unwrap();
    assert_eq!(list, b"Flog_0.ulg\t100\0Flog_1.ulg\t90000\0");
    let list = ask(&mut shelf, 3, MavFtpOpcode::LISTDIRECTORYWITHTIME, "/@MAV_LOG").unwrap();
    assert_eq!(list, b"Flog_0.ulg\t100\t1000\0Flog_1.ulg\t90000\t1100\0");
}

/// LOG-15: a client downloads a log by a burst, and the content is the log's, also when it has no data for a while.
#[test]
fn a_log_is_downloaded_as_a_file() {
    for (number, len) in [(0usize, 0usize), (1, 239), (2, 20_000)] {
        let mut shelf = shelf(&[0, 239, 20_000]);
        shelf.vehicle.logs.later = 5;
        let download = Download::new(format!("@MAV_LOG/log_{number}.ulg"));
        let mut transfer = Talk::new(Client::QGroundControl, STATION, download);
        let ended = shelf.run_until(secs(20), |shelf| {
            let now = shelf.now();
            transfer.poll(now, &mut shelf.gcs[0]).is_some()
        });
        assert!(ended && *transfer.output() == content(number, len));
    }
}

/// LOG-9, LOG-15: a log that has no data yet is read every five milliseconds, so that a sleeping loop sleeps. Files of other clients
/// on the link do not wait for it.
#[test]
fn a_slow_log_delays_no_other_file() {
    let mut shelf = shelf(&[5_000]);
    shelf.vehicle.logs.later = usize::MAX;
    let idle = shelf.sleep_for(secs(1));
    for opcode in [MavFtpOpcode::READFILE, MavFtpOpcode::BURSTREADFILE] {
        assert_eq!(ask(&mut shelf, 1, MavFtpOpcode::OPENFILERO, "@MAV_LOG/log_0.ulg").unwrap(), 5_000u32.to_le_bytes());
        shelf.gcs[0].send(&request(2, 0, opcode, 239, 0, b""));
        shelf.run_for(millis(20));
        shelf.vehicle.logs.reads = 0;
        let passes = shelf.sleep_for(secs(1));
        assert!((190..=210).contains(&shelf.vehicle.logs.reads), "{}", shelf.vehicle.logs.reads);
        assert!(passes < idle + 420, "{passes} passes, {idle} without a client");

        let mut transfer = Talk::new(Client::QGroundControl, OTHER_STATION, Download::new("docs/licence.txt"));
        let ended = shelf.run_until(millis(100), |shelf| {
            let now = shelf.now();
            transfer.poll(now, &mut shelf.gcs[0]).is_some()
        });
        assert!(ended && transfer.output() == b"MIT", "{opcode:?}");
        shelf.run_for(millis(20));
        assert_eq!(ask(&mut shelf, 3, MavFtpOpcode::RESETSESSION, ""), Ok(vec![]));
    }
    shelf.vehicle.logs.later = 0;
    assert!(ask(&mut shelf, 4, MavFtpOpcode::OPENFILERO, "@MAV_LOG/log_0.ulg").is_ok());
}

/// LOG-9, LOG-15, D-4: the checksum of a log that has no data yet is continued every five milliseconds, so that a sleeping loop sleeps.
#[test]
fn the_checksum_of_a_slow_log_sleeps() {
    const PATH: &str = "@MAV_LOG/log_0.ulg";
    let mut shelf = shelf(&[5_000]);
    let idle = shelf.sleep_for(secs(1));
    shelf.vehicle.logs.later = usize::MAX;
    shelf.gcs[0].send(&request(1, 0, MavFtpOpcode::CALCFILECRC, PATH.len() as u8, 0, PATH.as_bytes()));
    shelf.run_for(millis(20));
    shelf.vehicle.logs.reads = 0;
    let passes = shelf.sleep_for(secs(1));
    assert!((190..=210).contains(&shelf.vehicle.logs.reads), "{}", shelf.vehicle.logs.reads);
    assert!(passes < idle + 420, "{passes} passes, {idle} without a client");

    shelf.vehicle.logs.later = 0;
    let mut reference = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
    reference.digest(&content(0, 5_000));
    // The client repeats its request.
    assert_eq!(ask(&mut shelf, 1, MavFtpOpcode::CALCFILECRC, PATH), Ok(reference.get_crc().to_le_bytes().to_vec()));
}

/// LOG-7: logs are not erased while a client reads the file of one: until it has read its end, or nothing for three seconds.
#[test]
fn a_file_that_is_read_is_not_erased() {
    let erase = |shelf: &mut Shelf| {
        shelf.gcs[1].send(&ERASE);
        shelf.run_for(millis(50));
        let text = shelf.gcs[1].all::<Statustext>().pop().expect("a text").1.text.as_str().unwrap().to_string();
        (text, shelf.vehicle.logs.content.len())
    };
    for reads_end in [false, true] {
        let mut shelf = shelf(&[5_000]);
        assert!(ask(&mut shelf, 1, MavFtpOpcode::OPENFILERO, "@MAV_LOG/log_0.ulg").is_ok());
        for seq in 2..4 {
            assert!(ask(&mut shelf, seq, MavFtpOpcode::READFILE, "xxx").is_ok());
            shelf.run_for(millis(2_800));
            assert_eq!(erase(&mut shelf), ("Logs not erased: a client reads one".to_string(), 1));
        }
        assert_eq!(shelf.stack.logs().counters().busy, 2);
        if reads_end {
            assert!(ask(&mut shelf, 4, MavFtpOpcode::READFILE, "xxx").is_ok());
            shelf.gcs[0].send(&request(5, 0, MavFtpOpcode::READFILE, 3, 5_000, b""));
            shelf.run_for(millis(50));
        } else {
            shelf.run_for(millis(300));
        }
        assert_eq!(erase(&mut shelf), ("Logs erased".to_string(), 0));
    }
}

/// LOG-16: an open file ends with Fail when its number may belong to another log: after a flight, an erasure, or if the vehicle has
/// another log there of itself.
#[test]
fn a_file_is_never_of_two_logs() {
    let flight: fn(&mut Shelf) = |shelf| {
        for is_armed in [true, false] {
            shelf.vehicle.state = Some(mavstack::VehicleState::new(is_armed));
            shelf.run_for(millis(10));
        }
    };
    let erasure: fn(&mut Shelf) = |shelf| {
        shelf.gcs[1].send(&ERASE);
        shelf.run_for(millis(50));
        shelf.vehicle.logs.content = vec![content(7, 5_000)];
    };
    let eviction: fn(&mut Shelf) = |shelf| shelf.vehicle.logs.evicted = 1;
    for change in [flight, erasure, eviction] {
        let mut shelf = shelf(&[5_000]);
        assert!(ask(&mut shelf, 1, MavFtpOpcode::OPENFILERO, "@MAV_LOG/log_0.ulg").is_ok());
        assert_eq!(ask(&mut shelf, 2, MavFtpOpcode::READFILE, "xxx"), Ok(content(0, 3)));
        shelf.run_for(secs(4));
        change(&mut shelf);
        assert_eq!(ask(&mut shelf, 3, MavFtpOpcode::READFILE, "xxx"), Err(MavFtpErr::FAIL));
        assert!(ask(&mut shelf, 4, MavFtpOpcode::OPENFILERO, "@MAV_LOG/log_0.ulg").is_ok());
        assert!(ask(&mut shelf, 5, MavFtpOpcode::READFILE, "xxx").is_ok());
    }
}

/// LOG-15, LOG-6, F-32: names that are no log's are not found, files are not written or removed, and in flight nothing is read.
#[test]
fn other_files_are_refused() {
    let mut shelf = shelf(&[100]);
    let names = [
        "log_1.ulg",
        "log_.ulg",
        "log_0.bin",
        "log_0ulg",
        "log_0",
        "log_65536.ulg",
        "log_-1.ulg",
        "log_0.ulg/",
        "0",
        "log_00.ulg",
    ];
    for (seq, name) in (1..).zip(names) {
        let path = format!("@MAV_LOG/{name}");
        let expected = if name == "log_0.ulg/" { Ok(100) } else { Err(MavFtpErr::FILENOTFOUND) };
        let opened = ask(&mut shelf, seq, MavFtpOpcode::OPENFILERO, &path);
        assert_eq!(opened.map(|size| u32::from_le_bytes(size.try_into().unwrap())), expected, "{name}");
    }
    for (seq, opcode) in (20..).zip([MavFtpOpcode::OPENFILEWO, MavFtpOpcode::CREATEFILE, MavFtpOpcode::REMOVEFILE]) {
        assert_eq!(ask(&mut shelf, seq, opcode, "@MAV_LOG/log_0.ulg"), Err(MavFtpErr::FILEPROTECTED), "{opcode:?}");
    }
    shelf.vehicle.state = Some(mavstack::VehicleState::new(true));
    shelf.run_for(millis(10));
    assert_eq!(ask(&mut shelf, 30, MavFtpOpcode::LISTDIRECTORY, "@MAV_LOG"), Err(MavFtpErr::EOF));
    assert_eq!(ask(&mut shelf, 31, MavFtpOpcode::CALCFILECRC, "@MAV_LOG/log_0.ulg"), Err(MavFtpErr::FAIL));
}
