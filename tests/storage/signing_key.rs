//! The signing key and its time survive a power cut: rules G-13 and G-15, SEC-8.

use crate::support::flash::{Fault, FlashError, RamFlash, Torn};
use crate::support::signer::*;
use crate::support::*;
use crate::{OnlyKey, of_key};
use mavstack::LinkConfig;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::message::Secret;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::storage::RestoreError;

type Flash = RamFlash<8, 512>;
type Store<'a> = mavstack::storage::Store<&'a mut Flash>;

const REGION: u32 = mavstack::storage::Store::<Flash>::region_len::<OnlyKey>();
/// A minute, in timestamps.
const MINUTE: u64 = 6_000_000;

fn store(flash: &mut Flash) -> Store<'_> {
    Store::new(flash, 0..REGION)
}

fn new_rig() -> Rig {
    Rig::new([LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN.with_provisioning()); 2])
}

/// A vehicle that starts with this flash.
fn start(store: &mut Store<'_>) -> Rig {
    let mut rig = new_rig();
    of_key(rig.stack.restore(rig.now, store, &mut rig.vehicle)).expect("flash that can be read");
    rig
}

/// Until all is written, or the power goes; how many steps that took.
fn settle(rig: &mut Rig, store: &mut Store<'_>) -> u32 {
    let mut steps = 0;
    while rig.stack.persist(rig.now, store, &mut rig.vehicle) && !store.flash().is_off() {
        steps += 1;
        assert!(steps < 100, "it never ends");
    }
    steps
}

fn setup(key: [u8; 32], initial_timestamp: u64) -> Vec<u8> {
    let message = SetupSigning { initial_timestamp, target_system: 1, target_component: 1, secret_key: Secret(key) };
    Signer::new(KEY).unsigned(Version::V2, &message)
}

/// Flash of a vehicle that had this key set.
fn with_key(key: [u8; 32]) -> Flash {
    let mut flash = Flash::new(REGION);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.receive(0, &setup(key, NOW));
    settle(&mut rig, &mut store);
    flash
}

/// What a restart finds: which of the keys, and the time.
fn restarted(flash: &Flash) -> (Option<[u8; 32]>, u64) {
    let mut flash = flash.clone();
    flash.power_on();
    let mut store = store(&mut flash);
    let mut rig = new_rig();
    let result = of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle));
    let mut now = rig.now;
    if result == Err(RestoreError::Storage(FlashError::Fault)) {
        // A header that was cut off and cannot be read: after some looks, it does not count.
        while !rig.stack.persist(now, &mut store, &mut rig.vehicle) {
            now = now.after(secs(1));
            assert!(now < rig.now.after(secs(5)));
        }
    } else {
        assert_eq!(result, Ok(()));
    }
    let timestamp = rig.signing().timestamp(now);
    let first = rig.transmit(0).swap_remove(0);
    let key = [KEY, OTHER_KEY].into_iter().find(|key| first.is_signed_with(*key));
    assert_eq!(key.is_some(), first.is_signed());
    (key, timestamp)
}

/// SEC-15: also where the storage shows its bytes.
#[test]
fn a_store_does_not_show_the_key() {
    let mut flash = with_key([0xA5; 32]);
    assert!(format!("{flash:?}").contains("165, 165"), "it does");
    assert_eq!(format!("{:?}", store(&mut flash)), "Store");
}

#[test]
fn a_key_comes_back() {
    let flash = with_key(KEY);
    let (key, timestamp) = restarted(&flash);
    assert_eq!(key, Some(KEY));
    assert!((NOW + MINUTE..NOW + MINUTE + 1_000).contains(&timestamp));
    assert!(flash.bytes.windows(32).any(|bytes| bytes == KEY));
}

/// G-11, SEC-15: a key that was replaced, or taken away, is gone from storage too.
#[test]
fn an_old_key_is_erased() {
    for (key, initial_timestamp) in [(OTHER_KEY, NOW), ([0; 32], 0)] {
        let mut flash = with_key(KEY);
        let mut store = store(&mut flash);
        let mut rig = start(&mut store);
        rig.receive(0, &setup(key, initial_timestamp));
        settle(&mut rig, &mut store);
        settle(&mut rig, &mut store);
        assert!(!flash.bytes.windows(8).any(|bytes| KEY.windows(8).any(|part| part == bytes)), "it is still there");
        let (found, _) = restarted(&flash);
        assert_eq!(found, (initial_timestamp != 0).then_some(key));
    }
}

