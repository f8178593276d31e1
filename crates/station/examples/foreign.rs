//! Tries the services of a vehicle that it does not know, over UDP and as one of the clients. Prints a line for each, and exits with 1 if
//! one of them failed.
//!
//! `cargo run -p mavstack-station --example foreign -- mavsdk 14550 CRUISE_SPEED readme.txt`
//!
//! The arguments are the client, the port on which it listens (0 selects a free one), a parameter with a `REAL32`, and a file to
//! read. The parameter is restored. **The mission is replaced and cleared, and the vehicle is armed and disarmed.** A vehicle that is
//! armed already is left alone.

mod udp;

use std::process::ExitCode;

use mavstack::dialect::{AutopilotVersion, MavResult};
use mavstack::{Duration, Item};
use mavstack_station::command::Place;
use mavstack_station::names::Named;
use mavstack_station::parameters::Value;
use mavstack_station::plans::waypoint;
use mavstack_station::{Drive, Failure, GroundStation};

use udp::{Udp, client_named};

/// How far an item may be from where it was put (deg·1e7): MISSION_ITEM carries degrees as `f32`.
const TOLERANCE: u32 = 50;
/// How often, and at which interval, a vehicle that is not ready is armed again.
const ARM_TRIES: u32 = 20;
const ARM_INTERVAL: Duration = Duration::from_secs(1);
/// How long the vehicle has to report that it is armed, or disarmed.
const REPORTED_WITHIN: Duration = Duration::from_secs(3);

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [client, port, parameter, file] = arguments.as_slice() else {
        return Err("usage: foreign CLIENT PORT PARAMETER FILE".into());
    };
    let mut vehicle = Udp::listen(port.parse()?, client_named(client))?;
    println!("port: {}", vehicle.port()?);

    let mut report = Report { failed: false };
    report.note("connect", connect(&mut vehicle));
    if vehicle.station().is_any_armed() {
        return Err("the vehicle is armed: nothing was changed".into());
    }
    report.note("list", vehicle.parameters().map(|list| format!("{} parameters", list.len())));
    report.note("set", set_and_restore(&mut vehicle, parameter));
    report.note("upload", vehicle.upload_mission(&mission()).map(|_| "accepted".to_owned()));
    report.note("download", download(&mut vehicle));
    report.note("clear", clear(&mut vehicle));
    report.note("arm", arm(&mut vehicle));
    report.note("disarm", vehicle.disarm().and_then(|()| reports(&mut vehicle, false)));
    report.note("request", vehicle.request_message::<AutopilotVersion>().map(|_| "AUTOPILOT_VERSION".to_owned()));
    report.note("directory", vehicle.list_files("/").map(|entries| format!("{} entries", entries.len())));
    report.note("file", vehicle.read_file(file).map(|content| format!("{} bytes", content.len())));
    report.note("timesync", vehicle.timesync().map(|_| "answered".to_owned()));
    Ok(if report.failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Prints how the services did.
struct Report {
    failed: bool,
}

impl Report {
    fn note(&mut self, service: &str, result: Result<String, Failure>) {
        self.failed |= result.is_err();
        match result {
            Ok(what) => println!("{service}: {what}"),
            Err(failure) => println!("{service}: failed: {failure}"),
        }
    }
}

/// Connects as the client does. What the client misses then is not a failure.
fn connect(vehicle: &mut Udp) -> Result<String, Failure> {
    let connected = vehicle.connect()?;
    for failure in &connected.failures {
        println!("missing: {failure}");
    }
    let (heartbeat, address) = (connected.heartbeat, connected.vehicle);
    let (system, component) = (address.system.wire(), address.component.wire());
    Ok(format!("{} {} at {system}/{component}", heartbeat.autopilot.named(), heartbeat.r#type.named()))
}

/// Sets a parameter to another value, reads it, and sets it back.
fn set_and_restore(vehicle: &mut Udp, name: &str) -> Result<String, Failure> {
    let Value::F32(before) = vehicle.get(name)? else {
        return Err(Failure::Protocol(format!("parameter {name} is not a REAL32")));
    };
    let other = before + 1.0;
    let read = vehicle.set(name, other).and_then(|_| vehicle.get(name));
    // A set that was not answered may have been carried out.
    vehicle.set(name, before)?;
    let read = read?;
    if read != Value::F32(other) {
        return Err(Failure::Protocol(format!("parameter {name} is {read} after it was set to {other}")));
    }
    Ok(format!("{name} from {before} to {other} and back"))
}

/// Three waypoints near the place where the demo vehicle starts.
fn mission() -> [Item; 3] {
    [(47.3978, 8.5456, 20.0), (47.3981, 8.5460, 25.0), (47.3984, 8.5452, 30.0)]
        .map(|(latitude, longitude, altitude)| waypoint(Place::relative(latitude, longitude, altitude)))
}

/// Downloads the mission, and compares it with what was uploaded.
fn download(vehicle: &mut Udp) -> Result<String, Failure> {
    let (items, uploaded) = (vehicle.download_mission()?, mission());
    let is_near = |a: i32, b: i32| a.abs_diff(b) <= TOLERANCE;
    let is_same = |(a, b): (&Item, &Item)| {
        (a.command, a.frame, a.z) == (b.command, b.frame, b.z) && is_near(a.x, b.x) && is_near(a.y, b.y)
    };
    if items.len() != uploaded.len() || !items.iter().zip(&uploaded).all(is_same) {
        return Err(Failure::Protocol(format!("the vehicle has another mission: {items:?}")));
    }
    Ok(format!("{} items as uploaded", items.len()))
}

/// Clears the mission, and looks whether it is gone.
fn clear(vehicle: &mut Udp) -> Result<String, Failure> {
    vehicle.clear_mission()?;
    match vehicle.download_mission()?.len() {
        0 => Ok("no items".to_owned()),
        left => Err(Failure::Protocol(format!("{left} items are left"))),
    }
}

/// Arms the vehicle. It may need a moment after its start, for example until it has a position: then TEMPORARILY_REJECTED.
fn arm(vehicle: &mut Udp) -> Result<String, Failure> {
    for _ in 1..ARM_TRIES {
        match vehicle.arm() {
            Err(Failure::Command { result: MavResult::TEMPORARILY_REJECTED, .. }) => vehicle.wait(ARM_INTERVAL)?,
            result => return result.and_then(|()| reports(vehicle, true)),
        }
    }
    vehicle.arm().and_then(|()| reports(vehicle, true))
}

/// Waits until the vehicle's heartbeats say that it is armed, or disarmed.
fn reports(vehicle: &mut Udp, is_armed: bool) -> Result<String, Failure> {
    let what = if is_armed { "armed" } else { "disarmed" };
    let end = vehicle.station().now() + REPORTED_WITHIN;
    loop {
        let station = vehicle.station();
        let component = station.target().and_then(|target| station.seen().component(target));
        if component.is_some_and(|component| component.is_armed() == is_armed) {
            return Ok(what.to_owned());
        }
        if vehicle.step()? >= end {
            return Err(Failure::Protocol(format!("accepted, but the heartbeats do not say {what}")));
        }
    }
}
