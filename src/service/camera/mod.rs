//! A camera: its data and state, images on command and at intervals, video, and a report of each image.
//!
//! Implements the camera's side of <https://mavlink.io/en/services/camera.html>, version 2: rules CAM-1 to CAM-9. It
//! serves the requests of MAVSDK's plugin (`plugins/camera/camera_impl.cpp`, `core/mavlink_request_message.cpp`),
//! QGroundControl (`src/Camera/VehicleCameraControl.cc`) and MAVProxy, in the new form and in the superseded one.
//!
//! Left out: tracking (MAV_CMD_CAMERA_TRACK_POINT and its kin), CAMERA_FOV_STATUS, CAMERA_THERMAL_RANGE,
//! MAV_CMD_SET_STORAGE_USAGE, MAV_CMD_DO_TRIGGER_CONTROL, and MESSAGE_INTERVAL for CAMERA_CAPTURE_STATUS.
//! MAV_CMD_DO_SET_CAM_TRIGG_DIST is the vehicle's: [`Camera`] has an example.

mod commands;
mod control;
mod image;
mod link;
mod messages;
mod vehicle;

pub use control::{CameraControl, CameraCounters};
pub use image::Image;
pub use vehicle::{Camera, CameraOrder, Shot};

use super::{About, Cx, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment};
use crate::link::Port;
use crate::time::Instant;
use crate::types::{Component, Firmware};
use link::{CameraLink, CameraReply};

/// The number of orders of the vehicle that a poll takes.
const ORDERS: u8 = 4;

/// The stream id that stands for all video streams.
const ALL_STREAMS: u8 = 0;

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
    const NEW: Self = Self::NEW;
    type Link = CameraLink;
    const VACANT: CameraLink = CameraLink::VACANT;
    type Reply = CameraReply;

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut CameraLink>) {
        run_schedule(self, cx);
    }

    fn deadline(&self) -> Instant {
        let control: &CameraControl = self;
        control.poll_deadline()
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
        messages::can_send(port).then(|| control.next_message(view.now, link))
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
                reported_image: self.images.newest,
                changes: self.changes,
                settings_changes: self.settings_changes,
                ..CameraLink::VACANT
            };
        }
    }
}

/// Takes the vehicle's orders, and the images that are due.
fn run_schedule<F: Firmware<Vehicle: Camera>>(control: &mut CameraControl, cx: &mut Cx<'_, F>) {
    if control.is_busy && cx.now >= control.busy_until {
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
                let starts = order == CameraOrder::StartVideo;
                let recording = if starts { commands::Recording::Start } else { commands::Recording::Stop };
                // The result is not reported: the vehicle's hook has returned it.
                let _ = commands::record_video(control, cx, ALL_STREAMS, recording);
            }
        }
    }
    // A single image and one at an interval may be due.
    for _ in 0..2 {
        if !control.take_due_image(cx.now) {
            return;
        }
        let index = control.image_count();
        let (vehicle, mut context) = cx.hook();
        match vehicle.take_image(&mut context, index) {
            Shot::Taken(image) => control.image_captured(image),
            Shot::Failed => control.image_captured(Image::failed(cx.now)),
            Shot::Started => {
                control.is_busy = true;
                control.busy_until = cx.now + F::Vehicle::IMAGE_TIMEOUT;
                control.changes += 1;
            }
        }
    }
}