/// G-13: the power goes at every byte and in every erase of a change of the key: the restarted vehicle has the old key and a
/// time that was not used with it, or the new one.
#[test]
fn a_change_of_the_key_is_cut() {
    for torn in [Torn::Prefix, Torn::Garbage, Torn::Unreadable] {
        for (key, initial_timestamp) in [(OTHER_KEY, NOW + 3 * MINUTE), ([0; 32], 0)] {
            let mut before = with_key(KEY);
            before.torn = torn;
            let change = |flash: &mut Flash| {
                let mut store = store(flash);
                let mut rig = start(&mut store);
                rig.receive(0, &setup(key, initial_timestamp));
                settle(&mut rig, &mut store);
                settle(&mut rig, &mut store);
            };
            let mut uncut = before.clone();
            change(&mut uncut);
            let (old, new) = (restarted(&before), restarted(&uncut));
            assert_ne!(old, new);
            let (mut was_old, mut was_new) = (0, 0);
            for fuel in 1..=uncut.cost() - before.cost() {
                let mut flash = before.clone();
                flash.fuel = Some(fuel);
                change(&mut flash);
                let found = restarted(&flash);
                assert!(found == old || found == new, "cut after {fuel}: {found:?}");
                was_old += u32::from(found == old);
                was_new += u32::from(found == new);
            }
            assert!(was_old > 0 && was_new > 0, "{was_old} old, {was_new} new");
        }
    }
}

/// G-15, SEC-8: the power goes at any byte while the time is written on, over and over: no timestamp is ever used twice, and
/// none is more than a minute and what the restarts took ahead.
#[test]
fn no_timestamp_is_used_twice() {
    let mut rng = Rng::new(5);
    let mut flash = with_key(KEY);
    let (mut last, mut passed, mut starts) = (0, 0, 0);
    for _ in 0..300 {
        flash.power_on();
        flash.fuel = Some(1 + rng.below(2_500));
        let mut store = store(&mut flash);
        let mut rig = start(&mut store);
        starts += 1;
        while !store.flash().is_off() {
            let step = millis(100 * (1 + rng.below(50)));
            rig.run_for(step);
            passed += step.as_micros() / 10;
            settle(&mut rig, &mut store);
            let is_off = store.flash().is_off();
            for frame in rig.transmit(0).into_iter().filter(|_| !is_off) {
                let timestamp = frame.signature().timestamp;
                assert!(timestamp > last, "{timestamp} after {last}");
                last = timestamp;
            }
        }
    }
    let ahead = last - NOW - passed;
    assert!(ahead <= starts * (MINUTE + 500_000) + MINUTE, "{ahead} ahead after {starts} restarts");
}

/// G-15: what was recorded in the last minute before a restart; and that who is there is heard after our first heartbeat.
#[test]
fn what_was_recorded_before_a_restart() {
    for refuses in [false, true] {
        let mut flash = with_key(KEY);
        let mut store = store(&mut flash);
        let mut rig = start(&mut store);
        settle(&mut rig, &mut store);
        rig.run_for(secs(40));
        let now = rig.timestamp();
        let mut gcs = Signer::new(KEY).at(now);
        let recorded = gcs.frame(&Gcs::heartbeat());
        rig.receive(0, &recorded);
        settle(&mut rig, &mut store);
        assert_eq!(rig.counters().verified, 1);

        let mut rig = start(&mut store);
        let now = rig.now;
        if refuses {
            rig.signing().refuse_recorded(now);
        }
        rig.receive(0, &recorded);
        assert_eq!((rig.counters().verified, rig.counters().too_old), if refuses { (0, 1) } else { (1, 0) });
        // A station follows the time that it hears.
        gcs.timestamp = gcs.timestamp.max(rig.transmit(0)[0].signature().timestamp + 1);
        rig.receive(0, &gcs.frame(&Gcs::heartbeat()));
        assert_eq!(rig.counters().verified, if refuses { 1 } else { 2 });
    }
}

