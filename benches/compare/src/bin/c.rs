//! The C library of mavgen.

use std::ffi::c_void;

use mavstack_compare::{FRAMES, Peer, SOURCE, run};

unsafe extern "C" {
    fn compare_frames(bytes: *const u8, len: usize, piece: usize) -> usize;
    fn compare_decode(bytes: *const u8, len: usize) -> usize;
    safe fn compare_message_size() -> usize;
    fn compare_messages(bytes: *const u8, len: usize, messages: *mut u64) -> usize;
    fn compare_encode(messages: *const u64, len: usize, system: u8, component: u8, all: *mut u8) -> usize;
    fn compare_recover(
        bytes: *const u8,
        len: usize,
        each: extern "C" fn(*mut c_void, *const u8, usize),
        context: *mut c_void,
    );
}

struct C;

/// C's structures, aligned for any of them, and how long they are as frames.
struct Messages {
    structures: Vec<u64>,
    frames: Vec<u8>,
    is_written: std::cell::Cell<bool>,
}

extern "C" fn call<F: FnMut(&[u8])>(context: *mut c_void, frame: *const u8, len: usize) {
    // SAFETY: `recover` hands over its own function, and C the buffer that it has just written.
    let (each, frame) = unsafe { (&mut *context.cast::<F>(), std::slice::from_raw_parts(frame, len)) };
    each(frame);
}

impl Peer for C {
    type Messages = Messages;

    fn frames(stream: &[u8], piece: usize) -> usize {
        // SAFETY: what C may read is the slice.
        unsafe { compare_frames(stream.as_ptr(), stream.len(), piece) }
    }

    fn decode(stream: &[u8]) -> usize {
        // SAFETY: what C may read is the slice.
        unsafe { compare_decode(stream.as_ptr(), stream.len()) }
    }

    fn messages(stream: &[u8]) -> Messages {
        let size = compare_message_size();
        let mut structures = vec![0; (FRAMES * size).div_ceil(size_of::<u64>())];
        // SAFETY: what C may read is the slice, and there is room for as many messages as it has.
        let found = unsafe { compare_messages(stream.as_ptr(), stream.len(), structures.as_mut_ptr()) };
        assert_eq!(found, FRAMES);
        Messages { structures, frames: vec![0; stream.len()], is_written: false.into() }
    }

    fn encode(messages: &Messages, mut each: impl FnMut(&[u8])) {
        let structures = messages.structures.as_ptr();
        // The frames themselves are wanted once, to be compared; later passes end at C's own buffer, as with the others.
        if messages.is_written.replace(true) {
            // SAFETY: there are so many messages.
            unsafe { compare_encode(structures, FRAMES, SOURCE.0, SOURCE.1, std::ptr::null_mut()) };
            return;
        }
        let mut all = messages.frames.clone();
        // SAFETY: there are so many messages, and room for the frames that they came from.
        unsafe { compare_encode(structures, FRAMES, SOURCE.0, SOURCE.1, all.as_mut_ptr()) };
        each(&all);
    }

    fn recover(stream: &[u8], each: impl FnMut(&[u8])) {
        fn with<F: FnMut(&[u8])>(stream: &[u8], mut each: F) {
            // SAFETY: what C may read is the slice; `each` lives until C is done.
            unsafe { compare_recover(stream.as_ptr(), stream.len(), call::<F>, (&raw mut each).cast()) };
        }
        with(stream, each);
    }
}

fn main() {
    run::<C>();
}
