//! The stack's questions about each frame, and the service of SETUP_SIGNING.

use zeroize::Zeroize;

use super::setup::{SetupText, SigningLink};
use super::timestamp::RunningTime;
use super::{Signing, SigningStream, Verdict};
use crate::dialect::{MavModeFlag, MavSeverity, SetupSigning};
use crate::frame::{Decoder, Frame, Version, signature_cost};
use crate::link::Port;
use crate::message::{Message, Text};
use crate::service::{
    About, Cx, Handled, Received, Service, ShowCounters, SigningGate, StackEvent, Turn, View, increment,
};
use crate::time::{Duration, Instant};
use crate::types::{Accept, Firmware, LinkClass, ONE_FRAME, SignedAt, Vehicle};

/// The minimum time between two texts about a clock that is too far ahead.
const TEXT_PAUSE: Duration = Duration::from_secs(10);

impl<F: Firmware<Vehicle: Vehicle>, const STREAMS: usize> Service<F> for Signing<[SigningStream; STREAMS]> {
    const NEW: Self = Self::new();
    type Link = SigningLink;
    const VACANT: SigningLink = SigningLink::VACANT;
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::SigningText]);
    type Reply = SetupText;

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

    /// Handles SETUP_SIGNING.
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
        if received.target.system != cx.shared.config.address.get().system {
            return Handled::OutOfPlace;
        }
        if link.text != SetupText::None && !link.text.is_hint() {
            return Handled::NoRoom;
        }
        let text = if !port.config.signing.provisioning {
            SetupText::WrongLink
        } else if !is_disarmed {
            SetupText::Armed
        } else if !self.saving.has_token(cx.now) {
            SetupText::TooOften
        } else {
            let Some(mut setup) = received.frame.decode::<SetupSigning>() else { return Handled::Yes };
            let text = self.set_up(cx.now, &setup);
            setup.secret_key.0.zeroize();
            text
        };
        link.text = text;
        if text.is_success() {
            increment(&mut self.counters.setups);
            self.saving.spend_token(cx.now);
            port.facts.is_sign_of_life_due = true;
        } else {
            increment(&mut self.counters.refused_setups);
        }
        Handled::Yes
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, _: &Port, link: &SigningLink, _: Turn) -> Option<(Instant, SetupText)> {
        (link.text != SetupText::None).then_some((view.now, link.text))
    }

    fn send(&mut self, _: &mut Cx<'_, F>, port: &mut Port, link: &mut SigningLink, text: SetupText) -> bool {
        link.text = SetupText::None;
        text.send(port)
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        if let StackEvent::Begun(config) = event {
            self.max_lead = config.max_signing_lead;
        }
    }
}

impl<const STREAMS: usize> SigningGate<SigningLink> for Signing<[SigningStream; STREAMS]> {
    fn admits(&mut self, now: Instant, port: &mut Port, link: &mut SigningLink, frame: &Frame<'_>) -> bool {
        let config = &port.config.signing;
        match self.judge(now, frame) {
            Verdict::Verified(timestamp) => {
                // A frame from a satellite may contain a time from minutes ago.
                if port.config.class != LinkClass::HighLatency {
                    self.peers_time = self.peers_time.max(Some(RunningTime::new(now, timestamp)));
                }
                true
            }
            Verdict::Stale => false,
            Verdict::Forged => {
                link.hint(now, config, SetupText::WrongKey);
                false
            }
            Verdict::Unsigned => {
                let is_first_key = config.provisioning && !self.is_active() && frame.id() == SetupSigning::ID;
                let is_accepted = is_first_key || self.accepts_unsigned(port, frame.id());
                if !is_accepted {
                    increment(&mut self.counters.unsigned);
                    if self.saving.is_key_lost() && !self.is_active() {
                        link.hint(now, config, SetupText::LostKey);
                    }
                }
                is_accepted
            }
        }
    }

    fn knows_sender(&self, port: &Port, frame: &Frame<'_>) -> bool {
        match self.policy(&port.config.signing) {
            Accept::Open => true,
            Accept::SignedExcept(_) => !self.is_active() || frame.header().is_signed(),
            Accept::Required => self.is_active() && frame.header().is_signed(),
        }
    }

    fn accepts_unsigned(&self, port: &Port, id: u32) -> bool {
        self.policy(&port.config.signing).accepts_unsigned(id, self.is_active())
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
        let signs = self.is_active() && port.config.signing.signs() && self.next_timestamp(now).is_some();
        port.outbox.set_signs(signs);
        // MAVLink 1 has no signatures (V-3).
        if signs {
            port.outbox.set_version(Version::V2);
        }
    }

    fn sign(&mut self, now: Instant, port: &mut Port) {
        if port.outbox.needs_signature() {
            let timestamp = self.take_timestamp(now);
            port.outbox.sign(self.key.as_ref().zip(timestamp));
        }
    }

    fn wipe(&self, id: u32, decoder: &mut Decoder) {
        if id == SetupSigning::ID {
            decoder.wipe();
        }
    }
}
