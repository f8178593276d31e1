//! Requested messages and streams.

use crate::vehicle::{persist, rig};
use mavstack::Duration;
use mavstack::dialect::{Attitude, AutopilotVersion, MavProtocolCapability, VfrHud};
use mavstack_station::streams::Interval;
use mavstack_station::{Client, Failure, GroundStation};

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
