//! The schedule of images, the state that the camera reports, and the pending reports of each link.

use super::image::{Image, ImageLog, ImageNumber};
use super::link::{CameraLink, CameraReply, REQUESTABLE};
use crate::dialect::{CameraCaptureStatus, CameraSettings, MavResult};
use crate::message::{Address, Message};
use crate::num;
use crate::service::increment;
use crate::time::{Duration, Instant};
use core::num::{Saturating, Wrapping};
use core::ops::{Deref, DerefMut};

/// The number of images of an unlimited capture.
const UNLIMITED: u32 = u32::MAX;

/// How long a single image with the same sequence number is taken for a retransmission. A client that was started again
/// begins with the same numbers.
const REPEATED: Duration = Duration::from_secs(3);

counters! {
    /// Counters of the camera. They wrap.
    CameraCounters {
        /// Images that could not be taken: their CAMERA_IMAGE_CAPTURED says so.
        count failed,
        /// Images that failed because the camera did not report their end in time. They are among `failed`.
        count timed_out,
        /// The vehicle's orders for an image that were ignored, because another one was waiting for the camera.
        drop ignored,
        /// Reports that a link did not send, because it was stalled while more images were taken than are remembered.
        drop unsent,
    }
}

/// A camera that remembers its last images, 48 bytes each: `camera: CameraControl<[Image; 16]>` in the struct of a
/// [stack](macro@crate::Stack). The vehicle's part is [`Camera`](super::Camera).
///
/// ```text
///   IMAGE_START_CAPTURE ───┐
///   DO_DIGICAM_CONTROL ────┤              interval                       Shot::Taken ─────────┐
///   Camera::camera_order ──┼─▶ waiting ─── is over ──▶ Camera::take_image ├─▶ Shot::Started ──┼─▶ CAMERA_IMAGE_CAPTURED
///   take_image ────────────┤                                              └─▶ Shot::Failed ───┤   on every normal link
///   start_capture ─────────┘                                        image_captured, timeout ──┘
/// ```
///
/// The stack has the schedule, and counts and remembers the images. Every image has the next index, whether it was
/// taken or has failed, and is reported once on every normal link that carries MAVLink 2. A ground station that has
/// missed a report asks for it, as long as the image is remembered. Only a [reset of the image log](Self::reset_images)
/// lets the index begin again.
///
/// A command to take images is answered at once, and TEMPORARILY_REJECTED while others are being taken. Its
/// retransmission is ACCEPTED and starts nothing: a single image with the same sequence number from the same sender
/// within three seconds, or the same command for several images while they are being taken.
///
/// CAMERA_CAPTURE_STATUS is sent on the same links after each change, on request, and at an interval by
/// MAV_CMD_SET_MESSAGE_INTERVAL or MAV_CMD_VIDEO_START_CAPTURE; CAMERA_SETTINGS after each change.
#[derive(Debug)]
pub struct CameraControl<I: ?Sized = [Image]> {
    /// When the next image at an interval is due.
    next_image_at: Instant,
    /// How many images at an interval are left; [`UNLIMITED`] for no end, 0 if none are being taken.
    images_left: Saturating<u32>,
    /// The interval (ms).
    pub(super) interval: u32,
    /// Whether a single image, apart from those at an interval, waits for the camera.
    pub(super) is_single_waiting: bool,
    /// Whether an image is being taken. It has failed if it is not complete at `busy_until`.
    pub(super) is_busy: bool,
    pub(super) busy_until: Instant,
    /// The last accepted command to take images, and when it was received.
    command: CaptureCommand,
    command_at: Instant,
    pub(super) is_recording: bool,
    pub(super) recording_since: Instant,
    /// The interval of CAMERA_CAPTURE_STATUS during the recording (ms); 0 for none, and without video.
    pub(super) recording_interval: u32,
    /// The changes of state and settings, to report each of them once on each link.
    pub(super) changes: Wrapping<u8>,
    pub(super) settings_changes: Wrapping<u8>,
    pub(super) counters: CameraCounters,
    pub(super) images: ImageLog<I>,
}

/// A command to take images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CaptureCommand {
    pub(super) from: Address,
    /// The interval (ms).
    pub(super) interval: u32,
    /// The number of images; 0 for no end.
    pub(super) count: u32,
    /// The sequence number; 0 for none.
    pub(super) sequence: u32,
}

impl CaptureCommand {
    /// No command, because no sender has this address.
    const NONE: Self = Self { from: Address::new(0, 0), interval: 0, count: 0, sequence: 0 };
}

impl<const N: usize> CameraControl<[Image; N]> {
    /// All zero bits.
    pub(super) const NEW: Self = Self {
        next_image_at: Instant::ZERO,
        images_left: Saturating(0),
        interval: 0,
        is_single_waiting: false,
        is_busy: false,
        busy_until: Instant::ZERO,
        command: CaptureCommand::NONE,
        command_at: Instant::ZERO,
        is_recording: false,
        recording_since: Instant::ZERO,
        recording_interval: 0,
        changes: Wrapping(0),
        settings_changes: Wrapping(0),
        counters: CameraCounters::ZERO,
        images: ImageLog::EMPTY,
    };
}

