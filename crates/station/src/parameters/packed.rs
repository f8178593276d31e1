//! The file `@PARAM/param.pck`: all parameters in one, as MAVProxy and QGroundControl download it from ArduPilot.

use super::{Parameter, Value};

/// Values only.
const MAGIC: u16 = 0x671B;
/// Values, and defaults that differ from them.
const MAGIC_DEFAULTS: u16 = 0x671C;

/// Why a file of parameters could not be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PackedError {
    /// It does not begin with the magic number.
    Magic,
    /// It ends within a parameter.
    Cut,
    /// It has a type of value that the format does not have.
    Type(u8),
    /// The name of a parameter repeats more of the last name than there is.
    Name,
    /// It has this number of parameters, not the one in its header.
    Count(usize),
}

impl std::fmt::Display for PackedError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Magic => f.write_str("the file of parameters has no magic number"),
            Self::Cut => f.write_str("the file of parameters ends within a parameter"),
            Self::Type(other) => write!(f, "the file of parameters has a value of type {other}"),
            Self::Name => f.write_str("the file of parameters has a damaged name"),
            Self::Count(count) => write!(f, "the file has {count} parameters, not the number in its header"),
        }
    }
}

impl std::error::Error for PackedError {}

/// Decodes the content of `@PARAM/param.pck`, with or without defaults, which are skipped.
///
/// # Errors
///
/// See [`PackedError`].
pub fn decode_packed(file: &[u8]) -> Result<Vec<Parameter>, PackedError> {
    let (header, mut rest) = file.split_first_chunk::<6>().ok_or(PackedError::Magic)?;
    let [m0, m1, n0, n1, ..] = *header;
    if ![MAGIC, MAGIC_DEFAULTS].contains(&u16::from_le_bytes([m0, m1])) {
        return Err(PackedError::Magic);
    }
    let mut parameters: Vec<Parameter> = Vec::new();
    let mut name: Vec<u8> = Vec::new();
    // Zeros pad a parameter that would lie across two packets.
    while let Some(start) = rest.iter().position(|&byte| byte != 0) {
        rest = &rest[start..];
        let ([kind, lengths], after) = rest.split_first_chunk::<2>().ok_or(PackedError::Cut)?;
        let (common, own) = (usize::from(lengths & 0x0F), usize::from(lengths >> 4) + 1);
        if common > name.len() {
            return Err(PackedError::Name);
        }
        name.truncate(common);
        name.extend(after.get(..own).ok_or(PackedError::Cut)?);
        let (value, size) = value_of(kind & 0x0F, &after[own..])?;
        let has_default = kind & 0x10 != 0;
        rest = after.get(own + size * (1 + usize::from(has_default))..).ok_or(PackedError::Cut)?;
        parameters.push(Parameter {
            name: String::from_utf8_lossy(&name).into_owned(),
            index: u16::try_from(parameters.len()).ok(),
            value,
            param_type: value.param_type(),
        });
    }
    let is_whole = parameters.len() == usize::from(u16::from_le_bytes([n0, n1]));
    if is_whole { Ok(parameters) } else { Err(PackedError::Count(parameters.len())) }
}

/// Reads a value of one of the four types, and returns it with its length in bytes.
fn value_of(kind: u8, bytes: &[u8]) -> Result<(Value, usize), PackedError> {
    let cut = PackedError::Cut;
    Ok(match kind {
        1 => (Value::I8(i8::from_le_bytes(*bytes.first_chunk().ok_or(cut)?)), 1),
        2 => (Value::I16(i16::from_le_bytes(*bytes.first_chunk().ok_or(cut)?)), 2),
        3 => (Value::I32(i32::from_le_bytes(*bytes.first_chunk().ok_or(cut)?)), 4),
        4 => (Value::F32(f32::from_le_bytes(*bytes.first_chunk().ok_or(cut)?)), 4),
        other => return Err(PackedError::Type(other)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_share_their_beginnings_and_defaults_are_skipped() {
        let mut file = vec![0x1C, 0x67, 2, 0, 2, 0];
        file.extend([0x14, 0x50]);
        file.extend(b"RTL_AL");
        file.extend(30.0f32.to_le_bytes());
        file.extend(15.0f32.to_le_bytes());
        file.extend([0, 0, 0x01, 0x34]);
        file.extend(b"TYPE");
        file.extend([0xFF]);
        let parameters = decode_packed(&file).expect("a whole file");
        let names: Vec<_> = parameters.iter().map(|parameter| (parameter.name.as_str(), parameter.value)).collect();
        assert_eq!(names, [("RTL_AL", Value::F32(30.0)), ("RTL_TYPE", Value::I8(-1))]);
        assert_eq!(decode_packed(&file[..12]), Err(PackedError::Cut));
        assert_eq!(decode_packed(b"nothing"), Err(PackedError::Magic));
    }
}
