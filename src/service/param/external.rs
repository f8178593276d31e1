//! The service for parameters that live elsewhere (P-1): a [`ParamBackend`] has them, and the stack the marks of pending values.
//!
//! PREFLIGHT_STORAGE is passed on to the backend, at the rate at which peers may cause writes (C-15).

use super::backend::{ParamBackend, ParamUpdate, ParamWrite};
use super::info::{MAX_PARAMS, ParamInfo, Rows};
use super::links::{ParamLinks, ParamReply};
use super::list::ParamList;
use super::requests::{ParamClient, ParamRequest, handles};
use super::state::ParamState;
use super::storage::StorageAction;
use super::table::{ParamMemory, Table};
use super::vehicle::{ParamHash, ParamOptions};
use crate::dialect::MavResult;
use crate::link::Port;
use crate::service::write_schedule::TokenBucket;
use crate::service::{About, Cx, Handled, Received, Request, Service, StackEvent, Turn, Verdict, View};
use crate::time::Instant;
use crate::types::{Firmware, LinkMask, Values, Vehicle};

/// Number of updates that a poll takes from the backend.
const UPDATES: usize = 4;

/// The stack's state of up to `N` parameters that live elsewhere: for each the links on which its value is pending, two
/// bytes. [`ParamBackend`] has the example.
#[derive(Clone, Debug)]
pub struct ExternalParams<const N: usize> {
    marks: [LinkMask; N],
    state: ParamState,
    /// The number of parameters, once it is known.
    count: Option<u16>,
}

/// [`ExternalParams`] of any length.
#[derive(Debug)]
pub struct ExternalParamsMut<'a> {
    marks: &'a mut [LinkMask],
    state: &'a mut ParamState,
    count: &'a mut Option<u16>,
}

impl<'a> ExternalParamsMut<'a> {
    /// Returns the number of parameters; 0 before the first poll.
    pub(super) fn count(&self) -> u16 {
        self.count.unwrap_or(0)
    }

    /// Returns the parameters of a backend.
    fn table<B: ParamBackend>(self, backend: &'a B) -> Table<'a, BackendRows<'a, B>> {
        let Self { marks, state, count } = self;
        let room = u16::try_from(marks.len()).unwrap_or(u16::MAX);
        let count = *count.get_or_insert_with(|| backend.param_count().min(room));
        Table { rows: BackendRows { backend, count }, marks, state }
    }
}

/// [`ExternalParams`] of one length.
pub trait AnyExternalParams {
    fn view_mut(&mut self) -> ExternalParamsMut<'_>;
}

impl<const N: usize> AnyExternalParams for ExternalParams<N> {
    fn view_mut(&mut self) -> ExternalParamsMut<'_> {
        ExternalParamsMut { marks: &mut self.marks, state: &mut self.state, count: &mut self.count }
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
        Self { marks: [LinkMask::NONE; N], state: ParamState::NEW, count: None }
    };

    fn begin(&mut self) {}
}

/// The parameters of a backend.
pub(super) struct BackendRows<'a, B> {
    pub(super) backend: &'a B,
    pub(super) count: u16,
}

impl<B: ParamBackend> Rows for BackendRows<'_, B> {
    type Info = ParamInfo;

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
    links: ParamLinks,
    /// The links on which all values must be sent, after the active list.
    relisted: LinkMask,
    /// Limits the writes that peers cause.
    bucket: TokenBucket,
}

impl ExternalService {
    /// Calls `work` with the parameters, and updates the cached state after it.
    fn with_table<'t, B: ParamBackend, R>(
        &mut self,
        parameters: &'t mut impl AnyExternalParams,
        backend: &'t B,
        work: impl FnOnce(&mut Table<'t, BackendRows<'t, B>>) -> R,
    ) -> R {
        self.links.with(parameters.view_mut().table(backend), work)
    }
}

const fn options<B: ParamBackend>() -> ParamOptions {
    let hash = if B::SORTED { B::PARAM_HASH } else { ParamHash::Never };
    ParamOptions::new(B::PARAM_ENCODING, hash, B::PARAM_ERROR)
}

