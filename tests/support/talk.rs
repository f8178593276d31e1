//! Clients of `mavstack-station` on the lines of the tests.

use super::{Gcs, VEHICLE};
use mavstack::{Address, Instant};
use mavstack_station::{Client, Dialogue, Failure, Station};

/// A client in a dialogue with the vehicle. It shares the line of a [`Gcs`], which sends the heartbeats. Call [`poll`](Self::poll) after
/// every step.
#[derive(Debug)]
pub struct Talk<D: Dialogue> {
    pub dialogue: D,
    station: Station,
    /// The number of frames of [`Gcs::received`] that it has taken.
    seen: usize,
    result: Option<Result<D::Output, Failure>>,
}

impl<D: Dialogue> Talk<D> {
    pub fn new(client: Client, address: Address, dialogue: D) -> Self {
        let station = Station::new(client).with_address(address).with_target(VEHICLE);
        Self { dialogue, station, seen: 0, result: None }
    }

    /// The ground station has forgotten what it has received.
    pub fn forgot(&mut self) {
        self.seen = 0;
    }

    /// Takes what was received since the last call, and sends what is due. Returns the result once the dialogue has ended.
    pub fn poll(&mut self, now: Instant, gcs: &mut Gcs) -> Option<&Result<D::Output, Failure>> {
        if self.result.is_none() {
            gcs.received.iter().skip(self.seen).for_each(|frame| self.station.receive(now, &frame.raw));
            self.seen = gcs.received.len();
            self.result = self.station.advance(now, &mut self.dialogue);
            gcs.send_raw(&self.station.take_output());
        }
        self.result.as_ref()
    }

    /// Returns what the dialogue has ended with.
    ///
    /// # Panics
    ///
    /// It has failed, or not ended.
    pub fn output(&self) -> &D::Output {
        self.result.as_ref().expect("it has ended").as_ref().expect("it has succeeded")
    }
}
