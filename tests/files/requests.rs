//! Each request, and each error: rules F-1 to F-3, F-5, F-7 to F-10, F-15.

use super::*;
use crate::support::files::STATIC;
use mavstack::config::{LinkClass, TxVersion};
use mavstack::dialect::{AutopilotVersion, MavCmd, MavProtocolCapability};

/// Lists a directory as clients do: until the end.
fn list(world: &mut Shelf, client: &mut Client, opcode: MavFtpOpcode, path: &str) -> Result<Vec<String>, MavFtpErr> {
    let mut entries = Vec::new();
    loop {
        match client.ask(world, opcode, path.len() as u8, entries.len() as u32, path.as_bytes()) {
            Ok(data) => {
                assert_eq!(data.last(), Some(&0), "whole entries only");
                let text = String::from_utf8(data).expect("ASCII");
                entries.extend(text.split_terminator('\0').map(str::to_string));
            }
            Err(MavFtpErr::EOF) => return Ok(entries),
            Err(error) => return Err(error),
        }
    }
}

/// F-9: directories with and without times, of static files, of the vehicle's, of the parameters and of plans.
#[test]
fn directories_are_listed() {
    let (mut world, mut client) = (world(), client());
    world.vehicle.files.content.insert("logs/1.bin".to_string(), pattern(3));
    world.vehicle.files.content.insert("logs/2.bin".to_string(), pattern(70_000));
    let with_time = MavFtpOpcode::LISTDIRECTORYWITHTIME;
    for root in ["", "/", "."] {
        let entries = list(&mut world, &mut client, MavFtpOpcode::LISTDIRECTORY, root).unwrap();
        assert_eq!(entries, ["Fgeneral.json\t13", "Ddocs", "D@PARAM", "D@MISSION", "Flog.bin\t1000", "Dlogs"]);
    }
    for docs in ["docs", "/docs/"] {
        let entries = list(&mut world, &mut client, MavFtpOpcode::LISTDIRECTORY, docs).unwrap();
        assert_eq!(entries, ["Flicence.txt\t3", "Dmore", "Fempty\t0"]);
    }
    let entries = list(&mut world, &mut client, with_time, "logs").unwrap();
    assert_eq!(entries, ["F1.bin\t3\t1700000000", "F2.bin\t70000\t1700000000"]);
    let entries = list(&mut world, &mut client, with_time, "docs/more").unwrap();
    assert_eq!(entries, ["Fnotes.txt\t4\t0"]);
    let entries = list(&mut world, &mut client, with_time, "docs").unwrap();
    assert_eq!(entries[1], "Dmore\t0\t0");
    assert_eq!(list(&mut world, &mut client, MavFtpOpcode::LISTDIRECTORY, "@PARAM").unwrap(), ["Fparam.pck\t231"]);
    let plans = list(&mut world, &mut client, MavFtpOpcode::LISTDIRECTORY, "@MISSION").unwrap();
    assert_eq!(plans, ["Fmission.dat\t10", "Ffence.dat\t10", "Frally.dat\t10"], "F-20");
    for missing in ["nothing", "doc", "@SYS", "general.json/x", "docs/licence"] {
        let entries = list(&mut world, &mut client, MavFtpOpcode::LISTDIRECTORY, missing);
        assert_eq!(entries, Err(MavFtpErr::FILENOTFOUND), "{missing}");
    }
}

/// F-9: a directory of many files takes several packets. A name that does not fit is skipped.
#[test]
fn long_directories_take_several_packets() {
    let (mut world, mut client) = (world(), client());
    for i in 0..100 {
        world.vehicle.files.content.insert(format!("many/{i:03}_{}", "x".repeat(i)), Vec::new());
    }
    world.vehicle.files.content.insert(format!("many/z{}", "x".repeat(210)), Vec::new());
    let entries = list(&mut world, &mut client, MavFtpOpcode::LISTDIRECTORY, "many").unwrap();
    assert_eq!(entries.len(), 101);
    for (i, entry) in entries.iter().take(100).enumerate() {
        assert_eq!(*entry, format!("F{i:03}_{}\t0", "x".repeat(i)));
    }
    assert_eq!(entries[100], "S");
}

