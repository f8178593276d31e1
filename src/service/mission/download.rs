//! Downloads: stateless, from the live plan, for any number of clients (M-6, M-12, M-60 to M-67).
//!
//! A client may request any item at any time, so lost and repeated requests need no special handling. Live plans are in
//! RAM, so no read of storage can fail here (M-66). The only state is which clients requested a plan's count before the
//! plan was replaced. Such a client would mix the items of two plans, so it gets OPERATION_CANCELLED until it requests
//! the count again (M-63).
//!
//! ```text
//!                                                                 COUNT sent,
//!   (none) ── COUNT sent ──▶ current ── plan replaced ──▶ stale ── or own upload ──▶ current
//!      ▲                        │                           │
//!      └── MISSION_ACK, or 10 s without a request ──────────┘
//! ```

use super::check;
use super::replies::{Reply, ReplyContent};
use super::vehicle::Progress;
use crate::dialect::{MavMissionResult, MissionCount, MissionItem, MissionItemInt};
use crate::link::Outbox;
use crate::log::RefusalLog;
use crate::message::{Address, CommandRule, Message};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, Peer, PlanType, PlansMut, Sender, Trust};

/// Number of sessions. A new one evicts the session that has been silent for longest.
const SESSIONS: usize = 4;

/// A session ends this long after its last request.
const EXPIRY: Duration = Duration::from_secs(10);

#[derive(Clone, Copy, Debug)]
struct Session {
    /// The client, its link, and what has proved it: two stations with the same ids on two links are two clients (M-45), and so is one
    /// with less proof (X-1).
    client: Sender,
    plan: PlanType,
    /// Whether the plan was replaced since the client requested its count.
    is_stale: bool,
    /// Whether the slot is in use.
    is_open: bool,
    /// The time of the last request; zero for a free slot.
    at: Instant,
}

/// The downloads in progress.
#[derive(Clone, Debug)]
pub(super) struct Sessions {
    sessions: [Session; SESSIONS],
    pub(super) refused: RefusalLog,
}

impl Sessions {
    pub(super) const fn new() -> Self {
        let peer = Peer { address: Address::new(0, 0), link: LinkId(0) };
        let client = Sender { peer, trust: Trust::None };
        let free = Session { client, plan: PlanType::Mission, is_stale: false, is_open: false, at: Instant::ZERO };
        Self { sessions: [free; SESSIONS], refused: RefusalLog::NEW }
    }

    /// Returns the open session of `client` for this plan, on the client's link or, if `on_any_link`, the first one
    /// with the client's ids; `None` if there is none.
    fn find(&mut self, now: Instant, client: Sender, plan: PlanType, on_any_link: bool) -> Option<&mut Session> {
        self.sessions.iter_mut().find(|session| {
            let Session { client: known, plan: session_plan, is_open, at, .. } = **session;
            let is_link = on_any_link || known.peer.link == client.peer.link;
            let is_client = is_link && known.peer.address == client.peer.address && known.trust <= client.trust;
            is_client && session_plan == plan && is_open && now - at < EXPIRY
        })
    }

    /// Opens a session, because `client` is sent the count of the plan that is live now.
    fn open(&mut self, now: Instant, client: Sender, plan: PlanType) {
        let fresh = Session { client, plan, is_stale: false, is_open: true, at: now };
        if let Some(session) = self.find(now, client, plan, false) {
            *session = fresh;
        } else if let Some(oldest) = self.sessions.iter_mut().min_by_key(|session| session.at) {
            *oldest = fresh;
        }
    }

    /// Renews the session of `client`, which requests an item. Returns whether the client expects a plan that has been
    /// replaced. A client without a session on this link may have requested the count on another link, and moved
    /// (M-11).
    fn renew_and_check_stale(&mut self, now: Instant, client: Sender, plan: PlanType) -> bool {
        let may_have_moved = self.find(now, client, plan, false).is_none();
        self.find(now, client, plan, may_have_moved).is_some_and(|session| {
            session.at = now;
            session.is_stale
        })
    }

    /// Closes the session of `client`, which has finished or given up (M-65).
    pub(super) fn close(&mut self, client: Sender, plan: PlanType) {
        let is_its = |session: &&mut Session| session.client.is_repeated_by(client) && session.plan == plan;
        for session in self.sessions.iter_mut().filter(is_its) {
            (session.is_open, session.at) = (false, Instant::ZERO);
        }
    }

    /// Marks all sessions of this plan as stale: the plan was replaced.
    pub(super) fn invalidate(&mut self, plan: PlanType) {
        for session in self.sessions.iter_mut().filter(|session| session.plan == plan) {
            session.is_stale = true;
        }
    }

    /// Renews the session of `client` on its link: it has replaced the plan itself, so it knows the new one. A session
    /// with its ids on another link may be another station's (M-45).
    pub(super) fn renew(&mut self, now: Instant, client: Sender, plan: PlanType) {
        if let Some(session) = self.find(now, client, plan, false) {
            session.is_stale = false;
        }
    }

    /// Sends the answer `reply`, which is no MISSION_ACK. Returns false if the link cannot send it.
    ///
    /// `floats`: the rules of the mission's commands, if MISSION_REQUEST is answered by MISSION_ITEM instead of
    /// MISSION_ITEM_INT (M-61).
    pub(super) fn answer(
        &mut self,
        now: Instant,
        reply: &Reply,
        plans: &PlansMut<'_>,
        progress: &Progress,
        floats: Option<&'static [CommandRule]>,
        tx: &mut Outbox,
    ) -> bool {
        let Reply { to, mission_type, content } = *reply;
        let (ReplyContent::Count { trust } | ReplyContent::Item { trust, .. }) = content else { return false };
        let client = Sender { peer: Peer { address: to, link: tx.link() }, trust };
        // The plan was checked when the request was received.
        let plan = PlanType::from_mission_type(mission_type).unwrap_or(PlanType::Mission);
        let ReplyContent::Item { seq, is_old_request, .. } = content else {
            self.open(now, client, plan);
            return tx.send(&MissionCount {
                count: plans.count(plan),
                target_system: to.system.wire(),
                target_component: to.component.wire(),
                mission_type,
                opaque_id: plans.live(plan).id(),
            });
        };
        let seq = u16::from_le_bytes(seq);
        if self.renew_and_check_stale(now, client, plan) {
            if let Some(refused) = self.refused.count(now) {
                event!("{} download by {}: the plan has changed; {=u32} refused so far", plan, to, refused);
            }
            return reply.send_refusal(MavMissionResult::OPERATION_CANCELLED, tx);
        }
        let Some(item) = plans.live(plan).items().get(usize::from(seq)) else {
            return reply.send_refusal(MavMissionResult::INVALID_SEQUENCE, tx);
        };
        let is_current = plan == PlanType::Mission && seq == progress.current;
        let mut message = item.to_int(to, mission_type, seq, is_current);
        let mut info = const { &MissionItemInt::INFO };
        if let Some(rules) = floats.filter(|_| is_old_request) {
            let has_position = check::rule(plan, rules, item.command).is_ok_and(CommandRule::is_located);
            message = item.with_floats(message, has_position);
            info = const { &MissionItem::INFO };
        }
        tx.send_like(&message, info)
    }
}
