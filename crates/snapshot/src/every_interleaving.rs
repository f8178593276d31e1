//! Runs the snapshot in loom: in every interleaving of two threads, with every value that a load may return. `cargo measure loom`.
//!
//! loom fails a test when a slot is read and written at the same time, or when nothing orders the two accesses. So no value is torn.

extern crate std;

use std::boxed::Box;

use loom::sync::Arc;
use loom::sync::atomic::Ordering::{self, Acquire, Relaxed, Release};
use loom::sync::atomic::{self, AtomicU8};
use loom::thread;

use crate::{Reader, Snapshot, Writer};

const WRITES: u8 = 3;
/// For the longer models.
const PREEMPTIONS: usize = 4;

loom::lazy_static! {
    static ref FENCES: AtomicU8 = AtomicU8::new(0);
}

/// A fence at which loom switches threads. It switches at accesses to a shared atomic, but not at fences.
pub fn fence(order: Ordering) {
    FENCES.fetch_add(1, Relaxed);
    atomic::fence(order);
}

fn ends() -> (Writer<'static, u8>, Reader<'static, u8>) {
    Box::leak(Box::new(Snapshot::new(0))).split()
}

/// Runs a model. With `preemptions`, only the interleavings with at most so many: all of them would take hours.
fn explore(preemptions: Option<usize>, model: impl Fn() + Sync + Send + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = preemptions;
    builder.check(model);
}

/// One thread writes 1, 2, 3 while another one reads. Values never go back, and the last one arrives.
fn values_never_go_back(preemptions: Option<usize>, reads: u8) {
    explore(preemptions, move || {
        let (mut writer, mut reader) = ends();
        let writing = thread::spawn(move || (1..=WRITES).for_each(|value| writer.write(value)));
        let mut last = 0;
        for _ in 0..reads {
            let value = reader.read();
            assert!(last <= value && value <= WRITES, "{value} after {last}");
            last = value;
        }
        writing.join().unwrap();
        assert_eq!(reader.read(), WRITES);
    });
}

#[test]
fn two_reads_never_go_back() {
    values_never_go_back(None, 2);
}

#[test]
fn three_reads_never_go_back() {
    values_never_go_back(Some(PREEMPTIONS), 3);
}

/// A read that begins after the end of a write returns its value or a newer one.
#[test]
fn complete_values_are_read() {
    explore(Some(PREEMPTIONS), || {
        let (mut writer, mut reader) = ends();
        let written = Arc::new(AtomicU8::new(0));
        let complete = written.clone();
        let writing = thread::spawn(move || {
            for value in 1..=WRITES {
                writer.write(value);
                complete.store(value, Release);
            }
        });
        for _ in 0..3 {
            let oldest = written.load(Acquire);
            let value = reader.read();
            assert!(value >= oldest, "{value} after {oldest} was complete");
        }
        writing.join().unwrap();
    });
}
