//! The progress of a list of all parameters on a link (P-10, P-11). Pending values need no memory: the table has a mark for each
//! parameter and link (P-12).

use core::num::Saturating;

use crate::message::Address;
use crate::service::rate_limit::{RateLimit, cost};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer, Sender, Trust};

/// The cost of a value: the size of a PARAM_VALUE in MAVLink 2, for a share of 40 % of the link (P-11).
const COST: u32 = cost(37, 40);

/// A list value that has waited this long is sent before streams and forwarded frames; otherwise a saturated link would
/// starve the list (D-4, P-11). Less than a [`RateLimit`] makes up, so that waiting does not reduce the list's share.
const MAX_LATENESS: Duration = Duration::from_millis(20);

/// The state of a link: the progress of its list. Initially all zero bits.
#[derive(Clone, Debug)]
pub struct ParamList {
    /// When the next value is due.
    limit: RateLimit,
    /// The index of that value.
    next: Saturating<u16>,
    is_active: bool,
    /// The client that has requested it, and whether no other has (P-20).
    client: Sender,
    is_of_one: bool,
    /// Where the search for the next pending single value starts, so that each one has its turn (round robin).
    pub(super) search_from: Saturating<u16>,
}

impl ParamList {
    pub(crate) const NEW: Self = Self {
        limit: RateLimit::NEW,
        next: Saturating(0),
        is_active: false,
        client: Sender { peer: Peer { address: Address::new(0, 0), link: LinkId(0) }, trust: Trust::None },
        is_of_one: false,
        search_from: Saturating(0),
    };

    /// Starts or restarts the list, for a client or for all (P-10).
    pub(super) fn begin(&mut self, now: Instant, client: Option<Sender>) {
        self.next = Saturating(0);
        self.limit.begin(now);
        let was_active = core::mem::replace(&mut self.is_active, true);
        self.is_of_one = client.is_some_and(|client| !was_active || self.is_only_for(client));
        self.client = client.unwrap_or(self.client);
    }

    /// Whether this client alone waits for the list (P-20).
    pub(super) fn is_only_for(&self, client: Sender) -> bool {
        self.is_of_one && self.client.is_repeated_by(client)
    }

    /// Ends the list.
    pub(crate) fn end(&mut self) {
        self.is_active = false;
    }

    /// Whether a list is active.
    pub(super) const fn is_active(&self) -> bool {
        self.is_active
    }

    /// Returns when a list could begin: after the pause that its predecessor has left.
    pub(super) const fn begins_at(&self) -> Instant {
        self.limit.due()
    }

    /// Returns the index of the list's next value.
    pub(super) const fn next(&self) -> u16 {
        self.next.0
    }

    /// Returns when the list falls behind its share unless the next value is sent; [`Instant::NEVER`] without a list.
    pub(crate) fn late_at(&self) -> Instant {
        if self.is_active { self.limit.due() + MAX_LATENESS } else { Instant::NEVER }
    }

    /// Returns when the list's next value is due; [`Instant::NEVER`] without a list.
    pub(crate) const fn due(&self) -> Instant {
        if self.is_active { self.limit.due() } else { Instant::NEVER }
    }

    /// Records that a value of the list was sent. `count` is the length of the list, `bytes_per_second` the rate of the link; 0
    /// means no limit.
    pub(super) fn advance(&mut self, now: Instant, count: u16, bytes_per_second: u32) {
        self.next += 1;
        self.is_active = self.next.0 < count;
        self.limit.spend(now, COST, bytes_per_second);
    }
}
