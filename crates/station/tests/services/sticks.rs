//! Sticks and setpoints beside other dialogues.

use crate::rig::rig;
use mavstack::Duration;
use mavstack::dialect::MavCmd;
use mavstack_station::sticks::{Input, Sticks};
use mavstack_station::{Client, Drive, GroundStation};

#[test]
fn sticks_steer_while_commands_are_sent() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.2, 3).with_pass(Duration::from_millis(5));
        rig.connect().unwrap();
        let mut pilot = rig.alongside(Sticks::new(Input::joystick(0.5, -0.25, 0.75, 0.0)));
        pilot.wait(Duration::from_secs(1)).unwrap();
        for _ in 0..5 {
            let _ = pilot.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]);
            let now = pilot.inner().since_boot();
            let input = pilot.inner().firmware().stack.manual_input().manual_control(now);
            let input = input.unwrap_or_else(|| panic!("{client}: nobody steers"));
            assert_eq!((input.x, input.y), (Some(500), Some(-250)), "{client}");
        }
        assert!(rig.firmware().boat.armed, "{client}");
        rig.wait(Duration::from_secs(2)).unwrap();
        let now = rig.since_boot();
        assert!(rig.firmware().stack.manual_input().manual_control(now).is_none(), "{client}: they are released");
    }
}

#[test]
fn inputs_have_the_clients_rates() {
    for (client, sent) in [(Client::QGroundControl, 25), (Client::Mavsdk, 20), (Client::MavProxy, 10)] {
        let mut rig = rig(client, 0.0, 0);
        let mut sticks = Sticks::new(Input::channels(&[1_600, 1_500])).for_time(Duration::from_secs(1));
        rig.run(&mut sticks).unwrap();
        assert_eq!(sticks.sent(), sent, "{client}");
        let now = rig.since_boot();
        let channels = rig.firmware().stack.manual_input().rc_channels(now).expect("channels");
        assert_eq!((channels.channel(1), channels.channel(3)), (Some(1_600), None), "{client}");
    }
}

#[test]
fn moving_setpoints_arrive() {
    let mut rig = rig(Client::Mavsdk, 0.2, 5);
    rig.connect().unwrap();
    let ramp = |elapsed: Duration| Input::velocity([elapsed.as_millis() as f32 / 1_000.0, 0.0, 0.0]);
    rig.run(Sticks::moving(ramp).for_time(Duration::from_secs(3))).unwrap();
    let now = rig.since_boot();
    let setpoint = rig.firmware().stack.setpoints.current(now).expect("a setpoint");
    assert!(format!("{setpoint:?}").contains("2."), "about 2.9 m/s: {setpoint:?}");
    for input in [Input::position([1.0, 2.0, -3.0]), Input::attitude([1.0, 0.0, 0.0, 0.0], 0.5)] {
        rig.hold(input, Duration::from_millis(300)).unwrap();
    }
    assert_eq!(rig.firmware().stack.setpoints.counters().out_of_range, 0);
}