/// F-5, F-8, F-15: any part of a file is read. The last one is shorter; behind it is the end.
#[test]
fn any_part_is_read() {
    let (mut world, mut client) = (world(), client());
    assert_eq!(client.open(&mut world, "/log.bin"), Ok(1_000));
    let content = pattern(1_000);
    for (offset, size, expected) in
        [(0, 239, &content[..239]), (239, 1, &content[239..240]), (990, 239, &content[990..]), (5, 0, &content[5..244])]
    {
        assert_eq!(client.read(&mut world, offset, size), Ok(expected.to_vec()), "{offset}");
    }
    for offset in [1_000, 1_001, u32::MAX] {
        assert_eq!(client.read(&mut world, offset, 239), Err(MavFtpErr::EOF), "{offset}");
    }
    assert_eq!(client.open(&mut world, "docs/licence.txt"), Ok(3), "another file in the same session");
    assert_eq!(client.read(&mut world, 0, 239), Ok(b"MIT".to_vec()));
    assert_eq!(client.open(&mut world, "docs/empty"), Ok(0));
    assert_eq!(client.read(&mut world, 0, 239), Err(MavFtpErr::EOF));
    assert_eq!(client.end(&mut world), Ok(vec![]));
    assert_eq!(client.read(&mut world, 0, 239), Err(MavFtpErr::INVALIDSESSION));
    assert!(world.vehicle.files.open.is_empty());
}

/// F-8: a burst consists of packets with numbers of their own, up to the end of the file.
#[test]
fn burst_sends_the_whole_file() {
    let (mut world, mut client) = (world(), client());
    client.open(&mut world, "log.bin").unwrap();
    let burst = request(7, 0, MavFtpOpcode::BURSTREADFILE, 100, 750, &[]);
    client.send(&mut world, &burst);
    let packets = client.packets(&mut world);
    let shown = packets.iter().map(|p| (p.seq, p.offset, p.data.len(), p.is_last, p.error()));
    assert_eq!(
        shown.collect::<Vec<_>>(),
        [
            (8, 750, 100, false, None),
            (9, 850, 100, false, None),
            (10, 950, 50, true, None),
            (11, 1_000, 1, true, Some(MavFtpErr::EOF))
        ]
    );
    let data: Vec<u8> = packets[..3].iter().flat_map(|packet| packet.data.clone()).collect();
    assert_eq!(data, pattern(1_000)[750..]);
    assert!(packets.iter().all(|packet| packet.request == MavFtpOpcode::BURSTREADFILE));
    assert_eq!(client.packets(&mut world), [], "nothing more");
}

/// F-30: the last packet of a burst is marked, also if it is full; and a file that grows or shrinks after it was opened has the length
/// that its client knows, if there are so many bytes.
#[test]
fn last_packet_of_a_burst_is_marked() {
    let (mut world, mut client) = (world(), client());
    for (path, len, block) in [("log.bin", 1_000, 100), ("log.bin", 1_000, 200), ("docs/licence.txt", 3, 3)] {
        for grown in [0, 70] {
            client.open(&mut world, path).unwrap();
            world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000 + grown));
            client.seq += 1;
            client.send(&mut world, &request(client.seq, 0, MavFtpOpcode::BURSTREADFILE, block, 0, &[]));
            client.seq += 40;
            let packets = client.packets(&mut world);
            let shown: Vec<_> = packets.iter().map(|p| (p.offset, p.data.len(), p.is_last, p.error())).collect();
            let expected =
                (0..len).step_by(block.into()).map(|at| (at, block.into(), at + u32::from(block) == len, None));
            let end = (len, 1, true, Some(MavFtpErr::EOF));
            assert_eq!(shown, expected.chain([end]).collect::<Vec<_>>(), "{path} {block} {grown}");
            assert_eq!(client.read(&mut world, len - 1, 239).map(|data| data.len()), Ok(1));
            client.end(&mut world).unwrap();
            world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000));
        }
    }
}

/// CalcFileCRC32: MAVLink's CRC, over several polls.
#[test]
fn checksum_of_a_file() {
    let (mut world, mut client) = (world(), client());
    for path in ["log.bin", "general.json", "docs/empty"] {
        let content = world.vehicle.files.content.get(path).cloned();
        let content =
            content.or_else(|| Some(STATIC.iter().find(|file| file.path() == path)?.bytes().to_vec())).unwrap();
        let sum = client.path(&mut world, MavFtpOpcode::CALCFILECRC, path).unwrap();
        let mut reference = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
        reference.digest(&content);
        assert_eq!(sum, reference.get_crc().to_le_bytes(), "{path}");
    }
    let missing = client.path(&mut world, MavFtpOpcode::CALCFILECRC, "missing");
    assert_eq!(missing, Err(MavFtpErr::FILENOTFOUND));
    world.vehicle.files.is_broken = true;
    assert_eq!(client.path(&mut world, MavFtpOpcode::CALCFILECRC, "log.bin"), Err(MavFtpErr::FAIL));
    assert!(world.vehicle.files.open.is_empty(), "closed again");
}

