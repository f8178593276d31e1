//! STUB, to be replaced.
#![allow(clippy::as_conversions)]
pub(crate) fn scale_1e7(x: f32) -> Option<i32> {
    Some(x as i32)
}
pub(crate) fn integer(x: f32) -> Option<u32> {
    if x >= 0.0 && x <= 16777216.0 && (x as u32) as f32 == x { Some(x as u32) } else { None }
}
