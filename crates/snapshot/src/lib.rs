#![doc = include_str!("../README.md")]
#![no_std]
#![allow(unsafe_code, reason = "access to the slots; each use states why it is exclusive")]

#[cfg(all(test, loom))]
mod every_interleaving;
mod slot;

#[cfg(all(test, loom))]
use {every_interleaving::fence, loom::sync::atomic::AtomicBool};

#[cfg(not(all(test, loom)))]
use core::sync::atomic::{AtomicBool, fence};

use core::sync::atomic::Ordering::{Acquire, Relaxed, Release, SeqCst};

use slot::Slot;

/// The newest value, shared by one writer and one reader.
///
/// It takes four times the size of `T`, and four bytes.
pub struct Snapshot<T> {
    /// Two pairs of slots.
    slots: [[Slot<T>; 2]; 2],
    /// For each pair, the slot that was written last. Stored by the writer.
    newest: [AtomicBool; 2],
    /// The pair that was written last. Stored by the writer.
    latest: AtomicBool,
    /// The pair from which the reader reads, or has read last. Stored by the reader.
    reading: AtomicBool,
}

// SAFETY: a shared `Snapshot` is reachable only through one `Writer` and one `Reader`, because `split` borrows it mutably. These never
// access the same slot at the same time (see `write`). Values are copied from one thread to the other, which `Send` permits.
unsafe impl<T: Send> Sync for Snapshot<T> {}

/// Defines functions as `const`, but not in loom, whose types have no `const` constructors.
macro_rules! const_but_in_loom {
    ($($(#[$doc:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),*) -> Self $body:block)*) => {$(
        #[cfg(not(all(test, loom)))]
        $(#[$doc])*
        $vis const fn $name($($arg: $type),*) -> Self $body

        #[cfg(all(test, loom))]
        $(#[$doc])*
        $vis fn $name($($arg: $type),*) -> Self $body
    )*};
}
use const_but_in_loom;

impl<T: Copy> Snapshot<T> {
    const_but_in_loom! {
        /// Returns a snapshot of `initial`, which is read until something is written.
        ///
        /// If `initial` is all zero bits, a `static` snapshot is placed in `.bss`: it takes no flash.
        pub fn new(initial: T) -> Self {
            Self {
                slots: [[Slot::new(initial), Slot::new(initial)], [Slot::new(initial), Slot::new(initial)]],
                newest: [AtomicBool::new(false), AtomicBool::new(false)],
                latest: AtomicBool::new(false),
                reading: AtomicBool::new(false),
            }
        }
    }

    /// Returns the two ends. They exclude another pair of ends while one of them is in use.
    ///
    /// The ends of a `&'static mut Snapshot` are `'static`, as interrupts and tasks need them.
    ///
    /// ```compile_fail,E0499
    /// # use mavstack_snapshot::Snapshot;
    /// let mut state = Snapshot::new(0);
    /// let (mut writer, _) = state.split();
    /// let (mut second, _) = state.split();
    /// writer.write(1);
    /// second.write(2);
    /// ```
    pub fn split(&mut self) -> (Writer<'_, T>, Reader<'_, T>) {
        (Writer { shared: self }, Reader { shared: self })
    }
}

/// The end that writes. It can be sent to another thread, but not cloned.
///
/// ```compile_fail,E0599
/// # use mavstack_snapshot::Snapshot;
/// let mut state = Snapshot::new(0);
/// let (writer, _) = state.split();
/// let second = writer.clone();
/// ```
pub struct Writer<'a, T> {
    shared: &'a Snapshot<T>,
}

impl<T: Copy> Writer<'_, T> {
    /// Makes `value` the newest value. Wait-free: copies the value once, and never waits for the reader.
    pub fn write(&mut self, value: T) {
        // With the fence in `read`: either this load sees the pair that the reader announced, or the reader sees the slot that the
        // previous write completed.
        fence(SeqCst);
        let pair = !self.shared.reading.load(Acquire);
        let newest = pick(&self.shared.newest, pair);
        let free = !newest.load(Relaxed);
        // SAFETY: only this end writes, and `&mut self` excludes a second write. The reader does not read this slot now: it reads from
        // the other pair, or it has announced this pair since the load above and reads `newest`, which is the other slot until the
        // store below. If it has read this slot before, `Acquire` orders that read before this write.
        unsafe { pick(pick(&self.shared.slots, pair), free).write(value) };
        newest.store(free, Release);
        self.shared.latest.store(pair, Release);
    }
}

/// The end that reads. It can be sent to another thread, but not cloned.
///
/// ```compile_fail,E0599
/// # use mavstack_snapshot::Snapshot;
/// let mut state = Snapshot::new(0);
/// let (_, reader) = state.split();
/// let second = reader.clone();
/// ```
pub struct Reader<'a, T> {
    shared: &'a Snapshot<T>,
}

impl<T: Copy> Reader<'_, T> {
    /// Returns the newest value. Wait-free: copies the value once, and never waits for the writer.
    ///
    /// It is the value of the last complete [`write`](Writer::write), or of one in progress. It is never older than a value
    /// that was read before.
    pub fn read(&mut self) -> T {
        // The fence makes this load an acquire: `newest` is at least as new.
        let pair = self.shared.latest.load(Relaxed);
        // `Release` orders the previous read before this store.
        self.shared.reading.store(pair, Release);
        // See `write`.
        fence(SeqCst);
        let newest = pick(&self.shared.newest, pair).load(Acquire);
        // SAFETY: the writer has completed this slot, and `Acquire` orders that before this read. It does not write the slot again
        // before this read has ended: it would have to see another announcement first (see `write`), and `&mut self`
        // excludes one.
        unsafe { pick(pick(&self.shared.slots, pair), newest).read() }
    }
}

/// Returns one of two. Cannot panic, unlike an index.
fn pick<T>([first, second]: &[T; 2], is_second: bool) -> &T {
    if is_second { second } else { first }
}
