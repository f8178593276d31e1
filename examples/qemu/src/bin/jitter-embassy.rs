//! Measures how late flight starts in Embassy while storage erases. It has the tasks, priorities and locks of the firmware
//! `embassy`. For tests only.
#![no_std]
#![no_main]

#[path = "embassy/executors.rs"]
mod executors;
#[path = "embassy/time.rs"]
mod time;
#[allow(dead_code, reason = "the other kinds of traffic are for the firmware `work`")]
#[path = "work/traffic.rs"]
mod traffic;

use cortex_m_rt::entry;
use embassy_futures::select::select;
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, Ticker, Timer};
use mavstack::LinkId;
use mavstack::frame::MAX_FRAME_LEN;
use mavstack_demo::{App, LINKS};
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::jitter::{BYTES, Delays, PERIOD, SlowStore, Way};
use mavstack_qemu::memory;
use static_cell::StaticCell;
use traffic::{Kind, Sender};

/// The bytes for one call of the stack: not much more than one frame, so that flight waits for one frame.
const PIECE: usize = 16;

type SharedApp = Mutex<CriticalSectionRawMutex, &'static mut App>;
type SharedStore = Mutex<CriticalSectionRawMutex, SlowStore>;

static WAKE: [Signal<CriticalSectionRawMutex, ()>; LINKS] = [const { Signal::new() }; LINKS];
static JOB: Signal<CriticalSectionRawMutex, ()> = Signal::new();
static DONE: Signal<CriticalSectionRawMutex, ()> = Signal::new();

fn wake_transmitters(except: Option<LinkId>) {
    for (link, wake) in (0..).map(LinkId).zip(&WAKE) {
        if Some(link) != except {
            wake.signal(());
        }
    }
}

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
            delays.started(mavstack::Instant::from_micros(due.as_micros()), &app);
            app.fly(board::now())
        };
        if has_output {
            wake_transmitters(None);
        }
        due += Duration::from_millis(PERIOD.into());
    }
}

#[embassy_executor::task(pool_size = LINKS)]
async fn receive(app: &'static SharedApp, link: LinkId, mut sender: Sender, bytes: usize) {
    let mut ticker = Ticker::every(Duration::from_millis(1));
    let mut buffer = [0; 64];
    loop {
        ticker.next().await;
        let mut left = bytes;
        while left > 0 {
            let len = left.min(buffer.len());
            buffer[..len].fill_with(|| sender.next().unwrap_or(0));
            left -= len;
            let mut rest = &buffer[..len];
            while !rest.is_empty() {
                let mut app = app.lock().await;
                let (stack, vehicle) = app.parts();
                let now = board::now();
                let taken = stack.receive(now, link, rest.get(..PIECE).unwrap_or(rest), vehicle);
                rest = rest.get(taken..).unwrap_or_default();
                if taken == 0 {
                    stack.receive(now, link, &[], vehicle);
                }
            }
            wake_transmitters(None);
        }
    }
}

#[embassy_executor::task(pool_size = LINKS)]
async fn transmit(app: &'static SharedApp, link: LinkId, bytes: usize) {
    let mut frame = [0; MAX_FRAME_LEN];
    loop {
        // One call for each lock, so that flight waits for one call at most.
        app.lock().await.poll(board::now());
        {
            let mut app = app.lock().await;
            let (stack, vehicle) = app.parts();
            stack.receive(board::now(), link, &[], vehicle);
        }
        let (len, now, deadline) = {
            let mut app = app.lock().await;
            let now = board::now();
            let (stack, vehicle) = app.parts();
            let pending = stack.transmit(now, link, vehicle);
            let len = pending.len().min(frame.len());
            frame[..len].copy_from_slice(&pending[..len]);
            (len, now, stack.next_deadline(now))
        };
        if len == 0 {
            if deadline <= now {
                wake_transmitters(Some(link));
                Timer::after(Duration::from_millis(1)).await;
                continue;
            }
            let next = Timer::at(Instant::from_micros(deadline.as_micros()));
            select(WAKE[usize::from(link.0)].wait(), next).await;
            continue;
        }
        // As long as the line takes.
        Timer::after(Duration::from_micros(1_000 * len as u64 / bytes.max(1) as u64)).await;
        app.lock().await.parts().0.transmitted(link, len);
    }
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
