//! The other commands to a camera: video, settings, storages, and which camera is meant. Rules CAM-6 to CAM-9.

use crate::shooter::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::{
    Camera, Command, Commands, Context, Message, Outcome, Vehicle, VehicleState,
    camera::{CameraOrder, Image, Shot},
};

/// The settings that the first link has reported.
fn settings(site: &Site) -> usize {
    site.gcs[0].count_of::<CameraSettings>()
}

/// CAM-6: video is recorded from command to command; a repeated command changes nothing.
#[test]
fn video_is_recorded() {
    let mut site = site();
    let start = |site: &mut Site, hertz| command(site, MavCmd::VIDEO_START_CAPTURE, &[0.0, hertz]);
    assert_eq!(start(&mut site, 0.0), MavResult::TEMPORARILY_REJECTED, "in the image mode");
    site.vehicle.mode = CameraMode::VIDEO;
    assert_eq!(start(&mut site, 0.0), MavResult::ACCEPTED);
    site.run_for(secs(2));
    assert_eq!(start(&mut site, f32::NAN), MavResult::ACCEPTED);
    site.run_for(millis(20));
    let state = status(&site);
    assert_eq!((state.video_status, state.image_status), (1, 0));
    assert!((1_990..=2_100).contains(&state.recording_time_ms), "{}", state.recording_time_ms);
    assert!(site.stack.camera.is_recording());
    for _ in 0..2 {
        assert_eq!(command(&mut site, MavCmd::VIDEO_STOP_CAPTURE, &[1.0]), MavResult::ACCEPTED);
    }
    site.run_for(millis(20));
    assert_eq!((status(&site).video_status, status(&site).recording_time_ms), (0, 0));
    assert_eq!(site.vehicle.calls, [Hook::Record(0, true), Hook::Record(1, false)]);
}

/// CAM-5, CAM-6: while video is recorded, CAMERA_CAPTURE_STATUS is sent at the frequency of the command on every normal link.
#[test]
fn state_is_reported_while_recording() {
    let mut site = site();
    site.vehicle.mode = CameraMode::VIDEO;
    let count = |site: &Site| [0, 1].map(|link: usize| site.gcs[link].count_of::<CameraCaptureStatus>());
    assert_eq!(command(&mut site, MavCmd::VIDEO_START_CAPTURE, &[0.0, 2.0]), MavResult::ACCEPTED);
    site.run_for(millis(5_100));
    assert_eq!(count(&site), [11, 11]);
    assert_eq!(command(&mut site, MavCmd::VIDEO_STOP_CAPTURE, &[0.0]), MavResult::ACCEPTED);
    site.run_for(millis(50));
    let [before, _] = count(&site);
    site.run_for(secs(3));
    assert_eq!(count(&site), [before; 2]);
    for invalid in [-1.0, f32::NEG_INFINITY] {
        assert_eq!(command(&mut site, MavCmd::VIDEO_START_CAPTURE, &[0.0, invalid]), MavResult::DENIED);
    }
    for stream in [-1.0, 0.5, f32::NAN, 256.0] {
        assert_eq!(command(&mut site, MavCmd::VIDEO_STOP_CAPTURE, &[stream]), MavResult::DENIED);
    }
}

/// CAM-6: what the vehicle refuses has no effect, and its own orders have.
#[test]
fn vehicle_decides_over_video() {
    let mut site = site();
    site.vehicle.mode = CameraMode::VIDEO;
    site.vehicle.result = MavResult::FAILED;
    assert_eq!(command(&mut site, MavCmd::VIDEO_START_CAPTURE, &[2.0, 0.0]), MavResult::FAILED);
    assert!(!site.stack.camera.is_recording());
    site.vehicle.result = MavResult::ACCEPTED;
    site.vehicle.orders.push_back(CameraOrder::StartVideo);
    site.run_for(millis(10));
    assert!(site.stack.camera.is_recording());
    site.vehicle.orders.push_back(CameraOrder::StopVideo);
    site.run_for(millis(10));
    assert!(!site.stack.camera.is_recording());
    assert_eq!(site.vehicle.calls, [Hook::Record(2, true), Hook::Record(0, true), Hook::Record(0, false)]);
}

