//! A camera: what it is and does, images on command and at intervals, video, and a report of each image.
//!
//! Implements the camera's side of <https://mavlink.io/en/services/camera.html>, version 2: rules CAM-1 to CAM-9. It serves the
//! requests of MAVSDK's plugin (`plugins/camera/camera_impl.cpp`, `core/mavlink_request_message.cpp`), QGroundControl
//! (`src/Camera/VehicleCameraControl.cc`) and MAVProxy, in the new form and in the superseded one.
//!
//! Left out: tracking (MAV_CMD_CAMERA_TRACK_POINT and its kin), CAMERA_FOV_STATUS, CAMERA_THERMAL_RANGE, MAV_CMD_SET_STORAGE_USAGE,
//! MAV_CMD_DO_TRIGGER_CONTROL, and MESSAGE_INTERVAL for CAMERA_CAPTURE_STATUS. MAV_CMD_DO_SET_CAM_TRIGG_DIST is the vehicle's:
//! [`Camera`] has an example.

mod commands;
mod messages;
mod vehicle;

pub use vehicle::{Camera, CameraOrder, Shot};

use self::commands::Start;
use self::messages::{CameraReply, ROWS};
use super::{About, Cx, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment};
use crate::dialect::{CameraInformation, MavResult};
use crate::link::Port;
use crate::message::Message;
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{Component, Firmware};
use core::ops::{Deref, DerefMut};

/// The number of orders of the vehicle that a poll takes.
const ORDERS: u8 = 4;

/// The number of images that a link can be asked for again at a time.
const REQUESTED: usize = 4;

/// The number of images of an unlimited capture.
const UNLIMITED: u32 = u32::MAX;

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
    const NONE: Self = Self {
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
    const fn failed(now: Instant) -> Self {
        Self { is_success: false, ..Self::at(now) }
    }
}

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
/// [stack](macro@crate::Stack). The vehicle's part is [`Camera`].
///
/// ```text
///   IMAGE_START_CAPTURE ───┐
///   DO_DIGICAM_CONTROL ────┤              interval                       Shot::Taken ─────────┐
///   Camera::camera_order ──┼─▶ waiting ─── is over ──▶ Camera::take_image ├─▶ Shot::Started ──┼─▶ CAMERA_IMAGE_CAPTURED
///   take_image ────────────┤                                              └─▶ Shot::Failed ───┤   on every normal link
///   start_capture ─────────┘                                        image_captured, timeout ──┘
/// ```
///
/// The stack has the schedule, and counts and remembers the images. Every image has the next index, whether it was taken or has
/// failed, and is reported once on every normal link that carries MAVLink 2. A ground station that has missed a report asks for
/// it, as long as the image is remembered. Only a [reset of the image log](Self::reset_images) lets the index begin again.
///
/// A command to take images is answered at once, and TEMPORARILY_REJECTED while others are being taken. Its retransmission is
/// ACCEPTED and starts nothing: a single image with the same sequence number from the same sender within three seconds, or the
/// same command for several images while they are being taken.
///
/// CAMERA_CAPTURE_STATUS is sent on the same links after each change, on request, and at an interval by
/// MAV_CMD_SET_MESSAGE_INTERVAL or MAV_CMD_VIDEO_START_CAPTURE; CAMERA_SETTINGS after each change.
#[derive(Debug)]
pub struct CameraControl<I: ?Sized = [Image]> {
    /// The number of images since the start. It wraps.
    total: u32,
    /// The number of images before image 0.
    base: u32,
    /// When the next image of an interval is due.
    at: Instant,
    /// How many images of it are left; [`UNLIMITED`] for no end.
    left: u32,
    /// Its interval (ms).
    interval: u32,
    /// A single image waits for the camera.
    is_ordered: bool,
    /// An image is being taken, until this time.
    is_busy: bool,
    until: Instant,
    /// The last accepted command to start, and when it was received.
    started: Start,
    started_at: Instant,
    /// Since when video is being recorded, and the interval of CAMERA_CAPTURE_STATUS meanwhile (ms); 0 for none, and without video.
    is_recording: bool,
    recording_since: Instant,
    recording_interval: u32,
    /// The changes of state and settings, to report each of them once on each link. They wrap.
    changes: u8,
    settings: u8,
    counters: CameraCounters,
    /// The images that are remembered: the one with number `n` is at `n` modulo their number.
    images: I,
}

