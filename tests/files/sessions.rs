//! Sessions: rules F-4, F-6, F-7, F-12, F-13.

use super::*;
use proptest::prelude::*;

const OTHER: Client = Client::new(OTHER_STATION, 0, 0);

/// F-4, F-13: a repeated request is answered again, and is not carried out again.
#[test]
fn repeated_request_is_carried_out_once() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    let opened = client.open(&mut world, "log.bin").unwrap().to_le_bytes().to_vec();
    assert_eq!(client.repeat(&mut world, Op::OPENFILERO, 7, 0, b"log.bin"), Ok(opened));
    assert_eq!(world.vehicle.files.open.len(), 1);
    let data = client.read(&mut world, 5, 9);
    assert_eq!(client.repeat(&mut world, Op::READFILE, 9, 5, &[]), data);
    assert_eq!(client.end(&mut world), Ok(vec![]));
    assert_eq!(client.repeat(&mut world, Op::TERMINATESESSION, 0, 0, &[]), Ok(vec![]));

    for (opcode, offset, data) in [
        (Op::REMOVEFILE, 0, &b"log.bin"[..]),
        (Op::CREATEDIRECTORY, 0, b"d"),
        (Op::REMOVEDIRECTORY, 0, b"d"),
        (Op::REMOVEFILE, 0, b"missing"),
    ] {
        let changes = world.vehicle.files.changes;
        let answer = client.ask(&mut world, opcode, data.len() as u8, offset, data);
        for _ in 0..3 {
            assert_eq!(client.repeat(&mut world, opcode, data.len() as u8, offset, data), answer, "{opcode:?}");
        }
        assert_eq!(world.vehicle.files.changes, changes + 1, "{opcode:?}");
    }
    client.create(&mut world, "new").unwrap();
    client.write(&mut world, 0, b"abc").unwrap();
    assert_eq!(client.repeat(&mut world, Op::WRITEFILE, 3, 0, b"abc"), Ok(vec![]));
    assert_eq!(world.vehicle.files.writes, 1);
    // A refused write is refused again.
    assert_eq!(client.write(&mut world, 2_000_000, b"x"), Err(MavFtpErr::FAIL));
    assert_eq!(client.repeat(&mut world, Op::WRITEFILE, 1, 2_000_000, b"x"), Err(MavFtpErr::FAIL));
    assert_eq!(world.vehicle.files.writes, 2);
    // F-13: the same number, and other content: it is another request.
    client.seq -= 1;
    assert_eq!(client.write(&mut world, 0, b"xyz"), Ok(vec![]));
    assert_eq!(world.vehicle.files.content["new"], b"xyz");
}

/// F-4: a delayed duplicate of what has opened a file, or ended a session before, does no harm.
#[test]
fn delayed_duplicates_are_harmless() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    client.create(&mut world, "new").unwrap();
    let create = request(client.seq, 0, Op::CREATEFILE, 3, 0, b"new");
    for offset in 0..9 {
        client.write(&mut world, offset, b"a").unwrap();
    }
    client.send(&mut world, &create);
    assert_eq!(client.packets(&mut world).len(), 1, "answered again");
    assert_eq!(world.vehicle.files.content["new"], b"aaaaaaaaa");
    client.end(&mut world).unwrap();
    let end = request(client.seq, 0, Op::TERMINATESESSION, 0, 0, &[]);
    client.open(&mut world, "log.bin").unwrap();
    client.send(&mut world, &end);
    assert_eq!(client.packets(&mut world).len(), 1, "answered again");
    assert!(client.read(&mut world, 0, 9).is_ok());
}

