//! `param.pck`: all parameters in one file, which ground stations load and send by FTP (P-22, F-14).
//!
//! The format is ArduPilot's (`AP_Filesystem_Param`), which MAVProxy and QGroundControl read: a header, then a record for each
//! parameter, in the order of the table.
//!
//! ```text
//!   header   magic u16 (0x671B, or 0x671C with defaults), number of records u16, number of parameters u16
//!            (the third word of an upload is the length of the file)
//!   record   type and flags, common and rest of the name, rest of the name, value, default
//! ```
//!
//! A name repeats up to 15 bytes of the one before. Zeros between records keep a value from crossing a packet's end, so that
//! it is not torn if it changes meanwhile. The file is made while it is read. The length of a record depends only on what
//! does not change, so any part of it can be read again.
//!
//! Behind the last record there are zeros, which decoders skip and MAVLink 2 does not send. They extend the file to the length
//! of as many of the longest records, whatever the length of the client's packets (F-30).
//!
//! Integers without a sign are in the next larger type, which the format has with a sign only. A larger u32 is a float. In an upload, a
//! float that is a whole number is accepted for any integer (P-19).

use core::borrow::Borrow;

use super::info::ParamInfo;
use super::table::Rows;
use super::value;
use crate::dialect::{MavFtpErr, MavParamType};
use crate::num;
use crate::service::files::{Body, Entries};

/// The name of the file.
const NAME: &[u8] = b"param.pck";

const MAGIC: u16 = 0x671B;
const MAGIC_WITH_DEFAULTS: u16 = 0x671C;

const HEADER_LEN: u32 = 6;

/// The most that a record takes: padding, two bytes, the name, the value and, if it is in the file, the default.
const MAX_RECORD: usize = 3 + 2 + 16 + 4 + 4;
const LONGEST: u32 = 3 + 2 + 16 + 4;
const LONGEST_WITH_DEFAULT: u32 = LONGEST + 4;

/// The number of records that a call skips at most.
const STEP: u8 = 64;

/// The length of a packet's data if no client has chosen one yet.
const USUAL_BLOCK: u8 = 239;

/// The types of the format.
const INT8: u8 = 1;
const INT16: u8 = 2;
const INT32: u8 = 3;
const FLOAT: u8 = 4;

/// A file that is being read.
#[derive(Clone, Copy, Debug)]
pub struct Pack {
    /// The first parameter, and the number of them.
    first: u16,
    count: u16,
    /// The number of parameters in the table.
    total: u16,
    has_defaults: bool,
    /// The length of the client's packets: 0 until it has read.
    block: u8,
    /// The record that begins at `at`.
    index: u16,
    at: u32,
}

impl Pack {
    /// Returns the file of a table of `total` parameters that a client asks for: `path` is its name and the query. Refused if the
    /// query is wrong, or there is no such parameter; also any query for an upload.
    pub(super) fn open(path: &[u8], total: u16, is_upload: bool) -> Result<Self, MavFtpErr> {
        let query = match path.strip_prefix(NAME) {
            Some([]) => b"",
            Some([b'?', ..]) if is_upload => return Err(MavFtpErr::FILEPROTECTED),
            Some([b'?', query @ ..]) => query,
            _ => return Err(MavFtpErr::FILENOTFOUND),
        };
        Self::of(query, total).ok_or(MavFtpErr::FAIL)
    }

    fn of(query: &[u8], total: u16) -> Option<Self> {
        let mut pack = Self { first: 0, count: total, total, has_defaults: false, block: 0, index: 0, at: HEADER_LEN };
        let mut limit = 0;
        for part in query.split(|byte| *byte == b'&').filter(|part| !part.is_empty()) {
            let key = part.split(|byte| *byte == b'=').next().unwrap_or_default();
            let number = decimal(part.get(key.len().saturating_add(1)..)?)?;
            match key {
                b"start" => pack.first = number,
                b"count" => limit = number,
                b"withdefaults" => pack.has_defaults = number != 0,
                _ => {}
            }
        }
        pack.count = total.checked_sub(pack.first).filter(|count| *count > 0)?;
        if limit > 0 {
            pack.count = pack.count.min(limit);
        }
        Some(pack)
    }

