//! A received item of a plan, in either form.

use super::mission_type;
use crate::dialect::{MavMissionType, MissionItem, MissionItemInt};
use crate::frame::Frame;
use crate::message::Item;
use crate::message::Message;

/// A received item.
pub(super) struct Arrival {
    pub(super) mission_type: MavMissionType,
    pub(super) seq: u16,
    pub(super) current: u8,
    /// In the form of MISSION_ITEM_INT, even if it was received as MISSION_ITEM (M-37).
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
