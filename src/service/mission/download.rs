//! Downloads: stateless, from the live plan, for any number of clients (M-60 to M-67).
//!
//! Any item can be asked for at any time, so a repeated or lost request needs no care. What is sent stands in memory, so no
//! storage can fail to be read here (M-66). The one thing that is remembered is
//! who asked for a plan's count before the plan was replaced: such a client would mix the items of two plans, and gets
//! OPERATION_CANCELLED until it asks for the count again (M-63).
//!
//! ```text
//!   (none) ── COUNT sent ──▶ current ── plan replaced ──▶ stale ── COUNT sent ──▶ current
//!      ▲                        │                           │
//!      └── MISSION_ACK, or 10 s without a request ──────────┘
//! ```

use super::memory::{PlanType, PlansMut};
use super::replies::{Reply, What};
use crate::dialect::{MavMissionResult, MissionCount};
use crate::frame::Address;
use crate::link::{LinkId, Outbox, Peer};
use crate::time::{Duration, Instant};
use crate::vehicle::Progress;

/// Clients that are remembered; when there are more, the one that was silent for longest is forgotten.
const SESSIONS: usize = 4;

/// So long after its last request a client is forgotten.
const EXPIRY: Duration = Duration::from_secs(10);

#[derive(Clone, Copy, Debug)]
struct Session {
    /// With its link, because two stations with the same ids on two links are two clients (M-45).
    client: Peer,
    plan: PlanType,
    is_stale: bool,
    /// Its last request; none in a free place.
    at: Option<Instant>,
}

/// Who is downloading what.
#[derive(Clone, Debug)]
pub(super) struct Sessions {
    sessions: [Session; SESSIONS],
}

impl Sessions {
    pub(super) const fn new() -> Self {
        let client = Peer { address: Address::new(0, 0), link: LinkId(0) };
        let free = Session { client, plan: PlanType::Mission, is_stale: false, at: None };
        Self { sessions: [free; SESSIONS] }
    }

    fn find(&mut self, now: Instant, plan: PlanType, is_it: impl Fn(Peer) -> bool) -> Option<&mut Session> {
        self.sessions.iter_mut().find(|session| {
            session.plan == plan && is_it(session.client) && session.at.is_some_and(|at| now.since(at) < EXPIRY)
        })
    }

    /// `client` learns how many items the plan has now.
    fn open(&mut self, now: Instant, client: Peer, plan: PlanType) {
        let fresh = Session { client, plan, is_stale: false, at: Some(now) };
        if let Some(session) = self.find(now, plan, |other| other == client) {
            *session = fresh;
        } else if let Some(oldest) = self.sessions.iter_mut().min_by_key(|session| session.at) {
            *oldest = fresh;
        }
    }

    /// Returns whether `client`, which asks for an item, expects a plan that has been replaced. A client that has moved to
    /// this link may have asked for the count on another link (M-11).
    fn is_stale(&mut self, now: Instant, client: Peer, plan: PlanType) -> bool {
        let is_here = self.find(now, plan, |other| other == client).is_some();
        let is_it = |other: Peer| other.address == client.address && (other.link == client.link || !is_here);
        self.find(now, plan, is_it).is_some_and(|session| {
            session.at = Some(now);
            session.is_stale
        })
    }

    /// `client` is done, or gave up (M-65).
    pub(super) fn close(&mut self, client: Peer, plan: PlanType) {
        for session in self.sessions.iter_mut().filter(|session| (session.client, session.plan) == (client, plan)) {
            session.at = None;
        }
    }

    /// The plan was replaced.
    pub(super) fn invalidate(&mut self, plan: PlanType) {
        for session in self.sessions.iter_mut().filter(|session| session.plan == plan) {
            session.is_stale = true;
        }
    }

    /// Sends what `reply` owes.
    ///
    /// `float_form`: whether MISSION_REQUEST is answered by MISSION_ITEM instead of MISSION_ITEM_INT (M-61).
    pub(super) fn answer(
        &mut self,
        now: Instant,
        reply: &Reply,
        plans: &PlansMut<'_>,
        progress: &Progress,
        float_form: bool,
        tx: &mut Outbox,
    ) -> bool {
        let Reply { to, mission_type, .. } = *reply;
        let client = Peer { address: to, link: tx.link() };
        // That the plan is one of ours was seen when it was asked for.
        let plan = PlanType::from_mission_type(mission_type).unwrap_or(PlanType::Mission);
        let (seq, is_legacy) = match reply.what() {
            What::Accepted(_) | What::Refused(_) => return reply.send_ack(tx),
            What::Count => {
                self.open(now, client, plan);
                return tx.send(&MissionCount {
                    count: plans.count(plan),
                    target_system: to.system.0,
                    target_component: to.component.0,
                    mission_type,
                    opaque_id: plans.live(plan).id(),
                });
            }
            What::Item(seq) => (seq, false),
            What::LegacyItem(seq) => (seq, true),
        };
        if self.is_stale(now, client, plan) {
            event!("{} download by {}: the plan has changed", plan, to);
            return reply.ack(MavMissionResult::OPERATION_CANCELLED, 0, tx);
        }
        let Some(item) = plans.live(plan).items().get(usize::from(seq)) else {
            return reply.ack(MavMissionResult::INVALID_SEQUENCE, 0, tx);
        };
        let is_current = plan == PlanType::Mission && seq == progress.current;
        if is_legacy && float_form {
            tx.send(&item.to_float(to, mission_type, seq, is_current))
        } else {
            tx.send(&item.to_int(to, mission_type, seq, is_current))
        }
    }
}
