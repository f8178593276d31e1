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
//! A name repeats up to 15 bytes of the one before. Zeros between records keep a value from crossing a packet's end, so
//! that it is not torn if it changes meanwhile. The file is made while it is read. The length of a record depends only
//! on constants, so any part of it can be read again.
//!
//! Behind the last record there are zeros, which decoders skip and MAVLink 2 does not send. They extend the file to the length
//! of as many of the longest records, whatever the length of the client's packets (F-30).
//!
//! Integers without a sign are in the next larger type, which the format has with a sign only. A larger u32 is a float. In an upload, a
//! float that is a whole number is accepted for any integer (P-19).

use core::borrow::Borrow;
use core::num::{NonZeroU32, Saturating};
use core::task::Poll;

use super::info::{ParamInfo, Rows};
use super::value::{self, IntegerBits};
use crate::dialect::{MavFtpErr, MavParamType};
use crate::message::Text;
use crate::num;
use crate::service::files::{FileAccess, VirtualEntry};
use heapless::Vec;

/// The name of the file.
const NAME: &str = "param.pck";

const MAGIC: u16 = 0x671B;
const MAGIC_WITH_DEFAULTS: u16 = 0x671C;

/// The number of bytes before the first record.
const HEADER_LEN: u32 = 6;

/// The most that a record takes: padding, two bytes, the name, the value and, if it is in the file, the default.
const MAX_RECORD: usize = 3 + 2 + 16 + 4 + 4;
const LONGEST: u32 = 3 + 2 + 16 + 4;
const LONGEST_WITH_DEFAULT: u32 = LONGEST + 4;

/// The maximum length of the part of a name that is repeated.
const MAX_COMMON: usize = 15;

/// The maximum number of records that a call skips.
const STEP: Saturating<u8> = Saturating(64);

/// The length of a packet's data if no client has chosen one yet.
const USUAL_PACKET: NonZeroU32 = NonZeroU32::MIN.saturating_add(238);

/// The types of the format.
const INT8: u8 = 1;
const INT16: u8 = 2;
const INT32: u8 = 3;
const FLOAT: u8 = 4;

/// A file that is being read.
#[derive(Clone, Copy, Debug)]
pub struct PackedFile {
    /// The first parameter, and the number of them.
    first: u16,
    count: u16,
    /// The number of parameters in the table.
    total: u16,
    has_defaults: bool,
    /// The length of the data in the client's packets: 0 until it has read.
    packet: u8,
    /// The record that begins at `position`.
    index: Saturating<u16>,
    position: Saturating<u32>,
}

impl PackedFile {
    /// Returns the file of a table of `total` parameters that a client asks for: `path` is its name and the query. Refused if the
    /// query is wrong, or there is no such parameter; also any query for an upload.
    pub(super) fn open(path: &[u8], total: u16, access: FileAccess) -> Result<Self, MavFtpErr> {
        let query = match path.strip_prefix(NAME.as_bytes()) {
            Some([]) => b"",
            Some([b'?', ..]) if access != FileAccess::Read => return Err(MavFtpErr::FILEPROTECTED),
            Some([b'?', query @ ..]) => query,
            _ => return Err(MavFtpErr::FILENOTFOUND),
        };
        Self::of(query, total).ok_or(MavFtpErr::FAIL)
    }

    fn of(query: &[u8], total: u16) -> Option<Self> {
        let (mut first, mut limit, mut has_defaults) = (0, 0, false);
        for part in query.split(|byte| *byte == b'&').filter(|part| !part.is_empty()) {
            let mut key_and_number = part.splitn(2, |byte| *byte == b'=');
            let (key, number) = (key_and_number.next()?, decimal(key_and_number.next()?)?);
            match key {
                b"start" => first = number,
                b"count" => limit = number,
                b"withdefaults" => has_defaults = number != 0,
                _ => {}
            }
        }
        let left = total.checked_sub(first).filter(|left| *left > 0)?;
        let count = if limit > 0 { left.min(limit) } else { left };
        let (index, position) = (Saturating(0), Saturating(HEADER_LEN));
        Some(Self { first, count, total, has_defaults, packet: 0, index, position })
    }

