//! Extended parameters: settings of any type, such as a camera's, by the extended parameter protocol.
//!
//! Implements the server's side of <https://mavlink.io/en/services/parameter_ext.html>, rules P-40 to P-42: PARAM_EXT_REQUEST_READ,
//! PARAM_EXT_REQUEST_LIST and PARAM_EXT_SET. The parameters live in the vehicle. MAVSDK and QGroundControl use them for the settings
//! of a camera that has a definition file (`CAMERA_INFORMATION.cam_definition_uri`).
//!
//! Left out: storage, and PARAM_ERROR, which is for ordinary parameters. A request for a parameter that does not exist is not
//! answered; an attempt to set one is.

use super::rate_limit::{RateLimit, cost};
use super::{About, Cx, Handled, Received, Service, StackEvent, Turn, View};
use crate::dialect::{
    MavParamExtType, ParamAck, ParamExtAck, ParamExtRequestList, ParamExtRequestRead, ParamExtSet, ParamExtValue,
};
use crate::link::Port;
use crate::message::{ComponentId, Field, Message, Text};
use crate::time::Instant;
use crate::types::{Component, Context, Firmware, LinkMask, Peer};

/// The maximum number of extended parameters. More are not listed.
pub const MAX_EXT_PARAMS: u16 = 128;

/// The bytes of a set of parameters.
const BYTES: usize = 16;

/// The number of answers to PARAM_EXT_SET that can be pending, on all links together.
const SLOTS: usize = 3;

/// The cost of a value: the size of a PARAM_EXT_VALUE, for a share of 40 % of the link.
const COST: u32 = cost(161, 40);

/// The index of a parameter that does not exist.
const UNKNOWN: u16 = u16::MAX;

/// The value of an extended parameter. Numbers are little-endian on the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ExtValue<'a> {
    /// `uint8_t`
    U8(u8),
    /// `int8_t`
    I8(i8),
    /// `uint16_t`
    U16(u16),
    /// `int16_t`
    I16(i16),
    /// `uint32_t`
    U32(u32),
    /// `int32_t`
    I32(i32),
    /// `uint64_t`
    U64(u64),
    /// `int64_t`
    I64(i64),
    /// `float`
    F32(f32),
    /// `double`
    F64(f64),
    /// Bytes of the vehicle's own meaning, at most 128, such as a text. A received value has all 128; a shorter one of the
    /// vehicle is sent with zeros after it.
    Custom(&'a [u8]),
}

