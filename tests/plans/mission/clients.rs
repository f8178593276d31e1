//! Clients that differ from each other, that disturb each other, and that give up.

use super::*;

/// M-47, M-61: clients that know only MISSION_REQUEST upload and download: dronekit answers it with MISSION_ITEM, mavez with
/// MISSION_ITEM_INT.
#[test]
fn clients_of_the_old_request_upload_and_download() {
    for is_mavez in [false, true] {
        let mut world = world::<1>();
        let items = plan(4, 1);
        let upload = Upload::new(&world.gcs[0], &items);
        let mut upload = if is_mavez { upload.like_mavez() } else { upload.like_dronekit() };
        world.run_until(secs(20), |world| {
            let now = world.now();
            upload.poll(now, &mut world.gcs[0]).is_some()
        });
        assert!(upload.result().is_some_and(|result| result.is_ok()), "{:?}", upload.result());
        assert!(world.now().as_micros() < 5_000_000, "within five seconds");
        assert_eq!(world.stack.mission().items().len(), items.len());
        for (seq, item) in (0..).zip(&items) {
            world.gcs[0].send(&MissionRequest { target_system: 1, target_component: 1, seq, mission_type: MISSION });
            let back: MissionItem = world.expect(0, millis(50));
            assert_eq!((back.seq, back.x), (seq, (f64::from(item.x) / 1e7) as f32));
        }
        assert_eq!(world.gcs[0].count_of::<MissionItemInt>(), 0);
    }
}

/// M-47: over a round trip of 1.2 s, which is longer than the interval between requests, every client uploads: QGroundControl and
/// MAVSDK know MISSION_REQUEST_INT, dronekit and mavez only MISSION_REQUEST.
#[test]
fn every_client_uploads_over_a_long_round_trip() {
    type Like = fn(Upload) -> Upload;
    let likes: [(&str, Like); 4] = [
        ("QGroundControl", Upload::like_qgroundcontrol),
        ("MAVSDK", |upload| upload.with_patience(8)),
        ("dronekit", Upload::like_dronekit),
        ("mavez", Upload::like_mavez),
    ];
    for (name, like) in likes {
        let mut world = world::<1>();
        world.lines[0].set_up(|wire| wire.latency = millis(600));
        world.lines[0].set_down(|wire| wire.latency = millis(600));
        let mut upload = like(Upload::new(&world.gcs[0], &plan(4, 1)));
        world.run_until(secs(60), |world| {
            let now = world.now();
            upload.poll(now, &mut world.gcs[0]).is_some()
        });
        assert!(upload.result().is_some_and(|result| result.is_ok()), "{name}: {:?}", upload.result());
    }
}

/// M-35, M-47: MAVSDK refuses MISSION_REQUEST with UNSUPPORTED, which is not a cancel. The vehicle's first frames are
/// lost, so that MISSION_REQUEST is the first one received.
#[test]
fn mavsdk_completes_an_upload_after_refusing_mission_request() {
    let mut world = world::<1>();
    let mut upload = Upload::new(&world.gcs[0], &plan(4, 1)).with_patience(10);
    for now in 0..10_000 {
        let loss = if now < 1_700 { 1.0 } else { 0.0 };
        world.lines[0].set_down(|wire| wire.faults.frame_loss = loss);
        world.step();
        let now = world.now();
        if upload.poll(now, &mut world.gcs[0]).is_some() {
            break;
        }
    }
    assert!(upload.result().is_some_and(|result| result.is_ok()), "{:?}", upload.result());
    assert_eq!(world.gcs[0].count_of::<MissionRequest>(), 1, "refused once, it is not sent again");
}

