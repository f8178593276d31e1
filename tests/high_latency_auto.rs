//! The high-latency link that goes on by itself: L-14, what stops it, and what it costs at most.

mod support;

use mavstack::dialect::{CommandAck, Heartbeat, HighLatency2, MavCmd, MavResult, MavType};
use mavstack::{Address, Duration, HighLatency, HighLatencyConfig, HighLatencySample, LinkClass, LinkConfig};
use support::*;

const TELEM: usize = 0;
const SAT: usize = 1;
const PERIOD: Duration = secs(20);
const CONFIG: HighLatencyConfig =
    HighLatencyConfig { period: PERIOD, on_link_loss_after: Some(secs(3)), ..HighLatencyConfig::DEFAULT };

/// A telemetry radio with a ground station, and a satellite modem.
fn world(config: HighLatencyConfig) -> World<2> {
    let links = [LinkConfig::uart(57_600), LinkConfig::uart(9_600).with_class(LinkClass::HighLatency)];
    let mut world = World::new(Setup { links, ..Setup::new() });
    world.vehicle.satellite = Some(HighLatency::new(config));
    world.gcs[TELEM].heartbeat_period = Some(secs(1));
    world
}

fn satellite(world: &mut World<2>) -> &mut HighLatency {
    world.vehicle.satellite.as_mut().expect("it has one")
}

fn run(world: &mut World<2>, duration: Duration) {
    let end = world.now().after(duration);
    while world.now() < end {
        world.skip_to(end);
    }
}

/// How many messages came since the last time.
fn count(world: &mut World<2>) -> usize {
    std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).count()
}

fn control(world: &mut World<2>, link: usize, enable: f32) {
    world.gcs[link].command_long(MavCmd::CONTROL_HIGH_LATENCY, [enable, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.expect::<CommandAck>(link, millis(100)).result, MavResult::ACCEPTED);
}

fn lose(world: &mut World<2>) {
    world.gcs[TELEM].heartbeat_period = None;
}

fn regain(world: &mut World<2>) {
    world.gcs[TELEM].heartbeat_period = Some(secs(1));
}

/// L-14: when the last ground station on a normal link is lost, it goes on after the time that was set; when one is heard
/// again, off.
#[test]
fn it_goes_on_with_the_last_ground_station_and_off_with_the_first() {
    let mut world = world(CONFIG);
    run(&mut world, secs(30));
    lose(&mut world);
    // Lost five seconds after its last heartbeat, and three more.
    run(&mut world, secs(6));
    assert_eq!(count(&mut world), 0);
    run(&mut world, secs(3));
    assert_eq!((count(&mut world), satellite(&mut world).is_on_by_itself()), (1, true));
    run(&mut world, secs(40));
    assert_eq!(count(&mut world), 2);
    regain(&mut world);
    run(&mut world, secs(60));
    assert_eq!((count(&mut world), satellite(&mut world).is_on()), (0, false));
}

/// It does not, when nobody wants it to; nor for a ground station that was never there, or others that are lost, or a loss that
/// is over before the time is.
#[test]
fn it_does_not_go_on_without_need() {
    let mut world = world(HighLatencyConfig { on_link_loss_after: None, ..CONFIG });
    run(&mut world, secs(5));
    lose(&mut world);
    run(&mut world, secs(60));
    assert!(!satellite(&mut world).is_on(), "not wanted");

    let mut world = self::world(CONFIG);
    lose(&mut world);
    run(&mut world, secs(60));
    let companion = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Gcs::heartbeat() };
    world.gcs[TELEM].send_from(Address::new(1, 191), &companion);
    world.gcs[SAT].send(&Gcs::heartbeat());
    run(&mut world, secs(60));
    assert!(!satellite(&mut world).is_on(), "never there, no ground station, or not on a normal link");

    regain(&mut world);
    run(&mut world, secs(5));
    for _ in 0..5 {
        lose(&mut world);
        run(&mut world, millis(6_500));
        regain(&mut world);
        run(&mut world, secs(2));
    }
    assert_eq!((satellite(&mut world).is_on(), count(&mut world)), (false, 0), "short losses");
}

/// A START while it is on by itself makes it commanded, so that only a STOP ends it; a STOP puts it off until the next loss.
#[test]
fn commands_have_the_last_word() {
    let mut world = world(CONFIG);
    run(&mut world, secs(5));
    lose(&mut world);
    run(&mut world, secs(10));
    assert!(satellite(&mut world).is_on_by_itself());
    control(&mut world, SAT, 1.0);
    assert!(satellite(&mut world).is_on() && !satellite(&mut world).is_on_by_itself());
    regain(&mut world);
    run(&mut world, secs(30));
    assert!(satellite(&mut world).is_on(), "commanded");
    lose(&mut world);
    run(&mut world, secs(30));
    control(&mut world, SAT, 0.0);
    run(&mut world, secs(60));
    assert!(!satellite(&mut world).is_on(), "stopped, and not lost anew");
    regain(&mut world);
    run(&mut world, secs(5));
    lose(&mut world);
    run(&mut world, secs(10));
    assert!(satellite(&mut world).is_on_by_itself());
}

/// Whatever the radio does, it never costs more than one message a period.
#[test]
fn a_radio_that_comes_and_goes_costs_no_more() {
    let mut world = world(HighLatencyConfig { on_link_loss_after: Some(Duration::ZERO), ..CONFIG });
    run(&mut world, secs(5));
    let mut rng = Rng::new(3);
    let begin = world.now();
    while world.now().since(begin) < secs(1_000) {
        lose(&mut world);
        run(&mut world, millis(5_200 + rng.below(3_000)));
        regain(&mut world);
        run(&mut world, millis(1_000 + rng.below(500)));
    }
    let sent: Vec<_> = std::iter::from_fn(|| world.gcs[SAT].take::<HighLatency2>()).map(|(at, _)| at).collect();
    assert!(sent.len() >= 10, "{}", sent.len());
    assert!(sent.windows(2).all(|pair| pair[1].since(pair[0]) >= PERIOD), "{sent:?}");
}

/// L-14: one message after the start, once there is something to tell, and no more.
#[test]
fn it_announces_itself_once() {
    let mut world = world(HighLatencyConfig { announce_once: true, ..CONFIG });
    run(&mut world, secs(30));
    assert_eq!(count(&mut world), 0, "nothing to tell yet");
    let now = world.now();
    satellite(&mut world).sample(now, &HighLatencySample { altitude: 500.0, ..HighLatencySample::UNKNOWN });
    run(&mut world, secs(60));
    let (_, told) = world.gcs[SAT].take::<HighLatency2>().expect("one");
    assert_eq!((told.altitude, count(&mut world), satellite(&mut world).is_on()), (500, 0, false));
    control(&mut world, SAT, 1.0);
    run(&mut world, secs(30));
    assert_eq!(count(&mut world), 2);
}

/// A STOP before the modem was ready for it cancels the announcement.
#[test]
fn an_announcement_can_be_stopped() {
    let mut world = world(HighLatencyConfig { announce_once: true, ..CONFIG });
    let until = world.now().after(secs(10));
    world.uarts[SAT].stall_writes_until(until);
    let now = world.now();
    satellite(&mut world).sample(now, &HighLatencySample::UNKNOWN);
    run(&mut world, secs(5));
    control(&mut world, TELEM, 0.0);
    run(&mut world, secs(60));
    assert_eq!(count(&mut world), 0);
}
