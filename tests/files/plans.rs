//! `@MISSION`: rules F-20 to F-26.

use super::*;
use crate::support::plan_file::{HEADER, ITEM, decode, encode, file, path};
use mavstack::dialect::{
    MavCmd, MavFrame, MavMissionResult, MavMissionType, MavSeverity, MissionAck, MissionClearAll, MissionCount,
    MissionItemInt, Statustext,
};
use mavstack::plan::PlanView;
use mavstack::{Duration, PlanType};
use mavstack_station::Client as Real;
use proptest::prelude::{any, prop_assert, prop_assert_eq, proptest};

const MISSION: &str = "@MISSION/mission.dat";

/// Returns a plan of any kind: waypoints, circles or rally points.
pub(super) fn items(kind: PlanType, count: u16, variant: u16) -> Vec<MissionItemInt> {
    let of_kind = |item| match kind {
        PlanType::Mission => item,
        _ => {
            let is_fence = kind == PlanType::Fence;
            let command = if is_fence { MavCmd::NAV_FENCE_CIRCLE_INCLUSION } else { MavCmd::NAV_RALLY_POINT };
            let (mission_type, frame) = (kind.mission_type(), MavFrame::GLOBAL_RELATIVE_ALT);
            let param1 = f32::from(variant + 1);
            MissionItemInt { mission_type, command, frame, param1, param2: 0.0, param4: 0.0, current: 0, ..item }
        }
    };
    plan(count, variant).into_iter().map(of_kind).collect()
}

/// Returns items without the fields that belong to a transfer.
fn content(items: &[MissionItemInt]) -> Vec<u8> {
    let plain = |item: &MissionItemInt| MissionItemInt { target_system: 0, target_component: 0, current: 0, ..*item };
    encode([0; 5], &items.iter().map(plain).collect::<Vec<_>>())
}

/// Returns the plan that is downloaded by messages.
fn downloaded(world: &mut Shelf, kind: PlanType) -> Vec<u8> {
    content(&world.download(0, kind.mission_type()).expect("a download"))
}

/// Returns the live plan.
fn live(world: &Shelf, kind: PlanType) -> PlanView<'_> {
    match kind {
        PlanType::Mission => world.stack.mission(),
        PlanType::Fence => world.stack.fence(),
        PlanType::Rally => world.stack.rally(),
    }
}

/// Reads the file of a plan in packets of this length.
fn get(world: &mut Shelf, client: &mut Client, kind: PlanType, block: u8) -> Vec<u8> {
    let size = client.open(world, path(kind)).expect("a file");
    let mut file = Vec::new();
    while let Ok(data) = client.read(world, file.len() as u32, block) {
        file.extend(data);
    }
    assert_eq!(file.len() as u32, size, "F-20");
    file
}

/// Uploads a file in packets of this length, and ends the session. If the file is not whole, that is refused (F-31).
fn put(world: &mut Shelf, client: &mut Client, path: &str, file: &[u8], block: usize) -> Result<(), MavFtpErr> {
    let mut result = client.create(world, path).map(|_| ());
    for (number, part) in file.chunks(block).enumerate() {
        if result.is_ok() {
            result = client.write(world, (number * block) as u32, part).map(|_| ());
        }
    }
    let end = client.end(world).map(|_| ());
    result.and(end)
}

/// Returns the warnings that a ground station has received.
fn warnings(world: &Shelf) -> Vec<String> {
    let texts = world.gcs[0].all::<Statustext>().into_iter().map(|(_, text)| text);
    texts.filter(|text| text.severity == MavSeverity::WARNING).map(|text| text.text.as_str().unwrap().into()).collect()
}

