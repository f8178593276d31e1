//! Which message requests an item: MISSION_REQUEST_INT or the old MISSION_REQUEST (M-35, M-37, M-47).
//!
//! Some clients understand only the old message. Others refuse it with UNSUPPORTED. So the first request is a
//! MISSION_REQUEST_INT. From the third repetition or the first UNSUPPORTED on, the forms alternate. An item fixes the
//! form of the last request. But if both forms had requested it, it may be a late answer to the other one: then the
//! forms alternate until an item answers a single form.

use crate::dialect::{MissionRequest, MissionRequestInt};
use crate::message::{Message, MessageInfo};

/// Repetitions before the forms alternate.
const REPETITIONS: u8 = 3;

/// The form of the requests of one upload. "Old" is MISSION_REQUEST.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RequestForm {
    next_is_old: bool,
    last_was_old: bool,
    /// The form of the last request is kept.
    is_fixed: bool,
    /// A MISSION_REQUEST_INT has requested the missing item.
    has_int_request: bool,
    /// A MISSION_REQUEST has requested the missing item.
    has_old_request: bool,
    /// A MISSION_REQUEST was sent in this upload.
    has_sent_old: bool,
    client_refuses_int: bool,
    client_refuses_old: bool,
}

impl RequestForm {
    /// Records that a request is sent. Returns its message. Both messages have the same fields.
    pub(super) fn record_request(&mut self) -> &'static MessageInfo {
        self.last_was_old = self.next_is_old;
        if self.next_is_old {
            (self.has_old_request, self.has_sent_old) = (true, true);
            const { &MissionRequest::INFO }
        } else {
            self.has_int_request = true;
            const { &MissionRequestInt::INFO }
        }
    }

    /// Chooses the form of repetition number `retries`.
    pub(super) fn choose_for_retry(&mut self, retries: u8) {
        let do_forms_alternate = !self.is_fixed && (retries >= REPETITIONS || self.has_sent_old);
        if do_forms_alternate {
            self.next_is_old = !self.last_was_old && !self.client_refuses_old;
        }
    }

    /// Chooses the form for the next item when the missing one is received: that of the last request.
    pub(super) fn choose_after_item(&mut self) {
        self.next_is_old = self.last_was_old && !self.client_refuses_old;
        // An item that was requested in both forms may answer the earlier request: then it proves no form.
        let was_one_form_requested = self.has_int_request != self.has_old_request || !self.has_sent_old;
        if was_one_form_requested {
            self.is_fixed = true;
        }
        (self.has_int_request, self.has_old_request) = (false, false);
    }

    /// Whether UNSUPPORTED from the client may refuse the form of a request. If not, it cancels the upload: the client
    /// has sent items (`has_items`), and was sent no request in the other form.
    pub(super) fn may_be_refused(&self, has_items: bool) -> bool {
        self.has_sent_old || !has_items
    }

    /// Chooses the other form after the client answered UNSUPPORTED. Returns whether to send a request at once: only
    /// after the first refusal of the form of the last request. Several requests in transit may each be refused, and a
    /// client that knows neither form must not set the pace of the requests.
    pub(super) fn choose_after_refusal(&mut self) -> bool {
        if !self.has_sent_old {
            (self.client_refuses_int, self.next_is_old) = (true, true);
            return true;
        }
        // A client that refuses MISSION_REQUEST_INT may have refused several.
        self.next_is_old = self.client_refuses_int;
        let is_first_refusal = !self.client_refuses_int && !self.client_refuses_old;
        self.client_refuses_old |= is_first_refusal;
        is_first_refusal && self.last_was_old
    }
}
