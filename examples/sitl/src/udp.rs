//! A link over UDP. Each datagram contains one or more complete frames, to or from a single peer.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::ops::Range;

use mavstack::{Instant, LinkId};

use crate::Log;
use crate::vehicle::SitlApp;

/// Maximum length of a sent datagram, which fits any Ethernet frame.
const MAX_DATAGRAM: usize = 1_400;

/// The socket, and the rest of the last datagram.
pub struct Datagrams {
    socket: UdpSocket,
    buffer: Box<[u8]>,
    rest: Range<usize>,
    /// Logs the traffic.
    pub log: Log,
}

impl Datagrams {
    /// Opens a socket that exchanges datagrams with `peer` only.
    pub fn open(peer: SocketAddr) -> Result<Self, String> {
        let any: SocketAddr =
            if peer.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
        let socket = UdpSocket::bind(any)
            .and_then(|socket| socket.connect(peer).and_then(|()| socket.set_nonblocking(true)).map(|()| socket))
            .map_err(|error| format!("UDP to {peer}: {error}"))?;
        Ok(Self { socket, buffer: vec![0; usize::from(u16::MAX)].into(), rest: 0..0, log: Log::default() })
    }

    /// Moves bytes between the link and the peer, with the stack's `receive` and `transmit`. Never blocks.
    pub fn serve(&mut self, app: &mut SitlApp, now: Instant, link: LinkId) {
        if self.rest.is_empty() {
            // Errors are not fatal: "connection refused" only means that no program listened for the last datagram.
            self.rest = 0..self.socket.recv(&mut self.buffer).unwrap_or(0);
            self.log.received.pass(&self.buffer[self.rest.clone()]);
        }
        let (stack, vehicle) = app.parts();
        // Also called without bytes, because frames may be pending in the decoder.
        self.rest.start += stack.receive(now, link, &self.buffer[self.rest.clone()], vehicle);

        let mut datagram = Vec::new();
        loop {
            let frame = stack.transmit(now, link, vehicle);
            if frame.is_empty() || datagram.len() + frame.len() > MAX_DATAGRAM {
                break;
            }
            datagram.extend_from_slice(frame);
            let len = frame.len();
            stack.transmitted(link, len);
        }
        if !datagram.is_empty() {
            // An error only means that no program listens yet.
            let _ = self.socket.send(&datagram);
            self.log.sent.pass(&datagram);
        }
    }
}
