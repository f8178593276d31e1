//! Connects to a vehicle over UDP as each client does, and prints what it learns: `cargo run -p mavstack-station --example connect -- mavsdk`.
//!
//! It listens on port 14550 of this computer, where vehicles and simulators look for a ground station, or on the port that follows the
//! client's name.

use std::io::ErrorKind;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant as Clock};

use mavstack::Instant;
use mavstack_station::names::Named;
use mavstack_station::{Client, Drive, Failure, GroundStation, Station};

/// A station on a UDP port.
struct Udp {
    socket: UdpSocket,
    /// The vehicle, as soon as it was heard.
    peer: Option<SocketAddr>,
    station: Station,
    started: Clock,
}

impl Udp {
    fn listen(port: u16, client: Client) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(("127.0.0.1", port))?;
        socket.set_read_timeout(Some(Duration::from_millis(5)))?;
        Ok(Self { socket, peer: None, station: Station::new(client), started: Clock::now() })
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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).unwrap_or_default();
    let client = match name.as_str() {
        "mavsdk" => Client::Mavsdk,
        "mavproxy" => Client::MavProxy,
        "pymavlink" => Client::Pymavlink,
        _ => Client::QGroundControl,
    };
    let port = std::env::args().nth(2).map_or(Ok(14_550), |port| port.parse())?;
    let mut vehicle = Udp::listen(port, client)?;
    println!("{client} listens on port {port}");
    let connected = vehicle.connect()?;
    let address = connected.vehicle;
    println!(
        "system {} component {}: {}, {}",
        address.system.wire(),
        address.component.wire(),
        connected.heartbeat.r#type.named(),
        connected.heartbeat.autopilot.named(),
    );
    println!("{} modes, {} parameters", connected.modes.len(), connected.parameters.len());
    for plan in connected.plans.iter().flatten() {
        println!("a plan of {} items", plan.items.len());
    }
    for failure in &connected.failures {
        println!("missing: {failure}");
    }
    for text in vehicle.station.seen().texts() {
        println!("{}: {}", text.severity.named(), text.text);
    }
    Ok(())
}
