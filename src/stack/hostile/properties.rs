//! Floods of anything: rules.

use super::*;
use crate::config::LinkClass;
use crate::crc;
use crate::message::Dialect;

/// Sends a random message of the dialect with random content, mostly to this vehicle. Returns its length.
fn anything(field: &mut Field, random: &mut Random, link: usize, from: Address) -> usize {
    let rows = Common::MESSAGES.rows();
    let info = &rows[random.below(rows.len())];
    let mut payload: Vec<u8> = (0..info.max_len()).map(|_| random.next().to_le_bytes()[0]).collect();
    if random.below(4) > 0 {
        for at in [info.target_system(), info.target_component()].into_iter().flatten() {
            payload[usize::from(at)] = 1;
        }
    }
    let [a, b, c, _] = info.id().to_le_bytes();
    let (system, component) = (from.system.wire(), from.component.wire());
    let mut frame = vec![0xFD, info.max_len(), 0, 0, field.seq, system, component, a, b, c];
    frame.extend(payload);
    let sum = crc::checksum(&frame[1..], info.crc_extra());
    frame.extend(sum.to_le_bytes());
    field.receive(link, &frame);
    frame.len()
}

/// Sends a random request, or any message. Returns its length.
fn hostile(field: &mut Field, random: &mut Random, pool: &[Request], link: usize, from: Address) -> usize {
    if random.below(4) == 0 {
        return anything(field, random, link, from);
    }
    field.request(link, from, &pool[random.below(pool.len())])
}

/// whatever strangers flood a link with, one kind of request at a time or all of them, streams keep half of what they have
/// of a busy link, and others' requests have a tenth of it. No poll calls more than 32 hooks.
#[test]
fn floods_leave_a_busy_link_to_its_own() {
    const SECONDS: usize = 2;
    let pool = requests();
    let calm = flood(&mut prepared(), FAST, SECONDS, |_| 0);
    for seed in 0..12 {
        let mut random = Random(seed);
        let chosen: Vec<usize> = (0..4).map(|_| random.below(pool.len())).collect();
        let from = [STATION, STRANGER, Address::new(9, 1)];
        let mut field = prepared();
        let shares = flood(&mut field, FAST, SECONDS, |field| {
            let from = from[random.below(from.len())];
            if seed % 3 == 0 {
                return hostile(field, &mut random, &pool, ASKING, from);
            }
            field.request(ASKING, from, &pool[chosen[random.below(chosen.len())]])
        });
        assert!(field.hooks <= 32, "seed {seed}: {} hooks in a poll", field.hooks);
        check(&calm, &shares, SECONDS, &std::format!("seed {seed}"));
    }
}

const NEW_OWNER: Address = Address::new(254, 190);

/// A station requests control, and may let others take it over.
fn take_control(field: &mut Field, link: usize, from: Address, allows_takeover: bool) {
    let command = MavCmd(32_100);
    let (param2, param4) = (f32::from(u8::from(allows_takeover)), f32::from(from.system.wire()));
    let request = CommandLong { param1: 1.0, param2, param3: 10.0, param4, command, ..Default::default() };
    field.request(link, from, &of(CommandLong { target_system: 1, target_component: 1, ..request }));
    field.run_for(Duration::from_millis(40));
    assert_eq!(field.stack.operator(field.now), Some(from.system));
}