    /// Remembers the length of the client's packets, when it first reads.
    pub(super) const fn set_block(&mut self, block: u8) {
        if self.block == 0 {
            (self.block, self.index, self.at) = (block, 0, HEADER_LEN);
        }
    }

    /// Returns the length of the file (F-30).
    pub(super) fn len(&self) -> u32 {
        len(self.count, if self.has_defaults { LONGEST_WITH_DEFAULT } else { LONGEST })
    }

    /// Reads from any place of the file. [`Body::Later`] if it takes another call to find that place.
    pub(super) fn read<R: Rows>(&mut self, rows: &R, offset: u32, out: &mut [u8]) -> Body {
        if offset < self.at {
            (self.index, self.at) = (0, HEADER_LEN);
        }
        let header = self.header();
        let mut len = copy(&header, offset, out);
        let mut steps = STEP;
        while len < out.len() {
            let Some((record, record_len)) = self.record(rows) else { break };
            let place = offset.saturating_add(u32::try_from(len).unwrap_or(0)).saturating_sub(self.at);
            let bytes = record.get(..record_len).unwrap_or_default();
            let copied = copy(bytes, place, out.get_mut(len..).unwrap_or_default());
            len = len.saturating_add(copied);
            let used = usize::try_from(place).unwrap_or(usize::MAX).saturating_add(copied);
            if used < record_len {
                break;
            }
            self.advance(record_len);
            if copied == 0 {
                steps = steps.saturating_sub(1);
                if steps == 0 {
                    return Body::Later;
                }
            }
        }
        let end = offset.saturating_add(u32::try_from(len).unwrap_or(0));
        let rest = usize::try_from(self.len().saturating_sub(end)).unwrap_or(usize::MAX);
        for byte in out.iter_mut().skip(len).take(rest) {
            *byte = 0;
            len = len.saturating_add(1);
        }
        Body::Data(len)
    }

    fn advance(&mut self, len: usize) {
        self.index = self.index.saturating_add(1);
        self.at = self.at.saturating_add(u32::try_from(len).unwrap_or(0));
    }

    fn header(&self) -> [u8; 6] {
        let magic = if self.has_defaults { MAGIC_WITH_DEFAULTS } else { MAGIC };
        let ([a, b], [c, d], [e, f]) = (magic.to_le_bytes(), self.count.to_le_bytes(), self.total.to_le_bytes());
        [a, b, c, d, e, f]
    }

    /// Returns the record at `at` and its length; `None` behind the last one.
    fn record<R: Rows>(&self, rows: &R) -> Option<([u8; MAX_RECORD], usize)> {
        if self.index >= self.count {
            return None;
        }
        let index = self.first.checked_add(self.index)?;
        let (info, bits) = rows.get(index)?;
        let info: &ParamInfo = info.borrow();
        let name = info.name_bytes();
        let mut common = 0usize;
        if self.index > 0
            && let Some((before, _)) = rows.get(index.saturating_sub(1))
        {
            let before: &ParamInfo = before.borrow();
            for _ in name.iter().zip(before.name_bytes()).take_while(|(a, b)| a == b) {
                common = common.saturating_add(1);
            }
        }
        // At least one byte of the name is not repeated.
        let common = common.min(name.len().saturating_sub(1)).min(15);
        let rest = name.get(common..).unwrap_or_default();
        let (kind, value, size) = packed(info, bits, self.has_defaults);
        let mut record = [0; MAX_RECORD];
        let head = rest.len().saturating_add(2);
        let mut len = self.padding(head, size);
        let mut push = |bytes: &[u8]| {
            for (to, from) in record.get_mut(len..).unwrap_or_default().iter_mut().zip(bytes) {
                *to = *from;
                len = len.saturating_add(1);
            }
        };
        let lens = nibbles(common, rest.len().saturating_sub(1));
        push(&[kind | if self.has_defaults { 0x10 } else { 0 }, lens]);
        push(rest);
        push(value.to_le_bytes().get(..size).unwrap_or_default());
        if self.has_defaults {
            let default = default_as(kind, info);
            push(default.to_le_bytes().get(..size).unwrap_or_default());
        }
        Some((record, len))
    }

