//! Dialogues with a vehicle, and what drives them.

use crate::modes::{self, Mode};
use crate::parameters::{self, Parameter, Value};
use crate::plans;
use crate::station::Sender;
use crate::streams::{self, Interval};
use crate::{Client, Failure, Received, Seen, Station};
use mavstack::dialect::{MavCmd, MavStandardMode, MessageInterval};
use mavstack::{Address, Duration, Instant, Item, Message, PlanType};

/// How long [`Drive::run`] waits for the text with the reason of a refusal: the answer is sent first.
const TEXT_WITHIN: Duration = Duration::from_millis(500);

/// A dialogue with a vehicle: a state machine that sends, times out and retries.
///
/// [`poll`](Self::poll) is called first, then in turn with [`receive`](Self::receive) until it returns a result.
pub trait Dialogue {
    /// What it ends with.
    type Output;

    /// Sends what is due. Returns the result once the dialogue has ended; it is not called again then.
    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Self::Output, Failure>>;

    /// Takes a received frame, of any sender.
    fn receive(&mut self, io: &mut Io<'_>, frame: &Received);
}

impl<D: Dialogue + ?Sized> Dialogue for &mut D {
    type Output = D::Output;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Self::Output, Failure>> {
        (**self).poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        (**self).receive(io, frame);
    }
}

/// The station as a dialogue sees it.
#[derive(Debug)]
pub struct Io<'a> {
    now: Instant,
    sender: &'a mut Sender,
    seen: &'a Seen,
}

impl<'a> Io<'a> {
    pub(crate) fn new(now: Instant, sender: &'a mut Sender, seen: &'a Seen) -> Self {
        Self { now, sender, seen }
    }

    /// Returns the time.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Returns the client that the station behaves as.
    pub fn client(&self) -> Client {
        self.sender.client
    }

    /// Returns the station's own address.
    pub fn address(&self) -> Address {
        self.sender.address
    }

    /// Returns the vehicle that the station speaks with; component 1 of system 1 as long as none was heard.
    pub fn target(&self) -> Address {
        self.sender.target.unwrap_or(Address::new(1, 1))
    }

    /// Returns what was received.
    pub fn seen(&self) -> &'a Seen {
        self.seen
    }

    /// Sends a message.
    pub fn send<M: Message>(&mut self, message: &M) {
        self.sender.send(self.now, message);
    }

    /// Sets the key with which frames are signed from now on, see [`Station::set_signing`].
    pub fn set_signing(&mut self, key: Option<([u8; 32], u64)>) {
        self.sender.set_signing(self.now, key);
    }

    /// Whether a message with these target fields is for this station: addressed to it, or to all.
    pub fn is_for_us(&self, target_system: u8, target_component: u8) -> bool {
        let Address { system, component } = self.sender.address;
        [0, system.wire()].contains(&target_system) && [0, component.wire()].contains(&target_component)
    }
}