/// F-13: a client that begins each operation with the number 0, as MAVSDK did, sends identical requests that are new. Each is carried
/// out.
#[test]
fn identical_requests_of_a_new_operation_are_carried_out() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    let mut ask = |world: &mut Shelf, seq: u16, opcode: Op, size: u8, data: &[u8]| {
        client.seq = seq;
        client.repeat(world, opcode, size, 0, data)
    };
    for round in 0..3 {
        assert!(ask(&mut world, 0, Op::OPENFILERO, 7, b"log.bin").is_ok());
        assert_eq!(ask(&mut world, 1, Op::READFILE, 3, b""), Ok(pattern(3)));
        assert_eq!(ask(&mut world, 2, Op::TERMINATESESSION, 0, b""), Ok(vec![]));
        assert!(world.vehicle.files.open.is_empty(), "{round}: closed");

        let changes = world.vehicle.files.changes;
        assert_eq!(ask(&mut world, 0, Op::CREATEDIRECTORY, 1, b"d"), Ok(vec![]));
        assert_eq!(ask(&mut world, 0, Op::REMOVEDIRECTORY, 1, b"d"), Ok(vec![]));
        assert_eq!(world.vehicle.files.changes, changes + 2, "{round}");
    }
    let mut sums = [b"abc", b"xyz"].map(|content| {
        world.vehicle.files.content.insert("log.bin".to_string(), content.to_vec());
        ask(&mut world, 0, Op::CALCFILECRC, 7, b"log.bin").unwrap()
    });
    sums.sort();
    assert_ne!(sums[0], sums[1], "the file has changed");
}

/// F-13: a client that was started again after two seconds, in the middle of an upload, sends an identical request to begin. The file is
/// the new one alone: no tail of the old one is left.
#[test]
fn client_that_was_started_again_begins_again() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    for content in [&b"a long file"[..], b"short"] {
        client.seq = 0;
        assert_eq!(client.repeat(&mut world, Op::CREATEFILE, 3, 0, b"new"), Ok(vec![0; 4]));
        client.write(&mut world, 0, content).unwrap();
        assert_eq!(world.vehicle.files.content["new"], content);
        assert_eq!(world.vehicle.files.open.len(), 1);
        world.run_for(millis(2_000));
    }
}

/// F-4: numbers wrap.
#[test]
fn sequence_numbers_wrap() {
    let (mut world, mut client) = (world(), client());
    client.seq = u16::MAX - 2;
    client.open(&mut world, "log.bin").unwrap();
    client.read(&mut world, 0, 1).unwrap();
    client.read(&mut world, 0, 1).unwrap();
    assert_eq!(client.seq, 0);
    client.send(&mut world, &request(65_534, 0, MavFtpOpcode::BURSTREADFILE, 239, 0, &[]));
    let seqs: Vec<_> = client.packets(&mut world).iter().map(|packet| packet.seq).collect();
    assert_eq!(seqs, [65_535, 0, 1, 2, 3, 4]);
}

/// F-6, F-12: a session belongs to a client, its link, and its number.
#[test]
fn session_belongs_to_client_link_and_number() {
    let (mut world, mut client) = (world(), client());
    client.open(&mut world, "log.bin").unwrap();
    for mut other in [OTHER, Client { link: 1, ..client }, Client { session: 1, ..client }] {
        assert_eq!(other.read(&mut world, 0, 1), Err(MavFtpErr::INVALIDSESSION), "{other:?}");
        assert_eq!(other.end(&mut world), Ok(vec![]));
        assert_eq!(other.ask(&mut world, MavFtpOpcode::RESETSESSION, 0, 0, &[]), Ok(vec![]));
        if other.address == client.address && other.link == client.link {
            assert_eq!(client.read(&mut world, 0, 1), Err(MavFtpErr::INVALIDSESSION), "it has reset all of its own");
        } else {
            assert!(client.read(&mut world, 0, 1).is_ok(), "{other:?} must not end it");
        }
    }
}

