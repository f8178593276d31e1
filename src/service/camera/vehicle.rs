//! The camera service's interface to the vehicle.

use super::image::Image;
use crate::dialect::{
    CameraCapFlags, CameraInformation, CameraSettings, CameraSource, CameraZoomType, MavResult, SetFocusType,
    StorageInformation, VideoStreamInformation,
};
use crate::message::{ComponentId, Text};
use crate::time::Duration;
use crate::types::Context;

/// The result of [`Camera::take_image`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Shot {
    /// The image was taken.
    Taken(Image),
    /// The exposure has started. [`CameraControl::image_captured`](super::CameraControl::image_captured) reports its
    /// end, within [`Camera::IMAGE_TIMEOUT`].
    Started,
    /// The camera could not take the image. It is reported as one that has failed.
    Failed,
}

/// The vehicle's order to its camera: see [`Camera::camera_order`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CameraOrder {
    /// Take one image, as [`CameraControl::take_image`](super::CameraControl::take_image) does.
    TakeImage,
    /// Take images at an interval, as [`CameraControl::start_capture`](super::CameraControl::start_capture) does.
    StartCapture {
        /// The time from image to image, clamped to at least [`Camera::MIN_INTERVAL`].
        interval: Duration,
        /// The number of images; 0 for no end.
        count: u32,
    },
    /// End that, as [`CameraControl::stop_capture`](super::CameraControl::stop_capture) does.
    StopCapture,
    /// Start to record video: calls [`Camera::record_video`] for all streams, if none is recorded.
    StartVideo,
    /// End the recording of all streams.
    StopVideo,
}

/// A camera, for a vehicle that has [`CameraControl`](super::CameraControl) in the struct of its
/// [stack](macro@crate::Stack): it shows which part is the stack's.
///
/// Only [`FLAGS`](Self::FLAGS), [`camera_information`](Self::camera_information) and [`take_image`](Self::take_image)
/// are required. A command that the flags exclude is passed to [`Commands::command`](crate::Commands::command).
///
/// This vehicle takes images by itself while it flies a survey. MAV_CMD_DO_SET_CAM_TRIGG_DIST is addressed to the
/// autopilot, which knows how far it has flown:
///
/// ```
/// use mavstack::camera::{Image, Shot};
/// use mavstack::dialect::{CameraCapFlags, CameraInformation, MavCmd, MavResult};
/// use mavstack::prelude::*;
///
/// /// Positions are in metres, north and east of home.
/// #[derive(Default)]
/// struct Surveyor { position: [f32; 2], last_image: [f32; 2], distance: f32 }
///
/// #[derive(Stack)]
/// #[stack(vehicle: Surveyor, links: 2)]
/// struct Mavlink {
///     camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 32]>,
/// }
///
/// impl Camera for Surveyor {
///     const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;
///
///     fn camera_information(&self, information: &mut CameraInformation) {
///         information.vendor_name = *Text::new("Acme").wire();
///         information.model_name = *Text::new("Mapper").wire();
///         information.resolution_h = 4_000;
///         information.resolution_v = 3_000;
///     }
///
///     fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
///         // … pulse the trigger line
///         Shot::Taken(Image { latitude: 470_000_000, longitude: 80_000_000, ..Image::at(cx.now()) })
///     }
/// }
///
/// impl Commands for Surveyor {
///     fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
///         match command.id {
///             MavCmd::DO_SET_CAM_TRIGG_DIST if command.params[0] >= 0.0 => {
///                 self.distance = command.params[0];
///                 MavResult::ACCEPTED.into()
///             }
///             _ => MavResult::UNSUPPORTED.into(),
///         }
///     }
/// }
///
/// /// Called in every pass of the flight loop. The next `poll` takes the image.
/// fn survey(rover: &mut Surveyor, stack: &mut StackOf<Mavlink>) {
///     let [north, east] = [0, 1].map(|axis| rover.position[axis] - rover.last_image[axis]);
///     if rover.distance > 0.0 && north * north + east * east >= rover.distance * rover.distance {
///         rover.last_image = rover.position;
///         // False if an image is already waiting for the camera.
///         let _ = stack.camera.take_image();
///     }
/// }
/// # impl Vehicle for Surveyor { fn state(&self) -> Option<VehicleState> { None } }
/// ```
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `Camera`",
    note = "`CameraControl` in the struct of a stack needs `impl Camera for {Self}`: write it, or leave the field out"
)]
pub trait Camera {
    /// The component that the camera is, such as 100 (MAV_COMP_ID_CAMERA). `None` is a camera of the autopilot, with
    /// the camera id 1: few ground stations look for one there.
    const COMPONENT: Option<ComponentId> = None;

    /// The capabilities, as CAMERA_INFORMATION has them. Commands for others are not handled, and their code is left
    /// out.
    const FLAGS: CameraCapFlags;

    /// The number of storages, such as memory cards: 0 to 8. They have the ids 1, 2 and so on.
    const STORAGES: u8 = 0;

    /// The number of video streams: 0 to 8. They have the ids 1, 2 and so on.
    const VIDEO_STREAMS: u8 = 0;

    /// The shortest interval of images. A shorter one in a command or an order is clamped.
    const MIN_INTERVAL: Duration = Duration::from_millis(500);

    /// How long an image may take after [`Shot::Started`]. Then it has failed.
    const IMAGE_TIMEOUT: Duration = Duration::from_secs(10);

