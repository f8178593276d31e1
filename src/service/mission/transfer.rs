//! The state of a change of the plans: an upload, then its write to storage, then its result.

use core::num::Wrapping;

use super::replies::{FinalAnswer, Replies, ReplyContent};
use super::request_form::RequestForm;
use super::retry::RetryTimer;
use crate::dialect::{MavMissionResult, MavMissionType, MissionRequestInt};
use crate::frame::Frame;
use crate::link::Outbox;
use crate::message::{Address, Digest};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, NO_ITEM, Peer, PlanType, Trust};

/// The change that uses the staging area. The explicit tag makes `Idle` all zero bits, so that the stack lies in
/// `.bss`.
#[derive(Clone, Debug)]
#[repr(u8)]
pub(super) enum Transfer {
    Idle,
    /// Items are received. The staging area has those received so far.
    Upload(Upload),
    /// A durable change is being written to storage.
    Commit(Commit),
}

/// An upload in progress.
#[derive(Clone, Debug)]
pub(super) struct Upload {
    /// The client, and the link on which it was last heard: answers are sent there (M-11).
    pub(super) client: Peer,
    /// What has proved the client when the upload began: a frame with less is another client's.
    pub(super) trust: Trust,
    /// The rate of its link when it began (bytes/s; 0 for no limit).
    pub(super) rate: u32,
    pub(super) plan: PlanType,
    pub(super) count: u16,
    /// The first item marked as current.
    pub(super) first: Option<u16>,
    pub(super) digest: Digest,
    pub(super) retry: RetryTimer,
    /// Whether the request for the next item is pending.
    pub(super) is_request_pending: bool,
    pub(super) request_form: RequestForm,
    /// Whether a client certainly sends this plan. False if the upload began with a COUNT that may be a delayed
    /// duplicate of the previous upload's COUNT, until item 0 is received.
    ///
    /// In an unconfirmed upload, item 0 is requested once for each COUNT, and not by the timer: after a duplicate, the
    /// answer might be item 0 of the client's next plan. Other clients may start uploads, a timeout is not reported,
    /// and the state and the pending answers of the previous upload are kept.
    pub(super) is_confirmed: bool,
    /// The last expected item's frame. In an unconfirmed upload, that of the previous upload: a COUNT sent after it is
    /// not a duplicate (M-22).
    pub(super) last: FrameNumber,
    pub(super) counts: CountRange,
}

impl Upload {
    /// The address of a file's upload, instead of a client's.
    const FILE: Address = Address::new(0, 0);

    pub(super) fn new(client: Peer, plan: PlanType, count: u16, number: FrameNumber, now: Instant) -> Self {
        Self {
            client,
            trust: Trust::None,
            rate: 0,
            plan,
            count,
            first: None,
            digest: Digest::new(),
            retry: RetryTimer::new(now),
            is_request_pending: true,
            request_form: RequestForm::default(),
            is_confirmed: true,
            last: number,
            counts: CountRange::new(number),
        }
    }

    /// The upload of a file. No client of messages owns it, so all of them are refused (F-24) until it is slow. Its timers do not run:
    /// the file's session ends it.
    pub(super) fn of_file(plan: PlanType) -> Self {
        let client = Peer { address: Self::FILE, link: LinkId(0) };
        let upload = Self::new(client, plan, NO_ITEM, FrameNumber::NONE, Instant::NEVER);
        Self { is_request_pending: false, ..upload }
    }

    pub(super) fn is_of_file(&self) -> bool {
        self.client.address == Self::FILE
    }

    /// Whether a frame from this address, with this proof, is the client's.
    pub(super) fn is_by(&self, address: Address, trust: Trust) -> bool {
        self.client.address == address && trust >= self.trust
    }

    /// Returns how long an upload may take for so many items before it is slow: two seconds and four times an item's bytes at
    /// the link's rate, for each.
    pub(super) fn time_for(&self, items: u16) -> Duration {
        /// The µs of four times the bytes of an item and of its request at one byte a second.
        const FOUR_ITEMS: u32 = 4 * 70 * 1_000_000;
        let sending = FOUR_ITEMS.checked_div(self.rate).unwrap_or(0);
        (Duration::from_secs(2) + Duration::from_micros(sending.into())) * u32::from(items)
    }

    /// Sends the request for item `seq`. Returns false if the link cannot send it.
    pub(super) fn send_request(&mut self, now: Instant, seq: u16, tx: &mut Outbox) -> bool {
        self.is_request_pending = false;
        self.retry.on_request(now);
        let request = MissionRequestInt {
            seq,
            target_system: self.client.address.system.wire(),
            target_component: self.client.address.component.wire(),
            mission_type: self.plan.mission_type(),
        };
        tx.send_like(&request, self.request_form.record_request())
    }
}

/// A durable change that is being written.
#[derive(Clone, Debug)]
pub(super) struct Commit {
    /// The client that waits for the result, its link, and what has proved it when the change began.
    pub(super) client: Peer,
    pub(super) trust: Trust,
    pub(super) change: Change,
    /// When the write began.
    pub(super) since: Instant,
}

impl Commit {
    /// Whether a frame from this address, with this proof, is the client's.
    pub(super) fn is_by(&self, address: Address, trust: Trust) -> bool {
        self.client.address == address && trust >= self.trust
    }