impl<'a> ExtValue<'a> {
    /// Returns the value as a text: its bytes up to the first NUL. `None` for a number, and if it is not UTF-8.
    pub fn text(&self) -> Option<&'a str> {
        let Self::Custom(bytes) = *self else { return None };
        core::str::from_utf8(bytes.split(|&byte| byte == 0).next()?).ok()
    }

    /// Returns the type of the value.
    pub const fn kind(&self) -> MavParamExtType {
        match self {
            Self::U8(_) => MavParamExtType::UINT8,
            Self::I8(_) => MavParamExtType::INT8,
            Self::U16(_) => MavParamExtType::UINT16,
            Self::I16(_) => MavParamExtType::INT16,
            Self::U32(_) => MavParamExtType::UINT32,
            Self::I32(_) => MavParamExtType::INT32,
            Self::U64(_) => MavParamExtType::UINT64,
            Self::I64(_) => MavParamExtType::INT64,
            Self::F32(_) => MavParamExtType::REAL32,
            Self::F64(_) => MavParamExtType::REAL64,
            Self::Custom(_) => MavParamExtType::CUSTOM,
        }
    }

    /// Reads a value of this type. `None` for NaN and the infinities, which are no settings (P-41).
    fn read(kind: MavParamExtType, bytes: &'a [u8]) -> Option<Self> {
        Some(match kind {
            MavParamExtType::UINT8 => Self::U8(Field::read(bytes, 0)),
            MavParamExtType::INT8 => Self::I8(Field::read(bytes, 0)),
            MavParamExtType::UINT16 => Self::U16(Field::read(bytes, 0)),
            MavParamExtType::INT16 => Self::I16(Field::read(bytes, 0)),
            MavParamExtType::UINT32 => Self::U32(Field::read(bytes, 0)),
            MavParamExtType::INT32 => Self::I32(Field::read(bytes, 0)),
            MavParamExtType::UINT64 => Self::U64(Field::read(bytes, 0)),
            MavParamExtType::INT64 => Self::I64(Field::read(bytes, 0)),
            MavParamExtType::REAL32 => Self::F32(Some(Field::read(bytes, 0)).filter(|value: &f32| value.is_finite())?),
            MavParamExtType::REAL64 => Self::F64(Some(Field::read(bytes, 0)).filter(|value: &f64| value.is_finite())?),
            MavParamExtType::CUSTOM => Self::Custom(bytes),
            _ => return None,
        })
    }

    /// Writes the value over zeros.
    fn write(&self, bytes: &mut [u8]) {
        match self {
            Self::U8(value) => value.write(bytes, 0),
            Self::I8(value) => value.write(bytes, 0),
            Self::U16(value) => value.write(bytes, 0),
            Self::I16(value) => value.write(bytes, 0),
            Self::U32(value) => value.write(bytes, 0),
            Self::I32(value) => value.write(bytes, 0),
            Self::U64(value) => value.write(bytes, 0),
            Self::I64(value) => value.write(bytes, 0),
            Self::F32(value) => value.write(bytes, 0),
            Self::F64(value) => value.write(bytes, 0),
            Self::Custom(value) => {
                for (to, from) in bytes.iter_mut().zip(*value) {
                    *to = *from;
                }
            }
        }
    }
}

/// Extended parameters, for a vehicle that has [`ExtParamServer`] in the struct of its [stack](macro@crate::Stack).
///
/// ```
/// use mavstack::dialect::{MavResult, ParamAck};
/// use mavstack::ext_parameters::ExtValue;
/// use mavstack::prelude::*;
///
/// /// A camera with two settings.
/// struct Surveyor { iso: u32, owner: [u8; 16] }
///
/// #[derive(Stack)]
/// #[stack(vehicle: Surveyor, links: 1)]
/// struct Mavlink {
///     ext_parameters: mavstack::ext_parameters::ExtParamServer,
/// }
///
/// impl ExtParameters for Surveyor {
///     fn ext_param_count(&self) -> u16 {
///         2
///     }
///
///     fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
///         match index {
///             0 => Some(("CAM_ISO", ExtValue::U32(self.iso))),
///             1 => Some(("CAM_OWNER", ExtValue::Custom(&self.owner))),
///             _ => None,
///         }
///     }
///
///     fn set_ext_param(&mut self, _: &mut Context<'_>, index: u16, value: ExtValue<'_>, _: Peer) -> ParamAck {
///         match (index, value) {
///             (0, ExtValue::U32(iso @ 100..=6400)) => self.iso = iso,
///             (1, value) if value.text().is_some_and(|text| text.len() <= 16) => {
///                 self.owner = *Text::new(value.text().unwrap_or_default()).wire();
///             }
///             _ => return ParamAck::VALUE_UNSUPPORTED,
///         }
///         ParamAck::ACCEPTED
///     }
/// }
/// # impl Vehicle for Surveyor { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Surveyor {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
/// # }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `ExtParameters`",
    note = "`ExtParamServer` in the struct of a stack needs `impl ExtParameters for {Self}`: write it, or leave the field out"
)]
pub trait ExtParameters {
    /// The component that has the parameters, such as the camera with id 100. `None` is the autopilot.
    const COMPONENT: Option<ComponentId> = None;

    /// Returns the number of parameters, at most [`MAX_EXT_PARAMS`]. It must not change while ground stations are connected.
    fn ext_param_count(&self) -> u16;

