//! The program, with a board behind a TCP port of this computer.

use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::process::{Command, Output};
use std::thread;
use std::time::{Duration, Instant as Clock};

use crate::board::{BAUD, BoardFirmware, Fault};
use mavstack::Instant;
use mavstack_station::kit::{self, Board, Firmware, Line, LineConfig};
use serde_json::Value;

/// Runs a board in real time, until its client is gone.
fn serve(fault: Fault, mut stream: TcpStream) {
    let (clock, started) = (kit::Clock::default(), Clock::now());
    let line = Line::new(&clock, LineConfig::default(), 1);
    let mut ports = [line.ends().0];
    let mut firmware = BoardFirmware::boot(&Board::default(), fault, BAUD);
    stream.set_read_timeout(Some(Duration::from_millis(1))).expect("a socket");
    loop {
        let now = Instant::ZERO + started.elapsed().into();
        clock.set(now);
        firmware.fly(now);
        firmware.poll(now, &mut ports);
        let mut bytes = [0; 1_024];
        match stream.read(&mut bytes) {
            Ok(0) => return,
            Ok(len) => line.send(&bytes[..len]),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return,
        }
        if stream.write_all(&line.receive()).is_err() {
            return;
        }
    }
}

/// Runs `mavstack-check doctor` on a board.
fn doctor(fault: Fault, arguments: &[&str]) -> Output {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = format!("tcp:{}", listener.local_addr().expect("its address"));
    let board = thread::spawn(move || serve(fault, listener.accept().expect("the program connects").0));
    let output = run(&[&["doctor", &address], arguments].concat());
    board.join().expect("the board runs until the program has ended");
    output
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
    assert!(text.contains("Nothing is wrong") && !text.contains('\x1b'), "{text}");
    assert!(progress.contains("measuring in calm"), "{progress}");
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

#[test]
fn a_wrong_address_is_explained() {
    let output = run(&["doctor", "5760"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("use serial:PORT:BAUD"));
}
