//! One item of a plan: kept as received, and what it is on the wire.
//!
//! Rules M-3 to M-5 and M-37. Positions are integers whatever message brought them; a float form is converted once, exactly.

use super::{Address, CommandRule};
use crate::crc32::Crc32;
use crate::dialect::{MavCmd, MavFrame, MavMissionResult, MavMissionType, MissionItemInt};
use crate::num;

/// One item of a plan, exactly as it was uploaded (M-3): also the bits of a NaN survive.
///
/// Two items are equal when all their bits are, so a NaN equals itself here.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Item {
    /// What `x`, `y` and `z` are measured in. [`MavFrame::GLOBAL`] and [`MavFrame::GLOBAL_INT`] mean the same, and so do
    /// the other pairs (M-4).
    pub frame: MavFrame,
    /// The command.
    pub command: MavCmd,
    /// Whether the next item follows without being asked for: any value but 0 says so (M-71).
    pub autocontinue: u8,
    /// Parameters 1 to 4; NaN means "default" where the command has one (M-70).
    pub params: [f32; 4],
    /// Latitude (deg·1e7) of a command with a position, in a global frame. Otherwise parameter 5, unscaled in every frame (M-75).
    /// `i32::MAX` is "not given".
    pub x: i32,
    /// Longitude (deg·1e7) of a command with a position, in a global frame. Otherwise parameter 6, unscaled in every frame (M-75).
    /// `i32::MAX` is "not given".
    pub y: i32,
    /// Altitude (m), as the frame counts it; parameter 7 in [`MavFrame::MISSION`].
    pub z: f32,
}

const _: () = assert!(size_of::<Item>() == 32, "plan memory is counted in items of 32 bytes");

/// A place on the globe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct LatLon {
    /// Latitude (deg·1e7), −90° to 90°.
    pub latitude: i32,
    /// Longitude (deg·1e7), −180° to 180°.
    pub longitude: i32,
}

/// The kinds of frame that a plan can hold.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Position {
    /// x and y are latitude and longitude (M-4).
    Global,
    /// x and y are parameters.
    None,
}

/// What a frame's x and y are; nothing when the stack does not know (M-4).
pub(crate) fn position(frame: MavFrame) -> Option<Position> {
    match frame {
        MavFrame::GLOBAL
        | MavFrame::GLOBAL_INT
        | MavFrame::GLOBAL_RELATIVE_ALT
        | MavFrame::GLOBAL_RELATIVE_ALT_INT
        | MavFrame::GLOBAL_TERRAIN_ALT
        | MavFrame::GLOBAL_TERRAIN_ALT_INT => Some(Position::Global),
        MavFrame::MISSION => Some(Position::None),
        _ => None,
    }
}

impl Item {
    /// All bits: frame, command and autocontinue in one, then parameters, x, y, z.
    #[inline]
    fn words(&self) -> [u32; 8] {
        let [p1, p2, p3, p4] = self.params.map(f32::to_bits);
        let [c0, c1] = self.command.0.to_le_bytes();
        let head = u32::from_le_bytes([self.frame.0, c0, c1, self.autocontinue]);
        [head, p1, p2, p3, p4, self.x.cast_unsigned(), self.y.cast_unsigned(), self.z.to_bits()]
    }

    /// The item of a MISSION_ITEM_INT.
    pub(crate) fn from_int(message: &MissionItemInt) -> Self {
        Self {
            frame: message.frame,
            command: message.command,
            autocontinue: message.autocontinue,
            params: [message.param1, message.param2, message.param3, message.param4],
            x: message.x,
            y: message.y,
            z: message.z,
        }
    }

    /// The item of a MISSION_ITEM (M-37), which has MISSION_ITEM_INT's fields at the same places, but floats in x and y:
    /// `raw` is what comes of reading it so. Degrees of a command with a position become deg·1e7; plain numbers stay (M-75). NaN
    /// becomes "not given".
    pub(crate) fn from_float(raw: Self, rule: &CommandRule) -> Result<Self, MavMissionResult> {
        let position = position(raw.frame).ok_or(MavMissionResult::UNSUPPORTED_FRAME)?;
        let given = |bits: i32| match (f32::from_bits(bits.cast_unsigned()), position) {
            (value, _) if value.is_nan() => Some(i32::MAX),
            (value, Position::Global) if rule.is_located() => num::scale_1e7(value),
            (value, _) => num::integer(value),
        };
        Ok(Self {
            x: given(raw.x).ok_or(MavMissionResult::INVALID_PARAM5_X)?,
            y: given(raw.y).ok_or(MavMissionResult::INVALID_PARAM6_Y)?,
            ..raw
        })
    }

