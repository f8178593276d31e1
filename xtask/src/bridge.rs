//! Between the emulated UARTs and the clients: whole frames over UDP, one or more a datagram, and a look at what passes over
//! TCP.
//!
//! QEMU's own UDP ports send a datagram for each byte, which no ground station understands.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use mavstack_console::{Frames, Tap, Tlog};

use crate::system::Result;

/// No datagram is longer: what fits any Ethernet.
const MAX_DATAGRAM: usize = 1_400;

/// Cuts a byte stream into datagrams.
struct Cutter {
    frames: Frames,
    datagram: Vec<u8>,
}

impl Cutter {
    fn new() -> Self {
        Self { frames: Frames::default(), datagram: Vec::with_capacity(MAX_DATAGRAM) }
    }

    /// Sends the whole frames in `bytes`, and what was left from before; the rest waits for its end.
    fn cut(&mut self, bytes: &[u8], mut send: impl FnMut(&[u8])) {
        let datagram = &mut self.datagram;
        self.frames.cut(bytes, |frame| {
            if datagram.len() + frame.raw().len() > MAX_DATAGRAM {
                send(datagram);
                datagram.clear();
            }
            datagram.extend_from_slice(frame.raw());
        });
        if !datagram.is_empty() {
            send(datagram);
            datagram.clear();
        }
    }
}

/// Connects the UART that calls `uart` with `peer` until it closes. Only the peer's datagrams are let in.
pub fn start_udp(uart: TcpListener, peer: SocketAddr, tlog: Option<Arc<Tlog>>) -> Result {
    let any: SocketAddr =
        if peer.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { (Ipv6Addr::UNSPECIFIED, 0).into() };
    let socket = UdpSocket::bind(any)
        .and_then(|socket| socket.connect(peer).map(|()| socket))
        .map_err(|error| format!("UDP to {peer}: {error}"))?;
    thread::spawn(move || {
        if let Err(error) = serve_udp(uart, socket, tlog) {
            eprintln!("UDP to {peer}: {error}");
        }
    });
    Ok(())
}

fn serve_udp(uart: TcpListener, socket: UdpSocket, tlog: Option<Arc<Tlog>>) -> io::Result<()> {
    let (mut uart_in, _) = uart.accept()?;
    let mut uart_out = uart_in.try_clone()?;
    let socket_in = socket.try_clone()?;
    let (mut received, mut sent) = (Tap::new(tlog.clone()), Tap::new(tlog));
    thread::spawn(move || {
        let mut bytes = [0; 65_536];
        loop {
            match socket_in.recv(&mut bytes) {
                Ok(len) if uart_out.write_all(&bytes[..len]).is_ok() => received.pass(&bytes[..len]),
                // That is the answer to a datagram that we sent while nothing was listening.
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
        sent.pass(&bytes[..len]);
    }
}

/// Connects the UART that calls `uart` with the clients that call `port`, one at a time, and logs the traffic. Bytes without a
/// client are lost, as at the emulator's own ports.
pub fn start_tcp(uart: TcpListener, port: TcpListener, tlog: Arc<Tlog>) {
    thread::spawn(move || {
        // It ends with the emulator.
        let _ = serve_tcp(&uart, &port, &tlog);
    });
}

fn serve_tcp(uart: &TcpListener, port: &TcpListener, tlog: &Arc<Tlog>) -> io::Result<()> {
    let (uart_in, _) = uart.accept()?;
    let mut uart_out = uart_in.try_clone()?;
    uart_out.set_nodelay(true)?;
    let client: Arc<Mutex<Option<(TcpStream, Tap)>>> = Arc::default();
    let to_client = Arc::clone(&client);
    thread::spawn(move || send_to(&to_client, uart_in));
    let set = |new| *client.lock().unwrap_or_else(PoisonError::into_inner) = new;
    loop {
        let (mut stream, _) = port.accept()?;
        stream.set_nodelay(true)?;
        set(Some((stream.try_clone()?, Tap::new(Some(Arc::clone(tlog))))));
        let mut received = Tap::new(Some(Arc::clone(tlog)));
        let mut bytes = [0; 4096];
        while let Ok(len @ 1..) = stream.read(&mut bytes) {
            received.pass(&bytes[..len]);
            uart_out.write_all(&bytes[..len])?;
        }
        set(None);
    }
}

fn send_to(client: &Mutex<Option<(TcpStream, Tap)>>, mut uart: TcpStream) {
    let mut bytes = [0; 4096];
    while let Ok(len @ 1..) = uart.read(&mut bytes) {
        if let Some((stream, sent)) = &mut *client.lock().unwrap_or_else(PoisonError::into_inner)
            // It is about to be found gone.
            && stream.write_all(&bytes[..len]).is_ok()
        {
            sent.pass(&bytes[..len]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavstack::Address;
    use mavstack::dialect::{AutopilotVersion, Heartbeat};
    use mavstack::frame::{Version, encode};

    fn frames(count: u8) -> Vec<Vec<u8>> {
        let source = Address::new(1, 1);
        let frame = |seq: u8| {
            let mut bytes = [0; mavstack::frame::MAX_FRAME_LEN];
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
