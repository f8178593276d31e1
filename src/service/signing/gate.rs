//! What the stack asks about each frame, and the service of SETUP_SIGNING.

use super::setup::{self, Answer};
use super::{Signing, SigningLink, SigningStream, TEN};
use crate::dialect::{MavModeFlag, MavSeverity, SetupSigning};
use crate::frame::{Decoder, Frame, Version, signature_cost};
use crate::link::Port;
use crate::message::{Message, Text};
use crate::num;
use crate::service::{About, Cx, Handled, Received, Service, ShowCounters, SigningGate, StackEvent, Turn, View};
use crate::time::{Duration, Instant};
use crate::types::{Accept, Firmware, ONE_FRAME, SignedAt, Vehicle};

/// The minimum time between two texts about a clock that is too far ahead.
const TEXT_PAUSE: Duration = Duration::from_secs(10);

impl<F: Firmware<Vehicle: Vehicle>, const STREAMS: usize> Service<F> for Signing<[SigningStream; STREAMS]> {
    const NEW: Self = Self::new();
    type Link = SigningLink;
    const VACANT: SigningLink = SigningLink { setup: Answer::None, hint_from: Instant::ZERO };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::SigningText]);
    type Reply = Answer;

    /// Reports a system whose clock is too far ahead: it cannot read the text, but others can (G-17).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut SigningLink>) {
        self.clock = cx.shared.clock;
        if let Some(system) = self.ahead.take()
            && F::HAS_TEXTS
            && cx.now >= self.text_from
        {
            self.text_from = cx.now + TEXT_PAUSE;
            let mut text = Text::<ONE_FRAME>::new("System ");
            text.push_number(u32::from(system.wire()));
            text.push_str(" refused: its clock is too far ahead");
            cx.text(MavSeverity::WARNING, text.as_bytes());
        }
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut SigningLink,
        received: &Received<'_>,
    ) -> Handled {
        if received.frame.id() != SetupSigning::ID {
            return Handled::No;
        }
        // In a fault, it is not known whether the vehicle is armed.
        let is_disarmed = cx.vehicle.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED));
        let is_ours = received.target.system == cx.shared.config.address.get().system;
        setup::receive(self, cx.now, port, link, received.frame, is_ours, is_disarmed)
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, _: &Port, link: &SigningLink, _: Turn) -> Option<(Instant, Answer)> {
        (link.setup != Answer::None).then_some((view.now, link.setup))
    }

    fn send(&mut self, _: &mut Cx<'_, F>, port: &mut Port, link: &mut SigningLink, answer: Answer) -> bool {
        link.setup = Answer::None;
        answer.send(port)
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        if let StackEvent::Begun(config) = event {
            self.most_ahead = num::quotient(config.max_signing_lead.as_micros(), TEN);
        }
    }
}

impl<const STREAMS: usize> SigningGate<SigningLink> for Signing<[SigningStream; STREAMS]> {
    fn admits(&mut self, now: Instant, port: &mut Port, link: &mut SigningLink, frame: &Frame<'_>) -> bool {
        Signing::admits(self, now, port, link, frame)
    }

    fn knows_sender(&self, port: &Port, frame: &Frame<'_>) -> bool {
        match self.accept(&port.config.signing) {
            Accept::Open => true,
            Accept::SignedExcept(_) => !self.is_active() || frame.header().is_signed(),
            Accept::Required => self.is_active() && frame.header().is_signed(),
        }
    }

    fn believes_unsigned(&self, port: &Port, id: u32) -> bool {
        self.accept(&port.config.signing).takes_unsigned(id, self.is_active())
    }

    fn age(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration> {
        self.age_at(now, frame)
    }

    fn signed_at(&self, frame: &Frame<'_>) -> SignedAt {
        Signing::signed_at(self, frame)
    }

    fn cost(&self, frame: &Frame<'_>) -> u32 {
        if frame.header().is_signed() && self.is_active() { signature_cost(frame.raw().len()) } else { 0 }
    }

    fn has_key(&self) -> bool {
        self.is_active()
    }

    fn vouches_for(&self, raw: &[u8], work: &mut u32) -> bool {
        self.key.as_ref().is_some_and(|key| {
            *work = work.saturating_sub(signature_cost(raw.len()));
            key.has_signed(raw)
        })
    }

    fn prepare(&mut self, now: Instant, port: &mut Port) {
        let signs = self.is_active() && port.config.signing.signs() && self.has_stamp(now);
        port.outbox.set_signs(signs);
        // MAVLink 1 has no signatures (V-3).
        if signs {
            port.outbox.set_version(Version::V2);
        }
    }

    fn sign(&mut self, now: Instant, port: &mut Port) {
        if port.outbox.needs_signature() {
            let timestamp = self.stamp(now);
            port.outbox.sign(self.key.as_ref().zip(timestamp));
        }
    }

    fn wipe(&self, id: u32, decoder: &mut Decoder) {
        if id == SetupSigning::ID {
            decoder.wipe();
        }
    }
}
