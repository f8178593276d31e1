//! Messages that the vehicle sends by itself: rules K-8, K-9, D-3, D-4, H-15, L-2, P-11, S-10.

use std::collections::VecDeque;

use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::param::ParamTable;
use mavstack::{
    Address, Command, Commands, Context, Destination, Fill, Instant, LinkConfig, LinkId, Message, Outcome, Peer,
    Stream, Telemetry, Vehicle, VehicleState,
};
use proptest::prelude::*;

const GIMBAL: Address = Address::new(1, 154);

/// A vehicle that points its gimbal at USER_1, and answers USER_2 in a private protocol.
#[derive(Default)]
struct Carrier {
    angle: f32,
    gimbal: Option<Peer>,
    /// Tunnels that cannot be filled now.
    missing: Option<u16>,
}

impl Vehicle for Carrier {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }
}

impl Commands for Carrier {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        let is_sent = match (command.id, self.gimbal) {
            (MavCmd::USER_1, Some(gimbal)) => cx.send::<GimbalDeviceSetAttitude>(gimbal, 0),
            (MavCmd::USER_2, _) => cx.send::<Tunnel>(command.from, 7),
            _ => return MavResult::UNSUPPORTED.into(),
        };
        if is_sent { MavResult::ACCEPTED } else { MavResult::TEMPORARILY_REJECTED }.into()
    }
}

impl Telemetry for Carrier {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>().onboard(millis(5))];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let Address { system, component } = out.target();
        let (target_system, target_component) = (system.wire(), component.wire());
        match id {
            GimbalDeviceSetAttitude::ID => out.put(&GimbalDeviceSetAttitude {
                q: [self.angle; 4],
                target_system,
                target_component,
                ..GimbalDeviceSetAttitude::UNKNOWN
            }),
            Tunnel::ID if self.missing == Some(out.index()) => false,
            Tunnel::ID => {
                let payload_type = MavTunnelPayloadType(out.index());
                out.put(&Tunnel { payload_type, target_system, target_component, ..Tunnel::default() })
            }
            Attitude::ID => out.put(&Attitude::default()),
            _ => false,
        }
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Carrier, links: 3, streams, messages, parameters: Tuning)]
struct Carrying;

impl mavstack::Parameters for Carrier {
    type Table = Tuning;
}

type Sky = World<3, Carrying>;

/// A ground station, a gimbal and a satellite.
fn sky() -> Sky {
    let uart = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let links = [uart, uart.with_class(LinkClass::Private), uart.with_class(LinkClass::HighLatency)];
    let mut world = Sky::of(Setup { links, ..Setup::new() });
    world.vehicle.gimbal = Some(Peer { address: GIMBAL, link: LinkId(1) });
    world.run_for(millis(100));
    world
}

/// Returns the types of the tunnels that a link has sent.
fn tunnels(world: &Sky, link: usize) -> Vec<u16> {
    world.gcs[link].all::<Tunnel>().into_iter().map(|(_, tunnel)| tunnel.payload_type.0).collect()
}

fn stall(world: &Sky, link: usize, time: mavstack::Duration) {
    let until = world.now() + time;
    world.uarts[link].stall_writes_until(until);
}

/// K-8, D-3: a message to a peer is sent on its link only, has its address, and reports the state at the time it is sent.
#[test]
fn message_is_sent_to_one_peer() {
    let mut world = sky();
    stall(&world, 1, millis(300));
    world.vehicle.angle = 1.0;
    world.gcs[0].command_long(MavCmd::USER_1, [0.0; 7]);
    assert_eq!(world.expect::<CommandAck>(0, millis(100)).result, MavResult::ACCEPTED);
    world.vehicle.angle = 2.0;
    world.run_for(secs(1));
    let set: Vec<_> = world.gcs[1].all::<GimbalDeviceSetAttitude>().into_iter().map(|(_, set)| set).collect();
    let [GimbalDeviceSetAttitude { q, target_system: 1, target_component: 154, .. }] = set[..] else {
        panic!("{set:?}")
    };
    assert_eq!(q, [2.0; 4]);
    assert_eq!((0, 0), (world.gcs[0].count_of::<GimbalDeviceSetAttitude>(), world.gcs[2].received.len()));
}

