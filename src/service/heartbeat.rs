//! HEARTBEAT: sent only while the flight loop ticks.
//!
//! Implements <https://mavlink.io/en/services/heartbeat.html>, rules H-1 to H-7 and H-16. The states are drawn at
//! [`Pulse`](crate::Pulse).

use super::{About, Cx, Handled, RETRY, Received, Request, Service, Turn, Verdict, View};
use crate::dialect::{Heartbeat, MavCmd, MavResult};
use crate::link::Port;
use crate::message::Message;
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{Firmware, LinkMask, Vehicle, VehicleState};

/// HEARTBEAT.mavlink_version: the version of the definitions, the same for both wire versions (V-5).
const MAVLINK_VERSION: u8 = 3;

/// Sends HEARTBEAT.
#[derive(Debug)]
pub struct Heartbeats {
    /// Links on which an extra heartbeat is pending (H-16).
    extra: LinkMask,
}

/// A HEARTBEAT that is pending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beat {
    Scheduled,
    /// Reports a change of the state (H-16).
    Extra,
}

impl Heartbeats {
    /// Samples the pulse and the vehicle's state, before the services are polled: they see the same state.
    pub(crate) fn sample<F: Firmware<Vehicle: Vehicle>>(&mut self, cx: &mut Cx<'_, F>) {
        cx.shared.sample_pulse(cx.now);
        let state = cx.vehicle.state();
        self.notice(cx, state);
    }

    /// Decides whether a link may send a heartbeat: by the pulse, the state after a command, and requests of other
    /// services. The stack calls it before it asks for the link's next frame.
    pub(crate) fn prepare<F: Firmware<Vehicle: Vehicle>>(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut Schedule,
    ) {
        cx.shared.sample_pulse(cx.now);
        if cx.shared.has_acted {
            // A command may have changed the state. Its heartbeat must precede the answer, because clients read it as
            // soon as the answer arrives.
            let state = cx.vehicle.state();
            self.notice(cx, state);
        }
        if core::mem::take(&mut port.facts.is_sign_of_life_due) {
            link.postpone(cx.now);
        }
    }

    /// Schedules an extra heartbeat on each normal link when the reported state has changed (H-16).
    fn notice<F: Firmware>(&mut self, cx: &mut Cx<'_, F>, state: Option<VehicleState>) {
        let observed = &mut cx.shared.observed;
        observed.has_state = state.is_some();
        if let Some(state) = state.filter(|state| *state != observed.state) {
            observed.state = state;
            self.extra = cx.shared.normal;
        }
    }
}

impl<F: Firmware<Vehicle: Vehicle>> Service<F> for Heartbeats {
    const NEW: Self = Self { extra: LinkMask::NONE };
    type Link = Schedule;
    const VACANT: Schedule = Schedule::new();
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Heartbeat, Turn::ExtraHeartbeat]);
    type Reply = Beat;

    /// The peer table has recorded the heartbeat before.
    fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, _: &mut Schedule, received: &Received<'_>) -> Handled {
        if received.frame.id() == Heartbeat::ID { Handled::Yes } else { Handled::No }
    }

    /// Handles requests for HEARTBEAT. A requested heartbeat is sent like one that reports a change. The request is
    /// refused while no heartbeats are sent (H-5, Q-1). A request for another interval is accepted, but the interval
    /// stays as it is.
    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        _: &mut Schedule,
        request: &Request,
    ) -> Option<Verdict> {
        let command = &request.command;
        let [id, micros, instance, _] = command.params;
        let is_interval = command.id == MavCmd::SET_MESSAGE_INTERVAL;
        if !(is_interval || command.id == MavCmd::REQUEST_MESSAGE) || num::integer(id) != Some(Heartbeat::ID) {
            return None;
        }
        let is_valid = !port.config.class.is_high_latency() && command.has_response_target();
        let is_accepted = if is_interval {
            is_valid && micros >= 0.0 && (instance == 0.0 || instance.is_nan())
        } else {
            is_valid && cx.vehicle.state().is_some() && cx.shared.is_beating(cx.now)
        };
        if is_accepted && !is_interval {
            self.extra = self.extra.with(LinkMask::of(port.id));
        }
        Some(Verdict::done(if is_accepted { MavResult::ACCEPTED } else { MavResult::DENIED }))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &Schedule, turn: Turn) -> Option<(Instant, Beat)> {
        match turn {
            Turn::ExtraHeartbeat => {
                let is_pending = view.shared.observed.has_state && self.extra.contains(port.id);
                is_pending.then_some((link.extra, Beat::Extra))
            }
            _ if port.facts.is_sign_of_life_due => Some((view.now, Beat::Scheduled)),
            _ => Some((link.due, Beat::Scheduled)),
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut Schedule, beat: Beat) -> bool {
        let now = cx.now;
        let Some(state) = cx.vehicle.state() else {
            cx.shared.observed.has_state = false;
            if beat == Beat::Scheduled {
                link.postpone(now + RETRY);
            }
            return false;
        };
        self.extra = self.extra.without(LinkMask::of(port.id));
        let config = &cx.shared.config;
        match beat {
            Beat::Scheduled => {
                link.sent(now, config.heartbeat_period);
                port.facts.periods = port.facts.periods.wrapping_add(1);
            }
            Beat::Extra => link.sent_extra(now),
        }
        port.outbox.send(&Heartbeat {
            custom_mode: state.custom_mode,
            r#type: config.r#type,
            autopilot: config.autopilot,
            base_mode: state.flags(F::HAS_MODES),
            system_status: state.system_status,
            mavlink_version: MAVLINK_VERSION,
        })
    }
}

/// The minimum period: a link must have time for other frames.
const MIN_PERIOD: Duration = Duration::from_millis(10);

/// The minimum time between extra heartbeats on a link (H-16).
const EXTRA_PERIOD: Duration = Duration::from_millis(200);

/// When a link's next heartbeat is due. The schedule has no drift, and no burst after a stall (H-6). Extra heartbeats,
/// which report a change, do not shift it (H-16).
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    due: Instant,
    /// When the next extra heartbeat may be sent.
    extra: Instant,
}

impl Schedule {
    pub(crate) const fn new() -> Self {
        Self { due: Instant::ZERO, extra: Instant::ZERO }
    }

    /// Records that an extra heartbeat was sent.
    pub(crate) fn sent_extra(&mut self, now: Instant) {
        self.extra = now + EXTRA_PERIOD;
    }

    /// Records that a heartbeat was sent. The next is due one period after this one was *due*, or one period after
    /// `now` if that is in the past.
    pub(crate) fn sent(&mut self, now: Instant, period: Duration) {
        let period = period.max(MIN_PERIOD);
        let next = self.due + period;
        self.due = if next > now { next } else { now + period };
    }

    /// Moves the next heartbeat to `due`, because it cannot be sent now.
    pub(crate) const fn postpone(&mut self, due: Instant) {
        self.due = due;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedule_has_no_drift_and_no_burst() {
        // H-6
        let period = Duration::from_secs(1);
        let mut schedule = Schedule::new();
        schedule.sent(Instant::from_millis(3), period);
        assert_eq!(schedule.due, Instant::from_millis(1_000), "a late poll does not shift the schedule");
        schedule.sent(Instant::from_millis(5_300), period);
        assert_eq!(schedule.due, Instant::from_millis(6_300), "after a stall the schedule starts from now");
    }
}
