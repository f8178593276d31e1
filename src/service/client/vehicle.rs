//! The client's interface to the vehicle: the hooks, and the calls with which a hook requests something.

use crate::dialect::{MavCmd, MavFrame, MavParamError, MavParamExtType, MavResult, ParamExtValue, ParamValue};
use crate::frame::Frame;
use crate::message::{Message, Text};
use crate::num;
use crate::time::Duration;
use crate::types::{CommandPosition, Context, Pending, Recipient};

/// A command that the vehicle sends, as COMMAND_LONG or COMMAND_INT.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OutgoingCommand {
    pub(super) id: MavCmd,
    pub(super) params: [f32; 4],
    pub(super) position: CommandPosition,
    pub(super) z: f32,
}

impl OutgoingCommand {
    /// All zero bits.
    pub(super) const NONE: Self = Self::long(MavCmd(0), [0.0; 7]);

    /// Returns a command for COMMAND_LONG. A command with a location has it in degrees.
    pub const fn long(id: MavCmd, params: [f32; 7]) -> Self {
        let [p1, p2, p3, p4, param5, param6, z] = params;
        Self { id, params: [p1, p2, p3, p4], position: CommandPosition::Long { param5, param6 }, z }
    }

    /// Returns MAV_CMD_REQUEST_MESSAGE: message `M`, once. Each message defines the meaning of `index`; 0 is the
    /// default (Q-3). [`Vehicle::message`](crate::Vehicle::message) gets the message.
    pub fn request_message<M: Message>(index: u16) -> Self {
        Self::long(
            MavCmd::REQUEST_MESSAGE,
            [num::from_i32(M::ID.cast_signed()), f32::from(index), 0.0, 0.0, 0.0, 0.0, 0.0],
        )
    }

    /// Returns MAV_CMD_SET_MESSAGE_INTERVAL: message `M` at this interval. `None` stops it, and zero is the component's
    /// default (Q-4).
    pub fn set_message_interval<M: Message>(interval: Option<Duration>) -> Self {
        let micros = interval
            .map_or(-1.0, |interval| num::from_i32(i32::try_from(interval.as_micros()).unwrap_or(i32::MAX - 1)));
        Self::long(MavCmd::SET_MESSAGE_INTERVAL, [num::from_i32(M::ID.cast_signed()), micros, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// Returns a command for COMMAND_INT: parameters 1 to 4, the position (deg·1e7 in a global frame), and parameter 7.
    pub const fn int(id: MavCmd, frame: MavFrame, params: [f32; 4], [x, y]: [i32; 2], z: f32) -> Self {
        Self { id, params, position: CommandPosition::Int { frame, x, y }, z }
    }
}

/// The outcome of a command of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CommandReply {
    /// It runs, and another reply follows. Progress in percent; 255 is unknown.
    InProgress(u8),
    /// It was answered: ACCEPTED, CANCELLED, or why it was refused.
    Done {
        /// The result.
        result: MavResult,
        /// COMMAND_ACK.result_param2. Each command defines its meaning.
        result_param2: i32,
    },
    /// It was not sent: no such component is alive on a normal link, its link took nothing, or the vehicle made no command of
    /// the token.
    NotSent,
    /// It was not answered: it was lost each time, its recipient does not know commands, or it stopped reporting progress.
    TimedOut,
}

/// The vehicle sends commands to other components. For a vehicle that declares `command_client` in
/// [`#[stack]`](macro@crate::Stack).
///
/// ```
/// use mavstack::dialect::{MavCmd, MavResult, MavSeverity, MavType};
/// use mavstack::prelude::*;
///
/// struct Carrier { pitch: f32 }
///
/// const POINT_GIMBAL: u16 = 1;
///
/// impl Carrier {
///     fn point(&mut self, cx: &mut Context<'_>, pitch: f32) {
///         self.pitch = pitch;
///         if !cx.send_command(Recipient::Type(MavType::GIMBAL), POINT_GIMBAL) {
///             cx.text(MavSeverity::WARNING, "Gimbal: too many commands");
///         }
///     }
/// }
///
/// impl CommandClient for Carrier {
///     fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
///         let params = [self.pitch, 0.0, f32::NAN, f32::NAN, 0.0, 0.0, 0.0];
///         (token == POINT_GIMBAL).then_some(OutgoingCommand::long(MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, params))
///     }
///
///     fn command_answered(&mut self, cx: &mut Context<'_>, _: u16, reply: CommandReply) {
///         match reply {
///             CommandReply::InProgress(_) | CommandReply::Done { result: MavResult::ACCEPTED, .. } => {}
///             _ => cx.text(MavSeverity::WARNING, "Gimbal: not pointed"),
///         }
///     }
/// }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `CommandClient`",
    note = "`command_client` in `#[stack]` needs `impl CommandClient for {Self}`: write it, or leave `command_client` out"
)]
pub trait CommandClient {
    /// Returns the command that a token stands for: once, when a slot takes it up. Transmissions repeat it. `None` if there is
    /// nothing to send any more.
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand>;

