//! Frames.
pub(crate) mod crc;
