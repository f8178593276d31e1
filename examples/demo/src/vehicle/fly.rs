//! Executes maneuvers step by step, within the fence.

use mavstack::dialect::MavSeverity;
use mavstack::telemetry::Geofence;
use mavstack::{Context, PlanType};

use super::{DT, Mode, Quadrotor};
use crate::body::{Body, Vector};
use crate::fence;
use crate::plan::Maneuver;
use crate::tuning::Tuning;

impl Quadrotor {
    /// Flies one step of `maneuver`. Returns true when the maneuver is done. At the fence the mode changes as
    /// [`Tuning::GF_ACTION`] says.
    pub(super) fn perform(&mut self, cx: &mut Context<'_>, maneuver: Maneuver) -> bool {
        let here = self.body.position;
        let (goal, done) = match maneuver {
            Maneuver::Stay(to) => (to, true),
            Maneuver::Wait { at, until } => (at, self.time >= until),
            Maneuver::Reach { to, radius } => {
                (to, here.distance(to) <= radius && (to.down - here.down).abs() <= radius)
            }
            Maneuver::Circle { center, radius, angle } => {
                let flown = self.circled * 1.0_f32.copysign(angle);
                (self.body.around(center, radius, angle), flown >= angle.abs())
            }
            Maneuver::Climb(to) => {
                let is_up = (to.down - here.down).abs() < 0.5;
                let goal = if is_up { to } else { Vector { down: to.down, ..here } };
                (goal, is_up && here.distance(to) < 2.0)
            }
            Maneuver::Land(spot) => land(here, spot),
            // The caller has replaced it with a landing.
            Maneuver::Return => (here, false),
        };
        if let Maneuver::Circle { center, radius, .. } = maneuver {
            self.circled += self.body.angle_about(center, radius) * DT;
        }
        let mut next = self.body;
        next.fly(goal, self.speed(cx), DT);
        // A vehicle that holds is not stopped again.
        if self.mode == Mode::Hold && matches!(maneuver, Maneuver::Stay(_)) {
            self.is_warned = false;
            self.body = next;
            return done;
        }
        self.advance(cx, next) && done
    }

    /// Takes a step unless it leaves the fence. Returns true when the step was taken.
    pub(super) fn advance(&mut self, cx: &mut Context<'_>, next: Body) -> bool {
        let here = self.body.position;
        if !self.allows(cx, next.position, next.ahead(self.fence_margin(cx))) {
            let is_outside = !self.allows(cx, here, here);
            self.has_breached = is_outside;
            // Outside the fence the vehicle may still return or land.
            if !(is_outside && matches!(self.mode, Mode::Return | Mode::Land)) {
                return self.stop_at_fence(cx, next, is_outside);
            }
        } else {
            (self.is_warned, self.has_breached) = (false, false);
        }
        self.body = next;
        true
    }

    /// Handles a step that leaves the fence, as the parameters say. Returns true when the step was taken.
    fn stop_at_fence(&mut self, cx: &mut Context<'_>, next: Body, is_outside: bool) -> bool {
        let (is_warned, action) = (core::mem::replace(&mut self.is_warned, true), cx.parameter(Tuning::GF_ACTION));
        if action == 1 {
            self.body = next;
            if !is_warned {
                cx.text(MavSeverity::WARNING, "Leaving the fence");
            }
            return true;
        }
        // A vehicle that already returns can only hold.
        if action == 3 && self.mode != Mode::Return {
            self.enter(Mode::Return, Maneuver::Return);
            cx.text(MavSeverity::WARNING, "Returning: fence reached");
        } else {
            self.stop();
            let why = if is_outside { "Holding: outside the fence" } else { "Holding at the fence" };
            cx.text(MavSeverity::WARNING, why);
        }
        self.body.fly(self.body.rest(), self.speed(cx), DT);
        false
    }

    /// Whether the fence allows a straight flight from one position to another. Each step calls it once, or twice at the border.
    pub(super) fn allows(&self, cx: &Context<'_>, from: Vector, to: Vector) -> bool {
        if cx.parameter(Tuning::GF_ACTION) == 0 {
            return true;
        }
        let (far, high) = (cx.parameter(Tuning::GF_MAX_HOR_DIST), cx.parameter(Tuning::GF_MAX_VER_DIST));
        let is_near = |point| self.home.is_near(far, high, point);
        is_near(from) && is_near(to) && fence::allows(self.home, cx.plan(PlanType::Fence).items(), from, to)
    }

    /// Returns the state of the fence, which ground stations show. The distances from home are part of it.
    pub(super) fn fence_state(&self, cx: &Context<'_>) -> Geofence {
        let limits = [Tuning::GF_MAX_HOR_DIST, Tuning::GF_MAX_VER_DIST].map(|limit| cx.parameter(limit));
        let is_present = limits != [0.0; 2] || !cx.plan(PlanType::Fence).items().is_empty();
        match (is_present, cx.parameter(Tuning::GF_ACTION) != 0) {
            (false, _) => Geofence::Absent,
            (true, false) => Geofence::Disabled,
            (true, true) if self.has_breached => Geofence::Breached,
            (true, true) => Geofence::Kept,
        }
    }

    /// Returns the distance from the fence at which the vehicle stops (m). It is 0 after a turn back at the fence, because the
    /// return begins within the margin.
    pub(super) fn fence_margin(&self, cx: &Context<'_>) -> f32 {
        let has_turned_back = self.mode == Mode::Return && cx.parameter(Tuning::GF_ACTION) == 3;
        if has_turned_back { 0.0 } else { cx.parameter(Tuning::GF_MARGIN) }
    }

    /// Returns a landing at home or at a rally point within the fence, whichever is nearest. The approach is not lower than the
    /// vehicle's height, the rally point's altitude, and [`Tuning::RTL_RETURN_ALT`].
    #[inline(never)]
    pub(super) fn return_landing(&self, cx: &Context<'_>) -> Maneuver {
        let here = self.body.position;
        let rally = if cx.parameter(Tuning::RTL_TYPE) == 0 { cx.plan(PlanType::Rally).items() } else { &[] };
        let rally = rally.iter().filter_map(|item| {
            let (north, east) = self.home.to_local(item.x, item.y);
            let height = self.home.to_height(item.frame, item.z)?;
            Some(Vector { north, east, down: -height })
        });
        let home = self.home.spot;
        let spot = core::iter::once(home)
            .chain(rally)
            .filter(|&spot| self.allows(cx, spot, spot))
            .min_by(|a, b| here.distance(*a).total_cmp(&here.distance(*b)))
            .unwrap_or(home);
        let down = spot.down.min(here.down).min(home.down - cx.parameter(Tuning::RTL_RETURN_ALT));
        let max_height = cx.parameter(Tuning::GF_MAX_VER_DIST);
        Maneuver::Land(Vector { down: if max_height > 0.0 { down.max(home.down - max_height) } else { down }, ..spot })
    }
}

/// Returns the next position to fly to for a landing on `spot`, and whether the vehicle has landed. The approach is at the
/// height of `spot`; the descent begins above it.
fn land(here: Vector, spot: Vector) -> (Vector, bool) {
    let height = Vector { down: spot.down, ..here };
    if is_above(here, spot) {
        (Vector { down: 1.0, ..spot }, here.down >= 0.0)
    } else if here.down - spot.down > 0.5 {
        (height, false)
    } else {
        (spot, false)
    }
}

/// Whether `here` is close enough above `spot` for a vertical descent.
pub(super) fn is_above(here: Vector, spot: Vector) -> bool {
    here.distance(spot) <= 1.0
}
