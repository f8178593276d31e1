//! A survey: the camera takes images on the way, the gimbal looks where the plan says. Rules CAM-1 to CAM-9, GIM-7, K-10.

use crate::support::wire::{CAMERA, GIMBAL, Wire, command_long};
use crate::support::{act, at, waypoint};
use mavstack::dialect::*;
use mavstack::{Address, Item, Message, Text};
use mavstack_demo::{Mode, TELEMETRY};

const NAN: f32 = f32::NAN;

/// Uploads a plan and flies it to its end. Returns the images that were reported on the telemetry link.
fn fly(wire: &mut Wire, plan: &[Item]) -> Vec<CameraImageCaptured> {
    wire.upload(plan);
    wire.received.clear();
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("flown", 300, |vehicle| vehicle.mode() != Mode::Mission);
    wire.run(500);
    images(wire)
}

fn images(wire: &Wire) -> Vec<CameraImageCaptured> {
    let received = wire.received.iter().filter(|received| received.link == TELEMETRY && received.source == CAMERA);
    received.filter_map(|received| received.decode()).collect()
}

/// Sends a command to a component, and returns its answers: who, and what.
fn command(wire: &mut Wire, to: u8, id: MavCmd, params: &[f32]) -> Vec<(u8, MavResult)> {
    wire.received.clear();
    wire.send(TELEMETRY, &CommandLong { target_component: to, ..command_long(1, id, params) });
    wire.run(200);
    let acks = wire.received.iter().filter(|received| received.link == TELEMETRY);
    let acks = acks.filter_map(|received| Some((received.source.component.wire(), received.decode::<CommandAck>()?)));
    acks.filter(|(_, ack)| ack.command == id).map(|(from, ack)| (from, ack.result)).collect()
}

fn trigger(distance: f32) -> Item {
    act(MavCmd::DO_SET_CAM_TRIGG_DIST, [distance, 0.0, 1.0, NAN])
}

/// Three lines of a survey as QGroundControl writes it: the camera triggers by distance on each line, and not between them.
#[test]
fn a_survey_takes_an_image_every_so_many_metres() {
    fly_survey(1);
}

/// The image is taken where it is due, also if the flight loop runs rarely.
#[test]
fn a_survey_is_as_exact_with_rare_passes() {
    fly_survey(90);
}

fn fly_survey(pass: u64) {
    let mut wire = Wire::airborne();
    wire.pass = pass;
    let plan = [
        act(MavCmd::SET_CAMERA_MODE, [0.0, 2.0, NAN, NAN]),
        act(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, [-90.0, 0.0, NAN, NAN]),
        waypoint(20.0, 0.0),
        trigger(10.0),
        waypoint(75.0, 0.0),
        trigger(0.0),
        waypoint(75.0, 30.0),
        trigger(10.0),
        waypoint(20.0, 30.0),
        trigger(0.0),
        waypoint(20.0, 60.0),
        trigger(10.0),
        waypoint(75.0, 60.0),
        trigger(0.0),
        waypoint(60.0, 60.0),
    ];
    let images = fly(&mut wire, &plan);
    // On each line one at once, one every 10 m of 55 m, and one at the end. A waypoint counts as reached within a radius.
    assert_eq!(images.len(), 3 * 7, "{images:?}");
    for (index, image) in (0..).zip(&images) {
        assert_eq!((image.image_index, image.capture_result), (index, 1));
        // The gimbal looks down: a rotation by -90 degrees about the pitch axis.
        let [w, _, y, _] = image.q;
        assert!(index < 2 || ((w - 0.707).abs() < 0.1 && (y + 0.707).abs() < 0.1), "{:?}", image.q);
    }
    let line = |number: usize| &images[7 * number..7 * number + 7];
    for number in 0..3 {
        // Metres north and east: a degree of longitude is 0.677 of one of latitude here.
        let place = |image: &CameraImageCaptured| [f64::from(image.lat) * 0.011_132, f64::from(image.lon) * 0.007_536];
        let places: Vec<_> = line(number).iter().map(place).collect();
        let steps = places.windows(2).map(|pair| {
            let [north, east] = [0, 1].map(|axis| pair[1][axis] - pair[0][axis]);
            north.hypot(east)
        });
        for (step, expected) in steps.zip([10.0, 10.0, 10.0, 10.0, 10.0, 5.0]) {
            let most = if expected == 10.0 { 0.5 } else { 4.0 };
            assert!((step - expected).abs() < most, "{places:?}");
        }
    }
    assert_eq!(
        command(&mut wire, 100, MavCmd::REQUEST_MESSAGE, &[CameraSettings::ID as f32]),
        [(100, MavResult::ACCEPTED)]
    );
    let settings = wire.take::<CameraSettings>();
    assert!(settings.iter().any(|(_, settings)| settings.mode_id == CameraMode::IMAGE_SURVEY));
}