/// G-17: a frame from a wrong clock moves our time years ahead, and that time is stored. Neither a restart nor the same key
/// corrects it; another key does, at once and after another restart. Key and time are always stored together.
#[test]
fn another_key_heals_a_stored_time() {
    const WRONG: u64 = NOW + 14 * 365 * 1_440 * MINUTE;
    let mut flash = with_key(KEY);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.receive(0, &Signer::new(KEY).at(WRONG).frame(&Gcs::heartbeat()));
    assert_eq!(rig.counters().verified, 1);
    settle(&mut rig, &mut store);

    let mut rig = start(&mut store);
    assert!(rig.timestamp() >= WRONG);
    rig.receive(0, &setup(KEY, NOW));
    rig.receive(0, &Signer::new(KEY).of(OTHER_STATION).frame(&Gcs::heartbeat()));
    assert_eq!((rig.counters().too_old, rig.counters().verified), (1, 0), "the same key");
    rig.transmit(0);
    rig.receive(0, &setup(OTHER_KEY, NOW));
    rig.receive(0, &Signer::new(OTHER_KEY).frame(&Gcs::heartbeat()));
    assert_eq!(rig.counters().verified, 1);
    assert!(rig.transmit(0).iter().all(|frame| (NOW..NOW + MINUTE).contains(&frame.signature().timestamp)));
    assert!(restarted(store.flash()).0 == Some(KEY), "not stored yet");
    settle(&mut rig, &mut store);

    let (key, timestamp) = restarted(store.flash());
    assert_eq!(key, Some(OTHER_KEY));
    assert!((NOW..NOW + 2 * MINUTE).contains(&timestamp), "{timestamp}");
    let mut rig = start(&mut store);
    rig.receive(0, &Signer::new(OTHER_KEY).at(timestamp).frame(&Gcs::heartbeat()));
    assert_eq!(rig.counters().verified, 1);
}

/// G-17: a stored time sets no bound. A vehicle without a clock that was off for a year accepts its peers; a vehicle with a clock
/// and a wrong stored time accepts the peers that follow its own time.
#[test]
fn a_stored_time_bounds_nothing() {
    const YEAR: u64 = 365 * 1_440 * MINUTE;
    let mut flash = with_key(KEY);
    let mut rig = start(&mut store(&mut flash));
    rig.receive(0, &Signer::new(KEY).at(NOW + YEAR).frame(&Gcs::heartbeat()));
    assert_eq!((rig.counters().verified, rig.counters().too_far_ahead), (1, 0));
    let mut rig = start(&mut store(&mut flash));
    let (now, unix) = (rig.now, 1_420_070_400_000_000);
    assert!(rig.signing().set_time(now, unix + 10 * (NOW - YEAR), mavstack::Duration::MAX));
    let ours = rig.timestamp();
    rig.receive(0, &Signer::new(KEY).at(ours + 1).frame(&Gcs::heartbeat()));
    assert_eq!((rig.counters().verified, rig.counters().too_far_ahead), (1, 0));
}

/// G-17: without a key nothing is written, once that is stored: the next key starts with its own time.
#[test]
fn no_time_is_kept_without_a_key() {
    let mut flash = with_key(KEY);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.signing().clear_key();
    settle(&mut rig, &mut store);
    let writes = store.flash().writes;
    for _ in 0..200 {
        rig.run_for(secs(1));
        settle(&mut rig, &mut store);
    }
    assert_eq!((store.flash().writes, restarted(store.flash()).0), (writes, None));
}

/// A vehicle that never had a key writes nothing.
#[test]
fn nothing_is_kept_of_no_key() {
    let mut flash = Flash::new(REGION);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.run_for(secs(200));
    settle(&mut rig, &mut store);
    assert_eq!(store.flash().writes, 0);
}

/// G-14: what is restored moves the time no further back than the vehicle has it already.
#[test]
fn a_restored_time_does_not_go_back() {
    let mut flash = with_key(KEY);
    let mut store = store(&mut flash);
    let mut rig: Rig = Rig::new([LinkConfig::uart(115_200); 2]);
    let (now, unix) = (rig.now, 1_420_070_400_000_000);
    assert!(rig.signing().set_time(now, unix + 10 * (NOW + 99 * MINUTE), mavstack::Duration::MAX));
    of_key(rig.stack.restore(now, &mut store, &mut rig.vehicle)).expect("flash that can be read");
    assert!((NOW + 99 * MINUTE..NOW + 99 * MINUTE + 1_000).contains(&rig.timestamp()));
    // And it is stored, for it is beyond what was reserved.
    settle(&mut rig, &mut store);
    assert!(restarted(store.flash()).1 >= NOW + 100 * MINUTE);
}

