//! What peers may spend by satellite: L-17. Each test has the figures without a budget and with it.

use crate::support::*;
use mavstack::config::{CreditConfig, LinkClass};
use mavstack::dialect::{Attitude, CommandAck, CommandLong, HighLatency2, MavCmd, MavResult, Statustext};
use mavstack::high_latency::{HighLatency, HighLatencyConfig, HighLatencyCounters};
use mavstack::network::ForwardCounters;
use mavstack::{Address, Duration, LinkConfig, LinkId};

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 3, commands: { slots: 2 }, forwarding, operator_control)]
struct Flown {
    high_latency: HighLatency,
}

const RADIO: usize = 0;
const PILOT: usize = 1;
const SAT: usize = 2;

/// Another vehicle, near the pilot's radio.
const WINGMAN: Address = Address::new(2, 1);

/// No message is sent on schedule while a test runs.
const CONFIG: HighLatencyConfig = HighLatencyConfig { period: secs(100_000), ..HighLatencyConfig::DEFAULT };

/// A radio with a stranger, the pilot's radio, and a satellite modem.
fn world_with(credits: CreditConfig) -> World<3, Flown> {
    let satellite = LinkConfig::uart(9_600).with_class(LinkClass::HighLatency);
    let setup = Setup { links: [LinkConfig::uart(57_600), LinkConfig::uart(57_600), satellite], ..Setup::new() };
    let mut world = World::<3, Flown>::of(setup);
    world.stack.set_credits(credits);
    world.stack.high_latency.set_config(CONFIG);
    world.gcs[PILOT].address = OTHER_STATION;
    world.gcs[PILOT].heartbeat_period = Some(secs(1));
    world.run_for(secs(2));
    world
}

fn world() -> World<3, Flown> {
    world_with(CreditConfig::DEFAULT)
}

/// Sends a command from an address, and runs for a time.
fn command(world: &mut World<3, Flown>, link: usize, from: Address, command: &CommandLong, pause: Duration) {
    world.gcs[link].send_from(from, command);
    world.sleep_for(pause);
}

const START: CommandLong = CommandLong {
    param1: 1.0,
    param2: 0.0,
    param3: 0.0,
    param4: 0.0,
    param5: 0.0,
    param6: 0.0,
    param7: 0.0,
    command: MavCmd::CONTROL_HIGH_LATENCY,
    target_system: 1,
    target_component: 1,
    confirmation: 0,
};

/// A command that is forwarded to a station.
const FOR_THE_STATION: CommandLong = CommandLong {
    command: MavCmd::DO_SET_SERVO,
    target_system: STATION.system.wire(),
    target_component: STATION.component.wire(),
    ..START
};

fn counters(world: &World<3, Flown>) -> HighLatencyCounters {
    world.stack.high_latency.counters()
}

fn forwarded(world: &World<3, Flown>) -> ForwardCounters {
    world.stack.forward_counters(LinkId(SAT as u8)).expect("a link")
}

/// Has the satellite link know the station.
fn introduce_station(world: &mut World<3, Flown>) {
    world.gcs[SAT].send_from(STATION, &Attitude::default());
    world.sleep_for(millis(100));
}

/// Requests control for the pilot.
fn take_control(world: &mut World<3, Flown>) {
    let request = CommandLong { command: MavCmd(32_100), ..START };
    command(world, PILOT, OTHER_STATION, &request, secs(1));
    assert_eq!(world.stack.operator(world.now()), Some(OTHER_STATION.system));
}

/// L-17: 600 START in a minute by invented senders cost 1,200 credits without a budget. With it they cost their half of the
/// burst, and another 30 credits an hour. A text a minute says so.
#[test]
fn starts_of_invented_senders() {
    let mut world = world();
    let invented = |number: u32| Address::new(2 + (number % 200) as u8, 1 + (number / 200 % 100) as u8);
    for number in 0..600 {
        command(&mut world, RADIO, invented(number), &START, millis(100));
    }
    let HighLatencyCounters { credits, refused, .. } = counters(&world);
    assert!(credits <= 10, "{credits} credits in a minute");
    assert!(refused > 150, "{refused}");
    let mut number = 600;
    let end = world.now() + secs(3_600);
    while world.now() < end {
        command(&mut world, RADIO, invented(number), &START, secs(2));
        number += 1;
    }
    let HighLatencyCounters { credits, .. } = counters(&world);
    assert!((30..=10 + 31).contains(&credits), "{credits} credits in 61 minutes");
    let sent: Vec<_> = world.gcs[SAT].all::<HighLatency2>().iter().map(|(at, _)| *at).collect();
    assert!(sent.windows(2).all(|pair| pair[1] - pair[0] >= secs(10)), "{sent:?}");
    let texts = world.gcs[RADIO].all::<Statustext>();
    let told = texts.iter().filter(|(_, told)| told.text.as_str() == Some("Satellite: credits used up")).count();
    assert!((55..=62).contains(&told), "{told} texts in 61 minutes");
    // What is reserved is still there for the one in control.
    take_control(&mut world);
    let before = counters(&world).credits;
    for _ in 0..5 {
        command(&mut world, PILOT, OTHER_STATION, &START, secs(11));
    }
    assert_eq!(counters(&world).credits - before, 10, "five messages");
}