/// F-6: of three clients, the third one gets a session when another is idle for three seconds. The file of the other one is closed
/// before: the vehicle never has more open files than there are sessions.
#[test]
fn idle_session_is_taken_over() {
    let (mut world, mut first, mut second) = (world(), client(), OTHER);
    let mut third = Client::new(Address::new(77, 1), 1, 5);
    world.vehicle.files.room = Some(2);
    first.open(&mut world, "log.bin").unwrap();
    second.open(&mut world, "log.bin").unwrap();
    assert_eq!(third.open(&mut world, "log.bin"), Err(MavFtpErr::NOSESSIONSAVAILABLE));
    assert_eq!(third.open(&mut world, "missing"), Err(MavFtpErr::NOSESSIONSAVAILABLE));
    world.run_for(millis(2_700));
    second.read(&mut world, 0, 1).unwrap();
    assert_eq!(third.open(&mut world, "log.bin"), Err(MavFtpErr::NOSESSIONSAVAILABLE));
    world.run_for(millis(300));
    assert_eq!(third.open(&mut world, "log.bin"), Ok(1_000));
    assert_eq!(world.vehicle.files.open.len(), 2, "the file of the first one was closed");
    assert_eq!(first.read(&mut world, 0, 1), Err(MavFtpErr::INVALIDSESSION));
    assert!(second.read(&mut world, 0, 1).is_ok());
    let counters = world.stack.files().counters();
    assert_eq!((counters.opened, counters.taken_over, counters.no_session), (3, 1, 3));
    world.run_for(millis(3_000));
    assert_eq!(first.open(&mut world, "missing"), Err(MavFtpErr::FILENOTFOUND));
    assert_eq!(world.stack.files().counters().taken_over, 2);
    assert!(first.open(&mut world, "general.json").is_ok());
    assert_eq!(world.stack.files().counters().taken_over, 2, "a session is free");
}

/// F-6: a checksum does not keep the file that is open in its session: another client takes it over after three seconds.
#[test]
fn checksum_keeps_no_open_file() {
    use MavFtpOpcode as Op;
    let (mut world, mut first, mut second) = (world(), client(), OTHER);
    let mut third = Client::new(Address::new(77, 1), 1, 5);
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(4_000_000));
    first.open(&mut world, "log.bin").unwrap();
    first.send(&mut world, &request(60, 0, Op::CALCFILECRC, 7, 0, b"big.bin"));
    second.open(&mut world, "log.bin").unwrap();
    world.run_for(millis(2_700));
    second.read(&mut world, 0, 1).unwrap();
    assert_eq!(third.open(&mut world, "log.bin"), Err(MavFtpErr::NOSESSIONSAVAILABLE));
    world.run_for(millis(300));
    assert_eq!(third.open(&mut world, "log.bin"), Ok(1_000));
    assert_eq!(first.read(&mut world, 0, 1), Err(MavFtpErr::INVALIDSESSION));
    assert_eq!(world.vehicle.files.open.len(), 2, "the checksum has ended with it");
}

/// F-6: a client that vanishes keeps its session for ten seconds, or fifteen with a burst, whatever it was doing.
#[test]
fn dead_client_frees_its_session() {
    use MavFtpOpcode as Op;
    type Begun<'a> = (&'a str, &'a [(Op, u8, &'a [u8])]);
    let begun: [Begun<'_>; 6] = [
        ("opened", &[(Op::OPENFILERO, 7, b"log.bin")]),
        ("read", &[(Op::OPENFILERO, 7, b"log.bin"), (Op::READFILE, 9, b"")]),
        ("burst", &[(Op::OPENFILERO, 7, b"big.bin"), (Op::BURSTREADFILE, 239, b"")]),
        ("created", &[(Op::CREATEFILE, 3, b"new")]),
        ("written", &[(Op::CREATEFILE, 3, b"new"), (Op::WRITEFILE, 3, b"abc")]),
        ("checksum", &[(Op::CALCFILECRC, 7, b"big.bin")]),
    ];
    for (name, requests) in begun {
        let slow = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
        let lines = [LineConfig::radio(57_600, millis(20)); 2];
        let mut world = Shelf::of(Setup { links: [slow; 2], lines, ..Setup::new() });
        world.vehicle.files.content.insert("log.bin".to_string(), pattern(1_000));
        world.vehicle.files.content.insert("big.bin".to_string(), pattern(400_000));
        world.run_for(millis(100));
        let client = client();
        for (seq, (opcode, size, data)) in (0..).zip(requests) {
            client.send(&mut world, &request(seq, 0, *opcode, *size, 0, data));
        }
        assert_eq!(world.vehicle.files.open.len(), 1, "{name}");
        let bound = if name == "burst" { millis(15_200) } else { millis(10_100) };
        assert!(world.run_until(bound, |world| world.vehicle.files.open.is_empty()), "{name}: still open");
    }
}

