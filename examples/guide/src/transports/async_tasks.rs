//! The two tasks of a link, in an async executor.

use core::cell::{RefCell, RefMut};

use mavstack::frame::MAX_FRAME_LEN;
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack::{Instant, LinkId, StackOf};

use crate::vehicle::{Boat, Mavlink};

const TELEM: LinkId = StackOf::<Mavlink>::link(0);
static WAKE: Signal = Signal;

async fn receive(shared: &Shared, uart: UartRx) {
    let mut buffer = [0; 64];
    let mut receiver = AsyncReceiver::new(uart, &mut buffer);
    loop {
        receiver.wait().await;
        let (stack, vehicle) = &mut *shared.lock().await;
        // Errors are counted in `stack.link_counters(TELEM)`.
        let _ = stack.receive_from(now(), TELEM, &mut receiver, vehicle);
        WAKE.signal(()); // answers are pending
    }
}

async fn transmit(shared: &Shared, uart: UartTx) {
    let mut frame = [0; MAX_FRAME_LEN];
    let mut transmitter = AsyncTransmitter::new(uart, &mut frame);
    loop {
        let (has_bytes, deadline) = {
            let (stack, vehicle) = &mut *shared.lock().await;
            let now = now();
            stack.poll(now, vehicle);
            let has_bytes = stack.transmit_to(now, TELEM, &mut transmitter, vehicle);
            (has_bytes, stack.link_deadline(now, TELEM))
        };
        if has_bytes == Ok(true) {
            transmitter.send().await;
        } else {
            select(WAKE.wait(), Timer::at(deadline)).await;
        }
    }
}

// Stand-ins for the mutex, the signal and the timer of an executor.

type UartRx = &'static [u8];
type UartTx = &'static mut [u8];

struct Shared(RefCell<(StackOf<Mavlink>, Boat)>);

impl Shared {
    async fn lock(&self) -> RefMut<'_, (StackOf<Mavlink>, Boat)> {
        self.0.borrow_mut()
    }
}

struct Signal;

impl Signal {
    fn signal(&self, (): ()) {}
    async fn wait(&self) {}
}

struct Timer;

impl Timer {
    async fn at(_: Instant) {}
}

async fn select(_: impl Future<Output = ()>, _: impl Future<Output = ()>) {}

fn now() -> Instant {
    Instant::ZERO
}
