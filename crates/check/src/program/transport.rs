//! Serial ports and sockets.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::thread;
use std::time::{Duration, Instant as Clock};

use mavstack::Instant;
use mavstack_station::{Client, Drive, Failure, Station};
use serialport::{ClearBuffer, SerialPort};

use crate::address::LineAddress;

/// How long a step waits for bytes.
const WAIT: Duration = Duration::from_millis(1);
/// How long the connection to a TCP server may take.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);
/// The most bytes of one write to a serial port: it should not take longer than a step.
const SERIAL_CHUNK: usize = 64;

/// A line to a vehicle, and the station at its end.
pub struct Connection {
    line: Line,
    station: Station,
    /// Bytes to send, which the line does not take yet.
    pending: VecDeque<u8>,
    /// Whether something was sent since [`drop_pending`](Self::drop_pending).
    has_sent: bool,
    started: Clock,
}

enum Line {
    Serial(Box<dyn SerialPort>),
    Tcp(TcpStream),
    /// A socket, with the vehicle as soon as it is known.
    Udp(UdpSocket, Option<SocketAddr>),
}

impl Connection {
    /// Opens a line.
    pub fn open(address: &LineAddress) -> io::Result<Self> {
        let line = match address {
            LineAddress::Serial(port, baud) => Line::Serial(serialport::new(port, *baud).timeout(WAIT).open()?),
            LineAddress::Tcp(address) => Line::Tcp(connect(address)?),
            LineAddress::UdpIn(address) => Line::Udp(bind(resolve(address)?)?, None),
            LineAddress::UdpOut(address) => {
                let vehicle = resolve(address)?;
                let any = if vehicle.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
                Line::Udp(bind(resolve(any)?)?, Some(vehicle))
            }
        };
        let station = Station::new(Client::QGroundControl);
        Ok(Self { line, station, pending: VecDeque::new(), has_sent: false, started: Clock::now() })
    }

    /// Sends what the line takes without blocking.
    fn send(&mut self) -> io::Result<()> {
        self.has_sent |= !self.pending.is_empty();
        match &mut self.line {
            Line::Udp(socket, Some(vehicle)) => {
                // One frame in a datagram, as QGroundControl sends.
                for frame in frames(self.pending.make_contiguous()) {
                    without_waiting(socket.send_to(frame, *vehicle))?;
                }
                self.pending.clear();
            }
            // Nobody hears it yet.
            Line::Udp(_, None) => self.pending.clear(),
            Line::Tcp(stream) => write(stream, &mut self.pending, usize::MAX)?,
            Line::Serial(port) => write(port, &mut self.pending, SERIAL_CHUNK)?,
        }
        Ok(())
    }

    /// Drops what is not sent yet, also what the operating system still has to send.
    fn drop_pending(&mut self) {
        if let Line::Serial(port) = &self.line
            && std::mem::take(&mut self.has_sent)
        {
            // If it fails, a little more is sent.
            let _ = port.clear(ClearBuffer::Output);
        }
        self.pending.clear();
    }

    /// Returns what has arrived, and waits a little if there is nothing.
    fn receive(&mut self) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; 4_096];
        let len = match &mut self.line {
            Line::Serial(port) => without_waiting(port.read(&mut bytes))?.unwrap_or(0),
            Line::Tcp(stream) => match without_waiting(stream.read(&mut bytes))? {
                Some(0) => {
                    return Err(io::Error::new(ErrorKind::UnexpectedEof, "the far side has closed the connection"));
                }
                Some(len) => len,
                None => 0,
            },
            Line::Udp(socket, vehicle) => match without_waiting(socket.recv_from(&mut bytes)) {
                Ok(Some((len, from))) => {
                    *vehicle = Some(from);
                    len
                }
                Ok(None) => 0,
                // Nobody listens on that port yet.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => 0,
                Err(error) => return Err(error),
            },
        };
        if len == 0 && !matches!(self.line, Line::Serial(_)) {
            thread::sleep(WAIT);
        }
        bytes.truncate(len);
        Ok(bytes)
    }
}

impl Drive for Connection {
    fn station(&mut self) -> &mut Station {
        &mut self.station
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        let failed = |error: io::Error| Failure::Transport(error.to_string());
        let output = self.station.take_output();
        self.pending.extend(output);
        self.send().map_err(failed)?;
        let bytes = self.receive().map_err(failed)?;
        let now = Instant::ZERO + self.started.elapsed().into();
        self.station.receive(now, &bytes);
        self.station.poll(now);
        if !self.station.may_send() {
            self.drop_pending();
        }
        Ok(now)
    }
}

