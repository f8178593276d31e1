//! What the firmwares with Embassy share: the vehicle behind a mutex, the wake-ups, and both ends of a link.

use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embassy_time::Timer;
use embedded_io_async::{Read, Write};
use mavstack::LinkId;
use mavstack::frame::MAX_FRAME_LEN;
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack_demo::{App, LINKS};
use mavstack_qemu::board;

/// The most bytes for one call of the stack: not much more than one frame, so that flight waits for one frame.
const PIECE: usize = 16;

/// The vehicle and its stack, which flight and comms share.
pub type SharedApp = Mutex<CriticalSectionRawMutex, &'static mut App>;
/// The tasks `exchange` and `run` use the store in turn.
pub type SharedStore<S> = Mutex<CriticalSectionRawMutex, S>;

/// Signals to each link's `transmit` task that output may be pending.
pub static WAKE: [Signal<CriticalSectionRawMutex, ()>; LINKS] = [const { Signal::new() }; LINKS];

/// Wakes the `transmit` tasks of all links: a received frame may be forwarded to any of them.
pub fn wake_transmitters() {
    WAKE.iter().for_each(|wake| wake.signal(()));
}

/// Signals to `run` that the store has a job, and to `exchange` that the job has ended.
pub static JOB: Signal<CriticalSectionRawMutex, ()> = Signal::new();
pub static DONE: Signal<CriticalSectionRawMutex, ()> = Signal::new();

/// Receives bytes on a link.
pub async fn receive<R: Read>(app: &SharedApp, link: LinkId, rx: R) -> ! {
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
        if !matches!(is_pending, Ok(true)) {
            wake_transmitters();
        }
    }
}

/// Transmits pending frames on a link.
pub async fn transmit<W: Write>(app: &SharedApp, link: LinkId, tx: W) -> ! {
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
        if matches!(has_bytes, Ok(true)) {
            transmitter.send().await;
        } else {
            select(WAKE[usize::from(link.0)].wait(), Timer::at(deadline.into())).await;
        }
    }
}
