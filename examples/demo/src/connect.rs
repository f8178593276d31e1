//! What to tell somebody who wants to connect a ground station.

use core::fmt;
use core::net::SocketAddr;

/// Prints what the two other links are, on TCP ports of this machine.
#[derive(Clone, Copy, Debug)]
pub struct OtherLinks {
    /// The companion computer's.
    pub companion: u16,
    /// The satellite modem's.
    pub satellite: u16,
}

impl fmt::Display for OtherLinks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { companion, satellite } = self;
        write!(
            f,
            "Companion computer: TCP port {companion}. It hears and reaches the ground station through the vehicle, as \
             component 191\nof system 1 for example.\n\
             Satellite modem: TCP port {satellite}. Commands and their answers, no heartbeats; \
             MAV_CMD_CONTROL_HIGH_LATENCY has the vehicle\nreport there (in MAVProxy: `link hl on`)."
        )
    }
}

/// Prints the ways to connect to the telemetry link.
#[derive(Clone, Copy, Debug)]
pub enum HowToConnect {
    /// It listens on this TCP port of this machine.
    Tcp(u16),
    /// It sends datagrams there.
    Udp(SocketAddr),
}

impl fmt::Display for HowToConnect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(port) => write!(
                f,
                "    QGroundControl   Application Settings > Comm Links > Add: TCP, 127.0.0.1, port {port}\n    \
                     MAVProxy         mavproxy.py --master=tcp:127.0.0.1:{port}\n    \
                     MAVSDK           tcpout://127.0.0.1:{port}\n    \
                     pymavlink        mavutil.mavlink_connection('tcp:127.0.0.1:{port}')"
            ),
            Self::Udp(address) => {
                f.write_str("    QGroundControl   ")?;
                match address.port() {
                    14_550 => f.write_str("listens on UDP port 14550 by itself")?,
                    port => write!(f, "Application Settings > Comm Links > Add: UDP, port {port}")?,
                }
                write!(
                    f,
                    "\n    MAVProxy         mavproxy.py --master=udpin:{address}\n    \
                     MAVSDK           udpin://{address}\n    \
                     pymavlink        mavutil.mavlink_connection('udpin:{address}')"
                )
            }
        }
    }
}