fn resolve(address: &str) -> io::Result<SocketAddr> {
    let mut found = address.to_socket_addrs()?;
    found.next().ok_or_else(|| io::Error::new(ErrorKind::NotFound, "the host name has no address"))
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let stream = TcpStream::connect_timeout(&resolve(address)?, CONNECT_WITHIN)?;
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    Ok(stream)
}

fn bind(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// Writes the first bytes, and removes what was written.
fn write(to: &mut impl Write, pending: &mut VecDeque<u8>, most: usize) -> io::Result<()> {
    let bytes = pending.make_contiguous();
    let len = bytes.len().min(most);
    if len > 0 {
        let written = without_waiting(to.write(&bytes[..len]))?.unwrap_or(0);
        pending.drain(..written);
    }
    Ok(())
}

/// Returns `None` if the call would block.
fn without_waiting<T>(result: io::Result<T>) -> io::Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Splits the output of a station into its frames. Bytes that are none stay together.
fn frames(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut frames = Vec::new();
    while !bytes.is_empty() {
        let len = match *bytes {
            [0xFE, len, ..] => usize::from(len) + 8,
            [0xFD, len, flags, ..] => usize::from(len) + 12 + if flags & 1 != 0 { 13 } else { 0 },
            _ => bytes.len(),
        };
        let (frame, rest) = bytes.split_at(len.min(bytes.len()));
        frames.push(frame);
        bytes = rest;
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack::Address;
    use mavstack::dialect::{Heartbeat, MavAutopilot, MavModeFlag};
    use mavstack::frame::{Version, encode};
    use mavstack_station::Sending;
    use std::net::{Ipv4Addr, TcpListener};

    #[test]
    fn the_output_is_split_into_frames() {
        let mut station = Station::new(Client::QGroundControl);
        (0..3).for_each(|_| station.send(&Heartbeat::default()));
        let bytes = station.take_output();
        let lens: Vec<_> = frames(&bytes).iter().map(|frame| frame.len()).collect();
        assert_eq!(lens.len(), 3);
        assert_eq!(lens.iter().sum::<usize>(), bytes.len());
        assert_eq!(frames(&[1, 2, 3]), [[1, 2, 3]]);
    }

    /// Returns a heartbeat of the vehicle.
    fn heartbeat(base_mode: MavModeFlag) -> Vec<u8> {
        let heartbeat = Heartbeat { autopilot: MavAutopilot::GENERIC, base_mode, ..Heartbeat::default() };
        let mut frame = [0; 64];
        let len = encode(&heartbeat, Version::V2, Address::new(1, 1), 0, &mut frame).expect("room");
        frame[..len].to_vec()
    }

    #[test]
    fn what_waits_for_the_line_is_dropped_when_the_vehicle_is_armed() {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let address = LineAddress::Tcp(listener.local_addr().expect("its address").to_string());
        let mut connection = Connection::open(&address).expect("it listens");
        let mut vehicle = listener.accept().expect("it connects").0;
        let steps_until = |connection: &mut Connection, may_send| {
            (0..10_000).any(|_| {
                connection.step().expect("it is connected");
                connection.station.may_send() == may_send
            })
        };
        connection.station.set_sending(Sending::WhileDisarmed);
        vehicle.write_all(&heartbeat(MavModeFlag::EMPTY)).expect("it is connected");
        assert!(steps_until(&mut connection, true));

        // The vehicle does not read: more is queued than the sockets hold.
        connection.station.send_raw(&vec![0; 64 << 20]);
        connection.step().expect("it is connected");
        assert!(!connection.pending.is_empty());
        vehicle.write_all(&heartbeat(MavModeFlag::SAFETY_ARMED)).expect("it is connected");
        assert!(steps_until(&mut connection, false));
        assert!(connection.pending.is_empty());
    }

    #[test]
    fn a_line_that_takes_few_bytes_gets_them_one_after_another() {
        struct Slow(Vec<u8>);
        impl Write for Slow {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                if self.0.len() % 2 == 1 {
                    self.0.push(0);
                    return Err(ErrorKind::WouldBlock.into());
                }
                self.0.push(bytes[0]);
                Ok(1)
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let (mut slow, mut pending) = (Slow(Vec::new()), VecDeque::from([1, 2, 3]));
        for _ in 0..5 {
            write(&mut slow, &mut pending, 2).expect("it is only slow");
        }
        assert_eq!((slow.0.as_slice(), pending.len()), (&[1, 0, 2, 0, 3][..], 0));
    }
}
