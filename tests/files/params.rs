//! `@PARAM/param.pck`: rules P-22, F-14.

use super::*;
use mavstack::dialect::{MavCmd, MavParamError, MavSeverity, ParamRequestList, ParamValue, Statustext};
use mavstack::param::{ParamInfo, RuntimeTable};
use mavstack::{Context, Files, Instant, ParamChange, Parameters, Vehicle, VehicleState};

const FILE: &str = "@PARAM/param.pck";

/// A parameter in a file: name, type, value as a float, and default.
type Entry = (String, u8, f64, Option<f64>);

/// Decodes a file as MAVProxy does (`param_ftp.py`). Returns the third word too.
fn decode(file: &[u8]) -> (Vec<Entry>, u16) {
    let word = |at: usize| u16::from_le_bytes([file[at], file[at + 1]]);
    assert!(word(0) == 0x671B || word(0) == 0x671C, "magic");
    let (mut data, mut entries, mut last) = (&file[6..], Vec::new(), Vec::<u8>::new());
    loop {
        while data.first() == Some(&0) {
            data = &data[1..];
        }
        if data.is_empty() {
            assert_eq!(entries.len(), usize::from(word(2)));
            return (entries, word(4));
        }
        let (kind, has_default) = (data[0] & 15, word(0) == 0x671C && data[0] & 0x10 != 0);
        let (common, len) = (usize::from(data[1] & 15), usize::from(data[1] >> 4) + 1);
        last.truncate(common);
        last.extend(&data[2..2 + len]);
        data = &data[2 + len..];
        let mut value = || {
            let (value, size) = match kind {
                1 => (f64::from(data[0] as i8), 1),
                2 => (f64::from(i16::from_le_bytes([data[0], data[1]])), 2),
                3 => (f64::from(i32::from_le_bytes([data[0], data[1], data[2], data[3]])), 4),
                4 => (f64::from(f32::from_le_bytes([data[0], data[1], data[2], data[3]])), 4),
                _ => panic!("type {kind}"),
            };
            data = &data[size..];
            value
        };
        let (now, default) = (value(), has_default.then(value));
        entries.push((String::from_utf8(last.clone()).unwrap(), kind, now, default));
    }
}

/// Encodes an upload as MAVProxy does.
fn encode(entries: &[(&str, u8, f64)]) -> Vec<u8> {
    let [count, high] = (entries.len() as u16).to_le_bytes();
    let (mut file, mut last) = (vec![0x1B, 0x67, count, high, 0, 0], "");
    for (name, kind, value) in entries {
        let common = name.bytes().zip(last.bytes()).take_while(|(a, b)| a == b).count();
        file.extend([*kind, (common | (name.len() - common - 1) << 4) as u8]);
        file.extend(name[common..].bytes());
        match kind {
            1 => file.extend((*value as i8).to_le_bytes()),
            2 => file.extend((*value as i16).to_le_bytes()),
            3 => file.extend((*value as i32).to_le_bytes()),
            _ => file.extend((*value as f32).to_le_bytes()),
        }
        last = name;
    }
    let len = (file.len() as u16).to_le_bytes();
    file[4..6].copy_from_slice(&len);
    file
}

/// Reads a whole file in pieces, from any offset.
fn fetch(world: &mut Shelf, client: &mut Client, path: &str, block: u8) -> Vec<u8> {
    client.open(world, path).unwrap();
    let mut file = Vec::new();
    while let Ok(data) = client.read(world, file.len() as u32, block) {
        file.extend(data);
    }
    file
}

