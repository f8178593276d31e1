//! The messages of the plan service, and the plan that each of them names.

use crate::dialect::{
    MavComponent, MavMissionType, MissionAck, MissionClearAll, MissionCount, MissionItem, MissionItemInt,
    MissionRequest, MissionRequestInt, MissionRequestList, MissionRequestPartialList, MissionSetCurrent,
    MissionWritePartialList,
};
use crate::frame::{Frame, Version};
use crate::message::{ComponentId, Message};

/// Whether the service handles the message with this id.
pub(super) const fn is_handled(id: u32) -> bool {
    is_request(id) || matches!(id, MissionAck::ID | MissionItem::ID | MissionItemInt::ID | MissionSetCurrent::ID)
}

/// Whether the message is a request. A request is always answered, even if by UNSUPPORTED, because clients repeat an
/// unanswered request for seconds. Items and acknowledgements are not requests.
pub(super) const fn is_request(id: u32) -> bool {
    matches!(
        id,
        MissionCount::ID
            | MissionRequestList::ID
            | MissionRequestInt::ID
            | MissionRequest::ID
            | MissionClearAll::ID
            | MissionRequestPartialList::ID
            | MissionWritePartialList::ID
    )
}

/// Whether the message changes plans, so that its sender must be in control.
pub(super) const fn changes_plans(id: u32) -> bool {
    matches!(
        id,
        MissionCount::ID | MissionItem::ID | MissionItemInt::ID | MissionClearAll::ID | MissionWritePartialList::ID
    )
}

/// Whether a message about plans is addressed to component 190, as by old ground stations (M-10).
pub(crate) fn is_for_planner(component: ComponentId, id: u32) -> bool {
    component.wire() == MavComponent::MISSIONPLANNER.0 && is_handled(id)
}

/// Returns the plan type that a message names: in all messages of this service, the first byte after the base fields.
/// Most v1 frames end before that byte. They are about the mission (V-7).
pub(super) fn mission_type(frame: &Frame<'_>) -> MavMissionType {
    MavMissionType(frame.info().map_or(0, |info| frame.byte(info.base_len())))
}

/// Whether a frame of this version can name this type of plan. MAVLink 1 has missions only. A v1 frame that names
/// another type in its extension bytes is refused, because it is not about the mission (V-7).
pub(super) fn can_name(version: Version, mission_type: MavMissionType) -> bool {
    version == Version::V2 || mission_type == MavMissionType::MISSION
}
