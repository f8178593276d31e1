//! Tests of the service without the stack: encoded frames in, decoded frames out, simulated time, two links.

mod command;
mod external;
mod hash;
mod list;
mod random;
mod read;
mod set;

use std::string::String;
use std::vec;
use std::vec::Vec;

use super::list::ParamList;
use super::saving::{Replaced, Saving};
use super::value::{self, ParamEncoding, ParamType};
use super::{ParamChange, ParamHash, ParamInfo, ParamService, ParamTable, Parameters};
use crate::dialect::{
    MavCmd, MavModeFlag, MavParamError, MavParamType, MavResult, MavState, ParamError, ParamRequestList,
    ParamRequestRead, ParamSet, ParamValue,
};
use crate::frame::{MAX_FRAME_LEN, Version, encode};
use crate::link::{Link, Outbox, Port};
use crate::message::{Address, Message, Text};
use crate::network::target_of;
use crate::pulse::Pulse;
use crate::service::rest::{Rest, sent_texts, take, with_frame};
use crate::service::{Cx, Handled, Received, Request, Service, StackEvent, Turn, Verdict};
use crate::time::{Duration, Instant};
use crate::types::{
    Command, CommandPosition, Config, Context, Firmware, LinkClass, LinkConfig, LinkId, NoPlans, Peer, VehicleState,
};

crate::parameters! {
    /// Parameters with every type, flag and length of name.
    pub(super) struct Table {
        ALT_MIN: f32 = -5.0, -100.0..=100.0, "m";
        BYTE: u8 = 7, 1..=200, "";
        ID_OF_16_LETTERS: i32 = -2, -1_000..=1_000_000_000, "" { reboot_required };
        LOCKED: u32 = 4_000_000_000, 0..=u32::MAX, "" { read_only };
        NOISE: f32 = 0.5, 0.0..=1.0, "" { volatile };
        SMALL: i8 = -1, -10..=10, "";
        WIDE: i16 = -300, -1_000..=1_000, "";
        WORD: u16 = 60_000, 0..=u16::MAX, "";
    }
}

const COUNT: u16 = 8;

const VEHICLE: Address = Address::new(1, 1);
const A: Peer = Peer { address: Address::new(255, 190), link: LinkId(0) };
const B: Peer = Peer { address: Address::new(254, 190), link: LinkId(1) };

const DOES_NOT_EXIST: MavParamError = MavParamError::DOES_NOT_EXIST;
const OUT_OF_RANGE: MavParamError = MavParamError::VALUE_OUT_OF_RANGE;

/// The rate of a link with 57,600 baud.
const RATE: u32 = 5_760;

/// A frame that the service sent.
#[derive(Clone, Debug, PartialEq)]
enum Out {
    /// PARAM_VALUE: index, name, type, the bits of the value.
    Value(u16, String, MavParamType, u32),
    /// PARAM_ERROR: destination, error, index, name.
    Error(Address, MavParamError, i16, String),
}
use Out::*;

#[derive(Debug)]
struct Vehicle<const CAST: bool, const HASH: bool, const ERRORS: bool> {
    verdict: Result<(), MavParamError>,
    is_armed: bool,
    /// The index and the bits of all calls of `may_set`.
    asked: Vec<(u16, u32)>,
    /// The index and the bits of all changes.
    changed: Vec<(u16, u32)>,
}

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> Parameters for Vehicle<CAST, HASH, ERRORS> {
    type Table = Table;
    const PARAM_ENCODING: ParamEncoding = if CAST { ParamEncoding::CCast } else { ParamEncoding::Bytewise };
    const PARAM_HASH: ParamHash = if HASH { ParamHash::InList } else { ParamHash::ByName };
    const PARAM_ERROR: bool = ERRORS;

    fn may_set(&mut self, cx: &mut Context<'_>, change: &ParamChange<Table>) -> Result<(), MavParamError> {
        assert_ne!(cx.values[usize::from(change.index)], change.bits, "an equal value needs no permission");
        self.asked.push((change.index, change.bits));
        self.verdict
    }

    fn parameter_changed(&mut self, cx: &mut Context<'_>, change: &ParamChange<Table>) {
        assert_eq!(cx.values[usize::from(change.index)], change.bits, "called after the change");
        self.changed.push((change.index, change.bits));
    }
}

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> crate::Vehicle for Vehicle<CAST, HASH, ERRORS> {
    fn state(&self) -> Option<VehicleState> {
        let base_mode = if self.is_armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
        Some(VehicleState { base_mode, custom_mode: 0, system_status: MavState::STANDBY })
    }
}