/// P-22: the file has all parameters with their values; with defaults, if a client asks for them.
#[test]
fn file_has_all_parameters() {
    let (mut world, mut client) = (world(), client());
    world.stack.parameters_mut().set(Tuning::TRIM_ROLL, -17);
    world.stack.parameters_mut().set(Tuning::STAT_STARTS, 3_000_000_000);
    let expected = [
        ("BAT_LOW", 4, 10.5, 10.5),
        ("CRUISE", 4, 5.0, 5.0),
        ("FENCE_ACT", 3, 1.0, 1.0),
        ("LAND_SPEED", 4, f64::from(0.7f32), f64::from(0.7f32)),
        ("RTL_ALT", 4, 30.0, 30.0),
        ("STAT_STARTS", 4, 3_000_000_000.0, 0.0),
        ("SYS_ID", 2, 1.0, 1.0),
        ("TRIM_ROLL", 1, -17.0, -3.0),
        ("YAW_NOW", 4, 0.0, 0.0),
    ];
    let file = fetch(&mut world, &mut client, FILE, 239);
    let (entries, total) = decode(&file);
    assert_eq!(total, 9, "F-14");
    let plain = expected.map(|(name, kind, value, _)| (name.to_string(), kind, value, None));
    assert_eq!(entries, plain);
    assert_eq!(client.open(&mut world, FILE), Ok(file.len() as u32), "the size is right");
    assert!(file.len() <= 239, "one packet");

    let file = fetch(&mut world, &mut client, "@PARAM/param.pck?withdefaults=1", 239);
    let with_defaults = expected.map(|(name, kind, value, default)| (name.to_string(), kind, value, Some(default)));
    assert_eq!(decode(&file).0, with_defaults);
    let file = fetch(&mut world, &mut client, "@PARAM/param.pck?start=2&count=3", 239);
    let (entries, total) = decode(&file);
    assert_eq!((entries, total), (plain[2..5].to_vec(), 9));
    let file = fetch(&mut world, &mut client, "@PARAM/param.pck?start=7&count=30&withdefaults=0", 239);
    assert_eq!(decode(&file).0, plain[7..]);
    for query in ["start=9", "start=x", "count=70000", "start"] {
        let path = format!("{FILE}?{query}");
        assert_eq!(client.open(&mut world, &path), Err(MavFtpErr::FAIL), "{query}");
    }
}

/// P-22: any part can be read at any time, in packets of any length, and no value crosses the end of one.
#[test]
fn any_part_of_the_file_is_the_same() {
    let (mut world, mut client) = (world(), client());
    for block in [7, 16, 40, 80, 100, 239] {
        let file = fetch(&mut world, &mut client, "@PARAM/param.pck?withdefaults=1", block);
        let mut rng = Rng::new(u64::from(block));
        for _ in 0..100 {
            let (offset, size) = (rng.below(file.len() as u64) as usize, 1 + rng.below(239) as usize);
            let expected = &file[offset..file.len().min(offset + size)];
            assert_eq!(client.read(&mut world, offset as u32, size as u8).as_deref(), Ok(expected), "{block}");
        }
        assert_eq!(client.read(&mut world, file.len() as u32, block), Err(MavFtpErr::EOF));
        // A value that changes is not torn: of its bytes, all are in one packet.
        client.open(&mut world, FILE).unwrap();
        let mut torn = Vec::new();
        let mut value = 1.0;
        while let Ok(data) = client.read(&mut world, torn.len() as u32, block) {
            torn.extend(data);
            value = if value == 1.0 { f32::from_bits(0x3FAB_CDEF) } else { 1.0 };
            for param in [Tuning::LAND_SPEED, Tuning::CRUISE] {
                assert!(world.stack.parameters_mut().set(param, value));
            }
        }
        for (name, _, now, _) in decode(&torn).0 {
            let is_whole = [5.0, 0.7f32, 1.0, f32::from_bits(0x3FAB_CDEF)].map(f64::from).contains(&now);
            assert!(!matches!(&*name, "LAND_SPEED" | "CRUISE") || is_whole || block < 16, "{name} {now} {block}");
        }
    }
}

/// Returns the length of the file that its directory tells.
fn listed(world: &mut Shelf, client: &mut Client) -> u32 {
    let entries = client.path(world, MavFtpOpcode::LISTDIRECTORY, "@PARAM").unwrap();
    let entry = String::from_utf8(entries).unwrap();
    entry.strip_prefix("Fparam.pck\t").unwrap().trim_end_matches('\0').parse().unwrap()
}

/// F-30: the directory and the open file tell one length, and reads of any length bring exactly so many bytes. What is behind the
/// parameters are zeros, which decoders skip.
#[test]
fn file_has_one_length() {
    let (mut world, mut client) = (world(), client());
    let size = listed(&mut world, &mut client);
    let expected = decode(&fetch(&mut world, &mut client, FILE, 239));
    for block in 1..=239 {
        assert_eq!(client.open(&mut world, FILE), Ok(size));
        let file = fetch(&mut world, &mut client, FILE, block);
        assert_eq!((file.len() as u32, decode(&file)), (size, expected.clone()), "{block}");
    }
    for query in ["?withdefaults=1", "?start=3", "?start=1&count=2"] {
        let path = format!("{FILE}{query}");
        let size = client.open(&mut world, &path).unwrap();
        for block in [5, 80, 239] {
            assert_eq!(fetch(&mut world, &mut client, &path, block).len() as u32, size, "{query} {block}");
        }
    }
}

