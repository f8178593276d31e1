//! Embassy's time: the board's clock, and its alarm for who sleeps.

use core::cell::RefCell;
use core::task::Waker;

use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_time_driver::{Driver, time_driver_impl};
use embassy_time_queue_utils::Queue;
use mavstack_qemu::board::{self, Alarm};
use mavstack_qemu::device::interrupt;

/// Who sleeps, and what wakes them.
struct Sleepers {
    queue: Queue,
    alarm: Option<Alarm>,
}

impl Sleepers {
    /// Wakes those whose time has come, and sets the alarm for the next.
    fn wake(&mut self) {
        let now = board::now().as_micros();
        let next = self.queue.next_expiration(now);
        if let Some(alarm) = &mut self.alarm {
            alarm.set(next.saturating_sub(now));
        }
    }
}

struct BoardTime(CriticalSectionMutex<RefCell<Sleepers>>);

impl Driver for BoardTime {
    /// Ticks are microseconds: the feature `tick-hz-1_000_000`.
    fn now(&self) -> u64 {
        board::now().as_micros()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        self.0.lock(|sleepers| {
            let sleepers = &mut *sleepers.borrow_mut();
            if sleepers.queue.schedule_wake(at, waker) {
                sleepers.wake();
            }
        });
    }
}

time_driver_impl!(static TIME: BoardTime =
    BoardTime(CriticalSectionMutex::new(RefCell::new(Sleepers { queue: Queue::new(), alarm: None }))));

/// From now on sleepers are woken.
pub fn start(mut alarm: Alarm) {
    alarm.set(0);
    alarm.listen();
    TIME.0.lock(|sleepers| sleepers.borrow_mut().alarm = Some(alarm));
}

#[interrupt]
fn TIMER1() {
    TIME.0.lock(|sleepers| sleepers.borrow_mut().wake());
}
