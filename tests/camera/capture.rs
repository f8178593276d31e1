//! When a camera takes images: on command, at intervals, and for the vehicle itself. Rules CAM-2 and CAM-4.

use crate::shooter::*;
use crate::support::*;
use mavstack::camera::{CameraCounters, CameraOrder};
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::{LinkConfig, Message};

const START: MavCmd = MavCmd::IMAGE_START_CAPTURE;
const STOP: MavCmd = MavCmd::IMAGE_STOP_CAPTURE;

/// CAM-4: a single image with the same sequence number from the same sender within three seconds is a retransmission. Without a
/// number, or with another one, it is a new image.
#[test]
fn retransmission_takes_no_second_image() {
    let mut site = site();
    let shoot = |site: &mut Site, from, sequence| {
        let ack = command_from(site, 0, from, START, &[0.0, 0.0, 1.0, sequence]);
        site.run_for(millis(100));
        (ack.result, site.vehicle.exposures.len())
    };
    let accepted = MavResult::ACCEPTED;
    assert_eq!(shoot(&mut site, STATION, 7.0), (accepted, 1));
    assert_eq!(shoot(&mut site, STATION, 7.0), (accepted, 1), "a retransmission");
    assert_eq!(shoot(&mut site, OTHER_STATION, 7.0), (accepted, 2), "of another sender");
    assert_eq!(shoot(&mut site, OTHER_STATION, 8.0), (accepted, 3));
    site.run_for(secs(3));
    assert_eq!(shoot(&mut site, OTHER_STATION, 8.0), (accepted, 4), "a client that was started again");
    for number in [0.0, f32::NAN] {
        let before = site.vehicle.exposures.len();
        assert_eq!(shoot(&mut site, STATION, number), (accepted, before + 1));
        assert_eq!(shoot(&mut site, STATION, number), (accepted, before + 2), "pressed twice");
    }
    assert_eq!(reported(&site, 1), (0..8).collect::<Vec<_>>());
}

/// CAM-4: while an image is being taken, and while images are taken at an interval, another command to start is
/// TEMPORARILY_REJECTED.
#[test]
fn busy_camera_rejects_for_now() {
    let mut site = site();
    site.vehicle.shutter = Shutter::Slow;
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(50));
    for params in [[0.0, 0.0, 1.0], [0.0, 1.0, 5.0]] {
        assert_eq!(command(&mut site, START, &params), MavResult::TEMPORARILY_REJECTED);
    }
    let taken = image(site.now(), 0);
    control(&mut site).image_captured(taken);
    site.vehicle.shutter = Shutter::Instant;
    assert_eq!(command(&mut site, START, &[0.0, 1.0, 0.0]), MavResult::ACCEPTED);
    site.run_for(millis(10));
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::TEMPORARILY_REJECTED);
    assert_eq!(command(&mut site, START, &[0.0, 2.0, 0.0]), MavResult::TEMPORARILY_REJECTED, "another interval");
    // A retransmission: it starts nothing.
    assert_eq!(command(&mut site, START, &[0.0, 1.0, 0.0]), MavResult::ACCEPTED);
    let other = command_from(&mut site, 0, OTHER_STATION, START, &[0.0, 1.0, 0.0]);
    assert_eq!(other.result, MavResult::TEMPORARILY_REJECTED);
    assert_eq!(command(&mut site, STOP, &[0.0]), MavResult::ACCEPTED);
    assert_eq!(command(&mut site, STOP, &[0.0]), MavResult::ACCEPTED, "it has stopped");
    assert_eq!(command(&mut site, START, &[0.0, 1.0, 0.0]), MavResult::ACCEPTED);
}

/// CAM-4: images are taken at the interval, from the command on, and as many as were wanted. A late poll shifts none of the later
/// ones.
#[test]
fn images_are_taken_at_the_interval() {
    let mut site = site();
    let start = site.now();
    assert_eq!(command(&mut site, START, &[0.0, 0.7, 5.0, 3.0]), MavResult::ACCEPTED);
    site.run_for(millis(1_340));
    // The third image is due meanwhile.
    let late = start + millis(1_450);
    site.step_to(late);
    site.run_for(secs(10));
    let times: Vec<_> = site.vehicle.exposures.iter().map(|(at, _)| (*at - start).as_millis()).collect();
    assert_eq!(times.len(), 5, "{times:?}");
    for (time, planned) in times.iter().zip([0, 700, 1_450, 2_100, 2_800]) {
        assert!((planned..=planned + 2).contains(time), "{times:?}");
    }
    assert_eq!(reported(&site, 0), [0, 1, 2, 3, 4]);
    assert!(!site.stack.camera.is_capturing());
    assert_eq!(status(&site).image_status, 0);
}

