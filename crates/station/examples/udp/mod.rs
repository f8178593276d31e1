//! A station on a UDP port of this computer: the transport of the examples.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant as Clock};

use mavstack::Instant;
use mavstack_station::{Client, Drive, Failure, Station};

/// A station on a UDP port. The vehicle is whoever sent the last datagram.
pub struct Udp {
    socket: UdpSocket,
    /// The vehicle, as soon as it was heard.
    peer: Option<SocketAddr>,
    station: Station,
    started: Clock,
}

impl Udp {
    /// Listens on a port of this computer; 0 selects a free one.
    pub fn listen(port: u16, client: Client) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(("127.0.0.1", port))?;
        socket.set_read_timeout(Some(Duration::from_millis(5)))?;
        Ok(Self { socket, peer: None, station: Station::new(client), started: Clock::now() })
    }

    /// Returns the port.
    pub fn port(&self) -> std::io::Result<u16> {
        self.socket.local_addr().map(|address| address.port())
    }
}

impl Drive for Udp {
    fn station(&mut self) -> &mut Station {
        &mut self.station
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        let failed = |error: std::io::Error| Failure::Transport(error.to_string());
        let bytes = self.station.take_output();
        if let Some(peer) = self.peer.filter(|_| !bytes.is_empty()) {
            self.socket.send_to(&bytes, peer).map_err(failed)?;
        }
        let mut datagram = [0; 2_048];
        let received = self.socket.recv_from(&mut datagram);
        let now = Instant::ZERO + self.started.elapsed().into();
        match received {
            Ok((len, peer)) => {
                self.peer = Some(peer);
                self.station.receive(now, &datagram[..len]);
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(error) => return Err(failed(error)),
        }
        self.station.poll(now);
        Ok(now)
    }
}

/// Returns the client of this name, in any case; QGroundControl if there is none.
pub fn client_named(name: &str) -> Client {
    let known = Client::ALL.into_iter().find(|client| client.name().eq_ignore_ascii_case(name));
    known.unwrap_or(Client::QGroundControl)
}
