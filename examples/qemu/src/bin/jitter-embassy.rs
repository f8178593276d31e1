//! Measures how late flight starts in Embassy while storage erases. It has the tasks, priorities and locks of the firmware
//! `embassy`. For tests only.
#![no_std]
#![no_main]

#[path = "embassy/executors.rs"]
mod executors;
#[path = "embassy/shared.rs"]
mod shared;
#[path = "embassy/time.rs"]
mod time;
#[allow(dead_code, reason = "the other kinds of traffic are for the firmware `work`")]
#[path = "work/traffic.rs"]
mod traffic;

use core::convert::Infallible;

use cortex_m_rt::entry;
use embassy_futures::yield_now;
use embassy_sync::mutex::Mutex;
use embassy_time::{Duration, Instant, Ticker, Timer};
use embedded_io_async::{ErrorType, Read, Write};
use mavstack::LinkId;
use mavstack_demo::LINKS;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::jitter::{BYTES, Delays, PERIOD, SlowStore, Way};
use mavstack_qemu::memory;
use shared::{DONE, JOB, SharedApp, wake_transmitters};
use static_cell::StaticCell;
use traffic::{Kind, Sender};

type SharedStore = shared::SharedStore<SlowStore>;

#[entry]
fn main() -> ! {
    static APP: StaticCell<SharedApp> = StaticCell::new();
    static STORE: StaticCell<SharedStore> = StaticCell::new();

    let way = Way::from_command_line();
    let app = memory::start();
    let (Some(mut core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else {
        unreachable!("the firmware starts once")
    };
    let store = SlowStore::restore(board.flash, app, way);
    let app = &*APP.init(Mutex::new(app));
    let store = &*STORE.init(Mutex::new(store));
    time::start(board.alarm);

    let [flights, comms, storage] = executors::start(&mut core.NVIC);
    // No spawn fails, because each pool has enough slots.
    flights.spawn(flight(app, Delays::new("embassy", way)).unwrap());
    let kinds = [Kind::Commands, Kind::Upload, Kind::Nothing];
    for ((link, kind), bytes) in (0..).map(LinkId).zip(kinds).zip(BYTES) {
        comms.spawn(receive(app, link, Sender::new(kind), bytes).unwrap());
        comms.spawn(transmit(app, link, bytes).unwrap());
    }
    comms.spawn(exchange(app, store, way).unwrap());
    storage.spawn(run(store).unwrap());
    // Does not sleep: the emulator's timers are late after it has skipped idle time.
    loop {
        cortex_m::asm::nop();
    }
}

#[embassy_executor::task]
async fn flight(app: &'static SharedApp, mut delays: Delays) {
    let mut due = Instant::now() + Duration::from_millis(PERIOD.into());
    loop {
        Timer::at(due).await;
        let has_output = {
            let mut app = app.lock().await;
            delays.started(due.into(), &app);
            app.fly(board::now())
        };
        if has_output {
            wake_transmitters();
        }
        due += Duration::from_millis(PERIOD.into());
    }
}

/// The receiving half of a UART: each millisecond brings as many bytes as the line carries.
struct Source {
    sender: Sender,
    bytes: usize,
    left: usize,
    ticker: Ticker,
}

impl ErrorType for Source {
    type Error = Infallible;
}

impl Read for Source {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        while self.left == 0 {
            self.ticker.next().await;
            self.left = self.bytes;
        }
        let len = self.left.min(buffer.len());
        buffer[..len].fill_with(|| self.sender.next().unwrap_or(0));
        self.left -= len;
        Ok(len)
    }
}

/// The transmitting half of a UART: a write takes as long as the line does.
struct Sink {
    bytes: usize,
}

impl ErrorType for Sink {
    type Error = Infallible;
}

impl Write for Sink {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Timer::after(Duration::from_micros(1_000 * bytes.len() as u64 / self.bytes.max(1) as u64)).await;
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

#[embassy_executor::task(pool_size = LINKS)]
async fn receive(app: &'static SharedApp, link: LinkId, sender: Sender, bytes: usize) {
    let source = Source { sender, bytes, left: 0, ticker: Ticker::every(Duration::from_millis(1)) };
    shared::receive(app, link, source).await;
}

#[embassy_executor::task(pool_size = LINKS)]
async fn transmit(app: &'static SharedApp, link: LinkId, bytes: usize) {
    shared::transmit(app, link, Sink { bytes }).await;
}

#[embassy_executor::task]
async fn exchange(app: &'static SharedApp, store: &'static SharedStore, way: Way) {
    loop {
        let is_busy = {
            let mut store = store.lock().await;
            let mut app = app.lock().await;
            store.step(&mut app)
        };
        match (is_busy, way) {
            (false, _) => Timer::after(Duration::from_millis(10)).await,
            (true, Way::Persist) => yield_now().await,
            (true, Way::Jobs) => {
                JOB.signal(());
                DONE.wait().await;
            }
        }
    }
}

#[embassy_executor::task]
async fn run(store: &'static SharedStore) {
    loop {
        JOB.wait().await;
        store.lock().await.run();
        DONE.signal(());
    }
}
