//! Runs the rover of `examples/boards` on the host, as the vehicle that the guide `start` begins with.

#[path = "../../examples/boards/rover/src/lib.rs"]
#[allow(dead_code, unexpected_cfgs, unused_attributes, reason = "it is a crate of its own, for boards")]
mod rover;

use crate::support::flash::{Fault, RamFlash};
use crate::support::radio::ExpressLrs;
use crate::support::*;
use mavstack::Text;
use mavstack::dialect::*;
use mavstack::storage::{RestoreError, Store};
use mavstack::telemetry::Battery;
use rover::{HOLD, MANUAL, MISSION, Mavlink, Tuning};

fn world() -> World<1, Mavlink> {
    let mut setup = Setup::<1>::new();
    let mavstack::Config { r#type, durability, .. } = rover::CONFIG;
    setup.config = mavstack::Config { r#type, durability, ..setup.config };
    World::of(setup)
}

/// Runs the driving loop for this time, and the stack.
fn drive(world: &mut World<1, Mavlink>, seconds: u64) {
    for _ in 0..seconds * 10 {
        let now = world.now();
        world.vehicle.drive(now, &mut world.stack);
        world.run_for(millis(100));
    }
}

fn arm(world: &mut World<1, Mavlink>) -> MavResult {
    world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    world.expect::<CommandAck>(0, secs(1)).result
}

/// Three items that the rover can drive to.
fn waypoints() -> Vec<MissionItemInt> {
    let (command, frame) = (MavCmd::NAV_WAYPOINT, MavFrame::GLOBAL_RELATIVE_ALT);
    plan(3, 0).into_iter().map(|item| MissionItemInt { command, frame, ..item }).collect()
}

/// Whether QGroundControl shows "ready".
fn is_ready(world: &mut World<1, Mavlink>) -> bool {
    world.expect::<SysStatus>(0, secs(2)).onboard_control_sensors_health.contains(MavSysStatusSensor::PREARM_CHECK)
}

/// P-18: QGroundControl considers a vehicle ready when its parameters are loaded, and needs at least one.
#[test]
fn rover_has_parameters() {
    let mut world = world();
    assert_eq!(world.expect::<Heartbeat>(0, secs(2)).r#type, MavType::GROUND_ROVER);
    world.gcs[0].send(&ParamRequestList { target_system: 1, target_component: 1 });
    let value: ParamValue = world.expect(0, secs(1));
    assert_eq!((value.param_id.as_str(), value.param_count, value.param_index), (Some("BAT_V_LOW"), 4, 0));
    world.run_for(secs(1));
    world.gcs[0].forget();
    world.gcs[0].send(&ParamSet {
        param_value: 5.0,
        target_system: 1,
        target_component: 1,
        param_id: Text::new("SPEED_MAX"),
        param_type: value.param_type,
    });
    assert_eq!(world.expect::<ParamValue>(0, secs(1)).param_value, 5.0);
    assert_eq!(world.stack.parameters().get(Tuning::SPEED_MAX), 5.0);
}

/// The rover drives its mission only while it is armed, in the mode, and a ground station is alive. QGroundControl shows "ready".
#[test]
fn rover_drives_and_holds_when_the_station_is_lost() {
    let mut world = world();
    world.gcs[0].heartbeat_period = Some(secs(1));
    drive(&mut world, 2);
    assert!(is_ready(&mut world));
    world.upload(0, &waypoints()).unwrap();
    let target = |world: &World<1, Mavlink>| world.vehicle.target(&world.stack).map(|item| item.command);
    let select = |world: &mut World<1, Mavlink>, mode: u32| {
        world.gcs[0].send(&SetMode {
            custom_mode: mode,
            target_system: 1,
            base_mode: MavModeFlag::CUSTOM_MODE_ENABLED,
        });
        drive(world, 1);
    };
    select(&mut world, MISSION);
    assert_eq!(target(&world), None, "disarmed");
    assert_eq!(arm(&mut world), MavResult::ACCEPTED);
    drive(&mut world, 1);
    assert_eq!(target(&world), Some(MavCmd::NAV_WAYPOINT));
    select(&mut world, HOLD);
    assert_eq!(target(&world), None, "it holds");
    select(&mut world, MISSION);
    assert_eq!(target(&world), Some(MavCmd::NAV_WAYPOINT));
    world.gcs[0].heartbeat_period = None;
    world.gcs[0].forget();
    drive(&mut world, 10);
    assert_eq!(target(&world), None, "the ground station is lost");
    let texts = world.gcs[0].all::<Statustext>();
    assert_eq!(texts[0].1.text.as_str(), Some("Ground station lost: holding"));
    world.gcs[0].forget();
    assert_eq!(world.expect::<Heartbeat>(0, secs(2)).system_status, MavState::CRITICAL);
}

/// J-10, J-11: one UART carries the sticks of ExpressLRS, telemetry, and a ground station with a joystick. The pilot needs no ground
/// station. The joystick steers only while the receiver is silent. Without sticks the rover holds.
#[test]
fn rover_is_driven_by_the_pilots_receiver() {
    let mut world = world();
    let mut receiver = ExpressLrs::new();
    let drive = |world: &mut World<1, Mavlink>, receiver: &mut ExpressLrs, has_joystick: bool, millis: u64| {
        for _ in 0..millis {
            let now = world.now();
            if now.as_millis().is_multiple_of(10) {
                world.vehicle.drive(now, &mut world.stack);
            }
            if has_joystick && now.as_millis().is_multiple_of(40) {
                world.gcs[0].send(&ManualControl { target: 1, x: 200, y: -100, ..ManualControl::default() });
            }
            let bytes = receiver.write(now.as_millis());
            world.gcs[0].send_raw(&bytes);
            world.step();
        }
    };
    let manual = |world: &mut World<1, Mavlink>| {
        world.gcs[0].command_long(MavCmd::DO_SET_MODE, [1.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        world.expect::<CommandAck>(0, secs(1)).result
    };
    assert_eq!(MANUAL, 3 << 16);
    assert_eq!(manual(&mut world), MavResult::TEMPORARILY_REJECTED, "no sticks yet");
    receiver.pulse = 1_750;
    drive(&mut world, &mut receiver, false, 100);
    assert_eq!(arm(&mut world), MavResult::ACCEPTED);
    assert_eq!(manual(&mut world), MavResult::ACCEPTED);
    drive(&mut world, &mut receiver, false, 10_000);
    assert_eq!(world.vehicle.sticks(), Some([0, 500]), "without a ground station");

    // QGroundControl comes, with a joystick.
    world.gcs[0].heartbeat_period = Some(secs(1));
    drive(&mut world, &mut receiver, true, 5_000);
    assert_eq!(world.vehicle.sticks(), Some([0, 500]));
    receiver.is_connected = false;
    drive(&mut world, &mut receiver, true, 1_000);
    assert_eq!(world.vehicle.sticks(), None, "the rover holds: the pilot is lost");
    assert_eq!(manual(&mut world), MavResult::ACCEPTED, "by the joystick");
    drive(&mut world, &mut receiver, true, 1_000);
    assert_eq!(world.vehicle.sticks(), Some([200, -100]));
    receiver.is_connected = true;
    drive(&mut world, &mut receiver, true, 600);
    assert_eq!(world.vehicle.sticks(), Some([0, 500]), "the pilot is back");

    receiver.is_connected = false;
    drive(&mut world, &mut receiver, false, 2_000);
    assert_eq!(world.vehicle.sticks(), None);
    let texts = world.gcs[0].all::<Statustext>();
    assert!(texts.iter().any(|(_, text)| text.text.as_str() == Some("Sticks lost: holding")), "{texts:?}");
}

/// C-18: without a ground station the armed rover would leave mode Mission at once, so it refuses the mode. C-17: sticks that came
/// right before the request for mode Manual count.
#[test]
fn rover_accepts_only_modes_that_it_keeps() {
    let mut world = world();
    let ask = |world: &mut World<1, Mavlink>, mode: u32| {
        let [_, _, main, sub] = mode.to_le_bytes();
        world.gcs[0].command_long(MavCmd::DO_SET_MODE, [1.0, main.into(), sub.into(), 0.0, 0.0, 0.0, 0.0]);
        world.expect::<CommandAck>(0, secs(1)).result
    };
    let reported = |world: &mut World<1, Mavlink>| {
        drive(world, 1);
        world.gcs[0].all::<Heartbeat>().pop().expect("one").1.custom_mode
    };
    world.upload(0, &waypoints()).unwrap();
    drive(&mut world, 1);
    world.gcs[0].heartbeat_period = Some(secs(1));
    drive(&mut world, 2);
    world.gcs[0].send(&ManualControl { target: 1, x: 100, y: 0, ..ManualControl::default() });
    assert_eq!(ask(&mut world, MANUAL), MavResult::ACCEPTED);
    assert_eq!(arm(&mut world), MavResult::ACCEPTED);
    assert_eq!(ask(&mut world, MISSION), MavResult::ACCEPTED);
    assert_eq!(reported(&mut world), MISSION);
    world.gcs[0].heartbeat_period = None;
    drive(&mut world, 10);
    world.gcs[0].forget();
    assert_eq!(ask(&mut world, MISSION), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(reported(&mut world), HOLD);
    let texts = world.gcs[0].all::<Statustext>();
    assert!(texts.iter().any(|(_, text)| text.text.as_str() == Some("No ground station")), "{texts:?}");
    assert_eq!(world.stack.hook_faults().unreported_modes, 0);
}

/// The battery is unknown until it is measured. If the parameter says so, an unknown or a low one prevents arming, by its own voltage
/// or by that of its cells.
#[test]
fn rover_watches_its_battery() {
    let mut world = world();
    assert_eq!(world.expect::<BatteryStatus>(0, secs(3)).voltages[0], u16::MAX);
    world.vehicle.battery = Battery { voltage: 9.5, ..Battery::UNKNOWN };
    world.gcs[0].forget();
    assert_eq!(world.expect::<BatteryStatus>(0, secs(3)).voltages[..2], [9_500, u16::MAX]);
    for (minimum, cells, voltage, is_sufficient) in [
        (0.0, &[][..], 9.5, true),
        (0.0, &[], f32::NAN, true),
        (10.0, &[], 9.5, false),
        (10.0, &[], 10.0, true),
        (10.0, &[], f32::NAN, false),
        (10.0, &[3.2, 3.3, 3.4], f32::NAN, false),
        (10.0, &[3.4, 3.5, 3.4], f32::NAN, true),
        (10.0, &[3.4, f32::NAN, 3.4], f32::NAN, false),
        // The measured voltage counts, not the sum.
        (10.0, &[3.4, 3.5, 3.4], 9.9, false),
    ] {
        world.vehicle.battery = Battery { cells, voltage, ..Battery::UNKNOWN };
        assert!(world.stack.parameters_mut().set(Tuning::BAT_V_LOW, minimum));
        drive(&mut world, 4);
        world.gcs[0].forget();
        assert_eq!(is_ready(&mut world), is_sufficient, "{voltage} V, {cells:?}");
        world.gcs[0].forget();
        let result = if is_sufficient { MavResult::ACCEPTED } else { MavResult::DENIED };
        assert_eq!(arm(&mut world), result, "{voltage} V, {cells:?}");
    }
}

/// G-18: the rover does not arm while the storage cannot be read. It arms once its plan is restored late, without a restart.
#[test]
fn rover_arms_after_a_late_restore() {
    const LEN: u32 = 64 * 1024;
    let mut flash = RamFlash::<4, 4096>::new(LEN);
    let mut writer = world();
    let mut store = Store::new(&mut flash, 0..LEN);
    assert_eq!(writer.stack.restore(writer.now(), &mut store, &mut writer.vehicle), Ok(()));
    writer.upload(0, &waypoints()).unwrap();
    while writer.stack.persist(writer.now(), &mut store, &mut writer.vehicle) {}

    (flash.reads, flash.fault) = (0, Fault::Reads(0..3));
    let mut world = world();
    let mut store = Store::new(&mut flash, 0..LEN);
    let errors = world.stack.restore(world.now(), &mut store, &mut world.vehicle).expect_err("no read succeeds");
    assert_eq!((errors.plans, errors.is_empty()), (Some(RestoreError::Unreadable), false));
    drive(&mut world, 2);
    assert!(!is_ready(&mut world));
    assert_eq!(arm(&mut world), MavResult::DENIED);
    for _ in 0..4 {
        drive(&mut world, 1);
        while world.stack.persist(world.now(), &mut store, &mut world.vehicle) {}
    }
    drive(&mut world, 1);
    assert_eq!((world.stack.mission().items().len(), world.stack.restore_errors().is_empty()), (3, true));
    world.gcs[0].forget();
    assert!(is_ready(&mut world));
    assert_eq!(arm(&mut world), MavResult::ACCEPTED);
}
