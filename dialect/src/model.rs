//! All that a definition says, and what follows from it on the wire: order, lengths, offsets, `CRC_EXTRA`.
//!
//! Implements <https://mavlink.io/en/guide/xml_schema.html> and the field order of
//! <https://mavlink.io/en/guide/serialization.html>.

use crate::Error;
use std::{path::Path, sync::Arc};

/// Where an element stands, for messages to people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The XML file.
    pub file: Arc<Path>,
    /// Line of the element, from 1.
    pub line: u32,
}

impl Origin {
    /// An error about the element that stands here.
    pub(crate) fn error(&self, element: impl Into<String>, problem: impl Into<String>) -> Error {
        Error { file: self.file.to_path_buf(), line: Some(self.line), element: element.into(), problem: problem.into() }
    }
}

/// A definition with its includes: what one XML file given to a MAVLink tool means.
#[derive(Clone, Debug)]
pub struct Dialect {
    /// The files, an included one before the one that includes it; the last is the input.
    pub files: Vec<Arc<Path>>,
    /// Enumerations, sorted by name; those of one name from several files are merged.
    pub enums: Vec<Enum>,
    /// Messages, sorted by id.
    pub messages: Vec<Message>,
}

impl Dialect {
    /// The enumeration of this name.
    pub fn enumeration(&self, name: &str) -> Option<&Enum> {
        self.enums.binary_search_by(|e| e.name.as_str().cmp(name)).ok().map(|at| &self.enums[at])
    }

    /// The message of this name.
    pub fn message(&self, name: &str) -> Option<&Message> {
        self.messages.iter().find(|message| message.name == name)
    }
}

/// Whether an element is still, or not yet, meant to be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lifecycle {
    /// May still change.
    WorkInProgress,
    /// Not to be used any more.
    Deprecated(Replacement),
    /// There is something better; still in use.
    Superseded(Replacement),
}

/// What stands in the place of a deprecated or superseded element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replacement {
    /// Year and month.
    pub since: String,
    /// Name of the new element, or a text; may be empty.
    pub replaced_by: String,
}

/// An enumeration or bitmask.
#[derive(Clone, Debug)]
pub struct Enum {
    /// MAVLink's name.
    pub name: String,
    /// Its values are bits.
    pub bitmask: bool,
    /// What it is, may be empty.
    pub description: String,
    /// Whether it is still in use.
    pub lifecycle: Option<Lifecycle>,
    /// Sorted by value.
    pub entries: Vec<Entry>,
    /// Where it stands first.
    pub origin: Origin,
}

/// A value of an enumeration; in `MAV_CMD`, a command.
#[derive(Clone, Debug)]
pub struct Entry {
    /// MAVLink's name.
    pub name: String,
    /// The value on the wire; every entry of every integer type fits.
    pub value: i128,
    /// What it means, may be empty.
    pub description: String,
    /// Whether it is still in use.
    pub lifecycle: Option<Lifecycle>,
    /// Parameters 5, 6, 7 of the command are a position.
    pub has_location: Option<bool>,
    /// The vehicle flies to that position.
    pub is_destination: Option<bool>,
    /// The command stands in plans only.
    pub mission_only: bool,
    /// The command's parameters, sorted by index.
    pub params: Vec<Param>,
    /// Where it stands.
    pub origin: Origin,
}

/// One of the seven parameters of a command.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Param {
    /// 1 to 7.
    pub index: u8,
    /// Short name, may be empty.
    pub label: String,
    /// Unit, may be empty.
    pub units: String,
    /// Name of the enumeration of its values, may be empty.
    pub enumeration: String,
    /// The least value allowed.
    pub minimum: Option<f64>,
    /// The greatest value allowed.
    pub maximum: Option<f64>,
    /// Values are multiples of this, from the minimum.
    pub increment: Option<f64>,
    /// What to send when there is nothing to say; may be NaN.
    pub default: Option<f64>,
    /// Not in use: to be sent as the default.
    pub reserved: bool,
    /// The real value is the sent one times this: a number or a fraction; may be empty.
    pub multiplier: String,
    /// What it means, may be empty.
    pub description: String,
}

