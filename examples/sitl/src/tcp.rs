//! A TCP port that behaves like a UART. It serves one client at a time; without a client sent bytes are lost.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};

use embedded_io::{ErrorType, Read, ReadReady, Write, WriteReady};
use mavstack_console::Console;

use crate::Log;

/// Capacity of the receive buffer, in bytes.
const BUFFER: usize = 4096;

/// A port and its client.
pub struct Port {
    number: u16,
    listener: TcpListener,
    client: Option<Client>,
    console: Console,
    /// Logs the traffic.
    pub log: Log,
}

struct Client {
    stream: TcpStream,
    address: SocketAddr,
    received: Vec<u8>,
    /// The number of received bytes that were read.
    taken: usize,
    /// Bytes to send that the operating system has not accepted yet.
    unsent: Vec<u8>,
    has_ended: bool,
}

impl Port {
    /// Listens on the port of this machine only.
    pub fn open(number: u16, console: Console) -> Result<Self, String> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, number))
            .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
            .map_err(|error| format!("cannot use TCP port {number} ({error}); choose other ports with --port-base"))?;
        Ok(Self { number, listener, client: None, console, log: Log::default() })
    }

    /// Accepts a client if none is connected, and refuses others. Returns true when a new client has connected.
    pub fn accept(&mut self) -> bool {
        let Ok((stream, address)) = self.listener.accept() else { return false };
        if let Some(client) = &mut self.client {
            // The client may just have disconnected.
            client.fill();
            if !client.has_ended {
                let Self { number, console, .. } = self;
                console.print(format_args!("Port {number}: {address} refused; {} is connected.", client.address));
                return false;
            }
            self.hang_up("disconnected");
        }
        // Send small frames at once.
        if stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)).is_err() {
            return false;
        }
        self.console.print(format_args!("Port {}: {address} connected.", self.number));
        self.log.restart();
        self.client =
            Some(Client { stream, address, received: Vec::new(), taken: 0, unsent: Vec::new(), has_ended: false });
        true
    }

    /// Closes the connection and prints the reason.
    pub fn hang_up(&mut self, why: &str) {
        if let Some(client) = self.client.take() {
            self.console.print(format_args!("Port {}: {} {why}.", self.number, client.address));
        }
    }
}

impl Client {
    /// Reads the bytes that have arrived. An error ends the connection.
    fn fill(&mut self) {
        if self.has_ended {
            return;
        }
        self.received.drain(..self.taken);
        self.taken = 0;
        let mut bytes = [0; BUFFER];
        while self.received.len() < BUFFER {
            match self.stream.read(&mut bytes) {
                Ok(len @ 1..) => self.received.extend_from_slice(&bytes[..len]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                _ => {
                    self.has_ended = true;
                    break;
                }
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        while !self.unsent.is_empty() {
            match self.stream.write(&self.unsent) {
                Ok(len) => drop(self.unsent.drain(..len)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl ErrorType for Port {
    type Error = io::Error;
}

impl ReadReady for Port {
    fn read_ready(&mut self) -> io::Result<bool> {
        let Some(client) = &mut self.client else { return Ok(false) };
        if client.taken == client.received.len() {
            client.fill();
        }
        Ok(client.taken < client.received.len() || client.has_ended)
    }
}

impl Read for Port {
    /// Returns 0 at the end of the connection, as the trait requires, and also when `read_ready` would return false.
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let Some(client) = &mut self.client else { return Ok(0) };
        let rest = &client.received[client.taken..];
        let len = rest.len().min(buf.len());
        buf[..len].copy_from_slice(&rest[..len]);
        client.taken += len;
        self.log.received.pass(&buf[..len]);
        Ok(len)
    }
}

impl WriteReady for Port {
    fn write_ready(&mut self) -> io::Result<bool> {
        let Some(client) = &mut self.client else { return Ok(true) };
        client.flush()?;
        Ok(client.unsent.is_empty())
    }
}

impl Write for Port {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        if let Some(client) = &mut self.client {
            client.unsent.extend_from_slice(buf);
            client.flush()?;
            self.log.sent.pass(buf);
        }
        Ok(buf.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.client.as_mut().map_or(Ok(()), Client::flush)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    fn open() -> (Port, SocketAddr) {
        let mut port = Port::open(0, Console::new()).unwrap();
        let address = port.listener.local_addr().unwrap();
        port.number = address.port();
        (port, address)
    }

    /// Waits for a condition, because sockets are asynchronous.
    fn eventually(mut condition: impl FnMut() -> bool) {
        let began = Instant::now();
        while !condition() {
            assert!(began.elapsed() < Duration::from_secs(10), "timeout");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn a_second_client_is_refused() {
        let (mut port, address) = open();
        let mut first = TcpStream::connect(address).unwrap();
        eventually(|| port.accept());
        let mut second = TcpStream::connect(address).unwrap();
        second.set_nonblocking(true).unwrap();
        eventually(|| {
            assert!(!port.accept());
            matches!(second.read(&mut [0]), Ok(0))
        });
        first.write_all(b"hello").unwrap();
        eventually(|| port.read_ready().unwrap());
        let mut bytes = [0; 8];
        let len = port.read(&mut bytes).unwrap();
        assert_eq!(&bytes[..len], b"hello");
    }

    #[test]
    fn a_client_may_replace_one_that_left_unread_bytes() {
        let (mut port, address) = open();
        let mut first = TcpStream::connect(address).unwrap();
        eventually(|| port.accept());
        first.write_all(&[7; 1_000]).unwrap();
        drop(first);
        let mut second = TcpStream::connect(address).unwrap();
        eventually(|| port.accept());
        assert!(!port.read_ready().unwrap(), "the first client's bytes are discarded");
        assert_eq!(port.write(b"for the second").unwrap(), 14);
        let mut bytes = [0; 14];
        second.read_exact(&mut bytes).unwrap();
        assert_eq!(&bytes, b"for the second");
    }

    #[test]
    fn bytes_without_a_client_are_lost_and_the_end_reads_as_zero() {
        let (mut port, address) = open();
        assert_eq!(port.write(b"lost").unwrap(), 4);
        let client = TcpStream::connect(address).unwrap();
        eventually(|| port.accept());
        assert!(!port.read_ready().unwrap());
        drop(client);
        eventually(|| port.read_ready().unwrap());
        assert_eq!(port.read(&mut [0; 8]).unwrap(), 0);
        port.hang_up("disconnected");
        assert!(!port.read_ready().unwrap());
    }
}
