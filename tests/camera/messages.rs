//! What a camera reports: its description, its state, and its images. Rules CAM-1 to CAM-3 and CAM-5.

use crate::shooter::*;
use crate::support::*;
use mavstack::camera::CameraCounters;
use mavstack::dialect::*;
use mavstack::{LinkId, Message};

/// CAM-1: CAMERA_INFORMATION says what the camera is; the stack fills in what it knows.
#[test]
fn camera_describes_itself() {
    let mut site = site();
    assert_eq!(request::<CameraInformation>(&mut site, f32::NAN), MavResult::ACCEPTED);
    let information = site.expect::<CameraInformation>(0, millis(10));
    assert_eq!(information.flags, FLAGS);
    assert_eq!(&information.vendor_name[..5], b"Acme\0");
    assert_eq!((information.resolution_h, information.camera_device_id), (4_000, 1));
    assert!(information.focal_length.is_nan(), "unknown");
    assert_eq!(information.cam_definition_uri.as_str(), Some("mftp:///camera.xml"));
    assert!(information.time_boot_ms > 0);
}

/// CAM-1: each message is sent once, on the link of the request, whichever form the request has.
#[test]
fn messages_are_sent_on_request_in_both_forms() {
    fn asks<M: Message>(old: MavCmd, params: &[f32], index: f32) {
        let mut site = site();
        for round in 1..=2 {
            let result = match round {
                1 => request::<M>(&mut site, index),
                _ => command(&mut site, old, params),
            };
            assert_eq!(result, MavResult::ACCEPTED, "{}", M::NAME);
            site.run_for(millis(20));
            assert_eq!(site.gcs[0].count_of::<M>(), round, "{}", M::NAME);
            assert_eq!(site.gcs[1].count_of::<M>(), 0, "{}", M::NAME);
        }
    }
    asks::<CameraInformation>(MavCmd::REQUEST_CAMERA_INFORMATION, &[1.0], 0.0);
    asks::<CameraSettings>(MavCmd::REQUEST_CAMERA_SETTINGS, &[1.0], 0.0);
    asks::<CameraCaptureStatus>(MavCmd::REQUEST_CAMERA_CAPTURE_STATUS, &[1.0], 0.0);
    asks::<StorageInformation>(MavCmd::REQUEST_STORAGE_INFORMATION, &[1.0, 1.0], 1.0);
    asks::<VideoStreamInformation>(MavCmd::REQUEST_VIDEO_STREAM_INFORMATION, &[2.0], 2.0);
    asks::<VideoStreamStatus>(MavCmd::REQUEST_VIDEO_STREAM_STATUS, &[3.0], 3.0);
}

/// CAM-1: an invalid request is DENIED, and a message that is not the camera's is left to others.
#[test]
fn invalid_requests_are_denied() {
    let mut site = site();
    for (id, params) in [
        (MavCmd::REQUEST_CAMERA_INFORMATION, [0.0, 0.0]),
        (MavCmd::REQUEST_CAMERA_SETTINGS, [2.0, 0.0]),
        (MavCmd::REQUEST_STORAGE_INFORMATION, [1.0, 0.0]),
        (MavCmd::REQUEST_STORAGE_INFORMATION, [3.0, 1.0]),
        (MavCmd::REQUEST_VIDEO_STREAM_INFORMATION, [4.0, 0.0]),
        (MavCmd::REQUEST_VIDEO_STREAM_STATUS, [0.5, 0.0]),
        (MavCmd::REQUEST_VIDEO_STREAM_STATUS, [-1.0, 0.0]),
        (MavCmd::REQUEST_MESSAGE, [StorageInformation::ID as f32, 9.0]),
        (MavCmd::REQUEST_MESSAGE, [Attitude::ID as f32, 0.0]),
    ] {
        assert_eq!(command(&mut site, id, &params), MavResult::DENIED, "{id:?} {params:?}");
    }
    let target = [CameraInformation::ID as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 3.0];
    assert_eq!(command(&mut site, MavCmd::REQUEST_MESSAGE, &target), MavResult::DENIED, "no such response target");
    site.expect_no::<StorageInformation>(0, millis(50));
    assert_eq!(request::<AutopilotVersion>(&mut site, 0.0), MavResult::ACCEPTED);
}