/// CAM-6: streams are started and stopped by their ids.
#[test]
fn streams_are_started_and_stopped() {
    let mut site = site();
    assert_eq!(command(&mut site, MavCmd::VIDEO_START_STREAMING, &[1.0]), MavResult::ACCEPTED);
    assert_eq!(command(&mut site, MavCmd::VIDEO_STOP_STREAMING, &[0.0]), MavResult::ACCEPTED);
    for stream in [4.0, -1.0, f32::NAN] {
        assert_eq!(command(&mut site, MavCmd::VIDEO_START_STREAMING, &[stream]), MavResult::DENIED);
    }
    assert_eq!(site.vehicle.calls, [Hook::Stream(1, true), Hook::Stream(0, false)]);
}

/// CAM-7: mode, zoom, focus, source and reset are the vehicle's. CAMERA_SETTINGS follows each accepted change, on every normal
/// link.
#[test]
fn settings_are_changed() {
    let nan = f32::NAN;
    for (id, params, call) in [
        (MavCmd::SET_CAMERA_MODE, [0.0, 1.0, nan], Hook::Mode(CameraMode::VIDEO)),
        (MavCmd::SET_CAMERA_MODE, [0.0, 2.0, nan], Hook::Mode(CameraMode::IMAGE_SURVEY)),
        (MavCmd::SET_CAMERA_ZOOM, [0.0, -1.0, nan], Hook::Zoom(CameraZoomType::STEP, -1.0)),
        (MavCmd::SET_CAMERA_ZOOM, [1.0, 0.0, 0.0], Hook::Zoom(CameraZoomType::CONTINUOUS, 0.0)),
        (MavCmd::SET_CAMERA_ZOOM, [2.0, 100.0, 1.0], Hook::Zoom(CameraZoomType::RANGE, 100.0)),
        (MavCmd::SET_CAMERA_FOCUS, [2.0, 12.5, 0.0], Hook::Focus(SetFocusType::RANGE, 12.5)),
        (MavCmd::SET_CAMERA_FOCUS, [3.0, 250.0, 0.0], Hook::Focus(SetFocusType::METERS, 250.0)),
        (MavCmd::SET_CAMERA_FOCUS, [5.0, nan, 0.0], Hook::Focus(SetFocusType::AUTO_SINGLE, 0.0)),
        (MavCmd::SET_CAMERA_SOURCE, [0.0, 2.0, 1.0], Hook::Source(CameraSource::IR, CameraSource::RGB)),
        (MavCmd::RESET_CAMERA_SETTINGS, [1.0, 0.0, nan], Hook::Reset),
    ] {
        let mut site = site();
        assert_eq!(command(&mut site, id, &params), MavResult::ACCEPTED, "{call:?}");
        assert_eq!(site.vehicle.calls, std::slice::from_ref(&call));
        site.run_for(secs(1));
        assert_eq!([0, 1].map(|link: usize| site.gcs[link].count_of::<CameraSettings>()), [1, 1], "{call:?}");
        let reported = site.gcs[1].all::<CameraSettings>()[0].1;
        assert_eq!((reported.mode_id, reported.zoomLevel, reported.camera_device_id), (site.vehicle.mode, 30.0, 1));

        site.vehicle.result = MavResult::TEMPORARILY_REJECTED;
        assert_eq!(command(&mut site, id, &params), MavResult::TEMPORARILY_REJECTED, "the vehicle refuses: {call:?}");
        site.run_for(secs(1));
        assert_eq!(settings(&site), 1);
    }
}

/// CAM-7, C-9: values that do not exist are DENIED and reach no hook.
#[test]
fn invalid_settings_are_denied() {
    let mut site = site();
    let nan = f32::NAN;
    for (id, params) in [
        (MavCmd::SET_CAMERA_MODE, [0.0, 3.0, 0.0]),
        (MavCmd::SET_CAMERA_MODE, [0.0, nan, 0.0]),
        (MavCmd::SET_CAMERA_ZOOM, [5.0, 1.0, 0.0]),
        (MavCmd::SET_CAMERA_ZOOM, [2.0, 101.0, 0.0]),
        (MavCmd::SET_CAMERA_ZOOM, [1.0, nan, 0.0]),
        (MavCmd::SET_CAMERA_FOCUS, [7.0, 0.0, 0.0]),
        (MavCmd::SET_CAMERA_FOCUS, [2.0, -1.0, 0.0]),
        (MavCmd::SET_CAMERA_FOCUS, [3.0, f32::INFINITY, 0.0]),
        (MavCmd::SET_CAMERA_SOURCE, [0.0, 4.0, 0.0]),
        (MavCmd::SET_CAMERA_SOURCE, [0.0, 1.0, 0.5]),
        (MavCmd::RESET_CAMERA_SETTINGS, [0.0, 0.0, 0.0]),
    ] {
        assert_eq!(command(&mut site, id, &params), MavResult::DENIED, "{id:?} {params:?}");
    }
    assert_eq!((site.vehicle.calls.len(), settings(&site)), (0, 0));
    control(&mut site).settings_changed();
    site.run_for(millis(20));
    assert_eq!(settings(&site), 1, "a change without a command");
}