/// The vehicle's own files are created, written in any order, cut off, renamed and removed.
#[test]
fn files_are_written() {
    let (mut world, mut client) = (world(), client());
    client.create(&mut world, "new.txt").unwrap();
    assert_eq!(client.write(&mut world, 3, b"def\0\0"), Ok(vec![]), "trailing zeros are written too");
    assert_eq!(client.write(&mut world, 0, b"abc"), Ok(vec![]));
    assert_eq!(world.vehicle.files.content["new.txt"], b"abcdef\0\0");
    assert_eq!(client.write(&mut world, 2_000_000, b"x"), Err(MavFtpErr::FAIL));
    assert_eq!(client.read(&mut world, 0, 4), Ok(b"abcd".to_vec()));
    client.end(&mut world).unwrap();
    assert_eq!(client.ask(&mut world, MavFtpOpcode::TRUNCATEFILE, 7, 4, b"new.txt"), Ok(vec![]));
    assert_eq!(world.vehicle.files.content["new.txt"], b"abcd");
    assert_eq!(client.ask(&mut world, MavFtpOpcode::RENAME, 15, 0, b"new.txt\0old.txt"), Ok(vec![]));
    client.path(&mut world, MavFtpOpcode::OPENFILEWO, "old.txt").unwrap();
    client.write(&mut world, 1, b"B").unwrap();
    client.end(&mut world).unwrap();
    assert_eq!(world.vehicle.files.content["old.txt"], b"aBcd");
    assert_eq!(client.path(&mut world, MavFtpOpcode::CREATEDIRECTORY, "d"), Ok(vec![]));
    assert_eq!(client.path(&mut world, MavFtpOpcode::REMOVEDIRECTORY, "d"), Ok(vec![]));
    assert_eq!(client.path(&mut world, MavFtpOpcode::REMOVEFILE, "old.txt"), Ok(vec![]));
    assert!(world.vehicle.files.open.is_empty());
    assert_eq!(world.vehicle.files.content.keys().collect::<Vec<_>>(), ["log.bin"]);
}