    fn rewind(&mut self) {
        (self.index, self.position) = (Saturating(0), Saturating(HEADER_LEN));
    }

    /// Stores the length of the client's packets, when it first reads.
    pub(super) fn set_packet_len(&mut self, packet: u8) {
        if self.packet == 0 {
            self.packet = packet;
            self.rewind();
        }
    }

    /// Returns the length of the file (F-30).
    pub(super) fn len(&self) -> u32 {
        len(self.count, if self.has_defaults { LONGEST_WITH_DEFAULT } else { LONGEST })
    }

    /// Reads from any place of the file. Pending if it takes another call to find that place.
    pub(super) fn read<R: Rows>(&mut self, rows: &R, offset: u32, out: &mut [u8]) -> Poll<Result<usize, MavFtpErr>> {
        let left = usize::try_from((Saturating(self.len()) - Saturating(offset)).0).unwrap_or(usize::MAX);
        let len = left.min(out.len());
        let mut window =
            Window { skipped: Saturating(offset) - self.position, out: out.get_mut(..len).unwrap_or_default() };
        if offset < self.position.0 {
            self.rewind();
            window.skipped = Saturating(offset);
            window.put(&self.header());
        }
        let mut steps = STEP;
        while !window.out.is_empty() {
            let Some(record) = self.record(rows) else { break };
            let record_len = u32::try_from(record.len()).unwrap_or(0);
            let is_before = window.skipped.0 >= record_len;
            if !window.put(&record) {
                break;
            }
            self.index += 1;
            self.position += record_len;
            if is_before {
                steps -= 1;
                if steps.0 == 0 {
                    return Poll::Pending;
                }
            }
        }
        window.out.fill(0);
        Poll::Ready(Ok(len))
    }

    fn header(&self) -> [u8; 6] {
        let magic = if self.has_defaults { MAGIC_WITH_DEFAULTS } else { MAGIC };
        let ([a, b], [c, d], [e, f]) = (magic.to_le_bytes(), self.count.to_le_bytes(), self.total.to_le_bytes());
        [a, b, c, d, e, f]
    }

    /// Returns the next record; `None` after the last one.
    fn record<R: Rows>(&self, rows: &R) -> Option<Vec<u8, MAX_RECORD, u8>> {
        if self.index.0 >= self.count {
            return None;
        }
        let index = Saturating(self.first) + self.index;
        let (info, bits) = rows.get(index.0)?;
        let info: &ParamInfo = info.borrow();
        let name = info.name_bytes();
        let mut common = 0;
        if self.index.0 > 0 {
            let (before, _) = rows.get((index - Saturating(1)).0)?;
            let before: &ParamInfo = before.borrow();
            // At least one byte of the name is not repeated.
            let repeatable = name.split_last().map_or(name, |(_, repeatable)| repeatable);
            let pairs = repeatable.iter().zip(before.name_bytes()).take(MAX_COMMON);
            common = pairs.take_while(|(a, b)| a == b).count();
        }
        let rest = name.get(common..).unwrap_or_default();
        let PackedValue { kind, value, size } = packed(info, bits, self.has_defaults);
        let (flags, default) = if self.has_defaults { (0x10, Some(default_as(kind, info))) } else { (0, None) };
        let lens = common | rest.len().saturating_sub(1) << 4;
        let mut record = Vec::new();
        // There is room for all of it.
        let _ = record.resize(self.padding(rest.len(), size), 0);
        let _ = record.extend_from_slice(&[kind | flags, u8::try_from(lens).unwrap_or(0)]);
        let _ = record.extend_from_slice(rest);
        for value in [Some(value), default].into_iter().flatten() {
            let _ = record.extend_from_slice(value.to_le_bytes().get(..size).unwrap_or_default());
        }
        Some(record)
    }

