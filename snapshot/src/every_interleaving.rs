//! Runs the snapshot in loom: in every interleaving of two threads, with every value that a load may return. `cargo measure loom`.
//!
//! loom fails a test when a slot is read and written at the same time, or when nothing orders the two accesses. So no value is torn.

extern crate std;

use std::boxed::Box;

use loom::sync::Arc;
use loom::sync::atomic::{AtomicU8, Ordering::Acquire, Ordering::Release};
use loom::thread;

use crate::{Reader, Snapshot, Writer};

const WRITES: u8 = 3;
const READS: u8 = 3;

fn ends() -> (Writer<'static, u8>, Reader<'static, u8>) {
    Box::leak(Box::new(Snapshot::new(0))).split()
}

/// A thread reads while another one writes 1, 2, 3. Values never go back, and the last one arrives.
#[test]
fn values_never_go_back() {
    loom::model(|| {
        let (mut writer, mut reader) = ends();
        let writing = thread::spawn(move || (1..=WRITES).for_each(|value| writer.write(value)));
        let mut last = 0;
        for _ in 0..READS {
            let value = reader.read();
            assert!(last <= value && value <= WRITES, "{value} after {last}");
            last = value;
        }
        writing.join().unwrap();
        assert_eq!(reader.read(), WRITES);
    });
}

/// A read that begins after the end of a write returns its value or a newer one.
#[test]
fn complete_values_are_read() {
    loom::model(|| {
        let (mut writer, mut reader) = ends();
        let written = Arc::new(AtomicU8::new(0));
        let complete = written.clone();
        let writing = thread::spawn(move || {
            for value in 1..=WRITES {
                writer.write(value);
                complete.store(value, Release);
            }
        });
        for _ in 0..READS - 1 {
            let oldest = written.load(Acquire);
            let value = reader.read();
            assert!(value >= oldest, "{value} after {oldest} was complete");
        }
        writing.join().unwrap();
    });
}

/// The same with the roles of the threads exchanged: loom begins with another one.
#[test]
fn the_reader_may_be_the_other_thread() {
    loom::model(|| {
        let (mut writer, mut reader) = ends();
        let reading = thread::spawn(move || {
            let values = [reader.read(), reader.read(), reader.read()];
            assert!(values.is_sorted() && values[2] <= WRITES, "{values:?}");
        });
        (1..=WRITES).for_each(|value| writer.write(value));
        reading.join().unwrap();
    });
}
