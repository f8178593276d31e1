//! Operator control and setpoints over lines that lose a fifth of all frames in each direction: rules O-5, C-12, J-6 and J-7.
//!
//! However the frames are lost, each request has the outcome that its answer says, what is carried out is carried out once, and only
//! the owner's setpoints are followed.

use crate::support::*;
use mavstack::dialect::*;
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::{Address, Instant, LinkConfig};

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 2, commands: { slots: 3 }, operator_control)]
struct Controlled {
    setpoints: mavstack::setpoints::Setpoints,
}

type Shared = World<2, Controlled>;

const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);
/// A command that is carried out once.
const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
const STATIONS: [Address; 2] = [STATION, OTHER_STATION];
const SEEDS: u64 = 100;

/// Two ground stations, each on its own line.
fn world(seed: u64) -> Shared {
    let links = [LinkConfig::uart(57_600).with_own_system(true); 2];
    let lines = [LineConfig::radio(57_600, millis(20)); 2];
    let mut setup = Setup { links, lines, seed, step: millis(5), ..Setup::new() };
    // Ten heartbeats in a row are not lost.
    setup.config.peer_timeout = secs(10);
    let mut world = Shared::of(setup);
    for (gcs, station) in world.gcs.iter_mut().zip(STATIONS) {
        gcs.takes_unknown = true;
        gcs.address = station;
        gcs.send_from(station, &Gcs::heartbeat());
    }
    let all = ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) };
    world.stack.setpoints.set_source(all);
    world.vehicle.outcomes.insert(ONCE.0, MavResult::ACCEPTED.into());
    world.run_for(millis(500));
    for line in &world.lines {
        line.set_up(|wire| wire.faults = Faults::frames(0.2, 0.0));
        line.set_down(|wire| wire.faults = Faults::frames(0.2, 0.0));
    }
    world
}

/// Runs for this time; the ground stations send their heartbeats.
fn run(world: &mut Shared, millis_to_run: u64) {
    for _ in 0..millis_to_run / 100 {
        if world.now().as_millis() % 1_000 < 100 {
            for (gcs, station) in world.gcs.iter_mut().zip(STATIONS) {
                gcs.send_from(station, &Gcs::heartbeat());
            }
        }
        world.run_for(millis(100));
    }
}

/// A ground station sends a command until it is answered, at most five times. Returns the answer.
fn ask(world: &mut Shared, station: usize, command: MavCmd, params: [f32; 4]) -> Option<MavResult> {
    let [param1, param2, param3, param4] = params;
    world.gcs[station].forget();
    for confirmation in 0..5 {
        world.gcs[station].send_from(
            STATIONS[station],
            &CommandLong {
                command,
                param1,
                param2,
                param3,
                param4,
                confirmation,
                target_system: 1,
                target_component: 1,
                ..CommandLong::default()
            },
        );
        run(world, 500);
        let acks = world.gcs[station].all::<CommandAck>();
        if let Some((_, ack)) = acks.iter().find(|(_, ack)| ack.command == command) {
            assert!(acks.iter().all(|(_, other)| other.result == ack.result || command != ONCE), "{acks:?}");
            return Some(ack.result);
        }
    }
    None
}

fn request(world: &mut Shared, station: usize, allow: f32) -> Option<MavResult> {
    let system = f32::from(STATIONS[station].system.wire());
    ask(world, station, REQUEST_OPERATOR_CONTROL, [1.0, allow, 10.0, system])
}

fn owner(world: &Shared) -> Option<usize> {
    let owner = world.stack.operator(world.now())?;
    STATIONS.iter().position(|station| station.system == owner)
}

/// The number of notices that a ground station has received.
fn notices(world: &Shared, station: usize) -> usize {
    let commands = world.gcs[station].all::<CommandLong>();
    commands.iter().filter(|(_, command)| command.command == REQUEST_OPERATOR_CONTROL).count()
}