/// CAM-4: without a number of images they go on until the stop. An interval that is too short is clamped.
#[test]
fn unlimited_capture_ends_by_command() {
    let mut site = site();
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 0.0]), MavResult::ACCEPTED);
    site.run_for(millis(9_990));
    assert_eq!(site.vehicle.exposures.len(), 20, "every 500 ms, the camera's shortest");
    assert_eq!(status(&site).image_interval, 0.5);
    command(&mut site, STOP, &[f32::NAN]);
    site.run_for(secs(5));
    assert_eq!(site.vehicle.exposures.len(), 20);
}

/// CAM-4: a slow camera is not asked for an image while it takes another one. The next one follows at once, and none is left out.
#[test]
fn slow_camera_takes_all_images() {
    let mut site = site();
    site.vehicle.shutter = Shutter::Slow;
    command(&mut site, START, &[0.0, 0.5, 3.0]);
    for index in 0..3 {
        site.run_for(millis(800));
        assert_eq!(site.vehicle.exposures.len(), index + 1);
        let taken = image(site.now(), index as u32);
        control(&mut site).image_captured(taken);
    }
    site.run_for(secs(3));
    assert_eq!(reported(&site, 0), [0, 1, 2]);
    let times: Vec<_> = site.vehicle.exposures.iter().map(|(at, _)| at.as_millis()).collect();
    assert!(times.windows(2).all(|pair| (800..=803).contains(&(pair[1] - pair[0]))), "{times:?}");
}

/// CAM-2: an image that cannot be taken, or whose end is not reported in time, has its index and is reported as a failure.
#[test]
fn failed_images_are_reported_too() {
    let mut site = site();
    site.vehicle.shutter = Shutter::Broken;
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(50));
    site.vehicle.shutter = Shutter::Slow;
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(1_950));
    assert!(site.stack.camera.is_capturing());
    site.run_for(millis(200));
    assert!(!site.stack.camera.is_capturing());
    site.vehicle.shutter = Shutter::Instant;
    control(&mut site).take_image();
    site.run_for(millis(50));
    let images = site.gcs[0].all::<CameraImageCaptured>();
    let images: Vec<_> = images.iter().map(|(_, image)| (image.image_index, image.capture_result)).collect();
    assert_eq!(images, [(0, 0), (1, 0), (2, 1)]);
    let counters = counted::<CameraCounters>(|counters| (counters.failed, counters.timed_out) = (2, 1));
    assert_eq!(site.stack.camera.counters(), counters);
}

/// CAM-2: an image that the camera has taken by itself is counted and reported like all others.
#[test]
fn image_by_a_button_counts() {
    let mut site = site();
    let taken = image(site.now(), 0);
    control(&mut site).image_captured(taken);
    site.run_for(millis(20));
    assert_eq!((reported(&site, 0), status(&site).image_count), (vec![0], 1));
}

/// CAM-4: parameters that are no interval, number or sequence are DENIED, and nothing is taken.
#[test]
fn invalid_starts_are_denied() {
    let mut site = site();
    let nan = f32::NAN;
    for params in [
        [0.0, -1.0, 1.0, 0.0],
        [0.0, f32::INFINITY, 0.0, 0.0],
        [0.0, 1e9, 0.0, 0.0],
        [0.0, 1.0, -1.0, 0.0],
        [0.0, 1.0, 1.5, 0.0],
        [0.0, 1.0, nan, 0.0],
        [0.0, 1.0, 1.0, -3.0],
        [0.0, 1.0, 1.0, 0.5],
        [2.0, 1.0, 1.0, 0.0],
    ] {
        assert_eq!(command(&mut site, START, &params), MavResult::DENIED, "{params:?}");
    }
    assert_eq!(command(&mut site, START, &[nan, nan, 1.0, nan]), MavResult::ACCEPTED, "C-8: not given");
    site.run_for(secs(1));
    assert_eq!(site.vehicle.exposures.len(), 1);
}

