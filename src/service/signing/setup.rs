//! SETUP_SIGNING: a peer sets or removes the key (G-11, G-12, SEC-6).
//!
//! It is accepted only on a provisioning link, if it is addressed to this component by its system's number, and while
//! the vehicle is disarmed. Its timestamp must be at most ten minutes ahead, if the vehicle has set the time.
//!
//! The message has no acknowledgement, and a ground station that turns on its own signing without one may hear nothing
//! more. So an accepted message is answered at once by a HEARTBEAT, signed with the new key, or unsigned if the key was
//! removed, and by a text. A refused one is answered by an unsigned text. An unsigned text also hints to a ground
//! station that it signs with a wrong key, on a link where it could set the key.

use zeroize::Zeroize;

use super::timestamp::Timestamp;
use super::{Signing, SigningStream};
use crate::dialect::{MavModeFlag, MavSeverity, SetupSigning, Statustext};
use crate::frame::SigningKey;
use crate::link::Port;
use crate::message::{Message, Text};
use crate::service::{About, Cx, Handled, Received, Service, ShowCounters, StackEvent, Turn, View, increment};
use crate::time::{Duration, Instant};
use crate::types::{Accept, Firmware, LinkSigning, ONE_FRAME, Vehicle};

/// The minimum time between two texts about a clock that is too far ahead.
const TEXT_PAUSE: Duration = Duration::from_secs(10);

/// The minimum time between two hints on a link.
const HINT_PAUSE: Duration = Duration::from_secs(10);

/// A text about SETUP_SIGNING.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SetupText {
    /// No text is pending; zero bits.
    None,
    KeySet,
    KeyRemoved,
    Armed,
    WrongLink,
    BadTimestamp,
    TooOften,
    /// A hint: received frames are signed with another key.
    WrongKey,
    /// A hint: frames are refused because the stored key is lost.
    LostKey,
}

impl SetupText {
    /// Whether the key was set or removed.
    pub(super) const fn is_success(self) -> bool {
        matches!(self, Self::KeySet | Self::KeyRemoved)
    }

    /// Whether no SETUP_SIGNING has caused it. An answer replaces it.
    pub(super) const fn is_hint(self) -> bool {
        matches!(self, Self::WrongKey | Self::LostKey)
    }

    /// Sends the text.
    pub(super) fn send(self, port: &mut Port) -> bool {
        let text = match self {
            Self::None => "",
            Self::KeySet => "Signing key set",
            Self::KeyRemoved => "Signing is off",
            Self::Armed => "Signing not changed: vehicle is armed",
            Self::WrongLink => "Signing not changed: not by this link",
            Self::BadTimestamp => "Signing not changed: bad timestamp",
            Self::TooOften => "Signing not changed: stored too often, try later",
            Self::WrongKey => "Wrong signing key: set it again on this link",
            Self::LostKey => "Signing key lost: set it again on this link",
        };
        let severity = if self.is_success() {
            MavSeverity::INFO
        } else {
            // Unsigned, so that a station with another key accepts it too.
            port.outbox.set_signs(false);
            MavSeverity::WARNING
        };
        port.outbox.send(&Statustext { severity, text: Text::new(text), ..Statustext::default() })
    }
}

/// The state of signing on a link.
#[derive(Clone, Copy, Debug)]
pub struct SigningLink {
    /// The pending text.
    pub(super) text: SetupText,
    /// The earliest time of the next hint to a station that signs with another key.
    hint_from: Instant,
}

impl SigningLink {
    pub(super) const VACANT: Self = Self { text: SetupText::None, hint_from: Instant::ZERO };

    /// Schedules a hint after a frame was refused because it has no signature of our key. On a link that accepts
    /// SETUP_SIGNING unsigned, its sender can set the key, and would otherwise get no answer to anything (G-11, G-18).
    pub(super) fn hint(&mut self, now: Instant, config: &LinkSigning, hint: SetupText) {
        // Every provisioning link accepts the first key.
        let is_open = config.provisioning && (hint == SetupText::LostKey || config.accept == Accept::Open);
        if is_open && self.text == SetupText::None && now >= self.hint_from {
            self.text = hint;
            self.hint_from = now + HINT_PAUSE;
        }
    }
}

impl Signing {
    /// Executes a SETUP_SIGNING that is allowed now, and returns the answer.
    pub(super) fn set_up(&mut self, now: Instant, setup: &SetupSigning) -> SetupText {
        let timestamp = Timestamp(setup.initial_timestamp);
        if timestamp == Timestamp::ZERO && setup.secret_key.0.iter().all(|byte| *byte == 0) {
            self.clear_key();
            return SetupText::KeyRemoved;
        }
        let times = self.times(now);
        let is_ahead = timestamp > times.ours && times.is_beyond_bound(timestamp);
        if timestamp >= Timestamp::LAST || is_ahead {
            return SetupText::BadTimestamp;
        }
        self.replace_key(now, SigningKey::new(setup.secret_key.0), timestamp);
        SetupText::KeySet
    }
}

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
