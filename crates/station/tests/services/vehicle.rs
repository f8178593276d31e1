//! A boat with all smaller services: files and logs in memory, events, a camera, a gimbal.

use mavstack::camera::{CameraControl, Image, Shot};
use mavstack::clock::Time;
use mavstack::dialect::commands::ComponentArmDisarm;
use mavstack::dialect::{
    CameraCapFlags, CameraInformation, GimbalDeviceAttitudeStatus, GimbalDeviceFlags, GimbalDeviceInformation,
    GimbalManagerCapFlags, GimbalManagerFlags, GimbalManagerInformation, MavFtpErr, MavType, ParamAck,
};
use mavstack::ext_parameters::{ExtParamServer, ExtValue};
use mavstack::files::{FileAccess, FileChange, FileEntry, OpenFile};
use mavstack::gimbal::{DeviceService, GimbalSetpoint, GimbalTarget, ManagerService};
use mavstack::logs::{LogInfo, LogRead};
use mavstack::message::ComponentId;
use mavstack::prelude::*;
use mavstack::setpoints::Setpoints;
use mavstack::{Component, Files, GimbalDevice, GimbalManager, Logs, Peer};
use std::collections::BTreeMap;

mavstack::events! {
    /// The events of the boat.
    pub struct BoatEvents in "boat" {
        events {
            Passed(Info) { buoy: u8 } = "Passed buoy {1}";
        }
    }
}

/// The stack of the boat.
#[derive(mavstack::Stack)]
#[stack(
    vehicle: Boat,
    links: 2,
    commands: { slots: 4 },
    components,
    streams,
    files: { sessions: 2, upload: 1024 },
    logs,
    events: { history: 8 },
    manual_control,
    operator_control,
    signing: { streams: 8 },
)]
pub struct Mavlink {
    pub time: Time,
    pub setpoints: Setpoints,
    pub camera: CameraControl<[Image; 16]>,
    pub ext_parameters: ExtParamServer,
    pub gimbal_manager: ManagerService,
    pub gimbal_device: DeviceService,
}

/// The camera of the boat.
pub const CAMERA: ComponentId = ComponentId::new(100);

/// The boat.
#[derive(Debug, Default)]
pub struct Boat {
    pub armed: bool,
    /// The files in its root by name.
    pub files: BTreeMap<String, Vec<u8>>,
    pub open: BTreeMap<u16, String>,
    pub next: u16,
    /// The logs, the oldest first.
    pub logs: Vec<Vec<u8>>,
    /// Buoys that were passed and not reported yet.
    pub passed: Vec<u8>,
    /// Images taken.
    pub images: u32,
    pub iso: u32,
    /// Pitch and yaw of the gimbal (rad).
    pub gimbal: [f32; 2],
}

impl Vehicle for Boat {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.armed))
    }
}

impl Commands for Boat {
    fn command(&mut self, _: &mut Context<'_>, command: &Command) -> Outcome {
        match command.decode() {
            Ok(ComponentArmDisarm { arm, .. }) => self.armed = arm,
            Err(result) => return result.into(),
        }
        MavResult::ACCEPTED.into()
    }
}

fn text(path: &[u8]) -> &str {
    std::str::from_utf8(path).expect("ASCII")
}

impl Files for Boat {
    const WRITES: bool = true;

    fn directory(&mut self, path: &[u8]) -> Option<u16> {
        path.is_empty().then_some(0)
    }

    fn entry(&mut self, _: u16, index: u16) -> Option<FileEntry<'_>> {
        let (name, content) = self.files.iter().nth(index.into())?;
        Some(FileEntry { name: name.as_bytes(), size: Some(content.len() as u32), time: 1_700_000_000 })
    }

    fn open(&mut self, _: &mut Context<'_>, path: &[u8], access: FileAccess, _: Peer) -> Result<OpenFile, MavFtpErr> {
        let path = text(path);
        if path.starts_with("locked") {
            return Err(MavFtpErr::FILEPROTECTED);
        }
        match access {
            FileAccess::Read if !self.files.contains_key(path) => return Err(MavFtpErr::FILENOTFOUND),
            FileAccess::Read => {}
            FileAccess::Write => drop(self.files.entry(path.to_owned()).or_default()),
            FileAccess::Create => drop(self.files.insert(path.to_owned(), Vec::new())),
        }
        self.next += 1;
        self.open.insert(self.next, path.to_owned());
        Ok(OpenFile { number: self.next, size: self.files[path].len() as u32 })
    }

    fn read(&mut self, file: u16, offset: u32, out: &mut [u8]) -> Result<usize, MavFtpErr> {
        let content = self.files.get(&self.open[&file]).ok_or(MavFtpErr::FAIL)?;
        let rest = content.get(offset as usize..).unwrap_or_default();
        let len = rest.len().min(out.len());
        out[..len].copy_from_slice(&rest[..len]);
        Ok(len)
    }

    fn write(&mut self, _: &mut Context<'_>, file: u16, offset: u32, bytes: &[u8], _: Peer) -> Result<(), MavFtpErr> {
        let content = self.files.get_mut(&self.open[&file]).ok_or(MavFtpErr::FAIL)?;
        let (begin, end) = (offset as usize, offset as usize + bytes.len());
        content.resize(content.len().max(end), 0);
        content[begin..end].copy_from_slice(bytes);
        Ok(())
    }

    fn close(&mut self, _: &mut Context<'_>, file: u16) {
        self.open.remove(&file);
    }

    fn change(&mut self, _: &mut Context<'_>, change: FileChange<'_>, _: Peer) -> Result<(), MavFtpErr> {
        match change {
            FileChange::Remove(path) => self.files.remove(text(path)).map(drop).ok_or(MavFtpErr::FILENOTFOUND),
            FileChange::Truncate { path, size } => {
                let content = self.files.get_mut(text(path)).ok_or(MavFtpErr::FILENOTFOUND)?;
                content.resize(size as usize, 0);
                Ok(())
            }
            FileChange::Rename { from, to } => {
                let content = self.files.remove(text(from)).ok_or(MavFtpErr::FILENOTFOUND)?;
                self.files.insert(text(to).to_owned(), content);
                Ok(())
            }
            FileChange::CreateDirectory(_) | FileChange::RemoveDirectory(_) => Err(MavFtpErr::FAIL),
        }
    }
}