/// F-20, F-23: what is uploaded by messages is in the file, and what is uploaded as a file is downloaded by messages, byte for
/// byte and with the same id. Each plan can be filled; an empty file clears it.
#[test]
fn plans_go_both_ways() {
    let (mut world, mut client) = (world(), client());
    for (kind, capacity) in PlanType::ALL.into_iter().zip([60, 20, 6]) {
        for (count, block) in [(capacity, 239), (1, 80), (3, 7)] {
            let of_messages = items(kind, count, 1);
            let id = world.upload(0, &of_messages).expect("accepted").opaque_id;
            let file_of_messages = get(&mut world, &mut client, kind, block as u8);
            let (mission_type, found) = decode(&file_of_messages);
            assert_eq!(mission_type, kind.mission_type());
            assert_eq!(content(&found), content(&of_messages));

            let of_file = items(kind, count, 2);
            assert_eq!(put(&mut world, &mut client, path(kind), &file(kind, &of_file), block), Ok(()));
            assert_eq!(downloaded(&mut world, kind), content(&of_file));
            assert_ne!(live(&world, kind).id(), id);
            assert_eq!(put(&mut world, &mut client, path(kind), &file_of_messages, block), Ok(()));
            assert_eq!((downloaded(&mut world, kind), live(&world, kind).id()), (content(&of_messages), id));
        }
    }
    for kind in PlanType::ALL {
        assert_eq!(put(&mut world, &mut client, path(kind), &file(kind, &[]), 239), Ok(()));
        assert_eq!(live(&world, kind).items().len(), 0);
        assert_eq!(get(&mut world, &mut client, kind, 239), file(kind, &[]));
    }
    assert_eq!(world.gcs[0].count_of::<MissionAck>(), 0, "an upload as a file is not answered by a message");
    assert_eq!(world.stack.files().counters().uploads, 21);
}

/// F-21: any part of a file can be read, and the item that is flown is marked, as in a download by messages.
#[test]
fn any_part_of_a_plan_is_the_same() {
    let (mut world, mut client) = (world(), client());
    world.upload(0, &items(PlanType::Mission, 60, 1)).expect("accepted");
    world.vehicle.progress.current = 41;
    let whole = get(&mut world, &mut client, PlanType::Mission, 239);
    let marked: Vec<_> = decode(&whole).1.iter().filter(|item| item.current == 1).map(|item| item.seq).collect();
    assert_eq!(marked, [41]);
    let mut rng = Rng::new(7);
    for _ in 0..300 {
        let (offset, size) = (rng.below(whole.len() as u64) as usize, 1 + rng.below(239) as usize);
        let expected = &whole[offset..whole.len().min(offset + size)];
        assert_eq!(client.read(&mut world, offset as u32, size as u8).as_deref(), Ok(expected), "{offset} {size}");
    }
    for offset in [whole.len() as u32, whole.len() as u32 + 38, u32::MAX] {
        assert_eq!(client.read(&mut world, offset, 239), Err(MavFtpErr::EOF));
    }
}

/// F-22: a client never mixes two plans. Its file ends when another plan goes live; the same plan once more is no other plan.
#[test]
fn file_ends_when_the_plan_changes() {
    let (mut world, mut client) = (world(), client());
    world.upload(0, &items(PlanType::Mission, 60, 1)).expect("accepted");
    client.open(&mut world, MISSION).unwrap();
    let begin = client.read(&mut world, 0, 239).unwrap();
    world.upload(1, &items(PlanType::Mission, 60, 1)).expect("accepted");
    world.upload(1, &items(PlanType::Fence, 3, 1)).expect("accepted");
    assert_eq!(client.read(&mut world, 0, 239), Ok(begin));
    world.upload(1, &items(PlanType::Mission, 60, 2)).expect("accepted");
    assert_eq!(client.read(&mut world, 239, 239), Err(MavFtpErr::FAIL));
    client.send(&mut world, &request(900, 0, MavFtpOpcode::BURSTREADFILE, 239, 239, &[]));
    let errors: Vec<_> = client.packets(&mut world).iter().map(Packet::error).collect();
    assert_eq!(errors, [Some(MavFtpErr::FAIL)]);
    let (_, found) = decode(&get(&mut world, &mut client, PlanType::Mission, 239));
    assert_eq!(content(&found), content(&items(PlanType::Mission, 60, 2)));
}

