//! Parameters of other components: <https://mavlink.io/en/services/parameter.html> and
//! <https://mavlink.io/en/services/parameter_ext.html>, as far as one parameter is read by its name (P-2).

use super::{CommandClient, Slot, State, What};
use crate::dialect::{MavParamError, ParamError, ParamExtRequestRead, ParamExtValue, ParamRequestRead, ParamValue};
use crate::link::Port;
use crate::message::{Address, Text};
use crate::service::{Cx, Handled, Received};
use crate::types::{Context, Firmware, Pending, Recipient};

/// The answer to [`Context::read_param`] or [`Context::read_ext_param`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ParamAnswer<'a> {
    /// The parameter. Its type says how to read the value: by its bytes, or converted to a float (P-3).
    Value(&'a ParamValue),
    /// The extended parameter. Its type says how to read the 128 bytes of the value.
    ExtValue(&'a ParamExtValue),
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
    /// Sends the request.
    #[inline(never)]
    pub(super) fn send(&self, to: Address, port: &mut Port) -> bool {
        let (param_index, param_id) = (-1, self.name);
        let (target_system, target_component) = (to.system.0, to.component.0);
        if self.is_ext {
            port.outbox.send(&ParamExtRequestRead { param_index, target_system, target_component, param_id })
        } else {
            port.outbox.send(&ParamRequestRead { param_index, target_system, target_component, param_id })
        }
    }
}

/// Handles a frame that may be an answer.
#[inline(never)]
pub(super) fn take_answer<F: Firmware<Vehicle: CommandClient>>(
    slots: &mut [Slot],
    cx: &mut Cx<'_, F>,
    received: &Received<'_>,
) -> Handled {
    let (frame, from) = (received.frame, received.from.address);
    let mut end = |cx: &mut Cx<'_, F>, name: Text<16>, is_ext: Option<bool>, answer: ParamAnswer<'_>| {
        let is_it = |slot: &&mut Slot| match &slot.what {
            What::Param(query) => {
                slot.expects(from) && query.name == name && is_ext.is_none_or(|is_ext| is_ext == query.is_ext)
            }
            What::Command(_) => false,
        };
        let Some(slot) = slots.iter_mut().find(is_it) else { return Handled::No };
        slot.state = State::Free;
        cx.requests.set_due(true);
        let (vehicle, mut context) = cx.hook();
        vehicle.param_answered(&mut context, slot.token, answer);
        Handled::Yes
    };
    if let Some(value) = frame.decode::<ParamValue>() {
        return end(cx, value.param_id, Some(false), ParamAnswer::Value(&value));
    }
    if let Some(error) = frame.decode::<ParamError>() {
        return end(cx, error.param_id, None, ParamAnswer::Refused(error.error));
    }
    frame
        .decode::<ParamExtValue>()
        .map_or(Handled::No, |value| end(cx, value.param_id, Some(true), ParamAnswer::ExtValue(&value)))
}

impl Context<'_> {
    /// Reads a parameter of another component by PARAM_REQUEST_READ, and repeats it until it is answered, like a
    /// [command](Self::send_command). [`CommandClient::param_for`] names the parameter of the token, and
    /// [`CommandClient::param_answered`] gets its value. The vehicle `V` must set [`CommandClient::READS_PARAMS`];
    /// otherwise this does not compile. Returns false if too many requests wait.
    #[must_use = "it is not read if too many requests wait"]
    pub fn read_param<V: CommandClient>(&mut self, to: impl Into<Recipient>, token: u16) -> bool {
        const { check::<V>() };
        self.requests.command(Pending::Param { to: to.into(), token, is_ext: false })
    }

    /// Reads an extended parameter, such as a camera's setting, by PARAM_EXT_REQUEST_READ: see
    /// [`read_param`](Self::read_param).
    #[must_use = "it is not read if too many requests wait"]
    pub fn read_ext_param<V: CommandClient>(&mut self, to: impl Into<Recipient>, token: u16) -> bool {
        const { check::<V>() };
        self.requests.command(Pending::Param { to: to.into(), token, is_ext: true })
    }
}

pub(crate) const fn check<V: CommandClient>() {
    assert!(V::READS_PARAMS, "the vehicle reads no parameters of others: set `READS_PARAMS` in `CommandClient`");
}
