//! SETUP_SIGNING: somebody sets the key, or takes it away (G-11, G-12).
//!
//! Only on a link that is made for it, for this component by its system's number, while the vehicle is disarmed, and with no
//! timestamp that is more than a day ahead, if the vehicle has told what time it is. The message has no acknowledgement, and a
//! ground station that turns its own signing on by hope alone goes deaf. So what was accepted is answered at once by a HEARTBEAT,
//! signed with the new key, or unsigned when there is none any longer, and by a text; what was refused by an unsigned text. An
//! unsigned text also tells a ground station that it signs with a wrong key, on a link where it could set the key.

use zeroize::Zeroize;

use super::{Accept, Signing, count};
use crate::dialect::{MavModeFlag, MavSeverity, SetupSigning, Statustext};
use crate::frame::{Frame, SigningKey};
use crate::link::Port;
use crate::message::{Message, Text};
use crate::time::{Duration, Instant};
use crate::vehicle::Vehicle;

/// Minimum time between two hints on a link.
const HINT_PAUSE: Duration = Duration::from_secs(10);

/// The pending text about SETUP_SIGNING on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) enum Answer {
    /// Nothing; zero bits.
    None,
    Set,
    Off,
    Armed,
    Place,
    Time,
    Often,
    /// Unsolicited: frames are received that are signed with another key. An answer replaces it.
    WrongKey,
    /// Nobody asked: frames are refused because the stored key is lost. Gives way to an answer.
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
}

/// Takes SETUP_SIGNING; false for other messages. A vehicle without a memory for signing has no use for it, and its hook for
/// messages, which may log them, no business with a key. `is_ours`: whether the frame is for our system by its number.
pub(crate) fn on_frame(
    now: Instant,
    port: &mut Port,
    frame: &Frame<'_>,
    is_ours: bool,
    vehicle: &mut impl Vehicle,
) -> bool {
    if frame.id() != SetupSigning::ID {
        return false;
    }
    // What the vehicle is doing is not known in a fault.
    let is_disarmed = vehicle.state().is_some_and(|state| !state.base_mode.contains(MavModeFlag::SAFETY_ARMED));
    let Some(signing) = vehicle.signing() else {
        count(&mut port.counters.out_of_place);
        return true;
    };
    if !is_ours {
        count(&mut port.counters.out_of_place);
        return true;
    }
    if port.setup != Answer::None && !port.setup.is_hint() {
        count(&mut port.counters.no_answer_slot);
        return true;
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
        None => return true,
    };
    port.setup = answer;
    if answer.is_refusal() {
        count(&mut signing.counters.refused_setups);
    } else {
        count(&mut signing.counters.setups);
        signing.wear_key(now);
        port.heartbeat.postpone(now);
    }
    true
}

fn set_up(signing: &mut Signing, now: Instant, setup: &SetupSigning) -> Answer {
    if setup.initial_timestamp == 0 && setup.secret_key.0.iter().all(|byte| *byte == 0) {
        signing.clear_key();
        return Answer::Off;
    }
    if !signing.takes_setup(now, setup.initial_timestamp) {
        return Answer::Time;
    }
    signing.set_key(now, SigningKey::new(setup.secret_key.0), setup.initial_timestamp);
    Answer::Set
}

/// A frame was refused for want of the right key. On a link that takes SETUP_SIGNING unsigned its sender can set the key, and is
/// told so: it would hear no answer to anything (G-11, G-18).
pub(super) fn hint(now: Instant, port: &mut Port, answer: Answer) {
    let signing = &port.config.signing;
    // Every link for provisioning takes the first key.
    let is_open = signing.provisioning && (answer == Answer::LostKey || signing.accept == Accept::Open);
    if is_open && port.setup == Answer::None && now >= port.hint_from {
        port.setup = answer;
        port.hint_from = now.after(HINT_PAUSE);
    }
}

/// Sends the text that is pending on this link. Returns false when none is.
pub(crate) fn next(port: &mut Port) -> bool {
    let answer = core::mem::replace(&mut port.setup, Answer::None);
    if answer == Answer::None {
        return false;
    }
    let severity = if answer.is_refusal() { MavSeverity::WARNING } else { MavSeverity::INFO };
    if answer.is_refusal() {
        // Unsigned, so that a station with another key accepts it too.
        port.outbox.set_signs(false);
    }
    port.outbox.send(&Statustext { severity, text: Text::new(answer.text()), ..Statustext::default() })
}