/// L-17: commands of a stranger to the owner's station were all forwarded by satellite. Now 10 are at once, and another 30 in
/// an hour; the others are dropped and counted. The one in control has 20 at once, and 60 in an hour.
#[test]
fn forwarded_to_the_station() {
    for is_owner in [false, true] {
        let mut world = world();
        introduce_station(&mut world);
        let from = if is_owner { OTHER_STATION } else { WINGMAN };
        if is_owner {
            take_control(&mut world);
        }
        let (burst, more) = if is_owner { (20, 10) } else { (10, 5) };
        let mut sent = 0;
        for _ in 0..30 {
            command(&mut world, PILOT, from, &FOR_THE_STATION, millis(500));
            sent += 1;
        }
        assert_eq!(forwarded(&world).sent, burst, "at once, {is_owner}");
        for _ in 0..595 {
            command(&mut world, PILOT, from, &FOR_THE_STATION, secs(1));
            sent += 1;
        }
        let ForwardCounters { sent: passed, over_budget, .. } = forwarded(&world);
        assert!((burst + more - 1..=burst + more + 1).contains(&passed), "{passed} in ten minutes, {is_owner}");
        assert_eq!(passed + over_budget, sent, "{is_owner}");
        assert_eq!(world.gcs[SAT].count_of::<CommandLong>(), passed as usize);
    }
}

/// L-17: START and STOP to all systems are DENIED; START was ACCEPTED, and each vehicle in range paid for it.
#[test]
fn broadcast_start() {
    let mut world = world();
    for enable in [1.0, 0.0] {
        command(&mut world, PILOT, OTHER_STATION, &CommandLong { target_system: 0, param1: enable, ..START }, secs(1));
        let (_, ack) = world.gcs[PILOT].take::<CommandAck>().expect("an answer");
        assert_eq!((ack.command, ack.result), (MavCmd::CONTROL_HIGH_LATENCY, MavResult::DENIED));
    }
    assert_eq!((counters(&world).messages, world.stack.high_latency.is_on()), (0, false));
    // To the vehicle alone they are executed.
    command(&mut world, PILOT, OTHER_STATION, &START, secs(1));
    assert_eq!(world.gcs[PILOT].take::<CommandAck>().expect("an answer").1.result, MavResult::ACCEPTED);
    assert_eq!(counters(&world).reports, 1);
}

/// L-17: when strangers have used up their credits, all 20 commands of an emergency are executed and answered by satellite,
/// and the messages on schedule are sent.
#[test]
fn emergency() {
    let mut world = world();
    introduce_station(&mut world);
    for _ in 0..60 {
        command(&mut world, RADIO, WINGMAN, &FOR_THE_STATION, millis(100));
    }
    assert!(forwarded(&world).over_budget > 0);
    world.stack.high_latency.set_config(HighLatencyConfig { period: secs(60), ..CONFIG });
    command(&mut world, SAT, STATION, &START, secs(1));
    world.gcs[SAT].forget();
    let calls = world.vehicle.commands().len();
    for _ in 0..20 {
        command(&mut world, SAT, STATION, &CommandLong { command: MavCmd::NAV_LAND, ..START }, secs(15));
    }
    assert_eq!(world.vehicle.commands().len() - calls, 20);
    assert_eq!(world.gcs[SAT].count_of::<CommandAck>(), 20);
    assert!((4..=6).contains(&world.gcs[SAT].count_of::<HighLatency2>()), "five minutes");
}

/// L-17: a START without credits turns the service on, and messages are sent on schedule.
#[test]
fn start_without_credits_keeps_the_schedule() {
    let mut world = world();
    world.stack.high_latency.set_config(HighLatencyConfig { period: secs(60), ..CONFIG });
    for _ in 0..2 {
        for number in 0..30 {
            command(&mut world, RADIO, Address::new(2 + number, 1), &START, secs(2));
        }
        let stop = CommandLong { param1: 0.0, ..START };
        command(&mut world, PILOT, OTHER_STATION, &stop, secs(1));
    }
    let (paid, now) = (counters(&world).reports, world.now());
    assert_eq!(paid, 5 + 1, "the half for everyone, and one on schedule");
    command(&mut world, PILOT, OTHER_STATION, &START, secs(1));
    assert!(world.stack.high_latency.is_on());
    world.sleep_for(secs(60));
    let (_, ack) = *world.gcs[PILOT].all::<CommandAck>().last().expect("an answer");
    assert_eq!(ack.result, MavResult::ACCEPTED);
    assert_eq!(counters(&world).reports, paid + 1, "since {now:?}");
}

/// L-17: the product sets the budget, or none.
#[test]
fn budget_is_a_setting() {
    for (credits, expected) in [
        (CreditConfig { per_hour: 0, ..CreditConfig::DEFAULT }, 40),
        (CreditConfig { burst: 50, ..CreditConfig::DEFAULT }, 25),
        (CreditConfig { bytes: 10, ..CreditConfig::DEFAULT }, 2),
    ] {
        let mut world = world_with(credits);
        introduce_station(&mut world);
        for _ in 0..40 {
            command(&mut world, RADIO, WINGMAN, &FOR_THE_STATION, millis(100));
        }
        assert_eq!(forwarded(&world).sent, expected, "{credits:?}");
    }
}