/// CAM-8: a storage is formatted by its id, and the image log is reset only if that is wanted. Both only while nothing is taken.
#[test]
fn storage_is_formatted() {
    let mut site = site();
    control(&mut site).take_image();
    site.run_for(millis(50));
    let format = |site: &mut Site, params: [f32; 3]| command(site, MavCmd::STORAGE_FORMAT, &params);
    assert_eq!(format(&mut site, [2.0, 1.0, 0.0]), MavResult::ACCEPTED);
    site.run_for(millis(20));
    let storages = site.gcs[0].all::<StorageInformation>();
    assert_eq!(storages.iter().map(|(_, storage)| storage.storage_id).collect::<Vec<_>>(), [2], "its new state");
    assert_eq!(site.stack.camera.image_count(), 1);

    assert_eq!(format(&mut site, [1.0, 1.0, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(20));
    assert_eq!((site.stack.camera.image_count(), status(&site).image_count), (0, 0));
    assert_eq!(request::<CameraImageCaptured>(&mut site, 0.0), MavResult::DENIED, "forgotten");
    control(&mut site).take_image();
    site.run_for(millis(50));
    assert_eq!(reported(&site, 0), [0, 0], "it begins again");

    for params in [[0.0, 1.0, 0.0], [3.0, 1.0, 0.0], [f32::NAN, 1.0, 0.0], [1.0, 2.0, 0.0], [1.0, 1.0, -1.0]] {
        assert_eq!(format(&mut site, params), MavResult::DENIED, "{params:?}");
    }
    site.vehicle.result = MavResult::FAILED;
    assert_eq!(format(&mut site, [1.0, 1.0, 1.0]), MavResult::FAILED);
    assert_eq!(site.stack.camera.image_count(), 1, "it keeps its images");
    assert_eq!(site.vehicle.calls, [Hook::Format(2), Hook::Format(1), Hook::Format(1)]);
    site.vehicle.result = MavResult::ACCEPTED;
    command(&mut site, MavCmd::IMAGE_START_CAPTURE, &[0.0, 1.0, 0.0]);
    assert_eq!(format(&mut site, [1.0, 1.0, 1.0]), MavResult::TEMPORARILY_REJECTED, "it takes images");
    assert_eq!(site.vehicle.calls.len(), 3);
}

/// CAM-8, C-14: a broadcast formats and resets nothing.
#[test]
fn broadcast_formats_nothing() {
    let mut site = site();
    for (id, params) in [(MavCmd::STORAGE_FORMAT, [1.0, 1.0]), (MavCmd::RESET_CAMERA_SETTINGS, [1.0, 0.0])] {
        let [first, second] = params;
        let message =
            CommandLong { target_system: 0, ..site.gcs[0].long(id, [first, second, 0.0, 0.0, 0.0, 0.0, 0.0]) };
        send(&mut site, 0, STATION, &message);
        assert_eq!(site.expect::<CommandAck>(0, millis(20)).result, MavResult::DENIED);
    }
    assert!(site.vehicle.calls.is_empty());
}

/// CAM-9: a camera of the autopilot has the id 1 in messages and answers. 0 is every camera; a command for another one is DENIED.
#[test]
fn camera_id_is_checked() {
    let mut site = site();
    for (id, place) in [
        (MavCmd::IMAGE_START_CAPTURE, 0),
        (MavCmd::IMAGE_STOP_CAPTURE, 0),
        (MavCmd::VIDEO_START_CAPTURE, 2),
        (MavCmd::VIDEO_STOP_CAPTURE, 1),
        (MavCmd::SET_CAMERA_MODE, 0),
        (MavCmd::SET_CAMERA_ZOOM, 2),
        (MavCmd::SET_CAMERA_FOCUS, 2),
        (MavCmd::SET_CAMERA_SOURCE, 0),
        (MavCmd::RESET_CAMERA_SETTINGS, 1),
        (MavCmd::VIDEO_START_STREAMING, 1),
    ] {
        for (camera, is_ours) in
            [(0.0, true), (1.0, true), (f32::NAN, true), (2.0, false), (100.0, false), (0.5, false)]
        {
            site.vehicle.mode = CameraMode::VIDEO;
            let mut params = match id {
                MavCmd::RESET_CAMERA_SETTINGS | MavCmd::VIDEO_START_STREAMING => [1.0, 0.0, 0.0],
                _ => [0.0, 0.0, 0.0],
            };
            params[place] = camera;
            let ack = command_from(&mut site, 0, STATION, id, &params);
            let is_denied = ack.result == MavResult::DENIED;
            assert_eq!((is_denied, ack.result_param2), (!is_ours, 1), "{id:?}: {camera}: {ack:?}");
        }
    }
}

/// A camera that can only take images.
#[derive(Default)]
struct Simple {
    commands: Vec<MavCmd>,
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Simple, links: 1)]
struct Small {
    camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 16]>,
}