    /// Returns name and value of parameter `index`: a name of 1 to 16 bytes, always the same, with a value of always the same type.
    /// `None` from [`ext_param_count`](Self::ext_param_count) on.
    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)>;

    /// Sets parameter `index` to a value of its type, at the request of `from`. Returns ACCEPTED, or refuses the
    /// value by
    /// VALUE_UNSUPPORTED or FAILED. With IN_PROGRESS, [`ExtParamServer::finish`] follows. Setting the present value
    /// must do
    /// no harm: a client that has missed the answer sends it again.
    fn set_ext_param(&mut self, cx: &mut Context<'_>, index: u16, value: ExtValue<'_>, from: Peer) -> ParamAck;
}

/// A pending PARAM_EXT_ACK.
#[derive(Clone, Copy, Debug)]
struct Answer {
    /// The links on which it is pending.
    links: LinkMask,
    index: u16,
    /// As in the request. For a parameter that exists, the vehicle has them when the answer is sent.
    name: Name,
    kind: MavParamExtType,
    result: ParamAck,
}

impl Answer {
    /// All zero bits.
    const NONE: Self =
        Self { links: LinkMask::NONE, index: 0, name: [0; 16], kind: MavParamExtType(0), result: ParamAck::ACCEPTED };
}

/// The server of extended parameters: `ext_parameters: ExtParamServer` in the struct of a [stack](macro@crate::Stack).
///
/// Each PARAM_EXT_SET is answered by a PARAM_EXT_ACK on every normal link that carries MAVLink 2, so that all ground stations learn of
/// it; that of a station which is not in control only on its link. It has the resulting value. At most three answers can be pending: a link that takes none loses those to the requests of
/// others, and a link on which three are pending has further requests dropped and counted, without effect.
#[derive(Debug)]
pub struct ExtParamServer {
    answers: [Answer; SLOTS],
}

/// A frame that the server sends.
#[derive(Clone, Copy, Debug)]
pub enum ExtParamReply {
    /// PARAM_EXT_ACK, by its place among the answers.
    Answer(usize),
    /// PARAM_EXT_VALUE, by the index of the parameter.
    Value(u16),
}

/// The state of the service on a link.
#[derive(Debug)]
pub struct ExtParamLink {
    /// Parameters that were requested, one by one or as a list: a bit for each.
    requested: [u8; BYTES],
    limit: RateLimit,
}

impl ExtParamLink {
    const VACANT: Self = Self { requested: [0; BYTES], limit: RateLimit::NEW };

    /// Marks a parameter as requested.
    fn request(&mut self, index: u16) {
        if let Some(byte) = self.requested.get_mut(usize::from(index >> 3)) {
            *byte |= 1u8.wrapping_shl(u32::from(index));
        }
    }

    /// Removes the mark.
    fn forget(&mut self, index: u16) {
        if let Some(byte) = self.requested.get_mut(usize::from(index >> 3)) {
            *byte &= !1u8.wrapping_shl(u32::from(index));
        }
    }

    /// Returns the first parameter that was requested.
    fn first_requested(&self) -> Option<u16> {
        let (base, byte) = (0u16..).zip(&self.requested).find(|(_, byte)| **byte != 0)?;
        let bit = u16::try_from(byte.trailing_zeros()).unwrap_or(0);
        Some(base.wrapping_shl(3) | bit)
    }
}

impl ExtParamServer {
    /// Ends a change that was IN_PROGRESS: another PARAM_EXT_ACK has the result and the parameter's value now.
    pub fn finish(&mut self, index: u16, result: ParamAck) {
        if let Some(slot) = self.slot_for(LinkMask::NONE, index) {
            *slot = Answer { links: LinkMask::ALL, index, result, ..Answer::NONE };
        }
    }

    /// Returns the slot for an answer to a request on this link: that of a pending answer about the same parameter,
    /// or a free one, or
    /// one that is not pending on this link. `None` if there is none.
    fn slot_for(&mut self, link: LinkMask, index: u16) -> Option<&mut Answer> {
        let is_same = |answer: &Answer| answer.index == index && index != UNKNOWN && !answer.links.is_empty();
        let place = self.answers.iter().position(is_same);
        let place = place.or_else(|| self.answers.iter().position(|answer| answer.links.is_empty()));
        let place = place.or_else(|| self.answers.iter().position(|answer| !answer.links.intersects(link)));
        self.answers.get_mut(place?)
    }