    /// Called with the outcome of a command: any number of times with [`CommandReply::InProgress`], then once with
    /// another reply.
    fn command_answered(&mut self, cx: &mut Context<'_>, token: u16, reply: CommandReply);

    /// Whether the vehicle also [reads parameters](Context::read_param) of other components. The code for it is left out
    /// if not.
    const READS_PARAMS: bool = false;

    /// Returns the name of the parameter that a token stands for: at most 16 bytes. `None` if there is nothing to read any
    /// more.
    fn param_for(&mut self, token: u16) -> Option<Text<16>> {
        let _ = token;
        None
    }

    /// Called once with the answer to each [`Context::read_param`].
    fn param_answered(&mut self, cx: &mut Context<'_>, token: u16, answer: ParamAnswer<'_>) {
        let _ = (cx, token, answer);
    }
}

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

/// The value of an extended parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExtParamValue<'a> {
    /// How to read the bytes.
    pub r#type: MavParamExtType,
    bytes: &'a [u8],
}

impl<'a> ExtParamValue<'a> {
    /// Returns the name and the value of a PARAM_EXT_VALUE. It does not decode the message: a copy of 128 bytes would be on the
    /// call stack of the hook.
    pub(super) fn read(frame: &'a Frame<'_>) -> Option<(Text<16>, Self)> {
        if frame.id() != ParamExtValue::ID {
            return None;
        }
        // Count and index, the name, the value, and the type. A short payload is extended with zeros (S-6).
        let rest = frame.payload().get(4..).unwrap_or_default();
        let (name, rest) = rest.split_at_checked(16).unwrap_or((rest, &[]));
        let (bytes, rest) = rest.split_at_checked(128).unwrap_or((rest, &[]));
        let r#type = MavParamExtType(rest.first().copied().unwrap_or(0));
        Some((Text::from_wire(Self { r#type, bytes: name }.bytes()), Self { r#type, bytes }))
    }

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

impl Context<'_> {
    /// Sends a command to another component, and repeats it until it is answered: see [`CommandClient`]. The next
    /// [`poll`](crate::Stack::poll) takes it up, or a later one if all slots are taken. One that waits for that already, with the
    /// same recipient and token, is not queued twice, so both get one reply. Returns false, and sends nothing, if eight requests
    /// wait, or if [`#[stack]`](macro@crate::Stack) does not declare `command_client`.
    #[must_use = "it is not sent if too many commands wait"]
    pub fn send_command(&mut self, to: impl Into<Recipient>, token: u16) -> bool {
        self.requests.request(Pending::Command { to: to.into(), token })
    }

    /// Cancels the commands with this token that were requested before: they are not sent, or else COMMAND_CANCEL is sent for
    /// them. The reply to each goes to [`CommandClient::command_answered`], under its token: many components know no
    /// COMMAND_CANCEL, and answer the command itself in the end. So use another token for another command meanwhile. Returns
    /// false if eight requests wait.
    #[must_use = "it is not cancelled if too many commands wait"]
    pub fn cancel_sent_command(&mut self, token: u16) -> bool {
        self.requests.request(Pending::Cancel { token })
    }

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
