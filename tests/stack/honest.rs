//! Honest peers that look odd go on working, whatever holds off hostile ones: rules, J-10, G-9.
//!
//! Others are where their rooms are: a log download of an hour (`logs/downloads.rs`), a log stream of a flight (`logs/streaming.rs`),
//! commands by satellite in an emergency (`high_latency/budget.rs`), UDP stations that mostly listen (`links/udp.rs`), a survey
//! (`camera/capture.rs`), and answers over the second of two links (`commands/client_links.rs`).

use super::order::Loaded;
use crate::support::radio::{ELRS, ExpressLrs, MLRS, Mlrs, MlrsChannels};
use crate::support::*;
use mavstack::config::StreamProfile;
use mavstack::dialect::*;
use mavstack::manual_control::ControlSource;
use mavstack::{Address, Instant, LinkConfig, LinkId, Message, Peer, PlanType, Text};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 2,
    plans: { mission: 500 },
    parameters: Tuning,
    streams,
    commands: { slots: 3 },
    manual_control,
    operator_control,
)]
struct Flown {
    setpoints: mavstack::setpoints::Setpoints,
}

type Flight = World<2, Flown>;

const COMPANION: Address = Address::new(1, 191);
const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);
/// The id of the message, which is not in `common`.
const CONTROL_STATUS: u32 = 512;

/// Two fast links without streams.
fn flight() -> Flight {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let mut world = Flight::of(Setup { links: [link; 2], ..Setup::new() });
    world.run_for(millis(10));
    world
}

/// Invented ground stations send a HEARTBEAT each on a link.
fn crowd(gcs: &mut Gcs) {
    (1..=10).for_each(|system| gcs.send_from(Address::new(200 + system, 190), &Gcs::heartbeat()));
}

/// Sends a command, and returns its result.
fn command(world: &mut Flight, link: usize, from: Address, command: MavCmd, params: [f32; 4]) -> MavResult {
    let [a, b, c, d] = params;
    let message = world.gcs[link].long(command, [a, b, c, d, 0.0, 0.0, 0.0]);
    world.gcs[link].forget();
    world.gcs[link].send_from(from, &message);
    world.expect::<CommandAck>(link, millis(100)).result
}

/// scripts made with pymavlink send no HEARTBEAT, and some send as component 0. Parameters, plans and commands are theirs
/// all the same, also while others fill the table of peers.
#[test]
fn scripts_without_heartbeats() {
    for address in [STATION, Address::new(255, 0)] {
        let mut world = flight();
        crowd(&mut world.gcs[1]);
        world.run_for(millis(100));
        world.gcs[0].address = address;
        let (target_system, target_component) = (1, 1);
        world.gcs[0].send(&ParamRequestList { target_system, target_component });
        world.run_for(secs(1));
        assert_eq!(world.gcs[0].count_of::<ParamValue>(), 9, "{address:?}");
        world.gcs[0].forget();
        let (param_id, param_type) = (Text::new("CRUISE"), MavParamType::REAL32);
        world.gcs[0].send(&ParamSet { param_value: 7.5, target_system, target_component, param_id, param_type });
        assert_eq!(world.expect::<ParamValue>(0, millis(100)).param_value, 7.5, "{address:?}");
        let items = plan(20, 1);
        world.upload(0, &items).expect("the plan is taken");
        assert_eq!(world.download(0, MavMissionType::MISSION).expect("a plan").len(), 20, "{address:?}");
        assert_eq!(command(&mut world, 0, address, MavCmd::NAV_LAND, [0.0; 4]), MavResult::ACCEPTED, "{address:?}");
    }
}

/// J-10, X-1, X-9: receivers of ExpressLRS (255/68) and mLRS (51/68) send no HEARTBEAT. They steer all the time, while strangers on
/// another link fill the table of peers and send channels in their names.
#[test]
fn receivers_without_heartbeats() {
    for address in [ELRS, MLRS] {
        let mut world = flight();
        let receiver = Peer { address, link: LinkId(1) };
        world.stack.manual_input_mut().set_receivers(&[receiver]);
        let (mut elrs, mut mlrs) = (ExpressLrs::new(), Mlrs::new(MlrsChannels::Radio));
        for ms in 0..8_000 {
            let bytes = if address == ELRS { elrs.write(ms) } else { mlrs.write(ms) };
            world.gcs[1].send_raw(&bytes);
            if ms % 1_000 == 0 {
                crowd(&mut world.gcs[0]);
            }
            if ms % 20 == 0 {
                let forged = RcChannelsOverride { target_system: 1, chan1_raw: 1_900, ..RcChannelsOverride::default() };
                world.gcs[0].send_from(address, &forged);
            }
            world.step();
            let now = world.now();
            let channel = world.stack.manual_input().rc_channels(now).and_then(|channels| channels.channel(1));
            assert!(ms < 50 || channel == Some(1_500), "{address:?}, {ms} ms: {channel:?}");
        }
    }
}

