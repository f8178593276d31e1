//! SETUP_SIGNING: a peer sets or removes the key (G-11, G-12, SEC-6).
//!
//! It is accepted only on a provisioning link, if it is addressed to this component by its system's number, and while
//! the vehicle is disarmed. Its timestamp must be at most ten minutes ahead, if the vehicle has set the time.
//!
//! The message has no acknowledgement, and a ground station that turns on its own signing without one may hear nothing
//! more. So an accepted message is answered at once by a HEARTBEAT, signed with the new key, or unsigned if the key was
//! removed, and by a text. A refused one is answered by an unsigned text. An unsigned text also tells a ground station
//! that it signs with a wrong key, on a link where it could set the key.

use zeroize::Zeroize;

use super::{Signing, SigningLink};
use crate::dialect::{MavSeverity, SetupSigning, Statustext};
use crate::frame::{Frame, SigningKey};
use crate::link::Port;
use crate::message::Text;
use crate::service::{Handled, increment};
use crate::time::{Duration, Instant};
use crate::types::Accept;

/// Minimum time between two hints on a link.
const HINT_PAUSE: Duration = Duration::from_secs(10);

/// The pending text about SETUP_SIGNING on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Answer {
    /// No text is pending; zero bits.
    None,
    Set,
    Off,
    Armed,
    Place,
    Time,
    Often,
    /// Unsolicited: received frames are signed with another key. An answer replaces it.
    WrongKey,
    /// Unsolicited: frames are refused because the stored key is lost. An answer replaces it.
    LostKey,
}

impl Answer {
    const fn is_refusal(self) -> bool {
        matches!(self, Self::Armed | Self::Place | Self::Time | Self::Often) || self.is_hint()
    }

    const fn is_hint(self) -> bool {
        matches!(self, Self::WrongKey | Self::LostKey)
    }

    const fn text(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Set => "Signing key set",
            Self::Off => "Signing is off",
            Self::Armed => "Signing not changed: vehicle is armed",
            Self::Place => "Signing not changed: not by this link",
            Self::Time => "Signing not changed: bad timestamp",
            Self::Often => "Signing not changed: stored too often, try later",
            Self::WrongKey => "Wrong signing key: set it again on this link",
            Self::LostKey => "Signing key lost: set it again on this link",
        }
    }

    /// Sends the text.
    pub(super) fn send(self, port: &mut Port) -> bool {
        let severity = if self.is_refusal() { MavSeverity::WARNING } else { MavSeverity::INFO };
        if self.is_refusal() {
            // Unsigned, so that a station with another key accepts it too.
            port.outbox.set_signs(false);
        }
        port.outbox.send(&Statustext { severity, text: Text::new(self.text()), ..Statustext::default() })
    }
}

/// Handles SETUP_SIGNING. `is_ours`: the frame is addressed to our system by its id.
pub(super) fn receive(
    signing: &mut Signing,
    now: Instant,
    port: &mut Port,
    link: &mut SigningLink,
    frame: &Frame<'_>,
    is_ours: bool,
    is_disarmed: bool,
) -> Handled {
    if !is_ours {
        return Handled::OutOfPlace;
    }
    if link.setup != Answer::None && !link.setup.is_hint() {
        return Handled::NoRoom;
    }
    let answer = match frame.decode::<SetupSigning>() {
        _ if !port.config.signing.provisioning => Answer::Place,
        _ if !is_disarmed => Answer::Armed,
        _ if !signing.bears_key(now) => Answer::Often,
        Some(mut setup) => {
            let answer = set_up(signing, now, &setup);
            setup.secret_key.0.zeroize();
            answer
        }
        None => return Handled::Yes,
    };
    link.setup = answer;
    if answer.is_refusal() {
        increment(&mut signing.counters.refused_setups);
    } else {
        increment(&mut signing.counters.setups);
        signing.wear_key(now);
        port.facts.is_sign_of_life_due = true;
    }
    Handled::Yes
}

fn set_up(signing: &mut Signing, now: Instant, setup: &SetupSigning) -> Answer {
    if setup.initial_timestamp == 0 && setup.secret_key.0.iter().all(|byte| *byte == 0) {
        signing.clear_key();
        return Answer::Off;
    }
    if !signing.takes_setup(now, setup.initial_timestamp) {
        return Answer::Time;
    }
    signing.replace_key(now, SigningKey::new(setup.secret_key.0), setup.initial_timestamp);
    Answer::Set
}

/// Schedules a hint after a frame was refused because it has no signature of our key. On a link that accepts
/// SETUP_SIGNING unsigned, its sender can set the key, and would otherwise get no answer to anything (G-11, G-18).
pub(super) fn hint(now: Instant, port: &Port, link: &mut SigningLink, answer: Answer) {
    let signing = &port.config.signing;
    // Every provisioning link accepts the first key.
    let is_open = signing.provisioning && (answer == Answer::LostKey || signing.accept == Accept::Open);
    if is_open && link.setup == Answer::None && now >= link.hint_from {
        link.setup = answer;
        link.hint_from = now + HINT_PAUSE;
    }
}