/// Something that connects a [`Station`] with a vehicle: the kit's rig, or a program with a serial port.
///
/// ```no_run
/// use std::io::{ErrorKind, Read, Write};
/// use std::net::TcpStream;
/// use mavstack::Instant;
/// use mavstack_station::{Client, Drive, Failure, GroundStation, Station};
///
/// struct Tcp {
///     /// It does not block.
///     stream: TcpStream,
///     station: Station,
///     started: std::time::Instant,
/// }
///
/// impl Drive for Tcp {
///     fn station(&mut self) -> &mut Station {
///         &mut self.station
///     }
///
///     fn step(&mut self) -> Result<Instant, Failure> {
///         std::thread::sleep(std::time::Duration::from_millis(2));
///         let now = Instant::ZERO + self.started.elapsed().into();
///         let failed = |error: std::io::Error| Failure::Transport(error.to_string());
///         self.stream.write_all(&self.station.take_output()).map_err(failed)?;
///         let mut bytes = [0; 1024];
///         match self.stream.read(&mut bytes) {
///             Ok(len) => self.station.receive(now, &bytes[..len]),
///             Err(error) if error.kind() == ErrorKind::WouldBlock => {}
///             Err(error) => return Err(failed(error)),
///         }
///         self.station.poll(now);
///         Ok(now)
///     }
/// }
///
/// let stream = TcpStream::connect("127.0.0.1:5760")?;
/// stream.set_nonblocking(true)?;
/// let station = Station::new(Client::Mavsdk);
/// let mut tcp = Tcp { stream, station, started: std::time::Instant::now() };
/// println!("{} parameters", tcp.parameters()?.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Drive {
    /// Returns the station.
    fn station(&mut self) -> &mut Station;

    /// Lets a little time pass: sends [`take_output`](Station::take_output), hands what arrived to
    /// [`receive`](Station::receive), and calls [`poll`](Station::poll). Returns the new time.
    ///
    /// # Errors
    ///
    /// The transport failed.
    fn step(&mut self) -> Result<Instant, Failure>;

    /// Runs a dialogue to its end. A refusal waits up to 500 ms for the vehicle's text with the reason.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    fn run<D: Dialogue>(&mut self, mut dialogue: D) -> Result<D::Output, Failure>
    where
        Self: Sized,
    {
        let station = self.station();
        station.forget_inbox();
        let (mark, mut now) = (station.seen().text_mark(), station.now());
        loop {
            match self.station().advance(now, &mut dialogue) {
                Some(Ok(output)) => return Ok(output),
                Some(Err(failure)) => return Err(explained(self, failure, mark)),
                None => now = self.step()?,
            }
        }
    }
}

impl<T: Drive> Drive for &mut T {
    fn station(&mut self) -> &mut Station {
        (**self).station()
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        (**self).step()
    }
}

/// Adds the vehicle's text to a refusal, which may come after the answer.
fn explained<T: Drive>(drive: &mut T, mut failure: Failure, mark: usize) -> Failure {
    let Some(text @ None) = failure.text_mut() else { return failure };
    let end = drive.station().now() + TEXT_WITHIN;
    loop {
        *text = drive.station().seen().reason_since(mark);
        if text.is_some() || !matches!(drive.step(), Ok(now) if now < end) {
            return failure;
        }
    }
}

/// What a ground station does, in the field's words: one method for each [`Dialogue`], on everything that can [`Drive`] it.
pub trait GroundStation: Drive + Sized {
    /// Connects as the client does: see [`connect`](crate::connect::Connect).
    ///
    /// # Errors
    ///
    /// [`Failure::NoVehicle`], or the vehicle lacks what the client needs.
    fn connect(&mut self) -> Result<crate::connect::Connected, Failure> {
        self.run(crate::connect::Connect::new())
    }

