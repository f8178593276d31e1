//! SETUP_SIGNING: a peer sets or removes the key (G-11, G-12, SEC-6).
//!
//! It is accepted only on a provisioning link, if it is addressed to this component by its system's number, and while
//! the vehicle is disarmed. Its timestamp must be at most ten minutes ahead, if the vehicle has set the time.
//!
//! The message has no acknowledgement, and a ground station that turns on its own signing without one may hear nothing
//! more. So an accepted message is answered at once by a HEARTBEAT, signed with the new key, or unsigned if the key was
//! removed, and by a text. A refused one is answered by an unsigned text. An unsigned text also hints to a ground station
//! that it signs with a wrong key, on a link where it could set the key.

use super::Signing;
use super::timestamp::Timestamp;
use crate::dialect::{MavSeverity, SetupSigning, Statustext};
use crate::frame::SigningKey;
use crate::link::Port;
use crate::message::Text;
use crate::time::{Duration, Instant};
use crate::types::{Accept, LinkSigning};

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
