//! What both uses of mavio share.

use mavio::error::{IoError, IoErrorKind};
use mavio::io::Read;
use mavio::protocol::{Endpoint, Message, V2};
use mavstack_compare_firmware::Uart;

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

/// Reads from the UART.
pub struct Reader(pub Uart);

impl Read<IoError> for Reader {
    fn read_exact(&mut self, out: &mut [u8]) -> Result<(), IoError> {
        if self.0.take_exact(out) { Ok(()) } else { Err(IoErrorKind::UnexpectedEof.into()) }
    }
}

/// Sends a message.
pub fn send(endpoint: &Endpoint<V2>, message: &dyn Message) {
    let mut out = [0; 280];
    if let Ok(frame) = endpoint.next_frame(message)
        && let Ok(len) = frame.serialize(&mut out)
    {
        Uart::send(out.get(..len).unwrap_or_default());
    }
}