/// M-23, M-33: a second client is refused, and the first upload continues.
#[test]
fn second_client_is_refused_until_the_first_upload_ends() {
    let mut world = world::<2>();
    world.gcs[1].address = OTHER_STATION;
    let mut first = Upload::new(&world.gcs[0], &plan(30, 1));
    let mut refusals = 0;
    let mut second = None;
    world.run_until(secs(10), |world| {
        let now = world.now();
        if first.items_sent() >= 2 && first.result().is_none() {
            let upload = second.get_or_insert_with(|| Upload::new(&world.gcs[1], &plan(5, 2)));
            if let Some(result) = upload.poll(now, &mut world.gcs[1]) {
                assert_eq!(result, Err(TransferError::Refused(MavMissionResult::DENIED)));
                refusals += 1;
                second = None;
            }
        }
        first.poll(now, &mut world.gcs[0]).is_some()
    });
    first.result().expect("an end").expect("accepted");
    assert!(refusals > 2);
    assert_downloads(&mut world, 1, &plan(30, 1));
    world.upload(1, &plan(5, 2)).expect("accepted");
}

/// M-45, M-11: two instances of QGroundControl, both 255/190, on two links. The second downloads, tries to upload, and
/// cancels: the first one's upload continues on its link. When the first falls silent, the second can upload.
#[test]
fn stations_with_the_same_ids_do_not_disturb_each_other() {
    for is_silent in [false, true] {
        let mut world = world::<2>();
        world.gcs.iter_mut().for_each(|gcs| gcs.heartbeat_period = Some(secs(1)));
        world.upload(0, &plan(2, 9)).expect("accepted");
        let items = plan(30, 1);
        let mut first = Upload::new(&world.gcs[0], &items).with_patience(100);
        world.run_until(secs(1), |world| {
            let now = world.now();
            first.poll(now, &mut world.gcs[0]);
            first.items_sent() == 15
        });
        if is_silent {
            world.gcs[0].heartbeat_period = None;
            world.run_for(secs(2));
            world.upload(1, &plan(5, 2)).expect("accepted");
            assert_downloads(&mut world, 1, &plan(5, 2));
            continue;
        }
        // Four seconds without an item, as over a very lossy link. Heartbeats show that the client is alive.
        for _ in 0..2 {
            world.run_for(secs(2));
            assert_downloads(&mut world, 1, &plan(2, 9));
            let denied = Err(TransferError::Refused(MavMissionResult::DENIED));
            assert_eq!(world.upload(1, &plan(5, 2)), denied);
            let r#type = MavMissionResult::OPERATION_CANCELLED;
            world.gcs[1].send(&MissionAck { target_system: 1, target_component: 1, r#type, ..Default::default() });
        }
        let requests = |world: &TestWorld<2>, link: usize| world.gcs[link].count_of::<MissionRequestInt>();
        assert_eq!(requests(&world, 1), 0);
        world.run_until(secs(5), |world| {
            let now = world.now();
            first.poll(now, &mut world.gcs[0]).is_some()
        });
        first.result().expect("an end").expect("accepted");
        assert_downloads(&mut world, 1, &items);
    }
}

/// M-22, M-35: the client can restart or cancel its upload at any item. The old plan stays until the end.
#[test]
fn upload_can_be_restarted_or_cancelled_at_any_item() {
    for stop in 1..6 {
        for cancel in [false, true] {
            let mut world = world::<1>();
            world.upload(0, &plan(2, 9)).expect("accepted");
            let mut upload = Upload::new(&world.gcs[0], &plan(6, 1));
            world.run_until(secs(2), |world| {
                let now = world.now();
                upload.poll(now, &mut world.gcs[0]);
                upload.items_sent() == stop
            });
            assert_downloads(&mut world, 0, &plan(2, 9));
            if cancel {
                let cancelled = MavMissionResult::OPERATION_CANCELLED;
                world.gcs[0].send(&MissionAck {
                    target_system: 1,
                    target_component: 1,
                    r#type: cancelled,
                    ..Default::default()
                });
                world.run_for(millis(300));
                world.gcs[0].forget();
                world.expect_no::<MissionRequestInt>(0, secs(7));
                assert_eq!(world.gcs[0].count_of::<MissionAck>(), 0, "a cancel is not answered");
                assert_downloads(&mut world, 0, &plan(2, 9));
            }
            world.upload(0, &plan(4, 3)).expect("accepted");
            assert_downloads(&mut world, 0, &plan(4, 3));
        }
    }
}

/// M-41, D-6, PX4#27132: a client whose link fails blocks others for a few seconds at most.
#[test]
fn vanished_client_does_not_block_others() {
    let mut world = world::<2>();
    world.gcs[1].address = OTHER_STATION;
    world.upload(0, &plan(4, 9)).expect("accepted");
    let mut upload = Upload::new(&world.gcs[0], &plan(30, 1));
    world.run_until(secs(1), |world| {
        let now = world.now();
        upload.poll(now, &mut world.gcs[0]);
        upload.items_sent() == 10
    });
    // The line is cut, and accepts no bytes from the vehicle.
    let broken = world.now();
    world.uarts[0].stall_writes_until(broken + secs(60));
    world.lines[0].set_up(|wire| wire.faults.byte_loss = 1.0);
    let mut accepted = None;
    world.run_until(secs(20), |world| {
        accepted = world.upload(1, &plan(3, 2)).ok().map(|_| world.now());
        accepted.is_some()
    });
    assert!(accepted.expect("accepted") - broken <= secs(8));
    assert_downloads(&mut world, 1, &plan(3, 2));
    let mut texts = world.gcs[1].all::<Statustext>().into_iter();
    assert!(texts.any(|(_, text)| text.text.as_bytes().starts_with(b"Mission upload timed out at item ")));
}

/// M-60: three clients on two links download at once, one of them in random order.
#[test]
fn three_clients_download_at_once() {
    let mut world = world::<2>();
    let items = plan(CAPACITY, 1);
    world.upload(0, &items).expect("accepted");
    let third = mavstack::Address::new(200, 190);
    let mut downloads = [
        (0, Download::new(&world.gcs[0], MISSION)),
        (1, Download::new(&world.gcs[1], MISSION).by(OTHER_STATION)),
        (1, Download::new(&world.gcs[1], MISSION).by(third)),
    ];
    let done = world.run_until(secs(10), |world| {
        let now = world.now();
        for (link, download) in &mut downloads {
            download.poll(now, &mut world.gcs[*link]);
        }
        downloads.iter().all(|(_, download)| download.result().is_some())
    });
    assert!(done);
    for (_, download) in downloads {
        assert_eq!(content(&download.result().unwrap().expect("complete")), content(&items));
    }
    let mut rng = Rng::new(1);
    for _ in 0..50 {
        let seq = rng.below(CAPACITY.into()) as u16;
        let request = MissionRequestInt { seq, target_system: 1, target_component: 1, mission_type: MISSION };
        world.gcs[0].forget();
        world.gcs[0].send(&request);
        let item: MissionItemInt = world.expect(0, millis(100));
        assert_eq!(content(&[item]), content(&items[usize::from(seq)..][..1]));
    }
}

/// M-63: a plan that is replaced during a download cancels the download, so no client sees half of each plan.
#[test]
fn new_plan_cancels_running_downloads() {
    let mut world = world::<2>();
    world.gcs[1].address = OTHER_STATION;
    world.upload(0, &plan(30, 1)).expect("accepted");
    let mut download = Download::new(&world.gcs[1], MISSION);
    world.run_until(millis(20), |world| {
        let now = world.now();
        download.poll(now, &mut world.gcs[1]).is_some()
    });
    assert_eq!(download.result(), None);
    world.upload(0, &plan(30, 2)).expect("accepted");
    world.run_until(secs(3), |world| {
        let now = world.now();
        download.poll(now, &mut world.gcs[1]).is_some()
    });
    assert_eq!(download.result(), Some(Err(TransferError::Refused(MavMissionResult::OPERATION_CANCELLED))));
    assert_downloads(&mut world, 1, &plan(30, 2));
}
