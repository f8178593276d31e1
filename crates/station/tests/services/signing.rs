//! SETUP_SIGNING, and signed frames from then on.

use crate::rig::{rig, two_stations};
use mavstack::Duration;
use mavstack::dialect::MavCmd;
use mavstack_station::signing::{Remove, Setup, timestamp};
use mavstack_station::{Again, Client, Drive, GroundStation, Station};

const KEY: [u8; 32] = *b"a key for tests, and nothing els";
const NOW: u64 = timestamp(1_790_000_000);

#[test]
fn every_client_sets_a_key_and_removes_it_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            rig.connect().unwrap();
            assert_eq!(rig.run(Again::new(20, || Setup::new(KEY, NOW))), Ok(()), "{client}, seed {seed}");
            rig.wait(Duration::from_secs(5)).unwrap();
            let counters = rig.firmware_mut().stack.signing_mut().counters();
            let sends_heartbeats = client != Client::Pymavlink;
            assert!(!sends_heartbeats || counters.verified > 0, "{client}, seed {seed}: {counters:?}");
            assert_eq!(rig.run(Again::new(20, Remove::new)), Ok(()), "{client}, seed {seed}");
        }
    }
}

/// A station whose clock is an hour late learns the time from the vehicle's frames, and is heard.
#[test]
fn a_late_station_learns_the_timestamp() {
    let mut rig = two_stations(Client::MavProxy, 0.0, 0);
    rig.connect().unwrap();
    rig.setup_signing(KEY, NOW).unwrap();
    let late = Station::new(Client::QGroundControl).with_signing(KEY, NOW - timestamp(1_420_070_400 + 3_600));
    rig.on(1).replace_station(late);
    rig.run_for(Duration::from_secs(3));
    let verified = |rig: &mut mavstack_station::kit::Rig<_>| -> u32 {
        let tested: &mut crate::rig::Tested = rig.firmware_mut();
        tested.stack.signing_mut().counters().verified
    };
    let before = verified(&mut rig);
    let mut other = rig.on(1);
    other.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]).unwrap();
    assert!(verified(&mut rig) > before && rig.firmware().boat.armed);
}
