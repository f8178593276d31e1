//! One word for each dialogue.

use crate::modes::{self, Mode};
use crate::parameters::{self, Parameter, Value};
use crate::plans;
use crate::streams::{self, Interval};
use crate::{Alongside, Client, Dialogue, Drive, Failure, Wait};
use crate::{camera, command, connect, control, events, files, gimbal, logs, signing, sticks, time};
use mavstack::dialect::{MavCmd, MavStandardMode, MessageInterval};
use mavstack::{Duration, Item, Message, PlanType};

/// What a ground station does, in the field's words: one method for each [`Dialogue`], on everything that can [`Drive`] it.
pub trait GroundStation: Drive + Sized {
    /// Connects as the client does: see [`connect`](connect::Connect).
    ///
    /// # Errors
    ///
    /// [`Failure::NoVehicle`], or the vehicle lacks what the client needs.
    fn connect(&mut self) -> Result<connect::Connected, Failure> {
        self.run(connect::Connect::new())
    }

    /// Sends a COMMAND_LONG with these first parameters, and waits for the result. The client fills the other parameters.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn command(&mut self, command: MavCmd, params: &[f32]) -> Result<command::Accepted, Failure> {
        self.run(command::Send::new(command, params))
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

    /// Takes off to an altitude (m). QGroundControl's is above mean sea level, the others' is above the ground.
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn takeoff(&mut self, altitude: f32) -> Result<(), Failure> {
        const NAN: f32 = f32::NAN;
        let params = match self.station().client() {
            Client::QGroundControl => [-1.0, 0.0, 0.0, NAN, NAN, NAN, altitude],
            Client::Mavsdk => [NAN, NAN, NAN, NAN, NAN, NAN, altitude],
            Client::MavProxy | Client::Pymavlink => [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, altitude],
        };
        self.command(MavCmd::NAV_TAKEOFF, &params).map(drop)
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
    fn list_files(&mut self, directory: &str) -> Result<Vec<files::Entry>, Failure> {
        self.run(files::Listing::new(directory))
    }

    /// Reads a file of the vehicle.
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files); [`Failure::Protocol`] if its parts do not make up the announced size.
    fn read_file(&mut self, path: &str) -> Result<Vec<u8>, Failure> {
        self.run(files::Download::new(path))
    }