/// The state of the service on a link.
#[derive(Debug)]
pub struct CameraLink {
    /// The requested instances of each message of [`ROWS`], a bit for each, the first in the lowest.
    asked: [u8; ROWS.len()],
    /// The changes that it has reported.
    changes: u8,
    settings: u8,
    /// The numbers of images that were requested again, plus 1; 0 for none.
    requested: [u32; REQUESTED],
    /// The number of the next image to report.
    next_image: u32,
    /// The interval of CAMERA_CAPTURE_STATUS (ms); 0 for none. When it is due next.
    interval: u32,
    status_at: Instant,
}

impl CameraLink {
    /// All zero bits.
    const VACANT: Self = Self {
        asked: [0; ROWS.len()],
        changes: 0,
        settings: 0,
        requested: [0; REQUESTED],
        next_image: 0,
        interval: 0,
        status_at: Instant::ZERO,
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
    /// Takes one image in the next [`poll`](crate::Stack::poll), or when the camera is no longer busy. Returns false if one is
    /// already waiting for that; then nothing more is taken.
    pub fn take_image(&mut self) -> bool {
        let is_first = !core::mem::replace(&mut self.is_ordered, true);
        if !is_first {
            increment(&mut self.counters.ignored);
        }
        is_first
    }

    /// Takes images at this interval from the next [`poll`](crate::Stack::poll) on: `count` of them, or until
    /// [`stop_capture`](Self::stop_capture) if it is 0. It replaces the one before. [`Camera::MIN_INTERVAL`] does not apply.
    pub fn start_capture(&mut self, now: Instant, interval: Duration, count: u32) {
        self.begin(now, millis(interval), count);
    }

    /// Ends what was started. An image that is being taken is completed.
    pub fn stop_capture(&mut self) {
        if self.left > 0 || self.is_ordered {
            (self.left, self.is_ordered) = (0, false);
            self.changed();
        }
        // The same command starts again.
        self.started = Start::NONE;
    }

    /// Reports the end of an image after [`Shot::Started`]. Also reports an image that the camera took by itself, such as by a button:
    /// it is counted like all others.
    pub fn image_captured(&mut self, image: Image) {
        if !image.is_success {
            increment(&mut self.counters.failed);
        }
        self.is_busy = false;
        let total = self.total;
        if let Some(place) = self.image_mut(total) {
            *place = image;
        }
        self.total = total.wrapping_add(1);
        event!("camera: image {=u32}", self.image_count());
        self.changed();
    }

    /// Reports that mode, zoom or focus have changed without a command.
    pub fn settings_changed(&mut self) {
        self.settings = self.settings.wrapping_add(1);
    }

    /// Forgets all images: the next one has index 0. MAV_CMD_STORAGE_FORMAT does this if its sender wants it.
    pub fn reset_images(&mut self) {
        self.base = self.total;
        self.changed();
    }

    /// Returns the number of images since the [reset](Self::reset_images): the index of the next one.
    pub const fn image_count(&self) -> u32 {
        self.total.wrapping_sub(self.base)
    }

    /// Returns whether an image is being taken or waits for the camera, or images are taken at an interval.
    pub const fn is_capturing(&self) -> bool {
        self.is_busy || self.is_ordered || self.left > 0
    }

    /// Returns whether video is being recorded.
    pub const fn is_recording(&self) -> bool {
        self.is_recording
    }

    /// Returns the counters.
    pub const fn counters(&self) -> CameraCounters {
        self.counters
    }

    fn changed(&mut self) {
        self.changes = self.changes.wrapping_add(1);
    }

    /// Starts to take images at an interval (ms).
    fn begin(&mut self, now: Instant, interval: u32, count: u32) {
        self.left = if count == 0 { UNLIMITED } else { count };
        (self.at, self.interval) = (now, interval.max(1));
        self.changed();
    }

    /// Returns the place of an image by its number.
    fn image_mut(&mut self, number: u32) -> Option<&mut Image> {
        let place = number.checked_rem(self.capacity())?;
        self.images.get_mut(usize::try_from(place).ok()?)
    }

    /// Returns a remembered image by its number.
    fn image(&self, number: u32) -> Option<&Image> {
        let place = number.checked_rem(self.capacity())?;
        self.images.get(usize::try_from(place).ok()?)
    }

    fn capacity(&self) -> u32 {
        u32::try_from(self.images.len()).unwrap_or(u32::MAX)
    }

    /// Returns the number of remembered images: the last ones.
    fn remembered(&self) -> u32 {
        self.image_count().min(self.capacity())
    }

    /// Whether an entry of [`CameraLink::requested`] is pending.
    fn is_requested(&self, entry: u32) -> bool {
        entry != 0 && self.is_remembered(entry.wrapping_sub(1))
    }

    /// Whether the image with this number is remembered.
    fn is_remembered(&self, number: u32) -> bool {
        (1..=self.remembered()).contains(&self.total.wrapping_sub(number))
    }

    /// Returns the next image that a link reports by itself; of those that are no longer remembered, how many there were.
    fn unreported(&self, link: &CameraLink) -> (Option<u32>, u32) {
        let pending = self.total.wrapping_sub(link.next_image);
        let lost = pending.saturating_sub(self.remembered());
        let next = link.next_image.wrapping_add(lost);
        (Some(next).filter(|next| *next != self.total), lost)
    }

    /// Returns when CAMERA_CAPTURE_STATUS is due on a link.
    fn status_due(&self, now: Instant, link: &CameraLink) -> Instant {
        match self.status_interval(link) {
            _ if link.changes != self.changes => now,
            0 => Instant::NEVER,
            _ => link.status_at,
        }
    }

    /// Returns the interval of CAMERA_CAPTURE_STATUS on a link, the shorter of both (ms); 0 for none.
    fn status_interval(&self, link: &CameraLink) -> u32 {
        match self.recording_interval {
            0 => link.interval,
            recording if link.interval == 0 => recording,
            recording => recording.min(link.interval),
        }
    }

    /// Returns when the service has something to do.
    fn due(&self) -> Instant {
        match self.left {
            _ if self.is_busy => self.until,
            _ if self.is_ordered => Instant::ZERO,
            0 => Instant::NEVER,
            _ => self.at,
        }
    }

    /// Takes the next image into account whose time has come. Returns false if there is none.
    fn takes_next(&mut self, now: Instant) -> bool {
        if self.is_busy || self.due() > now {
            return false;
        }
        if !core::mem::take(&mut self.is_ordered) {
            if self.left != UNLIMITED {
                self.left = self.left.saturating_sub(1);
            }
            // A late poll does not shift the ones after it. What was missed is not made up.
            let interval = Duration::from_millis(u64::from(self.interval));
            let next = self.at + interval;
            self.at = if next > now { next } else { now + interval };
        }
        true
    }
}

/// Runs the schedule.
fn run<F: Firmware<Vehicle: Camera>>(control: &mut CameraControl, cx: &mut Cx<'_, F>) {
    if control.is_busy && cx.now >= control.until {
        increment(&mut control.counters.timed_out);
        control.image_captured(Image::failed(cx.now));
    }
    for _ in 0..ORDERS {
        let (vehicle, mut context) = cx.hook();
        let Some(order) = vehicle.camera_order(&mut context) else { break };
        match order {
            CameraOrder::TakeImage => {
                control.take_image();
            }
            CameraOrder::StartCapture { interval, count } => {
                control.start_capture(cx.now, interval.max(F::Vehicle::MIN_INTERVAL), count);
            }
            CameraOrder::StopCapture => control.stop_capture(),
            CameraOrder::StartVideo | CameraOrder::StopVideo => {
                let _ = commands::record(control, cx, 0, order == CameraOrder::StartVideo);
            }
        }
    }
    // A single image and one of an interval may be due.
    for _ in 0..2 {
        if !control.takes_next(cx.now) {
            return;
        }
        let index = control.image_count();
        let (vehicle, mut context) = cx.hook();
        match vehicle.take_image(&mut context, index) {
            Shot::Taken(image) => control.image_captured(image),
            Shot::Failed => control.image_captured(Image::failed(cx.now)),
            Shot::Started => {
                (control.is_busy, control.until) = (true, cx.now + F::Vehicle::IMAGE_TIMEOUT);
                control.changed();
            }
        }
    }
}

impl<F: Firmware<Vehicle: Camera>, const N: usize> Service<F> for CameraControl<[Image; N]> {
    const ABOUT: About = About::of(F::Vehicle::COMPONENT).in_turns(&[Turn::Camera]);
    const CHECK: () = {
        Component::check_service(F::COMPONENTS, F::Vehicle::COMPONENT);
        assert!(N > 0, "a camera remembers at least one image: `CameraControl<[Image; 16]>`");
        assert!(
            F::Vehicle::STORAGES <= 8 && F::Vehicle::VIDEO_STREAMS <= 8,
            "a camera has at most 8 storages and 8 streams"
        );
    };
    const NEW: Self = Self {
        total: 0,
        base: 0,
        at: Instant::ZERO,
        left: 0,
        interval: 0,
        is_ordered: false,
        is_busy: false,
        until: Instant::ZERO,
        started: Start::NONE,
        started_at: Instant::ZERO,
        is_recording: false,
        recording_since: Instant::ZERO,
        recording_interval: 0,
        changes: 0,
        settings: 0,
        counters: CameraCounters::ZERO,
        images: [Image::NONE; N],
    };
    type Link = CameraLink;
    const VACANT: CameraLink = CameraLink::VACANT;
    type Reply = CameraReply;

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut CameraLink>) {
        run(self, cx);
    }

