//! What a link sends next: the services in a fixed order (D-4), one frame at a time, and when there is something to send.
//! `docs/architecture.md` has that order as a table, and `tests/order.rs` checks it.

use super::{Context, Core, count, signing};
use crate::dialect::{Heartbeat, MavCmd, MavResult};
use crate::link::{LinkClass, LinkMask, Port, Transport};
use crate::message::Message;
use crate::num;
use crate::service::high_latency;
use crate::service::mission::{Missions, PlanStorage};
use crate::service::param;
use crate::service::statustext::StatusTexts;
use crate::service::{command, mode, time};
use crate::time::{Duration, Instant};
use crate::vehicle::{Autopilot, Command};

impl Core {
    /// Puts the next frame into the link's outbound buffer, which is empty.
    pub(super) fn fill<V: Autopilot, P: PlanStorage>(&mut self, context: &mut Context<'_, V, P>, port: &mut Port) {
        let now = context.now;
        port.bucket.drain(now);
        signing::prepare(now, port, context.vehicle);
        let is_normal = port.config.class != LinkClass::HighLatency;
        // The list keeps its share even when streams saturate the link (P-11).
        let is_list_late = port.params.is_late(now);
        let sent = (is_normal && self.heartbeat(now, port, context.vehicle))
            || command::next(port, context.vehicle)
            || (is_normal
                && (port.plans.next_ack(&mut port.outbox)
                    || signing::next(port)
                    || time::next(now, port, context.vehicle)
                    || (port.bucket.has_room() && (self.transfer(context, port) || self.requested(context, port)))
                    || (!is_list_late && self.share(context, port))
                    || (port.bucket.has_room() && self.list(now, port, context.vehicle))
                    || (is_list_late && self.share(context, port))))
            || (port.config.class == LinkClass::HighLatency
                && (self.high_latency(now, port, context.vehicle) || self.forward(context, port)));
        if sent {
            signing::sign(now, port, context.vehicle);
            count(&mut port.counters.tx_frames);
            high_latency::count(port, context.vehicle);
        }
    }

    /// Sends the heartbeat when it is due or the reported state has changed, and the flight loop is healthy (H-1, H-5,
    /// H-16).
    fn heartbeat<V: Autopilot>(&mut self, now: Instant, port: &mut Port, vehicle: &mut V) -> bool {
        if self.has_acted {
            // A command may have changed the state. The heartbeat must then precede the answer, because clients read it
            // as soon as the answer arrives.
            self.notice(vehicle.state());
        }
        let link = LinkMask::of(port.id);
        let is_due = port.heartbeat.is_due(now);
        let is_extra =
            self.extra_heartbeats.contains(link) && port.heartbeat.may_send_extra(now) && port.bucket.has_room();
        if !(is_due || is_extra) || !self.has_credit(now) {
            return false;
        }
        let Some(state) = vehicle.state() else {
            if is_due {
                port.heartbeat.postpone(now.after(RETRY));
            }
            return false;
        };
        self.extra_heartbeats = self.extra_heartbeats.without(link);
        if is_due {
            port.heartbeat.sent(now, self.config.heartbeat_period);
            if !V::MODES.is_empty() {
                mode::on_heartbeat(port);
            }
        } else {
            port.heartbeat.sent_extra(now);
        }
        port.outbox.send(&Heartbeat {
            custom_mode: state.custom_mode,
            r#type: self.config.r#type,
            autopilot: self.config.autopilot,
            base_mode: state.base_mode,
            system_status: state.system_status,
            mavlink_version: MAVLINK_VERSION,
        })
    }

    /// A request for HEARTBEAT, which is sent like one that reports a change, or refused while there is none (H-5, Q-1), and for a
    /// vehicle without streams the interval of it, which stays as it is; `None` for all other commands.
    pub(super) fn on_heartbeat_request<V: Autopilot>(
        &mut self,
        now: Instant,
        port: &Port,
        vehicle: &V,
        command: &Command,
    ) -> Option<MavResult> {
        let [id, micros, instance, _] = command.params;
        let is_interval = V::STREAMS.is_empty() && command.id == MavCmd::SET_MESSAGE_INTERVAL;
        if !(is_interval || command.id == MavCmd::REQUEST_MESSAGE) || num::unsigned(id) != Some(Heartbeat::ID) {
            return None;
        }
        let link = LinkMask::of(port.id);
        let is_taken = self.normal.contains(link) && command.has_response_target();
        if is_interval {
            let is_taken = is_taken && micros >= 0.0 && (instance == 0.0 || instance.is_nan());
            return Some(if is_taken { MavResult::ACCEPTED } else { MavResult::DENIED });
        }
        if !is_taken || vehicle.state().is_none() || !self.has_credit(now) {
            return Some(MavResult::DENIED);
        }
        self.extra_heartbeats = self.extra_heartbeats.with(link);
        Some(MavResult::ACCEPTED)
    }

