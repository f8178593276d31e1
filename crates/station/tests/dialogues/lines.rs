//! Lines with other faults than lost frames.

use crate::vehicle::{on, persist};
use mavstack::{Duration, Item};
use mavstack_station::command::Place;
use mavstack_station::kit::LineConfig;
use mavstack_station::parameters::{FileList, Value};
use mavstack_station::plans::waypoint;
use mavstack_station::{Again, Client, Drive, Failure, GroundStation};

fn mission() -> Vec<Item> {
    (0..10).map(|i| waypoint(Place::relative(47.0, 8.0 + f64::from(i) / 100.0, 20.0))).collect()
}

/// Everything that a user does in a session.
fn session(line: LineConfig, client: Client, seed: u64) {
    let mut rig = on(line, client, seed);
    persist(&mut rig, 5, |rig| rig.connect());
    persist(&mut rig, 5, |rig| rig.set("CRUISE", 6.5));
    assert_eq!(persist(&mut rig, 5, |rig| rig.get("CRUISE")), Value::F32(6.5), "{client}, seed {seed}");
    assert_eq!(persist(&mut rig, 5, |rig| rig.parameters()).len(), 22, "{client}, seed {seed}");
    persist(&mut rig, 5, |rig| rig.upload_mission(&mission()));
    let plan = persist(&mut rig, 5, |rig| rig.download_mission());
    assert_eq!(plan.len(), 10, "{client}, seed {seed}");
    persist(&mut rig, 5, |rig| rig.set_mode(4));
    persist(&mut rig, 5, |rig| rig.arm());
    assert!(rig.firmware().vehicle.armed, "{client}, seed {seed}");
}

#[test]
fn every_client_gets_along_with_duplicates_and_chunks() {
    for client in Client::ALL {
        for seed in 0..5 {
            session(LineConfig::uart(115_200).with_duplicates(0.1).with_chunks(7), client, seed);
        }
    }
}

#[test]
fn every_client_gets_along_with_damage() {
    for client in Client::ALL {
        for seed in 0..5 {
            session(LineConfig::uart(115_200).with_damage(0.000_5), client, seed);
        }
    }
}

/// A packet radio: 300 ms each way.
#[test]
fn every_client_gets_along_with_a_slow_radio() {
    for client in Client::ALL {
        session(LineConfig::radio(19_200, Duration::from_millis(300)), client, 1);
    }
}

#[test]
fn the_file_of_parameters_gets_through_a_line_that_loses_a_fifth() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = on(LineConfig::uart(115_200).with_loss(0.2), client, 1);
        persist(&mut rig, 5, |rig| rig.connect());
        let parameters = rig.run(Again::new(30, FileList::new))?;
        assert_eq!((parameters.len(), parameters[11].value), (22, Value::I32(1)), "{client}");
    }
    Ok(())
}
