//! A vehicle with a camera that records what the stack has it do, and a world of it.

use crate::support::*;
use mavstack::camera::{CameraControl, CameraOrder, Image, Shot};
use mavstack::config::{LinkClass, StreamProfile, TxVersion};
use mavstack::dialect::*;
use mavstack::{
    Address, Camera, Command, Commands, Context, Duration, Instant, LinkConfig, LinkId, Message, Outcome, Text,
    Vehicle, VehicleState,
};
use std::collections::VecDeque;

#[derive(mavstack::Stack)]
#[stack(vehicle: Shooter, links: 4)]
pub struct Equipped {
    pub camera: mavstack::camera::CameraControl<[mavstack::camera::Image; 8]>,
}

/// A camera that has everything.
pub const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE
    .with(CameraCapFlags::CAPTURE_VIDEO)
    .with(CameraCapFlags::HAS_MODES)
    .with(CameraCapFlags::HAS_BASIC_ZOOM)
    .with(CameraCapFlags::HAS_BASIC_FOCUS)
    .with(CameraCapFlags::HAS_VIDEO_STREAM);

/// A call of a hook.
#[derive(Clone, Debug, PartialEq)]
pub enum Hook {
    Record(u8, bool),
    Stream(u8, bool),
    Mode(CameraMode),
    Zoom(CameraZoomType, f32),
    Focus(SetFocusType, f32),
    Source(CameraSource, CameraSource),
    Reset,
    Format(u8),
    /// A command that the camera does not handle.
    Command(MavCmd),
}

/// How the camera takes an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shutter {
    /// At once.
    Instant,
    /// The test reports the end.
    Slow,
    Broken,
}

pub struct Shooter {
    pub shutter: Shutter,
    pub mode: CameraMode,
    /// The answer to every hook that may refuse.
    pub result: MavResult,
    pub may_capture: MavResult,
    pub orders: VecDeque<CameraOrder>,
    /// The time and index of each exposure.
    pub exposures: Vec<(Instant, u32)>,
    pub calls: Vec<Hook>,
}

impl Default for Shooter {
    fn default() -> Self {
        Self {
            shutter: Shutter::Instant,
            mode: CameraMode::IMAGE,
            result: MavResult::ACCEPTED,
            may_capture: MavResult::ACCEPTED,
            orders: VecDeque::new(),
            exposures: Vec::new(),
            calls: Vec::new(),
        }
    }
}

impl Shooter {
    fn called(&mut self, call: Hook) -> MavResult {
        self.calls.push(call);
        self.result
    }
}

impl Vehicle for Shooter {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Shooter {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        self.calls.push(Hook::Command(command.id));
        MavResult::UNSUPPORTED.into()
    }
}

/// The image with this index, as the camera reports it.
pub fn image(now: Instant, index: u32) -> Image {
    Image {
        latitude: 470_000_000 + index as i32,
        longitude: -80_000_000,
        altitude: 500_000,
        relative_altitude: 50_000,
        attitude: [1.0, 0.0, 0.0, 0.0],
        time_utc: 1_700_000_000_000_000,
        ..Image::at(now)
    }
}

impl Camera for Shooter {
    const FLAGS: CameraCapFlags = FLAGS;
    const STORAGES: u8 = 2;
    const VIDEO_STREAMS: u8 = 3;
    const IMAGE_TIMEOUT: Duration = secs(2);

    fn camera_information(&self, information: &mut CameraInformation) {
        information.vendor_name = *Text::new("Acme").wire();
        information.resolution_h = 4_000;
        information.cam_definition_uri = Text::new("mftp:///camera.xml");
        // The stack knows better.
        information.flags = CameraCapFlags::EMPTY;
        information.camera_device_id = 9;
    }

    fn camera_settings(&self, settings: &mut CameraSettings) {
        settings.mode_id = self.mode;
        settings.zoomLevel = 30.0;
    }

    fn storage_information(&self, id: u8, information: &mut StorageInformation) {
        information.status = StorageStatus::READY;
        information.available_capacity = 100.0 * f32::from(id);
    }

    fn video_stream_information(&self, id: u8, information: &mut VideoStreamInformation) {
        information.framerate = 25.0;
        information.resolution_h = 640 * u16::from(id);
        information.uri = Text::new("rtsp://camera/1");
    }

    fn take_image(&mut self, cx: &mut Context<'_>, index: u32) -> Shot {
        self.exposures.push((cx.now(), index));
        match self.shutter {
            Shutter::Instant => Shot::Taken(image(cx.now(), index)),
            Shutter::Slow => Shot::Started,
            Shutter::Broken => Shot::Failed,
        }
    }

