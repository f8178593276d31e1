//! The crate mavio, reduced to frames and the structs of the twelve messages.
#![no_std]
#![no_main]

#[path = "../mavio.rs"]
mod common;

use core::hint::black_box;

use common::{Reader, send};
use mavio::dialects::common::messages::*;
use mavio::error::IoError;
use mavio::io::Receiver;
use mavio::mavspec::rust::spec::MessageSpecStatic;
use mavio::protocol::{Endpoint, Frame, MavLinkId, V2, Versionless};
use mavstack_compare_firmware::{Uart, measure};

macro_rules! twelve {
    ($frame:expr, $endpoint:expr, $($message:ident => $then:expr,)+) => {{
        let frame = $frame;
        match frame.message_id() {
            $(id if id == <$message as MessageSpecStatic>::message_id() => {
                if cfg!(feature = "framing") {
                    frame.validate_checksum_with_crc_extra(<$message as MessageSpecStatic>::crc_extra()).is_ok()
                } else if let Ok(message) = frame.decode_message::<$message>() {
                    let then: fn(&$message, &Endpoint<V2>) = $then;
                    then(black_box(&message), $endpoint);
                    true
                } else {
                    false
                }
            })+
            _ => false,
        }
    }};
}

fn handle(frame: &Frame<Versionless>, endpoint: &Endpoint<V2>) -> bool {
    twelve!(frame, endpoint,
        Heartbeat => |_, endpoint| send(endpoint, &black_box(Heartbeat::default())),
        CommandLong => |command, endpoint| {
            send(endpoint, &CommandAck { command: command.command, ..black_box(CommandAck::default()) });
        },
        CommandInt => |command, endpoint| {
            send(endpoint, &CommandAck { command: command.command, ..black_box(CommandAck::default()) });
        },
        MissionCount => |count, endpoint| {
            let mission_type = count.mission_type;
            let request = black_box(MissionRequestInt::default());
            send(endpoint, &MissionRequestInt { seq: count.count, mission_type, ..request });
        },
        MissionItemInt => |item, endpoint| {
            send(endpoint, &MissionAck { mission_type: item.mission_type, ..black_box(MissionAck::default()) });
        },
        MissionRequestInt => |request, endpoint| {
            send(endpoint, &MissionItemInt { seq: request.seq, ..black_box(MissionItemInt::default()) });
        },
        MissionRequestList => |request, endpoint| {
            send(endpoint, &MissionCount { mission_type: request.mission_type, ..black_box(MissionCount::default()) });
        },
        MissionAck => |_, _| (),
        MissionClearAll => |_, _| (),
        ParamRequestList => |_, _| (),
        ParamRequestRead => |request, endpoint| {
            send(endpoint, &ParamValue { param_id: request.param_id, ..black_box(ParamValue::default()) });
        },
        ParamSet => |_, endpoint| {
            let mut text = [0; 50];
            text[..13].copy_from_slice(b"parameter set");
            send(endpoint, &Statustext { text, ..black_box(Statustext::default()) });
        },
    )
}

fn app(uart: Uart) -> u32 {
    let endpoint = Endpoint::v2(MavLinkId::new(1, 1));
    let mut receiver: Receiver<IoError, _, Versionless> = Receiver::versionless(Reader(uart));
    let mut frames = 0;
    while let Ok(frame) = receiver.recv() {
        frames += u32::from(handle(&frame, &endpoint));
        if cfg!(feature = "framing") {
            black_box(&frame);
        }
    }
    frames
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