/// A survey that is interrupted takes no images on the way home. It goes on when the mission does.
#[test]
fn a_paused_survey_takes_no_images() {
    let mut wire = Wire::airborne();
    wire.upload(&[waypoint(10.0, 0.0), trigger(5.0), waypoint(90.0, 0.0), trigger(0.0), waypoint(90.0, 20.0)]);
    wire.received.clear();
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("on the line", 60, |vehicle| vehicle.local_position().north > 40.0);
    assert_eq!(wire.long(MavCmd::NAV_RETURN_TO_LAUNCH, &[]), MavResult::ACCEPTED);
    wire.run(100);
    let before = images(&wire).len();
    assert!((6..=8).contains(&before), "{before}");
    wire.until("on the way back", 60, |vehicle| vehicle.local_position().north < 25.0);
    assert_eq!(images(&wire).len(), before);
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("flown", 120, |vehicle| vehicle.mode() != Mode::Mission);
    let images = images(&wire);
    let last = images.iter().map(|image| f64::from(image.lat) * 0.011_132).fold(f64::MIN, f64::max);
    let first = images.iter().map(|image| f64::from(image.lat) * 0.011_132).fold(f64::MAX, f64::min);
    assert!(images.len() > before + 10 && (last - first - 80.0).abs() < 4.0, "{} of {before}", images.len());
    // Ordered by a command, it does not depend on the mission.
    wire.received.clear();
    assert_eq!(command(&mut wire, 1, MavCmd::DO_SET_CAM_TRIGG_DIST, &[5.0, 0.0, 0.0]), [(1, MavResult::ACCEPTED)]);
    assert_eq!(wire.long(MavCmd::NAV_RETURN_TO_LAUNCH, &[]), MavResult::ACCEPTED);
    wire.until("on the way home", 60, |vehicle| vehicle.local_position().north < 40.0);
    assert!(self::images(&wire).len() > 5);
}

/// Images at an interval, single images, and video, as MAVSDK's missions have them.
#[test]
fn a_mission_operates_the_camera() {
    let mut wire = Wire::airborne();
    let plan = [
        waypoint(10.0, 0.0),
        act(MavCmd::IMAGE_START_CAPTURE, [0.0, 0.0, 1.0, NAN]),
        act(MavCmd::VIDEO_START_CAPTURE, [0.0, 0.0, NAN, NAN]),
        act(MavCmd::IMAGE_START_CAPTURE, [0.0, 2.0, 0.0, NAN]),
        act(MavCmd::NAV_DELAY, [9.0, -1.0, -1.0, -1.0]),
        act(MavCmd::IMAGE_STOP_CAPTURE, [0.0, NAN, NAN, NAN]),
        act(MavCmd::VIDEO_STOP_CAPTURE, [0.0, NAN, NAN, NAN]),
        waypoint(40.0, 0.0),
    ];
    let images = fly(&mut wire, &plan);
    assert!((5..=6).contains(&images.len()), "one, and one every two seconds for nine: {}", images.len());
    let recording = wire.take::<CameraCaptureStatus>();
    assert!(recording.iter().any(|(_, status)| status.video_status == 1));
    assert!(recording.last().is_some_and(|(_, status)| status.video_status == 0 && status.image_status == 0));
}