impl<F> Service<F> for ExternalService
where
    F: Firmware<Parameters: AnyExternalParams, Vehicle: Vehicle + ParamBackend>,
{
    const NEW: Self = Self { links: ParamLinks::NEW, relisted: LinkMask::NONE, bucket: TokenBucket::NONE };
    type Link = ParamList;
    const VACANT: ParamList = ParamList::NEW;
    type Reply = ParamReply;
    const ABOUT: About = About {
        turns: &[Turn::ParamAnswer, Turn::LateParamList, Turn::ParamList],
        capabilities: F::Vehicle::PARAM_ENCODING.capability(),
        ..About::AUTOPILOT
    };

    /// Takes changes of the backend (P-16).
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ParamList>) {
        for _ in 0..UPDATES {
            match cx.vehicle.take_update() {
                ParamUpdate::Nothing => break,
                ParamUpdate::All => self.relisted = cx.shared.normal,
                ParamUpdate::One(index) => self.with_table(cx.parameters, cx.vehicle, |table| {
                    if index < table.count() {
                        table.queue_value(index, cx.shared.normal);
                    }
                }),
            }
        }
        self.with_table(cx.parameters, cx.vehicle, Table::compute_hash);
    }

    fn deadline(&self) -> Instant {
        self.links.hash_deadline()
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        list: &mut ParamList,
        received: &Received<'_>,
    ) -> Handled {
        if !handles(received.frame.id()) {
            return Handled::No;
        }
        let options = options::<F::Vehicle>().on(port);
        let client = ParamClient { now: cx.now, from: received.from, options, normal_links: cx.shared.normal };
        let request =
            self.with_table(cx.parameters, cx.vehicle, |table| table.on_request(cx.texts, client, list, received));
        match request {
            ParamRequest::Handled(handled) => handled,
            ParamRequest::Set { index, bits } => {
                let (vehicle, mut context) = cx.hook();
                let decision = vehicle.set_param(&mut context, &ParamWrite { index, bits, from: client.from });
                self.with_table(cx.parameters, cx.vehicle, |table| {
                    table.on_decision(cx.texts, client, index, decision);
                });
                Handled::Yes
            }
        }
    }

    /// MAV_CMD_PREFLIGHT_STORAGE (P-17).
    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        _: &mut Port,
        _: &mut ParamList,
        request: &Request,
    ) -> Option<Verdict> {
        let action = match StorageAction::of(&request.command, true, cx.vehicle)? {
            Ok(action) => action,
            Err(refusal) => return Some(Verdict::Refused(refusal)),
        };
        let writes = matches!(action, StorageAction::Write | StorageAction::Reset { .. });
        // While the bucket is empty, values that the backend has acknowledged may be unsaved: they are not taken back (C-15).
        if action != StorageAction::Nothing && !self.bucket.has(cx.now, 1) {
            return Some(Verdict::Refused(MavResult::TEMPORARILY_REJECTED.into()));
        }
        let (vehicle, mut context) = cx.hook();
        let result = match action {
            StorageAction::Nothing => MavResult::ACCEPTED,
            StorageAction::Read => vehicle.load_params(&mut context),
            StorageAction::Write => vehicle.save_params(&mut context),
            StorageAction::Reset { all } => vehicle.reset_params(&mut context, all),
        };
        if writes {
            self.bucket.spend(cx.now, 1);
        }
        let has_changed = matches!(action, StorageAction::Read | StorageAction::Reset { .. });
        if has_changed && result == MavResult::ACCEPTED {
            self.relisted = cx.shared.normal;
        }
        Some(Verdict::done(result))
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, list: &ParamList, turn: Turn) -> Option<(Instant, ParamReply)> {
        let may_begin = !list.is_active() && !self.links.is_list_held(port.id);
        if turn == Turn::ParamList && may_begin && self.relisted.contains(port.id) {
            return Some((list.begins_at(), ParamReply::Unrequested));
        }
        self.links.pending_in(turn, view.now, port.id, list)
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, list: &mut ParamList, reply: ParamReply) -> bool {
        let options = options::<F::Vehicle>();
        if let ParamReply::Unrequested = reply {
            self.relisted = self.relisted.without(LinkMask::of(port.id));
            list.begin(cx.now, None);
        }
        self.with_table(cx.parameters, cx.vehicle, |table| match reply {
            ParamReply::Answer => table.send_answer(options, list, &mut port.outbox),
            ParamReply::Listed | ParamReply::Unrequested => table.send_listed(options, cx.now, list, port),
        })
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Begun(config) => self.bucket.set_refill(config.storage_refill),
            StackEvent::Opened(port, list) => {
                self.links.reopen(port.id, list);
                self.relisted = self.relisted.without(LinkMask::of(port.id));
            }
            _ => {}
        }
    }
}