/// The firmware of this vehicle.
struct Board<const CAST: bool, const HASH: bool, const ERRORS: bool>;

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> Firmware for Board<CAST, HASH, ERRORS> {
    type Vehicle = Vehicle<CAST, HASH, ERRORS>;
    type Plans = NoPlans;
    type Parameters = Table;
    type Credits = [crate::types::Credits; 0];
}

struct Bench<const CAST: bool = false, const HASH: bool = false, const ERRORS: bool = true> {
    params: ParamService,
    table: Table,
    vehicle: Vehicle<CAST, HASH, ERRORS>,
    rest: Rest,
    now: Instant,
    lists: [ParamList; 2],
    ports: [Port; 2],
}

impl Bench {
    fn new() -> Self {
        Self::of(Version::V2)
    }
}

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> Bench<CAST, HASH, ERRORS> {
    fn of(version: Version) -> Self {
        Self {
            params: Service::<Board<CAST, HASH, ERRORS>>::NEW,
            table: Table::new(),
            vehicle: Vehicle { verdict: Ok(()), is_armed: false, asked: Vec::new(), changed: Vec::new() },
            rest: Rest::new(),
            now: Instant::from_millis(60_000),
            lists: [const { ParamList::NEW }; 2],
            ports: [0, 1].map(|link| port(LinkId(link), version)),
        }
    }

    /// Returns the service with everything it needs, and its state on each link.
    fn parts(&mut self) -> (&mut ParamService, Cx<'_, Board<CAST, HASH, ERRORS>>, [(&mut Port, &mut ParamList); 2]) {
        let cx = self.rest.cx(self.now, &mut self.table, &mut self.vehicle);
        let ([port_a, port_b], [list_a, list_b]) = (&mut self.ports, &mut self.lists);
        (&mut self.params, cx, [(port_a, list_a), (port_b, list_b)])
    }

    /// Receives a frame.
    fn send<M: Message>(&mut self, from: Peer, message: &M) -> Handled {
        let mut bytes = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, from.address, 0, &mut bytes).expect("fits");
        with_frame(&bytes[..len], |frame| {
            let (params, mut cx, mut links) = self.parts();
            let (port, list) = &mut links[usize::from(from.link.0)];
            let received = Received {
                frame,
                from,
                trust: crate::types::Trust::Open,
                counts: true,
                may_change: true,
                target: target_of(frame),
                age: None,
            };
            params.on_frame(&mut cx, port, list, &received)
        })
    }

    /// Receives a frame. Returns the answers that link 0 and link 1 send then.
    fn ask<M: Message>(&mut self, from: Peer, message: &M) -> [Vec<Out>; 2] {
        assert_eq!(self.send(from, message), Handled::Yes);
        self.drain()
    }

    fn drain(&mut self) -> [Vec<Out>; 2] {
        [0, 1].map(|link| self.drain_link(link))
    }

    fn drain_link(&mut self, link: usize) -> Vec<Out> {
        let mut sent = Vec::new();
        loop {
            sent.extend(self.next(link));
            // The hash takes some polls.
            match self.params.links.has_answer(LinkId(link as u8)) {
                true => {}
                false if self.params.links.is_hashing => self.poll(),
                false => break,
            }
        }
        assert_eq!(self.next(link), None, "only pending answers are sent");
        sent
    }

    /// Returns the next answer that a link sends.
    fn next(&mut self, link: usize) -> Option<Out> {
        self.take(link, Turn::ParamAnswer)
    }

    /// Returns the next value of the list that a link sends.
    fn next_listed(&mut self, link: usize) -> Option<Out> {
        self.take(link, Turn::ParamList)
    }

    /// Returns the frame that a link sends in this turn.
    fn take(&mut self, link: usize, turn: Turn) -> Option<Out> {
        let (params, mut cx, mut links) = self.parts();
        let (port, list) = &mut links[link];
        offer(params, &mut cx, port, list, turn).then(|| decoded(&mut port.outbox))
    }

    fn poll(&mut self) {
        let (params, mut cx, [(_, list_a), (_, list_b)]) = self.parts();
        params.poll(&mut cx, [list_a, list_b].into_iter());
    }

    /// When the service's next timer is due.
    fn deadline(&self) -> Instant {
        self.params.write_due()
    }

    /// Reopens a link.
    fn restart(&mut self, link: usize) {
        let opened = StackEvent::Opened(&self.ports[link], &mut self.lists[link]);
        Service::<Board<CAST, HASH, ERRORS>>::on_event(&mut self.params, opened);
    }

    fn wait(&mut self, millis: u64) {
        self.now += Duration::from_millis(millis);
        self.poll();
    }

    /// Polls every ms for `millis` ms, and sends everything, answers first. Returns the frames that a link sent, and
    /// after how many ms.
    fn run(&mut self, link: usize, millis: u64) -> Vec<(u64, Out)> {
        let mut sent = Vec::new();
        for ms in 1..=millis {
            self.wait(1);
            if let Some(out) = self.next(link).or_else(|| self.next_listed(link)) {
                sent.push((ms, out));
            }
        }
        sent
    }

    fn command(&mut self, params: [f32; 4]) -> Option<MavResult> {
        self.command_of(MavCmd::PREFLIGHT_STORAGE, params)
    }

    fn command_of(&mut self, id: MavCmd, params: [f32; 4]) -> Option<MavResult> {
        let position = CommandPosition::Long { param5: 0.0, param6: 0.0 };
        let command = Command {
            id,
            params,
            position,
            z: 0.0,
            from: A,

            trust: crate::types::Trust::Open,
            class: LinkClass::Normal,
            age: None,
            component: crate::message::ComponentId::new(1),
            is_broadcast: false,
            confirmation: 0,
        };
        let (params, mut cx, [(port, list), _]) = self.parts();
        let request = Request::from(command);
        Some(match params.on_command(&mut cx, port, list, &request)? {
            Verdict::Done(outcome) => {
                assert_eq!(outcome, MavResult::ACCEPTED.into(), "every refusal has a reason");
                outcome.result
            }
            Verdict::Refused(refusal) => refusal.result,
        })
    }

    /// Returns the texts that a link sends.
    fn texts(&mut self, link: usize) -> Vec<String> {
        sent_texts(&mut self.rest.texts, &mut self.ports[link].outbox)
    }

    /// Returns the PARAM_VALUE of a parameter.
    fn value(&mut self, index: u16) -> Out {
        let (info, bits) = self.table.table_mut().get(index).expect("exists");
        let wire = value::to_wire(Vehicle::<CAST, HASH, ERRORS>::PARAM_ENCODING, info.param_type(), bits);
        Value(index, info.name().into(), info.param_type(), wire.to_bits())
    }

    fn values(&mut self) -> Vec<Out> {
        (0..COUNT).map(|index| self.value(index)).collect()
    }

    fn bits(&mut self, index: u16) -> u32 {
        self.table.table_mut().get(index).expect("exists").1
    }
}

