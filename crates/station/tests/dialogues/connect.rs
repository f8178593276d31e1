//! What each client does when it finds a vehicle.

use crate::vehicle::rig;
use mavstack::Duration;
use mavstack::dialect::{Attitude, CommandAck, Ping};
use mavstack_station::streams::Interval;
use mavstack_station::{Client, Drive, Failure, GroundStation, Station};

#[test]
fn qgroundcontrol_loads_everything() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl, 0.0, 1);
    let connected = rig.connect()?;
    assert_eq!((connected.modes.len(), connected.parameters.len()), (4, 22));
    assert!(connected.version.is_some() && connected.plans.iter().all(Option::is_some));
    // The vehicle has no metadata in either form, and says so at once.
    let failures: Vec<_> = connected.failures.iter().map(ToString::to_string).collect();
    assert_eq!(failures, ["the vehicle refused REQUEST_MESSAGE: DENIED"; 2]);
    assert!(rig.now().as_millis() < 4_000, "{:?}", rig.now());
    Ok(())
}

#[test]
fn mavproxy_takes_the_file_of_parameters() -> Result<(), Failure> {
    let mut rig = rig(Client::MavProxy, 0.0, 1);
    let connected = rig.connect()?;
    assert_eq!((connected.parameters.len(), connected.failures.len()), (22, 0));
    assert_eq!(connected.parameters[4].name, "CRUISE");
    assert!(connected.version.is_none());
    // REQUEST_DATA_STREAM starts the streams later.
    rig.run_for(Duration::from_secs(1));
    assert_eq!(rig.seen().count::<Attitude>(), 0);
    rig.run_for(Duration::from_secs(15));
    assert!(rig.seen().count::<Attitude>() >= 3);
    Ok(())
}

#[test]
fn mavsdk_and_scripts_want_little() -> Result<(), Failure> {
    let connected = rig(Client::Mavsdk, 0.0, 1).connect()?;
    assert!(connected.version.is_some() && connected.parameters.is_empty());
    let connected = rig(Client::Pymavlink, 0.0, 1).connect()?;
    assert!(connected.version.is_none() && connected.failures.is_empty());
    Ok(())
}

/// Its time does not begin at 0.
#[test]
fn a_station_that_comes_later_connects() {
    for client in Client::ALL {
        let mut rig = rig(Client::QGroundControl, 0.0, 1);
        rig.run_for(Duration::from_secs(20));
        rig.on(0).replace_station(client);
        rig.connect().unwrap_or_else(|failure| panic!("{client}: {failure}"));
    }
}

#[test]
fn a_line_without_a_vehicle_is_told() {
    let mut rig = rig(Client::QGroundControl, 1.0, 1);
    assert_eq!(rig.connect(), Err(Failure::NoVehicle));
    assert_eq!(rig.now().as_millis(), 10_000);
}

/// On a bad line QGroundControl gets what matters, but gives up a parameter that was lost five times.
#[test]
fn qgroundcontrol_connects_on_a_line_that_loses_a_fifth() {
    let mut whole = 0;
    for seed in 0..10 {
        let mut rig = rig(Client::QGroundControl, 0.2, seed);
        let connected = rig.connect().expect("a heartbeat");
        let is_whole = connected.parameters.len() == 22;
        let gave_up = connected.failures.iter().any(|failure| failure.to_string().contains("parameters"));
        assert!(is_whole != gave_up, "seed {seed}: {:?}", connected.failures);
        whole += u32::from(is_whole);
    }
    assert!(whole >= 8, "{whole} of 10");
}

/// MAVProxy requests the streams again and again, whatever was set.
#[test]
fn mavproxy_overrides_intervals() -> Result<(), Failure> {
    let mut rig = rig(Client::MavProxy, 0.0, 1);
    rig.connect()?;
    rig.set_interval::<Attitude>(Duration::from_millis(50))?;
    assert_eq!(rig.interval::<Attitude>()?, Some(Interval::Every(Duration::from_millis(50))));
    rig.run_for(Duration::from_secs(15));
    assert_eq!(rig.interval::<Attitude>()?, Some(Interval::Every(Duration::from_millis(250))));
    Ok(())
}

/// A client that must leave no rate behind.
#[test]
fn mavproxy_may_leave_the_streams_alone() -> Result<(), Failure> {
    let mut rig = rig(Client::MavProxy, 0.0, 1);
    rig.on(0).replace_station(Station::new(Client::MavProxy).without_stream_requests());
    rig.connect()?;
    rig.run_for(Duration::from_secs(31));
    assert_eq!(rig.seen().count::<Attitude>(), 0);
    Ok(())
}

/// The vehicle has no home: MAVProxy asks again and again, and the vehicle must bear it.
#[test]
fn mavproxy_asks_for_home() -> Result<(), Failure> {
    let mut rig = rig(Client::MavProxy, 0.0, 1);
    rig.connect()?;
    let before = rig.seen().count::<CommandAck>();
    rig.run_for(Duration::from_secs(10));
    assert_eq!(rig.seen().count::<CommandAck>() - before, 5);
    assert!(rig.seen().texts().count() <= 1, "{:?}", rig.seen());
    Ok(())
}

#[test]
fn mavsdk_pings() -> Result<(), Failure> {
    let mut rig = rig(Client::Mavsdk, 0.0, 1);
    rig.connect()?;
    rig.run_for(Duration::from_secs(16));
    assert_eq!(rig.seen().count::<Ping>(), 4, "each is answered");
    Ok(())
}

/// Each client waits as long as the real one until it takes the vehicle for lost.
#[test]
fn a_lost_vehicle_is_noticed() -> Result<(), Failure> {
    for (client, millis) in [
        (Client::QGroundControl, 3_500),
        (Client::Mavsdk, 3_000),
        (Client::MavProxy, 5_000),
        (Client::Pymavlink, 5_000),
    ] {
        let mut rig = rig(client, 0.0, 1);
        assert!(!rig.station().is_connected(), "{client}");
        rig.connect()?;
        assert!(rig.station().is_connected(), "{client}");
        rig.line(0).cut();
        rig.run_for(Duration::from_millis(millis - 1_100));
        assert!(rig.station().is_connected(), "{client}");
        rig.run_for(Duration::from_millis(1_200));
        assert!(!rig.station().is_connected(), "{client}");
    }
    Ok(())
}