/// CAM-1, Q-3: 0 and NaN are all storages and streams, another number is one of them.
#[test]
fn storages_and_streams_are_told_apart() {
    let mut site = site();
    for all in [0.0, f32::NAN] {
        site.gcs[0].forget();
        assert_eq!(request::<StorageInformation>(&mut site, all), MavResult::ACCEPTED);
        assert_eq!(request::<VideoStreamInformation>(&mut site, all), MavResult::ACCEPTED);
        site.run_for(millis(50));
        let storages = site.gcs[0].all::<StorageInformation>();
        let storages = storages.iter().map(|(_, s)| (s.storage_id, s.storage_count, s.available_capacity));
        assert_eq!(storages.collect::<Vec<_>>(), [(1, 2, 100.0), (2, 2, 200.0)]);
        let streams = site.gcs[0].all::<VideoStreamInformation>();
        let streams = streams.iter().map(|(_, s)| (s.stream_id, s.count, s.resolution_h));
        assert_eq!(streams.collect::<Vec<_>>(), [(1, 3, 640), (2, 3, 1_280), (3, 3, 1_920)]);
    }
    site.gcs[0].forget();
    assert_eq!(request::<VideoStreamStatus>(&mut site, 2.0), MavResult::ACCEPTED);
    let state = site.expect::<VideoStreamStatus>(0, millis(10));
    assert_eq!((state.stream_id, state.resolution_h, state.framerate), (2, 1_280, 25.0));
    site.expect_no::<VideoStreamStatus>(0, millis(50));
}

/// CAM-2: an image is reported once on every normal link that carries MAVLink 2, with what the camera knows of it.
#[test]
fn image_is_reported_on_every_normal_link() {
    let mut site = site();
    assert_eq!(command(&mut site, MavCmd::IMAGE_START_CAPTURE, &[0.0, 0.0, 1.0, 1.0]), MavResult::ACCEPTED);
    let taken = site.now();
    site.run_for(secs(2));
    for link in [0, 1] {
        let images = site.gcs[link].all::<CameraImageCaptured>();
        let [(_, captured)] = images[..] else { panic!("link {link}: {images:?}") };
        assert_eq!((captured.image_index, captured.capture_result, captured.camera_id), (0, 1, 1));
        assert_eq!((captured.lat, captured.lon, captured.alt), (470_000_000, -80_000_000, 500_000));
        assert_eq!((captured.relative_alt, captured.q), (50_000, [1.0, 0.0, 0.0, 0.0]));
        assert!(captured.time_boot_ms.abs_diff(taken.time_boot_ms()) <= 2, "when it was taken");
        assert_eq!(captured.time_utc, 1_700_000_000_000_000);
        assert_eq!(captured.file_url.as_str(), Some("mftp:///DCIM/0"));
    }
    let sent = |link: usize| site.gcs[link].received.iter().any(|frame| (256..300).contains(&frame.header.id));
    assert!(!sent(OLD), "S-10");
    assert!(site.gcs[SATELLITE].received.is_empty(), "L-2: {:?}", site.gcs[SATELLITE].received);
    assert_eq!(site.stack.camera.image_count(), 1);
}

/// CAM-3: a lost report is sent again on request, only on that link, in both forms. MAVSDK's request has no index: it is DENIED,
/// so MAVSDK uses the other form.
#[test]
fn lost_reports_are_sent_again() {
    let mut site = site();
    for _ in 0..10 {
        assert!(control(&mut site).take_image());
        site.run_for(millis(30));
    }
    assert_eq!(reported(&site, 0), (0..10).collect::<Vec<_>>());
    site.gcs[0].forget();
    for (index, expected) in [
        (9.0, MavResult::ACCEPTED),
        (2.0, MavResult::ACCEPTED),
        // Forgotten: eight are remembered.
        (1.0, MavResult::FAILED),
        (10.0, MavResult::DENIED),
        (0.5, MavResult::DENIED),
        (-1.0, MavResult::DENIED),
        (f32::NAN, MavResult::DENIED),
    ] {
        assert_eq!(request::<CameraImageCaptured>(&mut site, index), expected, "{index}");
        site.run_for(millis(20));
    }
    assert_eq!(command(&mut site, MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE, &[5.0]), MavResult::ACCEPTED);
    site.run_for(millis(20));
    assert_eq!(reported(&site, 0), [9, 2, 5]);
    let images = site.gcs[0].all::<CameraImageCaptured>();
    assert_eq!(images[1].1.lat, 470_000_002, "as it was");
    assert_eq!(reported(&site, 1).len(), 10);
}

