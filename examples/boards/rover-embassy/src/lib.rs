//! The futures of a rover on a board with Embassy: the driving loop, and a receiver and a transmitter for each link. All share the
//! stack in one task. A `RefCell` suffices, because none of them holds a borrow across an `await`.
//!
//! The board provides the transports, and decides what to do when one fails.
#![no_std]
#![forbid(unsafe_code)]

use core::cell::RefCell;

use embassy_futures::join::join;
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Timer, with_timeout};
use embedded_io_async::{Read, Write};
use embedded_storage::nor_flash::NorFlash;
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack::network::LinkError;
use mavstack::storage::Store;
use mavstack::{Duration, Instant, LinkId, StackOf};
use mavstack_rover::{LINKS, Mavlink, Rover};

/// Period of the driving loop. Received bytes wait no longer than this, unless a pass erases flash or writes a page.
pub const PERIOD: Duration = Duration::from_millis(4);

/// Several times the time that a line needs for a buffer.
const TIMEOUT: Duration = Duration::from_millis(100);

/// The time since boot, as the stack needs it.
pub fn now() -> Instant {
    embassy_time::Instant::now().into()
}

/// The state that the futures share.
pub struct Shared {
    vehicle: RefCell<(&'static mut StackOf<Mavlink>, Rover)>,
    /// For each link, signals that there may be something to send.
    wakes: [Signal<NoopRawMutex, ()>; LINKS],
}

impl Shared {
    /// Returns the shared state. `stack` must be begun and restored.
    pub fn new(stack: &'static mut StackOf<Mavlink>, rover: Rover) -> Self {
        Self { vehicle: RefCell::new((stack, rover)), wakes: [const { Signal::new() }; LINKS] }
    }

    fn wake(&self) {
        self.wakes.iter().for_each(|wake| wake.signal(()));
    }

    /// Runs the driving loop, which also stores changes.
    pub async fn drive<F: NorFlash>(&self, mut store: Store<F>) -> ! {
        let mut next = now();
        loop {
            {
                let (stack, rover) = &mut *self.vehicle.borrow_mut();
                rover.drive(now(), stack);
                stack.persist(now(), &mut store, rover);
            }
            // The rover's state may have changed.
            self.wake();
            // Passes that an erase has prevented are skipped. A `Ticker` would run them at once, and the other futures would wait: its
            // `next` does not yield when it is late. A `Timer` always yields.
            next = (next + PERIOD).max(now());
            Timer::at(next.into()).await;
        }
    }

    /// Waits for bytes, and handles them. Call it in a loop.
    ///
    /// # Errors
    ///
    /// Returns an error if the transport failed. It is counted in `stack.link_counters(link)`.
    pub async fn receive<R: Read>(
        &self,
        link: LinkId,
        receiver: &mut AsyncReceiver<'_, R>,
    ) -> Result<(), LinkError<R::Error>> {
        receiver.wait().await;
        let result = {
            let (stack, rover) = &mut *self.vehicle.borrow_mut();
            stack.receive_from(now(), link, receiver, rover)
        };
        // Answers are pending, perhaps on both links.
        self.wake();
        result.map(|_| ())
    }

    /// Sends pending bytes, or waits until there are some. Call it in a loop.
    ///
    /// # Errors
    ///
    /// Returns an error if the transport failed. It is counted in `stack.link_counters(link)`.
    pub async fn transmit<W: Write>(
        &self,
        link: LinkId,
        transmitter: &mut AsyncTransmitter<'_, W>,
    ) -> Result<(), LinkError<W::Error>> {
        let (has_bytes, deadline) = {
            let (stack, rover) = &mut *self.vehicle.borrow_mut();
            let now = now();
            stack.poll(now, rover);
            let has_bytes = stack.transmit_to(now, link, transmitter, rover);
            (has_bytes, stack.link_deadline(now, link))
        };
        if has_bytes? {
            // The HAL may miss a wake-up, and a host may stop reading. Nothing is lost: the transmitter continues where it stopped.
            let _ = with_timeout(TIMEOUT.into(), transmitter.send()).await;
        } else if let Some(wake) = self.wakes.get(usize::from(link.0)) {
            select(wake.wait(), Timer::at(deadline.into())).await;
        }
        Ok(())
    }

    /// Runs both ends of a UART, which continue after an error.
    pub async fn uart<const N: usize, R: Read, W: Write>(&self, link: LinkId, (rx, tx): (R, W)) -> ! {
        let (mut received, mut to_send) = ([0; 32], [0; N]);
        let mut receiver = AsyncReceiver::new(rx, &mut received);
        let mut transmitter = AsyncTransmitter::new(tx, &mut to_send);
        let receive = async {
            loop {
                let _ = self.receive(link, &mut receiver).await;
            }
        };
        let transmit = async {
            loop {
                let _ = self.transmit(link, &mut transmitter).await;
            }
        };
        join(receive, transmit).await.0
    }

    /// Runs both ends of an open transport until one of them fails, as when it is closed.
    pub async fn until_closed<const N: usize, R: Read, W: Write>(&self, link: LinkId, (rx, tx): (R, W)) {
        self.vehicle.borrow_mut().0.restart_link(link);
        let (mut received, mut to_send) = ([0; 128], [0; N]);
        let mut receiver = AsyncReceiver::new(rx, &mut received);
        let mut transmitter = AsyncTransmitter::new(tx, &mut to_send);
        let receive = async { while self.receive(link, &mut receiver).await.is_ok() {} };
        let transmit = async { while self.transmit(link, &mut transmitter).await.is_ok() {} };
        select(receive, transmit).await;
    }
}