/// F-30, F-8: a burst of any length of packets brings exactly as many bytes as the open file has, and says so in the last packet,
/// full or not.
#[test]
fn bursts_end_at_the_length_of_the_file() {
    let (mut world, mut client) = (world(), client());
    let size = client.open(&mut world, FILE).unwrap();
    for block in [21, 33, 77, 100, 230, size as u8] {
        client.open(&mut world, FILE).unwrap();
        client.seq += 1;
        client.send(&mut world, &request(client.seq, 0, MavFtpOpcode::BURSTREADFILE, block, 0, &[]));
        let mut packets = client.packets(&mut world);
        client.seq += 40;
        let end = packets.pop().unwrap();
        assert_eq!((end.error(), end.is_last, end.offset), (Some(MavFtpErr::EOF), true, size), "{block}");
        let marks: Vec<_> = packets.iter().map(|packet| packet.is_last).collect();
        let last = marks.len() - 1;
        assert!(marks.iter().enumerate().all(|(place, mark)| *mark == (place == last)), "{block} {marks:?}");
        assert_eq!(packets.iter().map(|packet| packet.data.len()).sum::<usize>() as u32, size, "{block}");
        client.end(&mut world).unwrap();
    }
    assert!(size.is_multiple_of(21) && size.is_multiple_of(33) && size.is_multiple_of(77), "full last packets");
}

/// Returns the warnings that the first ground station has received.
fn warnings(world: &Shelf) -> Vec<String> {
    let texts = world.gcs[0].all::<Statustext>().into_iter().map(|(_, text)| text);
    texts.filter(|text| text.severity == MavSeverity::WARNING).map(|text| text.text.as_str().unwrap().into()).collect()
}

/// F-31: an upload that is one byte short is refused, however it ends: Terminate, Reset, silence, or another file in the session. A
/// text says so, and Terminate is answered NAK, also when it is repeated.
#[test]
fn short_upload_is_refused() {
    let text: &[&str] = if cfg!(feature = "plan-texts") { &["Upload ended early: nothing was changed"] } else { &[] };
    let file = encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 4, 7.25)]);
    for end in 0..5 {
        let (mut world, mut client) = (world(), client());
        client.create(&mut world, FILE).unwrap();
        if end != 4 {
            client.write(&mut world, 0, &file[..file.len() - 1]).unwrap();
        }
        world.gcs[0].forget();
        match end {
            0 | 4 => {
                assert_eq!(client.end(&mut world), Err(MavFtpErr::FAIL));
                assert_eq!(warnings(&world), text, "{end}");
                let again = client.repeat(&mut world, MavFtpOpcode::TERMINATESESSION, 0, 0, &[]);
                assert_eq!(again, Err(MavFtpErr::FAIL));
                world.run_for(millis(100));
                assert_eq!(warnings(&world), [""; 0], "once");
                assert_eq!(client.end(&mut world), Ok(vec![]), "F-7: the session is over");
            }
            1 => {
                assert_eq!(client.ask(&mut world, MavFtpOpcode::RESETSESSION, 0, 0, &[]), Ok(vec![]));
                assert_eq!(warnings(&world), text);
            }
            2 => {
                world.run_for(secs(9));
                assert_eq!(warnings(&world), text);
            }
            _ => {
                client.open(&mut world, "log.bin").unwrap();
                assert_eq!(warnings(&world), text);
            }
        }
        assert_eq!(world.stack.parameters().get(Tuning::BAT_LOW), 10.5);
        assert_eq!(world.stack.files().counters().refused_uploads, 1, "{end}");
        // A whole one is accepted then.
        client.create(&mut world, FILE).unwrap();
        assert_eq!(client.write(&mut world, 0, &file), Ok(vec![]));
        assert_eq!(client.end(&mut world), Ok(vec![]));
        assert_eq!(world.stack.parameters().get(Tuning::BAT_LOW), 11.0);
    }
}

