//! The service on a bench: encoded frames in, decoded frames out, time by hand, two links, no stack around it.

mod command;
mod hash;
mod list;
mod random;
mod read;
mod set;

use std::string::String;
use std::vec;
use std::vec::Vec;

use super::*;
use crate::dialect::{Common, MavParamError, MavState, ParamError, Statustext};
use crate::frame::{Address, Decoder, MAX_FRAME_LEN, encode};
use crate::link::{LinkClass, LinkId};
use crate::message::Dialect;
use crate::service::statustext::{Entry, TextCursor};
use crate::vehicle::{CommandPosition, VehicleState};

crate::parameters! {
    /// One of every type, flag and length of name.
    pub(super) struct Table {
        ALT_MIN: f32 = -5.0, -100.0..=100.0, "m";
        BYTE: u8 = 7, 1..=200, "";
        ID_OF_16_LETTERS: i32 = -2, -1_000..=1_000_000_000, "", [reboot_required];
        LOCKED: u32 = 4_000_000_000, 0..=u32::MAX, "", [read_only];
        NOISE: f32 = 0.5, 0.0..=1.0, "", [volatile];
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

/// 57,600 baud.
const RATE: u32 = 5_760;

/// A frame that the service sent.
#[derive(Clone, Debug, PartialEq)]
enum Out {
    /// PARAM_VALUE: index, name, type, the bits of the value.
    Value(u16, String, MavParamType, u32),
    /// PARAM_ERROR: to whom, what, which index, which name.
    Error(Address, MavParamError, i16, String),
}
use Out::*;

#[derive(Debug)]
struct Vehicle<const CAST: bool, const HASH: bool, const ERRORS: bool> {
    table: Table,
    verdict: Result<(), MavParamError>,
    is_armed: bool,
    /// The index and the bits of what may_set was asked for.
    asked: Vec<(u16, u32)>,
    /// The index and the bits of what changed.
    changed: Vec<(u16, u32)>,
}

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> Parameters for Vehicle<CAST, HASH, ERRORS> {
    type Table = Table;
    const PARAM_ENCODING: ParamEncoding = if CAST { ParamEncoding::CCast } else { ParamEncoding::Bytewise };
    const PARAM_HASH: ParamHash = if HASH { ParamHash::InList } else { ParamHash::ByName };
    const PARAM_ERROR: bool = ERRORS;

    fn parameters_mut(&mut self) -> Option<&mut Table> {
        Some(&mut self.table)
    }

    fn may_set(&mut self, change: &ParamChange<Table>) -> Result<(), MavParamError> {
        let (_, old) = self.table.table_mut().get(change.index).expect("exists");
        assert_ne!(old, change.bits, "what it has already needs no permission");
        self.asked.push((change.index, change.bits));
        self.verdict
    }

    fn parameter_changed(&mut self, change: &ParamChange<Table>) {
        let (_, now) = self.table.table_mut().get(change.index).expect("exists");
        assert_eq!(now, change.bits, "told when it has happened");
        self.changed.push((change.index, change.bits));
    }
}

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> crate::vehicle::Vehicle for Vehicle<CAST, HASH, ERRORS> {
    fn state(&self) -> Option<VehicleState> {
        let base_mode = if self.is_armed { MavModeFlag::SAFETY_ARMED } else { MavModeFlag::EMPTY };
        Some(VehicleState { base_mode, custom_mode: 0, system_status: MavState::STANDBY })
    }
}

struct Bench<const CAST: bool = false, const HASH: bool = false, const ERRORS: bool = true> {
    params: Params,
    vehicle: Vehicle<CAST, HASH, ERRORS>,
    texts: StatusTexts<[Entry; 8]>,
    now: Instant,
    lists: [List; 2],
    boxes: [Outbox; 2],
}

impl Bench {
    fn new() -> Self {
        Self::of(Version::V2)
    }
}

impl<const CAST: bool, const HASH: bool, const ERRORS: bool> Bench<CAST, HASH, ERRORS> {
    fn of(version: Version) -> Self {
        Self {
            params: Params::new(),
            vehicle: Vehicle {
                table: Table::new(),
                verdict: Ok(()),
                is_armed: false,
                asked: Vec::new(),
                changed: Vec::new(),
            },
            texts: StatusTexts::new(),
            now: Instant::from_millis(60_000),
            lists: [const { List::new() }; 2],
            boxes: [0, 1].map(|link| outbox(LinkId(link), version)),
        }
    }

    /// A frame comes in.
    fn send<M: Message>(&mut self, from: Peer, message: &M) -> Taken {
        let mut bytes = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, from.address, 0, &mut bytes).expect("fits");
        with_frame(&bytes[..len], |frame| {
            assert!(Params::handles(frame.id()));
            let link = usize::from(from.link.0);
            let mut cx = Context { now: self.now, texts: &mut self.texts, normal: both_links() };
            let version = self.boxes[link].version();
            let mut caller = Caller { from, version, list: &mut self.lists[link] };
            self.params.on_frame(&mut cx, &mut self.vehicle, &mut caller, frame)
        })
    }

    /// A frame comes in, and all answers go out: what link 0 sends, then what link 1 does.
    fn ask<M: Message>(&mut self, from: Peer, message: &M) -> [Vec<Out>; 2] {
        assert_eq!(self.send(from, message), Taken::Yes);
        self.drain()
    }

    fn drain(&mut self) -> [Vec<Out>; 2] {
        [0, 1].map(|link| self.drain_link(link))
    }

    fn drain_link(&mut self, link: usize) -> Vec<Out> {
        let mut sent = Vec::new();
        // Steps of the hash that send nothing lie between.
        while self.params.is_pending(LinkId(link as u8)) {
            sent.extend(self.next(link));
        }
        assert_eq!(self.next(link), None, "what is not announced is not sent");
        sent
    }

    /// The next answer that a link sends.
    fn next(&mut self, link: usize) -> Option<Out> {
        let tx = &mut self.boxes[link];
        self.params.next(&mut self.vehicle, &mut self.lists[link], tx).then(|| decoded(tx))
    }

    /// The next value of the list that a link sends.
    fn next_listed(&mut self, link: usize) -> Option<Out> {
        let tx = &mut self.boxes[link];
        self.params.next_listed(self.now, &mut self.vehicle, &mut self.lists[link], RATE, tx).then(|| decoded(tx))
    }

    fn poll(&mut self) {
        self.params.poll(self.now, &mut self.vehicle);
    }

    fn wait(&mut self, millis: u64) {
        self.now = self.now.after(Duration::from_millis(millis));
        self.poll();
    }

    /// Polls every ms for so long, and sends what there is, answers first. What a link sent, and after how many ms.
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
            class: LinkClass::Normal,
            age: None,
            is_broadcast: false,
            confirmation: 0,
        };
        let mut cx = Context { now: self.now, texts: &mut self.texts, normal: both_links() };
        self.params.on_command(&mut cx, &mut self.vehicle, &command)
    }

    /// The texts that go out on a link, each once.
    fn texts(&mut self, link: usize) -> Vec<String> {
        let mut cursor = TextCursor::new();
        let (tx, texts): (_, &mut StatusTexts) = (&mut self.boxes[link], &mut self.texts);
        core::iter::from_fn(|| {
            let sent = texts.next(&mut cursor, tx);
            sent.then(|| with_frame(&take(tx), |frame| frame.decode::<Statustext>().expect("STATUSTEXT").text))
        })
        .map(|text| text.as_str().expect("UTF-8").into())
        .collect()
    }

    /// What a link would say of a parameter.
    fn value(&mut self, index: u16) -> Out {
        let (info, bits) = self.vehicle.table.table_mut().get(index).expect("exists");
        let wire = value::to_wire(Vehicle::<CAST, HASH, ERRORS>::PARAM_ENCODING, info.param_type(), bits);
        Value(index, info.name().into(), info.param_type(), wire.to_bits())
    }

    fn values(&mut self) -> Vec<Out> {
        (0..COUNT).map(|index| self.value(index)).collect()
    }

    fn bits(&mut self, index: u16) -> u32 {
        self.vehicle.table.table_mut().get(index).expect("exists").1
    }
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

fn outbox(link: LinkId, version: Version) -> Outbox {
    let mut outbox = Outbox::VACANT;
    outbox.configure(link, VEHICLE, version);
    outbox
}

fn both_links() -> LinkMask {
    LinkMask::of(LinkId(0)).with(LinkMask::of(LinkId(1)))
}

fn with_frame<R>(bytes: &[u8], handle: impl FnOnce(&Frame<'_>) -> R) -> R {
    let mut decoder = Decoder::default();
    let _ = decoder.push(bytes, Instant::ZERO);
    let frame = decoder.next(Instant::ZERO, Common::MESSAGES, &mut u32::MAX.clone(), |_| true);
    handle(&frame.expect("a whole frame"))
}

fn take(tx: &mut Outbox) -> Vec<u8> {
    let bytes = tx.pending().to_vec();
    tx.advance(bytes.len());
    bytes
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