    /// Returns the number of zeros before a record whose value would otherwise cross a packet's end. `rest`: the length of its part
    /// of the name; `size`: that of the value.
    fn padding(&self, rest: usize, size: usize) -> usize {
        let packet = NonZeroU32::new(self.packet.into()).unwrap_or(USUAL_PACKET);
        let (rest, size) = (u32::try_from(rest).unwrap_or(0), u32::try_from(size).unwrap_or(0));
        let value_at = self.position + Saturating(2) + Saturating(rest);
        let left = (Saturating(packet.get()) - Saturating(value_at.0 % packet)).0;
        let crosses = left < size && packet.get() >= size;
        if crosses { usize::try_from(left).unwrap_or(0) } else { 0 }
    }
}

/// The part of a file that a client reads.
struct Window<'a> {
    /// The number of bytes before it that are still to be generated.
    skipped: Saturating<u32>,
    /// The part that is not written yet.
    out: &'a mut [u8],
}

impl Window<'_> {
    /// Writes the next bytes of the file, as far as they are in the window. Returns false if they continue after it.
    fn put(&mut self, bytes: &[u8]) -> bool {
        let skipped = usize::try_from(self.skipped.0).unwrap_or(usize::MAX);
        self.skipped -= u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        let bytes = bytes.get(skipped..).unwrap_or_default();
        let len = bytes.len().min(self.out.len());
        if let Some((written, rest)) = core::mem::take(&mut self.out).split_at_mut_checked(len) {
            for (to, from) in written.iter_mut().zip(bytes) {
                *to = *from;
            }
            self.out = rest;
        }
        len == bytes.len()
    }
}

/// The file of `count` parameters as an entry of the directory.
pub(super) fn entry(count: u16, index: u16) -> Option<VirtualEntry> {
    (index == 0).then(|| VirtualEntry { name: Text::new(NAME), size: len(count, LONGEST), time: 0 })
}

/// Returns the length of a file with this number of records.
fn len(count: u16, longest: u32) -> u32 {
    (Saturating(HEADER_LEN) + Saturating(longest) * Saturating(count.into())).0
}

/// Whether the content is as long as its header says.
pub(super) fn is_complete(content: &[u8]) -> bool {
    let Some([_, _, _, _, low, high]) = content.first_chunk() else { return false };
    content.len() >= usize::from(u16::from_le_bytes([*low, *high]))
}

/// Returns a decimal number; `None` if it is none, or too large.
fn decimal(digits: &[u8]) -> Option<u16> {
    let mut number = 0u16;
    for digit in digits {
        let digit = digit.checked_sub(b'0').filter(|digit| *digit < 10)?;
        number = number.checked_mul(10)?.checked_add(u16::from(digit))?;
    }
    Some(number).filter(|_| !digits.is_empty())
}

/// A value in a type of the format.
struct PackedValue {
    kind: u8,
    value: u32,
    /// The length of the value.
    size: usize,
}

/// Returns a value in a type of the format, which fits the default too, if that follows.
fn packed(info: &ParamInfo, bits: u32, has_default: bool) -> PackedValue {
    let default = if has_default { info.default_bits() } else { 0 };
    let (kind, value, size) = match info.param_type() {
        MavParamType::INT8 => (INT8, bits, 1),
        MavParamType::UINT8 | MavParamType::INT16 => (INT16, bits, 2),
        MavParamType::UINT32 if (bits | default).cast_signed() < 0 => (FLOAT, num::f32_from_u32(bits).to_bits(), 4),
        MavParamType::REAL32 => (FLOAT, bits, 4),
        _ => (INT32, bits, 4),
    };
    PackedValue { kind, value, size }
}