/// F-31: a client that opens its upload again, before it has sent anything, has not lost anything.
#[test]
fn opening_an_upload_again_is_no_refusal() {
    let (mut world, mut client) = (world(), client());
    client.create(&mut world, FILE).unwrap();
    world.gcs[0].forget();
    client.create(&mut world, FILE).unwrap();
    assert_eq!((warnings(&world), world.stack.files().counters().refused_uploads), (vec![], 0));
}

/// P-14, F-14: an uploaded file sets all of its parameters, whatever types the client has chosen for the numbers. Each new value
/// is announced on all links.
#[test]
fn upload_sets_parameters() {
    let (mut world, mut client) = (world(), client());
    let file = encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 4, 7.25), ("FENCE_ACT", 4, 2.0), ("TRIM_ROLL", 3, -20.0)]);
    client.create(&mut world, FILE).unwrap();
    let (front, back) = file.split_at(20);
    assert_eq!(client.write(&mut world, 0, front), Ok(vec![]));
    assert_eq!(world.stack.parameters().get(Tuning::BAT_LOW), 10.5, "not before all of it is there");
    assert_eq!(client.write(&mut world, 20, back), Ok(vec![]));
    let tuning = world.stack.parameters();
    assert_eq!((tuning.get(Tuning::BAT_LOW), tuning.get(Tuning::CRUISE)), (11.0, 7.25));
    assert_eq!((tuning.get(Tuning::FENCE_ACT), tuning.get(Tuning::TRIM_ROLL)), (2, -20));
    world.run_for(millis(100));
    for gcs in &world.gcs {
        let names: Vec<_> = gcs.all::<ParamValue>().iter().map(|(_, value)| value.param_index).collect();
        assert_eq!(names, [0, 1, 2, 7]);
    }
    assert_eq!(client.end(&mut world), Ok(vec![]));
    assert_eq!(world.stack.files().counters().uploads, 1);
}

/// P-14: all or none: if one parameter is not right, nothing is set, and a text says which one it is.
#[test]
fn wrong_upload_changes_nothing() {
    for (case, text) in [
        (encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 4, 99.0)]), Some("CRUISE: out of range")),
        (encode(&[("BAT_LOW", 1, 11.0), ("STAT_STARTS", 1, 3.0)]), Some("STAT_STARTS: read-only")),
        (encode(&[("BAT_LOW", 1, 11.0), ("NONE", 1, 3.0)]), Some("NONE: no such parameter")),
        (encode(&[("BAT_LOW", 1, 11.0), ("FENCE_ACT", 4, 1.5)]), Some("FENCE_ACT: out of range")),
        (encode(&[("BAT_LOW", 1, 11.0), ("SYS_ID", 3, 300.0)]), Some("SYS_ID: out of range")),
        (encode(&[("BAT_LOW", 4, f64::NAN)]), Some("BAT_LOW: out of range")),
        (encode(&[("BAT_LOW", 1, 11.0), ("_HASH_CHECK", 1, 3.0)]), Some("_HASH_CHECK: no such parameter")),
        (encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 5, 3.0)]), None),
        ([&[0x1C, 0x67, 1, 0, 16, 0][..], &encode(&[("BAT_LOW", 1, 11.0)])[6..]].concat(), None),
        ([&[0x1B, 0x67, 2, 0, 16, 0][..], &encode(&[("BAT_LOW", 1, 11.0)])[6..]].concat(), None),
        ([&[0x1B, 0x67, 0, 0, 16, 0][..], &encode(&[("BAT_LOW", 1, 11.0)])[6..]].concat(), None),
        (vec![0x1B, 0x67, 1, 0, 16, 0, 1, 0xF3, b'B', b'A', 1, 1, 1, 1, 1, 1], None),
        (vec![0x1B, 0x67, 1, 0, 3, 0, 1], None),
    ] {
        let (mut world, mut client) = (world(), client());
        client.create(&mut world, FILE).unwrap();
        world.gcs[0].forget();
        let seq = client.seq;
        assert_eq!(client.write(&mut world, 0, &case), Err(MavFtpErr::FAIL), "{case:?}");
        let texts = world.gcs[0].all::<Statustext>();
        let texts: Vec<_> = texts.iter().map(|(_, t)| (t.severity, t.text.as_str().unwrap())).collect();
        let expected: Vec<_> = text.iter().map(|text| (MavSeverity::WARNING, *text)).collect();
        if cfg!(feature = "plan-texts") {
            assert_eq!(texts, expected, "{case:?}");
        }
        assert_eq!(
            client.repeat(&mut world, MavFtpOpcode::WRITEFILE, case.len() as u8, 0, &case),
            Err(MavFtpErr::FAIL)
        );
        assert_eq!(client.write(&mut world, 0, b"x"), Err(MavFtpErr::FAIL));
        assert_eq!(client.seq, seq + 2);
        let fresh = Tuning::new();
        assert_eq!(world.stack.parameters().get(Tuning::BAT_LOW), fresh.get(Tuning::BAT_LOW));
        assert_eq!(world.stack.files().counters().refused_uploads, 1);
        assert_eq!(world.stack.files().counters().uploads, 0);
    }
}

