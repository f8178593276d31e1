//! The service for parameters that live elsewhere (P-1): a [`ParamBackend`] has them, and the stack the marks of pending values.
//!
//! PREFLIGHT_STORAGE is passed on to the backend, at the rate at which peers may cause writes (C-15).

use super::backend::{ParamBackend, ParamUpdate, ParamWrite};
use super::info::{MAX_PARAMS, ParamInfo};
use super::state::State;
use super::table::{ParamMemory, Rows, Table};
use super::{Links, List, NOTHING, Options, ParamHash, capability, handles, is_armed, storage_action};
use crate::dialect::{MavCmd, MavResult};
use crate::link::Port;
use crate::service::write_schedule::TokenBucket;
use crate::service::{About, Cx, Handled, Received, Request, Service, StackEvent, Turn, Verdict, View};
use crate::time::Instant;
use crate::types::{Firmware, LinkMask, Values, Vehicle};

/// Number of updates that a poll takes from the backend.
const UPDATES: usize = 4;

/// What the stack keeps of up to `N` parameters that live elsewhere: for each the links on which its value is pending, two bytes.
/// [`ParamBackend`] has the example.
#[derive(Clone, Debug)]
pub struct ExternalParams<const N: usize> {
    pending: [LinkMask; N],
    state: State<Size>,
}

/// The number of parameters, once it is known.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    count: u16,
    is_known: bool,
}

/// [`ExternalParams`] of any length.
#[derive(Debug)]
pub struct MarksMut<'a> {
    pending: &'a mut [LinkMask],
    state: &'a mut State<Size>,
}

impl MarksMut<'_> {
    /// Returns the number of parameters.
    pub(super) const fn count(&self) -> u16 {
        self.state.kept.count
    }
}

/// [`ExternalParams`] of one length.
pub trait Marks {
    fn marks(&mut self) -> MarksMut<'_>;
}

impl<const N: usize> Marks for ExternalParams<N> {
    fn marks(&mut self) -> MarksMut<'_> {
        MarksMut { pending: &mut self.pending, state: &mut self.state }
    }
}

impl<const N: usize> Values for ExternalParams<N> {
    fn values(&self) -> &[u32] {
        &[]
    }
}

impl<const N: usize> ParamMemory for ExternalParams<N> {
    type Service = ExternalService;

    const VACANT: Self = {
        assert!(N > 0 && N <= MAX_PARAMS, "a backend has 1 to 32,768 parameters: `ExternalParams<64>`");
        Self { pending: [LinkMask::NONE; N], state: State::new(Size { count: 0, is_known: false }) }
    };

    fn begin(&mut self) {}
}

/// The parameters of a backend.
pub(super) struct Backed<'a, B> {
    pub(super) backend: &'a B,
    pub(super) count: u16,
}

impl<B: ParamBackend> Rows for Backed<'_, B> {
    type Info = ParamInfo;
    type Kept = Size;

    fn count(&self) -> u16 {
        self.count
    }

    fn get(&self, index: u16) -> Option<(ParamInfo, u32)> {
        if index >= self.count {
            return None;
        }
        Some((self.backend.param_info(index)?, self.backend.param_bits(index)?))
    }

    fn find(&self, name: &[u8; 16]) -> Option<u16> {
        let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
        self.backend.find_param(name).filter(|index| *index < self.count)
    }
}

/// Lists, reads and sets the parameters of a backend.
#[derive(Debug)]
pub struct ExternalService {
    links: Links,
    /// The links on which all values must be sent, after the active list.
    relisted: LinkMask,
    /// Limits the writes that peers cause.
    bucket: TokenBucket,
}

impl ExternalService {
    /// Returns the parameters, updated for reopened links.
    fn table<'t, B: ParamBackend>(&mut self, marks: &'t mut impl Marks, backend: &'t B) -> Table<'t, Backed<'t, B>> {
        let MarksMut { pending, state } = marks.marks();
        self.links.catch_up(state);
        let size = &mut state.kept;
        if !size.is_known {
            let room = u16::try_from(pending.len()).unwrap_or(u16::MAX);
            *size = Size { count: backend.param_count().min(room), is_known: true };
        }
        let rows = Backed { backend, count: size.count };
        Table { rows, pending, state }
    }

    /// Updates the cached state from the table.
    fn cache<B: ParamBackend>(&mut self, table: &Table<'_, Backed<'_, B>>) {
        self.links.cache(table);
    }
}

/// What the service sends.
#[derive(Clone, Copy, Debug)]
pub enum ExternalReply {
    /// A refusal, the hash, or a value that was requested or has changed.
    Answer,
    /// The next value of the list.
    Listed,
    /// The first value of a list that no client has requested: all values may have changed.
    First,
}

const fn options<B: ParamBackend>() -> Options {
    let hash = if B::SORTED { B::PARAM_HASH } else { ParamHash::Never };
    Options::new(B::PARAM_ENCODING, hash, B::PARAM_ERROR)
}

