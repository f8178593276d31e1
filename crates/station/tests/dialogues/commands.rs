//! Commands.

use crate::vehicle::{persist, rig};
use mavstack::dialect::{CommandLong, MavCmd, MavResult};
use mavstack::{Address, Duration};
use mavstack_station::command::{Cancel, Place, Send};
use mavstack_station::{Client, Drive, Failure, GroundStation};

#[test]
fn every_client_arms() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        rig.arm()?;
        assert!(rig.firmware().vehicle.armed, "{client}");
        rig.takeoff(10.0)?;
        rig.disarm()?;
        assert!(!rig.firmware().vehicle.armed, "{client}");
    }
    Ok(())
}

#[test]
fn a_refusal_says_what_was_refused_and_why() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let failure = rig.takeoff(10.0).expect_err("it is not armed");
        let text = "the vehicle refused NAV_TAKEOFF: DENIED (Takeoff refused: arm first)";
        assert_eq!(failure.to_string(), text, "{client}");
        let failure = rig.command(MavCmd::DO_PARACHUTE, &[]).expect_err("it has none");
        assert!(matches!(failure, Failure::Command { result: MavResult::UNSUPPORTED, .. }), "{failure}");
    }
    Ok(())
}

/// MAVSDK sends a command four times. QGroundControl leaves it to the operator.
#[test]
fn a_command_that_is_lost_is_sent_as_often_as_the_client_does() {
    let cases = [
        (Client::QGroundControl, 1, 1_500),
        (Client::Mavsdk, 4, 2_000),
        (Client::MavProxy, 1, 5_000),
        (Client::Pymavlink, 1, 3_000),
    ];
    for (client, expected, millis) in cases {
        let mut rig = rig(client, 0.0, 1);
        rig.connect().expect("a vehicle");
        rig.line(0).set_loss(1.0);
        let begin = rig.now();
        let failure = rig.arm().expect_err("nothing arrives");
        assert_eq!(failure, Failure::timeout("COMPONENT_ARM_DISARM", expected), "{client}");
        assert_eq!((rig.now() - begin).as_millis().div_ceil(10), millis / 10, "{client}");
    }
}

#[test]
fn commands_get_through_a_line_that_loses_a_fifth() {
    for client in Client::ALL {
        for seed in 0..20 {
            let mut rig = rig(client, 0.2, seed);
            persist(&mut rig, 5, |rig| rig.connect());
            persist(&mut rig, 10, |rig| rig.arm());
            assert!(rig.firmware().vehicle.armed, "{client}, seed {seed}");
        }
    }
}

#[test]
fn a_place_is_sent_as_command_int() -> Result<(), Failure> {
    let mut rig = rig(Client::Mavsdk, 0.0, 1);
    rig.connect()?;
    rig.run(Send::at(MavCmd::DO_REPOSITION, &[-1.0], Place::relative(47.4, 8.5, 20.0)))?;
    assert_eq!(rig.firmware().vehicle.commands[&MavCmd::DO_REPOSITION.0], 1);
    Ok(())
}

#[test]
fn a_long_running_command_is_waited_for() -> Result<(), Failure> {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect()?;
        let begin = rig.now();
        let accepted = rig.command(MavCmd::PREFLIGHT_CALIBRATION, &[1.0])?;
        assert!(rig.now() - begin >= Duration::from_secs(8), "{client}");
        assert!(accepted.progress.len() >= 8 && accepted.progress[1..].is_sorted(), "{client}: {accepted:?}");
        assert_eq!(rig.firmware().vehicle.commands[&MavCmd::PREFLIGHT_CALIBRATION.0], 1, "{client}");
    }
    Ok(())
}

/// A lost report of progress is not the end, and a repeated command does not start it again.
#[test]
fn a_long_running_command_survives_losses() {
    for seed in 0..20 {
        let mut rig = rig(Client::Mavsdk, 0.2, seed);
        persist(&mut rig, 5, |rig| rig.connect());
        persist(&mut rig, 3, |rig| rig.command(MavCmd::PREFLIGHT_CALIBRATION, &[1.0]));
    }
}

#[test]
fn a_long_running_command_is_cancelled() -> Result<(), Failure> {
    let mut rig = rig(Client::QGroundControl, 0.0, 1);
    rig.connect()?;
    let started = rig.run(Send::new(MavCmd::PREFLIGHT_CALIBRATION, &[1.0]).without_waiting())?;
    assert_eq!(started.result, MavResult::IN_PROGRESS);
    assert_eq!(rig.run(Cancel::new(MavCmd::PREFLIGHT_CALIBRATION))?, MavResult::CANCELLED);
    let cancelled = Send::new(MavCmd::PREFLIGHT_CALIBRATION, &[1.0]).cancelled_after(Duration::from_secs(2));
    let begin = rig.now();
    let failure = rig.run(cancelled).expect_err("it was cancelled");
    assert!(matches!(failure, Failure::Command { result: MavResult::CANCELLED, .. }), "{failure}");
    assert!(rig.now() - begin < Duration::from_secs(4));
    Ok(())
}

/// Parameters that are not given are NaN from MAVSDK, and 0 from the others.
#[test]
fn a_client_fills_the_parameters_that_are_not_given() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 1);
        rig.connect().expect("a vehicle");
        let mut send = Send::new(MavCmd::DO_PARACHUTE, &[2.0]).to(Address::new(1, 1));
        let now = rig.now();
        rig.station().take_output();
        assert!(rig.station().advance(now, &mut send).is_none());
        let frame = rig.station().take_output();
        let payload = &frame[if frame[0] == 0xFD { 10 } else { 6 }..];
        let message: CommandLong = mavstack::Message::decode(&payload[..payload.len() - 2]);
        assert_eq!((message.param1, message.param7.is_nan()), (2.0, client == Client::Mavsdk), "{client}");
    }
}