    /// Drops the answers that are pending on a link.
    fn forget(&mut self, port: &Port) {
        for answer in &mut self.answers {
            answer.links = answer.links.without(LinkMask::of(port.id));
        }
    }
}

/// Returns the number of parameters.
fn count<V: ExtParameters>(vehicle: &V) -> u16 {
    vehicle.ext_param_count().min(MAX_EXT_PARAMS)
}

/// A name, with zeros after it.
type Name = [u8; 16];

/// Returns a name as it is compared: without the bytes from the first NUL on (S-18).
fn name_of(bytes: &[u8]) -> Name {
    let mut name = [0; 16];
    for (to, from) in name.iter_mut().zip(bytes.iter().take_while(|byte| **byte != 0)) {
        *to = *from;
    }
    name
}

/// Returns the index of a parameter by its name.
fn find<V: ExtParameters>(vehicle: &V, name: &Name) -> Option<u16> {
    // Byte by byte: an equality of arrays links a function for it.
    let is_same = |other: &str| name_of(other.as_bytes()).iter().zip(name).all(|(a, b)| a == b);
    (0..count(vehicle)).find(|index| vehicle.ext_param(*index).is_some_and(|(other, _)| is_same(other)))
}

/// Handles PARAM_EXT_SET (P-41).
fn set<F: Firmware<Vehicle: ExtParameters>>(
    server: &mut ExtParamServer,
    cx: &mut Cx<'_, F>,
    port: &Port,
    received: &Received<'_>,
) -> Handled {
    if received.target.system.is_all() {
        // It would set the parameter on every vehicle in range.
        return Handled::OutOfPlace;
    }
    // Not decoded as a whole: a copy of 128 bytes would be on the call stack below the hook.
    let payload = received.frame.payload();
    let name = name_of(payload.get(2..18).unwrap_or_default());
    let kind = MavParamExtType(received.frame.byte(146));
    let index = find(cx.vehicle, &name).unwrap_or(UNKNOWN);
    let link = LinkMask::of(port.id);
    let Some(slot) = server.slot_for(link, index) else { return Handled::NoRoom };
    if !received.may_change {
        // Only those who may command change a setting (X-5). The answer names no client, so it takes the place of no other one, and
        // reaches no other link.
        let is_repeated = slot.index == index && slot.result == ParamAck::FAILED;
        if !(slot.links.is_empty() || is_repeated) {
            return Handled::NoRoom;
        }
        let links = if is_repeated { slot.links.with(link) } else { link };
        *slot = Answer { links, index, name, kind, result: ParamAck::FAILED };
        return Handled::Yes;
    }
    let is_of_type = cx.vehicle.ext_param(index).is_some_and(|(_, now)| now.kind() == kind);
    let value = payload.get(18..146).filter(|_| is_of_type).and_then(|bytes| ExtValue::read(kind, bytes));
    let result = match value {
        Some(value) => {
            let (vehicle, mut context) = cx.hook();
            vehicle.set_ext_param(&mut context, index, value, received.from())
        }
        None => ParamAck::VALUE_UNSUPPORTED,
    };
    event!("extended parameter {=u16}: {=u8}", index, result.0);
    *slot = Answer { links: cx.shared.normal, index, name, kind, result };
    cx.shared.has_acted = true;
    Handled::Yes
}

/// Sends a parameter.
fn send_value<F: Firmware<Vehicle: ExtParameters>>(cx: &Cx<'_, F>, port: &mut Port, index: u16) -> bool {
    let Some((name, value)) = cx.vehicle.ext_param(index) else { return false };
    let mut bytes = [0; 128];
    value.write(&mut bytes);
    let message = ParamExtValue {
        param_count: count(cx.vehicle),
        param_index: index,
        param_id: Text::from_wire(name_of(name.as_bytes())),
        param_value: Text::from_wire(bytes),
        param_type: value.kind(),
    };
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}