/// F-23, F-25: a file that is not right is refused, nothing changes, and a text says why, as for an upload by messages.
#[test]
fn wrong_plan_changes_nothing() {
    let good = items(PlanType::Mission, 4, 2);
    let with = |seq: usize, change: fn(&mut MissionItemInt)| {
        let mut items = good.clone();
        change(&mut items[seq]);
        file(PlanType::Mission, &items)
    };
    let header = |header: [u16; 5]| encode(header, &good);
    let not_consistent = "Mission refused: not consistent";
    let cases = [
        (with(2, |item| item.command = MavCmd(31_999)), "Mission item 2: command not supported"),
        (with(1, |item| (item.x, item.y) = (0, 0)), "Mission item 1: no position (0, 0)"),
        (with(3, |item| item.frame = MavFrame::LOCAL_NED), "Mission item 3: frame not supported"),
        (
            with(3, |item| (item.command, item.param1, item.x, item.y) = (MavCmd::DO_JUMP, 9.0, 0, 0)),
            "Mission item 3: parameter 1 out of range",
        ),
        // A command without a position has plain numbers there: a client has scaled these (M-75).
        (
            with(3, |item| (item.command, item.param1) = (MavCmd::DO_JUMP, 1.0)),
            "Mission item 3: parameter 5 out of range",
        ),
        (with(1, |item| item.mission_type = MavMissionType::FENCE), not_consistent),
        (with(1, |item| item.current = 2), not_consistent),
        (file(PlanType::Mission, &items(PlanType::Mission, 61, 1)), "Mission refused: too many items"),
        (file(PlanType::Fence, &items(PlanType::Fence, 4, 1)), not_consistent),
        (header([0x763C, 0, 0, 0, 4]), not_consistent),
        (header([0x763D, 0, 1, 0, 4]), not_consistent),
        (header([0x763D, 0, 0, 1, 4]), not_consistent),
        (header([0x763D, 256, 0, 0, 4]), not_consistent),
        (header([0x763D, 0, 0, 0, 3]), not_consistent),
        (header([0x763D, 0, 0, 0, 0]), not_consistent),
        (header([0x763D, 0, 0, 0, u16::MAX]), "Mission refused: too many items"),
    ];
    for (number, (case, text)) in cases.iter().enumerate() {
        let (mut world, mut client) = (world(), client());
        let old = items(PlanType::Mission, 5, 1);
        let id = world.upload(0, &old).expect("accepted").opaque_id;
        world.gcs[0].forget();
        client.create(&mut world, MISSION).unwrap();
        let result = client.write(&mut world, 0, &case[..case.len().min(239)]);
        assert_eq!(result, Err(MavFtpErr::FAIL), "case {number}");
        if cfg!(feature = "plan-texts") {
            assert_eq!(warnings(&world), [*text], "case {number}");
        }
        assert_eq!(client.write(&mut world, 239, &[1; 9]), Err(MavFtpErr::FAIL), "case {number}");
        assert_eq!(world.stack.plan_counters().refused, 1, "case {number}");
        // The staging area is free at once.
        world.upload(0, &items(PlanType::Fence, 2, 1)).expect("accepted");
        assert_eq!(
            (downloaded(&mut world, PlanType::Mission), live(&world, PlanType::Mission).id()),
            (content(&old), id)
        );
        client.end(&mut world).unwrap();
        assert_eq!(put(&mut world, &mut client, MISSION, &file(PlanType::Mission, &good), 239), Ok(()));
    }
}

