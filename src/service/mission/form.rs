//! Which message asks for an item: MISSION_REQUEST_INT, or the old MISSION_REQUEST (M-37, M-47).
//!
//! Some clients hear only the old message, some refuse it with UNSUPPORTED. So MISSION_REQUEST_INT comes first. While no item
//! has come, the forms alternate from the third repetition on, or from the first UNSUPPORTED on. The first item fixes the
//! form for the rest of the upload.

/// Repetitions before the forms alternate.
const PATIENCE: u8 = 3;

/// The form of an upload's requests.
#[derive(Clone, Copy, Debug)]
pub(super) struct Form {
    /// The next request is a MISSION_REQUEST.
    is_old: bool,
    /// The last request was one.
    was_old: bool,
    /// One was sent in this upload.
    has_asked_old: bool,
}

impl Form {
    pub(super) const NEW: Self = Self { is_old: false, was_old: false, has_asked_old: false };

    /// A request is sent; whether it is a MISSION_REQUEST.
    pub(super) fn take(&mut self) -> bool {
        self.was_old = self.is_old;
        self.has_asked_old |= self.is_old;
        self.is_old
    }

    /// No item has come yet, and the request is to be repeated for the time `retries`.
    pub(super) fn repeat(&mut self, retries: u8) {
        if retries >= PATIENCE || self.has_asked_old {
            self.is_old = !self.was_old;
        }
    }

    /// The first item came: as MISSION_ITEM, or as MISSION_ITEM_INT.
    pub(super) fn fix(&mut self, is_float: bool) {
        self.is_old = self.has_asked_old && is_float;
    }

    /// Whether UNSUPPORTED is about the form of a request, and not the end of the upload.
    pub(super) fn explains_unsupported(&self, has_items: bool) -> bool {
        self.has_asked_old || !has_items
    }

    /// The client answered UNSUPPORTED: it is to be asked in the other form. Whether at once: it may say so of each request
    /// that was on its way, and a client that knows neither form must not be asked as fast as it answers.
    pub(super) fn refused(&mut self) -> bool {
        let is_first = !self.has_asked_old;
        self.is_old = is_first;
        is_first || self.was_old
    }
}
