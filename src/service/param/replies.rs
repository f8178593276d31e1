//! What one link owes to those who talk about parameters: a list under way, the hash, and a few refusals.
//!
//! Values that are owed need no memory here: the table has a mark for each parameter and link (P-12).

use heapless::Vec;

use crate::dialect::{MavParamError, ParamError};
use crate::frame::Address;
use crate::link::Outbox;
use crate::message::Text;
use crate::time::{Duration, Instant};

const SLOTS: usize = 4;

/// Bytes of a PARAM_VALUE in MAVLink 2, times 10^6 for microseconds, times 5/2 for a share of 40 % of the link (P-11).
const PACE: u32 = 92_500_000;

/// What a list has not used of its share is lost after this time: so much may a poll be late.
const CATCH_UP: Duration = Duration::from_millis(100);

/// A request that is refused.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refusal {
    pub(super) to: Address,
    pub(super) error: MavParamError,
    /// As it was asked for; -1 when it was named (P-30).
    pub(super) index: i16,
    pub(super) name: [u8; 16],
}

/// What a link owes about parameters.
#[derive(Clone, Debug)]
pub(crate) struct Replies {
    refusals: Vec<Refusal, SLOTS, u8>,
    /// Whether a list is under way, which value is next in it, and when.
    listing: bool,
    next: u16,
    due: Instant,
    /// Whether the hash is owed.
    pub(super) hash: bool,
    /// Where to look for the next value that is owed, so that each has its turn.
    pub(super) from: u16,
}

impl Replies {
    pub(crate) const fn new() -> Self {
        Self { refusals: Vec::new(), listing: false, next: 0, due: Instant::ZERO, hash: false, from: 0 }
    }

    /// Whether a refusal would have no room.
    pub(super) fn is_full(&self) -> bool {
        self.refusals.is_full()
    }

    /// Owes a refusal. False when it has no room.
    pub(super) fn refuse(&mut self, refusal: Refusal) -> bool {
        self.refusals.push(refusal).is_ok()
    }

    /// Sends a refusal, the newest one: to take out the oldest of four would cost more flash than their order is worth. False when
    /// none is owed.
    pub(super) fn next_refusal(&mut self, tx: &mut Outbox) -> bool {
        let Some(refusal) = self.refusals.pop() else { return false };
        tx.send(&ParamError {
            param_index: refusal.index,
            target_system: refusal.to.system.0,
            target_component: refusal.to.component.0,
            param_id: Text::from_wire(refusal.name),
            error: refusal.error,
        })
    }

    /// Whether a refusal or the hash is owed.
    pub(super) fn has_any(&self) -> bool {
        self.hash || !self.refusals.is_empty()
    }

    /// Begins the list, or begins it again (P-10). True when none was under way.
    pub(super) fn list(&mut self, now: Instant) -> bool {
        self.next = 0;
        self.due = self.due.max(now);
        !core::mem::replace(&mut self.listing, true)
    }

    /// Ends the list.
    pub(super) fn end_list(&mut self) {
        self.listing = false;
    }

    /// Whether a list is under way.
    #[cfg(test)]
    pub(super) const fn is_listing(&self) -> bool {
        self.listing
    }

    /// The next value of the list, when it is due. The hash goes before it.
    pub(super) fn listed(&self, now: Instant) -> Option<u16> {
        (self.listing && !self.hash && now >= self.due).then_some(self.next)
    }

    /// When the next value of the list is due.
    pub(super) const fn list_due(&self) -> Instant {
        if self.listing && !self.hash { self.due } else { Instant::NEVER }
    }

    /// A value of the list was sent, of `count`, on a link that does so many bytes/s; 0 for one without a limit.
    pub(super) fn list_on(&mut self, now: Instant, count: u16, bytes_per_second: u32) {
        self.next = self.next.saturating_add(1);
        self.listing = self.next < count;
        let pause = PACE.checked_div(bytes_per_second).unwrap_or(0);
        let earliest = Instant::from_micros(now.as_micros().saturating_sub(CATCH_UP.as_micros()));
        self.due = self.due.max(earliest).after(Duration::from_micros(u64::from(pause)));
    }

    /// The line was opened anew: nobody is there any more who asked.
    pub(crate) fn restart(&mut self) {
        self.refusals.clear();
        self.listing = false;
        self.hash = false;
    }
}
