//! The real clients that a station behaves as.

use mavstack::dialect::{Heartbeat, MavAutopilot, MavModeFlag, MavState, MavType};
use mavstack::{Address, Duration};

/// A real ground station or library. A [`Station`](crate::Station) has its timers, message forms, retries and times of giving up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Client {
    /// QGroundControl.
    QGroundControl,
    /// MAVSDK, configured as a ground station.
    Mavsdk,
    /// MAVProxy.
    MavProxy,
    /// A script that uses pymavlink's `mavutil`: no heartbeats, no retries of its own.
    Pymavlink,
}

impl Client {
    /// All clients.
    pub const ALL: [Self; 4] = [Self::QGroundControl, Self::Mavsdk, Self::MavProxy, Self::Pymavlink];

    /// Returns its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::QGroundControl => "QGroundControl",
            Self::Mavsdk => "MAVSDK",
            Self::MavProxy => "MAVProxy",
            Self::Pymavlink => "pymavlink",
        }
    }

    /// Returns the address that it uses by default. pymavlink sends from component 0, which MAVLink does not allow.
    pub const fn address(self) -> Address {
        match self {
            Self::QGroundControl => Address::new(255, 190),
            Self::Mavsdk => Address::new(245, 190),
            Self::MavProxy => Address::new(255, 230),
            Self::Pymavlink => Address::new(255, 0),
        }
    }

    /// Returns the interval of its heartbeats; `None` if it sends none.
    pub const fn heartbeat_interval(self) -> Option<Duration> {
        match self {
            Self::QGroundControl | Self::Mavsdk | Self::MavProxy => Some(Duration::from_secs(1)),
            Self::Pymavlink => None,
        }
    }

    /// Returns the heartbeat that it sends.
    pub fn heartbeat(self) -> Heartbeat {
        let (base_mode, system_status) = match self {
            // QGroundControl says MAV_MODE_MANUAL_ARMED.
            Self::QGroundControl => (MavModeFlag::SAFETY_ARMED | MavModeFlag::MANUAL_INPUT_ENABLED, MavState::ACTIVE),
            Self::Mavsdk => (MavModeFlag::EMPTY, MavState::ACTIVE),
            Self::MavProxy | Self::Pymavlink => (MavModeFlag::EMPTY, MavState::UNINIT),
        };
        Heartbeat {
            r#type: MavType::GCS,
            autopilot: MavAutopilot::INVALID,
            base_mode,
            system_status,
            mavlink_version: 3,
            ..Heartbeat::default()
        }
    }

    /// Returns how long a user of this client waits for an answer where the client itself has no timeout: MAVProxy prints answers
    /// whenever they come, and a script with pymavlink chooses its own time.
    pub const fn patience(self) -> Duration {
        match self {
            Self::QGroundControl | Self::Mavsdk | Self::MavProxy => Duration::from_secs(5),
            Self::Pymavlink => Duration::from_secs(3),
        }
    }

    /// Returns how long without any frame it takes a vehicle for lost.
    pub const fn lost_after(self) -> Duration {
        match self {
            Self::QGroundControl => Duration::from_millis(3_500),
            Self::Mavsdk => Duration::from_secs(3),
            Self::MavProxy | Self::Pymavlink => Duration::from_secs(5),
        }
    }
}

impl std::fmt::Display for Client {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