/// F-3, F-5, F-7: each refusal has its own error.
#[test]
fn each_refusal_has_its_error() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    for (opcode, path, error) in [
        (Op::OPENFILERO, "missing", MavFtpErr::FILENOTFOUND),
        (Op::OPENFILERO, "", MavFtpErr::FILENOTFOUND),
        (Op::OPENFILERO, "@SYS/tasks.txt", MavFtpErr::FILENOTFOUND),
        (Op::OPENFILERO, "@PARAM/param.pck?start=99", MavFtpErr::FAIL),
        (Op::OPENFILERO, "@PARAM/param.pckx", MavFtpErr::FILENOTFOUND),
        (Op::CREATEFILE, "general.json", MavFtpErr::FILEPROTECTED),
        (Op::OPENFILEWO, "docs/licence.txt", MavFtpErr::FILEPROTECTED),
        (Op::CREATEFILE, "locked", MavFtpErr::FILEPROTECTED),
        (Op::REMOVEFILE, "general.json", MavFtpErr::FILEPROTECTED),
        (Op::REMOVEFILE, "@PARAM/param.pck", MavFtpErr::FILEPROTECTED),
        (Op::TRUNCATEFILE, "general.json", MavFtpErr::FILEPROTECTED),
        (Op::REMOVEFILE, "missing", MavFtpErr::FILENOTFOUND),
        (Op::RENAME, "log.bin", MavFtpErr::FAIL),
        (Op::RENAME, "log.bin\0@PARAM/x", MavFtpErr::FAIL),
        (Op::RENAME, "log.bin\0general.json", MavFtpErr::FAIL),
        (Op::RENAME, "missing\0other", MavFtpErr::FILENOTFOUND),
        (Op::RENAME, "log.bin\0", MavFtpErr::FAIL),
        (Op::RENAME, "\0log.old", MavFtpErr::FILEPROTECTED),
        (Op::REMOVEDIRECTORY, "", MavFtpErr::FILEPROTECTED),
        (Op::CREATEDIRECTORY, "/", MavFtpErr::FILEPROTECTED),
        (Op::REMOVEFILE, ".", MavFtpErr::FILEPROTECTED),
        (Op(17), "", MavFtpErr::UNKNOWNCOMMAND),
        (Op(127), "", MavFtpErr::UNKNOWNCOMMAND),
    ] {
        assert_eq!(client.path(&mut world, opcode, path), Err(error), "{opcode:?} {path}");
    }
    // F-7: an unknown session ends, and has no data.
    assert_eq!(client.end(&mut world), Ok(vec![]));
    assert_eq!(client.ask(&mut world, Op::RESETSESSION, 0, 0, &[]), Ok(vec![]));
    assert_eq!(client.ask(&mut world, Op::NONE, 0, 0, &[]), Ok(vec![]));
    for opcode in [Op::READFILE, Op::BURSTREADFILE, Op::WRITEFILE] {
        assert_eq!(client.ask(&mut world, opcode, 10, 0, &[]), Err(MavFtpErr::INVALIDSESSION), "{opcode:?}");
    }
    for opcode in [Op::READFILE, Op::BURSTREADFILE, Op::OPENFILERO] {
        assert_eq!(client.ask(&mut world, opcode, 240, 0, &[]), Err(MavFtpErr::INVALIDDATASIZE), "{opcode:?}");
    }
    client.open(&mut world, "log.bin").unwrap();
    assert_eq!(client.write(&mut world, 0, b"x"), Err(MavFtpErr::FILEPROTECTED), "it is open to be read");
    world.vehicle.files.is_broken = true;
    assert_eq!(client.read(&mut world, 0, 10), Err(MavFtpErr::FAIL));
    client.send(&mut world, &request(80, 0, Op::BURSTREADFILE, 10, 0, &[]));
    let packets = client.packets(&mut world);
    assert_eq!(
        packets.iter().map(|packet| (packet.error(), packet.is_last)).collect::<Vec<_>>(),
        [(Some(MavFtpErr::FAIL), true)]
    );
}

/// F-10: no path leads out of the files. One without a zero at its end is as good as one with it.
#[test]
fn paths_are_checked() {
    let (mut world, mut client) = (world(), client());
    for path in ["..", "../log.bin", "docs/../log.bin", "docs/..", "log\x01bin", "l\u{e4}g"] {
        assert_eq!(client.open(&mut world, path), Err(MavFtpErr::FILENOTFOUND), "{path}");
    }
    for path in ["log.bin", "log.bin\0", "log.bin\0junk", "/log.bin", "//log.bin"] {
        assert_eq!(client.open(&mut world, path), Ok(1_000), "{path}");
        client.end(&mut world).unwrap();
    }
    let longest = "x".repeat(239);
    world.vehicle.files.content.insert(longest.clone(), vec![1]);
    assert_eq!(client.open(&mut world, &longest), Ok(1));
}

/// F-32: a file has one spelling. Others are refused by every operation before a hook sees them, so that none passes the check of the
/// stack's own files.
#[test]
fn other_spellings_reach_no_hook() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    world.vehicle.files.content.insert("d/x".to_string(), pattern(3));
    let before = world.vehicle.files.content.clone();
    let spellings = [
        "./general.json",
        ".//log.bin",
        "./log.bin",
        "d//x",
        "d/./x",
        "d/.",
        "./d",
        "./.",
        "d\\x",
        "..\\x",
        "\\log.bin",
        "0:/log.bin",
        "C:log.bin",
        "log.bin:x",
        "./@PARAM/param.pck",
        "@PARAM//param.pck",
        "@PARAM/./param.pck",
        "@MISSION//mission.dat",
        "docs//licence.txt",
        "docs/./licence.txt",
        "log\tbin",
        "log.bin\x7f",
        "log.bin\r",
    ];
    let opcodes = [
        Op::OPENFILERO,
        Op::OPENFILEWO,
        Op::CREATEFILE,
        Op::CALCFILECRC,
        Op::LISTDIRECTORY,
        Op::LISTDIRECTORYWITHTIME,
        Op::REMOVEFILE,
        Op::CREATEDIRECTORY,
        Op::REMOVEDIRECTORY,
        Op::TRUNCATEFILE,
        Op::RENAME,
    ];
    for path in spellings {
        for opcode in opcodes {
            assert_eq!(client.path(&mut world, opcode, path), Err(MavFtpErr::FILENOTFOUND), "{opcode:?} {path:?}");
        }
        let rename = client.path(&mut world, Op::RENAME, &format!("log.bin\0{path}"));
        assert_eq!(rename, Err(MavFtpErr::FAIL), "{path:?}");
        let rename = client.path(&mut world, Op::RENAME, &format!("{path}\0new"));
        assert_eq!(rename, Err(MavFtpErr::FILENOTFOUND), "{path:?}");
    }
    assert_eq!((world.vehicle.files.changes, &world.vehicle.files.content), (0, &before));
    // Slashes at both ends, and names of dots that mean nothing, are allowed.
    for name in ["...", "..x", "x..", ".hidden", "a b"] {
        world.vehicle.files.content.insert(format!("d/{name}"), vec![1]);
        assert_eq!(client.open(&mut world, &format!("//d/{name}/")), Ok(1), "{name}");
    }
}

