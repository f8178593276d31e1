//! Who controls a gimbal besides a ground station: the vehicle's own mission, and the owner of the vehicle; and links that cannot carry
//! everything: rules GIM-2, GIM-7 and GIM-12.

use super::gimbal::{
    Carried, DOWN, NAN, PITCH_YAW, angles, command, configure, control, last, next_waypoint, pitch_yaw, place, send,
    take, world,
};
use crate::support::*;
use mavstack::config::{LinkClass, StreamProfile};
use mavstack::dialect::*;
use mavstack::gimbal::GimbalControl;
use mavstack::{Address, Item, LinkConfig, LinkId, Message};
use std::f32::consts::PI;

type Site = World<3, super::gimbal::Managed>;

/// Points as an item of the vehicle's mission does.
fn point(world: &mut Site, item: &Item) -> MavResult {
    let now = world.now();
    world.stack.with_services(now, &mut world.vehicle, |services, cx| services.gimbal_manager.point(cx, item))
}

/// Ends the vehicle's own control.
fn release(world: &mut Site) {
    let own = world.stack.address();
    world.stack.gimbal_manager.release(own);
}

/// GIM-7: the vehicle points for its mission: that takes control from whoever has it, and it releases it at the end.
#[test]
fn vehicle_points_for_its_mission() {
    let mut world = world();
    take(&mut world, STATION);
    let item = |command, params, x, y, z, frame| Item { command, params, x, y, z, frame, ..Item::default() };
    let mission = MavFrame::MISSION;
    let pitch_yaw = item(PITCH_YAW, [-90.0, NAN, NAN, NAN], 8, 0, 0.0, mission);
    assert_eq!(point(&mut world, &pitch_yaw), MavResult::ACCEPTED);
    let setpoint = *world.vehicle.pointed.last().unwrap();
    let down = angles([None, Some(-PI / 2.0), None], [None; 3]);
    assert_eq!((setpoint.target, setpoint.from, setpoint.flags.0), (down, VEHICLE, 8));
    assert_eq!(control(&world), [Some(VEHICLE), None]);
    world.run_for(millis(20));
    assert_eq!(world.expect::<GimbalManagerStatus>(1, millis(20)).primary_control_sysid, 255);
    assert_eq!(world.expect::<GimbalManagerStatus>(1, millis(20)).primary_control_sysid, 1);

    let frame = MavFrame::GLOBAL_RELATIVE_ALT;
    let roi = item(MavCmd::DO_SET_ROI_LOCATION, [0.0; 4], 475_000_000, 82_500_000, 5.0, frame);
    assert_eq!(point(&mut world, &roi), MavResult::ACCEPTED);
    assert_eq!(last(&world).1, place(475_000_000, 82_500_000, 5.0, Some(frame)));
    // Parameters 5 and 6 of a command without a position are plain numbers in every frame (M-75).
    for frame in [0, 2, 3, 6, 10].map(MavFrame) {
        let flags = item(PITCH_YAW, [-90.0, NAN, NAN, NAN], 8, 0, 0.0, frame);
        assert_eq!(point(&mut world, &flags), MavResult::ACCEPTED);
        assert_eq!(world.vehicle.pointed.last().unwrap().flags.0, 8);
        let offset = item(MavCmd::DO_SET_ROI_WPNEXT_OFFSET, [0.0; 4], 30, -10, 90.0, frame);
        assert_eq!(point(&mut world, &offset), MavResult::ACCEPTED);
        let [pitch, roll, yaw] = [30.0, -10.0, 90.0].map(|degrees: f32| Some(degrees * (PI / 180.0)));
        assert_eq!(last(&world).1, Some(next_waypoint([roll, pitch, yaw])));
        let scaled = Item { x: 300_000_000, ..offset };
        assert_eq!(point(&mut world, &scaled), MavResult::DENIED);
    }
    let terrain = item(MavCmd::DO_SET_ROI_LOCATION, [0.0; 4], 1, 1, 1.0, MavFrame::GLOBAL_TERRAIN_ALT);
    for (bad, result) in [
        (terrain, MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
        (item(PITCH_YAW, [200.0, 0.0, NAN, NAN], 0, 0, 0.0, mission), MavResult::DENIED),
        (item(MavCmd::DO_SET_ROI_LOCATION, [0.0; 4], 1, 1, 1.0, mission), MavResult::COMMAND_UNSUPPORTED_MAV_FRAME),
        (item(MavCmd::NAV_WAYPOINT, [0.0; 4], 1, 1, 1.0, frame), MavResult::UNSUPPORTED),
    ] {
        assert_eq!(point(&mut world, &bad), result);
    }
    assert_eq!(command(&mut world, OTHER_STATION, PITCH_YAW, DOWN), MavResult::DENIED, "the mission has control");
    // The mission hands over to a station, and takes it back.
    let give = item(MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, [255.0, 190.0, -1.0, -1.0], 0, 0, 0.0, mission);
    assert_eq!(point(&mut world, &give), MavResult::ACCEPTED);
    assert_eq!(control(&world), [Some(STATION), None]);
    let own = item(MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, [-2.0, -2.0, -1.0, -1.0], 0, 0, 0.0, mission);
    assert_eq!(point(&mut world, &own), MavResult::ACCEPTED);
    assert_eq!(control(&world), [Some(Address::new(1, 1)), None], "an item is of the autopilot (GIM-3)");
    release(&mut world);
    assert_eq!(control(&world), [None, None]);
    take(&mut world, STATION);
    release(&mut world);
    assert_eq!(control(&world), [Some(STATION), None], "only its own");
}

/// GIM-12, O-5: when another system takes over the vehicle, the control of others ends, but not that of the vehicle's own system. What
/// a station that is not in control of the vehicle sends takes none.
#[test]
fn control_ends_when_another_station_takes_over() {
    let mut world = world();
    send(&mut world, 0, STATION, &Gcs::heartbeat());
    send(&mut world, 1, OTHER_STATION, &Gcs::heartbeat());
    let companion = Address::new(1, 191);
    configure(&mut world, STATION, [255, 190, 1, 191]);
    let request = [1.0, 1.0, 10.0, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(command(&mut world, OTHER_STATION, MavCmd(32_100), request), MavResult::ACCEPTED);
    assert_eq!(control(&world), [None, Some(companion)]);
    world.run_for(millis(20));
    assert_eq!(world.vehicle.changes.last(), Some(&GimbalControl { primary: None, secondary: Some(companion) }));
    assert_eq!(configure(&mut world, STATION, [255, 190, -1, -1]), MavResult::NOT_IN_CONTROL);
    assert_eq!(command(&mut world, STATION, MavCmd::DO_SET_ROI_NONE, [0.0; 7]), MavResult::NOT_IN_CONTROL);
    assert_eq!(control(&world), [None, Some(companion)]);
    assert!(world.vehicle.pointed.is_empty());
}

/// GIM-2, D-3, L-2: with a full transmit buffer the answers, the status and the information wait, and are sent once there is room. A
/// high-latency link carries commands and their answers, and nothing else.
#[test]
fn full_and_expensive_links() {
    let uart = LinkConfig::unlimited().with_streams(StreamProfile::Off);
    let satellite = uart.with_class(LinkClass::HighLatency);
    let lines = [LineConfig { down: Wire { tx_fifo: 0, ..Wire::default() }, ..LineConfig::default() }; 3];
    let mut world = Carried::of(Setup { links: [uart, satellite, uart], lines, ..Setup::new() });
    for link in [0, 1] {
        let ask = [GimbalManagerInformation::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let params = [255.0, 190.0, -1.0, -1.0, 0.0, 0.0, 0.0];
        for (id, params) in [(MavCmd::REQUEST_MESSAGE, ask), (MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, params)] {
            let message = world.gcs[0].long(id, params);
            send(&mut world, link, STATION, &message);
        }
    }
    send(&mut world, 1, STATION, &pitch_yaw(0.5));
    world.run_for(secs(2));
    assert_eq!(control(&world), [Some(STATION), None]);
    assert!(world.vehicle.pointed.is_empty(), "no setpoints from a high-latency link");
    assert!(world.gcs.iter().all(|gcs| gcs.received.is_empty()));

    let now = world.now();
    let mut ids = [Vec::new(), Vec::new()];
    for (link, ids) in (0..).zip(&mut ids) {
        loop {
            let frame = world.stack.transmit(now, LinkId(link), &mut world.vehicle).to_vec();
            let [0xFD, .., _] = *frame else { break };
            ids.push(u32::from_le_bytes([frame[7], frame[8], frame[9], 0]));
            world.stack.transmitted(LinkId(link), frame.len());
        }
    }
    let count = |link: usize, id| ids[link].iter().filter(|sent| **sent == id).count();
    let [first, second] = [0, 1]
        .map(|link| [CommandAck::ID, GimbalManagerInformation::ID, GimbalManagerStatus::ID].map(|id| count(link, id)));
    assert_eq!(first, [2, 1, 1], "{ids:?}");
    assert_eq!(second, [2, 0, 0], "{ids:?}");
}