/// Returns a default in the type that the value has.
fn default_as(kind: u8, info: &ParamInfo) -> u32 {
    match info.param_type() {
        MavParamType::UINT32 if kind == FLOAT => num::f32_from_u32(info.default_bits()).to_bits(),
        _ => info.default_bits(),
    }
}

/// A place in an uploaded file: the beginning, or behind a record.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// The number of bytes between the header and this place.
    offset: u16,
    /// The number of records before it.
    records: Saturating<u16>,
}

/// What an uploaded file has next.
pub(super) enum Record {
    Parameter(Uploaded),
    /// It was the last record.
    End,
    /// It is not a file of parameters, is damaged, has another length than its header says, or something after the last record.
    Damaged,
}

/// A parameter of an uploaded file.
pub(super) struct Uploaded {
    /// The name, padded with zeros.
    pub(super) name: [u8; 16],
    r#type: MavParamType,
    bits: u32,
}

impl Place {
    /// The place behind the header.
    pub(super) const FIRST: Self = Self { offset: 0, records: Saturating(0) };

    /// Reads the record at this place, and moves behind it. `before` is the name in the record before, whose beginning may be
    /// repeated: all zeros at the first place.
    pub(super) fn next(&mut self, file: &[u8], before: [u8; 16]) -> Record {
        let Some((&[a, b, c, d, e, f], records)) = file.split_first_chunk() else { return Record::Damaged };
        let len = usize::from(u16::from_le_bytes([e, f]));
        if u16::from_le_bytes([a, b]) != MAGIC || len != file.len() {
            return Record::Damaged;
        }
        let mut rest = records.get(usize::from(self.offset)..).unwrap_or_default();
        while let Some((0, others)) = rest.split_first() {
            rest = others;
        }
        if self.records.0 >= u16::from_le_bytes([c, d]) {
            return if rest.is_empty() { Record::End } else { Record::Damaged };
        }
        let Some((record, rest)) = Uploaded::read(rest, before) else { return Record::Damaged };
        self.offset = u16::try_from(records.len().saturating_sub(rest.len())).unwrap_or(u16::MAX);
        self.records += 1;
        Record::Parameter(record)
    }
}

impl Uploaded {
    /// Reads a record. Returns the bytes after it too; `None` if it is damaged.
    fn read(record: &[u8], mut name: [u8; 16]) -> Option<(Self, &[u8])> {
        let ([kind, lens], rest) = record.split_first_chunk()?;
        let (common, len) = (usize::from(lens & 15), usize::from(lens >> 4).saturating_add(1));
        let (own, rest) = rest.split_at_checked(len)?;
        let (kept, replaced) = name.split_at_mut_checked(common)?;
        let (place, padding) = replaced.split_at_mut_checked(len)?;
        // No name has a NUL, and the one before is long enough.
        if own.contains(&0) || kept.contains(&0) {
            return None;
        }
        place.copy_from_slice(own);
        padding.fill(0);
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
        Some((Self { name, r#type, bits: u32::from_le_bytes(bits) }, rest))
    }

    /// Returns the value as one of this type; `None` if it does not fit. Clients send any number in the smallest type that
    /// has it.
    pub(super) fn value_of(&self, ours: MavParamType) -> Option<u32> {
        match (self.r#type, ours) {
            (MavParamType::REAL32, MavParamType::REAL32) => Some(self.bits),
            (MavParamType::REAL32, _) => IntegerBits::of(ours).of_integer(value::whole(f32::from_bits(self.bits))?),
            (sent, MavParamType::REAL32) => {
                Some(num::f32_from_i32(IntegerBits::of(sent).extended(self.bits)).to_bits())
            }
            (sent, _) => IntegerBits::of(ours).of_integer(IntegerBits::of(sent).integer(self.bits)),
        }
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
            let PackedValue { kind, value, .. } = packed(&info, bits, true);
            assert_eq!((kind, value, default_as(kind, &info)), expected);
        }
    }
}