/// F-32, F-9: a name that a client could not ask for is listed as `S`: a TAB in it would end it.
#[test]
fn names_without_a_spelling_are_skipped() {
    let (mut world, mut client) = (world(), client());
    for name in ["a\tb", "b\nc", "c\\d", "d:e", "e\x7f", "f", "l\u{e4}g", ".", ".."] {
        world.vehicle.files.content.insert(format!("odd/{name}"), vec![1]);
    }
    for (opcode, f) in
        [(MavFtpOpcode::LISTDIRECTORY, "Ff\t1"), (MavFtpOpcode::LISTDIRECTORYWITHTIME, "Ff\t1\t1700000000")]
    {
        let entries = list(&mut world, &mut client, opcode, "odd").unwrap();
        let named: Vec<_> = entries.iter().filter(|entry| *entry != "S").map(String::as_str).collect();
        assert_eq!((entries.len(), named), (9, vec![f]), "{entries:?}");
    }
}

/// F-1: an answer has no answer, and a request to everyone is none: the vehicle would answer for others.
#[test]
fn answers_and_broadcasts_are_ignored() {
    let (mut world, client) = (world(), client());
    for opcode in [MavFtpOpcode::ACK, MavFtpOpcode::NAK, MavFtpOpcode(200)] {
        client.send(&mut world, &request(1, 0, opcode, 1, 0, &[6]));
    }
    let mut to_all = request(1, 0, MavFtpOpcode::OPENFILERO, 7, 0, b"log.bin");
    to_all.target_system = 0;
    client.send(&mut world, &to_all);
    to_all.target_system = 9;
    client.send(&mut world, &to_all);
    assert_eq!(client.packets(&mut world), []);
    assert!(world.vehicle.files.open.is_empty());
}

/// F-11: nothing is answered on a high-latency link. MAVLink 1 carries files too.
#[test]
fn only_normal_links_carry_files() {
    let links = [
        LinkConfig::uart(921_600).with_class(LinkClass::HighLatency),
        LinkConfig::uart(921_600).with_version(TxVersion::V1).with_streams(StreamProfile::Off),
    ];
    let mut world = Shelf::of(Setup { links, ..Setup::new() });
    world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000));
    world.run_for(millis(10));
    let by_satellite = client();
    by_satellite.send(&mut world, &request(1, 0, MavFtpOpcode::OPENFILERO, 7, 0, b"log.bin"));
    assert_eq!(by_satellite.packets(&mut world), []);
    assert!(world.vehicle.files.open.is_empty());
    let mut old = Client::new(STATION, 1, 0);
    assert_eq!(old.open(&mut world, "log.bin"), Ok(1_000));
    assert_eq!(old.read(&mut world, 0, 239), Ok(pattern(1_000)[..239].to_vec()));
}

/// Q-9: the capability is announced by a vehicle that serves files, and by no other.
#[test]
fn capability_is_that_of_a_vehicle_with_files() {
    fn capabilities<D: mavstack::__private::Declares<Vehicle: Default>>() -> MavProtocolCapability {
        let mut world = World::<2, D>::of(Setup::new());
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.expect::<AutopilotVersion>(0, secs(1)).capabilities
    }
    assert!(capabilities::<Filed>().contains(MavProtocolCapability::FTP));
    assert!(!capabilities::<Tested>().contains(MavProtocolCapability::FTP));
}