/// The methods are those of a camera that remembers any number of images.
impl<const N: usize> Deref for CameraControl<[Image; N]> {
    type Target = CameraControl;

    fn deref(&self) -> &CameraControl {
        self
    }
}

impl<const N: usize> DerefMut for CameraControl<[Image; N]> {
    fn deref_mut(&mut self) -> &mut CameraControl {
        self
    }
}

impl CameraControl {
    /// Takes one image in the next [`poll`](crate::Stack::poll), or when the camera is no longer busy. Returns false if
    /// one is already waiting for that; then nothing more is taken.
    pub fn take_image(&mut self) -> bool {
        if self.is_single_waiting {
            increment(&mut self.counters.ignored);
            return false;
        }
        self.is_single_waiting = true;
        true
    }

    /// Takes images at this interval from the next [`poll`](crate::Stack::poll) on: `count` of them, or until
    /// [`stop_capture`](Self::stop_capture) if it is 0. It replaces the one before.
    /// [`Camera::MIN_INTERVAL`](super::Camera::MIN_INTERVAL) does not apply.
    pub fn start_capture(&mut self, now: Instant, interval: Duration, count: u32) {
        self.start_interval(now, millis(interval), count);
    }

    /// Ends captures and videos. An image that is being taken is completed.
    pub fn stop_capture(&mut self) {
        if self.is_at_interval() || self.is_single_waiting {
            self.images_left.0 = 0;
            self.is_single_waiting = false;
            self.changes += 1;
        }
        // If the command to take images is repeated, it is no retransmission: it takes images again.
        self.command = CaptureCommand::NONE;
    }

    /// Reports the end of an image after [`Shot::Started`](super::Shot::Started). Also reports an image that the camera
    /// took by itself, such as by a button: it is counted like all others.
    pub fn image_captured(&mut self, image: Image) {
        if !image.is_success {
            increment(&mut self.counters.failed);
        }
        self.is_busy = false;
        self.images.push(image);
        event!("camera: image {=u32}", self.image_count());
        self.changes += 1;
    }

    /// Reports that mode, zoom or focus have changed without a command.
    pub fn settings_changed(&mut self) {
        self.settings_changes += 1;
    }

    /// Forgets all images: the next one has index 0. MAV_CMD_STORAGE_FORMAT does this if its sender wants it.
    pub fn reset_images(&mut self) {
        self.images.reset();
        self.changes += 1;
    }

    /// Returns the number of images since the [reset](Self::reset_images): the index of the next one.
    pub const fn image_count(&self) -> u32 {
        self.images.count()
    }

    /// Returns whether an image is being taken or waits for the camera, or images are taken at an interval.
    pub const fn is_capturing(&self) -> bool {
        self.is_busy || self.is_single_waiting || self.is_at_interval()
    }

    /// Returns whether video is being recorded.
    pub const fn is_recording(&self) -> bool {
        self.is_recording
    }

    /// Returns the counters.
    pub const fn counters(&self) -> CameraCounters {
        self.counters
    }

    /// Whether images are being taken at an interval.
    pub(super) const fn is_at_interval(&self) -> bool {
        self.images_left.0 > 0
    }

    /// Starts to take images at an interval (ms).
    fn start_interval(&mut self, now: Instant, interval: u32, count: u32) {
        self.images_left.0 = if count == 0 { UNLIMITED } else { count };
        self.next_image_at = now;
        self.interval = interval.max(1);
        self.changes += 1;
    }

    /// Whether a command to take images is a retransmission of the one that was accepted last. An equal command is one
    /// while its images are being taken, and also soon after it was accepted if it has a sequence number.
    pub(super) fn is_retransmission(&self, now: Instant, command: &CaptureCommand) -> bool {
        if *command != self.command {
            return false;
        }
        let (is_single, has_sequence) = (command.count == 1, command.sequence != 0);
        if is_single && !has_sequence {
            // A second press of a button takes a second image.
            return false;
        }
        let is_recent = has_sequence && now < self.command_at + REPEATED;
        self.is_at_interval() || is_recent
    }

    /// Starts the capture that an accepted command requests. `min_interval`: in ms.
    pub(super) fn start(&mut self, now: Instant, command: CaptureCommand, min_interval: u32) {
        self.command = command;
        self.command_at = now;
        if command.count == 1 {
            self.is_single_waiting = true;
            self.changes += 1;
        } else {
            self.start_interval(now, command.interval.max(min_interval), command.count);
        }
    }

    /// Returns when [`poll`](super::Service::poll) has something to do.
    pub(super) fn poll_deadline(&self) -> Instant {
        if self.is_busy {
            self.busy_until
        } else if self.is_single_waiting {
            Instant::ZERO
        } else if self.is_at_interval() {
            self.next_image_at
        } else {
            Instant::NEVER
        }
    }

