//! PLAY_TUNE, counted: the example of a service, which the recipe in CONTRIBUTING.md refers to. Only unit tests compile it.
//!
//! Implements <https://mavlink.io/en/messages/common.html#PLAY_TUNE> as far as an example needs it: a received tune is not
//! played. It is counted, and the link on which it was received sends the count in a NAMED_VALUE_INT. Tunes that are received
//! before the link has room share one answer.

use super::{About, Cx, Handled, Received, Service, Turn, View};
use crate::dialect::{NamedValueInt, PlayTune};
use crate::link::Port;
use crate::message::{Message, Text};
use crate::time::Instant;
use crate::types::Firmware;

/// Counts the tunes that peers send.
#[derive(Clone, Debug)]
pub struct Tunes {
    received: u32,
}

impl Tunes {
    /// Returns the number of received tunes. Wraps.
    pub const fn received(&self) -> u32 {
        self.received
    }
}

/// The state of the service on a link.
#[derive(Clone, Copy, Debug)]
pub struct TuneLink {
    is_answer_pending: bool,
}

impl<F: Firmware> Service<F> for Tunes {
    const NEW: Self = Self { received: 0 };
    type Link = TuneLink;
    const VACANT: TuneLink = TuneLink { is_answer_pending: false };
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Answer]);
    type Reply = ();

    /// Receiving changes state and sends nothing.
    fn on_frame(&mut self, _: &mut Cx<'_, F>, _: &mut Port, link: &mut TuneLink, received: &Received<'_>) -> Handled {
        if received.frame().id() != PlayTune::ID {
            return Handled::No;
        }
        self.received = self.received.wrapping_add(1);
        link.is_answer_pending = true;
        Handled::Yes
    }

    /// There is one kind of frame, so its reply has no name.
    fn pending(&self, view: &View<'_>, _: &Port, link: &TuneLink, _: Turn) -> Option<(Instant, ())> {
        link.is_answer_pending.then_some((view.now(), ()))
    }

    /// Sends the answer, which is built when the link has room for it.
    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut TuneLink, (): ()) -> bool {
        link.is_answer_pending = false;
        port.send(&NamedValueInt {
            time_boot_ms: cx.now().time_boot_ms(),
            value: self.received.cast_signed(),
            name: Text::new("TUNES"),
        })
    }
}
