//! The pending reports of a link: requested messages and images, and changes.

use super::image::ImageNumber;
use crate::dialect::{
    CameraCaptureStatus, CameraImageCaptured, CameraInformation, CameraSettings, MavCmd, StorageInformation,
    VideoStreamInformation, VideoStreamStatus,
};
use crate::message::Message;
use crate::num;
use crate::time::Instant;
use core::num::Wrapping;

/// The number of images that a link can be asked for again at a time.
const REQUESTED_IMAGES: usize = 4;

/// The state of the service on a link. Initially all zero bits.
#[derive(Debug)]
pub struct CameraLink {
    /// The requested instances of each message of [`REQUESTABLE`].
    pub(super) requested: [Instances; REQUESTABLE.len()],
    /// The images that were requested again.
    pub(super) requested_images: [ImageNumber; REQUESTED_IMAGES],
    /// The last image that was reported.
    pub(super) reported_image: ImageNumber,
    /// The changes that were reported.
    pub(super) changes: Wrapping<u8>,
    pub(super) settings_changes: Wrapping<u8>,
    /// The interval of CAMERA_CAPTURE_STATUS (ms); 0 for none. When it is due next.
    pub(super) status_interval: u32,
    pub(super) status_at: Instant,
}

impl CameraLink {
    pub(super) const VACANT: Self = Self {
        requested: [Instances::NONE; REQUESTABLE.len()],
        requested_images: [ImageNumber::NONE; REQUESTED_IMAGES],
        reported_image: ImageNumber::NONE,
        changes: Wrapping(0),
        settings_changes: Wrapping(0),
        status_interval: 0,
        status_at: Instant::ZERO,
    };

    /// Makes instances of a message pending.
    pub(super) fn request(&mut self, id: u32, instances: Instances) {
        for (message, requested) in REQUESTABLE.iter().zip(&mut self.requested) {
            if message.id == id {
                requested.0 |= instances.0;
            }
        }
    }
}

/// A message that can be requested.
pub(super) struct Requestable {
    pub(super) id: u32,
    /// The command that MAV_CMD_REQUEST_MESSAGE has replaced.
    pub(super) superseded: MavCmd,
}

/// The messages that can be requested, in the order in which they are sent.
pub(super) const REQUESTABLE: [Requestable; 7] = [
    Requestable { id: CameraInformation::ID, superseded: MavCmd::REQUEST_CAMERA_INFORMATION },
    Requestable { id: CameraSettings::ID, superseded: MavCmd::REQUEST_CAMERA_SETTINGS },
    Requestable { id: StorageInformation::ID, superseded: MavCmd::REQUEST_STORAGE_INFORMATION },
    Requestable { id: VideoStreamInformation::ID, superseded: MavCmd::REQUEST_VIDEO_STREAM_INFORMATION },
    Requestable { id: VideoStreamStatus::ID, superseded: MavCmd::REQUEST_VIDEO_STREAM_STATUS },
    Requestable { id: CameraCaptureStatus::ID, superseded: MavCmd::REQUEST_CAMERA_CAPTURE_STATUS },
    Requestable { id: CameraImageCaptured::ID, superseded: MavCmd::REQUEST_CAMERA_IMAGE_CAPTURE },
];

/// A set of instances of a message, such as of storages: bit 0 is the one with the id 1. A message without instances
/// has the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Instances(u8);

impl Instances {
    pub(super) const NONE: Self = Self(0);
    pub(super) const FIRST: Self = Self(1);

    /// Returns the instances that a parameter names, of those up to `count`: 0 and NaN are all of them.
    pub(super) fn of_param(param: f32, count: u8) -> Self {
        let all = !u8::MAX.unbounded_shl(count.into());
        match num::integer::<u8>(param) {
            Some(0) => Self(all),
            Some(id) => Self(all & 1u8.unbounded_shl(u32::from(id).wrapping_sub(1))),
            None if param.is_nan() => Self(all),
            None => Self::NONE,
        }
    }

    /// Returns the id of the first instance.
    pub(super) fn first(self) -> Option<u8> {
        let id = (u16::from(self.0) << 1).trailing_zeros();
        if self == Self::NONE { None } else { u8::try_from(id).ok() }
    }

    pub(super) fn remove_first(&mut self) {
        self.0 &= self.0.wrapping_sub(1);
    }
}

/// A message that the camera sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraReply {
    /// CAMERA_IMAGE_CAPTURED.
    Image(ImageNumber),
    /// Another message, by its id.
    Message {
        id: u32,
        /// The id of the storage or the video stream.
        instance: u8,
    },
}
