//! A line in front of an emulated UART that takes bytes as fast as they come: it carries them at a baud rate.

use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::thread;
use std::time::{Duration, Instant};

use crate::system::Result;

/// The bytes that are sent at once: about a millisecond's at 57,600 bit/s.
const PIECE: usize = 6;
/// A line that is late by more, because the computer is busy, does not catch up: the UART's queue would overrun.
const LATE: Duration = Duration::from_millis(3);

/// Returns the port of a server that carries the bytes of one client to the UART at `uart`, and back as fast as they come.
pub fn line(uart: u16, baud: u32) -> Result<u16> {
    let fails = |error| format!("the line to the emulated UART: {error}");
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(fails)?;
    let port = listener.local_addr().map_err(fails)?.port();
    thread::spawn(move || {
        // It ends when either side closes its connection.
        let _ = serve(&listener, uart, baud);
    });
    Ok(port)
}

fn serve(listener: &TcpListener, uart: u16, baud: u32) -> std::io::Result<()> {
    let client = listener.accept()?.0;
    let board = connect(uart)?;
    client.set_nodelay(true)?;
    board.set_nodelay(true)?;
    let (mut from, mut to) = (board.try_clone()?, client.try_clone()?);
    thread::spawn(move || std::io::copy(&mut from, &mut to));
    pace(client, board, baud)
}

/// Waits until the emulator listens.
fn connect(port: u16) -> std::io::Result<TcpStream> {
    let began = Instant::now();
    loop {
        match TcpStream::connect((Ipv4Addr::LOCALHOST, port)) {
            Err(error) if error.kind() == ErrorKind::ConnectionRefused && began.elapsed() < Duration::from_secs(10) => {
                thread::sleep(Duration::from_millis(50));
            }
            result => return result,
        }
    }
}

fn pace(mut from: impl Read, mut to: impl Write, baud: u32) -> std::io::Result<()> {
    let byte = Duration::from_secs(10) / baud;
    let (mut piece, mut due) = ([0; PIECE], Instant::now());
    loop {
        let len = from.read(&mut piece)?;
        if len == 0 {
            return Ok(());
        }
        // As late as possible, when the last of its bits has passed.
        due = due.max(Instant::now() - LATE) + byte * u32::try_from(len).unwrap_or(u32::MAX);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        to.write_all(&piece[..len])?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_take_their_time() {
        let (bytes, began, mut received) = ([7; 240], Instant::now(), Vec::new());
        pace(&bytes[..], &mut received, 57_600).unwrap();
        assert_eq!(received, bytes);
        // 240 bytes take 41.7 ms.
        assert!(began.elapsed() > Duration::from_millis(38));
    }
}
