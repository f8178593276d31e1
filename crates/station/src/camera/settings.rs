//! The settings of a camera: extended parameters.

use super::first_camera;
use crate::{Client, Dialogue, Due, Failure, Io, Received, Retry};
use mavstack::dialect::{
    MavParamError, MavParamExtType, ParamAck, ParamExtAck, ParamExtRequestList, ParamExtRequestRead, ParamExtSet,
    ParamExtValue,
};
use mavstack::{Address, Duration, Text};

/// The value of a setting.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "the names are the types")]
pub enum Value {
    U8(u8),
    I8(i8),
    U16(u16),
    I16(i16),
    U32(u32),
    I32(i32),
    U64(u64),
    I64(i64),
    F32(f32),
    F64(f64),
    /// Bytes of the camera's own meaning, such as a text, at most 128.
    Custom(Vec<u8>),
}

/// A setting of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: Value,
}

impl Value {
    /// Returns the type and the bytes on the wire.
    fn encode(&self) -> (MavParamExtType, Text<128>) {
        let (kind, bytes) = match self {
            Self::U8(value) => (MavParamExtType::UINT8, value.to_le_bytes().to_vec()),
            Self::I8(value) => (MavParamExtType::INT8, value.to_le_bytes().to_vec()),
            Self::U16(value) => (MavParamExtType::UINT16, value.to_le_bytes().to_vec()),
            Self::I16(value) => (MavParamExtType::INT16, value.to_le_bytes().to_vec()),
            Self::U32(value) => (MavParamExtType::UINT32, value.to_le_bytes().to_vec()),
            Self::I32(value) => (MavParamExtType::INT32, value.to_le_bytes().to_vec()),
            Self::U64(value) => (MavParamExtType::UINT64, value.to_le_bytes().to_vec()),
            Self::I64(value) => (MavParamExtType::INT64, value.to_le_bytes().to_vec()),
            Self::F32(value) => (MavParamExtType::REAL32, value.to_le_bytes().to_vec()),
            Self::F64(value) => (MavParamExtType::REAL64, value.to_le_bytes().to_vec()),
            Self::Custom(bytes) => (MavParamExtType::CUSTOM, bytes.clone()),
        };
        let mut wire = [0; 128];
        let len = bytes.len().min(wire.len());
        wire[..len].copy_from_slice(&bytes[..len]);
        (kind, Text::from_wire(wire))
    }

    /// Reads a value. An unknown type is [`Custom`](Self::Custom).
    fn decode(kind: MavParamExtType, wire: &[u8; 128]) -> Self {
        /// The first bytes of the value.
        fn first<const N: usize>(wire: &[u8; 128]) -> [u8; N] {
            std::array::from_fn(|at| wire[at])
        }
        match kind {
            MavParamExtType::UINT8 => Self::U8(wire[0]),
            MavParamExtType::INT8 => Self::I8(i8::from_le_bytes(first(wire))),
            MavParamExtType::UINT16 => Self::U16(u16::from_le_bytes(first(wire))),
            MavParamExtType::INT16 => Self::I16(i16::from_le_bytes(first(wire))),
            MavParamExtType::UINT32 => Self::U32(u32::from_le_bytes(first(wire))),
            MavParamExtType::INT32 => Self::I32(i32::from_le_bytes(first(wire))),
            MavParamExtType::UINT64 => Self::U64(u64::from_le_bytes(first(wire))),
            MavParamExtType::INT64 => Self::I64(i64::from_le_bytes(first(wire))),
            MavParamExtType::REAL32 => Self::F32(f32::from_le_bytes(first(wire))),
            MavParamExtType::REAL64 => Self::F64(f64::from_le_bytes(first(wire))),
            _ => Self::Custom(wire.to_vec()),
        }
    }
}

/// The timer of requests for settings.
fn reading(client: Client) -> Retry {
    match client {
        Client::QGroundControl => Retry::new(Duration::from_millis(3_500), 4),
        Client::Mavsdk => Retry::new(Duration::from_millis(500), 4),
        Client::MavProxy | Client::Pymavlink => Retry::new(Duration::from_millis(3_500), 3),
    }
}

/// The timer of changes.
fn writing(client: Client) -> Retry {
    match client {
        Client::QGroundControl => Retry::new(Duration::from_secs(3), 4),
        _ => reading(client),
    }
}

/// Returns the camera that was given, or the first one that was heard, or the autopilot.
fn camera_of(io: &Io<'_>, camera: Option<Address>) -> Address {
    camera.or_else(|| first_camera(io)).unwrap_or(io.target())
}

/// Lists the settings of a camera: PARAM_EXT_REQUEST_LIST, then those that are missing one by one. Ends with them, in the camera's
/// order.
///
/// The real QGroundControl and MAVProxy know the names of the settings by the camera's definition file, and request those by name.
#[derive(Debug, Default)]
pub struct ListSettings {
    camera: Option<Address>,
    retry: Option<Retry>,
    settings: Option<Vec<Option<Setting>>>,
}