/// Sends an answer, with the present value.
fn send_answer<F: Firmware<Vehicle: ExtParameters>>(cx: &Cx<'_, F>, port: &mut Port, answer: &Answer) -> bool {
    let Answer { index, name, kind, result, .. } = *answer;
    let (mut name, mut param_type, mut bytes) = (name, kind, [0; 128]);
    if let Some((own, value)) = cx.vehicle.ext_param(index) {
        (name, param_type) = (name_of(own.as_bytes()), value.kind());
        value.write(&mut bytes);
    }
    let (param_id, param_value) = (Text::from_wire(name), Text::from_wire(bytes));
    let message = ParamExtAck { param_id, param_value, param_type, param_result: result };
    port.outbox.send_from::<F, _>(F::Vehicle::COMPONENT, &message)
}

impl<F: Firmware<Vehicle: ExtParameters>> Service<F> for ExtParamServer {
    const CHECK: () = Component::check_service(F::COMPONENTS, F::Vehicle::COMPONENT);
    const NEW: Self = Self { answers: [Answer::NONE; SLOTS] };
    const ABOUT: About = About::of(F::Vehicle::COMPONENT).in_turns(&[Turn::ExtParam]);
    type Link = ExtParamLink;
    const VACANT: ExtParamLink = ExtParamLink::VACANT;
    type Reply = ExtParamReply;

    /// Frees the slots of answers that no link can take.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ExtParamLink>) {
        for answer in &mut self.answers {
            if !answer.links.intersects(cx.shared.normal) {
                answer.links = LinkMask::NONE;
            }
        }
    }

    fn on_frame(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut ExtParamLink,
        received: &Received<'_>,
    ) -> Handled {
        let frame = received.frame;
        let can_answer = port.outbox.takes(ParamExtValue::ID);
        match frame.id() {
            ParamExtRequestRead::ID | ParamExtRequestList::ID | ParamExtSet::ID if !can_answer => {
                return Handled::OutOfPlace;
            }
            ParamExtRequestRead::ID => {
                // A negative index means by name.
                let index = i16::from_le_bytes([frame.byte(0), frame.byte(1)]);
                let found = match u16::try_from(index) {
                    Ok(index) => Some(index).filter(|index| *index < count(cx.vehicle)),
                    Err(_) => find(cx.vehicle, &name_of(frame.payload().get(4..).unwrap_or_default())),
                };
                found.into_iter().for_each(|index| link.request(index));
            }
            ParamExtRequestList::ID => (0..count(cx.vehicle)).for_each(|index| link.request(index)),
            ParamExtSet::ID => return set(self, cx, port, received),
            _ => return Handled::No,
        }
        Handled::Yes
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &ExtParamLink, _: Turn) -> Option<(Instant, ExtParamReply)> {
        if !port.outbox.takes(ParamExtValue::ID) {
            return None;
        }
        match self.answers.iter().position(|answer| answer.links.contains(port.id)) {
            Some(place) => Some((view.now, ExtParamReply::Answer(place))),
            None => link.first_requested().map(|index| (link.limit.due(), ExtParamReply::Value(index))),
        }
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut ExtParamLink, reply: ExtParamReply) -> bool {
        match reply {
            ExtParamReply::Answer(place) => {
                let Some(answer) = self.answers.get_mut(place) else { return false };
                answer.links = answer.links.without(LinkMask::of(port.id));
                send_answer(cx, port, answer)
            }
            ExtParamReply::Value(index) => {
                link.forget(index);
                link.limit.spend(cx.now, COST, port.config.bytes_per_second);
                send_value(cx, port, index)
            }
        }
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Opened(port, link) => {
                self.forget(port);
                *link = ExtParamLink::VACANT;
            }
            // A link that sends MAVLink 1 cannot carry the answers.
            StackEvent::Sent(port, _) if !port.outbox.takes(ParamExtValue::ID) => self.forget(port),
            _ => {}
        }
    }
}
