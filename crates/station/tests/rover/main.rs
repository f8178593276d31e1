//! The rover of `examples/boards`, tested as a new user tests a vehicle. `docs/testing.md` quotes this file.

mod faults;
mod rig;

use mavstack::dialect::{MavCmd, MavMissionResult};
use mavstack::{Duration, Item};
use mavstack_rover::{HOLD, MANUAL, MISSION};
use mavstack_station::command::Place;
use mavstack_station::parameters::Value;
use mavstack_station::plans::waypoint;
use mavstack_station::sticks::{Input, Sticks};
use mavstack_station::{Client, Failure, GroundStation};

use rig::{mode, rig};

const SECOND: Duration = Duration::from_secs(1);

/// Three places, 10 m apart.
fn mission() -> [Item; 3] {
    [47.397_7, 47.397_8, 47.397_9].map(|latitude| waypoint(Place::relative(latitude, 8.545_6, 0.0)))
}

#[test]
fn parameters_are_set_and_read() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client);
        rig.line(0).set_loss(0.1);
        assert_eq!(rig.parameters()?.len(), 4);
        rig.set("SPEED_MAX", 5.0_f32)?;
        assert_eq!(rig.get("SPEED_MAX")?, Value::F32(5.0), "{client}");
    }
    Ok(())
}

/// The driver reads why.
#[test]
fn refusals_have_reasons() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    let failure = rig.set("SPEED_MAX", 99.0_f32).unwrap_err();
    assert_eq!(failure.text(), Some("SPEED_MAX: out of range"));
    let failure = rig.set_mode(MISSION).unwrap_err();
    assert_eq!(failure.text(), Some("No mission"));
    rig.set("BAT_V_LOW", 11.0_f32)?;
    let failure = rig.arm().unwrap_err();
    assert_eq!(failure.text(), Some("Not armed: battery low or unknown, or stored data unreadable"));
    Ok(())
}

#[test]
fn a_mission_goes_up_and_comes_down() -> Result<(), Failure> {
    for client in [Client::QGroundControl, Client::Mavsdk, Client::MavProxy] {
        let mut rig = rig(client);
        rig.line(0).set_loss(0.1);
        rig.upload_mission(&mission())?;
        assert_eq!(rig.download_mission()?, mission(), "{client}");
        rig.line(0).set_loss(0.0);
        let takeoff = Item { command: MavCmd::NAV_TAKEOFF, ..mission()[0] };
        let failure = rig.upload_mission(&[takeoff]).unwrap_err();
        assert!(matches!(failure, Failure::Plan { result: MavMissionResult::UNSUPPORTED, .. }), "{failure}");
    }
    Ok(())
}

#[test]
fn arms_and_disarms() -> Result<(), Failure> {
    let mut rig = rig(Client::Mavsdk);
    rig.arm()?;
    rig.until(SECOND, |rig| rig.seen().vehicles().all(|vehicle| vehicle.is_armed()));
    rig.disarm()?;
    rig.until(SECOND, |rig| !rig.seen().vehicles().any(|vehicle| vehicle.is_armed()));
    Ok(())
}

#[test]
fn modes_are_listed_and_selected() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client);
        let names: Vec<_> = rig.modes()?.into_iter().map(|mode| mode.name).collect();
        assert_eq!(names, ["Hold", "Mission", "Manual"]);
        rig.upload_mission(&mission())?;
        rig.set_mode(MISSION)?;
        rig.set_mode(HOLD)?;
    }
    Ok(())
}

#[test]
fn drives_a_mission_to_its_end() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    rig.upload_mission(&mission())?;
    rig.arm()?;
    rig.set_mode(MISSION)?;
    rig.until(SECOND, |rig| mode(rig) == Some(MISSION));
    rig.until(SECOND * 40, |rig| mode(rig) == Some(HOLD));
    Ok(())
}

/// Without a station nobody can stop the rover.
#[test]
fn holds_when_the_station_is_lost() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    rig.upload_mission(&mission())?;
    rig.arm()?;
    rig.set_mode(MISSION)?;
    rig.run_for(SECOND * 5);
    rig.line(0).cut();
    rig.until(SECOND * 10, |rig| rig.firmware().rover.target(&rig.firmware().stack).is_none());
    rig.line(0).restore();
    rig.until(SECOND * 3, |rig| mode(rig) == Some(HOLD));
    Ok(())
}

/// The rover drives by hand for as long as the sticks arrive.
#[test]
fn holds_when_the_sticks_are_lost() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    rig.arm()?;
    let mut driver = rig.alongside(Sticks::new(Input::joystick(0.5, 0.0, 0.5, 0.0)));
    driver.wait(SECOND)?;
    driver.set_mode(MANUAL)?;
    assert_eq!(driver.inner().firmware().rover.sticks(), Some([500, 0]));
    rig.until(SECOND * 2, |rig| rig.seen().has_text("Sticks lost: holding"));
    Ok(())
}

/// What was stored is there after a power cut, which may come at any time.
#[test]
fn a_mission_survives_a_power_cut() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl);
    rig.upload_mission(&mission())?;
    rig.run_for(SECOND * 5);
    rig.cut_power();
    rig.run_for(SECOND * 5);
    rig.restore_power();
    assert_eq!(rig.download_mission()?, mission());
    Ok(())
}

/// The rover must not seem alive when nothing controls it.
#[test]
fn a_hung_loop_ends_the_heartbeats() {
    let mut rig = rig(Client::QGroundControl);
    rig.hang_flight_loop();
    rig.run_for(SECOND * 5);
    assert!(rig.now() - rig.seen().vehicles().next().unwrap().last_heartbeat() > SECOND * 3);
}
