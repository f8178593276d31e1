//! A step of a maneuver, within the fence.

use mavstack::dialect::MavSeverity;

use super::{DT, Live, Mode, Quadrotor};
use crate::body::{Body, Vector};
use crate::fence;
use crate::plan::Maneuver;
use crate::tuning::Tuning;

impl Quadrotor {
    /// Flies a step of `maneuver`; true when it is done. At the fence the mode becomes [`Mode::Hold`].
    pub(super) fn perform(&mut self, maneuver: Maneuver, live: &Live<'_>) -> bool {
        let here = self.body.position;
        let (goal, done) = match maneuver {
            Maneuver::Stay(to) => (to, true),
            Maneuver::Wait { at, until } => (at, self.time >= until),
            Maneuver::Reach { to, radius } => {
                (to, here.distance(to) <= radius && (to.down - here.down).abs() <= radius)
            }
            Maneuver::Climb(to) => {
                let is_up = (to.down - here.down).abs() < 0.5;
                let goal = if is_up { to } else { Vector { down: to.down, ..here } };
                (goal, is_up && here.distance(to) < 2.0)
            }
            Maneuver::Land(spot) => land(here, spot),
            // Where to is found out before.
            Maneuver::Return => (here, false),
        };
        let mut next = self.body;
        next.fly(goal, self.speed(), DT);
        // Where it stops, it stays.
        if self.mode == Mode::Hold && matches!(maneuver, Maneuver::Stay(_)) {
            self.is_warned = false;
            self.body = next;
            return done;
        }
        self.advance(next, live) && done
    }

    /// Takes a step, unless it leads out of the fence. True when it is taken.
    pub(super) fn advance(&mut self, next: Body, live: &Live<'_>) -> bool {
        let here = self.body.position;
        if !self.allows(live, next.position, next.ahead(self.fence_margin())) {
            let is_outside = !self.allows(live, here, here);
            // From outside it may come back and come down.
            if !(is_outside && matches!(self.mode, Mode::Return | Mode::Land)) {
                return self.stop_at_fence(next, is_outside);
            }
        } else {
            self.is_warned = false;
        }
        self.body = next;
        true
    }

    /// What the parameters say of a step out of the fence; true when it is taken.
    fn stop_at_fence(&mut self, next: Body, is_outside: bool) -> bool {
        let (is_warned, action) = (core::mem::replace(&mut self.is_warned, true), self.tuning.get(Tuning::GF_ACTION));
        if action == 1 {
            self.body = next;
            if !is_warned {
                self.say(MavSeverity::WARNING, "Leaving the fence");
            }
            return true;
        }
        // From the way home there is no other.
        if action == 3 && self.mode != Mode::Return {
            self.enter(Mode::Return, Maneuver::Return);
            self.say(MavSeverity::WARNING, "Returning from the fence");
        } else {
            self.stop();
            let why = if is_outside { "Holding: outside the fence" } else { "Holding at the fence" };
            self.say(MavSeverity::WARNING, why);
        }
        self.body.fly(self.body.rest(), self.speed(), DT);
        false
    }

    /// Whether the fence allows to fly straight from one place to another. A step asks this once, and twice at the border.
    pub(super) fn allows(&self, live: &Live<'_>, from: Vector, to: Vector) -> bool {
        if self.tuning.get(Tuning::GF_ACTION) == 0 {
            return true;
        }
        let (far, high) = (self.tuning.get(Tuning::GF_MAX_HOR_DIST), self.tuning.get(Tuning::GF_MAX_VER_DIST));
        let is_near = |place| self.home.is_near(far, high, place);
        is_near(from) && is_near(to) && fence::allows(self.home, live.fence, from, to)
    }

    /// How far from the fence it stops, m. On its way home it is there already where it has turned back.
    pub(super) fn fence_margin(&self) -> f32 {
        let has_turned_back = self.mode == Mode::Return && self.tuning.get(Tuning::GF_ACTION) == 3;
        if has_turned_back { 0.0 } else { self.tuning.get(Tuning::GF_MARGIN) }
    }

    /// To land at the nearest of home and the rally points within the fence, from no lower than where it is, and than the
    /// rally point says.
    #[inline(never)]
    pub(super) fn way_home(&self, live: &Live<'_>) -> Maneuver {
        let here = self.body.position;
        let rally = if self.tuning.get(Tuning::RTL_TYPE) == 0 { live.rally } else { &[] };
        let rally = rally.iter().map(|item| {
            let (north, east) = self.home.to_local(item.x, item.y);
            let height = self.home.to_height(item.frame, item.z).unwrap_or(0.0);
            Vector { north, east, down: -height }
        });
        let home = self.home.spot;
        let spot = core::iter::once(home)
            .chain(rally)
            .filter(|&spot| self.allows(live, spot, spot))
            .min_by(|a, b| here.distance(*a).total_cmp(&here.distance(*b)))
            .unwrap_or(home);
        let down = spot.down.min(here.down).min(home.down - self.tuning.get(Tuning::RTL_RETURN_ALT));
        // No higher than it may fly.
        let highest = self.tuning.get(Tuning::GF_MAX_VER_DIST);
        Maneuver::Land(Vector { down: if highest > 0.0 { down.max(home.down - highest) } else { down }, ..spot })
    }
}

/// Where to fly to land on `spot`, at `spot`'s height as long as it is far; and whether it has landed.
fn land(here: Vector, spot: Vector) -> (Vector, bool) {
    let height = Vector { down: spot.down, ..here };
    if is_over(here, spot) {
        (Vector { down: 1.0, ..spot }, here.down >= 0.0)
    } else if here.down - spot.down > 0.5 {
        (height, false)
    } else {
        (spot, false)
    }
}

/// Near enough to go straight down.
pub(super) fn is_over(here: Vector, spot: Vector) -> bool {
    here.distance(spot) <= 1.0
}
