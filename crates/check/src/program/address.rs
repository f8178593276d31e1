//! Addresses of lines, in pymavlink's words.

use std::fmt;
use std::str::FromStr;

/// The baud rate of a serial port whose address has none.
const DEFAULT_BAUD: u32 = 57_600;

/// Where the vehicle is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LineAddress {
    /// A serial port, with its baud rate.
    Serial(String, u32),
    /// A TCP server, as `HOST:PORT`.
    Tcp(String),
    /// A local UDP port, to which the vehicle sends first.
    UdpIn(String),
    /// A UDP port of the vehicle.
    UdpOut(String),
}

impl LineAddress {
    /// Returns the baud rate of a serial port.
    pub fn baud(&self) -> Option<u32> {
        match self {
            Self::Serial(_, baud) => Some(*baud),
            _ => None,
        }
    }
}

impl FromStr for LineAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let usage = "use serial:PORT:BAUD, tcp:HOST:PORT, udpin:HOST:PORT or udpout:HOST:PORT";
        let (kind, rest) = text.split_once(':').ok_or(usage)?;
        let host_and_port = || match rest.rsplit_once(':') {
            Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok_and(|port| port > 0) => {
                Ok(rest.to_owned())
            }
            _ => Err(format!("{rest:?} has no host or no port; {usage}")),
        };
        match kind {
            "serial" => match rest.rsplit_once(':') {
                Some((port, baud)) if !port.is_empty() => {
                    let baud = baud.parse().ok().filter(|baud| *baud >= 300);
                    let baud = baud.ok_or("the baud rate is a number from 300 on, such as 57600")?;
                    Ok(Self::Serial(port.to_owned(), baud))
                }
                None if !rest.is_empty() => Ok(Self::Serial(rest.to_owned(), DEFAULT_BAUD)),
                _ => Err(usage.to_owned()),
            },
            "tcp" => host_and_port().map(Self::Tcp),
            "udpin" | "udp" => host_and_port().map(Self::UdpIn),
            "udpout" => host_and_port().map(Self::UdpOut),
            _ => Err(usage.to_owned()),
        }
    }
}

impl fmt::Display for LineAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(port, baud) => write!(f, "serial:{port}:{baud}"),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::UdpIn(address) => write!(f, "udpin:{address}"),
            Self::UdpOut(address) => write!(f, "udpout:{address}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_written() {
        for text in [
            "serial:/dev/ttyACM0:115200",
            "serial:COM3:9600",
            "tcp:127.0.0.1:5760",
            "udpin:0.0.0.0:14550",
            "udpout:[::1]:14540",
        ] {
            assert_eq!(text.parse::<LineAddress>().map(|address| address.to_string()), Ok(text.to_owned()));
        }
        let serial = LineAddress::Serial("/dev/ttyUSB0".into(), DEFAULT_BAUD);
        assert_eq!("serial:/dev/ttyUSB0".parse(), Ok(serial));
    }

    #[test]
    fn wrong_addresses_are_refused() {
        for text in [
            "",
            "5760",
            "tcp:5760",
            "tcp:host:0",
            "tcp:host:70000",
            "udpin::14550",
            "serial:",
            "serial:/dev/ttyUSB0:fast",
            "usb:1:2",
        ] {
            assert!(text.parse::<LineAddress>().is_err(), "{text}");
        }
    }
}