/// F-6: a checksum ends with its session, so that it does not keep others from their uploads: when its client closes the session, resets
/// it or opens another file in it, or when its link is opened again. It has no answer then, and can be requested again.
#[test]
fn checksum_ends_with_its_session() {
    use MavFtpOpcode as Op;
    let ends: [fn(&mut Shelf, &mut Client); 4] = [
        |world, client| assert_eq!(client.end(world), Ok(vec![])),
        |world, client| assert_eq!(client.ask(world, Op::RESETSESSION, 0, 0, &[]), Ok(vec![])),
        |world, client| assert_eq!(client.open(world, "docs/licence.txt"), Ok(3)),
        |world, _| world.stack.restart_link(LinkId(0)),
    ];
    for (number, end) in ends.into_iter().enumerate() {
        let (mut world, mut client, mut other) = (world(), client(), Client { link: 1, ..OTHER });
        world.vehicle.files.content.insert("big.bin".to_string(), pattern(4_000_000));
        client.send(&mut world, &request(60, 0, Op::CALCFILECRC, 7, 0, b"big.bin"));
        other.send(&mut world, &request(60, 0, Op::CALCFILECRC, 7, 0, b"log.bin"));
        assert_eq!(other.packets(&mut world), [], "{number}: dropped, and the client sends it again");
        assert_eq!(world.vehicle.files.open.len(), 1, "{number}: it is being computed");
        end(&mut world, &mut client);
        world.run_for(millis(50));
        assert!(world.vehicle.files.open.is_empty(), "{number}");
        assert_eq!(other.create(&mut world, "@PARAM/param.pck"), Ok(vec![0; 4]), "{number}");
        let sum = client.path(&mut world, Op::CALCFILECRC, "docs/empty");
        assert_eq!(sum, Ok(vec![0; 4]), "{number}");
    }
}

/// F-6, F-13: a long checksum keeps its session for two minutes. A client that asks for it again with another number, as MAVSDK does,
/// gets the one answer to the last request.
#[test]
fn long_checksum_reaches_its_client() {
    use MavFtpOpcode as Op;
    let (mut world, client) = (world(), client());
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(4_000_000));
    world.gcs[0].forget();
    for (seq, wait) in [(1, 500), (2, 500), (3, 20_000)] {
        client.send(&mut world, &request(seq, 0, Op::CALCFILECRC, 7, 0, b"big.bin"));
        world.run_for(millis(wait));
    }
    let answers = world.gcs[0].all::<FileTransferProtocol>();
    let [(_, answer)] = &answers[..] else { panic!("one answer: {answers:?}") };
    let mut reference = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
    reference.digest(&pattern(4_000_000));
    let answer = Packet::of(answer);
    assert_eq!((answer.seq, answer.data), (4, reference.get_crc().to_le_bytes().to_vec()));

    // Of another file instead: the first one is given up.
    for (seq, path) in [(10, "big.bin"), (11, "log.bin")] {
        client.send(&mut world, &request(seq, 0, Op::CALCFILECRC, 7, 0, path.as_bytes()));
    }
    let answers = client.packets(&mut world);
    assert_eq!(answers.iter().map(|answer| answer.seq).collect::<Vec<_>>(), [12]);
    assert!(world.vehicle.files.open.is_empty());

    world.vehicle.files.content.insert("big.bin".to_string(), vec![7; 100_000_000]);
    client.send(&mut world, &request(20, 0, Op::CALCFILECRC, 7, 0, b"big.bin"));
    world.run_for(millis(120_000));
    assert_eq!(world.vehicle.files.open.len(), 1, "it is being computed");
    world.run_for(millis(10_100));
    assert!(world.vehicle.files.open.is_empty());
}

/// F-6: while a checksum is computed, virtual files whose size is known at once are opened, and read.
#[test]
fn checksum_does_not_delay_others() {
    let (mut world, client, mut other) = (world(), client(), Client { link: 1, ..OTHER });
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(4_000_000));
    client.send(&mut world, &request(60, 0, MavFtpOpcode::CALCFILECRC, 7, 0, b"big.bin"));
    for (path, size) in [("@MISSION/mission.dat", 10), ("@PARAM/param.pck", 231)] {
        assert_eq!(other.open(&mut world, path), Ok(size), "{path}");
        assert!(other.read(&mut world, 0, 239).is_ok(), "{path}");
    }
    assert_eq!(world.vehicle.files.open.len(), 1, "it is being computed");
}

