//! Flight logs, as each client reads them.

use crate::rig::{self, Tested};
use mavstack_station::kit::Rig;
use mavstack_station::logs::{Download, Listing, Log};
use mavstack_station::{Again, Client, Drive, Failure, GroundStation};

fn rig(client: Client, loss: f64, seed: u64) -> Rig<Tested> {
    let mut rig = rig::rig(client, loss, seed);
    rig.firmware_mut().boat.logs =
        [100, 0, 90 * 20, 50_000].map(|len| (0..len).map(|at| (at * 3 + at / 90) as u8).collect()).to_vec();
    rig
}

#[test]
fn every_client_lists_and_reads() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        let logs = rig.list_logs().expect("a list");
        assert_eq!(logs.iter().map(|log| log.size).collect::<Vec<_>>(), [100, 0, 1_800, 50_000], "{client}");
        assert_eq!(logs[2], Log { id: 2, size: 1_800, time_utc: 1_700_000_002 }, "{client}");
        for log in logs {
            let read = rig.read_log(log);
            let is_app = matches!(client, Client::QGroundControl | Client::Mavsdk);
            if log.size == 0 && is_app {
                assert!(matches!(read, Err(Failure::Protocol(_))), "{client}: {read:?}");
            } else {
                assert!(
                    read.as_ref() == Ok(&rig.firmware().boat.logs[usize::from(log.id)]),
                    "{client}: log {}",
                    log.id
                );
            }
        }
    }
}

#[test]
fn every_client_lists_and_reads_on_a_lossy_line() {
    for client in Client::ALL {
        for seed in 0..3 {
            let mut rig = rig(client, 0.2, seed);
            let mut logs = rig.run(Again::new(50, Listing::new));
            // QGroundControl takes silence for no logs.
            while logs.as_ref().is_ok_and(Vec::is_empty) {
                logs = rig.run(Again::new(50, Listing::new));
            }
            let logs = logs.expect("a list");
            assert_eq!(logs.len(), 4, "{client}, seed {seed}");
            let read = rig.run(Again::new(50, || Download::new(logs[3])));
            let result = read.as_ref().map(Vec::len);
            assert!(read.as_ref() == Ok(&rig.firmware().boat.logs[3]), "{client}, seed {seed}: {result:?}");
        }
    }
}

#[test]
fn an_erasure_tells_what_is_left() {
    for client in Client::ALL {
        let mut rig = rig(client, 0.0, 0);
        assert_eq!(rig.erase_logs(), Ok(Vec::new()), "{client}");
        assert!(rig.firmware().boat.logs.is_empty(), "{client}");
    }
}
