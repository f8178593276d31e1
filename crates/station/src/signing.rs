//! Message signing: a key for the vehicle, and signed frames from then on.
//!
//! | | QGroundControl | MAVProxy, pymavlink, MAVSDK |
//! |---|---|---|
//! | SETUP_SIGNING is sent | twice, because it has no answer | once |
//! | frames are signed | at once | at once |
//! | without a signed frame of the vehicle | it stops to sign | it goes on to sign |
//!
//! A [`Station`](crate::Station) with a key raises its timestamp to that of every frame with a correct signature, as all clients
//! do that use MAVLink's C library or pymavlink. MAVSDK has no signing of its own: an application would do as MAVProxy.

use crate::{Client, Dialogue, Failure, Io, Received};
use mavstack::dialect::SetupSigning;
use mavstack::message::Secret;
use mavstack::{Duration, Instant};

/// How long a frame is awaited that proves the change.
const PROOF: Duration = Duration::from_secs(5);

/// Units of a timestamp in a second: it counts 10 µs since 2015-01-01 00:00 UTC.
pub const PER_SECOND: u64 = 100_000;

/// Returns the timestamp of a time (s since 1970, UTC).
pub const fn timestamp(unix_secs: u64) -> u64 {
    /// 2015-01-01 00:00 UTC.
    const EPOCH: u64 = 1_420_070_400;
    unix_secs.saturating_sub(EPOCH) * PER_SECOND
}

/// Gives the vehicle a key by SETUP_SIGNING, and signs with it from then on. Ends with the first frame of the vehicle that is signed
/// with it.
#[derive(Debug)]
pub struct Setup {
    key: [u8; 32],
    timestamp: u64,
    end: Option<Instant>,
    is_proved: bool,
}

impl Setup {
    /// Gives a key, with the [`timestamp`] of the current time.
    pub fn new(key: [u8; 32], timestamp: u64) -> Self {
        Self { key, timestamp, end: None, is_proved: false }
    }
}

/// Makes the vehicle forget its key: SETUP_SIGNING with zeros. Signs nothing from then on. Ends with the first frame of the vehicle
/// that is not signed.
#[derive(Debug, Default)]
pub struct Remove {
    end: Option<Instant>,
    is_proved: bool,
}

impl Remove {
    /// Creates the dialogue.
    pub fn new() -> Self {
        Self::default()
    }
}

fn send(io: &mut Io<'_>, key: [u8; 32], initial_timestamp: u64) {
    let target = io.target();
    let message = SetupSigning {
        initial_timestamp,
        target_system: target.system.wire(),
        target_component: target.component.wire(),
        secret_key: Secret(key),
    };
    let copies = if io.client() == Client::QGroundControl { 2 } else { 1 };
    (0..copies).for_each(|_| io.send(&message));
}

impl Dialogue for Setup {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let Some(end) = self.end else {
            send(io, self.key, self.timestamp);
            io.set_signing(Some((self.key, self.timestamp)));
            self.end = Some(io.now() + PROOF);
            return None;
        };
        if self.is_proved {
            return Some(Ok(()));
        }
        if io.now() < end {
            return None;
        }
        if io.client() == Client::QGroundControl {
            io.set_signing(None);
        }
        Some(Err(Failure::timeout("SETUP_SIGNING", 1)))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.is_proved |= self.end.is_some() && frame.source() == io.target() && frame.is_signed;
    }
}

impl Dialogue for Remove {
    type Output = ();

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<(), Failure>> {
        let Some(end) = self.end else {
            send(io, [0; 32], 0);
            io.set_signing(None);
            self.end = Some(io.now() + PROOF);
            return None;
        };
        if self.is_proved {
            return Some(Ok(()));
        }
        (io.now() >= end).then(|| Err(Failure::timeout("SETUP_SIGNING", 1)))
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        self.is_proved |= self.end.is_some() && frame.source() == io.target() && !frame.header.is_signed();
    }
}