impl<F> Service<F> for ExternalService
where
    F: Firmware<Parameters: Marks, Vehicle: Vehicle + ParamBackend>,
{
    const NEW: Self = Self { links: Links::NEW, relisted: LinkMask::NONE, bucket: TokenBucket::NONE };
    type Link = List;
    const VACANT: List = List::new();
    type Reply = ExternalReply;
    const ABOUT: About = About {
        turns: &[Turn::ParamAnswer, Turn::LateParamList, Turn::ParamList],
        capabilities: capability(F::Vehicle::PARAM_ENCODING),
        ..About::AUTOPILOT
    };

    /// Takes what has changed in the backend (P-16).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut List>) {
        for _ in 0..UPDATES {
            let update = cx.vehicle.take_update();
            let mut table = self.table(cx.parameters, cx.vehicle);
            match update {
                ParamUpdate::Nothing => break,
                ParamUpdate::One(index) if index < table.count() => table.mark_pending(index, cx.shared.normal),
                ParamUpdate::One(_) => {}
                ParamUpdate::All => self.relisted = cx.shared.normal,
            }
            self.cache(&table);
        }
        if self.links.is_hashing {
            let mut table = self.table(cx.parameters, cx.vehicle);
            table.compute_hash();
            self.cache(&table);
        }
    }

    fn deadline(&self) -> Instant {
        self.links.hash_deadline()
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, list: &mut List, received: &Received<'_>) -> Handled {
        if !handles(received.frame.id()) {
            return Handled::No;
        }
        let options = options::<F::Vehicle>().on(port);
        let mut table = self.table(cx.parameters, cx.vehicle);
        let request = table.on_request(cx.now, cx.texts, options, list, received);
        self.cache(&table);
        let (index, bits) = match request {
            Ok(handled) => return handled,
            Err(set) => set,
        };
        // Everything but the backend's decision is checked, and there is a slot for a refusal.
        let verdict = bits.map(|bits| {
            let (vehicle, mut context) = cx.hook();
            vehicle.set_param(&mut context, &ParamWrite { index, bits, from: received.from })
        });
        let mut table = self.table(cx.parameters, cx.vehicle);
        if let Some(verdict) = verdict {
            table.on_decided(cx.now, cx.texts, options, received.from, index, verdict);
        }
        table.mark_pending(index, cx.shared.normal);
        self.cache(&table);
        Handled::Yes
    }

    /// MAV_CMD_PREFLIGHT_STORAGE (P-17).
    fn on_command(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut List, request: &Request) -> Option<Verdict> {
        let command = &request.command;
        if command.id != MavCmd::PREFLIGHT_STORAGE {
            return None;
        }
        let refused = |result: MavResult| Some(Verdict::Refused(result.into()));
        let Ok(action) = storage_action(&command.params, true) else { return refused(MavResult::DENIED) };
        let writes = matches!(action, 1 | 2 | 4);
        if is_armed(cx.vehicle) || (writes && !self.bucket.has(cx.now, 1)) {
            return refused(MavResult::TEMPORARILY_REJECTED);
        }
        let (vehicle, mut context) = cx.hook();
        let result = match action {
            NOTHING => return Some(Verdict::done(MavResult::ACCEPTED)),
            0 => vehicle.load_params(&mut context),
            1 => vehicle.save_params(&mut context),
            _ => vehicle.reset_params(&mut context, action == 4),
        };
        if writes {
            self.bucket.spend(cx.now, 1);
        }
        if action != 1 && result == MavResult::ACCEPTED {
            self.relisted = cx.shared.normal;
        }
        Some(Verdict::done(result))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, list: &List, turn: Turn) -> Option<(Instant, ExternalReply)> {
        match turn {
            Turn::ParamAnswer => self.links.is_pending(port.id).then_some((view.now, ExternalReply::Answer)),
            _ if self.links.is_list_held(port.id) => None,
            Turn::LateParamList => Some((list.late_at(), ExternalReply::Listed)),
            _ if list.is_active() => Some((list.due(), ExternalReply::Listed)),
            _ if self.relisted.contains(LinkMask::of(port.id)) => Some((list.begins_at(), ExternalReply::First)),
            _ => None,
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, list: &mut List, reply: ExternalReply) -> bool {
        let options = options::<F::Vehicle>();
        match reply {
            ExternalReply::Answer => {
                let mut table = self.table(cx.parameters, cx.vehicle);
                let is_sent = table.send_answer(options, list, &mut port.outbox);
                self.cache(&table);
                return is_sent;
            }
            ExternalReply::First => {
                self.relisted = self.relisted.without(LinkMask::of(port.id));
                list.begin(cx.now);
            }
            ExternalReply::Listed => {}
        }
        self.table(cx.parameters, cx.vehicle).send_listed(options, cx.now, list, port)
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(config) => self.bucket.set_refill(config.storage_refill),
            StackEvent::Opened(port, list) => {
                list.end();
                self.links.restart(port.id);
                self.relisted = self.relisted.without(LinkMask::of(port.id));
            }
            _ => {}
        }
    }
}
