//! A fleet of vehicles in one program, over sockets.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::{Duration, Instant};

use mavstack::dialect::{AutopilotVersion, CommandLong, GlobalPositionInt, Heartbeat, MavCmd, MavParamType, ParamSet};
use mavstack::frame::{Version, encode};
use mavstack::{Address, Message, Text};

/// A running program, which ends with the test.
struct Fleet {
    program: Child,
    base: u16,
}

impl Drop for Fleet {
    fn drop(&mut self) {
        // It may have ended by itself, after an error.
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}

impl Fleet {
    /// Starts vehicles with the system ids from `first` on, and waits until they run.
    fn start(count: u8, first: u8, telemetry: SocketAddr) -> Self {
        let arguments = ["--count", &count.to_string(), "--system", &first.to_string()];
        Self::start_with(count, telemetry, &arguments).0
    }

    /// Starts vehicles with these arguments, and waits until they run. Returns what they print until then, too.
    fn start_with(count: u8, telemetry: SocketAddr, arguments: &[&str]) -> (Self, String) {
        let base = free_ports(count);
        let mut program = Command::new(env!("CARGO_BIN_EXE_mavstack-sitl"))
            .args(arguments)
            .args(["--port-base", &base.to_string(), &format!("--udp={telemetry}")])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let output = BufReader::new(program.stdout.take().expect("its output"));
        let fleet = Self { program, base };
        let mut lines = output.lines().map_while(Result::ok);
        let mut printed = String::new();
        let is_running = lines.any(|line| {
            printed.push_str(&line);
            line.contains("Press Ctrl-C to stop")
        });
        assert!(is_running, "the program has ended: {printed}");
        // It goes on printing.
        std::thread::spawn(move || lines.for_each(drop));
        (fleet, printed)
    }

    /// Sends a message to the vehicle with this index, on its companion's port.
    fn send(&self, index: u16, message: &impl Message) -> TcpStream {
        let mut companion = TcpStream::connect((Ipv4Addr::LOCALHOST, self.base + 10 * index + 1)).expect("a client");
        companion.set_read_timeout(Some(Duration::from_millis(100))).expect("a timeout");
        let mut frame = [0; 280];
        let len = encode(message, Version::V2, Address::new(255, 190), 0, &mut frame).expect("a frame");
        companion.write_all(&frame[..len]).expect("the port takes it");
        companion
    }

    /// The processor time that it has used.
    #[cfg(target_os = "linux")]
    fn cpu_time(&self) -> Duration {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.program.id())).expect("it runs");
        let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace().skip(11);
        // User and system time, in units that Linux fixes at 10 ms.
        Duration::from_millis(fields.take(2).map(|ticks| ticks.parse::<u64>().expect("a number")).sum::<u64>() * 10)
    }

    /// The memory that it has (kB).
    #[cfg(target_os = "linux")]
    fn memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.program.id())).expect("it runs");
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("its memory");
        line.trim().trim_end_matches(" kB").parse().expect("a number")
    }
}

/// Returns the first of the free ports for a fleet. No two tests get the same.
fn free_ports(count: u8) -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(20_000);

    let is_free = |base: u16| {
        let ports = (0..u16::from(count)).flat_map(|index| (0..3).map(move |link| base + 10 * index + link));
        ports.into_iter().all(|port| TcpListener::bind((Ipv4Addr::LOCALHOST, port)).is_ok())
    };
    loop {
        let base = NEXT.fetch_add(10 * u16::from(count), Ordering::Relaxed);
        assert!(base < 30_000, "no free ports");
        if is_free(base) {
            return base;
        }
    }
}

/// Whole frames of MAVLink 2 in a row of bytes: id, system, component and payload.
fn frames(bytes: &[u8]) -> Vec<(u32, u8, u8, &[u8])> {
    let (mut found, mut rest) = (Vec::new(), bytes);
    while let [0xFD, len, _, _, _, system, component, a, b, c, ..] = *rest {
        let end = 12 + usize::from(len);
        let Some(payload) = rest.get(10..end - 2) else { break };
        found.push((u32::from_le_bytes([a, b, c, 0]), system, component, payload));
        rest = &rest[end..];
    }
    found
}

fn socket() -> UdpSocket {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    socket.set_read_timeout(Some(Duration::from_millis(100))).expect("a timeout");
    socket
}

