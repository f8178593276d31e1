//! Sets of one parameter.

use super::{Encoding, Parameter, Read, Value, is_from_target, name_of, parameter_of};
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::Duration;
use mavstack::dialect::{MavParamError, MavParamType, ParamError, ParamSet, ParamValue};
use mavstack::message::Text;

/// Sets a parameter, and waits for the confirmation that the client wants.
///
/// QGroundControl knows the type of a parameter before it sets it: here it is read first. MAVSDK reads it for an integer, and refuses to
/// set an integer where the vehicle has a `REAL32`; a float is sent as it is. MAVProxy and pymavlink send every number as `REAL32`.
#[derive(Clone, Debug)]
pub struct Set {
    name: String,
    value: Value,
    phase: Phase,
    answer: Answer,
}

#[derive(Clone, Debug)]
enum Phase {
    New,
    /// The type is as it was given.
    Typed,
    /// Learns the type.
    Read(Read),
    Set(Retry),
}

/// What was heard since the last PARAM_SET.
#[derive(Clone, Debug, Default)]
struct Answer {
    value: Option<Parameter>,
    error: Option<MavParamError>,
    /// MAVSDK repeats the request at once after another value: that there was one is kept.
    had_other: bool,
}

impl Answer {
    /// Whether the vehicle has answered at all.
    fn is_some(&self) -> bool {
        self.value.is_some() || self.error.is_some() || self.had_other
    }
}

impl Set {
    /// Creates the dialogue. QGroundControl sends the number as the type that the vehicle's parameter has.
    pub fn new(name: &str, value: impl Into<Value>) -> Self {
        Self { name: name.to_string(), value: value.into(), phase: Phase::New, answer: Answer::default() }
    }

    /// Creates a dialogue that sends exactly this type, right or wrong, without a read before.
    pub fn typed(name: &str, value: Value) -> Self {
        Self { phase: Phase::Typed, ..Self::new(name, value) }
    }

    fn timer(client: Client) -> Retry {
        match client {
            Client::Mavsdk => Retry::new(Duration::from_millis(500), 6),
            Client::QGroundControl | Client::MavProxy | Client::Pymavlink => Retry::new(Duration::from_secs(1), 3),
        }
    }

    fn transmit(&self, io: &mut Io<'_>) {
        let target = io.target();
        let param_type = self.value.param_type();
        io.send(&ParamSet {
            param_value: self.value.encode(io.client(), Encoding::of(io)),
            target_system: target.system.wire(),
            target_component: target.component.wire(),
            param_id: Text::new(&self.name),
            param_type,
        });
    }

    fn refused(&self, error: Option<MavParamError>) -> Failure {
        Failure::Param { name: self.name.clone(), error, text: None }
    }

    /// Learns the type, if the client must know it. Returns the failure of the read.
    fn learn(&mut self, io: &mut Io<'_>) -> Option<Failure> {
        if matches!(self.phase, Phase::New) {
            let is_float = matches!(self.value, Value::F32(_));
            self.phase = match io.client() {
                Client::Mavsdk if is_float => Phase::Set(Self::timer(Client::Mavsdk)),
                Client::QGroundControl | Client::Mavsdk => Phase::Read(Read::new(&self.name)),
                Client::MavProxy | Client::Pymavlink => {
                    self.value = Value::F32(self.value.number() as f32);
                    Phase::Set(Self::timer(io.client()))
                }
            };
        }
        if matches!(self.phase, Phase::Typed) {
            self.phase = Phase::Set(Self::timer(io.client()));
        }
        let Phase::Read(read) = &mut self.phase else { return None };
        match read.poll(io)? {
            // MAVSDK: an integer is not set where there is a float.
            Ok(parameter) if io.client() == Client::Mavsdk && parameter.param_type == MavParamType::REAL32 => {
                Some(self.refused(Some(MavParamError::TYPE_MISMATCH)))
            }
            Ok(parameter) => {
                let Some(value) = self.value.of_type(parameter.param_type) else {
                    let (name, number) = (&self.name, self.value);
                    return Some(Failure::Protocol(format!("parameter {name} is of a type that cannot hold {number}")));
                };
                self.value = value;
                self.phase = Phase::Set(Self::timer(io.client()));
                None
            }
            Err(failure) => Some(failure),
        }
    }

    /// Returns the result if the answer decides. MAVSDK repeats at once after another value.
    fn decide(&mut self, client: Client) -> Option<Result<Parameter, Failure>> {
        let Answer { value, error, .. } = &self.answer;
        if let Some(parameter) = value {
            let is_same = (parameter.value.number() - self.value.number()).abs() <= tolerance(client, self.value);
            match client {
                Client::Pymavlink => return Some(Ok(parameter.clone())),
                Client::Mavsdk if !is_type(parameter.param_type, self.value) => {
                    return Some(Err(self.refused(Some(MavParamError::TYPE_MISMATCH))));
                }
                _ if is_same => return Some(Ok(parameter.clone())),
                _ => {}
            }
        }
        let ends = matches!(client, Client::QGroundControl | Client::Mavsdk);
        error.filter(|_| ends).map(|error| Err(self.refused(Some(error))))
    }
}

/// Whether a value is of this type.
fn is_type(param_type: MavParamType, value: Value) -> bool {
    param_type == value.param_type()
}

/// Returns how far the confirmed value may be from the one that was set.
fn tolerance(client: Client, value: Value) -> f64 {
    match (client, value) {
        (Client::MavProxy, _) => 1e-5,
        (Client::QGroundControl, Value::F32(value)) => f64::from(value.abs()) * 1e-6,
        _ => 0.0,
    }
}

impl Dialogue for Set {
    type Output = Parameter;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Parameter, Failure>> {
        if let Some(failure) = self.learn(io) {
            return Some(Err(failure));
        }
        if let Some(result) = self.decide(io.client()) {
            return Some(result);
        }
        let Phase::Set(retry) = &mut self.phase else { return None };
        if io.client() == Client::Mavsdk && self.answer.value.take().is_some() {
            retry.hurry(io.now());
            self.answer.had_other = true;
        }
        match retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                self.transmit(io);
                None
            }
            Due::GiveUp if self.answer.is_some() => Some(Err(self.refused(self.answer.error))),
            Due::GiveUp => {
                let tries = retry.tries();
                Some(Err(Failure::timeout(format!("the set of parameter {}", self.name), tries)))
            }
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Phase::Read(read) = &mut self.phase {
            read.receive(io, frame);
            return;
        }
        if !is_from_target(io, frame) {
            return;
        }
        if let Some(message) = frame.decode::<ParamValue>()
            && name_of(&message.param_id) == self.name
        {
            self.answer.value = Some(parameter_of(io, &message));
        }
        if let Some(message) = frame.decode::<ParamError>()
            && name_of(&message.param_id) == self.name
        {
            self.answer.error = Some(message.error);
        }
    }
}
