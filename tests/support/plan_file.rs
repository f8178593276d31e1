//! Plans as files, in ArduPilot's format (F-20).

use mavstack::dialect::{MavMissionType, MissionItemInt};
use mavstack::{Message, PlanType};

/// The length of the header, and of an item.
pub const HEADER: usize = 10;
pub const ITEM: usize = 38;

/// Returns the path of a plan's file.
pub fn path(plan: PlanType) -> &'static str {
    match plan {
        PlanType::Mission => "@MISSION/mission.dat",
        PlanType::Fence => "@MISSION/fence.dat",
        PlanType::Rally => "@MISSION/rally.dat",
    }
}

/// Returns the file with this header and these items.
pub fn encode(header: [u16; 5], items: &[MissionItemInt]) -> Vec<u8> {
    let mut file: Vec<u8> = header.iter().flat_map(|word| word.to_le_bytes()).collect();
    for item in items {
        let mut record = [0; ITEM];
        assert_eq!(item.encode(&mut record), Some(ITEM));
        file.extend(record);
    }
    file
}

/// Returns the file of a plan, as MAVProxy writes it.
pub fn file(plan: PlanType, items: &[MissionItemInt]) -> Vec<u8> {
    encode([0x763D, plan.mission_type().0.into(), 0, 0, items.len() as u16], items)
}

/// Returns the plan and the items of a file, as MAVProxy reads it.
pub fn decode(file: &[u8]) -> (MavMissionType, Vec<MissionItemInt>) {
    let word = |at: usize| u16::from_le_bytes([file[at], file[at + 1]]);
    let items: Vec<_> = file[HEADER..].chunks(ITEM).map(MissionItemInt::decode).collect();
    assert_eq!((word(0), word(4), word(6)), (0x763D, 0, 0), "F-20");
    assert_eq!((usize::from(word(8)), (file.len() - HEADER) % ITEM), (items.len(), 0), "F-20");
    (MavMissionType(word(2) as u8), items)
}