/// P-22: a file that equals the vehicle's changes nothing, read-only parameters included.
#[test]
fn upload_of_the_download_is_accepted() {
    let (mut world, mut client) = (world(), client());
    let mut file = fetch(&mut world, &mut client, FILE, 239);
    let len = (file.len() as u16).to_le_bytes();
    file[4..6].copy_from_slice(&len);
    client.create(&mut world, FILE).unwrap();
    assert_eq!(client.write(&mut world, 0, &file), Ok(vec![]));
    assert_eq!(world.stack.files().counters().uploads, 1);
    assert!(world.gcs[0].all::<ParamValue>().is_empty());
}

/// An upload that is cut off, larger than the room for it, or of a second client changes nothing.
#[test]
fn unfinished_upload_changes_nothing() {
    let (mut world, mut client) = (world(), client());
    let file = encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 4, 7.25)]);
    client.create(&mut world, FILE).unwrap();
    client.write(&mut world, 0, &file[..10]).unwrap();
    let mut other = Client { link: 1, ..client };
    assert_eq!(other.create(&mut world, FILE), Err(MavFtpErr::FILEPROTECTED), "one upload at a time");
    assert_eq!(other.read(&mut world, 0, 9), Err(MavFtpErr::INVALIDSESSION));
    assert_eq!(client.read(&mut world, 0, 9), Err(MavFtpErr::FAIL), "it is written");
    assert_eq!(client.end(&mut world), Err(MavFtpErr::FAIL), "F-31");
    assert_eq!(world.stack.parameters().get(Tuning::BAT_LOW), 10.5);
    other.create(&mut world, FILE).unwrap();
    for offset in (0..400).step_by(200) {
        let header = [0x1B, 0x67, 1, 0, 0xFF, 1];
        let mut part = vec![1; 200];
        if offset == 0 {
            part[..6].copy_from_slice(&header);
        }
        other.write(&mut world, offset, &part).unwrap();
    }
    assert_eq!(other.write(&mut world, 400, &[1; 200]), Err(MavFtpErr::FAIL), "512 bytes at most");
    assert_eq!(client.create(&mut world, "@PARAM/param.pck?start=1"), Err(MavFtpErr::FILEPROTECTED));
}

/// A part that comes too early is not taken: the client sends it again, as MAVProxy does. One that comes again changes nothing.
#[test]
fn parts_of_an_upload_are_taken_in_order() {
    let (mut world, mut client) = (world(), client());
    let file = encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 4, 7.25)]);
    client.create(&mut world, FILE).unwrap();
    client.send(&mut world, &request(50, 0, MavFtpOpcode::WRITEFILE, 5, 10, &file[10..15]));
    assert_eq!(client.packets(&mut world), []);
    client.write(&mut world, 0, &file[..10]).unwrap();
    client.write(&mut world, 0, &[9; 10]).unwrap();
    client.write(&mut world, 10, &file[10..]).unwrap();
    assert_eq!(world.stack.parameters().get(Tuning::CRUISE), 7.25);
}

