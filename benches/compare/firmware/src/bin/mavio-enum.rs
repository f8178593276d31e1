//! The crate mavio, used as documented, with an enum of all messages.
#![no_std]
#![no_main]

use core::hint::black_box;

use mavio::dialects::common::Common;
use mavio::dialects::common::messages::*;
use mavio::error::{IoError, IoErrorKind};
use mavio::io::{Read, Receiver};
use mavio::protocol::{Endpoint, MavLinkId, Message, V2, Versionless};
use mavstack_compare_firmware::{Uart, measure};

/// An allocator that is never used. The crate does not link without one.
struct NoMemory;

// SAFETY: it returns null only.
unsafe impl core::alloc::GlobalAlloc for NoMemory {
    unsafe fn alloc(&self, _: core::alloc::Layout) -> *mut u8 {
        core::ptr::null_mut()
    }

    unsafe fn dealloc(&self, _: *mut u8, _: core::alloc::Layout) {}
}

#[global_allocator]
static NO_MEMORY: NoMemory = NoMemory;

struct Reader(Uart);

impl Read<IoError> for Reader {
    fn read_exact(&mut self, out: &mut [u8]) -> Result<(), IoError> {
        if self.0.take_exact(out) { Ok(()) } else { Err(IoErrorKind::UnexpectedEof.into()) }
    }
}

fn send(endpoint: &Endpoint<V2>, message: &dyn Message) {
    let mut out = [0; 280];
    if let Ok(frame) = endpoint.next_frame(message)
        && let Ok(len) = frame.serialize(&mut out)
    {
        Uart::send(out.get(..len).unwrap_or_default());
    }
}

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
