//! What happens between `attach_storage` and the end of reading: nothing is open that the key closes, and what is set meanwhile is
//! newer than what is stored (G-18, P-17).

use super::damage::{
    KEYS, Keys, PARAMS, Params, armed_by, cruise_and_altitude, run, set, settle, setup, signing_rig, start, start_rig,
    with_key, with_params,
};
use crate::support::signer::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::Version;

/// G-18: links that need a key stay closed until it is known whether there is one.
#[test]
fn links_stay_closed_until_the_key_is_read() {
    for has_key in [false, true] {
        let mut flash = if has_key { with_key() } else { super::damage::Flash::new(KEYS) };
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
        assert_eq!(armed_by(&mut rig), [false, false, true]);
        settle(&mut rig, &mut store);
        assert!(!rig.stack.is_restoring());
        // As configured: without a key, all are open.
        assert_eq!(armed_by(&mut rig), [!has_key, true, true]);
    }
}

/// G-11, G-18: a key that is set before the stored one is read stays, also after a restart, and the stored one is erased.
#[test]
fn a_key_that_is_set_before_reading_stays() {
    let mut flash = with_key();
    let mut store = Keys::new(&mut flash, 0..KEYS);
    let mut rig = signing_rig();
    rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
    rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
    assert!(rig.sent::<Heartbeat>(1)[0].is_signed_with(OTHER_KEY));
    for _ in 0..3 {
        rig.run_for(secs(1));
        settle(&mut rig, &mut store);
    }
    rig.receive(0, &Signer::new(OTHER_KEY).frame(&super::damage::arm()));
    assert_eq!(rig.vehicle.commands().len(), 1);
    assert!(!flash.bytes.windows(32).any(|bytes| bytes == KEY), "the old key is erased");
    let (_, mut rig, result) = start_rig(&mut flash);
    assert_eq!(result, Ok(()));
    rig.run_for(secs(1));
    assert!(rig.transmit(1).iter().any(|frame| frame.is_signed_with(OTHER_KEY)));
}

/// G-11, G-18: the same at any time during reading, also while a page of the key is read.
#[test]
fn a_key_that_is_set_during_reading_stays() {
    for calls in 0.. {
        let mut flash = with_key();
        let mut store = Keys::new(&mut flash, 0..KEYS);
        let mut rig = signing_rig();
        rig.stack.attach_storage(rig.now, store.region(), &mut rig.vehicle);
        for _ in 0..calls {
            rig.stack.exchange_job(rig.now, store.slot(), &mut rig.vehicle);
            store.run();
        }
        if !rig.stack.is_restoring() {
            assert!(calls > 10);
            break;
        }
        rig.receive(1, &Signer::new(KEY).unsigned(Version::V2, &setup(OTHER_KEY)));
        while rig.stack.exchange_job(rig.now, store.slot(), &mut rig.vehicle) {
            store.run();
        }
        rig.run_for(secs(1));
        assert!(rig.transmit(1).iter().all(|frame| frame.is_signed_with(OTHER_KEY)), "after {calls} calls");
    }
}

/// P-17: a parameter that is set before the stored ones are read keeps its value and is stored; the others are restored.
#[test]
fn a_parameter_that_is_set_before_reading_stays() {
    for is_stored in [false, true] {
        let mut flash = if is_stored { with_params() } else { super::damage::Flash::new(PARAMS) };
        let mut store = Params::new(&mut flash, 0..PARAMS);
        let mut world = World::new(Setup { step: millis(20), ..Setup::<1>::new() });
        world.stack.attach_storage(world.now(), store.region(), &mut world.vehicle);
        world.gcs[0].send(&set("CRUISE", 8.0));
        world.run_for(millis(100));
        run(&mut world, &mut store, secs(25));
        let (cruise, altitude) = cruise_and_altitude(&world);
        assert_eq!((cruise, altitude == 99.0), (8.0, is_stored));
        let (_, world, result) = start(&mut flash);
        assert_eq!(result, Ok(()));
        assert_eq!(cruise_and_altitude(&world), (8.0, altitude));
    }
}