    /// Removes an image that is due from the schedule: a single one, or the next one at an interval. Returns whether
    /// the camera must take an image now.
    pub(super) fn take_due_image(&mut self, now: Instant) -> bool {
        if self.is_busy {
            return false;
        }
        if self.is_single_waiting {
            self.is_single_waiting = false;
            return true;
        }
        if !self.is_at_interval() || now < self.next_image_at {
            return false;
        }
        let is_unlimited = self.images_left.0 == UNLIMITED;
        if !is_unlimited {
            self.images_left -= 1;
        }
        // After a poll that is late by less than an interval, the next image is on time. After a longer delay the
        // interval starts from now: missed images are not made up.
        let interval = Duration::from_millis(self.interval.into());
        let on_time = self.next_image_at + interval;
        self.next_image_at = if on_time > now { on_time } else { now + interval };
        true
    }

    /// Handles a request for an image by its index. Returns DENIED if there is no such image, FAILED if it is no longer
    /// in the log, and TEMPORARILY_REJECTED if too many images are pending on the link.
    ///
    /// MAVSDK sends MAV_CMD_REQUEST_MESSAGE without the index. DENIED makes it send
    /// MAV_CMD_REQUEST_CAMERA_IMAGE_CAPTURE, which has the index (`mavlink_request_message.cpp`).
    pub(super) fn request_image(&self, link: &mut CameraLink, index: f32) -> MavResult {
        let Some(index) = num::integer(index).filter(|index| *index < self.image_count()) else {
            return MavResult::DENIED;
        };
        let image = self.images.number(index);
        if !self.images.contains(image) {
            return MavResult::FAILED;
        }
        // The entry of an earlier request for this image, or one without an image that can be sent.
        let is_usable = |entry: &&mut ImageNumber| **entry == image || !self.images.contains(**entry);
        let Some(entry) = link.requested_images.iter_mut().find(is_usable) else {
            return MavResult::TEMPORARILY_REJECTED;
        };
        *entry = image;
        MavResult::ACCEPTED
    }

    /// Returns the message that is pending on a link, and when it is due: requested messages first, then changed
    /// settings, images, and CAMERA_CAPTURE_STATUS.
    pub(super) fn next_message(&self, now: Instant, link: &CameraLink) -> (Instant, CameraReply) {
        for (message, requested) in REQUESTABLE.iter().zip(link.requested) {
            if let Some(instance) = requested.first() {
                return (now, CameraReply::Message { id: message.id, instance });
            }
        }
        if link.settings_changes != self.settings_changes {
            return (now, CameraReply::Message { id: CameraSettings::ID, instance: 0 });
        }
        let requested = link.requested_images.iter().copied().find(|image| self.images.contains(*image));
        if let Some(image) = requested.or(self.images.after(link.reported_image).number) {
            return (now, CameraReply::Image(image));
        }
        let at = if link.changes != self.changes {
            now
        } else if self.status_interval(link) == 0 {
            Instant::NEVER
        } else {
            link.status_at
        };
        (at, CameraReply::Message { id: CameraCaptureStatus::ID, instance: 0 })
    }

    /// Records that a message is being sent on a link.
    pub(super) fn record_message(&mut self, now: Instant, link: &mut CameraLink, id: u32) {
        for (message, requested) in REQUESTABLE.iter().zip(&mut link.requested) {
            if message.id == id {
                requested.remove_first();
            }
        }
        if id == CameraSettings::ID {
            link.settings_changes = self.settings_changes;
        }
        if id == CameraCaptureStatus::ID {
            link.changes = self.changes;
            link.status_at = now + Duration::from_millis(self.status_interval(link).into());
        }
    }

    /// Records that the report of an image is being sent on a link.
    pub(super) fn record_image(&mut self, link: &mut CameraLink, image: ImageNumber) {
        for entry in &mut link.requested_images {
            if *entry == image {
                *entry = ImageNumber::NONE;
            }
        }
        let next = self.images.after(link.reported_image);
        if next.number == Some(image) {
            self.counters.unsent = (Wrapping(self.counters.unsent) + Wrapping(next.lost)).0;
            link.reported_image = image;
        }
    }

    /// Returns the interval of CAMERA_CAPTURE_STATUS on a link, the shorter of both (ms); 0 for none.
    fn status_interval(&self, link: &CameraLink) -> u32 {
        match (self.recording_interval, link.status_interval) {
            (0, interval) | (interval, 0) => interval,
            (recording, own) => recording.min(own),
        }
    }
}

/// Returns an interval in milliseconds, rounded down.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; the value was bounded")]
pub(super) const fn millis(interval: Duration) -> u32 {
    let millis = interval.as_millis();
    if millis > u32::MAX as u64 { u32::MAX } else { millis as u32 }
}
