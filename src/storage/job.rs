//! A job on its way from the stack to the driver, and its result on the way back.

use core::ops::Range;

use super::page::Page;

/// One operation on the storage. [`Stack::storage_job`](crate::Stack::storage_job) hands it out, and
/// [`Stack::storage_done`](crate::Stack::storage_done) takes its result.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Job {
    /// Read this range of the [`Page`](super::Page) from `offset` on, in bytes from the start of the storage. Its
    /// length is 32 or 256 bytes, and `offset` is a multiple of 32.
    Read {
        /// The address of the first byte.
        offset: u32,
        /// The part of the page to fill.
        range: Range<usize>,
    },
    /// Write this range of the [`Page`](super::Page) at `offset`: a multiple of the write unit, at a multiple of it.
    /// The place is erased, and is written once.
    Write {
        /// The address of the first byte.
        offset: u32,
        /// The part of the page to write.
        range: Range<usize>,
    },
    /// Erase `len` bytes at `offset`: one erase unit, or as many as 256 bytes are.
    Erase {
        /// The address of the first byte.
        offset: u32,
        /// The number of bytes.
        len: u32,
    },
}

#[derive(Clone, Debug)]
enum State {
    Empty,
    /// The job was not taken yet.
    Ready(Job),
    /// The job was taken, and has no result.
    Taken,
    /// The result.
    Finished(bool),
}

/// The place for one [`Job`], its page and its result. The stack and the code that runs the jobs exchange it.
///
/// [`Stack::exchange_job`](crate::Stack::exchange_job) puts a job in and reads the result of the one before. In
/// between, the job runs, and nothing of the stack is borrowed. [`Store`](super::Store) and `AsyncStore` have a slot. A
/// firmware that runs the jobs itself makes its own, and uses [`take`](Self::take) and [`finish`](Self::finish).
///
/// A job is taken once. If it is taken and never finished, because a future was dropped or a task was restarted, it
/// counts as failed.
pub struct JobSlot {
    page: Page,
    state: State,
}

impl Default for JobSlot {
    fn default() -> Self {
        Self::new()
    }
}

/// Omits the page, which may have the signing key (SEC-15).
impl core::fmt::Debug for JobSlot {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("JobSlot")
    }
}

impl JobSlot {
    /// Returns an empty slot.
    pub const fn new() -> Self {
        Self { page: Page::new(), state: State::Empty }
    }

    /// Takes the job, with the page that it reads into or writes from. Returns `None` if there is no job, or if it was
    /// taken before. Report the result with [`finish`](Self::finish).
    pub fn take(&mut self) -> Option<(Job, &mut Page)> {
        match core::mem::replace(&mut self.state, State::Taken) {
            State::Ready(job) => Some((job, &mut self.page)),
            other => {
                self.state = other;
                None
            }
        }
    }

    /// Stores the result of the job that was taken: whether the driver reported success. Does nothing if no job was
    /// taken.
    pub fn finish(&mut self, is_done: bool) {
        if matches!(self.state, State::Taken) {
            self.state = State::Finished(is_done);
        }
    }

    /// Returns the page of the job that was taken.
    pub const fn page_mut(&mut self) -> &mut Page {
        &mut self.page
    }

    /// Returns whether the job succeeded. One that has no result has not.
    pub(crate) const fn is_done(&self) -> bool {
        matches!(self.state, State::Finished(true))
    }

    /// Puts the next job in, if there is one. Returns whether there is.
    pub(crate) fn put(&mut self, job: Option<Job>) -> bool {
        let is_some = job.is_some();
        self.state = job.map_or(State::Empty, State::Ready);
        is_some
    }
}
