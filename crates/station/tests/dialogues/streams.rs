//! Requested messages and streams.

use crate::vehicle::{persist, rig};
use mavstack::dialect::{Attitude, AutopilotVersion, MavProtocolCapability, MessageInterval, VfrHud};
use mavstack::frame::{Version, encode};
use mavstack::{Address, Duration, Instant};
use mavstack_station::streams::{Interval, Request};
use mavstack_station::{Client, Failure, GroundStation, Station};

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn every_client_requests_messages() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let version: AutopilotVersion = rig.request_message()?;
        assert!(version.capabilities.contains(MavProtocolCapability::MISSION_INT), "{client}");
        rig.request_message::<VfrHud>().expect_err("it has none");
    }
    Ok(())
}

#[test]
fn every_client_sets_intervals() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let interval = Duration::from_millis(100);
        rig.set_interval::<Attitude>(interval)?;
        assert_eq!(rig.interval::<Attitude>()?, Some(Interval::Every(interval)), "{client}");
        let before = rig.seen().count::<Attitude>();
        rig.run_for(SECOND * 2);
        let count = rig.seen().count::<Attitude>() - before;
        assert!((19..=21).contains(&count), "{client}: {count}");
        assert_eq!(rig.expect::<Attitude>(SECOND)?.yaw, 1.0);
        rig.set_interval::<Attitude>(Interval::Off)?;
        rig.run_for(SECOND);
        rig.expect::<Attitude>(SECOND).expect_err("it is off");
    }
    Ok(())
}

/// A late answer to an earlier request is no answer.
#[test]
fn the_interval_of_another_message_is_not_taken() {
    let mut station = Station::new(Client::Pymavlink).with_target(Address::new(1, 1));
    let mut request = Request::<MessageInterval>::new().with_index(30);
    let mut answer = |message_id| {
        let interval = MessageInterval { message_id, interval_us: 100 };
        let mut frame = [0; 64];
        let len = encode(&interval, Version::V2, Address::new(1, 1), 0, &mut frame).expect("room");
        assert!(station.advance(Instant::ZERO, &mut request).is_none());
        station.receive(Instant::ZERO, &frame[..len]);
        station.advance(Instant::ZERO, &mut request)
    };
    assert_eq!(answer(33), None);
    assert_eq!(answer(30).map(|result| result.map(|interval| interval.message_id)), Some(Ok(30)));
}

#[test]
fn requests_get_through_a_line_that_loses_a_fifth() {
    for client in Client::ALL {
        for seed in 0..20 {
            let mut rig = rig(client, 0.2, seed);
            persist(&mut rig, 5, |rig| rig.connect());
            persist(&mut rig, 10, |rig| rig.request_message::<AutopilotVersion>());
            persist(&mut rig, 10, |rig| rig.set_interval::<Attitude>(SECOND));
        }
    }
}