/// GIM-7: a region of interest is followed while the vehicle flies past it, and left at the end of the mission.
#[test]
fn a_mission_points_the_gimbal() {
    let mut wire = Wire::airborne();
    let plan = [
        waypoint(0.0, 0.0),
        at(MavCmd::DO_SET_ROI_LOCATION, [0.0; 4], 40.0, 40.0, 0.0),
        waypoint(80.0, 0.0),
        act(MavCmd::DO_SET_ROI_NONE, [0.0; 4]),
        waypoint(80.0, 20.0),
    ];
    wire.upload(&plan);
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("on the way", 60, |vehicle| vehicle.local_position().north > 35.0);
    wire.received.clear();
    assert_eq!(
        command(&mut wire, 154, MavCmd::REQUEST_MESSAGE, &[GimbalDeviceAttitudeStatus::ID as f32]),
        [(154, MavResult::ACCEPTED)]
    );
    let attitudes = wire.received.iter().filter(|received| received.source == GIMBAL);
    let attitude =
        attitudes.filter_map(|received| received.decode::<GimbalDeviceAttitudeStatus>()).next_back().unwrap();
    let here = wire.vehicle().local_position();
    // Yaw from north: the gimbal's from the nose, and the nose's.
    let [w, x, y, z] = attitude.q;
    let yaw = 2.0 * z.atan2(w) + attitude.delta_yaw;
    let expected = (40.0 - here.east).atan2(40.0 - here.north);
    assert!((yaw - expected).abs() < 0.1, "{yaw} instead of {expected}");
    let pitch = 2.0 * y.atan2(w.hypot(z).copysign(1.0)).clamp(-1.6, 1.6);
    assert!(pitch < 0.0, "it looks down at the ground: {pitch} {x}");
    let control = |wire: &Wire| {
        let mut all = wire.received.iter().filter_map(|received| received.decode::<GimbalManagerStatus>());
        all.next_back().map(|status| (status.primary_control_sysid, status.primary_control_compid))
    };
    wire.run(2_500);
    assert_eq!(control(&wire), Some((1, 1)), "the mission is in control");
    wire.until("flown", 120, |vehicle| vehicle.mode() != Mode::Mission);
    wire.run(2_500);
    assert_eq!(control(&wire), Some((0, 0)));
    assert!(wire.vehicle().is_armed());
}

/// A mission that is paused takes no more images, and goes on with them when it is resumed; at its end all stops.
#[test]
fn a_pause_stops_the_survey() {
    let mut wire = Wire::airborne();
    wire.upload(&[
        waypoint(0.0, 0.0),
        act(MavCmd::VIDEO_START_CAPTURE, [0.0, 0.0, NAN, NAN]),
        trigger(10.0),
        waypoint(100.0, 0.0),
        waypoint(0.0, 0.0),
    ]);
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("on the way", 60, |vehicle| vehicle.local_position().north > 45.0);
    assert_eq!(wire.long(MavCmd::DO_REPOSITION, &[-1.0, 1.0]), MavResult::ACCEPTED);
    wire.run(100);
    let taken = images(&wire).len();
    assert!(taken >= 4);
    wire.run(10_000);
    assert_eq!(images(&wire).len(), taken, "it holds");
    let status = wire.take::<CameraCaptureStatus>();
    assert!(status.last().is_some_and(|(_, status)| status.video_status == 0), "the mission's video has ended");
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("flown", 120, |vehicle| vehicle.mode() != Mode::Mission);
    let all = images(&wire).len();
    assert!(all > taken + 10, "{all}");
    assert_eq!(
        wire.int(MavCmd::DO_REPOSITION, MavFrame::GLOBAL, [-1.0, 1.0, 0.0, NAN], 473_986_420, 85_455_940, 498.0),
        MavResult::ACCEPTED
    );
    wire.run(15_000);
    assert_eq!(images(&wire).len(), all, "after the mission it takes no images");
}

/// MAVProxy asks the autopilot for an image: one for each command, and a retransmission takes none.
#[test]
fn the_autopilot_has_images_taken() {
    let mut wire = Wire::booted();
    let shoot = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    for _ in 0..2 {
        assert_eq!(wire.long(MavCmd::DO_DIGICAM_CONTROL, &shoot), MavResult::ACCEPTED);
        wire.run(100);
    }
    assert_eq!(images(&wire).len(), 1);
    assert_eq!(wire.long(MavCmd::DO_DIGICAM_CONTROL, &[0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0]), MavResult::UNSUPPORTED);
    wire.run(100);
    assert_eq!(images(&wire).len(), 1, "zoom is no image");
}

/// CAM-7: ground stations learn of settings that no command to the camera has changed.
#[test]
fn changed_settings_are_reported() {
    let mut wire = Wire::booted();
    wire.received.clear();
    let set = ParamExtSet {
        target_system: 1,
        target_component: 100,
        param_id: Text::new("CAM_MODE"),
        param_value: Text::new("\u{1}"),
        param_type: MavParamExtType::UINT8,
    };
    wire.send(TELEMETRY, &set);
    wire.run(200);
    let settings = wire.take::<CameraSettings>();
    assert!(settings.iter().any(|(_, settings)| settings.mode_id == CameraMode::VIDEO), "{settings:?}");
}

