//! Connects to a vehicle over UDP as each client does, and prints what it learns: `cargo run -p mavstack-station --example connect -- mavsdk`.
//!
//! It listens on port 14550 of this computer, where vehicles and simulators look for a ground station, or on the port that follows the
//! client's name.

mod udp;

use mavstack_station::names::Named;
use mavstack_station::{Drive, GroundStation};

use udp::{Udp, client_named};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let client = client_named(&std::env::args().nth(1).unwrap_or_default());
    let port = std::env::args().nth(2).map_or(Ok(14_550), |port| port.parse())?;
    let mut vehicle = Udp::listen(port, client)?;
    println!("{client} listens on port {}", vehicle.port()?);
    let connected = vehicle.connect()?;
    let address = connected.vehicle;
    println!(
        "system {} component {}: {}, {}",
        address.system.wire(),
        address.component.wire(),
        connected.heartbeat.r#type.named(),
        connected.heartbeat.autopilot.named(),
    );
    println!("{} modes, {} parameters", connected.modes.len(), connected.parameters.len());
    for plan in connected.plans.iter().flatten() {
        println!("a plan of {} items", plan.items.len());
    }
    for failure in &connected.failures {
        println!("missing: {failure}");
    }
    for text in vehicle.station().seen().texts() {
        println!("{}: {}", text.severity.named(), text.text);
    }
    Ok(())
}
