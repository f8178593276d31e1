//! The rover of `examples/boards`, tested as a new user tests a vehicle. `docs/testing.md` quotes this file.

mod faults;
mod rig;

use mavstack::Duration;
use mavstack_station::kit::LineConfig;
use mavstack_station::{Client, Failure, GroundStation};

use rig::rig;

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn arms() -> Result<(), Failure> {
    let mut rig = rig(LineConfig::uart(57_600), Client::QGroundControl);
    rig.connect()?;
    rig.arm()?;
    rig.until(SECOND, |rig| rig.seen().vehicles().all(|vehicle| vehicle.is_armed()));
    Ok(())
}

/// The vehicle must not seem alive when nothing controls it.
#[test]
fn a_hung_flight_loop_ends_the_heartbeats() -> Result<(), Failure> {
    let mut rig = rig(LineConfig::uart(57_600), Client::QGroundControl);
    rig.connect()?;
    rig.hang_flight_loop();
    rig.run_for(SECOND * 3);
    let last = rig.seen().vehicles().next().unwrap().heartbeats.last().copied();
    assert!(rig.now() - last.unwrap() > SECOND * 2);
    rig.resume();
    rig.until(SECOND * 2, |rig| rig.seen().vehicles().next().unwrap().heartbeats.last().copied() > last);
    Ok(())
}