/// F-6: a checksum fails when another client uploads, so that no upload waits for it: when the upload begins, and again when it is
/// complete. Parts between leave it running.
#[test]
fn upload_does_not_wait_for_a_checksum() {
    use MavFtpOpcode as Op;
    let (mut world, mut client, mut other) = (world(), client(), Client::new(OTHER_STATION, 1, 0));
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(4_000_000));
    let failed = |world: &Shelf| {
        let answers = world.gcs[0].all::<FileTransferProtocol>();
        answers.iter().map(|(_, message)| Packet::of(message).error()).collect::<Vec<_>>()
    };
    world.gcs[0].forget();
    client.send(&mut world, &request(60, 0, Op::CALCFILECRC, 7, 0, b"big.bin"));
    assert_eq!(other.create(&mut world, FILE), Ok(vec![0; 4]));
    assert_eq!(failed(&world), [Some(MavFtpErr::FAIL)]);

    let whole = encode(&[("BAT_LOW", 1, 11.0), ("CRUISE", 4, 7.25)]);
    let (first, last) = whole.split_at(9);
    client.send(&mut world, &request(61, 0, Op::CALCFILECRC, 7, 0, b"big.bin"));
    assert_eq!(other.write(&mut world, 0, first), Ok(vec![]));
    assert_eq!(failed(&world), [Some(MavFtpErr::FAIL)]);
    assert_eq!(world.vehicle.files.open.len(), 1, "it is being computed");
    assert_eq!(other.write(&mut world, 9, last), Ok(vec![]));
    assert_eq!(failed(&world), [Some(MavFtpErr::FAIL); 2]);
    assert!(world.vehicle.files.open.is_empty());
    assert_eq!(world.stack.parameters().get(Tuning::CRUISE), 7.25);
    client.seq = 62;
    assert!(client.path(&mut world, Op::CALCFILECRC, "log.bin").is_ok());
}

/// A vehicle without room for an upload has a file that can only be read.
#[test]
fn upload_needs_room() {
    #[derive(mavstack::Stack)]
    #[stack(
        vehicle: TestVehicle,
        links: 1,
        parameters: Tuning,
        commands: { slots: 2 },
        files: { sessions: 1 },
    )]
    struct ReadOnly;
    let mut world = World::<1, ReadOnly>::of(Setup::new());
    world.run_for(millis(10));
    world.gcs[0].send(&request(1, 0, MavFtpOpcode::CREATEFILE, FILE.len() as u8, 0, FILE.as_bytes()));
    let answer: FileTransferProtocol = world.expect(0, millis(100));
    assert_eq!(Packet::of(&answer).error(), Some(MavFtpErr::FILEPROTECTED));
}

/// A vehicle with 52 parameters.
#[derive(Default)]
struct Tuned;

plain_vehicle!(Tuned);

impl Parameters for Tuned {
    type Table = RuntimeTable<MANY>;
}

impl Files for Tuned {}

/// As many parameters as large autopilots have.
const MANY: usize = 1_000;

#[derive(mavstack::Stack)]
#[stack(vehicle: Tuned, links: 1, parameters: RuntimeTable<MANY>, files: { sessions: 1 })]
struct Large;

/// Downloads parameters over a radio of 57,600 baud: returns the times as a file and as a list (ms).
fn file_and_list(count: usize, loss: f64) -> (u64, u64) {
    let faults = Faults { frame_loss: loss, ..Faults::default() };
    let mut line = LineConfig::radio(57_600, millis(20));
    (line.up.faults, line.down.faults) = (faults, faults);
    let mut world = World::<1, Large>::of(Setup { links: [LinkConfig::uart(57_600)], lines: [line], ..Setup::new() });
    for number in 0..count {
        let name = format!("{}_GAIN_{number}", ["ROLL", "PITCH", "YAW", "ALT"][number * 4 / count]);
        let info = ParamInfo::new(&name, number as f32 / 70.0, 0.0..=100.0).expect("a parameter");
        world.stack.parameters_mut().add(info).expect("room");
    }
    world.run_for(millis(1_500));
    let begin = world.now();
    let mut transfer = loss::download(mavstack_station::Client::MavProxy, STATION, FILE);
    assert!(world.run_until(secs(600), |world| transfer.poll(world.now(), &mut world.gcs[0]).is_some()));
    let by_file = world.now() - begin;
    assert_eq!(decode(transfer.output()).0.len(), count);
    let begin = world.now();
    world.gcs[0].forget();
    world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
    // A lost value is not sent again by itself: with loss, there is nothing to compare.
    let has_all = loss > 0.0 || world.run_until(secs(60), |world| world.gcs[0].count_of::<ParamValue>() == count);
    assert!(has_all, "the list is complete");
    (by_file.as_millis(), (world.now() - begin).as_millis())
}