/// Hands the frames of datagrams to `see`, until it returns true or the time is over.
fn receive(socket: &UdpSocket, time: Duration, mut see: impl FnMut(u32, u8, u8, &[u8]) -> bool) -> bool {
    let (began, mut datagram) = (Instant::now(), [0; 65_536]);
    while began.elapsed() < time {
        let Ok(len) = socket.recv(&mut datagram) else { continue };
        for (id, system, component, payload) in frames(&datagram[..len]) {
            if see(id, system, component, payload) {
                return true;
            }
        }
    }
    false
}

#[test]
fn each_vehicle_has_an_address_and_a_place_of_its_own() {
    let socket = socket();
    let _fleet = Fleet::start(12, 40, socket.local_addr().expect("an address"));
    let mut places = BTreeMap::new();
    let all_are_heard = receive(&socket, Duration::from_secs(30), |id, system, component, payload| {
        if id == GlobalPositionInt::ID && component == 1 {
            places.insert(system, GlobalPositionInt::decode(payload).lon);
        }
        places.len() == 12
    });
    assert!(all_are_heard, "heard: {places:?}");
    assert!(places.keys().copied().eq(40..52), "systems: {places:?}");
    let gaps: Vec<_> = places.values().zip(places.values().skip(1)).map(|(west, east)| east - west).collect();
    // Ten metres at 47.4° north.
    assert!(gaps.iter().all(|gap| (1_300..1_360).contains(gap)), "{places:?}");
}

#[test]
fn a_command_on_a_vehicles_port_reaches_this_vehicle() {
    let socket = socket();
    let fleet = Fleet::start(3, 7, socket.local_addr().expect("an address"));
    let mut ids = Vec::new();
    for index in 0..3 {
        let system = 7 + u8::try_from(index).expect("a small number");
        let request = CommandLong {
            command: MavCmd::REQUEST_MESSAGE,
            param1: AutopilotVersion::ID as f32,
            target_system: system,
            target_component: 1,
            ..CommandLong::UNKNOWN
        };
        let mut companion = fleet.send(index, &request);
        let (began, mut received) = (Instant::now(), Vec::new());
        let version = loop {
            assert!(began.elapsed() < Duration::from_secs(30), "no answer of system {system}");
            let mut bytes = [0; 4_096];
            let len = companion.read(&mut bytes).unwrap_or(0);
            received.extend_from_slice(&bytes[..len]);
            let answer = frames(&received).into_iter().find(|frame| frame.0 == AutopilotVersion::ID);
            if let Some((_, from, _, payload)) = answer {
                assert_eq!(from, system);
                break AutopilotVersion::decode(payload);
            }
        };
        ids.push((version.uid, version.uid2));
    }
    ids.dedup();
    assert_eq!(ids.len(), 3, "each vehicle has a hardware id of its own");
}

fn contents(files: &[&PathBuf]) -> Vec<Option<Vec<u8>>> {
    files.iter().map(|file| std::fs::read(file).ok()).collect()
}

