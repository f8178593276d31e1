//! TIMESYNC and PING both ways.

use crate::rig::rig;
use mavstack::dialect;
use mavstack::frame::{Version, encode};
use mavstack::{Address, Duration, Instant, LinkId};
use mavstack_station::connect::Connect;
use mavstack_station::time::{Answering, Ping, SendTime, Timesync};
use mavstack_station::{Again, Client, Drive, GroundStation, Station};

#[test]
fn clocks_are_measured_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            rig.run_for(Duration::from_secs(3));
            rig.reset();
            rig.run(Again::new(20, Connect::new)).unwrap();
            let ahead = rig.since_boot().as_micros() as i64 * 1_000 - rig.now().as_micros() as i64 * 1_000;
            let sample = rig.run(Again::new(20, || Timesync::of(5))).unwrap();
            assert!((sample.offset - ahead).abs() < 20_000_000, "{client}, seed {seed}: {sample:?}, {ahead} ns");
            assert!(sample.round_trip < Duration::from_millis(40), "{client}, seed {seed}: {sample:?}");
            assert!(rig.run(Again::new(20, Ping::new)).unwrap() < Duration::from_millis(40), "{client}, seed {seed}");
        }
    }
}

/// A PING to all is answered once, also beside the answers to TIMESYNC.
#[test]
fn a_ping_is_answered_once() {
    for (client, answers) in Client::ALL.into_iter().zip([1, 1, 0, 0]) {
        let mut station = Station::new(client).with_heartbeats(None);
        let mut answering = Answering::new();
        assert!(station.advance(Instant::ZERO, &mut answering).is_none());
        let ping = dialect::Ping { seq: 7, ..dialect::Ping::default() };
        let mut frame = [0; 64];
        let len = encode(&ping, Version::V2, Address::new(1, 1), 0, &mut frame).expect("room");
        station.receive(Instant::ZERO, &frame[..len]);
        assert!(station.advance(Instant::ZERO, &mut answering).is_none());

        let mut vehicle = Station::new(Client::Pymavlink);
        vehicle.receive(Instant::ZERO, &station.take_output());
        assert_eq!(vehicle.seen().count::<dialect::Ping>(), answers, "{client}");
    }
}

/// The vehicle's own requests are answered as the client does: QGroundControl does not know TIMESYNC.
#[test]
fn the_vehicle_is_answered_as_the_client_does() {
    for (client, answers) in Client::ALL.into_iter().zip([0, 1, 1, 0]) {
        let mut rig = rig(client, 0.0, 0);
        rig.connect().unwrap();
        rig.wait(Duration::from_secs(1)).unwrap();
        rig.firmware_mut().stack.time.ask(LinkId(0));
        let mut answering = Answering::new();
        rig.alongside(&mut answering).wait(Duration::from_secs(1)).unwrap();
        assert_eq!(answering.answers(), answers, "{client}");
        assert!(rig.ping().is_ok() && rig.timesync().is_ok(), "{client}");
    }
    let mut rig = rig(Client::QGroundControl, 0.0, 0);
    assert_eq!(rig.run(SendTime::new(1_800_000_000_000_000)), Ok(()));
}