impl Logs for Boat {
    fn log_count(&self) -> u16 {
        self.logs.len() as u16
    }

    fn log_info(&self, id: u16) -> Option<LogInfo> {
        let log = self.logs.get(usize::from(id))?;
        Some(LogInfo { size: log.len() as u32, time_utc: 1_700_000_000 + u32::from(id) })
    }

    fn read_log(&mut self, id: u16, offset: u32, out: &mut [u8]) -> LogRead {
        out.copy_from_slice(&self.logs[usize::from(id)][offset as usize..][..out.len()]);
        LogRead::Done
    }

    fn erase_logs(&mut self, _: &mut Context<'_>, _: Peer) -> bool {
        self.logs.clear();
        true
    }
}

impl Telemetry for Boat {
    const STREAMS: &'static [Stream] = &[];

    fn fill(&mut self, _: u32, _: &mut Fill<'_>) -> bool {
        false
    }
}

impl Components for Boat {
    const COMPONENTS: &'static [Component] = &[Component::new(CAMERA, MavType::CAMERA)];
}

impl Camera for Boat {
    const COMPONENT: Option<ComponentId> = Some(CAMERA);
    const FLAGS: CameraCapFlags = CameraCapFlags::CAPTURE_IMAGE;
    const STORAGES: u8 = 1;

    fn camera_information(&self, information: &mut CameraInformation) {
        information.model_name = *Text::new("Deck camera").wire();
    }

    fn take_image(&mut self, cx: &mut Context<'_>, _: u32) -> Shot {
        self.images += 1;
        Shot::Taken(Image::at(cx.now()))
    }
}

impl ExtParameters for Boat {
    const COMPONENT: Option<ComponentId> = Some(CAMERA);

    fn ext_param_count(&self) -> u16 {
        2
    }

    fn ext_param(&self, index: u16) -> Option<(&str, ExtValue<'_>)> {
        match index {
            0 => Some(("CAM_MODE", ExtValue::U8(0))),
            1 => Some(("CAM_ISO", ExtValue::U32(self.iso))),
            _ => None,
        }
    }

    fn set_ext_param(&mut self, _: &mut Context<'_>, index: u16, value: ExtValue<'_>, _: Peer) -> ParamAck {
        match (index, value) {
            (1, ExtValue::U32(iso @ 100..=6_400)) => self.iso = iso,
            _ => return ParamAck::VALUE_UNSUPPORTED,
        }
        ParamAck::ACCEPTED
    }
}

impl GimbalManager for Boat {
    const DEVICE: u8 = 1;

    fn manager_information(&self) -> GimbalManagerInformation {
        GimbalManagerInformation {
            cap_flags: GimbalManagerCapFlags::HAS_PITCH_AXIS.with(GimbalManagerCapFlags::HAS_YAW_AXIS),
            pitch_min: -1.5,
            pitch_max: 0.5,
            yaw_min: -1.5,
            yaw_max: 1.5,
            ..GimbalManagerInformation::default()
        }
    }

    fn manager_flags(&self) -> GimbalManagerFlags {
        GimbalManagerFlags::PITCH_LOCK.with(GimbalManagerFlags::YAW_IN_VEHICLE_FRAME)
    }

    fn point_gimbal(&mut self, _: &mut Context<'_>, setpoint: &GimbalSetpoint) -> MavResult {
        match setpoint.target {
            GimbalTarget::Angles { angles, .. } => {
                self.gimbal = [angles.pitch().unwrap_or(0.0), angles.yaw().unwrap_or(0.0)];
                MavResult::ACCEPTED
            }
            GimbalTarget::Attitude { q: [w, x, y, z], .. } => {
                let pitch = (2.0 * (w * y - z * x)).asin();
                let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
                self.gimbal = [pitch, yaw];
                MavResult::ACCEPTED
            }
            _ => MavResult::DENIED,
        }
    }
}

impl GimbalDevice for Boat {
    const ID: u8 = 1;
    const MANAGER: Option<ComponentId> = None;

    fn device_information(&self) -> GimbalDeviceInformation {
        GimbalDeviceInformation::UNKNOWN
    }

    fn device_status(&self) -> Option<GimbalDeviceAttitudeStatus> {
        let [pitch, yaw] = self.gimbal.map(|angle| angle / 2.0);
        let q = [yaw.cos() * pitch.cos(), -yaw.sin() * pitch.sin(), yaw.cos() * pitch.sin(), yaw.sin() * pitch.cos()];
        let flags = GimbalDeviceFlags::PITCH_LOCK.with(GimbalDeviceFlags::YAW_IN_VEHICLE_FRAME);
        Some(GimbalDeviceAttitudeStatus { q, flags, ..GimbalDeviceAttitudeStatus::UNKNOWN })
    }
}