/// Sends the frame that is due in a turn of a link. Returns whether one was.
fn offer<F: Firmware, S: Service<F>>(
    service: &mut S,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut S::Link,
    turn: Turn,
) -> bool {
    let pending = service.pending(&cx.view(), port, link, turn).filter(|(at, _)| *at <= cx.now);
    pending.is_some_and(|(_, reply)| service.send(cx, port, link, reply))
}

fn decoded(tx: &mut Outbox) -> Out {
    with_frame(&take(tx), |frame| {
        let text = |text: Text<16>| String::from(text.as_str().expect("UTF-8"));
        if let Some(m) = frame.decode::<ParamValue>() {
            assert_eq!(m.param_count, COUNT);
            Value(m.param_index, text(m.param_id), m.param_type, m.param_value.to_bits())
        } else if let Some(m) = frame.decode::<ParamError>() {
            Error(Address::new(m.target_system, m.target_component), m.error, m.param_index, text(m.param_id))
        } else {
            panic!("message {}", frame.id())
        }
    })
}

fn port(id: LinkId, version: Version) -> Port {
    static PULSE: Pulse = Pulse::new();
    let mut link = Link::VACANT;
    let config = LinkConfig { bytes_per_second: RATE, ..LinkConfig::unlimited() };
    link.configure(id, config, &Config::new(VEHICLE, &PULSE));
    link.port.outbox.set_version(version);
    link.port
}

const LIST: ParamRequestList = ParamRequestList { target_system: 1, target_component: 0 };

fn read(index: i16, name: &str) -> ParamRequestRead {
    ParamRequestRead { param_index: index, target_system: 1, target_component: 1, param_id: Text::new(name) }
}

/// A PARAM_SET with these bits in its float.
fn set(name: &str, param_type: MavParamType, bits: u32) -> ParamSet {
    let param_value = f32::from_bits(bits);
    ParamSet { param_value, target_system: 1, target_component: 1, param_id: Text::new(name), param_type }
}

fn error(error: MavParamError, index: i16, name: &str) -> Out {
    Error(A.address, error, index, name.into())
}
