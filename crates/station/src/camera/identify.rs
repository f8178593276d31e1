//! Finding a camera, and what it says of itself.

use super::first_camera;
use crate::streams::Request;
use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::{
    CameraCaptureStatus, CameraInformation, CameraSettings, StorageInformation, VideoStreamInformation,
};
use mavstack::{Address, Duration, Instant, Message};

/// How long a component with a camera's heartbeats is looked for.
const HEARTBEATS: Duration = Duration::from_secs(3);

/// A camera of the vehicle. What it refused to tell is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct Identified {
    /// Its address.
    pub camera: Address,
    /// What it is.
    pub information: CameraInformation,
    /// Its mode, its zoom and its focus.
    pub settings: Option<CameraSettings>,
    /// Its first storage.
    pub storage: Option<StorageInformation>,
    /// What it is doing.
    pub status: Option<CameraCaptureStatus>,
    /// Its first video stream.
    pub stream: Option<VideoStreamInformation>,
}

/// Finds a camera and requests what it says of itself, one message after the other. Ends with it.
///
/// Without a component that is a camera, the autopilot is asked after 3 s.
#[derive(Debug, Default)]
pub struct Identify {
    camera: Option<Address>,
    begin: Option<Instant>,
    information: Wanted<CameraInformation>,
    /// Requests for CAMERA_INFORMATION that were not answered.
    tries: u32,
    settings: Wanted<CameraSettings>,
    storage: Wanted<StorageInformation>,
    status: Wanted<CameraCaptureStatus>,
    stream: Wanted<VideoStreamInformation>,
}

/// A message that is requested of the camera.
#[derive(Debug)]
struct Wanted<M> {
    request: Option<Request<M>>,
    result: Option<Result<M, Failure>>,
}

impl<M> Default for Wanted<M> {
    fn default() -> Self {
        Self { request: None, result: None }
    }
}

impl<M: Message> Wanted<M> {
    /// Whether it was answered, or given up.
    fn is_done(&mut self, io: &mut Io<'_>, camera: Address) -> bool {
        if self.result.is_none() {
            self.result = self.request.get_or_insert_with(|| Request::new().of(camera)).poll(io);
        }
        self.result.is_some()
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if let Some(request) = self.request.as_mut().filter(|_| self.result.is_none()) {
            request.receive(io, frame);
        }
    }

    fn take(&mut self) -> Option<M> {
        self.result.take()?.ok()
    }
}

impl Identify {
    /// Looks for a camera of the vehicle.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks this component.
    pub fn at(camera: Address) -> Self {
        Self { camera: Some(camera), ..Self::default() }
    }

    fn find(&mut self, io: &Io<'_>) -> Option<Address> {
        let begin = *self.begin.get_or_insert(io.now());
        if self.camera.is_none() {
            let nobody = io.now() - begin >= HEARTBEATS;
            self.camera = first_camera(io).or(nobody.then(|| io.target()));
        }
        self.camera
    }

    /// Whether to request CAMERA_INFORMATION again.
    fn tries_again(&mut self, client: Client) -> bool {
        let limit = match client {
            Client::QGroundControl => 10,
            Client::Mavsdk => 1,
            Client::MavProxy | Client::Pymavlink => 5,
        };
        self.tries += 1;
        self.tries < limit
    }
}

impl Dialogue for Identify {
    type Output = Identified;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Identified, Failure>> {
        let camera = self.find(io)?;
        if !self.information.is_done(io, camera) {
            return None;
        }
        if matches!(self.information.result, Some(Err(Failure::Timeout { .. }))) && self.tries_again(io.client()) {
            let request = Request::new().of(camera);
            // QGroundControl uses the old command every second time.
            let is_old = io.client() == Client::QGroundControl && self.tries % 2 == 1;
            let request = if is_old { request.by_old_command() } else { request };
            self.information = Wanted { request: Some(request), result: None };
            return None;
        }
        if let Some(Err(_)) = &self.information.result {
            return self.information.result.take()?.err().map(Err);
        }
        let is_done = self.settings.is_done(io, camera)
            && self.storage.is_done(io, camera)
            && self.status.is_done(io, camera)
            && self.stream.is_done(io, camera);
        is_done.then_some(())?;
        Some(Ok(Identified {
            camera,
            information: self.information.take()?,
            settings: self.settings.take(),
            storage: self.storage.take(),
            status: self.status.take(),
            stream: self.stream.take(),
        }))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.information.receive(io, frame);
        self.settings.receive(io, frame);
        self.storage.receive(io, frame);
        self.status.receive(io, frame);
        self.stream.receive(io, frame);
    }
}
