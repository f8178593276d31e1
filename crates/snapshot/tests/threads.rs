//! Two threads on one snapshot: on the host's processor, and in Miri.

use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use mavstack_snapshot::{Reader, Snapshot, Writer};

/// Values in each direction. Miri is some hundred times slower.
const VALUES: u64 = if cfg!(miri) { 300 } else { 300_000 };

/// Too long for one access.
type Value = [u64; 12];

/// The reader sees whole values, none older than one before, and none older than the last complete one.
#[test]
fn threads_see_whole_values_in_order() {
    let mut snapshot = Snapshot::new([0; 12]);
    let complete = AtomicU64::new(0);
    let (mut writer, mut reader): (Writer<'_, Value>, Reader<'_, Value>) = snapshot.split();
    thread::scope(|scope| {
        scope.spawn(|| {
            for value in 1..=VALUES {
                writer.write([value; 12]);
                complete.store(value, Ordering::Release);
            }
        });
        let mut last = 0;
        // Bounded: the writer ends.
        while last < VALUES {
            let oldest = complete.load(Ordering::Acquire);
            let value = reader.read();
            assert_eq!(value, [value[0]; 12], "a torn value");
            assert!(value[0] >= last && value[0] >= oldest, "{} after {last}, {oldest} was complete", value[0]);
            last = value[0];
            if cfg!(miri) {
                thread::yield_now();
            }
        }
    });
}

/// Two snapshots carry a number there and back: each thread reads what the other has made of it.
#[test]
fn two_snapshots_make_a_round_trip() {
    const ROUNDS: u64 = VALUES / 100;
    let (mut there, mut back) = (Snapshot::new(0), Snapshot::new(0));
    let ((mut ask, mut asked), (mut answer, mut answered)) = (there.split(), back.split());
    thread::scope(|scope| {
        scope.spawn(move || {
            let mut last = 0;
            while last < ROUNDS {
                last = asked.read();
                answer.write(last);
                thread::yield_now();
            }
        });
        for round in 1..=ROUNDS {
            ask.write(round);
            while answered.read() != round {
                thread::yield_now();
            }
        }
    });
}

#[test]
fn the_initial_value_is_read_first() {
    let mut snapshot = Snapshot::new(7);
    assert_eq!(snapshot.split().1.read(), 7);
}

/// The ends may be taken again, by threads that follow each other.
#[test]
fn a_value_outlives_its_ends() {
    let mut snapshot = Snapshot::new(0);
    for value in 1..=9 {
        let (mut writer, mut reader) = snapshot.split();
        assert_eq!(reader.read(), value - 1);
        thread::scope(|scope| scope.spawn(move || writer.write(value)).join().unwrap());
        assert_eq!(reader.read(), value);
    }
}

/// Each end can be sent to a task or an interrupt, and the snapshot may be `static`.
#[test]
fn ends_can_be_sent() {
    fn is_send<T: Send>() {}
    fn is_sync<T: Sync>() {}
    is_send::<Writer<'static, Value>>();
    is_send::<Reader<'static, Value>>();
    is_sync::<Snapshot<Value>>();
    assert_eq!(
        size_of::<Snapshot<Value>>(),
        4 * size_of::<Value>() + 8,
        "four values and four flags, padded to eight bytes"
    );
    assert_eq!(size_of::<Snapshot<u8>>(), 4 + 4);
}