/// CAM-4: the vehicle may refuse, and a camera with modes takes images in the video mode only if it can.
#[test]
fn vehicle_may_refuse_images() {
    let mut site = site();
    site.vehicle.may_capture = MavResult::FAILED;
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::FAILED);
    site.vehicle.may_capture = MavResult::ACCEPTED;
    site.vehicle.mode = CameraMode::VIDEO;
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::TEMPORARILY_REJECTED);
    site.vehicle.mode = CameraMode::IMAGE_SURVEY;
    assert_eq!(command(&mut site, START, &[0.0, 0.0, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(50));
    assert_eq!(site.vehicle.exposures.len(), 1);
}

/// CAM-4: MAV_CMD_DO_DIGICAM_CONTROL of the first camera protocol takes an image, as COMMAND_LONG and COMMAND_INT.
#[test]
fn digicam_control_takes_an_image() {
    let mut site = site();
    let shoot = |param5| [0.0, 0.0, 0.0, 0.0, param5];
    assert_eq!(command(&mut site, MavCmd::DO_DIGICAM_CONTROL, &shoot(1.0)), MavResult::ACCEPTED);
    site.run_for(millis(50));
    for param5 in [0.0, 2.0, f32::NAN] {
        assert_eq!(command(&mut site, MavCmd::DO_DIGICAM_CONTROL, &shoot(param5)), MavResult::DENIED);
    }
    let (target_system, target_component, command) = (1, 1, MavCmd::DO_DIGICAM_CONTROL);
    send(&mut site, 1, STATION, &CommandInt { target_system, target_component, command, x: 1, ..Default::default() });
    assert_eq!(site.expect::<CommandAck>(1, millis(20)).result, MavResult::ACCEPTED);
    site.run_for(millis(50));
    assert_eq!(reported(&site, 0), [0, 1]);
}

/// CAM-4: the vehicle's own orders, by its hook and from its loop, have the same effect as commands. An order for a single image
/// while another one waits for the camera is counted, and not repeated later.
#[test]
fn vehicle_takes_images_itself() {
    let mut site = site();
    site.vehicle.orders.push_back(CameraOrder::TakeImage);
    site.run_for(millis(50));
    assert_eq!(site.vehicle.exposures.len(), 1);
    // An item of its mission, and a single image meanwhile.
    site.vehicle.orders.push_back(CameraOrder::StartCapture { interval: secs(1), count: 3 });
    site.run_for(millis(500));
    assert!(control(&mut site).take_image());
    site.run_for(secs(4));
    assert_eq!(site.vehicle.exposures.len(), 5);
    let now = site.now();
    control(&mut site).start_capture(now, millis(200), 0);
    site.run_for(millis(1_100));
    site.vehicle.orders.push_back(CameraOrder::StopCapture);
    site.run_for(secs(2));
    assert_eq!(site.vehicle.exposures.len(), 11);
    assert_eq!(reported(&site, 1), (0..11).collect::<Vec<_>>());

    site.vehicle.shutter = Shutter::Slow;
    assert!(control(&mut site).take_image());
    site.run_for(millis(50));
    assert!(control(&mut site).take_image(), "it waits for the camera");
    assert!(!control(&mut site).take_image());
    let taken = image(site.now(), 11);
    control(&mut site).image_captured(taken);
    site.run_for(millis(50));
    assert_eq!(site.vehicle.exposures.len(), 13);
    assert_eq!(site.stack.camera.counters().ignored, 1);
}

/// X-2, CAM-2: a survey's images are told on all links, 200 of 200 on each, though a stranger asks for everything that the camera has
/// on one of them.
#[test]
fn survey_is_told_on_all_links() {
    let uart = LinkConfig::uart(57_600).with_streams(StreamProfile::Off);
    let links = [uart, uart, uart.with_version(TxVersion::V1), uart.with_class(LinkClass::HighLatency)];
    let lines = [LineConfig::radio(57_600, millis(10)); 4];
    let mut site = Site::of(Setup { links, lines, step: millis(5), ..Setup::new() });
    site.gcs[0].command_long(START, [0.0, 0.5, 200.0, 1.0, 0.0, 0.0, 0.0]);
    site.gcs[1].address = OTHER_STATION;
    for round in 0..2_100u16 {
        match round % 4 {
            0 => site.gcs[1].command_long(START, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            1 => {
                let message = [CameraInformation::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
                site.gcs[1].command_long(MavCmd::REQUEST_MESSAGE, message);
            }
            2 => site.gcs[1].command_long(MavCmd::SET_CAMERA_ZOOM, [f32::NAN; 7]),
            _ => site.gcs[1].command_long(MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        }
        site.run_for(millis(50));
    }
    for link in [0, 1] {
        let mut images = reported(&site, link);
        images.sort_unstable();
        images.dedup();
        // Afterwards the other station's begins.
        assert_eq!(images[..200], (0..200).collect::<Vec<_>>(), "link {link}");
    }
}
