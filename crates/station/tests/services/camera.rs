//! A camera and its settings.

use crate::rig::rig;
use mavstack::dialect::MavCmd;
use mavstack::{Address, Duration};
use mavstack_station::camera::{Capture, Identify, ListSettings, SetSetting, Value};
use mavstack_station::{Again, Client, Drive, Failure, GroundStation};

const CAMERA: Address = Address::new(1, 100);
const SECOND: Duration = Duration::from_secs(1);

#[test]
fn a_camera_is_identified_by_every_client() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        rig.connect().unwrap();
        let camera = rig.identify_camera().unwrap();
        assert_eq!(camera.camera, CAMERA, "{client}");
        assert!(camera.information.model_name.starts_with(b"Deck camera"), "{client}");
        let (settings, storage) = (camera.settings.is_some(), camera.storage.is_some());
        assert!(settings && storage && camera.status.is_some() && camera.stream.is_none(), "{client}: {camera:?}");
    }
}

#[test]
fn a_camera_is_identified_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            rig.run(Again::new(20, mavstack_station::connect::Connect::new)).unwrap();
            let camera = rig.run(Again::new(20, Identify::new));
            assert!(camera.is_ok(), "{client}, seed {seed}: {camera:?}");
        }
    }
}

#[test]
fn images_are_reported() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        rig.connect().unwrap();
        assert_eq!(rig.take_image().unwrap().map(|image| image.image_index), Some(0), "{client}");
        let images = rig.run(Capture::at_interval(SECOND, 3)).unwrap();
        assert_eq!(images.iter().map(|image| image.image_index).collect::<Vec<_>>(), [1, 2, 3], "{client}");
        assert_eq!(rig.firmware().boat.images, 4, "{client}");
        assert_eq!(rig.run(Capture::at_interval(SECOND, 0)).map(|images| images.len()), Ok(1), "{client}");
        rig.wait(SECOND * 5).unwrap();
        assert_eq!(rig.firmware().boat.images, 5, "{client}");
    }
}

/// MAVSDK asks for the reports that it misses.
#[test]
fn mavsdk_gets_every_report_on_a_lossy_line() {
    for seed in 0..5 {
        let mut rig = rig(Client::Mavsdk, 0.2, seed);
        rig.run(Again::new(20, mavstack_station::connect::Connect::new)).unwrap();
        rig.wait(SECOND * 3).unwrap();
        let mut images = rig.run(Capture::at_interval(SECOND, 4));
        while images.is_err() {
            // The camera may have begun although no answer has arrived.
            rig.wait(SECOND * 5).unwrap();
            images = rig.run(Capture::at_interval(SECOND, 4));
        }
        assert_eq!(images.map(|images| images.len()), Ok(4), "seed {seed}");
    }
}

#[test]
fn settings_are_listed_and_set_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            rig.run(Again::new(20, mavstack_station::connect::Connect::new)).unwrap();
            rig.wait(SECOND * 3).unwrap();
            let settings = rig.run(Again::new(20, || ListSettings::of(CAMERA))).unwrap();
            let names: Vec<_> = settings.iter().map(|setting| &setting.name[..]).collect();
            assert_eq!(names, ["CAM_MODE", "CAM_ISO"], "{client}, seed {seed}");
            assert_eq!(settings[1].value, Value::U32(100), "{client}, seed {seed}");
            let set = rig.run(Again::new(20, || SetSetting::new("CAM_ISO", Value::U32(400)).of(CAMERA)));
            assert_eq!(set, Ok(Value::U32(400)), "{client}, seed {seed}");
            assert_eq!(rig.firmware().boat.iso, 400, "{client}, seed {seed}");
            let refused = rig.run(Again::new(20, || SetSetting::new("CAM_ISO", Value::U32(7)).of(CAMERA)));
            assert!(matches!(refused, Err(Failure::Param { .. })), "{client}, seed {seed}: {refused:?}");
        }
    }
}

#[test]
fn a_vehicle_without_a_camera_refuses() {
    let mut rig = rig(Client::QGroundControl, 0.0, 0);
    rig.connect().unwrap();
    let refused = rig.run(Identify::at(Address::new(1, 1)));
    assert!(matches!(refused, Err(Failure::Command { command: MavCmd::REQUEST_MESSAGE, .. })), "{refused:?}");
}
