//! Dialogues that run beside others for as long as they take.

use crate::{Dialogue, Drive, Failure, Station};
use mavstack::{Duration, Instant};

/// A ground station beside whose dialogues another one runs: see [`alongside`](crate::GroundStation::alongside).
///
/// The other one sees every frame. When it ends by itself, nothing more is sent, and its result is dropped.
#[derive(Debug)]
pub struct Alongside<'a, T, B> {
    drive: &'a mut T,
    side: Option<B>,
    /// The frames that it has seen, see [`Station::overhear`].
    heard: u64,
}

impl<'a, T: Drive, B: Dialogue> Alongside<'a, T, B> {
    pub(crate) fn new(drive: &'a mut T, side: B) -> Self {
        let heard = drive.station().frames_heard();
        Self { drive, side: Some(side), heard }
    }

    /// Returns what it drives.
    pub fn inner(&mut self) -> &mut T {
        self.drive
    }
}

impl<T: Drive, B: Dialogue> Drive for Alongside<'_, T, B> {
    fn station(&mut self) -> &mut Station {
        self.drive.station()
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        let now = self.drive.step()?;
        if let Some(side) = &mut self.side
            && self.drive.station().overhear(now, side, &mut self.heard).is_some()
        {
            self.side = None;
        }
        Ok(now)
    }
}

/// Lets time pass.
#[derive(Debug)]
pub struct Wait {
    time: Duration,
    begin: Option<Instant>,
}

impl Wait {
    /// Waits for this long.
    pub fn new(time: Duration) -> Self {
        Self { time, begin: None }
    }
}

impl Dialogue for Wait {
    type Output = ();

    fn poll(&mut self, io: &mut crate::Io<'_>) -> Option<Result<(), Failure>> {
        let begin = *self.begin.get_or_insert(io.now());
        (io.now() - begin >= self.time).then_some(Ok(()))
    }

    fn receive(&mut self, _: &mut crate::Io<'_>, _: &crate::Received) {}
}