    /// HIGH_LATENCY2, when it is due: like a heartbeat, only while the flight loop is well (L-3, H-5).
    fn high_latency<V: Autopilot>(&mut self, now: Instant, port: &mut Port, vehicle: &mut V) -> bool {
        vehicle.high_latency().is_some()
            && port.heartbeat.is_due(now)
            && self.has_credit(now)
            && high_latency::next(now, &self.config, port, vehicle)
    }

    /// Sends what can wait for the link's byte rate: of plans, parameters and texts. Not inlined: what it takes of the stack is
    /// free again before [`requested`](Self::requested) asks the vehicle.
    #[inline(never)]
    fn transfer<V: Autopilot, P: PlanStorage>(&mut self, context: &mut Context<'_, V, P>, port: &mut Port) -> bool {
        let Context { now, texts, missions, plans, vehicle, .. } = context;
        let float_items = self.config.float_mission_items;
        plans.parts(missions).is_some_and(|(missions, plans)| {
            missions.next(*now, &mut port.plans, &plans, &vehicle.progress(), float_items, &mut port.outbox)
        }) || self.params.next(*vehicle, &mut port.params, &mut port.outbox)
            || texts.next(&mut port.text, &mut port.outbox)
    }

    /// Sends the next message on request.
    #[inline(never)]
    fn requested<V: Autopilot, P: PlanStorage>(&mut self, context: &mut Context<'_, V, P>, port: &mut Port) -> bool {
        let Context { now, missions, plans, vehicle, slots, .. } = context;
        let capabilities = self.capabilities | param::capability::<V>();
        let has_modes = const { !V::MODES.is_empty() };
        port.owed.next(&self.config.identity, capabilities, &mut port.outbox)
            || self.answer(*now, slots, port, *vehicle)
            || (has_modes && mode::next_current(port, *vehicle))
            || plans
                .parts(missions)
                .is_some_and(|(missions, plans)| missions.next_progress(&plans, &vehicle.progress(), &mut port.outbox))
            || (has_modes && mode::next_listed(port, V::MODES))
    }

    /// Sends the next value of the parameter list when it is due. Returns false when it is not.
    fn list<V: Autopilot>(&mut self, now: Instant, port: &mut Port, vehicle: &mut V) -> bool {
        let rate = port.config.bytes_per_second;
        self.params.next_listed(now, vehicle, &mut port.params, rate, &mut port.outbox)
    }

    /// When something is to be sent on a link.
    pub(super) fn tx_deadline(
        &self,
        now: Instant,
        port: &Port,
        texts: &StatusTexts,
        missions: Option<&Missions>,
    ) -> Instant {
        let is_normal = port.config.class != LinkClass::HighLatency;
        let heartbeat = if self.has_state && self.extra_heartbeats.contains(LinkMask::of(port.id)) {
            port.heartbeat.due_with_extra(port.bucket.ready_at())
        } else {
            port.heartbeat.due()
        };
        let heartbeat = match heartbeat {
            Instant::NEVER => Instant::NEVER,
            due if due > now => self.credit.look_for(due, self.config.max_loop_gap),
            due if self.credit.is_good(now, self.config.max_loop_gap) => due,
            // It waits for the flight loop, of which the stack hears only when it looks.
            _ => now.after(RETRY),
        };
        match port.transport {
            // The rest of a frame waits for the next poll's budget.
            Transport::Ready if !port.outbox.is_empty() => return now,
            // It has to become ready first, of which the stack hears nothing.
            Transport::Full | Transport::Unknown if !port.outbox.is_empty() => return Instant::NEVER,
            // The same; but by the time of the next heartbeat it may be ready, though nobody is waiting for that.
            Transport::Full => return if heartbeat > now { heartbeat } else { Instant::NEVER },
            _ => {}
        }
        if !port.acks.is_empty() || (is_normal && (port.plans.has_ack() || port.is_told_of_setup())) {
            return now;
        }
        let waits = is_normal
            && (!port.owed.is_empty()
                || port.streams.is_asked()
                || self.params.is_pending(port.id)
                || texts.is_pending(LinkMask::of(port.id))
                || missions.is_some_and(|missions| missions.is_pending(&port.plans, &port.outbox)));
        let transfer = if waits { now } else { port.params.due() };
        let transfer = if is_normal { transfer.max(port.bucket.ready_at()) } else { Instant::NEVER };
        let stream = if is_normal { port.streams.deadline(port.bucket.idle_at()) } else { Instant::NEVER };
        let forward =
            if self.forwards.contains(LinkMask::of(port.id)) { port.bucket.idle_at() } else { Instant::NEVER };
        transfer.min(stream).min(forward).min(heartbeat)
    }
}

/// How soon to look again whether heartbeats may go on.
const RETRY: Duration = Duration::from_millis(100);

/// HEARTBEAT.mavlink_version: of the definitions, for both wire versions (V-5).
const MAVLINK_VERSION: u8 = 3;
