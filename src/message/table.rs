//! What is known of a message without decoding it: one row of 8 bytes a message, for the whole dialect, so that frames
//! that nobody decodes are still verified, routed, and never searched for smuggled frames (SEC-5).

#![allow(
    clippy::indexing_slicing,
    clippy::arithmetic_side_effects,
    clippy::as_conversions,
    reason = "const-evaluated code: a panic here is a compile error, and `From` cannot be called"
)]

use super::{Field, Message};
use crate::dialect::{CommandLong, Heartbeat};
use crate::frame::crc;

/// One field as `CRC_EXTRA` and the address filter see it. Made by [`message!`](crate::message).
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct FieldInfo {
    wire_type: &'static str,
    name: &'static str,
    /// Length of the array, 0 for a single value.
    array: u8,
    element: usize,
    size: usize,
}

impl FieldInfo {
    /// A field of type `T`; `name` as `stringify!` gives it.
    #[doc(hidden)]
    pub const fn of<T: Field>(name: &'static str) -> Self {
        let array = if T::IS_ARRAY { T::SIZE / T::ELEMENT } else { 0 };
        assert!(array <= 255, "an array has at most 255 elements");
        Self { wire_type: T::WIRE_TYPE, name, array: array as u8, element: T::ELEMENT, size: T::SIZE }
    }

    /// The digest of S-3.
    #[doc(hidden)]
    pub const fn crc_extra(message: &str, base: &[Self]) -> u8 {
        let mut sum = word(crc::INIT, message.as_bytes(), 0);
        let mut i = 0;
        while i < base.len() {
            let field = &base[i];
            sum = word(sum, field.wire_type.as_bytes(), 0);
            sum = word(sum, field.name.as_bytes(), raw_prefix(field.name));
            if field.array != 0 {
                sum = crc::step(sum, field.array);
            }
            i += 1;
        }
        (sum as u8) ^ ((sum >> 8) as u8)
    }

    /// Bytes of all these fields.
    #[doc(hidden)]
    pub const fn total(fields: &[Self]) -> usize {
        let mut total = 0;
        let mut rest = fields;
        while let [field, tail @ ..] = rest {
            total += field.size;
            rest = tail;
        }
        total
    }

    /// Whether this is its name, which is as long.
    const fn is_named(&self, name: &str) -> bool {
        let (ours, theirs) = (self.name.as_bytes(), name.as_bytes());
        let mut i = 0;
        while i < ours.len() {
            if ours[i] != theirs[i] {
                return false;
            }
            i += 1;
        }
        true
    }
}

/// A word and the space behind it.
const fn word(mut sum: u16, text: &[u8], skip: usize) -> u16 {
    let mut i = skip;
    while i < text.len() {
        sum = crc::step(sum, text[i]);
        i += 1;
    }
    crc::step(sum, b' ')
}

/// Length of the `r#` of a raw identifier, which is Rust's and not MAVLink's.
const fn raw_prefix(name: &str) -> usize {
    let name = name.as_bytes();
    if name.len() > 2 && name[0] == b'r' && name[1] == b'#' { 2 } else { 0 }
}

/// One row of a [`MessageTable`]: 8 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MessageInfo {
    /// Id in the low 24 bits, `CRC_EXTRA` above.
    id_and_crc: u32,
    base_len: u8,
    max_len: u8,
    target_system: u8,
    target_component: u8,
}

/// Marks a target field that the message does not have: no field can begin there.
const NO_FIELD: u8 = 255;

impl MessageInfo {
    /// The row of `M`, whose fields are these. Refuses, at compile time, what MAVLink does.
    #[doc(hidden)]
    pub const fn new<M: Message>(base: &[FieldInfo], extensions: &[FieldInfo]) -> Self {
        assert!(M::ID < 1 << 24, "a message id has 24 bits");
        assert!(M::MAX_LEN <= 255, "a payload has at most 255 bytes");
        assert!(base.len() + extensions.len() <= 64, "a message has at most 64 fields");
        let mut element = 8;
        let mut rest = base;
        while let [field, tail @ ..] = rest {
            assert!(element >= field.element, "base fields must stand in wire order: element sizes 8, 4, 2, 1");
            element = field.element;
            rest = tail;
        }
        let targets = Targets::NONE.find(base).find(extensions);
        Self {
            id_and_crc: M::ID | ((M::CRC_EXTRA as u32) << 24),
            base_len: M::BASE_LEN as u8,
            max_len: M::MAX_LEN as u8,
            target_system: targets.system,
            target_component: targets.component,
        }
    }