/// A private protocol is answered to the sender of the request.
#[test]
fn request_is_answered_to_its_sender() {
    let mut world = sky();
    world.gcs[0].command_long(MavCmd::USER_2, [0.0; 7]);
    world.run_for(millis(200));
    let (_, answer) = world.gcs[0].all::<Tunnel>()[0];
    let expected = (7, STATION.system.wire(), STATION.component.wire());
    assert_eq!((answer.payload_type.0, answer.target_system, answer.target_component), expected);
    assert_eq!((tunnels(&world, 0).len(), tunnels(&world, 1).len()), (1, 0));
}

/// L-2, S-10: a message to all is sent on every normal link that can carry it. No link but those has one refused.
#[test]
fn message_to_all_is_sent_on_normal_links() {
    let uart = LinkConfig::uart(115_200).with_streams(StreamProfile::Off);
    let links = [uart, uart.with_version(TxVersion::V1), uart.with_class(LinkClass::HighLatency)];
    let mut world = Sky::of(Setup { links, ..Setup::new() });
    world.run_for(millis(100));
    assert!(world.stack.send::<Tunnel>(Destination::All, 1));
    assert!(world.stack.send::<Attitude>(Destination::All, 0));
    world.run_for(millis(200));
    let count = |link: usize| (world.gcs[link].count_of::<Tunnel>(), world.gcs[link].count_of::<Attitude>());
    assert_eq!([count(0), count(1), count(2)], [(1, 1), (0, 1), (0, 0)], "TUNNEL has no id in MAVLink 1");
    for link in [LinkId(2), LinkId(3), LinkId(16), LinkId(255)] {
        assert!(!world.stack.send::<Tunnel>(link, 1), "{link:?}");
    }
    assert_eq!([0, 1, 2, 3].map(|link| world.stack.refused_messages(LinkId(link))), [0; 4]);
}

/// K-8: a link has room for eight. Others are refused and counted, and a stalled link does not affect the others.
#[test]
fn full_queue_refuses_and_counts() {
    let mut world = sky();
    stall(&world, 1, secs(3));
    for index in 0..20 {
        assert_eq!(world.stack.send::<Tunnel>(LinkId(1), index), index < 4, "{index}");
        assert!(world.stack.send::<Tunnel>(Destination::All, 100 + index), "the other link has room");
        world.run_for(millis(100));
    }
    assert_eq!(tunnels(&world, 0), (100..120).collect::<Vec<_>>());
    assert_eq!(world.stack.refused_messages(LinkId(0)), 0);
    world.run_for(secs(2));
    let sent = tunnels(&world, 1);
    assert_eq!(sent, [0, 100, 1, 101, 2, 102, 3, 103]);
    assert_eq!(world.stack.refused_messages(LinkId(1)), 32);
}

/// K-8: a message that is pending is not queued again, and one that cannot be filled is left out.
#[test]
fn duplicates_and_missing_messages_are_left_out() {
    let mut world = sky();
    world.vehicle.missing = Some(2);
    for index in [1, 2, 1, 3, 2, 3] {
        assert!(world.stack.send::<Tunnel>(LinkId(0), index));
    }
    world.run_for(secs(1));
    assert_eq!(tunnels(&world, 0), [1, 3]);
    assert!(world.stack.send::<Tunnel>(LinkId(0), 1));
    world.run_for(millis(100));
    assert_eq!(tunnels(&world, 0), [1, 3, 1], "it is no longer pending");
}

/// K-9, D-4, H-15, P-11: a vehicle that always has something to send takes at most half of the link. Heartbeats and answers are not
/// late, and the list of parameters and the streams go on.
#[test]
fn a_flood_takes_half_of_the_link() {
    flood(LinkConfig::uart(57_600), 45..=52);
}

