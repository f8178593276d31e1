//! Values of parameters and their encodings.

use crate::{Client, Io};
use mavstack::dialect::{MavAutopilot, MavParamType};

/// A parameter of the vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name: 1 to 16 bytes.
    pub name: String,
    /// Its index; `None` if the vehicle did not tell it.
    pub index: Option<u16>,
    /// Its value, as the client decodes it.
    pub value: Value,
    /// Its type, as the vehicle says.
    pub param_type: MavParamType,
}

/// The value of a parameter, with its type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// `UINT8`
    U8(u8),
    /// `INT8`
    I8(i8),
    /// `UINT16`
    U16(u16),
    /// `INT16`
    I16(i16),
    /// `UINT32`
    U32(u32),
    /// `INT32`
    I32(i32),
    /// `REAL32`
    F32(f32),
}

/// How the `f32` of PARAM_VALUE and PARAM_SET carries an integer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As its bytes (`MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE`).
    Bytewise,
    /// As a number (`MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST`).
    Cast,
}

impl Encoding {
    /// Returns the encoding that the client assumes. All of them go by the autopilot's number and ignore the capability.
    pub fn of(io: &Io<'_>) -> Self {
        let heartbeat = io.seen().component(io.target()).and_then(|component| component.heartbeat);
        let autopilot = heartbeat.map_or(MavAutopilot::GENERIC, |heartbeat| heartbeat.autopilot);
        let is_bytewise = match io.client() {
            Client::QGroundControl | Client::Mavsdk => autopilot != MavAutopilot::ARDUPILOTMEGA,
            Client::MavProxy | Client::Pymavlink => autopilot == MavAutopilot::PX4,
        };
        if is_bytewise { Self::Bytewise } else { Self::Cast }
    }
}

impl Value {
    /// Returns the type.
    pub const fn param_type(self) -> MavParamType {
        match self {
            Self::U8(_) => MavParamType::UINT8,
            Self::I8(_) => MavParamType::INT8,
            Self::U16(_) => MavParamType::UINT16,
            Self::I16(_) => MavParamType::INT16,
            Self::U32(_) => MavParamType::UINT32,
            Self::I32(_) => MavParamType::INT32,
            Self::F32(_) => MavParamType::REAL32,
        }
    }

    /// Returns the number.
    pub fn number(self) -> f64 {
        match self {
            Self::U8(value) => value.into(),
            Self::I8(value) => value.into(),
            Self::U16(value) => value.into(),
            Self::I16(value) => value.into(),
            Self::U32(value) => value.into(),
            Self::I32(value) => value.into(),
            Self::F32(value) => value.into(),
        }
    }

    /// Returns the number as a value of this type; `None` if the type cannot hold it: a fraction of an integer, a number out of its
    /// range, a type of 64 bits.
    pub fn of_type(self, param_type: MavParamType) -> Option<Self> {
        let number = self.number();
        let is_whole_in = |least: f64, most: f64| number.fract() == 0.0 && (least..=most).contains(&number);
        match param_type {
            MavParamType::UINT8 => is_whole_in(0.0, u8::MAX.into()).then_some(Self::U8(number as u8)),
            MavParamType::INT8 => is_whole_in(i8::MIN.into(), i8::MAX.into()).then_some(Self::I8(number as i8)),
            MavParamType::UINT16 => is_whole_in(0.0, u16::MAX.into()).then_some(Self::U16(number as u16)),
            MavParamType::INT16 => is_whole_in(i16::MIN.into(), i16::MAX.into()).then_some(Self::I16(number as i16)),
            MavParamType::UINT32 => is_whole_in(0.0, u32::MAX.into()).then_some(Self::U32(number as u32)),
            MavParamType::INT32 => is_whole_in(i32::MIN.into(), i32::MAX.into()).then_some(Self::I32(number as i32)),
            MavParamType::REAL32 => Some(Self::F32(number as f32)),
            _ => None,
        }
    }

    /// Returns the value in the field of a PARAM_VALUE. With [`Encoding::Cast`], or an unknown type, it is the field itself.
    pub fn decode(field: f32, param_type: MavParamType, encoding: Encoding) -> Self {
        if encoding == Encoding::Cast {
            return Self::F32(field);
        }
        let bytes = field.to_bits().to_le_bytes();
        let [a, b, ..] = bytes;
        match param_type {
            MavParamType::UINT8 => Self::U8(a),
            MavParamType::INT8 => Self::I8(i8::from_le_bytes([a])),
            MavParamType::UINT16 => Self::U16(u16::from_le_bytes([a, b])),
            MavParamType::INT16 => Self::I16(i16::from_le_bytes([a, b])),
            MavParamType::UINT32 => Self::U32(u32::from_le_bytes(bytes)),
            MavParamType::INT32 => Self::I32(i32::from_le_bytes(bytes)),
            _ => Self::F32(field),
        }
    }

    /// Returns the field of a PARAM_SET with this value, as the client encodes it.
    pub fn encode(self, client: Client, encoding: Encoding) -> f32 {
        if encoding == Encoding::Cast {
            return self.number() as f32;
        }
        let bits = match self {
            Self::F32(value) => return value,
            Self::I32(value) => value as u32,
            // MAVSDK encodes no other integers, and sends NaN.
            _ if client == Client::Mavsdk => return f32::NAN,
            Self::U8(value) => value.into(),
            Self::I8(value) => u8::from_le_bytes(value.to_le_bytes()).into(),
            Self::U16(value) => value.into(),
            Self::I16(value) => u16::from_le_bytes(value.to_le_bytes()).into(),
            Self::U32(value) => value,
        };
        f32::from_bits(bits)
    }
}

impl From<f32> for Value {
    fn from(value: f32) -> Self {
        Self::F32(value)
    }
}

impl From<i32> for Value {
    fn from(value: i32) -> Self {
        Self::I32(value)
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            // The shortest text of the f32, not of the f64 with the same value.
            Self::F32(value) => value.fmt(f),
            value => value.number().fmt(f),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_survives_its_encoding() {
        let values =
            [Value::U8(200), Value::I8(-3), Value::U16(60_000), Value::I16(-300), Value::U32(u32::MAX), Value::I32(-1)];
        for value in values {
            let field = value.encode(Client::QGroundControl, Encoding::Bytewise);
            assert_eq!(Value::decode(field, value.param_type(), Encoding::Bytewise), value);
        }
    }

    #[test]
    fn a_number_is_converted_only_where_it_is_kept() {
        assert_eq!(Value::F32(3.0).of_type(MavParamType::INT32), Some(Value::I32(3)));
        assert_eq!(Value::F32(0.5).of_type(MavParamType::INT32), None);
        assert_eq!(Value::I32(-1).of_type(MavParamType::UINT8), None);
        assert_eq!(Value::I32(1).of_type(MavParamType::REAL64), None);
    }
}
