//! A link over datagrams: whole frames, one or more in each, to and from one peer.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::ops::Range;

use mavstack::{Instant, LinkId, PlanStorage};
use mavstack_demo::App;

use crate::Log;

/// No datagram is longer: what fits any Ethernet.
const MAX_DATAGRAM: usize = 1_400;

/// The socket, and what of the last datagram is not yet taken.
pub struct Datagrams {
    socket: UdpSocket,
    buffer: Box<[u8]>,
    rest: Range<usize>,
    /// What passes.
    pub log: Log,
}

impl Datagrams {
    /// Datagrams to and from `peer` only.
    pub fn open(peer: SocketAddr) -> Result<Self, String> {
        let any: SocketAddr =
            if peer.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
        let socket = UdpSocket::bind(any)
            .and_then(|socket| socket.connect(peer).and_then(|()| socket.set_nonblocking(true)).map(|()| socket))
            .map_err(|error| format!("UDP to {peer}: {error}"))?;
        Ok(Self { socket, buffer: vec![0; usize::from(u16::MAX)].into(), rest: 0..0, log: Log::default() })
    }

    /// Moves bytes between the link and the peer, through the stack's calls for bytes; never waits.
    pub fn serve<P: PlanStorage>(&mut self, app: &mut App<P>, now: Instant, link: LinkId) {
        if self.rest.is_empty() {
            // Errors are no end: "connection refused" is the answer to a datagram that nobody listened to.
            self.rest = 0..self.socket.recv(&mut self.buffer).unwrap_or(0);
            self.log.received.pass(&self.buffer[self.rest.clone()]);
        }
        let (stack, vehicle) = app.parts();
        // Also with no bytes: frames may wait in the decoder.
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
            // Nobody listening (yet) is no error.
            let _ = self.socket.send(&datagram);
            self.log.sent.pass(&datagram);
        }
    }
}
