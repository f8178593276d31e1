//! Taking images.

use super::first_camera;
use crate::command::Send;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{CameraCaptureStatus, CameraImageCaptured, MavCmd};
use mavstack::{Address, Duration, Instant, Message};
use std::collections::BTreeMap;

/// How long the report of an image is awaited.
const REPORT: Duration = Duration::from_secs(3);
/// How often MAVSDK requests images that were not reported, and how often each of them.
const AGAIN: Duration = Duration::from_millis(500);
const REQUESTS: u32 = 3;

/// Takes images. Ends with their reports, CAMERA_IMAGE_CAPTURED, in their order: those that have arrived 3 s after the last one was due.
///
/// MAVSDK counts the images by CAMERA_CAPTURE_STATUS and requests the reports that it misses; the others do not.
#[derive(Debug)]
pub struct Capture {
    interval: Duration,
    count: u32,
    camera: Option<Address>,
    command: Option<Send>,
    /// When the reports are no longer awaited.
    end: Option<Instant>,
    images: BTreeMap<i32, CameraImageCaptured>,
    /// The number of images of the camera, as last reported.
    total: Option<i32>,
    /// When the next reports are requested.
    due: Instant,
    requests: u32,
}

impl Capture {
    /// Takes one image.
    pub fn one() -> Self {
        Self::at_interval(Duration::ZERO, 1)
    }

    /// Takes `count` images, at least one: the command's 0 would let the camera go on for ever.
    pub fn at_interval(interval: Duration, count: u32) -> Self {
        Self {
            interval,
            count: count.max(1),
            camera: None,
            command: None,
            end: None,
            images: BTreeMap::new(),
            total: None,
            due: Instant::ZERO,
            requests: 0,
        }
    }

    /// Takes them with this component; by default with the first camera that was heard, or with the autopilot.
    #[must_use]
    pub fn with(mut self, camera: Address) -> Self {
        self.camera = Some(camera);
        self
    }

    fn start(&mut self, io: &Io<'_>) -> Send {
        let camera = *self.camera.get_or_insert_with(|| first_camera(io).unwrap_or(io.target()));
        let (seconds, count) = (self.interval.as_millis() as f32 / 1_000.0, self.count as f32);
        // A repeated sequence number is a duplicate to the camera, so it must differ from that of the last capture. QGroundControl
        // sends none.
        let sequence = if io.client() == Client::Mavsdk { (io.now().as_millis() % 10_000) as f32 + 1.0 } else { 0.0 };
        Send::new(MavCmd::IMAGE_START_CAPTURE, &[0.0, seconds, count, sequence]).to(camera)
    }

    /// Requests the number of images, then the reports that are missing, as MAVSDK does.
    fn request_missing(&mut self, io: &mut Io<'_>, camera: Address) {
        if io.client() != Client::Mavsdk || io.now() < self.due || self.requests == REQUESTS * 2 {
            return;
        }
        self.due = io.now() + AGAIN;
        self.requests += 1;
        let mut request = |params: &[f32]| {
            let mut send = Send::new(MavCmd::REQUEST_MESSAGE, params).to(camera);
            // Its answer does not matter: the message does.
            let _ = send.poll(io);
        };
        let Some(total) = self.total else { return request(&[CameraCaptureStatus::ID as f32]) };
        let first = total.saturating_sub_unsigned(self.count);
        for index in (first..total).filter(|index| !self.images.contains_key(index)) {
            request(&[CameraImageCaptured::ID as f32, index as f32]);
        }
    }
}

impl Dialogue for Capture {
    type Output = Vec<CameraImageCaptured>;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Self::Output, Failure>> {
        let Some(end) = self.end else {
            if self.command.is_none() {
                self.command = Some(self.start(io));
            }
            if let Err(failure) = self.command.as_mut()?.poll(io)? {
                return Some(Err(failure));
            }
            let last = io.now() + self.interval * self.count.saturating_sub(1);
            self.end = Some(last + REPORT);
            self.due = last + AGAIN;
            return None;
        };
        if self.images.len() < self.count as usize && io.now() < end {
            let camera = self.camera?;
            self.request_missing(io, camera);
            return None;
        }
        Some(Ok(std::mem::take(&mut self.images).into_values().collect()))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(command) = &mut self.command {
            command.receive(io, frame);
        }
        if Some(frame.source()) != self.camera || self.command.is_none() {
            return;
        }
        if let Some(image) = frame.decode::<CameraImageCaptured>() {
            self.images.insert(image.image_index, image);
        } else if let Some(status) = frame.decode::<CameraCaptureStatus>() {
            self.total = Some(status.image_count);
        }
    }
}
