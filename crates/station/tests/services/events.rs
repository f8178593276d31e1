//! Events: nothing is missed on a lossy line, and what the vehicle does not have any more is counted.

use crate::rig::rig;
use crate::vehicle::Passed;
use mavstack::Duration;
use mavstack::events::DeclaredEvent;
use mavstack_station::events::Follow;
use mavstack_station::{Client, GroundStation};

const SECOND: Duration = Duration::from_secs(1);

fn buoys(follow: &Follow) -> Vec<u8> {
    follow.events().iter().filter(|event| event.id == Passed::INFO.id()).map(|event| event.arguments[0]).collect()
}

#[test]
fn every_event_arrives_in_order_on_a_lossy_line() {
    for client in [Client::QGroundControl, Client::Mavsdk] {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            let mut follow = Follow::new();
            // The first number, which the first event may not bring.
            rig.alongside(&mut follow).wait(SECOND * 8).unwrap();
            for buoy in 0..20 {
                rig.firmware_mut().boat.passed.push(buoy);
                rig.alongside(&mut follow).wait(SECOND).unwrap();
            }
            rig.alongside(&mut follow).wait(SECOND * 10).unwrap();
            assert_eq!(buoys(&follow), (0..20).collect::<Vec<_>>(), "{client}, seed {seed}");
            assert_eq!(follow.lost(), 0, "{client}, seed {seed}");
        }
    }
}

#[test]
fn overwritten_events_are_counted() {
    let mut rig = rig(Client::QGroundControl, 0.0, 0);
    let mut follow = Follow::new();
    rig.firmware_mut().boat.passed.push(0);
    rig.alongside(&mut follow).wait(SECOND * 5).unwrap();
    rig.line(0).cut();
    // The history has 8 events.
    rig.firmware_mut().boat.passed.extend(1..=20);
    rig.run_for(SECOND * 2);
    rig.line(0).restore();
    rig.alongside(&mut follow).wait(SECOND * 5).unwrap();
    assert_eq!(buoys(&follow), [0, 13, 14, 15, 16, 17, 18, 19, 20]);
    assert_eq!(follow.lost(), 12);
}

#[test]
fn clients_without_requests_miss_events() {
    let mut rig = rig(Client::MavProxy, 0.3, 1);
    let mut follow = Follow::new();
    for buoy in 0..30 {
        rig.firmware_mut().boat.passed.push(buoy);
        rig.alongside(&mut follow).wait(SECOND).unwrap();
    }
    assert_eq!((follow.requests(), buoys(&follow).len() < 30), (0, true));
    let events = rig.events_for(SECOND).unwrap();
    assert!(events.is_empty(), "{events:?}");
}
