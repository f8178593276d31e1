//! A parameter that is the vehicle's system id (H-2).

use crate::support::flash::RamFlash;
use crate::support::*;
use mavstack::dialect::{Heartbeat, MavCmd, MavParamType, MavResult, ParamSet, ParamValue};
use mavstack::prelude::*;
use mavstack::storage::Store;

mavstack::parameters! {
    pub struct Tuning {
        ALPHA: f32 = 1.0, 0.0..=2.0, "";
        MAV_SYS_ID: i32 = 7, 1..=254, "" { system_id };
    }
}

#[derive(Stack)]
#[stack(vehicle: Rover, links: 1, parameters: Tuning, storage)]
struct Mavlink;

#[derive(Default)]
struct Rover;

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Parameters for Rover {
    type Table = Tuning;
}

type Flash = RamFlash<8, 512>;
const REGION: u32 = Store::<Flash>::region_len::<Mavlink>();

fn world() -> World<1, Mavlink> {
    World::of(Setup::new())
}

fn start(store: &mut Store<&mut Flash>) -> World<1, Mavlink> {
    let mut world = world();
    world.stack.restore(world.now(), store, &mut world.vehicle).expect("readable");
    world
}

/// Runs the world while storage runs, for two seconds.
fn run(world: &mut World<1, Mavlink>, store: &mut Store<&mut Flash>) {
    let end = world.now() + secs(2);
    while world.now() < end {
        world.step();
        world.stack.persist(world.now(), store, &mut world.vehicle);
    }
}

/// Sets the system id of system `target`.
fn set(world: &mut World<1, Mavlink>, target: u8, id: u32) {
    world.gcs[0].send(&ParamSet {
        target_system: target,
        target_component: 1,
        param_id: Text::new("MAV_SYS_ID"),
        param_value: f32::from_bits(id),
        param_type: MavParamType::INT32,
    });
}

/// The systems from which the ground station has received an `M`.
fn sources<M: Message>(world: &World<1, Mavlink>) -> Vec<u8> {
    let of_message = world.gcs[0].received.iter().filter(|frame| frame.header.id == M::ID);
    let mut systems: Vec<_> = of_message.map(|frame| frame.header.source.system.wire()).collect();
    systems.dedup();
    systems
}

/// H-2: the default of the parameter replaces the configured system. The component stays.
#[test]
fn default_is_the_system_id() {
    let mut world = world();
    world.run_for(secs(2));
    assert_eq!(
        (world.stack.address(), sources::<Heartbeat>(&world)),
        (Address::new(7, VEHICLE.component.wire()), vec![7])
    );
}

/// P-14: the answer to a change comes from the vehicle that was asked. The new system id is there after the next start.
#[test]
fn change_takes_effect_at_the_next_start() {
    let mut flash = Flash::new(REGION);
    let mut store = Store::new(&mut flash, 0..REGION);
    let mut world = start(&mut store);
    set(&mut world, 7, 9);
    run(&mut world, &mut store);
    assert_eq!(world.gcs[0].take::<ParamValue>().expect("sent").1.param_value.to_bits(), 9);
    assert_eq!((sources::<ParamValue>(&world), sources::<Heartbeat>(&world)), (vec![7], vec![7]));
    // To read the stored values again changes nothing either.
    world.gcs[0].vehicle = Address::new(7, 1);
    world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    run(&mut world, &mut store);
    assert_eq!(sources::<Heartbeat>(&world), [7]);

    let mut world = start(&mut store);
    set(&mut world, 9, 255);
    run(&mut world, &mut store);
    assert_eq!((world.stack.address().system.wire(), sources::<Heartbeat>(&world)), (9, vec![9]));
    assert_eq!(world.gcs[0].take::<ParamValue>().expect("sent").1.param_value.to_bits(), 9);
}

/// H-2: storage that runs beside the loop brings the system id when all is read.
#[test]
fn storage_beside_the_loop_brings_the_system_id() {
    let mut flash = Flash::new(REGION);
    let mut store = Store::new(&mut flash, 0..REGION);
    let mut world = start(&mut store);
    set(&mut world, 7, 9);
    run(&mut world, &mut store);
    let mut world = self::world();
    world.stack.attach_storage(world.now(), store.region(), &mut world.vehicle);
    assert_eq!(world.stack.address().system.wire(), 7);
    run(&mut world, &mut store);
    assert!(!world.stack.is_restoring());
    assert_eq!(world.stack.address().system.wire(), 9);
}