/// G-9, X-1: a SiK radio (51/68) sends RADIO_STATUS and no HEARTBEAT. While its buffer is free, streams have their rate; while it is
/// full, they are slower; and then they have their rate again.
#[test]
fn radio_without_heartbeats() {
    let link = LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard);
    let mut world = Flight::of(Setup { links: [link; 2], ..Setup::new() });
    let mut attitudes = |txbuf: u8, seconds: u32| {
        for _ in 0..seconds {
            world.gcs[0].forget();
            world.gcs[0].send_from(MLRS, &RadioStatus { txbuf, ..RadioStatus::default() });
            world.run_for(secs(1));
        }
        world.gcs[0].count_of::<Attitude>()
    };
    assert!(attitudes(100, 3) >= 48);
    let slowed = attitudes(10, 3);
    assert!((5..48).contains(&slowed), "{slowed} of 50");
    let free = attitudes(100, 10);
    assert!(free >= 48, "{free} of 50");
}

/// a router withholds the HEARTBEATs of the companion. On a link that trusts our system, its commands, settings, plans
/// and setpoints count while a station is in control. On another link nobody has that in its name.
#[test]
fn companion_without_heartbeats() {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let links = [link, link.with_own_system(true)];
    let mut world = Flight::of(Setup { links, ..Setup::new() });
    world.stack.setpoints.set_source(ControlSource::System(VEHICLE.system));
    world.gcs[0].heartbeat_period = Some(secs(1));
    world.run_for(secs(1));
    let request = command(&mut world, 0, STATION, REQUEST_OPERATOR_CONTROL, [1.0, 0.0, 10.0, 255.0]);
    assert_eq!((request, world.stack.operator(world.now())), (MavResult::ACCEPTED, Some(STATION.system)));
    for (link, is_served) in [(1, true), (0, false)] {
        let expected = if is_served { MavResult::ACCEPTED } else { MavResult::NOT_IN_CONTROL };
        assert_eq!(command(&mut world, link, COMPANION, MavCmd::NAV_LAND, [0.0; 4]), expected, "link {link}");
        let (target_system, target_component) = (1, 1);
        world.gcs[link].send_from(
            COMPANION,
            &SetPositionTargetLocalNed {
                target_system,
                target_component,
                coordinate_frame: MavFrame::LOCAL_NED,
                ..Default::default()
            },
        );
        world.run_for(millis(10));
        let setpoint = world.stack.setpoints.current(world.now());
        assert_eq!(setpoint.is_some(), is_served, "link {link}");
        let station = core::mem::replace(&mut world.gcs[link].address, COMPANION);
        assert_eq!(world.upload(link, &plan(3, 1)).is_ok(), is_served, "link {link}");
        world.gcs[link].address = station;
        world.run_for(secs(2));
    }
}

/// on a radio that streams fill, a station sees within two seconds what another one changes elsewhere: all parameters, extended
/// parameters, who is in control, and the plan.
#[test]
fn watcher_sees_what_others_change() {
    let radio = LinkConfig::uart(57_600).with_streams(StreamProfile::Onboard);
    let fast = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let down = Wire { bytes_per_second: 5_760, tx_fifo: 512, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }, LineConfig::default()];
    let mut world = Loaded::of(Setup { links: [radio, fast], lines, ..Setup::new() });
    let (target_system, target_component) = (1, 1);
    for gcs in &mut world.gcs {
        gcs.heartbeat_period = Some(secs(1));
        gcs.takes_unknown = true;
    }
    world.gcs[1].address = OTHER_STATION;
    for id in [Attitude::ID, GlobalPositionInt::ID] {
        world.gcs[0].command_long(MavCmd::SET_MESSAGE_INTERVAL, [id as f32, 5_000.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(500));
    }
    for (name, value, param_type) in [
        ("BAT_LOW", 11.0, MavParamType::REAL32),
        ("CRUISE", 6.0, MavParamType::REAL32),
        ("LAND_SPEED", 0.5, MavParamType::REAL32),
        ("RTL_ALT", 40.0, MavParamType::REAL32),
    ]
    .repeat(2)
    {
        let param_id = Text::new(name);
        world.gcs[0].forget();
        world.gcs[1].send(&ParamSet { param_value: value, target_system, target_component, param_id, param_type });
        let seen: ParamValue = world.expect(0, secs(2));
        assert_eq!((seen.param_id.as_str(), seen.param_value), (Some(name), value));
    }
    let mut value = [0; 128];
    value[0] = 1;
    let param_value = Text::from_wire(value);
    let (param_id, param_type) = (Text::new("CAM_ISO"), MavParamExtType::UINT8);
    world.gcs[1].send(&ParamExtSet { target_system, target_component, param_id, param_value, param_type });
    assert_eq!(world.expect::<ParamExtAck>(0, secs(2)).param_result, ParamAck::ACCEPTED);
    world.gcs[0].forget();
    world.gcs[1].command_long(REQUEST_OPERATOR_CONTROL, [1.0, 0.0, 10.0, 254.0, 0.0, 0.0, 0.0]);
    world.run_for(secs(2));
    let is_status = |frame: &Received| frame.header.id == CONTROL_STATUS && frame.payload.contains(&254);
    assert!(world.gcs[0].received.iter().any(is_status), "CONTROL_STATUS");
    world.upload(1, &plan(3, 1)).expect("the plan is taken");
    world.gcs[0].forget();
    world.run_for(secs(2));
    let currents = world.gcs[0].all::<MissionCurrent>();
    assert_eq!(currents.last().map(|(_, current)| current.total), Some(3));
}