    /// Fills in the camera's description. It begins as [`CameraInformation::UNKNOWN`]; the stack sets the time, the
    /// flags and the camera id.
    fn camera_information(&self, information: &mut CameraInformation);

    /// Fills in mode, zoom and focus. They begin as the image mode and unknown; the stack sets the time and the camera
    /// id.
    fn camera_settings(&self, settings: &mut CameraSettings) {
        let _ = settings;
    }

    /// Fills in the state of storage `id`, 1 to [`STORAGES`](Self::STORAGES). The stack sets the time, the id and the
    /// number of storages.
    fn storage_information(&self, id: u8, information: &mut StorageInformation) {
        let _ = (id, information);
    }

    /// Fills in the description and the state of video stream `id`, 1 to [`VIDEO_STREAMS`](Self::VIDEO_STREAMS). The
    /// stack sets the id, the number of streams and the camera id. VIDEO_STREAM_STATUS consists of the same fields.
    fn video_stream_information(&self, id: u8, information: &mut VideoStreamInformation) {
        let _ = (id, information);
    }

    /// Takes an image, or starts to. It will have this index, which counts from 0. Called in
    /// [`poll`](crate::Stack::poll), never while another image is being taken.
    fn take_image(&mut self, cx: &mut Context<'_>, index: u32) -> Shot;

    /// Returns the vehicle's next order to its camera, such as from a mission item. Each order is returned once. Called
    /// in every [`poll`](crate::Stack::poll), up to four times, until it returns `None`. The flight loop calls the
    /// methods of [`CameraControl`](super::CameraControl) instead.
    fn camera_order(&mut self, cx: &mut Context<'_>) -> Option<CameraOrder> {
        let _ = cx;
        None
    }

    /// Whether images may be taken now: ACCEPTED, or the result with which a command to start is refused, such as
    /// TEMPORARILY_REJECTED without a card.
    fn may_capture(&mut self, cx: &mut Context<'_>) -> MavResult {
        let _ = cx;
        MavResult::ACCEPTED
    }

    /// Writes the address of image `index` into `url`, such as `mftp:///DCIM/7.jpg`. Called when the image is reported.
    fn image_url(&self, index: u32, url: &mut Text<205>) {
        let _ = (index, url);
    }

    /// Starts or stops the recording of video `stream`; 0 is every stream. Called only if that changes something.
    fn record_video(&mut self, cx: &mut Context<'_>, stream: u8, on: bool) -> MavResult {
        let _ = (cx, stream, on);
        MavResult::UNSUPPORTED
    }

    /// Starts or stops the transmission of video `stream`, 1 to [`VIDEO_STREAMS`](Self::VIDEO_STREAMS), or 0 for every
    /// one. By default it is ACCEPTED, as for a server to which clients connect.
    fn stream_video(&mut self, cx: &mut Context<'_>, stream: u8, on: bool) -> MavResult {
        let _ = (cx, stream, on);
        MavResult::ACCEPTED
    }

    /// Enters a mode: IMAGE, VIDEO or IMAGE_SURVEY. With [`HAS_MODES`](CameraCapFlags::HAS_MODES).
    fn set_camera_mode(&mut self, cx: &mut Context<'_>, mode: crate::dialect::CameraMode) -> MavResult {
        let _ = (cx, mode);
        MavResult::UNSUPPORTED
    }

    /// Zooms. `value` is finite, and 0 to 100 for RANGE. With [`HAS_BASIC_ZOOM`](CameraCapFlags::HAS_BASIC_ZOOM).
    fn set_zoom(&mut self, cx: &mut Context<'_>, zoom: CameraZoomType, value: f32) -> MavResult {
        let _ = (cx, zoom, value);
        MavResult::UNSUPPORTED
    }

    /// Focuses. `value` is finite, 0 to 100 for RANGE, and 0 for AUTO, AUTO_SINGLE and AUTO_CONTINUOUS. With
    /// [`HAS_BASIC_FOCUS`](CameraCapFlags::HAS_BASIC_FOCUS).
    fn set_focus(&mut self, cx: &mut Context<'_>, focus: SetFocusType, value: f32) -> MavResult {
        let _ = (cx, focus, value);
        MavResult::UNSUPPORTED
    }

    /// Selects the sources of image and video: MAV_CMD_SET_CAMERA_SOURCE. By default it is UNSUPPORTED.
    fn set_source(&mut self, cx: &mut Context<'_>, primary: CameraSource, secondary: CameraSource) -> MavResult {
        let _ = (cx, primary, secondary);
        MavResult::UNSUPPORTED
    }

    /// Resets all settings to their defaults. By default it is UNSUPPORTED.
    fn reset_camera_settings(&mut self, cx: &mut Context<'_>) -> MavResult {
        let _ = cx;
        MavResult::UNSUPPORTED
    }

    /// Erases storage `id`, 1 to [`STORAGES`](Self::STORAGES). By default it is UNSUPPORTED.
    fn format_storage(&mut self, cx: &mut Context<'_>, id: u8) -> MavResult {
        let _ = (cx, id);
        MavResult::UNSUPPORTED
    }
}

/// Returns the camera id in messages and answers (CAM-9): 1 for a camera of the autopilot, otherwise 0.
pub(super) const fn device_id<V: Camera>() -> u8 {
    if V::COMPONENT.is_none() { 1 } else { 0 }
}
