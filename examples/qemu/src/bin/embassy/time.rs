//! Embassy's time driver, on the board's clock and alarm.

use core::cell::RefCell;
use core::task::Waker;

use embassy_sync::blocking_mutex::CriticalSectionMutex;
use embassy_time_driver::{Driver, time_driver_impl};
use embassy_time_queue_utils::Queue;
use mavstack_qemu::board::{self, Alarm};
use mavstack_qemu::device::interrupt;

/// The pending wake-ups, and the alarm for the next one.
struct Wakeups {
    queue: Queue,
    alarm: Option<Alarm>,
}

impl Wakeups {
    /// Wakes all tasks that are due, and sets the alarm for the next one.
    fn wake(&mut self) {
        let now = board::now().as_micros();
        let next = self.queue.next_expiration(now);
        if let Some(alarm) = &mut self.alarm {
            alarm.set(next.saturating_sub(now));
        }
    }
}

struct BoardTime(CriticalSectionMutex<RefCell<Wakeups>>);

impl Driver for BoardTime {
    /// Ticks are microseconds: the feature `tick-hz-1_000_000`.
    fn now(&self) -> u64 {
        board::now().as_micros()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        self.0.lock(|wakeups| {
            let wakeups = &mut *wakeups.borrow_mut();
            if wakeups.queue.schedule_wake(at, waker) {
                wakeups.wake();
            }
        });
    }
}

time_driver_impl!(static TIME: BoardTime =
    BoardTime(CriticalSectionMutex::new(RefCell::new(Wakeups { queue: Queue::new(), alarm: None }))));

/// Starts the driver. The interrupt must find the alarm: only setting it again ends the request.
pub fn start(mut alarm: Alarm) {
    TIME.0.lock(|wakeups| {
        alarm.set(0);
        alarm.listen();
        wakeups.borrow_mut().alarm = Some(alarm);
    });
}

#[interrupt]
fn TIMER1() {
    TIME.0.lock(|wakeups| wakeups.borrow_mut().wake());
}