/// another station takes control while the former owner is doing anything. From then on nothing of the former owner's changes the
/// vehicle, what it has begun included, and the new owner's upload is taken at once. PARAM_SET is not among it: `Parameters::may_set`
/// decides about it.
#[test]
fn former_owner_changes_nothing() {
    let mut pool = requests();
    pool.retain(|request| request.name != "PARAM_SET");
    let mut allowed = 0;
    for seed in 0..24 {
        let mut random = Random(seed);
        let mut field = prepared();
        let beat = |field: &mut Field| {
            field.beat(ASKING, STATION);
            field.beat(IDLE, NEW_OWNER);
        };
        beat(&mut field);
        take_control(&mut field, ASKING, STATION, true);
        for _ in 0..40 {
            let request = &pool[random.below(pool.len())];
            // Images that are taken at an interval go on, whoever is in control.
            if !["REQUEST_OPERATOR_CONTROL", "IMAGE_START_CAPTURE"].contains(&request.name) {
                field.request(ASKING, STATION, request);
            }
            field.answer_with_item(ASKING, STATION);
            field.step();
        }
        beat(&mut field);
        take_control(&mut field, IDLE, NEW_OWNER, false);
        let before = field.rover.changes.len();
        allowed += before;
        for round in 0..300 {
            let sent = field.seq;
            hostile(&mut field, &mut random, &pool, ASKING, STATION);
            field.answer_with_item(ASKING, STATION);
            field.step();
            if round % 50 == 0 {
                beat(&mut field);
            }
            let changes = &field.rover.changes[before..];
            assert!(changes.is_empty(), "seed {seed}, round {round}, frames from {sent} on: {changes:?}");
        }
        assert_eq!(field.stack.operator(field.now), Some(NEW_OWNER.system), "seed {seed}");
        let (target_system, target_component) = (1, 1);
        let count = MissionCount { count: 3, target_system, target_component, ..MissionCount::default() };
        field.asked = [const { None }; LINKS];
        field.request(IDLE, NEW_OWNER, &of(count));
        for _ in 0..50 {
            field.answer_with_item(IDLE, NEW_OWNER);
            field.step();
        }
        assert_eq!(field.rover.changes[before..], ["plan_changed"], "seed {seed}");
        assert!(field.hooks <= 32, "seed {seed}: {} hooks in a poll", field.hooks);
    }
    assert!(allowed > 50, "{allowed} changes while it was in control");
}

