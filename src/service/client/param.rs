//! Parameters of other components: <https://mavlink.io/en/services/parameter.html> and
//! <https://mavlink.io/en/services/parameter_ext.html>, as far as one parameter is read by its name (K-6).

use super::recipients::note_answer;
use super::slot::{State, What};
use super::{CommandClient, Slot};
use crate::dialect::{
    MavParamError, MavParamExtType, ParamError, ParamExtRequestRead, ParamExtValue, ParamRequestRead, ParamValue,
};
use crate::link::Port;
use crate::message::{Address, Message, Text};
use crate::service::{Cx, Handled, Received};
use crate::types::{Context, Firmware, Pending, Recipient};

/// The answer to [`Context::read_param`] or [`Context::read_ext_param`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ParamAnswer<'a> {
    /// The parameter. Its type says how to read the value: by its bytes, or converted to a float (P-3).
    Value(&'a ParamValue),
    /// The extended parameter.
    ExtValue(ExtParamValue<'a>),
    /// The component refused it by PARAM_ERROR: it has no such parameter, for example.
    Refused(MavParamError),
    /// It was not requested: no such component is alive on a normal link, or the vehicle named no parameter for the token.
    NotSent,
    /// It was not answered. Many components do not answer a request for a parameter that they do not have.
    TimedOut,
}

/// A parameter to read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Query {
    pub(super) name: Text<16>,
    pub(super) is_ext: bool,
}

impl Query {
    /// Returns the id of the request.
    pub(super) fn id(&self) -> u32 {
        if self.is_ext { ParamExtRequestRead::ID } else { ParamRequestRead::ID }
    }

    /// Sends the request.
    pub(super) fn send(&self, to: Address, port: &mut Port) -> bool {
        let (param_index, param_id) = (-1, self.name);
        let (target_system, target_component) = (to.system.wire(), to.component.wire());
        if self.is_ext {
            port.outbox.send(&ParamExtRequestRead { param_index, target_system, target_component, param_id })
        } else {
            port.outbox.send(&ParamRequestRead { param_index, target_system, target_component, param_id })
        }
    }
}

/// The value of an extended parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExtParamValue<'a> {
    /// How to read the bytes.
    pub r#type: MavParamExtType,
    bytes: &'a [u8],
}

impl ExtParamValue<'_> {
    /// The positions of name, value and type in PARAM_EXT_VALUE.
    const NAME: usize = 4;
    const VALUE: usize = Self::NAME + 16;
    const TYPE: usize = Self::VALUE + 128;

    /// Returns the first `N` bytes of the value, which has 128: `u32::from_le_bytes(value.bytes())`, for example, if the type
    /// is [`MavParamExtType::UINT32`].
    pub fn bytes<const N: usize>(&self) -> [u8; N] {
        let mut bytes = [0; N];
        for (to, from) in bytes.iter_mut().zip(self.bytes) {
            *to = *from;
        }
        bytes
    }
}

/// Handles a frame that may be an answer.
pub(super) fn take_answer<F: Firmware<Vehicle: CommandClient>>(
    slots: &mut [Slot],
    cx: &mut Cx<'_, F>,
    received: &Received<'_>,
) -> Handled {
    let frame = received.frame;
    let value = frame.decode::<ParamValue>();
    let error = frame.decode::<ParamError>();
    let (name, is_ext, answer) = match (&value, error) {
        (Some(value), _) => (value.param_id, Some(false), ParamAnswer::Value(value)),
        (_, Some(error)) => (error.param_id, None, ParamAnswer::Refused(error.error)),
        _ if frame.id() == ParamExtValue::ID => {
            // Not decoded: a copy of 128 bytes would be on the call stack below the hook.
            let field = |from, len| frame.payload().get(from..).map_or(&[][..], |rest| rest.get(..len).unwrap_or(rest));
            let name = ExtParamValue { r#type: MavParamExtType(0), bytes: field(ExtParamValue::NAME, 16) }.bytes();
            let [r#type] = ExtParamValue { r#type: MavParamExtType(0), bytes: field(ExtParamValue::TYPE, 1) }.bytes();
            let value = ExtParamValue { r#type: MavParamExtType(r#type), bytes: field(ExtParamValue::VALUE, 128) };
            (Text::from_wire(name), Some(true), ParamAnswer::ExtValue(value))
        }
        _ => return Handled::No,
    };
    let is_it = |slot: &&mut Slot| match &slot.what {
        What::Param(query) => {
            // What follows the NUL is no part of the name (S-18).
            let is_same =
                query.name.as_bytes() == name.as_bytes() && is_ext.is_none_or(|is_ext| is_ext == query.is_ext);
            is_same && slot.is_answered_by(received.from.address)
        }
        What::Command(_) => false,
    };
    let Some(slot) = slots.iter_mut().find(is_it) else { return Handled::No };
    slot.state = State::Free;
    cx.requests.set_client_due(true);
    note_answer(cx.peers, received.from);
    let (vehicle, mut context) = cx.hook();
    vehicle.param_answered(&mut context, slot.token, answer);
    Handled::Yes
}

impl Context<'_> {
    /// Reads a parameter of another component by PARAM_REQUEST_READ, and repeats it until it is answered, like a
    /// [command](Self::send_command). [`CommandClient::param_for`] names the parameter of the token, and
    /// [`CommandClient::param_answered`] gets its value. The vehicle `V` must set [`CommandClient::READS_PARAMS`];
    /// otherwise this does not compile. Returns false if too many requests wait.
    #[must_use = "it is not read if too many requests wait"]
    pub fn read_param<V: CommandClient>(&mut self, to: impl Into<Recipient>, token: u16) -> bool {
        const { check::<V>() };
        self.requests.request(Pending::Param { to: to.into(), token, is_ext: false })
    }

    /// Reads an extended parameter, such as a camera's setting, by PARAM_EXT_REQUEST_READ: see
    /// [`read_param`](Self::read_param).
    #[must_use = "it is not read if too many requests wait"]
    pub fn read_ext_param<V: CommandClient>(&mut self, to: impl Into<Recipient>, token: u16) -> bool {
        const { check::<V>() };
        self.requests.request(Pending::Param { to: to.into(), token, is_ext: true })
    }
}

pub(crate) const fn check<V: CommandClient>() {
    assert!(V::READS_PARAMS, "the vehicle reads no parameters of others: set `READS_PARAMS` in `CommandClient`");
}
