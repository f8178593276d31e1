//! The stack's clock: it is never set back, whatever the firmware's clock does.

use super::{Declares, Memory, Stack};
use crate::dialect::MavSeverity;
use crate::service::{Shared, increment};
use crate::time::Instant;

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Returns the time by the stack's clock when the firmware's clock shows `now`: it is never set back.
    pub(crate) fn enter(&mut self, now: Instant) -> Instant {
        if !self.shared.clock.advance(now) {
            self.note_clock_step(now);
        }
        self.shared.clock.now()
    }

    /// Re-anchors the stack's clock, and reports it, if the firmware's was set back to `now` by a second or more.
    fn note_clock_step(&mut self, now: Instant) {
        if !self.shared.clock.anchor(now) {
            return;
        }
        let Shared { clock, clock_steps, normal, .. } = &mut self.shared;
        increment(clock_steps);
        self.services.on_clock_step(clock.lead());
        self.requests.view_mut().lead = clock.lead();
        for link in &mut self.links {
            link.port.outbox.set_lead(clock.lead());
        }
        if D::HAS_TEXTS {
            self.texts.view_mut().push(
                clock.now(),
                *normal,
                MavSeverity::WARNING,
                b"Clock was set back: check the firmware's timer",
            );
        }
    }

    /// Returns how often the clock that the firmware passes as `now` was set back by a second or more. The stack then
    /// continues from where it was, and a text says so. A counter that wraps is the usual cause: extend it to 64 bits. Wraps.
    pub fn clock_steps(&self) -> u32 {
        self.shared.clock_steps
    }
}
