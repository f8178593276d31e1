//! The tasks of the vehicle, except those of a network.

use core::future::pending;

use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Timer};
use mavstack::LinkId;
use mavstack::frame::MAX_FRAME_LEN;
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack_demo::{App, LINKS, PORTS};
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::memory::FlashStore;

use crate::uart::{Receiver, Sender};

/// Period of the flight loop.
const PERIOD: Duration = Duration::from_millis(10);

/// The most bytes for one call of the stack: not much more than one frame, so that flight waits for one frame.
const PIECE: usize = 16;

/// The vehicle and its stack, which flight and comms share.
pub type SharedApp = Mutex<CriticalSectionRawMutex, &'static mut App>;
/// The tasks `exchange` and `run` use it in turn.
pub type SharedStore = Mutex<CriticalSectionRawMutex, FlashStore>;

/// Signals to each link's `transmit` task that output may be pending.
pub static WAKE: [Signal<CriticalSectionRawMutex, ()>; LINKS] = [const { Signal::new() }; LINKS];

/// Wakes the `transmit` tasks of all links: a received frame may be forwarded to any of them.
pub fn wake_transmitters() {
    WAKE.iter().for_each(|wake| wake.signal(()));
}

/// Signals to `run` that the store has a job, and to `exchange` that the job has ended.
static JOB: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static DONE: Signal<CriticalSectionRawMutex, ()> = Signal::new();

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
    let mut buffer = [0; 64];
    let mut receiver = AsyncReceiver::new(rx, &mut buffer).with_piece(PIECE);
    loop {
        receiver.wait().await;
        let is_pending = {
            let mut app = app.lock().await;
            let (stack, vehicle) = app.parts();
            // An error is reported once, and counted. Checksums detect the lost bytes.
            stack.receive_from(board::now(), link, &mut receiver, vehicle)
        };
        if is_pending != Ok(true) {
            wake_transmitters();
        }
    }
}

/// Transmits pending frames on a link.
#[embassy_executor::task(pool_size = PORTS)]
pub async fn transmit(app: &'static SharedApp, link: LinkId, tx: Sender) {
    let mut frame = [0; MAX_FRAME_LEN];
    let mut transmitter = AsyncTransmitter::new(tx, &mut frame);
    loop {
        // One call for each lock, so that flight waits for one call at most.
        app.lock().await.poll(board::now());
        let (has_bytes, deadline) = {
            let mut app = app.lock().await;
            let now = board::now();
            let (stack, vehicle) = app.parts();
            let has_bytes = stack.transmit_to(now, link, &mut transmitter, vehicle);
            (has_bytes, stack.link_deadline(now, link))
        };
        if has_bytes == Ok(true) {
            transmitter.send().await;
        } else {
            select(WAKE[usize::from(link.0)].wait(), Timer::at(deadline.into())).await;
        }
    }
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
