//! A gimbal and its manager.

use crate::rig::{rig, two_stations};
use mavstack::Address;
use mavstack::Duration;
use mavstack::dialect::GimbalManagerStatus;
use mavstack_station::gimbal::{Claim, Configure, Identify, Point};
use mavstack_station::{Again, Client, Drive, Failure, GroundStation};

#[test]
fn every_client_points_a_gimbal() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        rig.connect().unwrap();
        let manager = rig.identify_gimbal().unwrap();
        assert_eq!((manager.address, manager.information.gimbal_device_id), (Address::new(1, 1), 1), "{client}");
        rig.point_gimbal(manager, -45.0, 30.0).unwrap();
        rig.wait(Duration::from_millis(100)).unwrap();
        let [pitch, yaw] = rig.firmware().boat.gimbal.map(f32::to_degrees);
        assert!((pitch + 45.0).abs() < 0.01 && (yaw - 30.0).abs() < 0.01, "{client}: {pitch}, {yaw}");
    }
}

#[test]
fn control_is_taken_and_released() {
    for client in [Client::QGroundControl, Client::Mavsdk] {
        let mut rig = two_stations(client, 0.0, 0);
        rig.connect().unwrap();
        rig.on(1).connect().unwrap();
        let manager = rig.identify_gimbal().unwrap();
        rig.run(Configure::new(manager, Claim::Take)).unwrap();
        rig.wait(Duration::from_secs(6)).unwrap();
        let status = rig.seen().last::<GimbalManagerStatus>().expect("its status");
        assert_eq!(status.primary_control_sysid, client.address().system.wire(), "{client}");
        let refused = rig.on(1).run(Point::new(manager, 10.0, 0.0));
        let is_refused = matches!(refused, Err(Failure::Command { .. })) || client == Client::Mavsdk;
        assert!(is_refused && rig.firmware().boat.gimbal == [0.0; 2], "{client}: {refused:?}");
        rig.run(Configure::new(manager, Claim::Release)).unwrap();
        rig.wait(Duration::from_secs(6)).unwrap();
        let status = rig.seen().last::<GimbalManagerStatus>().expect("its status");
        assert_eq!(status.primary_control_sysid, 0, "{client}");
    }
}

#[test]
fn a_gimbal_is_pointed_on_a_lossy_line() {
    for client in [Client::QGroundControl, Client::MavProxy, Client::Pymavlink] {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            rig.run(Again::new(20, mavstack_station::connect::Connect::new)).unwrap();
            let manager = rig.run(Again::new(20, Identify::new)).unwrap();
            rig.run(Again::new(20, || Configure::new(manager, Claim::Take))).unwrap();
            rig.run(Again::new(20, || Point::new(manager, 20.0, 0.0))).unwrap();
            assert!((rig.firmware().boat.gimbal[0].to_degrees() - 20.0).abs() < 0.01, "{client}, seed {seed}");
        }
    }
}
