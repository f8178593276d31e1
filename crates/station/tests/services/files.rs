//! MAVLink FTP, as each client does it.

use crate::rig::{self, Tested};
use mavstack::dialect::MavFtpErr;
use mavstack_station::files::{Checksum, Download, EntryKind, Listing, Operation, Reading, Upload, crc32};
use mavstack_station::kit::Rig;
use mavstack_station::{Again, Client, Drive, Failure, GroundStation};

/// The size of the longest file.
const LONG: usize = 10_000;

/// A file of `len` bytes.
fn content(len: usize) -> Vec<u8> {
    (0..len).map(|at| (at * 7 + at / 256) as u8).collect()
}

fn rig(client: Client, loss: f64, seed: u64) -> Rig<Tested> {
    let mut rig = rig::rig(client, loss, seed);
    rig.firmware_mut().boat.files.insert("long.bin".to_owned(), content(LONG));
    rig.firmware_mut().boat.files.insert("short.txt".to_owned(), b"short".to_vec());
    rig.firmware_mut().boat.files.insert("whole.bin".to_owned(), content(2 * 239));
    rig
}

#[test]
fn every_client_reads_files() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        for name in ["long.bin", "short.txt", "whole.bin"] {
            let expected = rig.firmware().boat.files[name].clone();
            assert_eq!(rig.read_file(name), Ok(expected.clone()), "{client}: {name}");
            let single = Download::new(name).with_reading(Reading::Single);
            assert_eq!(rig.run(single), Ok(expected), "{client}: {name} without a burst");
        }
    }
}

#[test]
fn every_client_reads_and_writes_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            let expected = content(LONG);
            // MAVSDK fails if the last packet of a burst is lost, but not the answer that the file has ended.
            let mut read = rig.run(Again::new(50, || Download::new("long.bin")));
            while client == Client::Mavsdk && matches!(read, Err(Failure::File { error: MavFtpErr::EOF, .. })) {
                read = rig.run(Again::new(50, || Download::new("long.bin")));
            }
            assert!(read == Ok(expected), "{client}, seed {seed}: {:?}", read.map(|bytes| bytes.len()));
            let new = content(5_000);
            let written = rig.run(Again::new(50, || Upload::new("new.bin", new.clone())));
            assert_eq!(written, Ok(()), "{client}, seed {seed}");
            assert_eq!(rig.firmware().boat.files["new.bin"], new, "{client}, seed {seed}");
        }
    }
}

#[test]
fn every_client_lists_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            // pymavlink repeats nothing, so a list of many parts never arrives.
            let more = if client == Client::Pymavlink { 0 } else { 60 };
            rig.firmware_mut().boat.files.extend((0..more).map(|n| (format!("file number {n}"), content(n))));
            let entries = rig.run(Again::new(50, || Listing::new("/"))).expect("a list");
            let files = entries.iter().filter(|entry| matches!(entry.kind, EntryKind::File { .. })).count();
            assert_eq!(files, 3 + more, "{client}, seed {seed}: {entries:?}");
            let file = entries.iter().find(|entry| entry.name == "long.bin").expect("the file");
            let time = (client == Client::MavProxy).then_some(1_700_000_000);
            assert!(
                matches!(file.kind, EntryKind::File { size, time: told } if size == LONG as u32 && (told.is_none() || told == time)),
                "{client}, seed {seed}: {file:?}"
            );
        }
    }
}

#[test]
fn operations_are_carried_out_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            let sum = rig.run(Again::new(50, || Checksum::new("short.txt")));
            assert_eq!(sum, Ok(crc32(b"short")), "{client}, seed {seed}");
            let cut = rig.run(Again::new(50, || Operation::truncate("short.txt", 2)));
            assert_eq!(
                (cut, &rig.firmware().boat.files["short.txt"][..]),
                (Ok(()), &b"sh"[..]),
                "{client}, seed {seed}"
            );
            // A repetition after the first one was carried out finds nothing any more.
            let moved = rig.run(Again::new(50, || Operation::rename("short.txt", "renamed.txt")));
            assert!(moved.is_ok() || is_not_found(&moved), "{client}, seed {seed}: {moved:?}");
            assert!(rig.firmware().boat.files.contains_key("renamed.txt"), "{client}, seed {seed}");
            let removed = rig.run(Again::new(50, || Operation::remove("renamed.txt")));
            assert!(removed.is_ok() || is_not_found(&removed), "{client}, seed {seed}: {removed:?}");
            assert!(!rig.firmware().boat.files.contains_key("renamed.txt"), "{client}, seed {seed}");
            assert_eq!(rig.run(Again::new(50, Operation::reset_sessions)), Ok(()), "{client}, seed {seed}");
        }
    }
}

fn is_not_found(result: &Result<(), Failure>) -> bool {
    matches!(result, Err(Failure::File { error: MavFtpErr::FILENOTFOUND, .. }))
}

#[test]
fn refusals_have_their_reason() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        let missing = rig.read_file("missing.bin");
        assert!(matches!(missing, Err(Failure::File { error: MavFtpErr::FILENOTFOUND, .. })), "{client}: {missing:?}");
        let locked = rig.write_file("locked.bin", &content(10));
        assert!(matches!(locked, Err(Failure::File { error: MavFtpErr::FILEPROTECTED, .. })), "{client}: {locked:?}");
        let removed = rig.remove_file("missing.bin");
        assert!(is_not_found(&removed), "{client}: {removed:?}");
        let listed = rig.list_files("/no/directory");
        assert!(matches!(listed, Err(Failure::File { .. })), "{client}: {listed:?}");
    }
}

/// Each client's way with a file without content, and with a vehicle that does not answer.
#[test]
fn clients_give_up_as_the_real_ones() {
    for (client, is_read) in Client::ALL.into_iter().zip([true, false, true, true]) {
        let mut rig = rig(client, 0.0, 0);
        rig.firmware_mut().boat.files.insert("empty".to_owned(), Vec::new());
        assert_eq!(rig.read_file("empty").is_ok(), is_read, "{client}");
    }
    for (client, millis, sends) in [
        (Client::QGroundControl, 1_000, 1),
        (Client::Mavsdk, 5_000, 10),
        (Client::MavProxy, 11_000, 11),
        (Client::Pymavlink, 3_000, 3),
    ] {
        let mut rig = rig(client, 1.0, 0);
        let begin = rig.now();
        let result = rig.run(Download::new("long.bin"));
        assert!(matches!(result, Err(Failure::Timeout { tries, .. }) if tries == sends), "{client}: {result:?}");
        let took = (rig.now() - begin).as_millis();
        assert!(took.abs_diff(millis) < 100, "{client}: {took} ms");
    }
}

/// Transfers with more than 256 requests: MAVProxy's sequence numbers have 8 bits.
#[test]
fn long_transfers_wrap_the_numbers() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.02, 1);
        let long = content(239 * 300);
        let written = rig.run(Again::new(20, || Upload::new("long.bin", long.clone())));
        assert_eq!(written, Ok(()), "{client}");
        assert!(rig.firmware().boat.files["long.bin"] == long, "{client}");
        let mut read = rig.run(Again::new(20, || Download::new("long.bin")));
        if matches!(read, Err(Failure::File { error: MavFtpErr::EOF, .. })) {
            read = rig.run(Download::new("long.bin").with_reading(Reading::Single));
        }
        assert!(read.as_ref() == Ok(&long), "{client}: {:?}", read.map(|bytes| bytes.len()));
    }
}