/// PX4#28695, F-6: a session does not time out while a burst is sent to it.
#[test]
fn session_lives_while_a_burst_is_sent() {
    let slow = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
    let lines = [LineConfig::radio(57_600, millis(20)); 2];
    let mut world = Shelf::of(Setup { links: [slow; 2], lines, ..Setup::new() });
    world.vehicle.files.content.insert("big.bin".to_string(), pattern(400_000));
    world.run_for(millis(100));
    let mut client = client();
    client.open(&mut world, "big.bin").unwrap();
    world.run_for(millis(9_000));
    client.send(&mut world, &request(9, 0, MavFtpOpcode::BURSTREADFILE, 239, 0, &[]));
    world.run_for(millis(14_000));
    assert!(client.read(&mut world, 0, 1).is_ok());
    let last = world.gcs[0].all::<FileTransferProtocol>();
    assert!(!last.is_empty());
}

/// F-6: when a link is opened again, its clients are gone.
#[test]
fn opening_a_link_again_ends_its_sessions() {
    let (mut world, mut here, mut there) = (world(), client(), Client { link: 1, ..OTHER });
    here.open(&mut world, "log.bin").unwrap();
    there.open(&mut world, "log.bin").unwrap();
    here.send(&mut world, &request(60, 0, MavFtpOpcode::BURSTREADFILE, 239, 0, &[]));
    world.stack.restart_link(LinkId(0));
    assert_eq!(here.packets(&mut world), []);
    assert_eq!(world.vehicle.files.open.len(), 1);
    assert_eq!(here.read(&mut world, 0, 1), Err(MavFtpErr::INVALIDSESSION));
    assert!(there.read(&mut world, 0, 1).is_ok());
}

/// D-3: on a stalled link nothing that was accepted is lost. What there is no room for is dropped without effect, and counted.
#[test]
fn stalled_link_loses_no_answer() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    client.create(&mut world, "new").unwrap();
    let until = world.now() + millis(2_000);
    world.uarts[0].stall_writes_until(until);
    world.run_for(millis(100));
    for seq in 0..8u8 {
        client.send(&mut world, &request(100 + u16::from(seq), 0, Op::WRITEFILE, 1, u32::from(seq), &[seq + 1]));
    }
    assert_eq!(world.vehicle.files.content["new"], [1, 2, 3, 4, 5], "five at a time");
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().no_answer_slot, 3);
    world.gcs[0].forget();
    world.run_for(millis(2_500));
    let answers = world.gcs[0].all::<FileTransferProtocol>();
    let seqs: Vec<_> = answers.iter().map(|(_, message)| Packet::of(message).seq).collect();
    assert_eq!(seqs, [101, 102, 103, 104, 105]);
}

/// F-6: requests of many clients without sessions have two slots. The others are dropped, and counted.
#[test]
fn requests_without_a_slot_are_dropped() {
    let mut world = world();
    world.uarts[0].stall_writes_until(world.now() + millis(500));
    world.run_for(millis(100));
    for number in 0..6 {
        let client = Client::new(Address::new(10 + number, 1), 0, 0);
        client.send(&mut world, &request(1, 0, MavFtpOpcode::REMOVEFILE, 7, 0, b"log.bin"));
    }
    assert_eq!(world.vehicle.files.changes, 4, "two sessions, and two for answers");
    assert_eq!(world.stack.link_counters(LinkId(0)).unwrap().no_answer_slot, 2);
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Open(u8),
    Read(u8),
    Burst(u8),
    End(u8),
    Reset(u8),
    Repeat(u8),
    Wait(u64),
}

fn step() -> impl Strategy<Value = Step> {
    let client = 0..4u8;
    prop_oneof![
        client.clone().prop_map(Step::Open),
        client.clone().prop_map(Step::Read),
        client.clone().prop_map(Step::Burst),
        client.clone().prop_map(Step::End),
        client.clone().prop_map(Step::Reset),
        client.prop_map(Step::Repeat),
        prop::sample::select(&[1u64, 60, 1_000, 3_100, 10_100][..]).prop_map(Step::Wait),
    ]
}

