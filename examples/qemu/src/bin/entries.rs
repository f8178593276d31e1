//! The loop of `loop.rs` with each call of the stack in a separate function, so that `cargo measure stack` can measure them one by
//! one. For measurements only.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use mavstack::storage::{Job, Page};
use mavstack::{Instant, LinkId};
use mavstack_demo::App;
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::memory::{self, FlashStore};
use mavstack_qemu::polled::{Polled, Sleep};

#[inline(never)]
fn restore(app: &mut App, store: &mut FlashStore) {
    store.restore(app, board::now());
}

#[inline(never)]
fn fly(app: &mut App, now: Instant) {
    app.fly(now);
}

#[inline(never)]
fn poll(app: &mut App, now: Instant) {
    app.poll(now);
}

#[inline(never)]
fn poll_link(app: &mut App, now: Instant, link: LinkId, uart: &mut Polled) {
    let _ = app.serve(now, link, uart);
}

#[inline(never)]
fn receive(app: &mut App, now: Instant, link: LinkId, bytes: &[u8]) -> usize {
    let (stack, vehicle) = app.parts();
    stack.receive(now, link, bytes, vehicle)
}

#[inline(never)]
fn transmit(app: &mut App, now: Instant, link: LinkId) -> usize {
    let (stack, vehicle) = app.parts();
    stack.transmit(now, link, vehicle).len()
}

#[inline(never)]
fn persist(app: &mut App, store: &mut FlashStore, now: Instant) -> bool {
    store.persist(app, now)
}

#[inline(never)]
fn storage_job(app: &mut App, now: Instant, page: &mut Page) -> Option<Job> {
    let (stack, vehicle) = app.parts();
    stack.storage_job(now, page, vehicle)
}

#[inline(never)]
fn storage_done(app: &mut App, now: Instant, is_done: bool, page: &mut Page) {
    let (stack, vehicle) = app.parts();
    stack.storage_done(now, is_done, page, vehicle);
}

#[entry]
fn main() -> ! {
    let app = memory::start();
    let (Some(core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else { Board::reset() };
    let mut sleep = Sleep::new(core.SYST);
    let mut uarts = board.uarts.map(Polled::new);
    let mut store = FlashStore::new(board.flash);
    let mut page = Page::new();
    restore(app, &mut store);
    loop {
        let now = board::now();
        fly(app, now);
        poll(app, now);
        for (link, uart) in (0..).map(LinkId).zip(&mut uarts) {
            poll_link(app, now, link, uart);
            let bytes = core::hint::black_box(&[0xFD_u8; 8][..]);
            let taken = receive(app, now, link, bytes);
            core::hint::black_box(taken);
            core::hint::black_box(transmit(app, now, link));
        }
        persist(app, &mut store, now);
        let is_done = core::hint::black_box(storage_job(app, now, &mut page)).is_some();
        storage_done(app, now, is_done, &mut page);
        sleep.until_event(&mut uarts);
    }
}
