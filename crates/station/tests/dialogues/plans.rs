//! Plans.

use crate::vehicle::{persist, rig};
use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult};
use mavstack::{Duration, Item};
use mavstack_station::command::Place;
use mavstack_station::plans::waypoint;
use mavstack_station::{Client, Failure, GroundStation};

/// A mission of `count` waypoints, with a jump at its end.
fn mission(count: i32) -> Vec<Item> {
    let mut items: Vec<_> =
        (0..count).map(|i| waypoint(Place::relative(47.0 + f64::from(i) / 100.0, 8.5, 30.0))).collect();
    items.push(Item {
        frame: MavFrame::MISSION,
        command: MavCmd::DO_JUMP,
        autocontinue: 1,
        params: [0.0, 2.0, 0.0, 0.0],
        ..Item::default()
    });
    items
}

fn fence() -> Vec<Item> {
    let corners = [(47.0, 8.0), (47.0, 8.1), (47.1, 8.1), (47.1, 8.0)];
    let vertex = |(latitude, longitude)| Item {
        command: MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        params: [4.0, 0.0, 0.0, 0.0],
        ..waypoint(Place::global(latitude, longitude, 0.0))
    };
    corners.map(vertex).to_vec()
}

fn rally() -> Vec<Item> {
    let place = Place::relative(47.05, 8.05, 40.0);
    vec![Item { command: MavCmd::NAV_RALLY_POINT, params: [0.0; 4], ..waypoint(place) }]
}

/// Positions in MISSION_ITEM are `f32`: the script of pymavlink is off by up to half a metre. A NaN is not equal to itself.
fn assert_same(sent: &[Item], received: &[Item], client: Client) {
    assert_eq!(sent.len(), received.len(), "{client}");
    let tolerance = if client == Client::Pymavlink { 20 } else { 0 };
    for (a, b) in sent.iter().zip(received) {
        assert_eq!((a.command, a.frame, a.z), (b.command, b.frame, b.z), "{client}");
        assert_eq!(a.params.map(f32::to_bits), b.params.map(f32::to_bits), "{client}");
        let is_near = |a: i32, b: i32| a.abs_diff(b) <= tolerance;
        assert!(is_near(a.x, b.x) && is_near(a.y, b.y), "{client}: {a:?} {b:?}");
    }
}

#[test]
fn every_client_uploads_and_downloads_every_plan() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let id = rig.upload_mission(&mission(12))?;
        assert_ne!(id, 0, "{client}");
        assert_same(&mission(12), &rig.download_mission()?, client);
        rig.upload_fence(&fence())?;
        rig.upload_rally(&rally())?;
        assert_same(&fence(), &rig.download_fence()?, client);
        assert_same(&rally(), &rig.download_rally()?, client);
        rig.clear_fence()?;
        assert_eq!(rig.download_fence()?, [], "{client}");
        rig.clear_rally()?;
        rig.clear_mission()?;
        assert_eq!(rig.download_mission()?, [], "{client}");
    }
    Ok(())
}

#[test]
fn plans_get_through_a_line_that_loses_a_fifth() {
    for client in [Client::QGroundControl, Client::Mavsdk] {
        for seed in 0..20 {
            let mut rig = rig(client, 0.2, seed);
            persist(&mut rig, 5, |rig| rig.connect());
            persist(&mut rig, 8, |rig| rig.upload_mission(&mission(20)));
            let items = persist(&mut rig, 8, |rig| rig.download_mission());
            assert_same(&mission(20), &items, client);
            persist(&mut rig, 5, |rig| rig.clear_mission());
            assert_eq!(rig.firmware().stack.mission().items(), [], "{client}, seed {seed}");
        }
    }
}

/// MAVProxy and scripts do not repeat: a user tries again. Short plans succeed now and then.
#[test]
fn clients_that_do_not_repeat_need_patience() {
    for client in [Client::MavProxy, Client::Pymavlink] {
        for seed in 0..5 {
            let mut rig = rig(client, 0.1, seed);
            persist(&mut rig, 10, |rig| rig.connect());
            persist(&mut rig, 40, |rig| rig.upload_mission(&mission(2)));
            let items = persist(&mut rig, 40, |rig| rig.download_mission());
            assert_same(&mission(2), &items, client);
        }
    }
}

#[test]
fn a_refusal_has_its_code_and_the_vehicles_text() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let failure = rig.upload_mission(&mission(60)).expect_err("too many items");
        assert!(matches!(failure, Failure::Plan { result: MavMissionResult::NO_SPACE, .. }), "{client}: {failure}");
        let mut items = mission(3);
        items[1].x = i32::MAX - 1;
        let failure = rig.upload_mission(&items).expect_err("no such latitude");
        assert!(matches!(failure, Failure::Plan { seq: Some(1), .. }), "{client}: {failure}");
        assert!(failure.text().is_some(), "{client}: {failure}");
        rig.arm()?;
        let failure = rig.upload_fence(&fence()).expect_err("it is armed");
        let text = "the vehicle refused the fence: DENIED (Fence refused: disarm first)";
        assert_eq!(failure.to_string(), text, "{client}");
        assert_eq!(rig.download_mission()?, [], "{client}");
    }
    Ok(())
}

#[test]
fn every_client_sets_the_current_item() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        rig.upload_mission(&mission(4))?;
        rig.set_current(2)?;
        assert_eq!(rig.firmware().vehicle.current, 2, "{client}");
        rig.set_current(77).expect_err("there is no such item");
    }
    Ok(())
}

/// A vehicle that falls silent is given up after the client's own time.
#[test]
fn a_client_gives_up_in_its_own_time() -> Result<(), Failure> {
    let cases = [
        (Client::QGroundControl, 10_500),
        (Client::Mavsdk, 2_500),
        (Client::MavProxy, 10_000),
        (Client::Pymavlink, 3_000),
    ];
    for (client, millis) in cases {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        rig.line(0).cut();
        let begin = rig.now();
        rig.upload_mission(&mission(2)).expect_err("nothing arrives");
        let took = rig.now() - begin;
        assert!(
            took >= Duration::from_millis(millis) && took < Duration::from_millis(millis + 50),
            "{client}: {took:?}"
        );
    }
    Ok(())
}
