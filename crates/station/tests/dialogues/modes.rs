//! Flight modes.

use crate::vehicle::{persist, rig};
use mavstack::dialect::MavStandardMode;
use mavstack_station::{Client, Failure, GroundStation};

#[test]
fn every_client_lists_the_modes() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let modes = rig.modes()?;
        let names: Vec<_> = modes.iter().map(|mode| mode.name.as_str()).collect();
        assert_eq!(names, ["Manual", "Hold", "Return", "Follow"], "{client}");
        assert_eq!(modes[1].standard_mode, MavStandardMode::POSITION_HOLD, "{client}");
    }
    Ok(())
}

#[test]
fn every_client_sets_a_mode() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        rig.set_mode(4)?;
        assert_eq!(rig.firmware().vehicle.mode, 4, "{client}");
        rig.set_standard_mode(MavStandardMode::SAFE_RECOVERY)?;
        assert_eq!(rig.firmware().vehicle.mode, 6, "{client}");
        rig.set_mode_named("Manual")?;
        assert_eq!(rig.firmware().vehicle.mode, 1, "{client}");
        rig.set_mode_named("Loop").expect_err("there is no such mode");
        let failure = rig.set_mode(9).expect_err("there is nobody to follow");
        let text = "the vehicle refused DO_SET_MODE: DENIED (Follow refused: nobody to follow)";
        assert_eq!(failure.to_string(), text, "{client}");
    }
    Ok(())
}

/// A vehicle that accepts a mode and does not report it is found out.
#[test]
fn an_accepted_mode_must_be_reported() -> Result<(), Failure> {
    let mut rig = rig(Client::MavProxy, 0.0, 1);
    rig.connect()?;
    rig.firmware_mut().vehicle.ignores_modes = true;
    let failure = rig.set_mode(4).expect_err("it stays in its mode");
    assert!(failure.to_string().contains("does not report it"), "{failure}");
    Ok(())
}

#[test]
fn modes_get_through_a_line_that_loses_a_fifth() {
    for client in Client::ALL {
        for seed in 0..20 {
            let mut rig = rig(client, 0.2, seed);
            persist(&mut rig, 5, |rig| rig.connect());
            persist(&mut rig, 8, |rig| rig.set_mode(4));
            assert_eq!(rig.firmware().vehicle.mode, 4, "{client}, seed {seed}");
            assert_eq!(persist(&mut rig, 20, |rig| rig.modes()).len(), 4, "{client}, seed {seed}");
        }
    }
}
