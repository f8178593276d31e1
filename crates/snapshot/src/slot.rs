//! A cell that two threads access in turns. In loom it detects accesses at the same time.

use super::const_but_in_loom;

#[cfg(all(test, loom))]
use loom::cell::UnsafeCell;

#[cfg(not(all(test, loom)))]
use core::cell::UnsafeCell;

pub struct Slot<T>(UnsafeCell<T>);

impl<T: Copy> Slot<T> {
    const_but_in_loom! {
        pub fn new(value: T) -> Self {
            Self(UnsafeCell::new(value))
        }
    }

    /// # Safety
    ///
    /// Nothing may write the slot meanwhile. Earlier writes must happen before this call.
    pub unsafe fn read(&self) -> T {
        #[cfg(all(test, loom))]
        // SAFETY: guaranteed by the caller.
        return self.0.with(|value| unsafe { *value });
        #[cfg(not(all(test, loom)))]
        // SAFETY: guaranteed by the caller.
        return unsafe { *self.0.get() };
    }

    /// # Safety
    ///
    /// Nothing may read or write the slot meanwhile. Earlier reads and writes must happen before this call.
    pub unsafe fn write(&self, value: T) {
        #[cfg(all(test, loom))]
        // SAFETY: guaranteed by the caller.
        self.0.with_mut(|place| unsafe { *place = value });
        #[cfg(not(all(test, loom)))]
        // SAFETY: guaranteed by the caller.
        unsafe {
            *self.0.get() = value;
        }
    }
}
