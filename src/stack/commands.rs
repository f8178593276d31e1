//! Commands as the stack sees them beside COMMAND_LONG and COMMAND_INT: the one that takes one back, the mode's old message,
//! and when an answer has left.

use super::receive::origin;
use super::{Context, Core, Stack, count_drop};
use crate::dialect::{CommandCancel, SetMode};
use crate::frame::{Address, Frame};
use crate::link::{LinkClass, LinkId, Peer, Port};
use crate::service::mission::PlanStorage;
use crate::service::{command, mode};
use crate::vehicle::Autopilot;

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
    /// Takes a message that is a command in all but form: COMMAND_CANCEL, and SET_MODE where the vehicle has modes. False
    /// when it is neither.
    #[inline(never)]
    pub(super) fn on_command_frame<V: Autopilot, P: PlanStorage>(
        &mut self,
        context: &mut Context<'_, V, P>,
        port: &mut Port,
        frame: &Frame<'_>,
        target: Address,
    ) -> bool {
        let from = Peer { address: frame.source(), link: port.id };
        if context.vehicle.command_memory().is_some()
            && let Some(message) = frame.decode::<CommandCancel>()
        {
            // Not for everyone (C-23).
            if target == self.config.address.get() {
                command::cancel(message.command, from, context.vehicle);
                self.has_acted = true;
            } else {
                count_drop(&mut port.counters.out_of_place, frame, "not for everyone");
            }
            return true;
        }
        if V::MODES.is_empty() || port.config.class == LinkClass::HighLatency {
            return false;
        }
        let Some(message) = frame.decode::<SetMode>() else { return false };
        let command = mode::from_set_mode(&message, origin(context, port, frame));
        self.on_command(context, port, frame, &command, Some(message.custom_mode));
        true
    }
}
