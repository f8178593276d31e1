//! An item of a plan as a client sends it, in either form.

use super::item::Item;
use super::mission_type;
use crate::dialect::{MavMissionType, MissionItem, MissionItemInt};
use crate::frame::Frame;
use crate::message::Message;

/// An item as it arrived.
pub(super) struct Arrival {
    pub(super) mission_type: MavMissionType,
    pub(super) seq: u16,
    pub(super) current: u8,
    /// As MISSION_ITEM_INT has it, also when it is the other form (M-37).
    pub(super) item: Item,
    pub(super) is_float: bool,
}

impl Arrival {
    pub(super) fn of(frame: &Frame<'_>) -> Self {
        let message = MissionItemInt::decode(frame.payload());
        Self {
            mission_type: mission_type(frame),
            seq: message.seq,
            current: message.current,
            item: Item::from_int(&message),
            is_float: frame.id() == MissionItem::ID,
        }
    }
}