    /// The item as MISSION_ITEM_INT.
    pub(crate) fn to_int(self, to: Address, plan: MavMissionType, seq: u16, current: bool) -> MissionItemInt {
        let [param1, param2, param3, param4] = self.params;
        MissionItemInt {
            param1,
            param2,
            param3,
            param4,
            x: self.x,
            y: self.y,
            z: self.z,
            seq,
            command: self.command,
            target_system: to.system.wire(),
            target_component: to.component.wire(),
            frame: self.frame,
            current: current.into(),
            autocontinue: self.autocontinue,
            mission_type: plan,
        }
    }

    /// Returns its MISSION_ITEM_INT as a MISSION_ITEM, which has floats in place of `x` and `y`, and else the same fields: degrees
    /// of a command with a position as the nearest floats, plain numbers as they are (M-75).
    pub(crate) fn with_floats(self, message: MissionItemInt, has_position: bool) -> MissionItemInt {
        let is_scaled = has_position && position(self.frame) == Some(Position::Global);
        let float = |value| if is_scaled { num::from_1e7(value) } else { num::from_i32(value) };
        let bits = |value| float(value).to_bits().cast_signed();
        MissionItemInt { x: bits(self.x), y: bits(self.y), ..message }
    }
}

impl PartialEq for Item {
    fn eq(&self, other: &Self) -> bool {
        let bits = |item: &Self| (item.params.map(f32::to_bits), item.z.to_bits());
        let (([a1, a2, a3, a4], az), ([b1, b2, b3, b4], bz)) = (bits(self), bits(other));
        // Field by field, which is fast enough for a whole plan.
        (self.frame, self.command, self.autocontinue) == (other.frame, other.command, other.autocontinue)
            && (self.x, self.y, az) == (other.x, other.y, bz)
            && (a1, a2, a3, a4) == (b1, b2, b3, b4)
    }
}

impl Eq for Item {}

/// A plan's id while its items come in (M-5): CRC-32 of frame, command, autocontinue, parameters, x, y, z of each,
/// little-endian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Digest(Crc32);

impl Digest {
    /// All zero bits.
    #[cfg(feature = "storage")]
    pub(crate) const VACANT: Self = Self(Crc32::ZERO);

    pub(crate) const fn new() -> Self {
        Self(Crc32::new())
    }

    /// One more item.
    pub(crate) fn add(&mut self, item: &Item) {
        for word in item.words() {
            self.0.add(&word.to_le_bytes());
        }
    }

