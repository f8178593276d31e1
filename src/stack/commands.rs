//! Commands as the stack sees them beside COMMAND_LONG and COMMAND_INT: the one that takes one back, the mode's old message,
//! and when an answer has left.

use super::{Context, Core, Stack, count};
use crate::dialect::{CommandCancel, CommandInt, CommandLong, MissionSetCurrent, SetMode};
use crate::frame::{Address, Frame};
use crate::link::{LinkId, Peer, Port};
use crate::service::command::{self, Origin};
use crate::service::mission::{self, PlanStorage};
use crate::service::mode;
use crate::vehicle::{Autopilot, Command};

impl<const LINKS: usize, P: PlanStorage, const PEERS: usize, const TEXTS: usize, const STREAMS: usize>
    Stack<LINKS, P, PEERS, TEXTS, STREAMS>
{
    /// Whether every command that came by `link` has got its answer, down to the last byte that the transport takes. What is
    /// still in the UART's own buffers the stack does not see.
    ///
    /// For commands after which there is no answering, a reboot above all (C-30): remember [`Command::from`] and reset when
    /// this is true, or after a second, should the line be stuck.
    ///
    /// [`Command::from`]: crate::Command::from
    pub fn has_answered(&self, link: LinkId) -> bool {
        let link = self.links.get(usize::from(link.0));
        link.is_none_or(|link| link.port.acks.is_empty() && link.port.outbox.is_empty())
    }
}

impl Core {
    /// Takes back a command (COMMAND_CANCEL, C-23). False when the frame is none.
    #[inline(never)]
    pub(super) fn on_cancel<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        frame: &Frame<'_>,
        target: Address,
    ) -> bool {
        if context.vehicle.command_memory().is_none() {
            return false;
        }
        let Some(message) = frame.decode::<CommandCancel>() else { return false };
        if target == self.config.address.get() {
            let from = Peer { address: frame.source(), link: port.id };
            command::cancel(message.command, from, context.vehicle);
            self.has_acted = true;
        } else {
            count(&mut port.counters.out_of_place);
        }
        true
    }
}

/// Returns the item of a MISSION_SET_CURRENT whose sender is not authorised to give the equivalent command (M-46).
#[inline(never)]
pub(super) fn refused_item(frame: &Frame<'_>, origin: Origin, vehicle: &impl Autopilot) -> Option<u16> {
    let message = frame.decode::<MissionSetCurrent>()?;
    let is_allowed = command::is_allowed(&mission::from_set_current(&message, origin), vehicle);
    (!is_allowed).then_some(message.seq)
}

/// The command of a COMMAND_LONG or COMMAND_INT, or of a SET_MODE where that is one in all but form; with its `custom_mode`
/// then. Not inlined: no message is needed any longer when the command is carried out.
#[inline(never)]
pub(super) fn command_of(frame: &Frame<'_>, origin: Origin, has_set_mode: bool) -> Option<(Command, Option<u32>)> {
    if let Some(message) = frame.decode::<CommandLong>() {
        return Some((command::from_long(&message, origin), None));
    }
    if let Some(message) = frame.decode::<CommandInt>() {
        return Some((command::from_int(&message, origin), None));
    }
    let message = frame.decode::<SetMode>().filter(|_| has_set_mode)?;
    Some((mode::from_set_mode(&message, origin), Some(message.custom_mode)))
}
