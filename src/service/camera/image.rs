//! Images, and the log of the last ones.

use crate::time::Instant;
use core::num::{Saturating, Wrapping};

/// An image, as CAMERA_IMAGE_CAPTURED reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Image {
    /// The time of day (µs since 1970); 0 is unknown.
    pub time_utc: u64,
    /// When it was taken (ms since boot).
    pub time_boot_ms: u32,
    /// Latitude (1e-7 degrees).
    pub latitude: i32,
    /// Longitude (1e-7 degrees).
    pub longitude: i32,
    /// Altitude above mean sea level (mm).
    pub altitude: i32,
    /// Altitude above ground (mm).
    pub relative_altitude: i32,
    /// The camera's attitude as a quaternion (w, x, y, z); all zero is unknown.
    pub attitude: [f32; 4],
    /// Whether the image was taken.
    pub is_success: bool,
}

impl Image {
    /// All zero bits.
    pub(super) const NONE: Self = Self {
        time_utc: 0,
        time_boot_ms: 0,
        latitude: 0,
        longitude: 0,
        altitude: 0,
        relative_altitude: 0,
        attitude: [0.0; 4],
        is_success: false,
    };

    /// Returns an image that was taken at this time, at an unknown position.
    pub const fn at(now: Instant) -> Self {
        Self { time_boot_ms: now.time_boot_ms(), is_success: true, ..Self::NONE }
    }

    /// Returns an image that could not be taken.
    pub(super) const fn failed(now: Instant) -> Self {
        Self { is_success: false, ..Self::at(now) }
    }
}

const _: () = assert!(size_of::<Image>() == 48, "the memory of an image is documented");

/// The number of an image since the start: 1 for the first. It wraps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageNumber(Wrapping<u32>);

impl ImageNumber {
    /// No image.
    pub(super) const NONE: Self = Self(Wrapping(0));
}

/// The image after another one.
pub(super) struct NextImage {
    pub(super) number: Option<ImageNumber>,
    /// The number of images between them that are no longer in the log.
    pub(super) lost: u32,
}

/// The last images. The one with number `n` is at `n` modulo their capacity.
#[derive(Debug)]
pub(super) struct ImageLog<I: ?Sized = [Image]> {
    pub(super) newest: ImageNumber,
    /// The newest image at the last reset: the next one has index 0.
    last_before_reset: ImageNumber,
    images: I,
}

impl<const N: usize> ImageLog<[Image; N]> {
    pub(super) const EMPTY: Self =
        Self { newest: ImageNumber::NONE, last_before_reset: ImageNumber::NONE, images: [Image::NONE; N] };
}

impl ImageLog {
    /// Adds an image. It replaces the oldest.
    pub(super) fn push(&mut self, image: Image) {
        self.newest.0 += 1;
        if let Some(place) = self.place(self.newest)
            && let Some(oldest) = self.images.get_mut(place)
        {
            *oldest = image;
        }
    }

    /// Forgets all images. Their numbers are not used again, their indices are.
    pub(super) const fn reset(&mut self) {
        self.last_before_reset = self.newest;
    }

    /// Returns the number of images since the reset.
    pub(super) const fn count(&self) -> u32 {
        self.newest.0.0.wrapping_sub(self.last_before_reset.0.0)
    }

    /// Returns the index of an image, which counts from 0 at the reset.
    pub(super) fn index(&self, ImageNumber(number): ImageNumber) -> u32 {
        (number - self.last_before_reset.0 - Wrapping(1)).0
    }

    /// Returns the image with this index.
    pub(super) fn number(&self, index: u32) -> ImageNumber {
        ImageNumber(self.last_before_reset.0 + Wrapping(index) + Wrapping(1))
    }

    pub(super) fn get(&self, number: ImageNumber) -> Option<&Image> {
        self.images.get(self.place(number)?)
    }

    /// Whether this is an image that is still in the log.
    pub(super) fn contains(&self, number: ImageNumber) -> bool {
        number != ImageNumber::NONE && (self.newest.0 - number.0).0 < self.len()
    }

    /// Returns the image after this one that is still in the log, and how many before it are not.
    pub(super) fn after(&self, ImageNumber(number): ImageNumber) -> NextImage {
        let Saturating(lost) = Saturating((self.newest.0 - number).0) - Saturating(self.len());
        let next = number + Wrapping(lost);
        NextImage { number: (next != self.newest.0).then_some(ImageNumber(next + Wrapping(1))), lost }
    }

    /// Returns the number of images since the reset that are still in the log.
    fn len(&self) -> u32 {
        self.count().min(u32::try_from(self.images.len()).unwrap_or(u32::MAX))
    }

    fn place(&self, ImageNumber(number): ImageNumber) -> Option<usize> {
        usize::try_from(number.0).ok()?.checked_rem(self.images.len())
    }
}
