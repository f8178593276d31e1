//! The reset of a large table takes several polls: rules X-6, P-17.

use crate::support::*;
use mavstack::dialect::{CommandAck, MavCmd, MavResult, ParamValue};
use mavstack::param::{ParamInfo, RuntimeTable};
use mavstack::{Context, Instant, LinkConfig, LinkId, ParamChange, Parameters, Vehicle, VehicleState};
use std::collections::BTreeMap;

const COUNT: usize = 300;

/// A vehicle that counts the changes it is told of at each time.
#[derive(Default)]
struct Counting {
    is_armed: bool,
    changes: BTreeMap<Instant, usize>,
}

impl Counting {
    fn changed(&self) -> usize {
        self.changes.values().sum()
    }
}

impl Vehicle for Counting {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.is_armed))
    }
}

without_commands!(Counting);

impl Parameters for Counting {
    type Table = RuntimeTable<COUNT>;

    fn parameter_changed(&mut self, cx: &mut Context<'_>, _: &ParamChange<Self::Table>) {
        *self.changes.entry(cx.now()).or_default() += 1;
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Counting, links: 2, parameters: RuntimeTable<COUNT>, commands: { slots: 2 })]
struct Large;

type LargeWorld = World<2, Large>;

/// Creates a vehicle whose parameters do not have their defaults.
fn world() -> LargeWorld {
    let mut world = LargeWorld::of(Setup { links: [LinkConfig::uart(921_600); 2], ..Setup::new() });
    for number in 0..COUNT {
        let info = ParamInfo::new(&format!("P{number:03}"), 1.0f32, 0.0..=9.0).expect("valid");
        world.stack.parameters_mut().add(info).expect("room");
    }
    world.run_for(millis(50));
    for index in 0..COUNT as u16 {
        assert!(world.stack.parameters_mut().set_bits(index, 2.0f32.to_bits()));
    }
    world
}

const RESET: [f32; 7] = [2.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0];

fn reset(world: &mut LargeWorld, link: usize) {
    world.gcs[link].command_long(MavCmd::PREFLIGHT_STORAGE, RESET);
}

/// Another station requests a reset on the second link.
fn reset_by_other(world: &mut LargeWorld) {
    let command = world.gcs[1].long(MavCmd::PREFLIGHT_STORAGE, RESET);
    let frame = world.gcs[1].frame_from(OTHER_STATION, &command);
    world.stack.receive(world.clock.now(), LinkId(1), &frame, &mut world.vehicle);
}

/// Returns the number of parameters that have their defaults.
fn at_default(world: &LargeWorld) -> usize {
    let is_default = |index: &u16| world.stack.parameters().bits(*index) == Some(1.0f32.to_bits());
    (0..COUNT as u16).filter(is_default).count()
}

/// Returns the results that a ground station has received.
fn results(world: &LargeWorld, link: usize) -> Vec<MavResult> {
    world.gcs[link].all::<CommandAck>().into_iter().map(|(_, ack)| ack.result).collect()
}

/// one poll told the vehicle of 300 changes, and now of at most 32. The command is answered after the last change. Another reset
/// meanwhile, of the same station, another one or on another link, is answered then too.
#[test]
fn reset_of_300() {
    let mut world = world();
    reset(&mut world, 0);
    while world.vehicle.changed() == 0 {
        world.run_for(millis(1));
    }
    reset(&mut world, 0);
    reset_by_other(&mut world);
    reset(&mut world, 1);
    while results(&world, 0).is_empty() && results(&world, 1).is_empty() {
        assert!(world.now() < Instant::from_millis(5_000), "it is not answered");
        assert!(results(&world, 0).is_empty() && results(&world, 1).is_empty());
        world.run_for(millis(1));
    }
    assert_eq!((world.vehicle.changed(), at_default(&world)), (COUNT, COUNT));
    let most = world.vehicle.changes.values().max();
    assert!(most <= Some(&32), "{most:?} changes in one poll");
    world.run_for(millis(500));
    assert_eq!([0, 1].map(|link| results(&world, link)), [[MavResult::ACCEPTED; 2]; 2]);
    assert_eq!(world.gcs[1].all::<ParamValue>().iter().filter(|(_, told)| told.param_value == 1.0).count(), COUNT);
    // The next one has nothing to change.
    world.gcs.iter_mut().for_each(|gcs| gcs.forget());
    reset(&mut world, 1);
    world.run_for(millis(500));
    assert_eq!((results(&world, 0), results(&world, 1)), (vec![], vec![MavResult::ACCEPTED]));
}

/// only the answer about the reset waits, and those behind it on its link. Other links are answered at once.
#[test]
fn other_links_are_answered_meanwhile() {
    let mut world = world();
    reset(&mut world, 0);
    while world.vehicle.changed() == 0 {
        world.run_for(millis(1));
    }
    world.gcs[1].command_long(MavCmd::NAV_LAND, [0.0; 7]);
    world.run_for(millis(5));
    assert!(world.vehicle.changed() < COUNT);
    assert_eq!([0, 1].map(|link| results(&world, link)), [vec![], vec![MavResult::UNSUPPORTED]]);
}

/// X-6, P-17: a reset that has begun is completed, also if the vehicle arms meanwhile: it never has half of its defaults. Then a new one
/// is refused.
#[test]
fn a_reset_is_completed() {
    let mut world = world();
    reset(&mut world, 0);
    while world.vehicle.changed() == 0 {
        world.run_for(millis(1));
    }
    world.vehicle.is_armed = true;
    world.run_for(millis(500));
    assert_eq!((results(&world, 0), at_default(&world)), (vec![MavResult::ACCEPTED], COUNT));
    world.gcs[0].forget();
    reset(&mut world, 0);
    world.run_for(millis(500));
    assert_eq!(results(&world, 0), [MavResult::TEMPORARILY_REJECTED]);
}

/// a sleeping loop is woken until the reset has ended.
#[test]
fn a_reset_keeps_a_sleeping_loop_awake() {
    let mut world = world();
    reset(&mut world, 0);
    while world.vehicle.changed() == 0 {
        world.run_for(millis(1));
    }
    world.sleep_for(millis(100));
    assert_eq!(at_default(&world), COUNT);
}