    fn camera_order(&mut self, _: &mut Context<'_>) -> Option<CameraOrder> {
        self.orders.pop_front()
    }

    fn may_capture(&mut self, _: &mut Context<'_>) -> MavResult {
        self.may_capture
    }

    fn image_url(&self, index: u32, url: &mut Text<205>) {
        url.push_str("mftp:///DCIM/");
        url.push_number(index);
    }

    fn record_video(&mut self, _: &mut Context<'_>, stream: u8, on: bool) -> MavResult {
        self.called(Hook::Record(stream, on))
    }

    fn stream_video(&mut self, _: &mut Context<'_>, stream: u8, on: bool) -> MavResult {
        self.called(Hook::Stream(stream, on))
    }

    fn set_camera_mode(&mut self, _: &mut Context<'_>, mode: CameraMode) -> MavResult {
        let result = self.called(Hook::Mode(mode));
        if result == MavResult::ACCEPTED {
            self.mode = mode;
        }
        result
    }

    fn set_zoom(&mut self, _: &mut Context<'_>, zoom: CameraZoomType, value: f32) -> MavResult {
        self.called(Hook::Zoom(zoom, value))
    }

    fn set_focus(&mut self, _: &mut Context<'_>, focus: SetFocusType, value: f32) -> MavResult {
        self.called(Hook::Focus(focus, value))
    }

    fn set_source(&mut self, _: &mut Context<'_>, primary: CameraSource, secondary: CameraSource) -> MavResult {
        self.called(Hook::Source(primary, secondary))
    }

    fn reset_camera_settings(&mut self, _: &mut Context<'_>) -> MavResult {
        self.called(Hook::Reset)
    }

    fn format_storage(&mut self, _: &mut Context<'_>, id: u8) -> MavResult {
        self.called(Hook::Format(id))
    }
}

pub type Site = World<4, Equipped>;

/// The third link carries MAVLink 1 only.
pub const OLD: usize = 2;
pub const SATELLITE: usize = 3;

/// Two normal links, one that carries MAVLink 1, and a high-latency link.
pub fn site() -> Site {
    let uart = LinkConfig::uart(921_600).with_streams(StreamProfile::Off);
    let links = [uart, uart, uart.with_version(TxVersion::V1), uart.with_class(LinkClass::HighLatency)];
    let mut site = Site::of(Setup { links, ..Setup::new() });
    site.run_for(millis(5));
    site
}

/// Receives `message` now.
pub fn send<M: Message>(site: &mut Site, link: usize, from: Address, message: &M) {
    let frame = site.gcs[link].frame_from(from, message);
    assert_eq!(site.stack.receive(site.clock.now(), LinkId(link as u8), &frame, &mut site.vehicle), frame.len());
}

/// Sends a command, and returns its answer. The vehicle is polled at least once.
pub fn command_from(site: &mut Site, link: usize, from: Address, command: MavCmd, params: &[f32]) -> CommandAck {
    let mut all = [0.0; 7];
    all[..params.len()].copy_from_slice(params);
    let message = site.gcs[link].long(command, all);
    send(site, link, from, &message);
    let before = site.gcs[link].count_of::<CommandAck>();
    assert!(site.run_until(millis(20), |site| site.gcs[link].count_of::<CommandAck>() > before), "no answer");
    let acks = site.gcs[link].all::<CommandAck>();
    let (_, ack) = acks.last().expect("an answer");
    // MAVLink 1 does not carry the target.
    let to = if link == OLD { 0 } else { from.system.wire() };
    assert_eq!((ack.command, ack.target_system), (command, to), "the answer");
    *ack
}

pub fn command(site: &mut Site, command: MavCmd, params: &[f32]) -> MavResult {
    command_from(site, 0, STATION, command, params).result
}

pub fn request<M: Message>(site: &mut Site, index: f32) -> MavResult {
    command(site, MavCmd::REQUEST_MESSAGE, &[M::ID as f32, index])
}

/// The indices of the images that a link has reported.
pub fn reported(site: &Site, link: usize) -> Vec<i32> {
    site.gcs[link].all::<CameraImageCaptured>().iter().map(|(_, image)| image.image_index).collect()
}

/// The last state that the first link has reported.
pub fn status(site: &Site) -> CameraCaptureStatus {
    site.gcs[0].all::<CameraCaptureStatus>().last().expect("a state").1
}

pub fn control(site: &mut Site) -> &mut CameraControl {
    &mut site.stack.camera
}