/// F-23: the vehicle decides as for an upload by messages: when it begins, for each item, and for the whole plan.
#[test]
fn vehicle_may_refuse() {
    let (mut world, mut client) = (world(), client());
    let whole = file(PlanType::Mission, &items(PlanType::Mission, 4, 1));
    world.vehicle.may_change = Err(MavMissionResult::DENIED);
    assert_eq!(client.create(&mut world, MISSION), Err(MavFtpErr::FAIL));
    assert_eq!(client.write(&mut world, 0, &whole), Err(MavFtpErr::INVALIDSESSION), "it is closed");
    world.vehicle.may_change = Ok(());
    client.create(&mut world, MISSION).unwrap();
    client.write(&mut world, 0, &whole[..100]).unwrap();
    world.vehicle.may_change = Err(MavMissionResult::DENIED);
    assert_eq!(client.write(&mut world, 100, &whole[100..]), Err(MavFtpErr::FAIL), "M-45: it has armed meanwhile");
    client.end(&mut world).unwrap();
    world.vehicle.may_change = Ok(());
    world.vehicle.bad_items.insert(2, MavMissionResult::INVALID_PARAM3);
    assert_eq!(put(&mut world, &mut client, MISSION, &whole, 239), Err(MavFtpErr::FAIL));
    world.vehicle.bad_items.clear();
    world.vehicle.plan_verdict = Err(MavMissionResult::INVALID);
    assert_eq!(put(&mut world, &mut client, MISSION, &whole, 239), Err(MavFtpErr::FAIL));
    assert!(world.vehicle.plan_changes().is_empty());
    world.vehicle.plan_verdict = Ok(());
    let mut marked = items(PlanType::Mission, 4, 1);
    (marked[0].current, marked[2].current) = (0, 1);
    assert_eq!(put(&mut world, &mut client, MISSION, &file(PlanType::Mission, &marked), 239), Ok(()));
    let changes = world.vehicle.plan_changes();
    assert_eq!((changes.len(), changes[0].1.len(), changes[0].2), (1, 4, 2), "it starts from the marked item");
    // A clear, too.
    client.create(&mut world, MISSION).unwrap();
    world.vehicle.may_change = Err(MavMissionResult::DENIED);
    assert_eq!(client.write(&mut world, 0, &file(PlanType::Mission, &[])), Err(MavFtpErr::FAIL));
    assert_eq!(live(&world, PlanType::Mission).items().len(), 4);
}

