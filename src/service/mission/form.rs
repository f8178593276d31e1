//! Which message requests an item: MISSION_REQUEST_INT or the old MISSION_REQUEST (M-35, M-37, M-47).
//!
//! Some clients understand only the old message, others refuse it with UNSUPPORTED. So the first request is a
//! MISSION_REQUEST_INT. From the third repetition or the first UNSUPPORTED on, the forms alternate. The first item fixes the
//! form for the rest of the upload.

/// Repetitions before the forms alternate.
const REPETITIONS: u8 = 3;

/// The form of the requests of one upload.
#[derive(Clone, Copy, Debug)]
pub(super) struct Form {
    /// The next request is a MISSION_REQUEST.
    is_old: bool,
    /// The last request was a MISSION_REQUEST.
    was_old: bool,
    /// A MISSION_REQUEST was sent in this upload.
    has_asked_old: bool,
}

impl Form {
    pub(super) const NEW: Self = Self { is_old: false, was_old: false, has_asked_old: false };

    /// Records that a request is sent. Returns whether it is a MISSION_REQUEST.
    pub(super) fn take(&mut self) -> bool {
        self.was_old = self.is_old;
        self.has_asked_old |= self.is_old;
        self.is_old
    }

    /// Chooses the form of repetition number `retries`, before the first item.
    pub(super) fn repeat(&mut self, retries: u8) {
        if retries >= REPETITIONS || self.has_asked_old {
            self.is_old = !self.was_old;
        }
    }

    /// Fixes the form when the first item is received. `is_float`: the item is a MISSION_ITEM, not a MISSION_ITEM_INT.
    pub(super) fn fix(&mut self, is_float: bool) {
        self.is_old = self.has_asked_old && is_float;
    }

    /// Whether UNSUPPORTED refuses the form of a request, rather than cancelling the upload.
    pub(super) fn explains_unsupported(&self, has_items: bool) -> bool {
        self.has_asked_old || !has_items
    }

    /// Switches to the other form after the client answered UNSUPPORTED. Returns whether to send a request at once. Several
    /// requests in transit may each be refused, and a client that knows neither form must not set the pace of the requests.
    pub(super) fn refused(&mut self) -> bool {
        let is_first = !self.has_asked_old;
        self.is_old = is_first;
        is_first || self.was_old
    }
}