impl ListSettings {
    /// Lists those of the first camera that was heard, or of the autopilot.
    pub fn new() -> Self {
        Self::default()
    }

    /// Lists those of this component.
    pub fn of(camera: Address) -> Self {
        Self { camera: Some(camera), ..Self::default() }
    }

    fn request(&self, io: &mut Io<'_>, camera: Address) {
        let (target_system, target_component) = (camera.system.wire(), camera.component.wire());
        let Some(settings) = &self.settings else {
            return io.send(&ParamExtRequestList { target_system, target_component });
        };
        let missing = settings.iter().enumerate().filter(|(_, setting)| setting.is_none());
        for (index, _) in missing {
            let param_index = index as i16;
            io.send(&ParamExtRequestRead { param_index, target_system, target_component, param_id: Text::EMPTY });
        }
    }
}

impl Dialogue for ListSettings {
    type Output = Vec<Setting>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Vec<Setting>, Failure>> {
        if let Some(all) = self.settings.as_ref().and_then(|settings| settings.iter().cloned().collect()) {
            return Some(Ok(all));
        }
        let camera = *self.camera.insert(camera_of(io, self.camera));
        let retry = self.retry.get_or_insert_with(|| reading(io.client()));
        match retry.due(io.now()) {
            Due::Wait => {}
            Due::Send => self.request(io, camera),
            Due::GiveUp => return Some(Err(Failure::timeout("PARAM_EXT_REQUEST_LIST", retry.tries()))),
        }
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let Some(message) = frame.decode::<ParamExtValue>().filter(|_| Some(frame.source()) == self.camera) else {
            return;
        };
        let settings = self.settings.get_or_insert_with(|| vec![None; usize::from(message.param_count)]);
        if let Some(setting) = settings.get_mut(usize::from(message.param_index)) {
            let name = message.param_id.as_str().unwrap_or_default().to_owned();
            *setting = Some(Setting { name, value: Value::decode(message.param_type, message.param_value.wire()) });
        }
        if let Some(retry) = &mut self.retry {
            // Something has come, so the tries begin again.
            *retry = reading(io.client());
            retry.extend(io.now(), Duration::from_millis(500));
        }
    }
}

/// Sets a setting of a camera by PARAM_EXT_SET. Ends with the value that the camera has then.
#[derive(Debug)]
pub struct SetSetting {
    camera: Option<Address>,
    setting: Setting,
    retry: Option<Retry>,
    ack: Option<ParamExtAck>,
}

impl SetSetting {
    /// Sets one of the first camera that was heard, or of the autopilot.
    pub fn new(name: impl Into<String>, value: Value) -> Self {
        Self { camera: None, setting: Setting { name: name.into(), value }, retry: None, ack: None }
    }

    /// Sets one of this component.
    #[must_use]
    pub fn of(mut self, camera: Address) -> Self {
        self.camera = Some(camera);
        self
    }

    fn outcome(&self) -> Option<Result<Value, Failure>> {
        let ack = self.ack?;
        let refusal = |error| Failure::Param { name: self.setting.name.clone(), error, text: None };
        match ack.param_result {
            ParamAck::ACCEPTED => Some(Ok(Value::decode(ack.param_type, ack.param_value.wire()))),
            ParamAck::IN_PROGRESS => None,
            ParamAck::VALUE_UNSUPPORTED => Some(Err(refusal(Some(MavParamError::VALUE_OUT_OF_RANGE)))),
            _ => Some(Err(refusal(None))),
        }
    }
}

impl Dialogue for SetSetting {
    type Output = Value;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Value, Failure>> {
        if let Some(outcome) = self.outcome() {
            return Some(outcome);
        }
        let camera = *self.camera.insert(camera_of(io, self.camera));
        let retry = self.retry.get_or_insert_with(|| writing(io.client()));
        match retry.due(io.now()) {
            Due::Wait => None,
            Due::Send => {
                let (param_type, param_value) = self.setting.value.encode();
                io.send(&ParamExtSet {
                    target_system: camera.system.wire(),
                    target_component: camera.component.wire(),
                    param_id: Text::new(&self.setting.name),
                    param_value,
                    param_type,
                });
                None
            }
            Due::GiveUp => {
                Some(Err(Failure::timeout(format!("PARAM_EXT_SET of {}", self.setting.name), retry.tries())))
            }
        }
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        let is_ours = |ack: &ParamExtAck| ack.param_id.as_str() == Some(&self.setting.name);
        let Some(ack) = frame.decode().filter(is_ours).filter(|_| Some(frame.source()) == self.camera) else { return };
        self.ack = Some(ack);
        if let Some(retry) = self.retry.as_mut().filter(|_| ack.param_result == ParamAck::IN_PROGRESS) {
            retry.extend(io.now(), Duration::from_secs(3));
        }
    }
}