    /// Moves the client to the link on which it was heard now, so that the result is sent there (M-11). Changes nothing
    /// if the result slot of that link, in `replies`, is taken.
    pub(super) fn move_client(&mut self, link: LinkId, replies: &Replies) {
        if !replies.has_result() {
            self.client.link = link;
        }
    }
}

/// A change of the live plans.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    /// The staging area becomes this plan.
    Upload {
        plan: PlanType,
        id: u32,
        /// The item to start from.
        first: u16,
        last_seq: u16,
        /// The last item's frame.
        last: FrameNumber,
    },
    /// This plan is cleared, or all plans are.
    Clear(Option<PlanType>),
}

impl Change {
    pub(super) fn mission_type(&self) -> MavMissionType {
        match *self {
            Self::Upload { plan, .. } | Self::Clear(Some(plan)) => plan.mission_type(),
            Self::Clear(None) => MavMissionType::ALL,
        }
    }

    /// Whether the change replaces or clears `plan`.
    pub(super) fn affects(&self, plan: PlanType) -> bool {
        match *self {
            Self::Upload { plan: uploaded, .. } => uploaded == plan,
            Self::Clear(Some(cleared)) => cleared == plan,
            Self::Clear(None) => true,
        }
    }
}

/// The result of the previous upload, so that a lost final ACK can be sent again (M-31).
///
/// No field has a niche, so an `Option` of this type has a tag, which is 0 for `None`.
#[derive(Clone, Debug)]
pub(super) struct FinishedUpload {
    pub(super) client: Address,
    pub(super) mission_type: MavMissionType,
    pub(super) last_seq: u16,
    pub(super) result: MavMissionResult,
    /// The plan's id; 0 if the upload was refused.
    pub(super) id: u32,
    /// The last item's frame.
    pub(super) last: FrameNumber,
    /// When the upload ended.
    pub(super) at: Instant,
}

/// The answer to a client whose upload has given way to another client. Initially all bits are zero.
#[derive(Clone, Debug)]
pub(super) struct Ousted {
    pub(super) is_pending: bool,
    pub(super) client: Peer,
    pub(super) mission_type: MavMissionType,
}

impl Ousted {
    pub(super) const NONE: Self = Self {
        is_pending: false,
        client: Peer { address: Address::new(0, 0), link: LinkId(0) },
        mission_type: MavMissionType(0),
    };

    /// Takes the answer, if it is pending.
    pub(super) fn take(&mut self) -> Option<FinalAnswer> {
        let content = ReplyContent::Refused(MavMissionResult::OPERATION_CANCELLED);
        let answer = self.is_pending.then(|| FinalAnswer::new(self.client, self.mission_type, content));
        self.is_pending = false;
        answer
    }
}

/// The second final answer of an accepted upload (M-31). As [`FinishedUpload`], `None` is all zero bits.
#[derive(Clone, Debug)]
pub(super) struct SecondAnswer {
    /// When the answer is sent.
    pub(super) at: Instant,
    pub(super) client: Peer,
    pub(super) mission_type: MavMissionType,
    pub(super) id: u32,
}

impl SecondAnswer {
    pub(super) fn answer(&self) -> FinalAnswer {
        let content = ReplyContent::Accepted { id: self.id.to_le_bytes() };
        FinalAnswer::new(self.client, self.mission_type, content)
    }
}

/// The sequence number of a frame, and the link on which it was received. It shows which frame was sent first (M-22,
/// M-45).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FrameNumber {
    pub(super) link: LinkId,
    pub(super) seq: Wrapping<u8>,
}

impl FrameNumber {
    const NONE: Self = Self { link: LinkId(0), seq: Wrapping(0) };

    pub(super) fn of(frame: &Frame<'_>, from: Peer) -> Self {
        Self { link: from.link, seq: Wrapping(frame.header().seq) }
    }

    /// Whether this frame was certainly sent after `other`. False for frames of two links, because each link has its
    /// own sequence numbers, and for equal numbers, because some senders do not increment them.
    pub(super) fn is_after(self, other: Self) -> bool {
        let is_ahead = matches!((self.seq - other.seq).0, 1..=127);
        self.link == other.link && is_ahead
    }
}

/// The range of sequence numbers of an upload's COUNTs: the first COUNT, up to the first item. Empty for a sender that
/// does not increment its sequence number.
#[derive(Clone, Copy, Debug)]
pub(super) struct CountRange {
    first: FrameNumber,
    len: u8,
}

impl CountRange {
    /// Starts the range with the first COUNT.
    const fn new(first: FrameNumber) -> Self {
        Self { first, len: 1 }
    }

    /// Extends the range to a repeated COUNT.
    pub(super) fn extend(&mut self, number: FrameNumber) {
        let len = number.seq - self.first.seq + Wrapping(1);
        if number.link == self.first.link && len.0 <= 127 {
            self.len = self.len.max(len.0);
        }
    }

    /// Ends the range before the first item.
    pub(super) fn end(&mut self, number: FrameNumber) {
        let len = number.seq - self.first.seq;
        if number.link == self.first.link && len.0 <= 127 {
            self.len = len.0;
        }
    }

    /// Whether this is the sequence number of one of these COUNTs, on whichever link it was received.
    pub(super) fn contains(&self, seq: Wrapping<u8>) -> bool {
        (seq - self.first.seq).0 < self.len
    }
}
