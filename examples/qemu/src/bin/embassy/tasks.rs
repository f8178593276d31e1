//! The tasks of the vehicle, except those of a network.

use core::future::pending;

use embassy_time::{Duration, Instant, Timer};
use mavstack::LinkId;
use mavstack_demo::PORTS;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::memory::FlashStore;

use crate::shared::{self, DONE, JOB, SharedApp, wake_transmitters};
use crate::uart::{Receiver, Sender};

/// Period of the flight loop.
const PERIOD: Duration = Duration::from_millis(10);

/// The tasks `exchange` and `run` use it in turn.
pub type SharedStore = shared::SharedStore<FlashStore>;

/// Runs the flight loop, which ticks the pulse.
#[embassy_executor::task]
pub async fn flight(app: &'static SharedApp) {
    let mut next = Instant::now();
    loop {
        let (has_output, hangs) = {
            let mut app = app.lock().await;
            (app.fly(board::now()), app.simulates_hang())
        };
        if has_output {
            wake_transmitters();
        }
        if hangs {
            // For example for a sensor that does not answer.
            pending::<()>().await;
        }
        // Missed passes are skipped. A `Ticker` would run them at once, without yielding.
        next = (next + PERIOD).max(Instant::now());
        Timer::at(next).await;
    }
}

/// Receives bytes on a link.
#[embassy_executor::task(pool_size = PORTS)]
pub async fn receive(app: &'static SharedApp, link: LinkId, rx: Receiver) {
    shared::receive(app, link, rx).await;
}

/// Transmits pending frames on a link.
#[embassy_executor::task(pool_size = PORTS)]
pub async fn transmit(app: &'static SharedApp, link: LinkId, tx: Sender) {
    shared::transmit(app, link, tx).await;
}

/// Exchanges the storage's jobs, and resets the processor when a reboot was requested.
#[embassy_executor::task]
pub async fn exchange(app: &'static SharedApp, store: &'static SharedStore) {
    loop {
        let has_job = {
            let mut store = store.lock().await;
            let mut app = app.lock().await;
            if app.wants_reboot() {
                Board::reset();
            }
            store.exchange_job(&mut app, board::now())
        };
        if has_job {
            JOB.signal(());
            DONE.wait().await;
        } else {
            Timer::after(Duration::from_millis(10)).await;
        }
    }
}

/// Runs the storage's jobs. Its priority is the lowest, because an erase may keep the processor busy.
#[embassy_executor::task]
pub async fn run(store: &'static SharedStore) {
    loop {
        JOB.wait().await;
        store.lock().await.run();
        DONE.signal(());
    }
}
