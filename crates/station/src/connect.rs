//! What a client does when it finds a vehicle.

use crate::{Dialogue, Failure, Io, Received};
use mavstack::dialect::Heartbeat;
use mavstack::{Address, Duration, Instant};

/// How long to wait for the first heartbeat.
const WITHIN: Duration = Duration::from_secs(10);

/// Waits for the heartbeat of an autopilot.
#[derive(Debug, Default)]
pub struct Connect {
    end: Option<Instant>,
}

/// The vehicle that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Connected {
    /// Its address.
    pub vehicle: Address,
    /// Its heartbeat.
    pub heartbeat: Heartbeat,
}

impl Connect {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Dialogue for Connect {
    type Output = Connected;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Connected, Failure>> {
        let end = *self.end.get_or_insert(io.now() + WITHIN);
        let vehicle = io.target();
        if let Some(heartbeat) = io.seen().component(vehicle).and_then(|component| component.heartbeat) {
            return Some(Ok(Connected { vehicle, heartbeat }));
        }
        (io.now() >= end).then_some(Err(Failure::NoVehicle))
    }

    fn receive(&mut self, _: &mut Io<'_>, _: &Received) {}
}
