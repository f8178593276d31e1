//! Worn flash, and drivers that fail, under the whole stack.

use crate::support::flash::{Fault, RamFlash, Worn};
use crate::support::*;
use mavstack::storage::Store;

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 1, parameters: Tuning, commands: { slots: 1 }, storage)]
struct OnlyParams;

type Flash = RamFlash<8, 1024>;
type Vessel = World<1, OnlyParams>;

/// Returns a vehicle with the parameters of this flash.
fn start(flash: &mut Flash) -> (Vessel, Store<&mut Flash>) {
    let len = flash.bytes.len() as u32;
    let (mut world, mut store) = (Vessel::of(Setup::new()), Store::new(flash, 0..len));
    assert_eq!(world.stack.restore(world.now(), &mut store, &mut world.vehicle), Ok(()));
    (world, store)
}

/// Every save of the parameters succeeds if one unit of the flash is worn: the first of the region, the last, and the first of the
/// second segment.
#[test]
fn every_save_succeeds_beside_a_worn_unit() {
    for (units, saves, unit) in [(12, 24, 0), (12, 24, 6), (12, 24, 11), (48, 90, 0), (48, 90, 24)] {
        for how in [Worn::Erase, Worn::Keep] {
            let mut flash = Flash::new(units * 1024);
            flash.worn.push((unit, how));
            let (mut world, mut store) = start(&mut flash);
            for save in 0..saves {
                let value = 1.0 + save as f32 / 100.0;
                assert!(world.stack.parameters_mut().set(Tuning::CRUISE, value));
                world.step();
                world.stack.save_parameters(world.now());
                while world.stack.persist(world.now(), &mut store, &mut world.vehicle) {}
                world.run_for(secs(1));
                if save % 8 == 0 {
                    (world, store) = start(&mut flash);
                    let found = world.stack.parameters().get(Tuning::CRUISE);
                    assert_eq!(found, value, "{units} units, unit {unit}: {how:?}, save {save}");
                }
            }
        }
    }
}

/// Storage that fails in any way leaves no deadline in the past: a loop that sleeps goes on sleeping.
#[test]
fn failing_storage_does_not_spin_the_loop() {
    for fault in [Fault::Erase, Fault::Write(0), Fault::WrongWrite(0), Fault::Read(0..u32::MAX)] {
        let mut flash = Flash::new(12 * 1024);
        let (mut world, mut store) = start(&mut flash);
        assert!(world.stack.parameters_mut().set(Tuning::CRUISE, 6.0));
        world.stack.save_parameters(world.now());
        world.step();
        while world.stack.persist(world.now(), &mut store, &mut world.vehicle) {}
        flash.fault = fault.clone();
        let len = flash.bytes.len() as u32;
        let (mut world, mut store) = (Vessel::of(Setup::new()), Store::new(&mut flash, 0..len));
        let restored = world.stack.restore(world.now(), &mut store, &mut world.vehicle);
        assert_eq!(restored.is_ok(), !matches!(fault, Fault::Read(_)));
        world.run_for(millis(100));
        let (mut early, mut passes) = (0, 0);
        for step in 0..20_000 {
            if step % 5_000 == 0 {
                assert!(world.stack.parameters_mut().set(Tuning::CRUISE, 7.0 + (step / 5_000) as f32 / 10.0));
                world.stack.save_parameters(world.now());
            }
            world.step();
            while world.stack.persist(world.now(), &mut store, &mut world.vehicle) {
                passes += 1;
                assert!(passes < 5_000, "{fault:?}: it never ends");
            }
            early += u32::from(world.stack.next_deadline(world.now()) <= world.now());
        }
        assert!(early < 1_000, "{fault:?}: {early} of 20,000 passes");
    }
}
