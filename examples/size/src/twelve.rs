//! The 12 message types that the firmware `frames` receives and the 8 that it sends, for a crate with a type `Tx` that sends.
//! `benches/compare` measures the same code beside other libraries.

use core::hint::black_box;

use mavstack::dialect::{
    CommandAck, CommandInt, CommandLong, Heartbeat, MavAutopilot, MavCmd, MavMissionResult, MavModeFlag, MavResult,
    MavSeverity, MavState, MavType, MissionAck, MissionClearAll, MissionCount, MissionItemInt, MissionRequestInt,
    MissionRequestList, ParamRequestList, ParamRequestRead, ParamSet, ParamValue, Statustext,
};
use mavstack::{Frame, Message, Text};

use crate::Tx;

mavstack::dialect! {
    /// What is received.
    pub struct Twelve: [
        Heartbeat, CommandLong, CommandInt, MissionCount, MissionItemInt, MissionRequestInt, MissionRequestList,
        MissionAck, MissionClearAll, ParamRequestList, ParamRequestRead, ParamSet,
    ];
}

/// Answers a command.
fn acknowledge(tx: &mut Tx, command: MavCmd, frame: &Frame<'_>) {
    tx.send(&CommandAck {
        command,
        result: black_box(MavResult::ACCEPTED),
        progress: 255,
        result_param2: 0,
        target_system: frame.source().system.wire(),
        target_component: frame.source().component.wire(),
    });
}

/// Decodes a message so that every field is used.
fn read<M: Message>(frame: &Frame<'_>) -> M {
    black_box(M::decode(frame.payload()))
}

/// Handles a received frame.
pub fn handle(frame: &Frame<'_>, tx: &mut Tx) {
    match frame.id() {
        Heartbeat::ID => {
            let _: Heartbeat = read(frame);
            tx.send(&Heartbeat {
                custom_mode: black_box(1),
                r#type: MavType::QUADROTOR,
                autopilot: MavAutopilot::GENERIC,
                base_mode: black_box(MavModeFlag::SAFETY_ARMED),
                system_status: black_box(MavState::ACTIVE),
                mavlink_version: 3,
            });
        }
        CommandLong::ID => acknowledge(tx, read::<CommandLong>(frame).command, frame),
        CommandInt::ID => acknowledge(tx, read::<CommandInt>(frame).command, frame),
        MissionCount::ID => {
            let count: MissionCount = read(frame);
            tx.send(&MissionRequestInt { seq: count.count, mission_type: count.mission_type, ..Default::default() });
        }
        MissionItemInt::ID => {
            let item: MissionItemInt = read(frame);
            tx.send(&MissionAck {
                r#type: black_box(MavMissionResult::ACCEPTED),
                mission_type: item.mission_type,
                ..Default::default()
            });
        }
        MissionRequestInt::ID => {
            let request: MissionRequestInt = read(frame);
            tx.send(&MissionItemInt { seq: request.seq, ..black_box(MissionItemInt::default()) });
        }
        MissionRequestList::ID => {
            let request: MissionRequestList = read(frame);
            tx.send(&MissionCount {
                count: black_box(3),
                mission_type: request.mission_type,
                ..black_box(MissionCount::default())
            });
        }
        MissionAck::ID => drop(read::<MissionAck>(frame)),
        MissionClearAll::ID => drop(read::<MissionClearAll>(frame)),
        ParamRequestList::ID => drop(read::<ParamRequestList>(frame)),
        ParamRequestRead::ID => {
            let request: ParamRequestRead = read(frame);
            tx.send(&ParamValue { param_id: request.param_id, ..black_box(ParamValue::default()) });
        }
        ParamSet::ID => {
            let _: ParamSet = read(frame);
            let severity = black_box(MavSeverity::INFO);
            tx.send(&Statustext { severity, text: Text::new("parameter set"), ..Default::default() });
        }
        _ => {}
    }
}