    /// Creates or replaces a file of the vehicle.
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files).
    fn write_file(&mut self, path: &str, content: &[u8]) -> Result<(), Failure> {
        self.run(files::Upload::new(path, content))
    }

    /// Removes a file of the vehicle. For other changes see [`files::Operation`](files::Operation).
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files).
    fn remove_file(&mut self, path: &str) -> Result<(), Failure> {
        self.run(files::Operation::remove(path))
    }

    /// Returns the checksum of a file of the vehicle, see [`files::crc32`](files::crc32).
    ///
    /// # Errors
    ///
    /// As [`list_files`](Self::list_files).
    fn checksum(&mut self, path: &str) -> Result<u32, Failure> {
        self.run(files::Checksum::new(path))
    }

    /// Lists the flight logs.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if entries are missing.
    fn list_logs(&mut self) -> Result<Vec<logs::Log>, Failure> {
        self.run(logs::Listing::new())
    }

    /// Reads a flight log.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if data are missing, [`Failure::Protocol`] if it is empty and the client cannot read such.
    fn read_log(&mut self, log: logs::Log) -> Result<Vec<u8>, Failure> {
        self.run(logs::Download::new(log))
    }

    /// Erases all flight logs. Returns those that are left.
    ///
    /// # Errors
    ///
    /// As [`list_logs`](Self::list_logs).
    fn erase_logs(&mut self) -> Result<Vec<logs::Log>, Failure> {
        self.run(logs::Erasure::new())
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

    /// Sets a flight mode by its name, which it looks up in the vehicle's list, and waits until the vehicle reports it.
    ///
    /// # Errors
    ///
    /// As [`set_mode`](Self::set_mode); [`Failure::Protocol`] if the vehicle has no mode of this name.
    fn set_mode_named(&mut self, name: &str) -> Result<(), Failure> {
        let modes = self.modes()?;
        let mode = modes.iter().find(|mode| mode.name == name);
        let mode = mode.ok_or_else(|| Failure::Protocol(format!("the vehicle has no mode {name}")))?;
        self.set_mode(mode.custom_mode)
    }

    /// Starts the mission (MAV_CMD_MISSION_START), all of it.
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn start_mission(&mut self) -> Result<(), Failure> {
        self.command(MavCmd::MISSION_START, &[0.0, 0.0]).map(drop)
    }

    /// Orders a reboot (MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN), and does not wait for it.
    ///
    /// # Errors
    ///
    /// As [`command`](Self::command).
    fn reboot(&mut self) -> Result<(), Failure> {
        self.command(MavCmd::PREFLIGHT_REBOOT_SHUTDOWN, &[1.0]).map(drop)
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

    /// Runs another dialogue beside all that follow, for example [`Sticks`](sticks::Sticks) or
    /// [`events::Follow`](events::Follow). Give it by reference to read it afterwards.
    fn alongside<B: Dialogue>(&mut self, side: B) -> Alongside<'_, Self, B> {
        Alongside::new(self, side)
    }

    /// Lets time pass.
    ///
    /// # Errors
    ///
    /// Only those of the transport.
    fn wait(&mut self, time: Duration) -> Result<(), Failure> {
        self.run(Wait::new(time))
    }

    /// Holds the sticks, or sends a setpoint, for a time.
    ///
    /// # Errors
    ///
    /// Only those of the transport: sticks are not answered.
    fn hold(&mut self, input: impl Into<sticks::Input>, time: Duration) -> Result<(), Failure> {
        self.run(sticks::Sticks::new(input).for_time(time))
    }

    /// Returns the events of the next `time`.
    ///
    /// # Errors
    ///
    /// Only those of the transport.
    fn events_for(&mut self, time: Duration) -> Result<Vec<mavstack::dialect::Event>, Failure> {
        self.run(events::Follow::new().for_time(time))
    }

    /// Requests control of the vehicle, see [`control::Request`](control::Request).
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn request_control(&mut self, takeover: control::Takeover) -> Result<control::Answer, Failure> {
        self.run(control::Request::new(takeover, Duration::from_secs(10)))
    }

    /// Releases control of the vehicle.
    ///
    /// # Errors
    ///
    /// As [`request_control`](Self::request_control).
    fn release_control(&mut self) -> Result<(), Failure> {
        self.run(control::Release::new())
    }

    /// Gives the vehicle a key, and signs from then on, see [`signing::Setup`](signing::Setup).
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if the vehicle does not sign then.
    fn setup_signing(&mut self, key: [u8; 32], timestamp: u64) -> Result<(), Failure> {
        self.run(signing::Setup::new(key, timestamp))
    }

    /// Makes the vehicle forget its key, and signs nothing from then on.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if the vehicle still signs.
    fn remove_signing(&mut self) -> Result<(), Failure> {
        self.run(signing::Remove::new())
    }

    /// Measures the vehicle's clock by TIMESYNC.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if it is not answered.
    fn timesync(&mut self) -> Result<time::Sample, Failure> {
        self.run(time::Timesync::new())
    }

    /// Sends PING. Returns the time until its answer.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if it is not answered.
    fn ping(&mut self) -> Result<Duration, Failure> {
        self.run(time::Ping::new())
    }

    /// Finds the vehicle's camera, and requests what it says of itself.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] or [`Failure::Timeout`] if there is none.
    fn identify_camera(&mut self) -> Result<camera::Identified, Failure> {
        self.run(camera::Identify::new())
    }

    /// Takes an image. Returns its report if one came.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if the command is not answered.
    fn take_image(&mut self) -> Result<Option<mavstack::dialect::CameraImageCaptured>, Failure> {
        Ok(self.run(camera::Capture::one())?.pop())
    }

    /// Lists the settings of the vehicle's camera.
    ///
    /// # Errors
    ///
    /// [`Failure::Timeout`] if some are missing.
    fn camera_settings(&mut self) -> Result<Vec<camera::Setting>, Failure> {
        self.run(camera::ListSettings::new())
    }

    /// Sets a setting of the vehicle's camera. Returns the value that it has then.
    ///
    /// # Errors
    ///
    /// [`Failure::Param`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn set_camera_setting(&mut self, name: &str, value: camera::Value) -> Result<camera::Value, Failure> {
        self.run(camera::SetSetting::new(name, value))
    }

    /// Finds the vehicle's gimbal manager.
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] or [`Failure::Timeout`] if there is none.
    fn identify_gimbal(&mut self) -> Result<gimbal::Manager, Failure> {
        self.run(gimbal::Identify::new())
    }

    /// Takes control of a gimbal, and points it: pitch up, yaw to the right of the nose (deg).
    ///
    /// # Errors
    ///
    /// [`Failure::Command`] if it is refused, [`Failure::Timeout`] if it is not answered.
    fn point_gimbal(&mut self, manager: gimbal::Manager, pitch: f32, yaw: f32) -> Result<(), Failure> {
        self.run(gimbal::Configure::new(manager, gimbal::Claim::Take))?;
        self.run(gimbal::Point::new(manager, pitch, yaw))
    }
}

impl<T: Drive> GroundStation for T {}
