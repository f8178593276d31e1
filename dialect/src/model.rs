//! The model of a definition, and its properties on the wire: order, lengths, offsets, `CRC_EXTRA`.
//!
//! Implements <https://mavlink.io/en/guide/xml_schema.html> and the field order of
//! <https://mavlink.io/en/guide/serialization.html>.

use crate::Error;
use std::{path::Path, sync::Arc};

/// The position of an element, for error messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The XML file.
    pub file: Arc<Path>,
    /// Line of the element, from 1.
    pub line: u32,
}

impl Origin {
    /// Returns an error about the element at this position.
    pub(crate) fn error(&self, element: impl Into<String>, problem: impl Into<String>) -> Error {
        Error { file: self.file.to_path_buf(), line: Some(self.line), element: element.into(), problem: problem.into() }
    }
}

/// A definition with its includes.
#[derive(Clone, Debug)]
pub struct Dialect {
    /// The files. An included file precedes the one that includes it; the input file is the last.
    pub files: Vec<Arc<Path>>,
    /// Enumerations, sorted by name. Those with the same name in several files are merged.
    pub enums: Vec<Enum>,
    /// Messages, sorted by id.
    pub messages: Vec<Message>,
}

impl Dialect {
    /// Returns the enumeration with this name.
    pub fn enumeration(&self, name: &str) -> Option<&Enum> {
        self.enums.binary_search_by(|e| e.name.as_str().cmp(name)).ok().map(|at| &self.enums[at])
    }

    /// Returns the message with this name.
    pub fn message(&self, name: &str) -> Option<&Message> {
        self.messages.iter().find(|message| message.name == name)
    }
}

/// The status of an element that is not, or no longer, recommended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lifecycle {
    /// It may still change.
    WorkInProgress,
    /// It should no longer be used.
    Deprecated(Replacement),
    /// It is still in use, but has a better replacement.
    Superseded(Replacement),
}

/// The replacement of a deprecated or superseded element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replacement {
    /// Year and month of the replacement.
    pub since: String,
    /// Name of the new element, or a text; may be empty.
    pub replaced_by: String,
}

/// An enumeration or bitmask.
#[derive(Clone, Debug)]
pub struct Enum {
    /// MAVLink's name.
    pub name: String,
    /// Whether its values are bits.
    pub bitmask: bool,
    /// Description; may be empty.
    pub description: String,
    /// Status, if it is not in regular use.
    pub lifecycle: Option<Lifecycle>,
    /// The entries, sorted by value.
    pub entries: Vec<Entry>,
    /// Position of its first definition.
    pub origin: Origin,
}

/// A value of an enumeration; in `MAV_CMD`, a command.
#[derive(Clone, Debug)]
pub struct Entry {
    /// MAVLink's name.
    pub name: String,
    /// The value on the wire. The type holds the values of all integer types.
    pub value: i128,
    /// Description; may be empty.
    pub description: String,
    /// Status, if it is not in regular use.
    pub lifecycle: Option<Lifecycle>,
    /// Whether parameters 5, 6 and 7 of the command are a position.
    pub has_location: Option<bool>,
    /// Whether the vehicle flies to that position.
    pub is_destination: Option<bool>,
    /// Whether parameter 7 of the command is an altitude, without a position.
    pub has_altitude_only: bool,
    /// Whether the command is allowed in plans only. Newer definitions list the places instead.
    pub mission_only: bool,
    /// Whether missions may contain the command.
    pub in_mission: bool,
    /// Whether geofences may contain the command.
    pub in_fence: bool,
    /// Whether sets of rally points may contain the command.
    pub in_rally: bool,
    /// Whether the command may be sent in COMMAND_INT and COMMAND_LONG.
    pub as_command: bool,
    /// The command's parameters, sorted by index.
    pub params: Vec<Param>,
    /// Position of the definition.
    pub origin: Origin,
}

/// One of the seven parameters of a command.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Param {
    /// The number of the parameter, 1 to 7.
    pub index: u8,
    /// Short name; may be empty.
    pub label: String,
    /// Unit; may be empty.
    pub units: String,
    /// Name of the enumeration with its values; may be empty.
    pub enumeration: String,
    /// The smallest allowed value.
    pub minimum: Option<f64>,
    /// The largest allowed value.
    pub maximum: Option<f64>,
    /// The step between allowed values, from the minimum.
    pub increment: Option<f64>,
    /// The value that is sent by default; may be NaN.
    pub default: Option<f64>,
    /// Whether the parameter is reserved: clients send the default.
    pub reserved: bool,
    /// The factor between the sent and the actual value, as a number or a fraction; may be empty.
    pub multiplier: String,
    /// Description; may be empty.
    pub description: String,
}

/// A message.
#[derive(Clone, Debug)]
pub struct Message {
    /// The message id, 24 bits.
    pub id: u32,
    /// MAVLink's name.
    pub name: String,
    /// Description; may be empty.
    pub description: String,
    /// Status, if it is not in regular use.
    pub lifecycle: Option<Lifecycle>,
    /// The fields in the order of the definition; extensions are last.
    pub fields: Vec<Field>,
    /// Position of the definition.
    pub origin: Origin,
}