/// G-15: with storage that works there is a write every 55 s, each of them small; the stored time is ahead, by a minute at most.
#[test]
fn the_time_is_stored_ahead() {
    let mut flash = with_key(KEY);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    settle(&mut rig, &mut store);
    let mut jobs = 0;
    for _ in 0..6_000 {
        rig.run_for(millis(100));
        let before = store.flash().writes;
        settle(&mut rig, &mut store);
        jobs += u32::from(store.flash().writes > before);
        let (_, stored) = restarted(store.flash());
        let now = rig.timestamp();
        assert!(now + 490_000 <= stored && stored <= now + MINUTE, "{now}, {stored}");
    }
    assert_eq!(jobs, 600 / 55);
}

/// SEC-12: nothing is written while the vehicle says no, and then what was due.
#[test]
fn nothing_is_written_without_permission() {
    let mut flash = Flash::new(REGION);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.receive(0, &setup(KEY, NOW));
    rig.vehicle.may_persist = false;
    assert_eq!(settle(&mut rig, &mut store), 0);
    rig.run_for(secs(100));
    assert_eq!(settle(&mut rig, &mut store), 0);
    rig.vehicle.may_persist = true;
    assert!(settle(&mut rig, &mut store) > 0);
    assert!(restarted(store.flash()).1 >= rig.timestamp());
}

/// Storage that fails is left alone for ten seconds at a time, and signing goes on.
#[test]
fn failing_storage_does_not_stop_anything() {
    for fault in [Fault::Erase, Fault::Write(0), Fault::HalfWrite(0), Fault::WrongWrite(0)] {
        let mut flash = with_key(KEY);
        flash.writes = 0;
        flash.fault = fault.clone();
        let mut store = store(&mut flash);
        let mut rig = start(&mut store);
        rig.receive(0, &setup(OTHER_KEY, NOW));
        let mut steps = 0;
        for _ in 0..60 {
            steps += settle(&mut rig, &mut store);
            rig.run_for(secs(1));
        }
        assert!((1..50).contains(&steps), "{fault:?}: {steps} steps in a minute");
        assert!(rig.transmit(0).iter().all(|frame| frame.is_signed_with(OTHER_KEY)));
        store.flash_mut().fault = Fault::None;
        rig.run_for(secs(10));
        settle(&mut rig, &mut store);
        assert_eq!(restarted(store.flash()).0, Some(OTHER_KEY), "{fault:?}");
    }
}

/// G-18: storage that cannot be read is told, and there is no key; one that is empty, or has something else in it, changes no key
/// that there is.
#[test]
fn what_cannot_be_read() {
    let mut flash = with_key(KEY);
    flash.fault = Fault::Read(0..REGION);
    let mut rig: Rig = Rig::new([LinkConfig::uart(115_200); 2]);
    let result = of_key(rig.stack.restore(rig.now, &mut store(&mut flash), &mut rig.vehicle));
    assert_eq!(result, Err(RestoreError::Storage(FlashError::Fault)));
    let text = rig.sent::<Statustext>(0)[0].decode::<Statustext>().unwrap();
    assert_eq!((text.text.as_bytes(), text.severity), (&b"The signing key cannot be read"[..], MavSeverity::ERROR));
    let mut rng = Rng::new(1);
    let garbage = (0..REGION).map(|_| rng.byte()).collect();
    for mut flash in [Flash::new(REGION), Flash::of(garbage)] {
        let mut rig: Rig = Rig::new([LinkConfig::uart(115_200); 2]);
        let now = rig.now;
        rig.signing().set_key(now, SigningKey::new(OTHER_KEY), NOW);
        assert_eq!(of_key(rig.stack.restore(now, &mut store(&mut flash), &mut rig.vehicle)), Ok(()));
        assert!(rig.transmit(0)[0].is_signed_with(OTHER_KEY));
    }
}

/// What is stored stands here byte by byte: later versions have to read it.
#[test]
fn the_layout_is_this() {
    let flash = with_key(KEY);
    let slot = (0..2).map(|slot| slot * 512).find(|slot| flash.bytes[*slot..].starts_with(b"MVSR")).expect("a record");
    let header = &flash.bytes[slot..slot + 32];
    assert_eq!(header[4..8], [3, 0, 1, 0], "kind, schema");
    assert_eq!(header[12..16], [64, 0, 0, 0], "length");
    let body = &flash.bytes[slot + 256..slot + 320];
    assert_eq!(body[..32], KEY);
    let timestamp = u64::from_le_bytes(body[32..40].try_into().unwrap());
    assert!((NOW + MINUTE..NOW + MINUTE + 1_000).contains(&timestamp));
    assert_eq!(body[40..], [&[1][..], &[0; 23]].concat());
}