/// K-10: camera and gimbal answer for themselves, and the autopilot for itself.
#[test]
fn payloads_answer_for_themselves() {
    let mut wire = Wire::booted();
    let accepted = |from| vec![(from, MavResult::ACCEPTED)];
    let request = MavCmd::REQUEST_MESSAGE;
    for (to, from, id) in [
        (100, 100, CameraInformation::ID),
        (0, 100, CameraInformation::ID),
        (154, 154, GimbalDeviceInformation::ID),
        (1, 1, GimbalManagerInformation::ID),
        (0, 1, GimbalManagerInformation::ID),
        (1, 1, AutopilotVersion::ID),
    ] {
        assert_eq!(command(&mut wire, to, request, &[id as f32]), accepted(from), "{id} of {to}");
        assert!(wire.received.iter().any(|received| received.id == id && received.source.component.wire() == from));
    }
    assert_ne!(command(&mut wire, 1, request, &[CameraInformation::ID as f32]), accepted(1));
    assert_eq!(command(&mut wire, 100, MavCmd::IMAGE_START_CAPTURE, &[0.0, 0.0, 1.0, 0.0]), accepted(100));
    assert_eq!(images(&wire).len(), 1);
    assert_eq!(command(&mut wire, 100, MavCmd::COMPONENT_ARM_DISARM, &[1.0]), [(100, MavResult::UNSUPPORTED)]);
    assert!(!wire.vehicle().is_armed());
    // A station points only when it is in control.
    let down = [-90.0, 0.0, NAN, NAN, 0.0, 0.0, 0.0];
    assert_eq!(command(&mut wire, 1, MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, &down), [(1, MavResult::DENIED)]);
    assert_eq!(command(&mut wire, 1, MavCmd::DO_GIMBAL_MANAGER_CONFIGURE, &[255.0, 190.0, -1.0, -1.0]), accepted(1));
    assert_eq!(command(&mut wire, 1, MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, &down), accepted(1));
}

/// K-10: without components, the vehicle is component 1 alone. Commands and items for the camera and the gimbal are unsupported, and
/// those to their components have no answer.
#[test]
fn a_vehicle_without_components_is_alone() {
    let mut wire = Wire::alone();
    wire.run(10_000);
    let others: Vec<_> = wire.received.iter().filter(|received| received.source != Address::new(1, 1)).collect();
    assert!(others.is_empty() && wire.count::<Heartbeat>(TELEMETRY) > 9);
    assert_eq!(wire.count::<GimbalManagerStatus>(TELEMETRY), 0);
    for id in [
        MavCmd::DO_SET_CAM_TRIGG_DIST,
        MavCmd::DO_DIGICAM_CONTROL,
        MavCmd::IMAGE_START_CAPTURE,
        MavCmd::DO_GIMBAL_MANAGER_PITCHYAW,
        MavCmd::DO_GIMBAL_MANAGER_CONFIGURE,
        MavCmd::DO_SET_ROI_LOCATION,
        MavCmd::DO_SET_ROI_NONE,
        MavCmd::DO_MOUNT_CONTROL,
    ] {
        let params = [0.0; 7];
        assert_eq!(command(&mut wire, 1, id, &params), [(1, MavResult::UNSUPPORTED)], "{id:?}");
        for to in [100, 154] {
            assert_eq!(command(&mut wire, to, id, &params), [], "{id:?} to {to}");
        }
    }
    let id = AutopilotVersion::ID as f32;
    assert_eq!(wire.long(MavCmd::REQUEST_MESSAGE, &[id]), MavResult::ACCEPTED);
    wire.run(100);
    let (_, version) = wire.take::<AutopilotVersion>().pop().expect("it was requested");
    assert!(!version.capabilities.contains(MavProtocolCapability::COMPONENT_IMPLEMENTS_GIMBAL_MANAGER));

    for item in
        [trigger(10.0), act(MavCmd::SET_CAMERA_MODE, [0.0, 2.0, NAN, NAN]), act(MavCmd::DO_SET_ROI_NONE, [0.0; 4])]
    {
        let refused = MavMissionResult::UNSUPPORTED;
        assert_eq!(wire.try_upload(&[waypoint(10.0, 0.0), item]), refused, "{:?}", item.command);
    }
    // A mission without such items is flown.
    wire.upload(&[
        at(MavCmd::NAV_TAKEOFF, [0.0, 0.0, NAN, NAN], 0.0, 0.0, 8.0),
        waypoint(20.0, 0.0),
        act(MavCmd::NAV_RETURN_TO_LAUNCH, [NAN; 4]),
    ]);
    assert_eq!(wire.long(MavCmd::COMPONENT_ARM_DISARM, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(wire.long(MavCmd::MISSION_START, &[]), MavResult::ACCEPTED);
    wire.until("flown", 300, |vehicle| !vehicle.is_armed());
}
