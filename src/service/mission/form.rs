//! Which message requests an item: MISSION_REQUEST_INT or the old MISSION_REQUEST (M-35, M-37, M-47).
//!
//! Some clients understand only the old message, others refuse it with UNSUPPORTED. So the first request is a
//! MISSION_REQUEST_INT. From the third repetition or the first UNSUPPORTED on, the forms alternate. An item fixes the form
//! of the last request. But if both forms had requested it, it may be a late answer to the other one: then the forms
//! alternate until an item answers a single form.

/// Repetitions before the forms alternate.
const REPETITIONS: u8 = 3;

/// A MISSION_REQUEST_INT has requested the missing item.
const INT: u8 = 1;
/// A MISSION_REQUEST has requested the missing item.
const OLD: u8 = 2;
/// A MISSION_REQUEST was sent in this upload.
const HAS_ASKED_OLD: u8 = 4;
/// Repetitions keep the form.
const FIXED: u8 = 8;
/// The client has refused a MISSION_REQUEST_INT.
const REFUSES_INT: u8 = 16;
/// The client has refused a MISSION_REQUEST.
const REFUSES_OLD: u8 = 32;

/// The form of the requests of one upload.
#[derive(Clone, Copy, Debug)]
pub(super) struct Form {
    /// The next request is a MISSION_REQUEST.
    is_old: bool,
    /// The last request was a MISSION_REQUEST.
    was_old: bool,
    /// What was asked and refused: the flags above.
    flags: u8,
}

impl Form {
    pub(super) const NEW: Self = Self { is_old: false, was_old: false, flags: 0 };

    const fn has(self, flag: u8) -> bool {
        self.flags & flag != 0
    }

    /// Records that a request is sent. Returns whether it is a MISSION_REQUEST.
    pub(super) fn take(&mut self) -> bool {
        self.was_old = self.is_old;
        self.flags |= if self.is_old { OLD | HAS_ASKED_OLD } else { INT };
        self.is_old
    }

    /// Chooses the form of repetition number `retries`.
    pub(super) fn repeat(&mut self, retries: u8) {
        if !self.has(FIXED) && (retries >= REPETITIONS || self.has(HAS_ASKED_OLD)) {
            self.is_old = !self.was_old && !self.has(REFUSES_OLD);
        }
    }

    /// Chooses the form for the next item when the missing one is received: that of the last request.
    pub(super) fn answered(&mut self) {
        self.is_old = self.was_old && !self.has(REFUSES_OLD);
        let asked = self.flags & (INT | OLD);
        if asked == INT || asked == OLD || !self.has(HAS_ASKED_OLD) {
            self.flags |= FIXED;
        }
        self.flags &= !(INT | OLD);
    }

    /// Whether UNSUPPORTED refuses the form of a request, rather than cancelling the upload.
    pub(super) fn explains_unsupported(self, has_items: bool) -> bool {
        self.has(HAS_ASKED_OLD) || !has_items
    }

    /// Chooses the other form after the client answered UNSUPPORTED. Returns whether to send a request at once. Several
    /// requests in transit may each be refused, and a client that knows neither form must not set the pace of the requests.
    pub(super) fn refused(&mut self) -> bool {
        if !self.has(HAS_ASKED_OLD) {
            self.flags |= REFUSES_INT;
            self.is_old = true;
            return true;
        }
        // One that refuses MISSION_REQUEST_INT may have refused several.
        self.is_old = self.has(REFUSES_INT);
        let is_new = !self.has(REFUSES_INT | REFUSES_OLD);
        if is_new {
            self.flags |= REFUSES_OLD;
        }
        is_new && self.was_old
    }
}