/// an upload of 500 items over 1,200 baud is whole, though another station asks for an upload every second.
#[test]
fn long_upload_over_a_slow_link() {
    let slow = LinkConfig::uart(1_200).with_streams(StreamProfile::Off);
    let fast = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let lines = [LineConfig::radio(1_200, millis(50)), LineConfig::default()];
    let mut world = Flight::of(Setup { links: [slow, fast], lines, step: millis(20), ..Setup::new() });
    let (target_system, target_component) = (1, 1);
    let count = |count| MissionCount { count, target_system, target_component, ..MissionCount::default() };
    let items = plan(500, 1);
    world.gcs[1].address = OTHER_STATION;
    world.gcs[0].send(&count(500));
    world.run_for(secs(1));
    let (mut result, mut asked) = (None, 1);
    while result.is_none() && world.now() < Instant::from_millis(1_200_000) {
        if world.now() >= Instant::from_millis(asked * 1_000) {
            asked += 1;
            world.gcs[1].send(&count(2));
        }
        world.step();
        while let Some((_, request)) = world.gcs[0].take::<MissionRequestInt>() {
            let item = MissionItemInt { target_system, target_component, ..items[usize::from(request.seq)] };
            world.gcs[0].send(&item);
        }
        result = world.gcs[0].take::<MissionAck>();
        world.gcs[0].forget();
    }
    let (at, ack) = result.expect("an end");
    assert_eq!(ack.r#type, MavMissionResult::ACCEPTED);
    let [(PlanType::Mission, taken, 0)] = &world.vehicle.plan_changes()[..] else {
        panic!("{:?}", world.vehicle.plan_changes().len())
    };
    assert_eq!(taken.len(), 500);
    assert!(asked > 200, "{asked} of the other in {} s", at.as_millis() / 1_000);
}

/// a PARAM_EXT_ACK names no client. The refusal of a station that is not in control takes neither the place of the answer to the one
/// in control, on whichever link, nor reaches another link. Before, the one in control was told that its change had failed.
#[test]
fn refusals_of_others_hide_no_answer() {
    let link = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let (target_system, target_component) = (1, 1);
    let mut value = [0; 128];
    value[0] = 1;
    let (param_id, param_value) = (Text::new("CAM_ISO"), Text::from_wire(value));
    let set =
        ParamExtSet { target_system, target_component, param_id, param_value, param_type: MavParamExtType::UINT8 };
    for other_link in [0, 1] {
        let mut world = Loaded::of(Setup { links: [link; 2], ..Setup::new() });
        world.gcs[0].heartbeat_period = Some(secs(1));
        world.run_for(millis(1_500));
        world.gcs[0].takes_unknown = true;
        world.gcs[0].command_long(REQUEST_OPERATOR_CONTROL, [1.0, 0.0, 10.0, 255.0, 0.0, 0.0, 0.0]);
        world.run_for(millis(100));
        assert_eq!(world.stack.operator(world.now()), Some(STATION.system));
        for (link, from) in [(0, STATION), (other_link, OTHER_STATION)] {
            let frame = world.gcs[link].frame_from(from, &set);
            world.stack.receive(world.clock.now(), LinkId(link as u8), &frame, &mut world.vehicle);
        }
        world.run_for(millis(100));
        let results = |world: &Loaded, link: usize| -> Vec<_> {
            world.gcs[link].all::<ParamExtAck>().into_iter().map(|(_, ack)| ack.param_result).collect()
        };
        assert_eq!([0, 1].map(|link| results(&world, link)), [[ParamAck::ACCEPTED]; 2], "link {other_link}");
        // Alone, it is refused on its own link.
        world.gcs.iter_mut().for_each(Gcs::forget);
        world.gcs[other_link].send_from(OTHER_STATION, &set);
        world.run_for(millis(100));
        let is_told = [0, 1].map(|link| results(&world, link) == [ParamAck::FAILED]);
        assert_eq!(is_told, [other_link == 0, other_link == 1]);
    }
}