    /// The id of a plan that is not empty: never 0, which means "no plan".
    pub(crate) fn id(self) -> u32 {
        self.0.sum().max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MissionItem;
    use crate::message::Message;
    use proptest::prelude::*;

    pub(crate) fn any_item() -> impl Strategy<Value = Item> {
        any::<([u32; 4], u32, i32, i32, u16, u8, u8)>().prop_map(|(params, z, x, y, command, frame, autocontinue)| {
            Item {
                frame: MavFrame(frame),
                command: MavCmd(command),
                autocontinue,
                params: params.map(f32::from_bits),
                x,
                y,
                z: f32::from_bits(z),
            }
        })
    }

    impl Item {
        /// What the id is computed from, for other implementations of CRC-32.
        pub(crate) fn to_bytes(self) -> std::vec::Vec<u8> {
            self.words().into_iter().flat_map(u32::to_le_bytes).collect()
        }

        /// The item as MISSION_ITEM, as the engine sends it.
        pub(crate) fn to_float(self, to: Address, plan: MavMissionType, seq: u16, current: bool) -> MissionItem {
            let mut payload = [0; MissionItem::MAX_LEN];
            let has_position = CommandRule::any(self.command).is_located();
            self.with_floats(self.to_int(to, plan, seq, current), has_position).encode(&mut payload).unwrap();
            MissionItem::decode(&payload)
        }
    }

    fn float(frame: MavFrame, x: f32, y: f32) -> MissionItem {
        MissionItem { frame, x, y, command: MavCmd::NAV_WAYPOINT, ..Default::default() }
    }

    /// As the engine reads it: the payload of a MISSION_ITEM by the layout of MISSION_ITEM_INT.
    fn from_float(message: &MissionItem) -> Result<Item, MavMissionResult> {
        let mut payload = [0; MissionItem::MAX_LEN];
        message.encode(&mut payload).unwrap();
        Item::from_float(Item::from_int(&MissionItemInt::decode(&payload)), &CommandRule::any(message.command))
    }

    fn position_of(message: &MissionItem) -> Result<(i32, i32), MavMissionResult> {
        from_float(message).map(|item| (item.x, item.y))
    }

    #[test]
    fn float_degrees_become_integers() {
        // M-37, M-4
        for frame in [0, 3, 5, 6, 10, 11].map(MavFrame) {
            assert_eq!(position_of(&float(frame, 47.397_742, -8.545_594)), Ok((473_977_432, -85_455_942)));
            assert_eq!(position_of(&float(frame, f32::NAN, f32::NAN)), Ok((i32::MAX, i32::MAX)));
            let infinite = f32::INFINITY;
            assert_eq!(position_of(&float(frame, infinite, 0.0)), Err(MavMissionResult::INVALID_PARAM5_X));
            assert_eq!(position_of(&float(frame, 0.0, 300.0)), Err(MavMissionResult::INVALID_PARAM6_Y));
        }
    }

    #[test]
    fn float_parameters_are_copied_as_integers() {
        // M-37
        assert_eq!(position_of(&float(MavFrame::MISSION, 3.0, -70_000.0)), Ok((3, -70_000)));
        assert_eq!(position_of(&float(MavFrame::MISSION, f32::NAN, 0.0)), Ok((i32::MAX, 0)));
        assert_eq!(position_of(&float(MavFrame::MISSION, 0.5, 0.0)), Err(MavMissionResult::INVALID_PARAM5_X));
        assert_eq!(position_of(&float(MavFrame::BODY_FRD, 0.0, 0.0)), Err(MavMissionResult::UNSUPPORTED_FRAME));
    }

    /// M-75: of a command without a position they are copied in every frame.
    #[test]
    fn float_numbers_without_a_position_are_not_scaled() {
        for frame in [0, 2, 3, 5, 6, 10, 11].map(MavFrame) {
            let message = |x, y| MissionItem { command: MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, ..float(frame, x, y) };
            assert_eq!(position_of(&message(12.0, -70_000.0)), Ok((12, -70_000)), "{frame:?}");
            assert_eq!(position_of(&message(12.5, 0.0)), Err(MavMissionResult::INVALID_PARAM5_X));
            assert_eq!(position_of(&message(0.0, f32::INFINITY)), Err(MavMissionResult::INVALID_PARAM6_Y));
            let item = from_float(&message(12.0, f32::NAN)).unwrap();
            let back = item.to_float(Address::new(1, 1), MavMissionType::MISSION, 3, false);
            assert!(back.x == 12.0 && back.y.is_nan(), "{back:?}");
        }
    }

    #[test]
    fn id_of_a_plan_is_never_zero() {
        let id = |bytes: &[u8]| {
            let mut crc = Crc32::new();
            crc.add(bytes);
            Digest(crc).id()
        };
        assert_eq!(id(&[0x9D, 0x0A, 0xD9, 0x6D]), 1, "these four have the sum 0");
        assert_eq!(id(&[0xFF; 4]), u32::MAX);
    }

    proptest! {
        /// M-3: what came is what goes, to the bit.
        #[test]
        fn integer_form_round_trips(item in any_item(), seq: u16) {
            let to = Address::new(255, 190);
            let message = item.to_int(to, MavMissionType::FENCE, seq, true);
            prop_assert_eq!(Item::from_int(&message), item);
            prop_assert_eq!((message.seq, message.current, message.mission_type), (seq, 1, MavMissionType::FENCE));
            prop_assert_eq!((message.target_system, message.target_component), (255, 190));
        }

        /// A position that came as floats goes back as the same floats.
        #[test]
        fn float_form_round_trips(x in 1.0f32..90.0, y in -180.0f32..-1.0, item in any_item()) {
            let frame = MavFrame::GLOBAL_RELATIVE_ALT;
            let item = Item { command: MavCmd::NAV_WAYPOINT, ..item };
            let message = Item { frame, ..item }.to_float(Address::new(1, 1), MavMissionType::MISSION, 3, false);
            let message = MissionItem { x, y, ..message };
            let back = from_float(&message).unwrap();
            prop_assert_eq!(back, Item { frame, x: back.x, y: back.y, ..item });
            let again = back.to_float(Address::new(1, 1), MavMissionType::MISSION, 3, false);
            prop_assert_eq!((again.x, again.y), (x, y));
        }

        /// M-5
        #[test]
        fn id_is_the_crc_32_of_the_items(items in proptest::collection::vec(any_item(), 1..6)) {
            let mut digest = Digest::new();
            let mut reference = crc_any::CRCu32::crc32();
            for item in &items {
                digest.add(item);
                reference.digest(&item.to_bytes());
            }
            prop_assert_eq!(digest.id(), reference.get_crc().max(1));
        }

        /// Equality is by bits: any flipped bit is seen.
        #[test]
        fn every_bit_counts(item in any_item(), byte in 0usize..32, bit in 0u8..8) {
            let mut bytes = item.to_bytes();
            bytes[byte] ^= 1 << bit;
            let word = |i: usize| u32::from_le_bytes(bytes[i..i + 4].try_into().unwrap());
            let other = Item {
                frame: MavFrame(bytes[0]),
                command: MavCmd(u16::from_le_bytes([bytes[1], bytes[2]])),
                autocontinue: bytes[3],
                params: [word(4), word(8), word(12), word(16)].map(f32::from_bits),
                x: word(20) as i32,
                y: word(24) as i32,
                z: f32::from_bits(word(28)),
            };
            prop_assert_ne!(item, other);
            prop_assert_eq!(item, item);
        }
    }
}
