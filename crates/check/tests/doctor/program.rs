//! The program, with a board behind a port of this computer.

use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant as Clock};

use crate::board::{BAUD, BoardFirmware, Fault};
use mavstack::Instant;
use mavstack_station::kit::{self, Board, Firmware, Line, LineConfig};
use serde_json::Value;

const MILLISECOND: Duration = Duration::from_millis(1);

/// The far end of a line: what the board's UART is connected with.
trait FarEnd {
    /// Returns what has arrived, or an error once the program has ended. Waits up to about a millisecond.
    fn receive(&mut self) -> std::io::Result<Vec<u8>>;
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()>;
}

impl FarEnd for TcpStream {
    fn receive(&mut self) -> std::io::Result<Vec<u8>> {
        let mut bytes = [0; 1_024];
        match self.read(&mut bytes) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(len) => Ok(bytes[..len].to_vec()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(Vec::new()),
            Err(error) => Err(error),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.write_all(bytes)
    }
}

/// A UDP socket, with the program's address once it is known.
struct Datagrams(UdpSocket, Option<SocketAddr>);

impl FarEnd for Datagrams {
    fn receive(&mut self) -> std::io::Result<Vec<u8>> {
        let mut bytes = [0; 1_024];
        match self.0.recv_from(&mut bytes) {
            Ok((len, from)) => {
                self.1 = Some(from);
                Ok(bytes[..len].to_vec())
            }
            Err(_) => Ok(Vec::new()),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        if let Some(program) = self.1.filter(|_| !bytes.is_empty()) {
            // The program does not listen yet, or has ended.
            let _ = self.0.send_to(bytes, program);
        }
        Ok(())
    }
}

/// Runs a board in real time, until its program is gone or `is_done`.
fn serve(fault: Fault, mut far_end: impl FarEnd, is_done: &AtomicBool) {
    let (clock, started) = (kit::Clock::default(), Clock::now());
    let line = Line::new(&clock, LineConfig::default(), 1);
    let mut ports = [line.ends().0];
    let mut firmware = BoardFirmware::boot(&Board::default(), fault, BAUD);
    while !is_done.load(Ordering::Relaxed) {
        let now = Instant::ZERO + started.elapsed().into();
        clock.set(now);
        firmware.fly(now);
        firmware.poll(now, &mut ports);
        let Ok(bytes) = far_end.receive() else { return };
        line.send(&bytes);
        if far_end.send(&line.receive()).is_err() {
            return;
        }
    }
}

/// Runs `mavstack-check doctor` on a board behind `far_end`.
fn doctor_at<E: FarEnd>(address: &str, arguments: &[&str], fault: Fault, far_end: impl FnOnce() -> E + Send) -> Output {
    let is_done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| serve(fault, far_end(), &is_done));
        let output = run(&[&["doctor", address], arguments].concat());
        is_done.store(true, Ordering::Relaxed);
        output
    })
}

/// Runs `mavstack-check doctor` on a board behind a TCP server.
fn doctor(fault: Fault, arguments: &[&str]) -> Output {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = format!("tcp:{}", listener.local_addr().expect("its address"));
    doctor_at(&address, arguments, fault, || {
        let stream = listener.accept().expect("the program connects").0;
        stream.set_read_timeout(Some(MILLISECOND)).expect("a socket");
        stream
    })
}

/// Returns a socket of this computer.
fn socket() -> UdpSocket {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    socket.set_read_timeout(Some(MILLISECOND)).expect("a socket");
    socket
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mavstack-check")).args(arguments).output().expect("the program runs")
}

#[test]
fn a_sound_board_ends_with_0_and_text() {
    let output = doctor(Fault::None, &["--quick"]);
    let (text, progress) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("System 1, component 1: GROUND_ROVER, autopilot GENERIC"), "{text}");
    assert!(text.contains("Nothing wrong was found") && !text.contains('\x1b'), "{text}");
    assert!(progress.contains("measuring while idle"), "{progress}");
}