/// K-9: on a link without a rate they are every other frame, so they cannot starve the others.
#[test]
fn a_flood_takes_half_of_a_link_without_a_rate() {
    flood(LinkConfig::unlimited(), 30..=70);
}

/// Floods a link that transmits 5,760 bytes/s, and checks the share of the vehicle's own messages (%).
fn flood(config: LinkConfig, shares: core::ops::RangeInclusive<u64>) {
    const RATE: u64 = 5_760;
    let is_paced = config.bytes_per_second != 0;
    let uart = config.with_streams(StreamProfile::Onboard);
    let down = Wire { bytes_per_second: RATE, tx_fifo: 512, ..Wire::default() };
    let lines = [LineConfig { down, ..LineConfig::default() }, LineConfig::default(), LineConfig::default()];
    let mut world = Sky::of(Setup { links: [uart; 3], lines, ..Setup::new() });
    let flood = |world: &mut Sky, time: mavstack::Duration| {
        let end = world.now() + time;
        while world.now() < end {
            for index in 0..4 {
                let _ = world.stack.send::<Tunnel>(LinkId(0), index);
            }
            world.step();
        }
    };
    flood(&mut world, secs(2));
    world.gcs[0].forget();
    flood(&mut world, secs(10));
    let bytes = |world: &Sky, id: u32| -> u64 {
        let frames = world.gcs[0].received.iter().filter(|frame| frame.header.id == id);
        frames.map(|frame| frame.raw.len() as u64).sum::<u64>() * 100 / (RATE * 10)
    };
    let share = bytes(&world, Tunnel::ID);
    assert!(shares.contains(&share), "{share} % for the vehicle's own messages");
    let streamed = bytes(&world, Attitude::ID);
    assert!(streamed >= 25, "{streamed} % for streams");
    if !is_paced {
        // The line's own buffer delays heartbeats and answers.
        return;
    }
    let beats: Vec<Instant> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
    for pair in beats.windows(2) {
        let gap = (pair[1] - pair[0]).as_millis();
        assert!(gap.abs_diff(1_000) <= 70, "{gap} ms between heartbeats");
    }

    world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [Attitude::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let asked = world.now();
    world.gcs[0].forget();
    flood(&mut world, secs(2));
    let (at, _) = world.gcs[0].all::<CommandAck>()[0];
    assert!((at - asked).as_millis() <= 70, "the answer takes {} ms", (at - asked).as_millis());
    let values = world.gcs[0].all::<ParamValue>();
    assert_eq!(values.len(), Tuning::INFO.len());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// K-8, D-3: each accepted message is sent once, in order, and no refused one, however the links stall.
    #[test]
    fn accepted_messages_are_sent_once_and_in_order(
        events in prop::collection::vec((0u8..3, 0u16..12, 0u64..30), 1..100),
    ) {
        let mut world = sky();
        let mut pending: [VecDeque<u16>; 2] = Default::default();
        for (what, index, pause) in events {
            let queued: &[usize] = match what {
                0 => &[0],
                1 => &[1],
                _ => &[0, 1],
            };
            let to = match what {
                2 => Destination::All,
                link => Destination::Link(LinkId(link)),
            };
            let mut is_accepted = false;
            for &link in queued {
                if pending[link].contains(&index) {
                    is_accepted = true;
                } else if pending[link].len() < 8 {
                    pending[link].push_back(index);
                    is_accepted = true;
                }
            }
            prop_assert_eq!(world.stack.send::<Tunnel>(to, index), is_accepted);
            if pause % 3 == 0 {
                stall(&world, usize::from(index % 2), millis(pause * 2));
            }
            world.run_for(millis(pause));
            for (link, pending) in pending.iter_mut().enumerate() {
                for index in tunnels(&world, link) {
                    prop_assert_eq!(pending.pop_front(), Some(index));
                }
                world.gcs[link].forget();
            }
        }
        world.run_for(secs(2));
        for (link, pending) in pending.iter_mut().enumerate() {
            prop_assert_eq!(&tunnels(&world, link), pending.make_contiguous());
        }
    }
}
