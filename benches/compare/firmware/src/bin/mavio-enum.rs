//! The crate mavio, used as documented, with an enum of all messages.
#![no_std]
#![no_main]

#[path = "../mavio.rs"]
mod common;

use core::hint::black_box;

use common::{Reader, send};
use mavio::dialects::common::Common;
use mavio::dialects::common::messages::*;
use mavio::error::IoError;
use mavio::io::Receiver;
use mavio::protocol::{Endpoint, MavLinkId, V2, Versionless};
use mavstack_compare_firmware::{Uart, measure};

fn handle(message: &Common, endpoint: &Endpoint<V2>) {
    // Every field is used.
    match black_box(message) {
        Common::Heartbeat(_) => send(endpoint, &black_box(Heartbeat::default())),
        Common::CommandLong(command) => {
            send(endpoint, &CommandAck { command: command.command, ..black_box(CommandAck::default()) });
        }
        Common::CommandInt(command) => {
            send(endpoint, &CommandAck { command: command.command, ..black_box(CommandAck::default()) });
        }
        Common::MissionCount(count) => send(
            endpoint,
            &MissionRequestInt {
                seq: count.count,
                mission_type: count.mission_type,
                ..black_box(MissionRequestInt::default())
            },
        ),
        Common::MissionItemInt(item) => {
            send(endpoint, &MissionAck { mission_type: item.mission_type, ..black_box(MissionAck::default()) });
        }
        Common::MissionRequestInt(request) => {
            send(endpoint, &MissionItemInt { seq: request.seq, ..black_box(MissionItemInt::default()) });
        }
        Common::MissionRequestList(request) => {
            send(endpoint, &MissionCount { mission_type: request.mission_type, ..black_box(MissionCount::default()) });
        }
        Common::ParamRequestRead(request) => {
            send(endpoint, &ParamValue { param_id: request.param_id, ..black_box(ParamValue::default()) });
        }
        Common::ParamSet(_) => {
            let mut text = [0; 50];
            text[..13].copy_from_slice(b"parameter set");
            send(endpoint, &Statustext { text, ..black_box(Statustext::default()) });
        }
        _ => {}
    }
}

fn app(uart: Uart) -> u32 {
    let endpoint = Endpoint::v2(MavLinkId::new(1, 1));
    let mut receiver: Receiver<IoError, _, Versionless> = Receiver::versionless(Reader(uart));
    let mut frames = 0;
    while let Ok(frame) = receiver.recv() {
        if cfg!(feature = "framing") {
            if frame.validate_checksum::<Common>().is_ok() {
                black_box(&frame);
                frames += 1;
            }
        } else if let Ok(message) = frame.decode::<Common>() {
            handle(&message, &endpoint);
            frames += 1;
        }
    }
    frames
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