/// A message.
#[derive(Clone, Debug)]
pub struct Message {
    /// 24 bits.
    pub id: u32,
    /// MAVLink's name.
    pub name: String,
    /// What it says, may be empty.
    pub description: String,
    /// Whether it is still in use.
    pub lifecycle: Option<Lifecycle>,
    /// In the order of the definition; extensions last.
    pub fields: Vec<Field>,
    /// Where it stands.
    pub origin: Origin,
}

/// A field of a message.
#[derive(Clone, Debug)]
pub struct Field {
    /// MAVLink's name.
    pub name: String,
    /// Type of the field, or of its elements.
    pub scalar: Scalar,
    /// Length of the array.
    pub array: Option<u8>,
    /// Holds the definitions' version (`uint8_t_mavlink_version`): that of the file.
    pub version: Option<u8>,
    /// Not in v1, not in `CRC_EXTRA`.
    pub extension: bool,
    /// Unit, may be empty.
    pub units: String,
    /// Name of the enumeration of its values, may be empty.
    pub enumeration: String,
    /// The value that says "unknown", in MAVLink's notation; may be empty.
    pub invalid: String,
    /// The real value is the sent one times this: a number or a fraction; may be empty.
    pub multiplier: String,
    /// The least value allowed.
    pub minimum: Option<f64>,
    /// The greatest value allowed.
    pub maximum: Option<f64>,
    /// What to send when there is nothing to say; may be NaN.
    pub default: Option<f64>,
    /// Tells apart several sensors (and such) that send the same message.
    pub instance: bool,
    /// How a tool should show it, may be empty.
    pub display: String,
    /// How a tool should print it, may be empty.
    pub print_format: String,
    /// What it means, may be empty.
    pub description: String,
    /// Where it stands.
    pub origin: Origin,
}

impl Field {
    /// Bytes on the wire.
    pub fn size(&self) -> usize {
        self.scalar.size() * usize::from(self.array.unwrap_or(1))
    }
}

/// A type of one value on the wire.
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
    /// A byte of text.
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

    /// Bytes on the wire.
    pub fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 | Self::Char => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// MAVLink's name, as it goes into `CRC_EXTRA`.
    pub fn wire_name(self) -> &'static str {
        match self {
            Self::U8 => "uint8_t",
            Self::I8 => "int8_t",
            Self::U16 => "uint16_t",
            Self::I16 => "int16_t",
            Self::U32 => "uint32_t",
            Self::I32 => "int32_t",
            Self::U64 => "uint64_t",
            Self::I64 => "int64_t",
            Self::F32 => "float",
            Self::F64 => "double",
            Self::Char => "char",
        }
    }

    /// The type in generated code.
    pub fn rust_name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::Char => "Char",
        }
    }

    /// The least and the greatest value of an integer.
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
    /// The base fields in wire order: elements of 8 bytes first, then 4, 2, 1, and otherwise as in the definition (S-4).
    pub fn base(&self) -> Vec<&Field> {
        let mut base: Vec<_> = self.fields.iter().filter(|field| !field.extension).collect();
        // A stable sort.
        base.sort_by_key(|field| std::cmp::Reverse(field.scalar.size()));
        base
    }

    /// The extension fields, which stand on the wire as they stand in the definition.
    pub fn extensions(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter().filter(|field| field.extension)
    }

    /// All fields in the order of the wire.
    pub fn wire_order(&self) -> Vec<&Field> {
        let mut fields = self.base();
        fields.extend(self.extensions());
        fields
    }

    /// Bytes of the base fields.
    pub fn base_len(&self) -> usize {
        self.fields.iter().filter(|field| !field.extension).map(Field::size).sum()
    }

    /// Bytes with the extensions.
    pub fn max_len(&self) -> usize {
        self.fields.iter().map(Field::size).sum()
    }

    /// Where the field of this name begins in the payload.
    pub fn offset(&self, name: &str) -> Option<usize> {
        let fields = self.wire_order();
        let at = fields.iter().position(|field| field.name == name)?;
        Some(fields.iter().take(at).map(|field| field.size()).sum())
    }

    /// The byte that a frame's checksum ends with: a digest of names, types and order of the base fields (S-3).
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