/// P-22: on a radio of 57,600 baud, parameters take less than half the time as a file than as a list.
#[test]
fn file_is_faster_than_the_list() {
    for count in [52, MANY] {
        let (by_file, by_list) = file_and_list(count, 0.0);
        println!("{count} parameters: {by_file} ms as a file, {by_list} ms as a list");
        assert!(by_file * 2 < by_list, "{by_file} ms and {by_list} ms");
    }
}

/// P-22: a file also arrives over a line that loses a tenth of all frames.
#[test]
fn file_arrives_over_a_lossy_line() {
    file_and_list(52, 0.1);
}

/// A vehicle that notes when it is asked for which parameters, and told of which. It permits no change while it is armed.
#[derive(Default)]
struct Noting {
    is_armed: bool,
    asked: Vec<(Instant, u16)>,
    changed: Vec<(Instant, u16)>,
}

impl Vehicle for Noting {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.is_armed))
    }
}

without_commands!(Noting);

impl Parameters for Noting {
    type Table = RuntimeTable<HUGE>;

    fn may_set(&mut self, cx: &mut Context<'_>, change: &ParamChange<Self::Table>) -> Result<(), MavParamError> {
        self.asked.push((cx.now(), change.index()));
        if self.is_armed { Err(MavParamError::PERMISSION_DENIED) } else { Ok(()) }
    }

    fn parameter_changed(&mut self, cx: &mut Context<'_>, change: &ParamChange<Self::Table>) {
        self.changed.push((cx.now(), change.index()));
    }
}

impl Files for Noting {}

/// So many parameters have a file of 16 kB.
const HUGE: usize = 2_300;

#[derive(mavstack::Stack)]
#[stack(vehicle: Noting, links: 1, parameters: RuntimeTable<HUGE>, operator_control, files: { sessions: 1, upload: 16_500 })]
struct Huge;

/// Sends a file with new values for all parameters, up to the last packet, and then that one and the end of the session at once. Returns
/// the world before it handles these two.
fn uploaded() -> World<1, Huge> {
    uploaded_of(HUGE, |_| {})
}

/// The same with so many parameters, which the caller may change before.
fn uploaded_of(count: usize, prepare: impl FnOnce(&mut [ParamInfo])) -> World<1, Huge> {
    let links = [LinkConfig::uart(921_600).with_streams(StreamProfile::Off)];
    let mut world = World::<1, Huge>::of(Setup { links, ..Setup::new() });
    let names: Vec<_> = (0..count).map(|number| format!("P{number:04}")).collect();
    let mut infos: Vec<_> =
        names.iter().map(|name| ParamInfo::new(name, 1.0, 0.0..=9.0).expect("a parameter")).collect();
    prepare(&mut infos);
    let value = |info: &ParamInfo| if info.is_read_only() { 1.0 } else { 2.5 };
    let entries: Vec<_> = names.iter().zip(&infos).map(|(name, info)| (&**name, 4, value(info))).collect();
    let file = encode(&entries);
    assert!(count < HUGE || (16_000..16_500).contains(&file.len()), "{}", file.len());
    infos.into_iter().for_each(|info| world.stack.parameters_mut().add(info).map(drop).expect("room"));
    world.run_for(millis(100));
    let packets = file.chunks(239).count();
    let ask = |world: &mut World<1, Huge>, seq, opcode, offset, data: &[u8]| {
        world.gcs[0].send(&request(seq, 0, opcode, data.len() as u8, offset, data));
    };
    ask(&mut world, 1, MavFtpOpcode::CREATEFILE, 0, FILE.as_bytes());
    for (number, data) in file.chunks(239).enumerate() {
        let answer: FileTransferProtocol = world.expect(0, millis(100));
        assert_eq!(Packet::of(&answer).error(), None);
        ask(&mut world, 2 + number as u16, MavFtpOpcode::WRITEFILE, 239 * number as u32, data);
    }
    ask(&mut world, 2 + packets as u16, MavFtpOpcode::TERMINATESESSION, 0, &[]);
    world
}

/// Returns how many hooks were called at most at one time, which is one poll of the stack and of its link.
fn most(vehicle: &Noting) -> usize {
    let calls = vehicle.asked.iter().chain(&vehicle.changed);
    let mut at = std::collections::BTreeMap::<_, usize>::new();
    calls.for_each(|(time, _)| *at.entry(*time).or_default() += 1);
    at.into_values().max().unwrap_or(0)
}