    /// Sends a COMMAND_LONG with these first parameters, and waits for the result. The client fills the other parameters.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn command(&mut self, command: MavCmd, params: &[f32]) -> Result<crate::command::Accepted, Failure> {
        self.run(crate::command::Send::new(command, params))
    }

    /// Arms the vehicle.
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn arm(&mut self) -> Result<(), Failure> {
        self.command(MavCmd::COMPONENT_ARM_DISARM, &[1.0]).map(drop)
    }

    /// Disarms the vehicle.
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn disarm(&mut self) -> Result<(), Failure> {
        self.command(MavCmd::COMPONENT_ARM_DISARM, &[0.0]).map(drop)
    }

    /// Takes off to an altitude (m), which MAVSDK does not send: QGroundControl's is above mean sea level, and MAVProxy's is above home.
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn takeoff(&mut self, altitude: f32) -> Result<(), Failure> {
        const NAN: f32 = f32::NAN;
        let params: &[f32] = match self.station().client() {
            Client::QGroundControl => &[-1.0, 0.0, 0.0, NAN, NAN, NAN, altitude],
            Client::Mavsdk => &[],
            Client::MavProxy | Client::Pymavlink => &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, altitude],
        };
        self.command(MavCmd::NAV_TAKEOFF, params).map(drop)
    }

    /// Reads a parameter by its name.
    ///
    /// # Errors
    ///
    /// [`Failure::Param`] if there is none, [`Failure::Timeout`] if it is not answered.
    fn get(&mut self, name: &str) -> Result<Value, Failure> {
        self.run(parameters::Read::new(name)).map(|parameter| parameter.value)
    }

    /// Sets a parameter, and waits until it is confirmed. Returns the value that the vehicle has then.
    ///
    /// # Errors
    ///
    /// [`Failure::Param`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn set(&mut self, name: &str, value: impl Into<Value>) -> Result<Value, Failure> {
        self.run(parameters::Set::new(name, value)).map(|parameter| parameter.value)
    }

    /// Downloads all parameters, in order of their indices.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if some of them did not come.
    fn parameters(&mut self) -> Result<Vec<Parameter>, Failure> {
        self.run(parameters::List::new())
    }

    /// Lists a directory of the vehicle; `/` is the root.
    ///
    /// # Errors
    ///
    /// [`Failure::File`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn list_files(&mut self, directory: &str) -> Result<Vec<crate::files::Entry>, Failure> {
        self.run(crate::files::Listing::new(directory))
    }

    /// Reads a file of the vehicle.
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files); [`Failure::Protocol`] if its parts do not make up the announced size.
    fn read_file(&mut self, path: &str) -> Result<Vec<u8>, Failure> {
        self.run(crate::files::Download::new(path))
    }

    /// Creates or replaces a file of the vehicle.
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files).
    fn write_file(&mut self, path: &str, content: &[u8]) -> Result<(), Failure> {
        self.run(crate::files::Upload::new(path, content))
    }

    /// Removes a file of the vehicle. For other changes see [`files::Operation`](crate::files::Operation).
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files).
    fn remove_file(&mut self, path: &str) -> Result<(), Failure> {
        self.run(crate::files::Operation::remove(path))
    }

    /// Returns the checksum of a file of the vehicle, see [`files::crc32`](crate::files::crc32).
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files).
    fn checksum(&mut self, path: &str) -> Result<u32, Failure> {
        self.run(crate::files::Checksum::new(path))
    }

    /// Lists the flight logs.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if entries are missing.
    fn list_logs(&mut self) -> Result<Vec<crate::logs::Log>, Failure> {
        self.run(crate::logs::Listing::new())
    }

    /// Reads a flight log.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if data are missing, [`Failure::Protocol`] if it is empty and the client cannot read such.
    fn read_log(&mut self, log: crate::logs::Log) -> Result<Vec<u8>, Failure> {
        self.run(crate::logs::Download::new(log))
    }

    /// Erases all flight logs. Returns those that are left.
    ///
    /// # Errors
    ///
    /// As [`list_logs`](Self::list_logs).
    fn erase_logs(&mut self) -> Result<Vec<crate::logs::Log>, Failure> {
        self.run(crate::logs::Erasure::new())
    }

    /// Uploads the mission. Returns the vehicle's id of the plan (`opaque_id`), or 0.
    ///
    /// # Errors
    ///
    /// [`Failure::Plan`] if it is refused, [`Failure::Timeout`] if the vehicle falls silent.
    fn upload_mission(&mut self, items: &[Item]) -> Result<u32, Failure> {
        self.run(plans::Upload::new(PlanType::Mission, items))
    }

    /// Downloads the mission.
    ///
    /// # Errors
    ///
    /// As for the upload.
    fn download_mission(&mut self) -> Result<Vec<Item>, Failure> {
        self.run(plans::Download::new(PlanType::Mission)).map(|plan| plan.items)
    }

    /// Clears the mission.
    ///
    /// # Errors
    ///
    /// As for the upload.
    fn clear_mission(&mut self) -> Result<(), Failure> {
        self.run(plans::Clear::new(PlanType::Mission))
    }

    /// Uploads the geofence. Returns the vehicle's id of the plan (`opaque_id`), or 0.
    ///
    /// # Errors
    ///
    /// [`Failure::Plan`] if it is refused, [`Failure::Timeout`] if the vehicle falls silent.
    fn upload_fence(&mut self, items: &[Item]) -> Result<u32, Failure> {
        self.run(plans::Upload::new(PlanType::Fence, items))
    }

    /// Downloads the geofence.
    ///
    /// # Errors
    ///
    /// As for the upload.
    fn download_fence(&mut self) -> Result<Vec<Item>, Failure> {
        self.run(plans::Download::new(PlanType::Fence)).map(|plan| plan.items)
    }

    /// Clears the geofence.
    ///
    /// # Errors
    ///
    /// As for the upload.
    fn clear_fence(&mut self) -> Result<(), Failure> {
        self.run(plans::Clear::new(PlanType::Fence))
    }

    /// Uploads the rally points. Returns the vehicle's id of the plan (`opaque_id`), or 0.
    ///
    /// # Errors
    ///
    /// [`Failure::Plan`] if it is refused, [`Failure::Timeout`] if the vehicle falls silent.
    fn upload_rally(&mut self, items: &[Item]) -> Result<u32, Failure> {
        self.run(plans::Upload::new(PlanType::Rally, items))
    }

    /// Downloads the rally points.
    ///
    /// # Errors
    ///
    /// As for the upload.
    fn download_rally(&mut self) -> Result<Vec<Item>, Failure> {
        self.run(plans::Download::new(PlanType::Rally)).map(|plan| plan.items)
    }

    /// Clears the rally points.
    ///
    /// # Errors
    ///
    /// As for the upload.
    fn clear_rally(&mut self) -> Result<(), Failure> {
        self.run(plans::Clear::new(PlanType::Rally))
    }

    /// Makes an item of the mission the current one.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn set_current(&mut self, seq: u16) -> Result<(), Failure> {
        self.run(plans::SetCurrent::new(seq))
    }

    /// Downloads all parameters in one file.
    ///
    /// # Errors
    ///
    /// As [`read_file`](Self::read_file); [`Failure::Protocol`] if the file is damaged.
    fn parameter_file(&mut self) -> Result<Vec<Parameter>, Failure> {
        self.run(parameters::FileList::new())
    }

    /// Lists the flight modes.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if the vehicle has none, [`Failure::Timeout`] if some of them did not come.
    fn modes(&mut self) -> Result<Vec<Mode>, Failure> {
        self.run(modes::List::new())
    }

    /// Sets the flight mode by its number in HEARTBEAT, and waits until the vehicle reports it.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered, [`Failure::Protocol`] if it was accepted and
    /// is not reported.
    fn set_mode(&mut self, custom_mode: u32) -> Result<(), Failure> {
        self.run(modes::Set::new(custom_mode))
    }

    /// Sets a standard mode, and waits until the vehicle reports it.
    ///
    /// # Errors
    ///
    /// As [`set_mode`](Self::set_mode).
    fn set_standard_mode(&mut self, mode: MavStandardMode) -> Result<(), Failure> {
        self.run(modes::Set::standard(mode))
    }

    /// Requests one message, and waits for it.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it does not come.
    fn request_message<M: Message>(&mut self) -> Result<M, Failure> {
        self.run(streams::Request::new())
    }

    /// Sets the interval of a message on this link: a [`Duration`] or an [`Interval`].
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn set_interval<M: Message>(&mut self, interval: impl Into<Interval>) -> Result<(), Failure> {
        self.run(streams::set_interval::<M>(interval)).map(drop)
    }

    /// Returns the interval of a message on this link; `None` if the vehicle does not have the message.
    ///
    /// # Errors
    ///
    /// As [`request_message`](Self::request_message).
    fn interval<M: Message>(&mut self) -> Result<Option<Interval>, Failure> {
        let request = streams::Request::<MessageInterval>::new().with_index(M::ID);
        self.run(request).map(|message| Interval::from_message(&message))
    }

    /// Waits for the next `M` of the vehicle.
    ///
    /// # Errors
    ///
    /// [`Failure::Protocol`] if none comes within the time.
    fn expect<M: Message>(&mut self, within: Duration) -> Result<M, Failure> {
        self.run(streams::Await::new(within))
    }

    /// Runs another dialogue beside all that follow, for example [`Sticks`](crate::sticks::Sticks) or
    /// [`events::Follow`](crate::events::Follow). Give it by reference to read it afterwards.
    fn alongside<B: Dialogue>(&mut self, side: B) -> crate::Alongside<'_, Self, B> {
        crate::Alongside::new(self, side)
    }

    /// Lets time pass.
    ///
    /// # Errors
    ///
    /// Only those of the transport.
    fn wait(&mut self, time: Duration) -> Result<(), Failure> {
        self.run(crate::Wait::new(time))
    }

    /// Holds the sticks, or sends a setpoint, for a time.
    ///
    /// # Errors
    ///
    /// Only those of the transport: sticks are not answered.
    fn hold(&mut self, input: impl Into<crate::sticks::Input>, time: Duration) -> Result<(), Failure> {
        self.run(crate::sticks::Sticks::new(input).for_time(time))
    }

    /// Returns the events of the next `time`.
    ///
    /// # Errors
    ///
    /// Only those of the transport.
    fn events_for(&mut self, time: Duration) -> Result<Vec<mavstack::dialect::Event>, Failure> {
        self.run(crate::events::Follow::new().for_time(time))
    }

    /// Requests control of the vehicle, see [`control::Request`](crate::control::Request).
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn request_control(&mut self, takeover: crate::control::Takeover) -> Result<crate::control::Answer, Failure> {
        self.run(crate::control::Request::new(takeover, Duration::from_secs(10)))
    }

    /// Releases control of the vehicle.
    ///
    /// # Errors
    ///
    /// As [`request_control`](Self::request_control).
    fn release_control(&mut self) -> Result<(), Failure> {
        self.run(crate::control::Release::new())
    }

    /// Gives the vehicle a key, and signs from then on, see [`signing::Setup`](crate::signing::Setup).
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if the vehicle does not sign then.
    fn setup_signing(&mut self, key: [u8; 32], timestamp: u64) -> Result<(), Failure> {
        self.run(crate::signing::Setup::new(key, timestamp))
    }

    /// Makes the vehicle forget its key, and signs nothing from then on.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if the vehicle still signs.
    fn remove_signing(&mut self) -> Result<(), Failure> {
        self.run(crate::signing::Remove::new())
    }

    /// Measures the vehicle's clock by TIMESYNC.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if it is not answered.
    fn timesync(&mut self) -> Result<crate::time::Sample, Failure> {
        self.run(crate::time::Timesync::new())
    }

    /// Sends PING. Returns the time until its answer.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if it is not answered.
    fn ping(&mut self) -> Result<Duration, Failure> {
        self.run(crate::time::Ping::new())
    }

    /// Finds the vehicle's camera, and requests what it says of itself.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] or [`Failure::Timeout`] if there is none.
    fn identify_camera(&mut self) -> Result<crate::camera::Identified, Failure> {
        self.run(crate::camera::Identify::new())
    }

    /// Takes an image. Returns its report if one came.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if the command is not answered.
    fn take_image(&mut self) -> Result<Option<mavstack::dialect::CameraImageCaptured>, Failure> {
        Ok(self.run(crate::camera::Capture::one())?.pop())
    }

    /// Lists the settings of the vehicle's camera.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if some are missing.
    fn camera_settings(&mut self) -> Result<Vec<crate::camera::Setting>, Failure> {
        self.run(crate::camera::ListSettings::new())
    }

    /// Sets a setting of the vehicle's camera. Returns the value that it has then.
    ///
    /// # Errors
    ///
    /// [`Failure::Param`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn set_camera_setting(&mut self, name: &str, value: crate::camera::Value) -> Result<crate::camera::Value, Failure> {
        self.run(crate::camera::SetSetting::new(name, value))
    }

    /// Finds the vehicle's gimbal manager.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] or [`Failure::Timeout`] if there is none.
    fn identify_gimbal(&mut self) -> Result<crate::gimbal::Manager, Failure> {
        self.run(crate::gimbal::Identify::new())
    }

    /// Takes control of a gimbal, and points it: pitch up, yaw to the right of the nose (deg).
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn point_gimbal(&mut self, manager: crate::gimbal::Manager, pitch: f32, yaw: f32) -> Result<(), Failure> {
        self.run(crate::gimbal::Configure::new(manager, crate::gimbal::Claim::Take))?;
        self.run(crate::gimbal::Point::new(manager, pitch, yaw))
    }
}

impl<T: Drive> GroundStation for T {}