impl Vehicle for Simple {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl Commands for Simple {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        self.commands.push(command.id);
        MavResult::UNSUPPORTED.into()
    }
}

impl Camera for Simple {
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;

    fn camera_information(&self, _: &mut CameraInformation) {}

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        Shot::Taken(Image::at(cx.now()))
    }
}

/// CAM-9: commands that the flags exclude, and those of the vehicle, are passed to the vehicle. What it does not have is DENIED.
#[test]
fn commands_of_other_cameras_are_left_to_the_vehicle() {
    let mut world = World::<1, Small>::of(Setup::new());
    let others = [
        MavCmd::VIDEO_START_CAPTURE,
        MavCmd::VIDEO_STOP_CAPTURE,
        MavCmd::VIDEO_START_STREAMING,
        MavCmd::SET_CAMERA_MODE,
        MavCmd::SET_CAMERA_ZOOM,
        MavCmd::SET_CAMERA_FOCUS,
        MavCmd::STORAGE_FORMAT,
        MavCmd::DO_SET_CAM_TRIGG_DIST,
        MavCmd::CAMERA_TRACK_POINT,
    ];
    for id in others {
        world.gcs[0].command_long(id, [1.0; 7]);
        assert_eq!(world.expect::<CommandAck>(0, millis(50)).result, MavResult::UNSUPPORTED, "{id:?}");
    }
    assert_eq!(world.vehicle.commands, others);
    for id in [StorageInformation::ID, VideoStreamInformation::ID, VideoStreamStatus::ID] {
        world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(world.expect::<CommandAck>(0, millis(50)).result, MavResult::DENIED, "{id}");
    }
    world.gcs[0].command_long(MavCmd::IMAGE_START_CAPTURE, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(world.expect::<CameraImageCaptured>(0, millis(50)).image_index, 0);
}

/// C-16: what the stack refuses has its reason each time; the vehicle explains its own refusals.
#[test]
fn refusals_have_a_text() {
    const RANGE: &str = "Camera: a parameter is out of range";
    const BUSY: &str = "Camera: busy, or in another mode";
    let mut site = site();
    for (id, params, result, text) in [
        (MavCmd::IMAGE_START_CAPTURE, &[0.0, 0.0, -1.0][..], MavResult::DENIED, RANGE),
        (MavCmd::VIDEO_START_CAPTURE, &[0.0, -1.0], MavResult::DENIED, RANGE),
        (MavCmd::VIDEO_START_CAPTURE, &[0.0, 1.0], MavResult::TEMPORARILY_REJECTED, BUSY),
        (MavCmd::VIDEO_STOP_CAPTURE, &[0.5], MavResult::DENIED, RANGE),
        (MavCmd::VIDEO_START_STREAMING, &[99.0], MavResult::DENIED, RANGE),
        (MavCmd::SET_CAMERA_MODE, &[0.0, 9.0], MavResult::DENIED, RANGE),
        (MavCmd::STORAGE_FORMAT, &[9.0, 1.0, 0.0], MavResult::DENIED, RANGE),
    ] {
        for _ in 0..2 {
            site.run_for(millis(2_100));
            site.gcs[0].forget();
            assert_eq!(command(&mut site, id, params), result, "{id:?}");
            site.run_for(millis(20));
            let texts = site.gcs[0].all::<Statustext>();
            let texts: Vec<_> = texts.iter().map(|(_, text)| text.text.as_str()).collect();
            assert_eq!(texts, [Some(text)], "{id:?} {params:?}");
        }
    }
    site.run_for(secs(6));
    site.gcs[0].forget();
    site.vehicle.result = MavResult::TEMPORARILY_REJECTED;
    assert_eq!(command(&mut site, MavCmd::SET_CAMERA_MODE, &[0.0, 1.0]), MavResult::TEMPORARILY_REJECTED);
    site.run_for(millis(20));
    assert_eq!(site.gcs[0].count_of::<Statustext>(), 0);
}