    fn deadline(&self) -> Instant {
        let control: &CameraControl = self;
        control.due()
    }

    fn on_command(
        &mut self,
        cx: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut CameraLink,
        request: &Request,
    ) -> Option<Verdict> {
        commands::handle(self, cx, port, link, &request.command)
    }

    #[inline(always)]
    fn pending(&self, view: &View<'_>, port: &Port, link: &CameraLink, _: Turn) -> Option<(Instant, CameraReply)> {
        let control: &CameraControl = self;
        control.pending(view.now, port, link)
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut CameraLink, reply: CameraReply) -> bool {
        messages::send(self, cx, port, link, reply)
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        // The new peers need neither the answers nor the reports of images from before.
        if let StackEvent::Opened(_, link) = event {
            *link = CameraLink {
                next_image: self.total,
                changes: self.changes,
                settings: self.settings,
                ..CameraLink::VACANT
            };
        }
    }
}

/// Returns an interval in milliseconds, rounded down.
#[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; what is cast was bounded")]
const fn millis(interval: Duration) -> u32 {
    let millis = interval.as_millis();
    if millis > u32::MAX as u64 { u32::MAX } else { millis as u32 }
}

/// Converts an interval (ms) to seconds.
fn seconds(millis: u32) -> f32 {
    num::f32_from_u32(millis) / 1_000.0
}

/// Whether a link can send the camera's messages: MAVLink 1 has no room for their ids (S-10), and high-latency links carry none.
fn can_send(port: &Port) -> bool {
    port.outbox.takes(CameraInformation::ID)
}

/// Whether a hook has done what it was called for.
fn is_accepted(result: MavResult) -> bool {
    result == MavResult::ACCEPTED
}