    /// Returns the number of zeros before a record whose value would otherwise cross a packet's end.
    fn padding(&self, head: usize, size: usize) -> usize {
        let block = if self.block == 0 { USUAL_BLOCK } else { self.block };
        let value_at = self.at.saturating_add(u32::try_from(head).unwrap_or(0));
        let left = u32::from(block).saturating_sub(value_at.checked_rem(u32::from(block)).unwrap_or(0));
        let left = usize::try_from(left).unwrap_or(usize::MAX);
        if left < size && usize::from(block) >= size { left } else { 0 }
    }
}

/// The file of `count` parameters as an entry of the directory.
pub(super) fn entry(count: u16, index: u16, name: &mut Entries<'_>) -> Option<(u32, u32)> {
    if index > 0 {
        return None;
    }
    name.text(NAME);
    Some((len(count, LONGEST), 0))
}

/// Returns the length of a file with this number of records.
fn len(count: u16, longest: u32) -> u32 {
    HEADER_LEN.saturating_add(longest.saturating_mul(count.into()))
}

/// Whether the content is as long as its header says.
pub(super) fn is_complete(content: &[u8]) -> bool {
    let Some([_, _, _, _, low, high]) = content.first_chunk() else { return false };
    content.len() >= usize::from(u16::from_le_bytes([*low, *high]))
}

/// Copies what follows `offset` in `bytes` to `out`. Returns how much it is.
fn copy(bytes: &[u8], offset: u32, out: &mut [u8]) -> usize {
    let rest = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..)).unwrap_or_default();
    let len = rest.len().min(out.len());
    if let (Some(from), Some(to)) = (rest.get(..len), out.get_mut(..len)) {
        to.copy_from_slice(from);
    }
    len
}

/// Returns a byte of two lengths below 16.
fn nibbles(low: usize, high: usize) -> u8 {
    u8::try_from(low & 15 | (high & 15).wrapping_shl(4)).unwrap_or(0)
}

fn decimal(digits: &[u8]) -> Option<u16> {
    let mut number = 0u16;
    for digit in digits {
        let digit = digit.checked_sub(b'0').filter(|digit| *digit < 10)?;
        number = number.checked_mul(10)?.checked_add(u16::from(digit))?;
    }
    Some(number).filter(|_| !digits.is_empty())
}

/// Returns the type of the format, the value in it, and its length. The type fits the default too, if that follows.
fn packed(info: &ParamInfo, bits: u32, has_default: bool) -> (u8, u32, usize) {
    let default = if has_default { info.default_bits() } else { 0 };
    match info.param_type() {
        MavParamType::INT8 => (INT8, bits, 1),
        MavParamType::UINT8 | MavParamType::INT16 => (INT16, bits, 2),
        MavParamType::UINT32 if (bits | default).cast_signed() < 0 => (FLOAT, num::f32_from_u32(bits).to_bits(), 4),
        MavParamType::REAL32 => (FLOAT, bits, 4),
        _ => (INT32, bits, 4),
    }
}

/// Returns a default in the type that the value has.
fn default_as(kind: u8, info: &ParamInfo) -> u32 {
    match info.param_type() {
        MavParamType::UINT32 if kind == FLOAT => num::f32_from_u32(info.default_bits()).to_bits(),
        _ => info.default_bits(),
    }
}