    /// The message id.
    #[inline]
    pub const fn id(&self) -> u32 {
        self.id_and_crc & 0x00FF_FFFF
    }

    /// The byte that the checksum ends with, `CRC_EXTRA` (S-3).
    #[inline]
    pub const fn crc_extra(&self) -> u8 {
        (self.id_and_crc >> 24) as u8
    }

    /// Length of the base fields (bytes): the payload length of a v1 frame that is sent, and the minimum for one that is received
    /// (S-8).
    #[inline]
    pub const fn base_len(&self) -> u8 {
        self.base_len
    }

    /// Length with all extensions (bytes).
    #[inline]
    pub const fn max_len(&self) -> u8 {
        self.max_len
    }

    /// Where `target_system` stands in the payload.
    #[inline]
    pub const fn target_system(&self) -> Option<u8> {
        if self.target_system == NO_FIELD { None } else { Some(self.target_system) }
    }

    /// Where `target_component` stands in the payload.
    #[inline]
    pub const fn target_component(&self) -> Option<u8> {
        if self.target_component == NO_FIELD { None } else { Some(self.target_component) }
    }
}

/// Where the target fields begin.
struct Targets {
    system: u8,
    component: u8,
    /// Where the next field begins.
    offset: usize,
}

impl Targets {
    const NONE: Self = Self { system: NO_FIELD, component: NO_FIELD, offset: 0 };

    /// Goes on with `fields`. Compares no more names than it must: constants are computed slowly.
    const fn find(mut self, fields: &[FieldInfo]) -> Self {
        let mut rest = fields;
        while let [field, tail @ ..] = rest {
            match field.name.len() {
                13 if field.is_named("target_system") => self.system = self.offset as u8,
                16 if field.is_named("target_component") => self.component = self.offset as u8,
                _ => {}
            }
            self.offset += field.size;
            rest = tail;
        }
        self
    }
}

/// Ids below this are found through [`MessageTable`]'s index: nearly all traffic.
const INDEXED: u32 = 256;
/// So many ids share an entry of the index. On a host each has its own: how long a search takes cannot be predicted there,
/// and a branch that was not predicted costs more than its comparisons.
const BUCKET: u32 = if cfg!(target_pointer_width = "64") { 1 } else { 8 };
/// The index: where in the rows the ids of each bucket begin.
type Index = [u16; INDEX_LEN];
const INDEX_LEN: usize = (INDEXED / BUCKET) as usize;

/// The messages that are known, sorted by id. An id below 256 is found in at most 8 comparisons, through an index of 64
/// bytes (on a 64-bit host in one, through 512 bytes); any other by binary search.
#[derive(Clone, Copy, Debug)]
pub struct MessageTable {
    rows: &'static [MessageInfo],
    index: &'static Index,
}

impl MessageTable {
    /// A table of rows that are sorted by id, with their [`index`](Self::index).
    #[doc(hidden)]
    pub const fn new(rows: &'static [MessageInfo], index: &'static Index) -> Self {
        Self { rows, index }
    }

    /// The index of rows that are sorted by id.
    ///
    /// # Panics
    ///
    /// When they are not, or an id stands there twice. In a `const`, where tables are made, that is a compile error.
    #[doc(hidden)]
    pub const fn index(rows: &[MessageInfo]) -> Index {
        let mut i = 1;
        while i < rows.len() {
            assert!(
                rows[i - 1].id() < rows[i].id(),
                "two messages of the dialect have one id: leave one out, or give yours another id"
            );
            i += 1;
        }
        let mut index = [0; INDEX_LEN];
        let mut bucket = 0;
        let mut row = 0;
        while bucket < index.len() {
            while row < rows.len() && rows[row].id() < bucket as u32 * BUCKET {
                row += 1;
            }
            index[bucket] = row as u16;
            bucket += 1;
        }
        index
    }

    /// The rows sorted by id, for [`new`](Self::new).
    #[doc(hidden)]
    pub const fn sorted<const N: usize>(mut rows: [MessageInfo; N]) -> [MessageInfo; N] {
        let mut i = 1;
        while i < N {
            let mut j = i;
            while j > 0 && rows[j - 1].id() > rows[j].id() {
                let row = rows[j];
                rows[j] = rows[j - 1];
                rows[j - 1] = row;
                j -= 1;
            }
            i += 1;
        }
        rows
    }