/// a file of 16 kB with 2,300 new values: one poll called 4,600 hooks, and now at most 32. All are set, each with one pair of calls.
/// The last packet, and the end of the session right behind it, are answered after the last call.
#[test]
fn one_poll_calls_32_hooks() {
    let mut world = uploaded();
    let mut answers = Vec::new();
    while answers.len() < 2 {
        world.run_for(millis(1));
        while let Some((_, message)) = world.gcs[0].take::<FileTransferProtocol>() {
            let packet = Packet::of(&message);
            assert_eq!((packet.error(), world.vehicle.changed.len()), (None, HUGE), "{:?}", packet.request);
            answers.push(packet.request);
        }
        assert!(world.now() < Instant::from_millis(20_000), "it never ends");
    }
    assert_eq!(answers, [MavFtpOpcode::WRITEFILE, MavFtpOpcode::TERMINATESESSION]);
    let most = most(&world.vehicle);
    println!("{most} hooks at most, {} polls", 2 * HUGE / most);
    assert!(most <= 32, "{most} hooks in one poll");
    let all: Vec<_> = (0..HUGE as u16).collect();
    let indices = |calls: &[(Instant, u16)]| calls.iter().map(|(_, index)| *index).collect::<Vec<_>>();
    assert_eq!([indices(&world.vehicle.asked), indices(&world.vehicle.changed)], [all.clone(), all]);
    let bits = |index| world.stack.parameters().bits(index);
    assert!((0..HUGE as u16).all(|index| bits(index) == Some(2.5f32.to_bits())));
}

/// X-6, P-22: a vehicle that arms while it is asked for the values of a file is asked again, and refuses all of them.
#[test]
fn permission_ends_when_the_vehicle_arms() {
    let mut world = uploaded();
    while world.vehicle.asked.len() < HUGE / 2 {
        world.run_for(millis(1));
    }
    world.vehicle.is_armed = true;
    let answer: FileTransferProtocol = world.expect(0, millis(500));
    assert_eq!(Packet::of(&answer).error(), Some(MavFtpErr::FAIL));
    let answer: FileTransferProtocol = world.expect(0, millis(500));
    assert_eq!(
        (Packet::of(&answer).request, Packet::of(&answer).error()),
        (MavFtpOpcode::TERMINATESESSION, Some(MavFtpErr::FAIL))
    );
    assert_eq!(world.vehicle.changed, []);
    assert_eq!(world.stack.files().counters().refused_uploads, 1);
}

/// another system takes control while the vehicle is asked for the values of a file: none of them is set. Before, all 2,300 were.
#[test]
fn upload_ends_when_another_system_takes_control() {
    let mut world = uploaded();
    while world.vehicle.asked.len() < HUGE / 2 {
        world.run_for(millis(1));
    }
    let request = world.gcs[0].long(MavCmd(32_100), [1.0, 1.0, 10.0, 254.0, 0.0, 0.0, 0.0]);
    world.gcs[0].takes_unknown = true;
    world.gcs[0].send_from(OTHER_STATION, &Gcs::heartbeat());
    world.gcs[0].send_from(OTHER_STATION, &request);
    world.run_for(millis(500));
    let now = world.now();
    assert_eq!(world.stack.operator(now), Some(OTHER_STATION.system));
    world.run_for(secs(2));
    assert_eq!(world.vehicle.changed.len(), 0);
    assert_eq!(world.stack.files().counters().refused_uploads, 1);
}

/// X-6, P-22: a read-only value that the vehicle changes after it was checked keeps no other from being set. Before, the file ended there,
/// with half of its values set.
#[test]
fn all_values_are_set_if_a_read_only_one_changes() {
    const COUNT: usize = 80;
    let mut world = uploaded_of(COUNT, |infos| infos[COUNT / 2] = infos[COUNT / 2].read_only());
    while world.vehicle.changed.is_empty() {
        world.run_for(millis(1));
    }
    assert!(world.vehicle.changed.len() < COUNT / 2);
    assert!(world.stack.parameters_mut().set_bits(COUNT as u16 / 2, 7.0f32.to_bits()));
    let answer: FileTransferProtocol = world.expect(0, millis(500));
    assert_eq!((Packet::of(&answer).error(), world.vehicle.changed.len()), (None, COUNT - 1));
    assert_eq!(world.stack.parameters().bits(COUNT as u16 / 2), Some(7.0f32.to_bits()));
}
