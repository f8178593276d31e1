//! The crate mavlink, reduced to a dialect of the twelve messages.
#![no_std]
#![no_main]

use core::hint::black_box;

use mavlink::MavHeader;
use mavlink::dialects::common::*;
use mavlink::error::ParserError;
use mavlink::{Dialect, MAVLinkV2MessageRaw, MavlinkReader, MavlinkVersion, MessageData};
use mavstack_compare_firmware::{Uart, measure};

const HEADER: MavHeader = MavHeader { system_id: 1, component_id: 1, sequence: 0 };

macro_rules! twelve {
    ($($name:ident($message:ident),)+) => {
        #[allow(non_camel_case_types, dead_code, reason = "MAVLink's names; some fields are only passed to black_box")]
        enum Received {
            $($name($message),)+
            /// A frame that is not decoded.
            Frame,
        }

        /// A custom dialect.
        struct Twelve;

        impl Dialect for Twelve {
            type Message = Received;
            type EncodeError = core::convert::Infallible;

            fn message_id(&self, _: &Received) -> u32 {
                0
            }

            fn extra_crc(&self, id: u32) -> Option<u8> {
                match id {
                    $($message::ID => Some($message::EXTRA_CRC),)+
                    _ => None,
                }
            }

            fn decode(&self, version: MavlinkVersion, id: u32, payload: &[u8]) -> Result<Received, ParserError> {
                if cfg!(feature = "framing") {
                    black_box(payload);
                    return Ok(Received::Frame);
                }
                match id {
                    $($message::ID => $message::deser(version, payload).map(Received::$name),)+
                    id => Err(ParserError::UnknownMessage { id }),
                }
            }

            fn encode(&self, _: MavlinkVersion, _: &Received, _: &mut [u8]) -> Result<usize, Self::EncodeError> {
                Ok(0)
            }
        }
    };
}

twelve! {
    HEARTBEAT(HEARTBEAT_DATA),
    COMMAND_LONG(COMMAND_LONG_DATA),
    COMMAND_INT(COMMAND_INT_DATA),
    MISSION_COUNT(MISSION_COUNT_DATA),
    MISSION_ITEM_INT(MISSION_ITEM_INT_DATA),
    MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA),
    MISSION_REQUEST_LIST(MISSION_REQUEST_LIST_DATA),
    MISSION_ACK(MISSION_ACK_DATA),
    MISSION_CLEAR_ALL(MISSION_CLEAR_ALL_DATA),
    PARAM_REQUEST_LIST(PARAM_REQUEST_LIST_DATA),
    PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA),
    PARAM_SET(PARAM_SET_DATA),
}

fn send<D: MessageData>(message: &D) {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message_data(HEADER, message);
    Uart::send(raw.raw_bytes());
}

fn acknowledge(command: MavCmd) {
    send(&COMMAND_ACK_DATA { command, ..black_box(COMMAND_ACK_DATA::DEFAULT) });
}

fn handle(message: &Received) {
    // Every field is used.
    match black_box(message) {
        Received::HEARTBEAT(_) => send(&black_box(HEARTBEAT_DATA::DEFAULT)),
        Received::COMMAND_LONG(command) => acknowledge(command.command),
        Received::COMMAND_INT(command) => acknowledge(command.command),
        Received::MISSION_COUNT(count) => {
            send(&MISSION_REQUEST_INT_DATA { seq: count.count, ..black_box(MISSION_REQUEST_INT_DATA::DEFAULT) });
        }
        Received::MISSION_ITEM_INT(_) => send(&black_box(MISSION_ACK_DATA::DEFAULT)),
        Received::MISSION_REQUEST_INT(request) => {
            send(&MISSION_ITEM_INT_DATA { seq: request.seq, ..black_box(MISSION_ITEM_INT_DATA::DEFAULT) });
        }
        Received::MISSION_REQUEST_LIST(_) => send(&black_box(MISSION_COUNT_DATA::DEFAULT)),
        Received::PARAM_REQUEST_READ(request) => {
            send(&PARAM_VALUE_DATA { param_id: request.param_id, ..black_box(PARAM_VALUE_DATA::DEFAULT) });
        }
        Received::PARAM_SET(_) => {
            send(&black_box(STATUSTEXT_DATA { text: "parameter set".into(), ..STATUSTEXT_DATA::DEFAULT }));
        }
        _ => {}
    }
}

fn app(uart: Uart) -> u32 {
    let mut reader = MavlinkReader::new(uart);
    let mut frames = 0;
    while let Ok((_, message)) = reader.read_any_message_with_dialect(&Twelve) {
        handle(&message);
        frames += 1;
    }
    frames
}

#[cortex_m_rt::entry]
fn main() -> ! {
    measure(app)
}