/// CAM-3, D-3: four reports can be requested at a time; another one is TEMPORARILY_REJECTED, and has no effect.
#[test]
fn requests_for_reports_are_bounded() {
    let mut site = site();
    for _ in 0..8 {
        control(&mut site).take_image();
        site.run_for(millis(30));
    }
    // Of a slow line, answers go first.
    site.lines[0].set_down(|wire| (wire.bytes_per_second, wire.tx_fifo) = (100, 16));
    site.gcs[0].forget();
    let ask = |site: &mut Site, index: f32| {
        let message = site.gcs[0].long(MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE, [index, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        send(site, 0, STATION, &message);
    };
    let results = |site: &Site| {
        let acks = site.gcs[0].all::<CommandAck>();
        acks.iter().map(|(_, ack)| ack.result).collect::<Vec<_>>()
    };
    for index in [0.0, 1.0, 2.0, 3.0] {
        ask(&mut site, index);
    }
    assert!(site.run_until(secs(5), |site| results(site).len() == 2));
    // A request for one of these is no other one.
    ask(&mut site, 3.0);
    ask(&mut site, 4.0);
    site.run_for(secs(20));
    let [accepted, rejected] = [MavResult::ACCEPTED, MavResult::TEMPORARILY_REJECTED];
    assert_eq!(results(&site), [accepted, accepted, accepted, accepted, accepted, rejected]);
    assert_eq!(reported(&site, 0), [0, 1, 2, 3]);
}

/// CAM-2, D-3: a stalled link delays reports and loses none that is remembered; those beyond are counted.
#[test]
fn stalled_link_reports_later() {
    for (images, expected, unsent) in [(8, 0..8, 0), (11, 3..11, 3)] {
        let mut site = site();
        let now = site.now();
        site.uarts[0].stall_writes_until(now + secs(3));
        for _ in 0..images {
            assert!(control(&mut site).take_image());
            site.run_for(millis(50));
        }
        assert_eq!((reported(&site, 0), reported(&site, 1).len()), (vec![], images));
        site.run_for(secs(4));
        assert_eq!(reported(&site, 0), expected.collect::<Vec<i32>>());
        let counted = counted::<CameraCounters>(|counters| counters.unsent = unsent);
        assert_eq!(site.stack.camera.counters(), counted);
    }
}

/// CAM-2: a link that was opened again reports only later images.
#[test]
fn restarted_link_begins_again() {
    let mut site = site();
    let now = site.now();
    site.uarts[0].stall_writes_until(now + millis(500));
    for _ in 0..3 {
        control(&mut site).take_image();
        site.run_for(millis(50));
    }
    site.stack.restart_link(LinkId(0));
    site.run_for(secs(1));
    control(&mut site).take_image();
    site.run_for(millis(50));
    // A report whose first byte was on its way is not taken back.
    let late: Vec<_> = reported(&site, 0).into_iter().filter(|index| *index > 0).collect();
    assert_eq!(late, [3]);
    assert_eq!(reported(&site, 1), [0, 1, 2, 3]);
}

/// CAM-5: CAMERA_CAPTURE_STATUS is sent on every normal link after a change, and not otherwise.
#[test]
fn state_is_reported_after_a_change() {
    let mut site = site();
    site.run_for(secs(3));
    assert_eq!([0, 1].map(|link: usize| site.gcs[link].count_of::<CameraCaptureStatus>()), [0, 0]);

    site.vehicle.shutter = Shutter::Slow;
    assert_eq!(command(&mut site, MavCmd::IMAGE_START_CAPTURE, &[0.0, 0.0, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(20));
    assert_eq!((status(&site).image_status, status(&site).image_count), (1, 0), "an image is being taken");
    let taken = image(site.now(), 0);
    control(&mut site).image_captured(taken);
    site.run_for(millis(20));
    assert_eq!((status(&site).image_status, status(&site).image_count), (0, 1));
    assert_eq!(status(&site).available_capacity, 100.0, "of the first storage");

    site.vehicle.shutter = Shutter::Instant;
    assert_eq!(command(&mut site, MavCmd::IMAGE_START_CAPTURE, &[0.0, 1.5, 0.0]), MavResult::ACCEPTED);
    site.run_for(millis(20));
    assert_eq!((status(&site).image_status, status(&site).image_interval), (2, 1.5));
    assert_eq!(command(&mut site, MavCmd::IMAGE_STOP_CAPTURE, &[0.0]), MavResult::ACCEPTED);
    site.run_for(millis(20));
    assert_eq!((status(&site).image_status, status(&site).image_interval), (0, 0.0));
    let states = site.gcs[0].all::<CameraCaptureStatus>().len();
    assert_eq!(site.gcs[1].count_of::<CameraCaptureStatus>(), states);
    site.run_for(secs(3));
    assert_eq!(site.gcs[0].count_of::<CameraCaptureStatus>(), states, "nothing changes");
}

/// CAM-5, Q-4: MAV_CMD_SET_MESSAGE_INTERVAL sets the interval of CAMERA_CAPTURE_STATUS on its link.
#[test]
fn state_is_reported_at_an_interval() {
    let mut site = site();
    let id = CameraCaptureStatus::ID as f32;
    let count = |site: &Site| [0, 1].map(|link: usize| site.gcs[link].count_of::<CameraCaptureStatus>());
    assert_eq!(command(&mut site, MavCmd::SET_MESSAGE_INTERVAL, &[id, 500_000.0]), MavResult::ACCEPTED);
    site.run_for(millis(5_100));
    assert_eq!(count(&site), [11, 0]);
    let times: Vec<_> = site.gcs[0].all::<CameraCaptureStatus>().iter().map(|(at, _)| at.as_millis()).collect();
    assert!(times.windows(2).all(|pair| (499..=502).contains(&(pair[1] - pair[0]))), "{times:?}");
    // A shorter one is clamped to 100 ms.
    assert_eq!(command(&mut site, MavCmd::SET_MESSAGE_INTERVAL, &[id, 1.0]), MavResult::ACCEPTED);
    site.run_for(millis(1_050));
    assert!((21..=22).contains(&count(&site)[0]), "{:?}", count(&site));
    for off in [-1.0, 0.0] {
        assert_eq!(command(&mut site, MavCmd::SET_MESSAGE_INTERVAL, &[id, off]), MavResult::ACCEPTED);
        site.gcs[0].forget();
        site.run_for(secs(1));
        assert_eq!(count(&site), [0, 0]);
    }
    for invalid in [-2.0, f32::NAN] {
        assert_eq!(command(&mut site, MavCmd::SET_MESSAGE_INTERVAL, &[id, invalid]), MavResult::DENIED);
    }
}

/// CAM-1, S-10, L-4: a link that cannot carry the messages refuses the requests, and gets none.
#[test]
fn links_without_room_for_the_ids_refuse() {
    let mut site = site();
    for link in [OLD, SATELLITE] {
        for params in [
            (MavCmd::REQUEST_MESSAGE, [CameraInformation::ID as f32, 0.0]),
            (MavCmd::REQUEST_MESSAGE, [CameraImageCaptured::ID as f32, 0.0]),
            (MavCmd::REQUEST_CAMERA_SETTINGS, [1.0, 0.0]),
            (MavCmd::SET_MESSAGE_INTERVAL, [CameraCaptureStatus::ID as f32, 1e6]),
        ] {
            let ack = command_from(&mut site, link, STATION, params.0, &params.1);
            assert_eq!(ack.result, MavResult::DENIED, "link {link}: {params:?}");
        }
        // But the camera takes images for everyone.
        let ack = command_from(&mut site, link, STATION, MavCmd::IMAGE_START_CAPTURE, &[0.0, 0.0, 1.0]);
        assert_eq!(ack.result, MavResult::ACCEPTED);
        site.run_for(millis(100));
        assert!(site.gcs[link].received.iter().all(|frame| frame.header.id < 256), "link {link}");
    }
    assert_eq!(reported(&site, 0), [0, 1]);
}

/// D-4: a firmware that sleeps until the next deadline loses no image, no report and no state.
#[test]
fn sleeping_firmware_is_in_time() {
    let mut site = site();
    command(&mut site, MavCmd::IMAGE_START_CAPTURE, &[0.0, 2.0, 5.0]);
    let passes = site.sleep_for(secs(20));
    assert_eq!(reported(&site, 1), [0, 1, 2, 3, 4]);
    let times: Vec<_> = site.vehicle.exposures.iter().map(|(at, _)| at.as_millis()).collect();
    assert!(times.windows(2).all(|pair| (1_999..=2_001).contains(&(pair[1] - pair[0]))), "{times:?}");
    assert!(passes < 400, "{passes} passes: it spins");
}
