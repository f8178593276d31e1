//! Instructions for connecting ground stations.

use core::fmt;
use core::net::SocketAddr;

/// Prints how to use the other two links, which are TCP ports of this machine.
#[derive(Clone, Copy, Debug)]
pub struct OtherLinks {
    /// The vehicle's system id.
    pub system: u8,
    /// The port for a companion computer.
    pub companion: u16,
    /// The port for a satellite modem.
    pub satellite: u16,
}

impl fmt::Display for OtherLinks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { system, companion, satellite } = self;
        write!(
            f,
            "Companion computer: TCP port {companion}. The vehicle forwards between it and the ground station. Use \
             system {system},\ncomponent 191, for example.\n\
             Satellite modem: TCP port {satellite}. Carries commands and their answers, no heartbeats. \
             MAV_CMD_CONTROL_HIGH_LATENCY\nstarts HIGH_LATENCY2 reports there (in MAVProxy: `link hl on`)."
        )
    }
}

/// Prints how further ground stations connect to a vehicle on a network: the first one hears the vehicle by itself.
#[derive(Clone, Copy, Debug)]
pub struct FurtherStations {
    /// The vehicle's UDP port on this machine.
    pub port: u16,
}

impl fmt::Display for FurtherStations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { port } = self;
        write!(
            f,
            "The vehicle listens on UDP port {port}, and serves four ground stations. Further ones call it:\n    \
                 QGroundControl   Application Settings > Comm Links > Add: UDP, server 127.0.0.1:{port}\n    \
                 MAVProxy         mavproxy.py --master=udpout:127.0.0.1:{port}\n    \
                 MAVSDK           udpout://127.0.0.1:{port}\n    \
                 pymavlink        mavutil.mavlink_connection('udpout:127.0.0.1:{port}')"
        )
    }
}

/// Prints the ways to connect to the telemetry link.
#[derive(Clone, Copy, Debug)]
pub enum HowToConnect {
    /// The vehicle listens on this TCP port of this machine.
    Tcp(u16),
    /// The vehicle sends datagrams to this address.
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
                    14_550 => f.write_str("listens on UDP port 14550 by default")?,
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