/// A field of a message.
#[derive(Clone, Debug)]
pub struct Field {
    /// MAVLink's name.
    pub name: String,
    /// Type of the field, or of its elements.
    pub scalar: Scalar,
    /// Length of the array; `None` if the field is not an array.
    pub array: Option<u8>,
    /// The version of the definitions, if the field is sent with it (`uint8_t_mavlink_version`).
    pub version: Option<u8>,
    /// Whether it is an extension field: not in MAVLink 1, and not a part of `CRC_EXTRA`.
    pub extension: bool,
    /// Unit; may be empty.
    pub units: String,
    /// Name of the enumeration with its values; may be empty.
    pub enumeration: String,
    /// The value that means "not known", in MAVLink's notation; may be empty.
    pub invalid: String,
    /// The factor between the sent and the actual value, as a number or a fraction; may be empty.
    pub multiplier: String,
    /// The smallest allowed value.
    pub minimum: Option<f64>,
    /// The largest allowed value.
    pub maximum: Option<f64>,
    /// The value that is sent by default; may be NaN.
    pub default: Option<f64>,
    /// Whether it identifies the instance, for example one of several batteries that send the same message.
    pub instance: bool,
    /// How tools should display it; may be empty.
    pub display: String,
    /// How tools should print it; may be empty.
    pub print_format: String,
    /// Description; may be empty.
    pub description: String,
    /// Position of the definition.
    pub origin: Origin,
}

impl Field {
    /// Returns the size on the wire in bytes.
    pub fn size(&self) -> usize {
        self.scalar.size() * usize::from(self.array.unwrap_or(1))
    }
}

/// The type of a field or of an array's element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs, reason = "named like Rust's types")]
pub enum Scalar {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
    /// A byte of a text.
    Char,
}

impl Scalar {
    /// All types.
    pub const ALL: [Self; 11] = [
        Self::U8,
        Self::I8,
        Self::U16,
        Self::I16,
        Self::U32,
        Self::I32,
        Self::U64,
        Self::I64,
        Self::F32,
        Self::F64,
        Self::Char,
    ];

    /// Returns the size on the wire in bytes, MAVLink's name, and the name in generated code.
    const fn properties(self) -> (usize, &'static str, &'static str) {
        match self {
            Self::U8 => (1, "uint8_t", "u8"),
            Self::I8 => (1, "int8_t", "i8"),
            Self::U16 => (2, "uint16_t", "u16"),
            Self::I16 => (2, "int16_t", "i16"),
            Self::U32 => (4, "uint32_t", "u32"),
            Self::I32 => (4, "int32_t", "i32"),
            Self::U64 => (8, "uint64_t", "u64"),
            Self::I64 => (8, "int64_t", "i64"),
            Self::F32 => (4, "float", "f32"),
            Self::F64 => (8, "double", "f64"),
            Self::Char => (1, "char", "Char"),
        }
    }

    /// Returns the size on the wire in bytes.
    pub fn size(self) -> usize {
        self.properties().0
    }

    /// Returns MAVLink's name, which is a part of `CRC_EXTRA`.
    pub fn wire_name(self) -> &'static str {
        self.properties().1
    }

    /// Returns the type's name in generated code.
    pub fn rust_name(self) -> &'static str {
        self.properties().2
    }

    /// Returns the smallest and the largest value of an integer type; `None` for other types.
    pub fn range(self) -> Option<(i128, i128)> {
        Some(match self {
            Self::U8 => (0, u8::MAX.into()),
            Self::I8 => (i8::MIN.into(), i8::MAX.into()),
            Self::U16 => (0, u16::MAX.into()),
            Self::I16 => (i16::MIN.into(), i16::MAX.into()),
            Self::U32 => (0, u32::MAX.into()),
            Self::I32 => (i32::MIN.into(), i32::MAX.into()),
            Self::U64 => (0, u64::MAX.into()),
            Self::I64 => (i64::MIN.into(), i64::MAX.into()),
            Self::F32 | Self::F64 | Self::Char => return None,
        })
    }
}

impl Message {
    /// Returns the base fields in wire order: sorted by element size (8, 4, 2, 1 bytes), and fields of the same size in
    /// the order of the definition (S-4).
    pub fn base(&self) -> Vec<&Field> {
        let mut base: Vec<_> = self.fields.iter().filter(|field| !field.extension).collect();
        // `sort_by_key` is stable.
        base.sort_by_key(|field| std::cmp::Reverse(field.scalar.size()));
        base
    }

    /// Returns the extension fields, which are sent in the order of the definition.
    pub fn extensions(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter().filter(|field| field.extension)
    }

    /// Returns all fields in wire order.
    pub fn wire_order(&self) -> Vec<&Field> {
        let mut fields = self.base();
        fields.extend(self.extensions());
        fields
    }

    /// Returns the length of the base fields in bytes.
    pub fn base_len(&self) -> usize {
        self.fields.iter().filter(|field| !field.extension).map(Field::size).sum()
    }

    /// Returns the length with all extension fields in bytes.
    pub fn max_len(&self) -> usize {
        self.fields.iter().map(Field::size).sum()
    }

    /// Returns the offset of the field with this name in the payload.
    pub fn offset(&self, name: &str) -> Option<usize> {
        let fields = self.wire_order();
        let at = fields.iter().position(|field| field.name == name)?;
        Some(fields.iter().take(at).map(|field| field.size()).sum())
    }

    /// Returns `CRC_EXTRA`, the last byte of the checksum's input: a digest of the names, types and order of the base
    /// fields (S-3).
    pub fn crc_extra(&self) -> u8 {
        let mut crc = crc_any::CRCu16::crc16mcrf4cc();
        crc.digest(format!("{} ", self.name).as_bytes());
        for field in self.base() {
            crc.digest(format!("{} {} ", field.scalar.wire_name(), field.name).as_bytes());
            crc.digest(field.array.as_slice());
        }
        let [low, high] = crc.get_crc().to_le_bytes();
        low ^ high
    }
}