    /// The rows of both, sorted by id; `N` is how many they are.
    #[doc(hidden)]
    pub const fn joined<const N: usize>(base: &[MessageInfo], own: &[MessageInfo]) -> [MessageInfo; N] {
        const FREE: MessageInfo =
            MessageInfo { id_and_crc: 0, base_len: 0, max_len: 0, target_system: NO_FIELD, target_component: NO_FIELD };
        let mut rows = [FREE; N];
        let mut i = 0;
        while i < N {
            rows[i] = if i < base.len() { base[i] } else { own[i - base.len()] };
            i += 1;
        }
        Self::sorted(rows)
    }

    /// Refuses, at compile time, a table with which a vehicle would be deaf: own messages without those of common.
    pub(crate) const fn check(&self) {
        let (mut has_heartbeat, mut has_commands) = (false, false);
        let mut i = 0;
        while i < self.rows.len() {
            has_heartbeat = has_heartbeat || self.rows[i].id() == Heartbeat::ID;
            has_commands = has_commands || self.rows[i].id() == CommandLong::ID;
            i += 1;
        }
        assert!(
            has_heartbeat && has_commands,
            "`MESSAGES` has no HEARTBEAT or no COMMAND_LONG: put all of common beside your own, `[Own] + Common`"
        );
    }

    /// The row of the message with this id; `None` when it is not in the table, and its frames cannot be checked (S-12).
    #[inline]
    pub fn get(&self, id: u32) -> Option<&'static MessageInfo> {
        let bucket = (id / BUCKET) as usize;
        match self.index.get(bucket) {
            // The only one that it can be.
            Some(&from) if BUCKET == 1 => self.rows.get(usize::from(from)).filter(|row| row.id() == id),
            Some(&from) => {
                let row = self.rows.get(usize::from(from)..)?.iter().find(|row| row.id() >= id);
                row.filter(|row| row.id() == id)
            }
            None => {
                let index = self.rows.partition_point(|row| row.id() < id);
                self.rows.get(index).filter(|row| row.id() == id)
            }
        }
    }

    /// All rows, sorted by id.
    #[inline]
    pub const fn rows(&self) -> &'static [MessageInfo] {
        self.rows
    }
}

/// A set of messages: what [`dialect!`](crate::dialect!) declares and the generator writes.
pub trait Dialect {
    /// The messages whose frames can be checked.
    const MESSAGES: MessageTable;
}

#[cfg(test)]
mod tests {
    use super::*;

    message! {
        struct First: FIRST = 70_000 { target_component: u8, target_system: u8, }
    }
    message! {
        struct Second: SECOND = 3 { a: u8, }
        extensions { target_system: u8, }
    }
    crate::dialect! { struct Two: [First, Second]; }

    message! {
        /// All that goes into the digest: a keyword, a name apart from the type, an enumeration.
        struct Beat: HEARTBEAT = 0 {
            custom_mode: u32,
            r#type: crate::dialect::MavType,
            autopilot: u8,
            base_mode: crate::dialect::MavModeFlag,
            system_status: u8,
            mavlink_version: u8,
        }
    }
    message! {
        /// Text, and an extension, which does not.
        struct Value: PARAM_VALUE = 22 {
            param_value: f32,
            param_count: u16,
            param_index: u16,
            param_id: crate::Text<16>,
            param_type: u8,
        }
        extensions { more: u8, }
    }
    message! {
        /// Arrays.
        struct Gps: GPS_STATUS = 25 {
            satellites_visible: u8,
            satellite_prn: [u8; 20],
            satellite_used: [u8; 20],
            satellite_elevation: [u8; 20],
            satellite_azimuth: [u8; 20],
            satellite_snr: [u8; 20],
        }
    }

    /// S-3
    #[test]
    fn digest_of_a_declaration_by_hand_is_computed() {
        assert_eq!((Beat::CRC_EXTRA, Value::CRC_EXTRA, Gps::CRC_EXTRA), (50, 220, 23));
    }

    #[test]
    fn rows_are_found_by_id_and_know_their_targets() {
        let first = Two::MESSAGES.get(70_000).expect("in the table");
        assert_eq!((first.target_system(), first.target_component()), (Some(1), Some(0)));
        let second = Two::MESSAGES.get(3).expect("in the table");
        assert_eq!((second.target_system(), second.target_component(), second.base_len()), (Some(1), None, 1));
        assert_eq!(Two::MESSAGES.get(4), None);
        assert_eq!(size_of::<MessageInfo>(), 8);
    }
}
