//! The reset of all parameters by MAV_CMD_PREFLIGHT_STORAGE (P-17), which may take several polls.

use core::marker::PhantomData;

use super::service::ParamService;
use super::table::{ParamChange, ParamTable};
use super::vehicle::Parameters;
use crate::dialect::{CommandAck, MavCmd, MavResult};
use crate::link::Outbox;
use crate::message::Address;
use crate::service::{Cx, Verdict};
use crate::types::{Firmware, LinkId, LinkMask, Peer, Vehicle};

/// The maximum number of parameters that a poll resets. A parameter calls at most one hook.
const STEP: u8 = 255;

/// No progress, in a COMMAND_ACK.
const NO_PROGRESS: u8 = u8::MAX;

/// The reset that runs, or whose answer is pending: one at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reset {
    step: Step,
    client: Peer,
    /// The links on which the client has sent the command, until it is answered there.
    links: LinkMask,
    /// Whether read-only parameters are reset, too.
    all: bool,
}

/// With this representation `None` is all zero bits.
#[derive(Clone, Copy, Debug)]
#[repr(u8)]
enum Step {
    None,
    /// The parameters before this one are reset.
    Running(u16),
    Done(MavResult),
}

impl Reset {
    pub(super) const NONE: Self = Self {
        step: Step::None,
        client: Peer { address: Address::new(0, 0), link: LinkId(0) },
        links: LinkMask::NONE,
        all: false,
    };

    /// Begins with the first parameter.
    pub(super) const fn begin(client: Peer, all: bool) -> Self {
        Self { step: Step::Running(0), client, links: LinkMask::of(client.link), all }
    }

    /// Returns whether the command for a reset can be executed: `None` if it can. While another reset has not ended, it is refused,
    /// unless it is a retransmission of the same command. That is answered with its original, also on another link.
    pub(super) fn admit(&mut self, from: Peer, all: bool) -> Option<Verdict> {
        match self.step {
            Step::None => None,
            _ if self.client.address == from.address && self.all == all => {
                self.links = self.links.with(LinkMask::of(from.link));
                Some(Verdict::Later)
            }
            _ => Some(Verdict::Refused(MavResult::TEMPORARILY_REJECTED.into())),
        }
    }

    /// Whether a poll continues it.
    pub(super) const fn is_running(&self) -> bool {
        matches!(self.step, Step::Running(_))
    }

    /// Whether its answer is pending on this link.
    pub(super) fn is_done_on(&self, link: LinkId) -> bool {
        matches!(self.step, Step::Done(_)) && self.links.contains(link)
    }

    /// Records that the answer was sent on a link, or is dropped.
    pub(super) fn forget(&mut self, link: LinkId) {
        self.links = self.links.without(LinkMask::of(link));
        if self.links.is_empty() && !self.is_running() {
            self.step = Step::None;
        }
    }

    /// Sends the answer.
    pub(super) fn answer(&mut self, tx: &mut Outbox) -> bool {
        let Step::Done(result) = self.step else { return false };
        self.forget(tx.link());
        tx.send(&CommandAck {
            command: MavCmd::PREFLIGHT_STORAGE,
            result,
            progress: NO_PROGRESS,
            result_param2: 0,
            target_system: self.client.address.system.wire(),
            target_component: self.client.address.component.wire(),
        })
    }
}

impl ParamService {
    /// Resets the next parameters. Returns the result after the last one: the client is answered with it. A vehicle that arms
    /// meanwhile keeps the values that are not reset yet.
    pub(super) fn run_reset<F>(&mut self, cx: &mut Cx<'_, F>) -> Option<MavResult>
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
    {
        let Reset { step: Step::Running(mut next), client, all, .. } = self.reset else { return None };
        let count = cx.parameters.table_mut().count();
        let is_armed = cx.vehicle.state().is_some_and(|state| state.is_armed());
        if !is_armed {
            for _ in 0..STEP {
                if next >= count || !cx.shared.may_continue() {
                    break;
                }
                self.reset_parameter(cx, next, all, client);
                next = next.saturating_add(1);
            }
            if next < count {
                self.reset.step = Step::Running(next);
                return None;
            }
        }
        self.reset.step = Step::None;
        self.write_now(cx.now, cx.parameters);
        Some(if is_armed { MavResult::TEMPORARILY_REJECTED } else { MavResult::ACCEPTED })
    }

    /// Continues a reset. The answer becomes pending after the last parameter.
    pub(super) fn poll_reset<F>(&mut self, cx: &mut Cx<'_, F>)
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Vehicle + Parameters<Table = F::Parameters>>,
    {
        if let Some(result) = self.run_reset(cx)
            && !self.reset.links.is_empty()
        {
            self.reset.step = Step::Done(result);
        }
    }

    /// Resets a parameter to its default for the client `from`.
    fn reset_parameter<F>(&mut self, cx: &mut Cx<'_, F>, index: u16, resets_read_only: bool, from: Peer)
    where
        F: Firmware<Parameters: ParamTable, Vehicle: Parameters<Table = F::Parameters>>,
    {
        let Some((info, _)) = cx.parameters.table_mut().get(index) else { return };
        let bits = info.default_bits();
        let is_reset = resets_read_only || !info.is_read_only();
        if is_reset && self.with_table(cx.parameters, |table| table.change(index, bits, cx.shared.normal)) {
            let change = ParamChange { index, bits, from: Some(from), table: PhantomData };
            let (vehicle, mut context) = cx.hook();
            vehicle.parameter_changed(&mut context, &change);
        }
    }
}