#[test]
fn a_faulty_board_ends_with_1_and_json() {
    let output = doctor(Fault::Component, &["--quick", "--json", "--quiet"]);
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(output.status.code(), Some(1), "{report}");
    assert!(output.stderr.is_empty());
    assert_eq!(report["outcome"], "findings");
    assert_eq!((&report["vehicle"]["system"], &report["vehicle"]["component"]), (&1.into(), &50.into()));
    let finding = &report["findings"][0];
    assert_eq!(
        (&finding["id"], &finding["topic"], &finding["severity"]),
        (&"component-id".into(), &"identity".into(), &"error".into())
    );
    assert!(finding["cause"].is_string() && finding["remedy"].is_string());
}

#[test]
fn a_port_where_nobody_listens_ends_with_2() {
    // The port is free again when the listener is gone.
    let port =
        TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|listener| listener.local_addr()).expect("a port").port();
    let output = run(&["doctor", &format!("tcp:127.0.0.1:{port}")]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("error: tcp:127.0.0.1"));
}

/// It would send before the vehicle has said anything.
#[test]
fn udpout_needs_the_users_word() {
    let vehicle = socket();
    let address = format!("udpout:{}", vehicle.local_addr().expect("its address"));
    let output = run(&["doctor", &address, "--quick"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--disarmed"));
    assert!(vehicle.recv_from(&mut [0; 64]).is_err(), "a datagram was sent");
}

#[test]
fn a_connection_that_is_closed_ends_with_2_and_the_report() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = format!("tcp:{}", listener.local_addr().expect("its address"));
    let output = doctor_at(&address, &[], Fault::None, || {
        let stream = listener.accept().expect("the program connects").0;
        stream.set_read_timeout(Some(MILLISECOND)).expect("a socket");
        Closing(stream, 0)
    });
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("error line-failed") && text.contains("received while idle"), "{text}");
}

/// A TCP connection that the board closes after 4,000 bytes.
struct Closing(TcpStream, usize);

impl FarEnd for Closing {
    fn receive(&mut self) -> std::io::Result<Vec<u8>> {
        self.0.receive()
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.1 += bytes.len();
        if self.1 > 4_000 {
            return Err(ErrorKind::ConnectionAborted.into());
        }
        self.0.send(bytes)
    }
}

#[test]
fn a_wrong_address_is_explained() {
    let output = run(&["doctor", "5760"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("use serial:PORT:BAUD"));
}

#[test]
fn a_board_is_examined_over_udp() {
    let vehicle = socket();
    let address = format!("udpout:{}", vehicle.local_addr().expect("its address"));
    let output = doctor_at(&address, &["--quick", "--disarmed"], Fault::None, || Datagrams(vehicle, None));
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));

    // The port is free again when the socket is gone.
    let program = socket().local_addr().expect("its address");
    let far_end = || Datagrams(socket(), Some(program));
    let output = doctor_at(&format!("udpin:{program}"), &["--quick"], Fault::None, far_end);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
}

/// A pseudo terminal in place of a serial port.
#[cfg(unix)]
#[test]
fn a_board_is_examined_over_a_serial_port() {
    use serialport::{SerialPort, TTYPort};
    let (mut board, program) = TTYPort::pair().expect("a pseudo terminal");
    board.set_timeout(MILLISECOND).expect("a terminal");
    let name = program.name().expect("its name");
    // The program opens it itself, alone.
    drop(program);
    let output = doctor_at(&format!("serial:{name}:57600"), &["--quick"], Fault::None, || Terminal(board));
    let (text, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{text}{errors}");
}

/// A pseudo terminal, which fails while the program has not opened the other end.
#[cfg(unix)]
struct Terminal(serialport::TTYPort);

#[cfg(unix)]
impl FarEnd for Terminal {
    fn receive(&mut self) -> std::io::Result<Vec<u8>> {
        let mut bytes = [0; 1_024];
        let len = self.0.read(&mut bytes).unwrap_or(0);
        Ok(bytes[..len].to_vec())
    }

    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        let _ = self.0.write_all(bytes);
        Ok(())
    }
}