/// The records of an uploaded file.
pub(super) struct Records<'a> {
    rest: &'a [u8],
    left: u16,
    name: [u8; 16],
    name_len: usize,
}

/// A parameter of an uploaded file.
pub(super) struct Uploaded {
    pub(super) name: [u8; 16],
    r#type: MavParamType,
    bits: u32,
}

impl<'a> Records<'a> {
    /// Returns the records of a file; `None` if it is not one, or has another length than its header says.
    pub(super) fn new(file: &'a [u8]) -> Option<Self> {
        let (header, rest) = file.split_first_chunk::<6>()?;
        let [a, b, c, d, e, f] = *header;
        let len = usize::from(u16::from_le_bytes([e, f]));
        let is_good = u16::from_le_bytes([a, b]) == MAGIC && len == file.len();
        is_good.then_some(Self { rest, left: u16::from_le_bytes([c, d]), name: [0; 16], name_len: 0 })
    }

    /// Returns the next record; `Some(Err(()))` if the file is damaged.
    pub(super) fn next(&mut self) -> Option<Result<Uploaded, ()>> {
        while let Some((0, rest)) = self.rest.split_first() {
            self.rest = rest;
        }
        if self.left == 0 {
            return if self.rest.is_empty() { None } else { Some(Err(())) };
        }
        self.left = self.left.saturating_sub(1);
        Some(self.record().ok_or(()))
    }

    fn record(&mut self) -> Option<Uploaded> {
        let ([kind, lens], rest) = self.rest.split_first_chunk()?;
        let (common, len) = (usize::from(lens & 15), usize::from(lens >> 4).saturating_add(1));
        let (name, rest) = rest.split_at_checked(len)?;
        let end = common.checked_add(len).filter(|end| *end <= 16 && common <= self.name_len)?;
        if name.contains(&0) {
            return None;
        }
        self.name.get_mut(common..end)?.copy_from_slice(name);
        self.name.get_mut(end..)?.fill(0);
        self.name_len = end;
        let (r#type, size) = match *kind {
            INT8 => (MavParamType::INT8, 1),
            INT16 => (MavParamType::INT16, 2),
            INT32 => (MavParamType::INT32, 4),
            FLOAT => (MavParamType::REAL32, 4),
            _ => return None,
        };
        let (value, rest) = rest.split_at_checked(size)?;
        let mut bits = [0; 4];
        bits.get_mut(..size)?.copy_from_slice(value);
        self.rest = rest;
        Some(Uploaded { name: self.name, r#type, bits: u32::from_le_bytes(bits) })
    }
}

impl Uploaded {
    /// Returns the value as one of this type; `None` if it does not fit. Clients send any number in the smallest type that
    /// has it.
    pub(super) fn value_of(&self, ours: MavParamType) -> Option<u32> {
        let (from, bits) = match (self.r#type, ours) {
            (MavParamType::REAL32, MavParamType::REAL32) => return Some(self.bits),
            (MavParamType::REAL32, _) => value::whole(f32::from_bits(self.bits))?,
            (integer, MavParamType::REAL32) => {
                return Some(num::f32_from_i32(value::extended(integer, self.bits)).to_bits());
            }
            (integer, _) => (integer, self.bits),
        };
        value::converted(from, ours, bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P-22: value and default have one type in the file, and it fits both.
    #[test]
    fn default_has_the_type_of_the_value() {
        for (bits, default, expected) in [
            (5, 3_000_000_000u32, (FLOAT, 5.0f32.to_bits(), 3e9f32.to_bits())),
            (3_000_000_000, 5, (FLOAT, 3e9f32.to_bits(), 5.0f32.to_bits())),
            (5, 6, (INT32, 5, 6)),
        ] {
            let info = ParamInfo::new("COUNT", default, 0..=u32::MAX).expect("a good row");
            let (kind, value, _) = packed(&info, bits, true);
            assert_eq!((kind, value, default_as(kind, &info)), expected);
        }
    }
}
