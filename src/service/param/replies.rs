//! What is owed to those who talk about parameters, beside values: a list under way on each link, and a few refusals.
//!
//! Values that are owed need no memory here: the table has a mark for each parameter and link (P-12).

use crate::dialect::{MavParamError, ParamError};
use crate::link::{LinkId, LinkMask, Outbox, Peer};
use crate::message::Text;
use crate::time::{Duration, Instant};

/// Refusals that all links together can owe.
const SLOTS: usize = 4;

/// Bytes of a PARAM_VALUE in MAVLink 2, times 10^6 for microseconds, times 5/2 for a share of 40 % of the link (P-11).
const PACE: u32 = 92_500_000;

/// What a list has not used of its share is lost after this time: so much may a poll be late.
const CATCH_UP: Duration = Duration::from_millis(100);

/// A list value that has waited this long is sent before streams and forwarded frames; otherwise a saturated link would
/// starve the list (D-4, P-11). Less than [`CATCH_UP`], so that waiting does not reduce the list's share.
const PATIENCE: Duration = Duration::from_millis(20);

/// A request that is refused.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refusal {
    pub(super) to: Peer,
    pub(super) error: MavParamError,
    /// As it was asked for; -1 when it was named (P-30).
    pub(super) index: i16,
    pub(super) name: [u8; 16],
}

/// The refusals that are owed, of all links.
///
/// Who has none always gets room, if need be that of another link's: or a line that stalls would hold up the others. To who
/// waits for that one it is a lost frame; nothing was carried out, and of what was to be set he has the value.
#[derive(Clone, Debug)]
pub(super) struct Refusals([Option<Refusal>; SLOTS]);

impl Refusals {
    pub(super) const fn new() -> Self {
        Self([None; SLOTS])
    }

    /// The links that refusals are owed on.
    pub(super) fn links(&self) -> LinkMask {
        self.0.iter().flatten().fold(LinkMask::NONE, |links, refusal| links.with(LinkMask::of(refusal.to.link)))
    }

    /// Whether one more would have no room on a link.
    pub(super) fn is_full(&self, link: LinkId) -> bool {
        self.0.iter().all(Option::is_some) && self.links().contains(LinkMask::of(link))
    }

    /// Owes a refusal. False when it has no room.
    pub(super) fn push(&mut self, refusal: Refusal) -> bool {
        if self.is_full(refusal.to.link) {
            return false;
        }
        // Free, or the last one: then it is another link's.
        let place = self.0.iter().position(Option::is_none).unwrap_or(SLOTS.wrapping_sub(1));
        if let Some(slot) = self.0.get_mut(place) {
            *slot = Some(refusal);
        }
        true
    }

    fn slot(&mut self, link: LinkId) -> Option<&mut Option<Refusal>> {
        self.0.iter_mut().find(|slot| slot.is_some_and(|refusal| refusal.to.link == link))
    }

    /// Sends one of a link's. False when it owes none.
    pub(super) fn next(&mut self, tx: &mut Outbox) -> bool {
        let Some(refusal) = self.slot(tx.link()).and_then(Option::take) else { return false };
        tx.send(&ParamError {
            param_index: refusal.index,
            target_system: refusal.to.address.system.0,
            target_component: refusal.to.address.component.0,
            param_id: Text::from_wire(refusal.name),
            error: refusal.error,
        })
    }

    /// Forgets those of the links.
    pub(super) fn forget(&mut self, links: LinkMask) {
        for slot in &mut self.0 {
            if slot.is_some_and(|refusal| links.contains(LinkMask::of(refusal.to.link))) {
                *slot = None;
            }
        }
    }

    /// To whom each is owed, and the name in it.
    #[cfg(test)]
    pub(super) fn iter(&self) -> impl Iterator<Item = &Refusal> {
        self.0.iter().flatten()
    }
}

/// What a link keeps of its own: how far its list is. Zero bits at first.
#[derive(Clone, Debug)]
pub(crate) struct List {
    /// When the next value is due.
    due: Instant,
    /// Which one it is.
    next: u16,
    /// Where to look for the next value that is owed beside the list, so that each has its turn.
    pub(super) from: u16,
    is_going_on: bool,
}

impl List {
    pub(crate) const fn new() -> Self {
        Self { due: Instant::ZERO, next: 0, from: 0, is_going_on: false }
    }

    /// Begins the list, or begins it again (P-10). True when none was under way.
    pub(super) fn begin(&mut self, now: Instant) -> bool {
        self.next = 0;
        self.due = self.due.max(now);
        !core::mem::replace(&mut self.is_going_on, true)
    }

    /// Ends the list.
    pub(crate) fn end(&mut self) {
        self.is_going_on = false;
    }

    /// Whether a list is under way.
    #[cfg(test)]
    pub(super) const fn is_going_on(&self) -> bool {
        self.is_going_on
    }

    /// The next value of the list, when it is due.
    pub(super) fn listed(&self, now: Instant) -> Option<u16> {
        (self.is_going_on && now >= self.due).then_some(self.next)
    }

    /// Whether the list falls behind its share.
    pub(crate) fn is_late(&self, now: Instant) -> bool {
        self.is_going_on && now >= self.due.after(PATIENCE)
    }

    /// When the next value of the list is due; never, when there is no list.
    pub(crate) const fn due(&self) -> Instant {
        if self.is_going_on { self.due } else { Instant::NEVER }
    }

    /// A value of the list was sent, of `count`, on a link that does so many bytes/s; 0 for one without a limit.
    pub(super) fn go_on(&mut self, now: Instant, count: u16, bytes_per_second: u32) {
        self.next = self.next.saturating_add(1);
        self.is_going_on = self.next < count;
        // A line without a limit is never behind.
        let Some(pause) = PACE.checked_div(bytes_per_second) else {
            self.due = now;
            return;
        };
        let earliest = Instant::from_micros(now.as_micros().saturating_sub(CATCH_UP.as_micros()));
        self.due = self.due.max(earliest).after(Duration::from_micros(u64::from(pause)));
    }
}
