//! Which message requests an item: MISSION_REQUEST_INT or the old MISSION_REQUEST (M-35, M-37, M-47).
//!
//! Some clients understand only the old message, others refuse it with UNSUPPORTED. So the first request is a
//! MISSION_REQUEST_INT. From the third repetition or the first UNSUPPORTED on, the forms alternate. An item fixes the form
//! of the last request. But if both forms had requested it, it may be a late answer to the other one: then the forms
//! alternate until an item answers a single form.

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
    /// The missing item was requested by a MISSION_REQUEST.
    old_for_item: bool,
    /// The missing item was requested by a MISSION_REQUEST_INT.
    int_for_item: bool,
    /// Repetitions keep the form.
    is_fixed: bool,
    /// The client has refused a MISSION_REQUEST_INT.
    refuses_int: bool,
    /// The client has refused a MISSION_REQUEST.
    refuses_old: bool,
}

impl Form {
    pub(super) const NEW: Self = Self {
        is_old: false,
        was_old: false,
        has_asked_old: false,
        old_for_item: false,
        int_for_item: false,
        is_fixed: false,
        refuses_int: false,
        refuses_old: false,
    };

    /// Records that a request is sent. Returns whether it is a MISSION_REQUEST.
    pub(super) fn take(&mut self) -> bool {
        self.was_old = self.is_old;
        self.has_asked_old |= self.is_old;
        self.old_for_item |= self.is_old;
        self.int_for_item |= !self.is_old;
        self.is_old
    }

    /// Chooses the form of repetition number `retries`.
    pub(super) fn repeat(&mut self, retries: u8) {
        if !self.is_fixed && (retries >= REPETITIONS || self.has_asked_old) {
            self.is_old = !self.was_old && !self.refuses_old;
        }
    }

    /// Chooses the form for the next item when the missing one is received: that of the last request.
    pub(super) fn answered(&mut self) {
        self.is_old = self.was_old && !self.refuses_old;
        self.is_fixed |= self.old_for_item != self.int_for_item || !self.has_asked_old;
        (self.old_for_item, self.int_for_item) = (false, false);
    }

    /// Whether UNSUPPORTED refuses the form of a request, rather than cancelling the upload.
    pub(super) fn explains_unsupported(&self, has_items: bool) -> bool {
        self.has_asked_old || !has_items
    }

    /// Chooses the other form after the client answered UNSUPPORTED. Returns whether to send a request at once. Several
    /// requests in transit may each be refused, and a client that knows neither form must not set the pace of the requests.
    pub(super) fn refused(&mut self) -> bool {
        self.refuses_int |= !self.has_asked_old;
        self.is_old = self.refuses_int;
        let is_first = !(self.refuses_old || self.refuses_int && self.has_asked_old);
        self.refuses_old |= !self.refuses_int;
        is_first && (self.refuses_int || self.was_old)
    }
}
