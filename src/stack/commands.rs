//! The firmware's view of commands.

use super::{Declares, Stack};
use crate::service::command::CommandService;
use crate::types::{HookFaults, LinkId};

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Whether every command that was received on `link` was answered, down to the last byte that the transport takes.
    /// Bytes in the UART's own buffers are not known to the stack.
    ///
    /// Use it for commands after which the vehicle cannot answer, above all a reboot (C-30): store [`Command::from`],
    /// and reset when this returns true, or after a second if the link is stalled.
    ///
    /// [`Command::from`]: crate::Command::from
    pub fn has_answered(&self, link: LinkId) -> bool {
        let index = usize::from(link.0);
        let link = self.links.get(index).zip(self.states.get(index));
        link.is_none_or(|(link, state)| {
            CommandService::<D::Commands>::has_answered(&state.command) && !link.port.outbox.has_frame()
        })
    }
    /// Returns the counters of answers of the vehicle's hooks that promised what did not happen.
    pub fn hook_faults(&self) -> HookFaults {
        self.shared.faults
    }
}