/// What the vehicle was told of its companion in 15 s: a remote gimbal on a link that trusts our system, which moves and answers every
/// fifth request. With an `attack`, others send anything in its name on another link.
fn told(seed: u64, attack: Option<LinkConfig>, pool: &[Request]) -> Vec<std::string::String> {
    const PASSES: u16 = 750;
    let mut random = Random(seed);
    let mut field = Field::new([attack.unwrap_or(quiet(FAST)), quiet(FAST).with_own_system(true), quiet(SLOW)]);
    let gimbal = Heartbeat { r#type: MavType::GIMBAL, autopilot: MavAutopilot::INVALID, ..Heartbeat::default() };
    for pass in 0..PASSES {
        if pass % 50 == 0 {
            field.request(IDLE, COMPANION, &of(gimbal));
            field.beat(ASKING, STATION);
        }
        if pass % 10 == 0 {
            field.request(IDLE, COMPANION, &of(GimbalDeviceAttitudeStatus::default()));
        }
        let second = pass / 50;
        if pass % 50 == 20 && second % 5 == 0 {
            assert!(field.stack.send_command(COMPANION, second / 5));
        }
        if pass % 50 == 30 && second == 5 {
            let (result, command) = (MavResult::ACCEPTED, MavCmd(1));
            let (target_system, target_component) = (1, 1);
            let ack = CommandAck { command, result, target_system, target_component, ..CommandAck::default() };
            field.request(IDLE, COMPANION, &of(ack));
        }
        for _ in 0..if attack.is_some() { random.below(3) } else { 0 } {
            hostile(&mut field, &mut random, pool, ASKING, COMPANION);
        }
        field.step();
    }
    field.rover.told
}

/// whatever is sent in the name of a component of our system, on a link that does not trust our system, answers nothing that the
/// vehicle has asked, and tells nothing of the component.
#[test]
fn claims_on_other_links_count_for_nothing() {
    let pool = requests();
    let calm = told(0, None, &pool);
    let count = |what: &str| calm.iter().filter(|told| told.starts_with(what)).count();
    assert!(count("device_moved") >= 70 && count("command 1") == 1 && count("command 0: TimedOut") == 1, "{calm:?}");
    for seed in 0..12 {
        assert_eq!(told(seed, Some(quiet(FAST)), &pool), calm, "seed {seed}");
    }
    assert_ne!(told(0, Some(quiet(FAST).with_own_system(true)), &pool), calm, "on a link that does, they count");
}

/// L-17: whatever strangers flood a link with, a minute of it costs no more by satellite than the part of the burst that everyone has,
/// and a message by schedule.
#[test]
fn floods_cost_little_by_satellite() {
    const CREDIT: usize = 50;
    let mut pool = requests();
    // The one in control has more.
    pool.retain(|request| request.name != "REQUEST_OPERATOR_CONTROL");
    let satellite = LinkConfig::uart(SLOW * 10).with_class(LinkClass::HighLatency);
    for seed in 0..4 {
        let mut random = Random(seed);
        let mut field = Field::new([quiet(FAST), quiet(SLOW), satellite]);
        // A peer on that link, so that others may write to it.
        field.request(BUSY, WINGMAN, &command(MavCmd::NAV_LAND, [0.0; 3]));
        field.run_for(Duration::from_secs(2));
        field.sent.clear();
        for _ in 0..3_000 {
            let from = [STATION, STRANGER, Address::new(9, 1)];
            let from = from[random.below(from.len())];
            hostile(&mut field, &mut random, &pool, ASKING, from);
            let (target_system, target_component) = (WINGMAN.system.wire(), WINGMAN.component.wire());
            field.request(ASKING, from, &of(CommandLong { target_system, target_component, ..Default::default() }));
            field.step();
        }
        let bytes = field.bytes(BUSY, |_| true);
        assert!((1..=(10 + 1 + 2) * CREDIT).contains(&bytes), "seed {seed}: {bytes} bytes");
    }
}

/// after strangers have done anything, one that was never there before is served within 20 s: a command, a parameter, a plan, a
/// file and the list of logs.
#[test]
fn a_late_station_is_served() {
    const LATE: Address = Address::new(200, 190);
    let pool = requests();
    let (target_system, target_component) = (1, 1);
    for seed in 0..8 {
        let mut random = Random(seed);
        let mut field = prepared();
        for _ in 0..1_000 {
            let from = Address::new(u8::try_from(2 + random.below(100)).expect("a system"), 190);
            hostile(&mut field, &mut random, &pool, ASKING, from);
            field.step();
        }
        let mission_type = MavMissionType::MISSION;
        let wanted = [
            (77, command(MavCmd::NAV_LAND, [0.0; 3])),
            (22, of(ParamRequestRead { param_index: 0, target_system, target_component, ..Default::default() })),
            (44, of(MissionRequestList { target_system, target_component, mission_type })),
            (110, file_request(0, MavFtpOpcode::OPENFILERO, "a")),
            (118, of(LogRequestList { start: 0, end: u16::MAX, target_system, target_component })),
        ];
        field.run_for(Duration::from_secs(1));
        field.sent.clear();
        for _ in 0..19 {
            for (_, request) in &wanted {
                field.request(IDLE, LATE, request);
            }
            field.run_for(Duration::from_secs(1));
        }
        for (answer, request) in &wanted {
            let is_answered = field.bytes(IDLE, |sent| sent.id == *answer) > 0;
            assert!(is_answered, "seed {seed}: {} is not answered", request.name);
        }
    }
}

/// on a link that its own peers flood at its rate, streams keep a fifth of what they have: lists and files may have the rest.
/// What changes the streams themselves is left out.
#[test]
fn floods_of_a_link_leave_its_streams_a_part() {
    let mut pool = requests();
    pool.retain(|request| !["SET_MESSAGE_INTERVAL", "REQUEST_DATA_STREAM", "RADIO_STATUS"].contains(&request.name));
    let calm = flood(&mut prepared(), SLOW, 1, |_| 0);
    for seed in 0..12 {
        let mut random = Random(seed);
        let chosen: Vec<usize> = (0..3).map(|_| random.below(pool.len())).collect();
        let mut field = prepared();
        let shares = flood(&mut field, SLOW, 1, |field| {
            field.request(BUSY, STRANGER, &pool[chosen[random.below(chosen.len())]])
        });
        let names: Vec<_> = chosen.iter().map(|number| pool[*number].name).collect();
        assert!(5 * shares.streams >= calm.streams, "{names:?}: {shares:?}, calm {calm:?}");
    }
}