/// F-24: uploads by messages and as files exclude each other, of the same client too.
#[test]
fn one_upload_at_a_time() {
    let (mut world, mut client) = (world(), client());
    let (target_system, target_component) = (1, 1);
    let count = MissionCount { target_system, target_component, count: 3, ..MissionCount::default() };
    world.gcs[1].send(&count);
    world.run_for(millis(20));
    assert_eq!(client.create(&mut world, "@MISSION/fence.dat"), Err(MavFtpErr::FAIL));
    let cancel = MavMissionResult::OPERATION_CANCELLED;
    world.gcs[1].send(&MissionAck { target_system, target_component, r#type: cancel, ..MissionAck::default() });
    world.run_for(millis(20));

    let whole = file(PlanType::Mission, &items(PlanType::Mission, 4, 1));
    client.create(&mut world, MISSION).unwrap();
    client.write(&mut world, 0, &whole[..100]).unwrap();
    let mut other = Client { link: 1, ..client };
    assert_eq!(other.create(&mut world, MISSION), Err(MavFtpErr::FILEPROTECTED));
    for link in [0, 1] {
        world.gcs[link].forget();
        world.gcs[link].send(&count);
        let ack: MissionAck = world.expect(link, millis(100));
        assert_eq!(ack.r#type, MavMissionResult::DENIED);
        world.gcs[link].send(&MissionClearAll { target_system, target_component, ..MissionClearAll::default() });
        let ack: MissionAck = world.expect(link, millis(100));
        assert_eq!(ack.r#type, MavMissionResult::DENIED);
        world.gcs[link].send(&MissionItemInt { target_system, target_component, ..items(PlanType::Mission, 4, 1)[2] });
        world.run_for(millis(20));
    }
    client.write(&mut world, 100, &whole[100..]).unwrap();
    assert_eq!(live(&world, PlanType::Mission).items().len(), 4);
    world.upload(1, &items(PlanType::Mission, 5, 1)).expect("free before the session ends");
}

/// F-26: an upload that is not completed changes nothing. The staging area is free when its session ends, by its client, by
/// another file in it, or after ten seconds of silence.
#[test]
fn dead_client_leaves_the_old_plan() {
    let (mut world, mut client) = (world(), client());
    let old = items(PlanType::Mission, 5, 1);
    world.upload(0, &old).expect("accepted");
    let whole = file(PlanType::Mission, &items(PlanType::Mission, 40, 2));
    let ends: [fn(&mut Shelf, &mut Client); 4] = [
        |world, client| assert_eq!(client.end(world), Err(MavFtpErr::FAIL), "F-31"),
        |world, client| assert!(client.open(world, "log.bin").is_ok()),
        |world, client| assert!(client.ask(world, MavFtpOpcode::RESETSESSION, 0, 0, &[]).is_ok()),
        |world, _| world.run_for(secs(11)),
    ];
    for (number, end) in ends.iter().enumerate() {
        for parts in [0, 1, 3] {
            client.create(&mut world, MISSION).unwrap();
            for (number, part) in whole.chunks(200).take(parts).enumerate() {
                client.write(&mut world, number as u32 * 200, part).unwrap();
            }
            let refused = world.upload(1, &items(PlanType::Fence, 2, parts as u16));
            assert_eq!(refused, Err(TransferError::Refused(MavMissionResult::DENIED)), "end {number}");
            end(&mut world, &mut client);
            assert_eq!(downloaded(&mut world, PlanType::Mission), content(&old));
            world.upload(1, &items(PlanType::Fence, 2, parts as u16)).expect("the staging area is free");
        }
    }
    // A client that ends its session right behind the last part has uploaded the plan.
    client.create(&mut world, MISSION).unwrap();
    let short = file(PlanType::Mission, &items(PlanType::Mission, 3, 2));
    client.send(&mut world, &request(700, 0, MavFtpOpcode::WRITEFILE, short.len() as u8, 0, &short));
    client.send(&mut world, &request(701, 0, MavFtpOpcode::TERMINATESESSION, 0, 0, &[]));
    client.packets(&mut world);
    assert_eq!(live(&world, PlanType::Mission).items().len(), 3);
    world.upload(1, &items(PlanType::Mission, 5, 1)).expect("the staging area is free");
}

/// F-26: an upload that its client closes before it has begun is refused, and a file that the client has opened since stays open.
#[test]
fn closed_upload_leaves_the_next_file_open() {
    use MavFtpOpcode as Op;
    let (mut world, mut client) = (world(), client());
    let requests: [(Op, &[u8]); 3] =
        [(Op::CREATEFILE, MISSION.as_bytes()), (Op::TERMINATESESSION, b""), (Op::OPENFILERO, b"log.bin")];
    for (seq, (opcode, data)) in (10..).zip(requests) {
        client.send(&mut world, &request(seq, 0, opcode, data.len() as u8, 0, data));
    }
    let answers = client.packets(&mut world);
    let errors: Vec<_> = answers.iter().map(|packet| (packet.request, packet.error())).collect();
    let refused = (Op::CREATEFILE, Some(MavFtpErr::FAIL));
    assert_eq!(errors, [refused, (Op::TERMINATESESSION, None), (Op::OPENFILERO, None)]);
    assert_eq!(client.read(&mut world, 0, 239), Ok(pattern(1_000)[..239].to_vec()));
    world.upload(1, &items(PlanType::Mission, 5, 1)).expect("the staging area is free");
}

/// F-26, M-41: an upload that receives no part is closed after eight seconds, whatever else its client requests; then other uploads
/// are taken. One that makes progress is not closed.
#[test]
fn stalled_upload_is_closed() {
    let whole = file(PlanType::Mission, &items(PlanType::Mission, 4, 1));
    for parts in [0, 1] {
        let (mut world, mut client) = (world(), client());
        let mut other = Client { link: 1, ..client };
        client.create(&mut world, MISSION).unwrap();
        for (number, part) in whole.chunks(100).take(parts).enumerate() {
            world.run_for(millis(7_000));
            client.write(&mut world, number as u32 * 100, part).unwrap();
        }
        let since = world.now();
        while world.now() < since + millis(7_600) {
            world.run_for(millis(500));
            client.path(&mut world, MavFtpOpcode::LISTDIRECTORY, "/").unwrap();
            if parts > 0 {
                // It was taken already.
                client.write(&mut world, 0, &whole[..100]).unwrap();
            }
        }
        let refused = world.upload(1, &items(PlanType::Fence, 2, 1));
        assert_eq!(refused, Err(TransferError::Refused(MavMissionResult::DENIED)), "{parts}");
        if parts == 0 {
            // One that is slow for ten seconds gives way to another file, and for fifteen to messages.
            assert_eq!(other.create(&mut world, "@PARAM/param.pck"), Err(MavFtpErr::FILEPROTECTED));
        }
        world.run_for(millis(400));
        world.upload(1, &items(PlanType::Fence, 2, 1)).expect("the staging area is free");
        assert_eq!(client.write(&mut world, 100, &whole[100..]), Err(MavFtpErr::INVALIDSESSION), "{parts}");
        assert_eq!(world.stack.files().counters().timed_out, 1, "{parts}");
        assert!(other.create(&mut world, "@PARAM/param.pck").is_ok(), "{parts}");
        assert_eq!(other.end(&mut world), Err(MavFtpErr::FAIL), "F-31: nothing has arrived");
        assert_eq!(put(&mut world, &mut client, MISSION, &whole, 239), Ok(()), "{parts}");
    }
}

/// F-23: parts are taken in order. One that comes too early is dropped, one that comes again changes nothing, and five that come at
/// once, as from MAVProxy, are all taken.
#[test]
fn parts_of_a_plan_are_taken_in_order() {
    let (mut world, mut client) = (world(), client());
    let plan = items(PlanType::Mission, 30, 3);
    let whole = file(PlanType::Mission, &plan);
    client.create(&mut world, MISSION).unwrap();
    let parts: Vec<_> = whole.chunks(80).enumerate().collect();
    let part = |seq: u16, number: usize| {
        let (_, part) = parts[number];
        request(seq, 0, MavFtpOpcode::WRITEFILE, part.len() as u8, number as u32 * 80, part)
    };
    client.send(&mut world, &part(100, 1));
    assert_eq!(client.packets(&mut world), []);
    for (seq, numbers) in [(200, 0..5), (300, 3..8), (400, 8..10), (500, 5..10)] {
        for number in numbers.clone() {
            client.send(&mut world, &part(seq + number as u16, number));
        }
        let answers: Vec<_> = client.packets(&mut world).iter().map(|packet| (packet.opcode, packet.offset)).collect();
        let expected: Vec<_> = numbers.map(|number| (MavFtpOpcode::ACK, number as u32 * 80)).collect();
        assert_eq!(answers, expected);
    }
    assert_eq!(live(&world, PlanType::Mission).items().len(), 0, "not before all of it is there");
    for number in 10..parts.len() {
        client.send(&mut world, &part(600 + number as u16, number));
    }
    client.packets(&mut world);
    assert_eq!(downloaded(&mut world, PlanType::Mission), content(&plan));
    assert_eq!(world.vehicle.plan_changes().len(), 1);
}

/// F-20: without `upload` plans can only be read, and a plan without memory has no file.
#[test]
fn upload_of_plans_needs_room() {
    #[derive(mavstack::Stack)]
    #[stack(
        vehicle: TestVehicle,
        links: 1,
        plans: { mission: 3 },
        parameters: Tuning,
        commands: { slots: 3 },
        files: { sessions: 1 },
    )]
    struct ReadOnly;
    let mut world = World::<1, ReadOnly>::of(Setup::new());
    world.run_for(millis(10));
    let requests = [
        (MavFtpOpcode::CREATEFILE, MISSION, Some(MavFtpErr::FILEPROTECTED)),
        (MavFtpOpcode::OPENFILERO, MISSION, None),
        (MavFtpOpcode::OPENFILERO, "@MISSION/fence.dat", Some(MavFtpErr::FILENOTFOUND)),
        (MavFtpOpcode::OPENFILERO, "@MISSION/mission.da", Some(MavFtpErr::FILENOTFOUND)),
        (MavFtpOpcode::OPENFILERO, "@MISSION/", Some(MavFtpErr::FILENOTFOUND)),
    ];
    for (seq, (opcode, path, error)) in requests.into_iter().enumerate() {
        world.gcs[0].send(&request(seq as u16 * 2, 0, opcode, path.len() as u8, 0, path.as_bytes()));
        let answer: FileTransferProtocol = world.expect(0, millis(100));
        assert_eq!(Packet::of(&answer).error(), error, "{path}");
    }
}

/// F-21, F-23: over a line that loses up to a fifth of all frames, duplicates and reorders some, plans arrive both ways.
#[test]
fn plans_survive_loss() {
    for (loss, disorder) in [(0.0, 0.0), (0.1, 0.1), (0.2, 0.1)] {
        for (seed, kind) in (1..).zip(PlanType::ALL) {
            let client = if kind == PlanType::Fence { Real::Pymavlink } else { Real::MavProxy };
            let mut world = loss::lossy(loss::line(loss, disorder), seed);
            let plan = items(kind, [60, 20, 6][seed as usize - 1], 1);
            let bytes = file(kind, &plan);
            let took = loss::run(&mut world, &mut [(0, loss::upload(client, path(kind), &bytes))]);
            assert!(took < Duration::from_secs(60), "{took:?}");
            let mut down = [(0, loss::download(client, STATION, path(kind)))];
            loss::run(&mut world, &mut down);
            assert_eq!(content(&decode(down[0].1.output()).1), content(&plan));
            assert_eq!(downloaded(&mut world, kind), content(&plan));
        }
    }
}

proptest! {
    #![proptest_config(cases(60))]

    /// F-23: whatever a client writes, the plan is the old one or exactly what is in the file, and afterwards the staging area is
    /// free.
    #[test]
    fn any_file_is_taken_whole_or_not_at_all(
        kind in 0..3usize,
        count in 0..7u16,
        block in 1..240usize,
        damage in proptest::collection::vec((any::<u16>(), any::<u8>()), 0..3),
        cut in 0..50usize,
    ) {
        let (mut world, mut client) = (world(), client());
        let kind = PlanType::ALL[kind];
        let old = items(kind, 2, 9);
        world.upload(0, &old).expect("accepted");
        let mut bytes = file(kind, &items(kind, count, 1));
        for (at, value) in damage {
            let at = usize::from(at) % bytes.len();
            bytes[at] = value;
        }
        bytes.truncate(bytes.len() - cut.saturating_sub(40).min(bytes.len()));
        let is_whole = bytes.len() >= HEADER
            && bytes.len() == HEADER + ITEM * usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        let result = put(&mut world, &mut client, path(kind), &bytes, block);
        let now = downloaded(&mut world, kind);
        prop_assert!(is_whole || result.is_err(), "F-31");
        if now != content(&old) {
            prop_assert!(result.is_ok() && is_whole);
            let (of, found) = decode(&bytes);
            let numbered = |(seq, item): (u16, &MissionItemInt)| MissionItemInt { seq, ..*item };
            let found: Vec<_> = (0..).zip(&found).map(numbered).collect();
            prop_assert_eq!((of, now), (kind.mission_type(), content(&found)));
        }
        world.upload(0, &items(kind, 3, 8)).expect("the staging area is free");
    }
}