proptest! {
    #![proptest_config(cases(60))]

    /// F-6, F-7: whatever four clients do, no more than two files are open, each is closed once, and none for longer than the
    /// time of an idle session.
    #[test]
    fn sessions_are_bounded(steps in prop::collection::vec(step(), 1..40)) {
        use MavFtpOpcode as Op;
        let mut world = world();
        let mut clients = [client(), OTHER, Client { link: 1, ..OTHER }, Client { session: 9, ..OTHER }];
        let mut last = [(Op::NONE, 0u8, &b""[..]); 4];
        for step in steps {
            let (number, what) = match step {
                Step::Open(number) => (number, Some((Op::OPENFILERO, 7, &b"log.bin"[..]))),
                Step::Read(number) => (number, Some((Op::READFILE, 9, &b""[..]))),
                Step::Burst(number) => (number, Some((Op::BURSTREADFILE, 239, &b""[..]))),
                Step::End(number) => (number, Some((Op::TERMINATESESSION, 0, &b""[..]))),
                Step::Reset(number) => (number, Some((Op::RESETSESSION, 0, &b""[..]))),
                Step::Repeat(number) => (number, None),
                Step::Wait(ms) => {
                    world.run_for(millis(ms));
                    prop_assert!(ms < 10_100 || world.vehicle.files.open.is_empty());
                    continue;
                }
            };
            let (client, last) = (&mut clients[usize::from(number)], &mut last[usize::from(number)]);
            if let Some(what) = what {
                *last = what;
                client.seq += 1;
            }
            let (opcode, size, data) = *last;
            client.send(&mut world, &request(client.seq, client.session, opcode, size, 0, data));
            prop_assert!(world.vehicle.files.open.len() <= 2);
        }
    }
}

/// answers that were pending on a link that takes no bytes held all sessions for ever, and none of a living link's requests
/// was answered. Now they are, and a file is opened after ten seconds.
#[test]
fn dead_link_holds_no_sessions() {
    use MavFtpOpcode as Op;
    let mut world = world();
    world.uarts[0].stall_writes_until(mavstack::Instant::NEVER);
    world.run_for(millis(50));
    let begin = world.now();
    let mut living = Client::new(OTHER_STATION, 1, 9);
    let mut answers = 0;
    for half_second in 0..40 {
        // It still receives: its clients repeat their requests.
        for number in (0..6).filter(|_| half_second % 4 == 0) {
            let gone = Client::new(Address::new(200, 1 + number), 0, number);
            gone.send(&mut world, &request(1, number, Op::OPENFILERO, 7, 0, b"log.bin"));
        }
        living.seq += 1;
        living.send(&mut world, &request(living.seq, 9, Op::OPENFILERO, 7, 0, b"log.bin"));
        // It is refused at first: a slow link keeps no sessions with answers, but the two files are still open.
        answers += living.packets(&mut world).iter().filter(|packet| packet.error().is_none()).count();
        if answers > 0 {
            break;
        }
        world.run_for(millis(450));
    }
    assert_eq!(answers, 1);
    assert!(world.now() - begin <= secs(11), "{:?}", world.now() - begin);
    assert_eq!(living.read(&mut world, 0, 9).unwrap(), pattern(9));
}

/// a link that takes bytes, however few, holds its sessions.
#[test]
fn slow_link_keeps_its_sessions() {
    let mut world = world();
    let mut slow = client();
    slow.open(&mut world, "log.bin").unwrap();
    for second in 0..12 {
        // Its transport takes bytes for a moment every five seconds.
        let stalls = second % 5 != 4;
        world.uarts[0].stall_writes_until(if stalls { world.now() + secs(1) } else { mavstack::Instant::ZERO });
        slow.send(&mut world, &request(900 + second, 0, MavFtpOpcode::READFILE, 9, 0, &[]));
        world.run_for(secs(1));
    }
    world.uarts[0].stall_writes_until(mavstack::Instant::ZERO);
    world.run_for(millis(100));
    assert!(slow.read(&mut world, 0, 9).is_ok(), "the file is still open");
}
