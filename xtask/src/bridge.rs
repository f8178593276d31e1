//! From the emulated UART to UDP and back: whole frames, one or more a datagram.
//!
//! QEMU's own UDP ports send a datagram for each byte, which no ground station understands.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, UdpSocket};
use std::thread;

use mavstack::dialect::Common;
use mavstack::{Decoder, Dialect, Instant};

use crate::system::Result;

/// No datagram is longer: what fits any Ethernet.
const MAX_DATAGRAM: usize = 1_400;

/// Cuts a byte stream into datagrams.
struct Cutter {
    decoder: Decoder,
    datagram: Vec<u8>,
}

impl Cutter {
    fn new() -> Self {
        Self { decoder: Decoder::default(), datagram: Vec::with_capacity(MAX_DATAGRAM) }
    }

    /// Sends the whole frames in `bytes`, and what was left from before; the rest waits for its end.
    fn cut(&mut self, mut bytes: &[u8], mut send: impl FnMut(&[u8])) {
        loop {
            // A line from the emulator: nothing is damaged, so nothing grows stale and time may stand still.
            let taken = self.decoder.push(bytes, Instant::ZERO);
            bytes = &bytes[taken..];
            let mut budget = u32::MAX;
            while let Some(frame) = self.decoder.next(Instant::ZERO, Common::MESSAGES, &mut budget, |_| true) {
                if self.datagram.len() + frame.raw().len() > MAX_DATAGRAM {
                    send(&self.datagram);
                    self.datagram.clear();
                }
                self.datagram.extend_from_slice(frame.raw());
            }
            if bytes.is_empty() {
                break;
            }
        }
        if !self.datagram.is_empty() {
            send(&self.datagram);
            self.datagram.clear();
        }
    }
}

/// Connects the UART that calls `uart` with `peer` until it closes. Only the peer's datagrams are let in.
pub fn start(uart: TcpListener, peer: SocketAddr) -> Result {
    let any: SocketAddr =
        if peer.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
    let socket = UdpSocket::bind(any)
        .and_then(|socket| socket.connect(peer).map(|()| socket))
        .map_err(|error| format!("UDP to {peer}: {error}"))?;
    thread::spawn(move || {
        if let Err(error) = serve(uart, socket) {
            eprintln!("UDP to {peer}: {error}");
        }
    });
    Ok(())
}

fn serve(uart: TcpListener, socket: UdpSocket) -> io::Result<()> {
    let (mut uart_in, _) = uart.accept()?;
    let mut uart_out = uart_in.try_clone()?;
    let socket_in = socket.try_clone()?;
    thread::spawn(move || {
        let mut bytes = [0; 65_536];
        loop {
            match socket_in.recv(&mut bytes) {
                Ok(len) if uart_out.write_all(&bytes[..len]).is_ok() => {}
                // That is the answer to a datagram that we sent while nobody listened.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                _ => return,
            }
        }
    });
    let mut cutter = Cutter::new();
    let mut bytes = [0; 4096];
    loop {
        let len = uart_in.read(&mut bytes)?;
        if len == 0 {
            return Ok(());
        }
        // Nobody listening (yet) is no error.
        cutter.cut(&bytes[..len], |datagram| drop(socket.send(datagram)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack::dialect::{AutopilotVersion, Heartbeat};
    use mavstack::{Address, Version, encode};

    fn frames(count: u8) -> Vec<Vec<u8>> {
        let source = Address::new(1, 1);
        let frame = |seq: u8| {
            let mut bytes = [0; mavstack::MAX_FRAME_LEN];
            let len = if seq.is_multiple_of(3) {
                encode(
                    &AutopilotVersion { uid: 0xFDFD_FEFE_FDFD, ..Default::default() },
                    Version::V2,
                    source,
                    seq,
                    &mut bytes,
                )
            } else {
                encode(&Heartbeat { mavlink_version: 3, ..Default::default() }, Version::V2, source, seq, &mut bytes)
            };
            bytes[..len.unwrap()].to_vec()
        };
        (0..count).map(frame).collect()
    }

    /// However the emulator's socket cuts the stream, datagrams hold whole frames, all of them, in order.
    #[test]
    fn datagrams_hold_whole_frames_whatever_the_pieces() {
        let frames = frames(100);
        let stream = frames.concat();
        for piece in [1, 7, 64, 280, 5_000] {
            let mut cutter = Cutter::new();
            let mut sent = Vec::new();
            stream.chunks(piece).for_each(|bytes| cutter.cut(bytes, |datagram| sent.push(datagram.to_vec())));
            assert_eq!(sent.concat(), stream, "pieces of {piece}");
            let mut remaining = frames.iter();
            for datagram in &sent {
                assert!(datagram.len() <= MAX_DATAGRAM);
                let mut len = 0;
                while len < datagram.len() {
                    len += remaining.next().unwrap().len();
                }
                assert_eq!(len, datagram.len(), "a datagram ends within a frame, in pieces of {piece}");
            }
        }
    }
}
