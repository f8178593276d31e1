//! The signing key and its time survive a power cut: rules G-13 and G-15, SEC-8.

use crate::pages::{self, LAST, LogPage};
use crate::support::flash::{Fault, RamFlash, Torn};
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

/// Starts a vehicle with this flash.
fn start(store: &mut Store<'_>) -> Rig {
    let mut rig = new_rig();
    of_key(rig.stack.restore(rig.now, store, &mut rig.vehicle)).expect("flash that can be read");
    rig
}

/// Runs storage until everything is written, or the power is cut. Returns the number of steps.
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

/// Returns the flash of a vehicle in which this key was set.
fn with_key(key: [u8; 32]) -> Flash {
    let mut flash = Flash::new(REGION);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.receive(0, &setup(key, NOW));
    settle(&mut rig, &mut store);
    flash
}

/// Returns what a restarted vehicle has: which of the two keys, and the time.
fn restarted(flash: &Flash) -> (Option<[u8; 32]>, u64) {
    let mut flash = flash.clone();
    flash.power_on();
    let mut store = store(&mut flash);
    let mut rig = new_rig();
    let result = of_key(rig.stack.restore(rig.now, &mut store, &mut rig.vehicle));
    let mut now = rig.now;
    if result == Err(RestoreError::Unreadable) {
        // The write of a page was cut off, and its ECC is wrong: after four attempts it does not count.
        while rig.stack.restore_errors().signing.is_some() {
            now += millis(100);
            rig.stack.persist(now, &mut store, &mut rig.vehicle);
            assert!(now < rig.now + secs(5));
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

/// SEC-15: even if the `Debug` of the flash shows its bytes.
#[test]
fn a_store_does_not_show_the_key() {
    let mut flash = with_key([0xA5; 32]);
    assert!(format!("{flash:?}").contains("165, 165"));
    assert_eq!(format!("{:?}", store(&mut flash)), "Store");
}

/// G-13, G-15: after a restart the key is in use, and the time is one minute ahead.
#[test]
fn a_stored_key_is_restored() {
    let flash = with_key(KEY);
    let (key, timestamp) = restarted(&flash);
    assert_eq!(key, Some(KEY));
    assert!((NOW + MINUTE..NOW + MINUTE + 1_000).contains(&timestamp));
    assert!(flash.bytes.windows(32).any(|bytes| bytes == KEY));
}

/// G-11, SEC-15: a key that was replaced or removed is erased from storage.
#[test]
fn an_old_key_is_erased() {
    for (key, initial_timestamp) in [(OTHER_KEY, NOW), ([0; 32], 0)] {
        let mut flash = with_key(KEY);
        let mut store = store(&mut flash);
        let mut rig = start(&mut store);
        rig.receive(0, &setup(key, initial_timestamp));
        settle(&mut rig, &mut store);
        settle(&mut rig, &mut store);
        assert!(
            !flash.bytes.windows(8).any(|bytes| KEY.windows(8).any(|part| part == bytes)),
            "the old key is still stored"
        );
        let (found, _) = restarted(&flash);
        assert_eq!(found, (initial_timestamp != 0).then_some(key));
    }
}

/// G-11, SEC-15: storage has records of the old key in both segments, in units that the new key does not need. All of them are
/// erased, also if the power is cut meanwhile.
#[test]
fn each_copy_of_an_old_key_is_erased() {
    const LONG: u32 = 5 * REGION;
    let has_key = |flash: &Flash| flash.bytes.windows(32).any(|bytes| bytes == KEY);
    for minutes in [1, 14, 25, 38] {
        let mut flash = Flash::new(LONG);
        let mut store = Store::new(&mut flash, 0..LONG);
        let mut rig = start(&mut store);
        rig.receive(0, &setup(KEY, NOW));
        for _ in 0..minutes * 60 {
            rig.run_for(secs(1));
            settle(&mut rig, &mut store);
        }
        let before = flash.clone();
        let mut was_cut = 0;
        for fuel in (1..300).step_by(7).map(Some).chain([None]) {
            let mut flash = before.clone();
            flash.fuel = fuel;
            let mut store = Store::new(&mut flash, 0..LONG);
            let mut rig = start(&mut store);
            rig.receive(0, &setup(OTHER_KEY, NOW));
            settle(&mut rig, &mut store);
            assert!(store.flash().is_off() || !has_key(store.flash()), "{minutes} minutes, cut after {fuel:?}");
            was_cut += u32::from(store.flash().is_off());
            store.flash_mut().power_on();
            let mut rig = start(&mut store);
            if rig.transmit(0)[0].is_signed_with(OTHER_KEY) {
                settle(&mut rig, &mut store);
                assert!(!has_key(store.flash()), "{minutes} minutes, cut after {fuel:?}: the old key is still stored");
            }
        }
        assert!(was_cut > 35, "{was_cut} cuts");
    }
}

/// G-13: the power is cut at every byte and in every erase while the key is replaced or removed. The restarted vehicle has the
/// new state, or the old key with a time that was not used before.
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

/// G-15, SEC-8: the power is cut again and again, at any byte of a write of the time. No timestamp is used twice, and time is
/// never ahead by more than one minute and what each restart skips.
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

/// G-15: a frame that was recorded in the last minute before a restart is accepted after it, unless the vehicle refuses recorded
/// frames. A station that is still there is accepted after the vehicle's first heartbeat in either case.
#[test]
fn frames_recorded_before_a_restart() {
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
        // A station adopts a later time that it receives.
        gcs.timestamp = gcs.timestamp.max(rig.transmit(0)[0].signature().timestamp + 1);
        rig.receive(0, &gcs.frame(&Gcs::heartbeat()));
        assert_eq!(rig.counters().verified, if refuses { 1 } else { 2 });
    }
}

/// G-17: a frame from a wrong clock moves our time years ahead, and that time is stored. Neither a restart nor the same key
/// corrects it; another key does, at once and after another restart. Key and time are always stored together.
#[test]
fn another_key_corrects_a_stored_time() {
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

/// G-17: once the removal of the key is stored, no time is written: the next key starts with its own time.
#[test]
fn no_time_is_stored_without_a_key() {
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

/// G-13: a vehicle that never had a key writes nothing.
#[test]
fn nothing_is_stored_without_a_key() {
    let mut flash = Flash::new(REGION);
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.run_for(secs(200));
    settle(&mut rig, &mut store);
    assert_eq!(store.flash().writes, 0);
}

/// G-14: restoring a time never sets the vehicle's time back.
#[test]
fn a_restored_time_does_not_go_back() {
    let mut flash = with_key(KEY);
    let mut store = store(&mut flash);
    let mut rig: Rig = Rig::new([LinkConfig::uart(115_200); 2]);
    let (now, unix) = (rig.now, 1_420_070_400_000_000);
    assert!(rig.signing().set_time(now, unix + 10 * (NOW + 99 * MINUTE), mavstack::Duration::MAX));
    of_key(rig.stack.restore(now, &mut store, &mut rig.vehicle)).expect("flash that can be read");
    assert!((NOW + 99 * MINUTE..NOW + 99 * MINUTE + 1_000).contains(&rig.timestamp()));
    // It is beyond the stored time, so it is stored.
    settle(&mut rig, &mut store);
    assert!(restarted(store.flash()).1 >= NOW + 100 * MINUTE);
}

/// G-15: the time is stored every 55 s, and the stored time is always ahead of ours, by one minute at most.
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

/// SEC-12: nothing is written while the vehicle does not permit it; what is due is written afterwards.
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

/// SEC-12: failing storage is tried again every ten seconds, and signing works meanwhile.
#[test]
fn failing_storage_does_not_stop_signing() {
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

/// G-18: storage that cannot be read is reported, and there is no key. Storage that is empty or has other data does not change a
/// key that the firmware has set; other data is reported.
#[test]
fn storage_that_has_no_key() {
    let mut flash = with_key(KEY);
    flash.fault = Fault::Read(0..REGION);
    let mut rig: Rig = Rig::new([LinkConfig::uart(115_200); 2]);
    let result = of_key(rig.stack.restore(rig.now, &mut store(&mut flash), &mut rig.vehicle));
    assert_eq!(result, Err(RestoreError::Unreadable));
    let text = rig.sent::<Statustext>(0)[0].decode::<Statustext>().unwrap();
    assert_eq!((text.text.as_bytes(), text.severity), (&b"The signing key cannot be read"[..], MavSeverity::ERROR));
    let mut rng = Rng::new(1);
    let garbage = (0..REGION).map(|_| rng.byte()).collect();
    for (mut flash, region) in [(Flash::new(REGION), None), (Flash::of(garbage), Some(RestoreError::OtherData))] {
        let mut rig: Rig = Rig::new([LinkConfig::uart(115_200); 2]);
        let now = rig.now;
        rig.signing().set_key(now, SigningKey::new(OTHER_KEY), NOW);
        let result = rig.stack.restore(now, &mut store(&mut flash), &mut rig.vehicle);
        assert_eq!((of_key(result), rig.stack.restore_errors().region), (Ok(()), region));
        let sent = rig.transmit(0);
        assert!(sent[0].is_signed_with(OTHER_KEY));
        let texts: Vec<_> = sent.iter().filter_map(Sent::decode::<Statustext>).collect();
        let texts: Vec<_> = texts.iter().map(|text| (text.text.as_bytes(), text.severity)).collect();
        let expected = (&b"Storage has other data, which is erased"[..], MavSeverity::WARNING);
        assert_eq!(texts, region.map(|_| expected).into_iter().collect::<Vec<_>>());
    }
}

/// The stored bytes, one by one: later versions must be able to read them.
#[test]
fn the_layout_is_as_documented() {
    let flash = with_key(KEY);
    let [(0, page)] = &pages::pages(&flash.bytes)[..] else { panic!("there is one page") };
    assert_eq!((flash.bytes[..4].to_vec(), page.payload.len()), (b"ML\x01\x03".to_vec(), 41));
    assert_eq!(page.payload[..32], KEY);
    let timestamp = u64::from_le_bytes(page.payload[32..40].try_into().unwrap());
    assert!((NOW + MINUTE..NOW + MINUTE + 1_000).contains(&timestamp));
    assert_eq!(page.payload[40], 1);
    let expected =
        LogPage { segment: 1, schema: 1, kind: 3, flags: LAST, payload: page.payload.clone(), ..LogPage::default() };
    assert_eq!(*page, expected);
    assert!(flash.bytes[256..].iter().all(|byte| *byte == 0xFF));

    let mut flash = flash;
    let mut store = store(&mut flash);
    let mut rig = start(&mut store);
    rig.receive(0, &setup([0; 32], 0));
    settle(&mut rig, &mut store);
    let (_, page) = pages::newest(&flash.bytes, pages::KEY);
    assert_eq!((&page.payload[..32], &page.payload[40..]), (&[0; 32][..], &[0][..]), "there is no key");
}
