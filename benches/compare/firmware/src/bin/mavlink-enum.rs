//! The crate mavlink, used as documented, with an enum of all messages.
#![no_std]
#![no_main]

use core::hint::black_box;

use mavlink::MavHeader;
use mavlink::MavlinkReader;
use mavlink::dialects::common::*;
use mavstack_compare_firmware::{Tx, Uart, measure};

const HEADER: MavHeader = MavHeader { system_id: 1, component_id: 1, sequence: 0 };

fn send(message: MavMessage) {
    let _ = mavlink::write_v2_msg(&mut Tx, HEADER, &message);
}

fn handle(message: &MavMessage) {
    // Every field is used.
    match black_box(message) {
        MavMessage::HEARTBEAT(_) => send(MavMessage::HEARTBEAT(black_box(HEARTBEAT_DATA::DEFAULT))),
        MavMessage::COMMAND_LONG(command) => send(MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: command.command,
            ..black_box(COMMAND_ACK_DATA::DEFAULT)
        })),
        MavMessage::COMMAND_INT(command) => send(MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: command.command,
            ..black_box(COMMAND_ACK_DATA::DEFAULT)
        })),
        MavMessage::MISSION_COUNT(count) => send(MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
            seq: count.count,
            ..black_box(MISSION_REQUEST_INT_DATA::DEFAULT)
        })),
        MavMessage::MISSION_ITEM_INT(_) => send(MavMessage::MISSION_ACK(black_box(MISSION_ACK_DATA::DEFAULT))),
        MavMessage::MISSION_REQUEST_INT(request) => send(MavMessage::MISSION_ITEM_INT(MISSION_ITEM_INT_DATA {
            seq: request.seq,
            ..black_box(MISSION_ITEM_INT_DATA::DEFAULT)
        })),
        MavMessage::MISSION_REQUEST_LIST(_) => send(MavMessage::MISSION_COUNT(black_box(MISSION_COUNT_DATA::DEFAULT))),
        MavMessage::PARAM_REQUEST_READ(request) => send(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_id: request.param_id,
            ..black_box(PARAM_VALUE_DATA::DEFAULT)
        })),
        MavMessage::PARAM_SET(_) => send(MavMessage::STATUSTEXT(black_box(STATUSTEXT_DATA {
            text: "parameter set".into(),
            ..STATUSTEXT_DATA::DEFAULT
        }))),
        _ => {}
    }
}

fn app(uart: Uart) -> u32 {
    let mut reader = MavlinkReader::new(uart);
    let mut frames = 0;
    if cfg!(feature = "framing") {
        while let Ok(raw) = reader.read_any_raw_message::<MavMessage>() {
            black_box(&raw);
            frames += 1;
        }
    } else {
        while let Ok((_, message)) = reader.read_any_message::<MavMessage>() {
            handle(&message);
            frames += 1;
        }
    }
    frames
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