/// O-5, C-12: control is requested, refused, handed over with the owner's consent, and used. `None`: a request was never answered.
fn hand_over(world: &mut Shared, seed: u64) -> Option<()> {
    assert_eq!((request(world, 0, 0.0)?, owner(world)), (MavResult::ACCEPTED, Some(0)), "seed {seed}");
    assert_eq!((request(world, 1, 0.0)?, owner(world)), (MavResult::FAILED, Some(0)), "seed {seed}");
    run(world, 4_000);
    // Each refused transmission begins the three notices again.
    let told = notices(world, 0);
    assert!(told <= 3 * 5, "seed {seed}: {told} notices");
    assert_eq!(notices(world, 1), 0, "seed {seed}");
    if told == 0 {
        return None;
    }
    // The owner consents, and is told no more.
    assert_eq!((request(world, 0, 1.0)?, owner(world)), (MavResult::ACCEPTED, Some(0)), "seed {seed}");
    world.gcs[0].forget();
    run(world, 3_000);
    assert_eq!(notices(world, 0), 0, "seed {seed}");
    // A lost answer is answered again: the request is granted to the station that has control already.
    assert_eq!((request(world, 1, 0.0)?, owner(world)), (MavResult::ACCEPTED, Some(1)), "seed {seed}");
    world.vehicle.calls.clear();
    let params = [1.0, 1_500.0, 3.0, 0.5];
    let refused = ask(world, 0, ONCE, params);
    assert!(refused.is_none_or(|result| result == MavResult::NOT_IN_CONTROL), "seed {seed}: {refused:?}");
    assert_eq!(world.vehicle.commands(), [], "seed {seed}");
    let accepted = ask(world, 1, ONCE, params);
    assert!(accepted.is_none_or(|result| result == MavResult::ACCEPTED), "seed {seed}: {accepted:?}");
    let commands = world.vehicle.commands();
    let runs = commands.len();
    assert!(runs == 1 || (runs == 0 && accepted.is_none()), "seed {seed}: carried out {runs} times");
    assert!(commands.iter().all(|command| command.from.address == STATIONS[1]), "seed {seed}");
    Some(())
}

/// O-5, C-12: in the end every answered request has had its effect once, and no other.
#[test]
fn control_is_handed_over() {
    let complete: u64 = (0..SEEDS).map(|seed| u64::from(hand_over(&mut world(seed), seed).is_some())).sum();
    // Each of four requests is answered in 99.4 % of all cases.
    assert!(complete * 10 >= SEEDS * 9, "{complete} of {SEEDS}");
}

/// J-6, J-7, O-5: of two stations that send setpoints, only the owner's are followed. Each that is received is followed once, until
/// the timeout, and none is older than that.
#[test]
fn setpoints_of_the_owner_are_followed() {
    for seed in 0..SEEDS / 2 {
        let mut world = world(seed);
        if request(&mut world, 0, 0.0).is_none() {
            continue;
        }
        let (mut sent, mut last) = (0, Instant::ZERO);
        let (mut followed, mut gaps) = (0, 0);
        for _ in 0..100 {
            for (station, gcs) in world.gcs.iter_mut().enumerate() {
                let time_boot_ms = sent + 1_000 * station as u32;
                let (target_system, target_component) = (1, 1);
                let setpoint =
                    SetPositionTargetLocalNed { time_boot_ms, target_system, target_component, ..Default::default() };
                gcs.send_from(STATIONS[station], &setpoint);
            }
            sent += 1;
            world.run_for(millis(50));
            let now = world.now();
            let Some(setpoint) = world.stack.setpoints.current(now) else {
                gaps += 1;
                continue;
            };
            assert_eq!(setpoint.from.address, STATION, "seed {seed}");
            assert!(now - setpoint.at < millis(500) && setpoint.at >= last, "seed {seed}");
            followed += u32::from(setpoint.at > last);
            last = setpoint.at;
        }
        let counters = world.stack.setpoints.counters();
        assert_eq!((counters.taken, counters.not_owner), (followed, 0), "seed {seed}");
        assert!((60..100).contains(&followed) && gaps <= 10, "seed {seed}: {followed} followed, {gaps} gaps");
        // The others were dropped before.
        let dropped = world.stack.operator_control().counters().messages;
        assert!((60..100).contains(&dropped), "seed {seed}: {dropped}");
        world.run_for(millis(500));
        assert_eq!(world.stack.setpoints.current(world.now()), None, "seed {seed}");
    }
}