/// Waits until all files have changed, and then do not for a second.
fn wait_until_stored(files: &[&PathBuf], before: &[Option<Vec<u8>>]) {
    let (began, mut last, mut changed_at) = (Instant::now(), before.to_vec(), Instant::now());
    loop {
        let now = contents(files);
        if now != last {
            (last, changed_at) = (now, Instant::now());
        }
        let have_changed = last.iter().zip(before).all(|(now, before)| now != before);
        if have_changed && changed_at.elapsed() >= Duration::from_secs(1) {
            return;
        }
        assert!(began.elapsed() < Duration::from_secs(30), "nothing is stored");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The command line takes precedence over stored system ids, also after a reboot. Without it a vehicle keeps its own.
#[test]
fn system_ids_are_those_of_the_command_line_and_then_the_stored_ones() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fleet-storage.bin");
    let files = [&file, &file.with_extension("bin.2")];
    for file in files {
        // There is none, or it is left by an earlier run.
        let _ = std::fs::remove_file(file);
    }
    let storage = file.to_str().expect("a name");
    let cases: [(&[&str], &[u8]); 4] = [
        (&["--system", "3", "--count", "2"], &[3, 4]),
        (&["--system", "10", "--count", "2"], &[10, 11]),
        (&[], &[10]),
        (&["--count", "2"], &[1, 2]),
    ];
    for ((arguments, expected), speed) in cases.into_iter().zip([3.0, 4.0, 5.0, 6.0]) {
        let socket = socket();
        let address = socket.local_addr().expect("an address");
        let count = u8::try_from(expected.len()).expect("a small number");
        let (fleet, printed) = Fleet::start_with(count, address, &[arguments, &["--storage", storage]].concat());
        assert!(printed.contains(&format!("Use system {},", expected[0])), "{arguments:?}: {printed}");
        let heard = || {
            let mut systems = BTreeSet::new();
            // On a busy machine heartbeats may be late. Those with other ids have some time, too.
            for (time, is_enough) in [(30_000, count), (2_500, u8::MAX)] {
                receive(&socket, Duration::from_millis(time), |id, system, component, _| {
                    if (id, component) == (Heartbeat::ID, 1) {
                        systems.insert(system);
                    }
                    systems.len() >= usize::from(is_enough)
                });
            }
            systems.into_iter().collect::<Vec<_>>()
        };
        assert_eq!(heard(), expected, "{arguments:?}");
        for (&target_system, index) in expected.iter().zip(0..) {
            let command = MavCmd::PREFLIGHT_REBOOT_SHUTDOWN;
            let reboot =
                CommandLong { command, param1: 1.0, target_system, target_component: 1, ..CommandLong::UNKNOWN };
            fleet.send(index, &reboot);
        }
        assert_eq!(heard(), expected, "{arguments:?}, after a reboot");
        // With a change all parameters are stored.
        let files = &files[..expected.len()];
        let before = contents(files);
        for (&target_system, index) in expected.iter().zip(0..) {
            let (param_id, param_type) = (Text::new("MPC_XY_CRUISE"), MavParamType::REAL32);
            fleet.send(
                index,
                &ParamSet { param_value: speed, target_system, target_component: 1, param_id, param_type },
            );
        }
        wait_until_stored(files, &before);
        assert_eq!(heard(), expected, "{arguments:?}, once stored");
    }
}

/// K-10: heartbeats are sent by the autopilot, its gimbal and its camera; with `--no-components` by the autopilot only, also after a
/// reboot.
#[test]
fn a_vehicle_without_components_sends_heartbeats_of_component_1() {
    for (arguments, expected) in [(&[][..], &[1, 100, 154][..]), (&["--no-components"], &[1])] {
        let socket = socket();
        let (fleet, _) = Fleet::start_with(1, socket.local_addr().expect("an address"), arguments);
        // On a busy machine heartbeats may be late. The components follow the autopilot at once.
        let heard = || {
            let (mut components, mut beats) = (BTreeSet::new(), 0);
            receive(&socket, Duration::from_secs(30), |id, _, component, _| {
                if id == Heartbeat::ID {
                    components.insert(component);
                    beats += u8::from(component == 1);
                }
                beats == 4
            });
            components.into_iter().collect::<Vec<_>>()
        };
        assert_eq!(heard(), expected, "{arguments:?}");
        let (target_system, target_component) = (1, 1);
        let command = MavCmd::PREFLIGHT_REBOOT_SHUTDOWN;
        fleet.send(0, &CommandLong { command, param1: 1.0, target_system, target_component, ..CommandLong::UNKNOWN });
        assert_eq!(heard(), expected, "{arguments:?}, after a reboot");
    }
}

/// What 250 vehicles cost: `cargo test --release -p mavstack-sitl --test fleet -- --ignored --nocapture`.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "the machine is busy for 12 s"]
fn heartbeats_of_250_vehicles() {
    const COUNT: u8 = 250;
    let socket = socket();
    let fleet = Fleet::start(COUNT, 1, socket.local_addr().expect("an address"));
    // Until all have started.
    receive(&socket, Duration::from_secs(2), |_, _, _, _| false);
    let (began, used) = (Instant::now(), fleet.cpu_time());
    let (mut count, mut longest, mut last) = (0u32, Duration::ZERO, BTreeMap::new());
    receive(&socket, Duration::from_secs(10), |id, system, component, _| {
        count += 1;
        if (id, component) == (Heartbeat::ID, 1) {
            let before = last.insert(system, Instant::now());
            longest = longest.max(before.map_or(Duration::ZERO, |before| before.elapsed()));
        }
        false
    });
    let share = (fleet.cpu_time() - used).as_secs_f64() / began.elapsed().as_secs_f64();
    println!(
        "{COUNT} vehicles: {} frames a second, at most {} ms from a heartbeat to the next, {:.0} % of a core, {} kB",
        count / 10,
        longest.as_millis(),
        share * 100.0,
        fleet.memory(),
    );
    assert_eq!(last.len(), usize::from(COUNT), "all are heard");
}
