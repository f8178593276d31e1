//! Drives the station, records what it receives, and measures.

use std::collections::VecDeque;

use mavstack::{Address, Duration, Instant};
use mavstack_station::{Client, Dialogue, Drive, Failure, Io, Received, Station};

use crate::echo::Echo;
use crate::trace::{Probe, Trace};

/// Keeps the frames of everything but ground stations.
#[derive(Debug, Default)]
struct Recorder {
    frames: Vec<Received>,
}

impl Dialogue for Recorder {
    type Output = ();

    fn poll(&mut self, _: &mut Io<'_>) -> Option<Result<(), Failure>> {
        None
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        if frame.source().system == io.target().system {
            self.frames.push(frame.clone());
        }
    }
}

/// What is sent during a measurement, and for how long.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// How long it takes. Probes that are not answered then are awaited.
    pub time: Duration,
    /// The mean time between two probes.
    pub probe_every: Duration,
    /// How long a probe is awaited; at most the examiner's own patience.
    pub patience: Duration,
    /// Bytes per second of other frames that are sent besides.
    pub fill: f64,
}

impl Load {
    /// Nothing but probes, ten in a second.
    pub fn calm(time: Duration) -> Self {
        Self { time, probe_every: Duration::from_millis(100), patience: Duration::MAX, fill: 0.0 }
    }
}

/// Moves an examination forward: a [`Drive`] that keeps all frames, with which the checks measure.
#[derive(Debug)]
pub struct Examiner<'a, T> {
    drive: &'a mut T,
    recorder: Recorder,
    /// The frames that the recorder has seen, see [`Station::overhear`].
    heard: u64,
    /// How long an answer may take, by the first one.
    pub(crate) patience: Duration,
    /// What the probes are.
    pub(crate) echo: Echo,
    /// Spreads the probes, so that they meet a periodic poll in all phases.
    random: u64,
}

impl<T: Drive> Drive for Examiner<'_, T> {
    fn station(&mut self) -> &mut Station {
        self.drive.station()
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        let now = self.drive.step()?;
        let _ = self.drive.station().overhear(now, &mut self.recorder, &mut self.heard);
        Ok(now)
    }
}

impl<'a, T: Drive> Examiner<'a, T> {
    /// Takes over what drives the station.
    pub fn new(drive: &'a mut T) -> Self {
        let heard = drive.station().frames_heard();
        Self {
            drive,
            recorder: Recorder::default(),
            heard,
            patience: Duration::MAX,
            echo: Echo::Command,
            random: 0x9E37_79B9,
        }
    }

    /// Returns the time.
    pub fn now(&mut self) -> Instant {
        self.station().now()
    }

    /// Returns the vehicle.
    pub fn target(&mut self) -> Address {
        self.station().target().unwrap_or(Address::new(1, 1))
    }

    /// Returns all frames recorded so far.
    pub fn frames(&self) -> &[Received] {
        &self.recorder.frames
    }

    /// Behaves as another client from now on.
    pub fn become_client(&mut self, client: Client) {
        let station = self.drive.station();
        let target = station.target();
        *station = Station::new(client);
        if let Some(target) = target {
            station.set_target(target);
        }
        self.heard = 0;
    }

    /// Runs `part`, and returns a trace of what was received meanwhile.
    ///
    /// # Errors
    ///
    /// The transport failed.
    pub fn trace(&mut self, part: impl FnOnce(&mut Self) -> Result<Vec<Probe>, Failure>) -> Result<Trace, Failure> {
        let (began, first, before) = (self.now(), self.recorder.frames.len(), self.station().counters());
        let probes = part(self)?;
        let frames = self.recorder.frames[first..].to_vec();
        let mut trace = Trace { began, ended: self.now(), frames, probes, ..Trace::default() };
        trace.add_damage(before, self.station().counters());
        Ok(trace)
    }

    /// Lets time pass, and sends probes and other frames meanwhile.
    ///
    /// # Errors
    ///
    /// The transport failed.
    pub fn measure(&mut self, load: Load) -> Result<Trace, Failure> {
        self.trace(|examiner| examiner.probe(load))
    }

    /// Sends a probe whenever one is due and the last one was answered or given up.
    pub(crate) fn probe(&mut self, load: Load) -> Result<Vec<Probe>, Failure> {
        let (began, target) = (self.now(), self.target());
        let end = began + load.time;
        let (mut probes, mut due, mut filled) = (Vec::<Probe>::new(), began, 0.0);
        let (mut read, mut is_open) = (self.recorder.frames.len(), false);
        loop {
            let now = self.step()?;
            let was_open = is_open;
            is_open = self.answer(&mut probes, &mut read, now, load.patience.min(self.patience));
            if was_open && !is_open {
                due = now + self.spread(load.probe_every);
            }
            if now >= end && !is_open {
                return Ok(probes);
            }
            if now >= end {
                continue;
            }
            filled = self.fill(load.fill, now - began, filled);
            if !is_open && now >= due {
                let (echo, station) = (self.echo, self.drive.station());
                echo.send(station, now, target);
                probes.push(Probe { sent: now, answered: None });
                is_open = true;
            }
        }
    }

    /// Looks for the answer to the last probe. Returns whether it is still awaited.
    fn answer(&self, probes: &mut [Probe], read: &mut usize, now: Instant, patience: Duration) -> bool {
        let new = &self.recorder.frames[*read..];
        *read = self.recorder.frames.len();
        let Some(probe) = probes.last_mut().filter(|probe| probe.answered.is_none()) else { return false };
        let answer = new.iter().find(|frame| self.echo.is_answer(frame, probe.sent));
        probe.answered = answer.map(|frame| frame.at);
        probe.answered.is_none() && now - probe.sent < patience
    }

    /// Sends heartbeats, as many as the rate allows. Returns the bytes sent.
    fn fill(&mut self, rate: f64, elapsed: Duration, mut filled: f64) -> f64 {
        let owed = rate * elapsed.as_micros() as f64 / 1e6;
        while filled + FILL_LEN as f64 <= owed {
            self.send_fill();
            filled += FILL_LEN as f64;
        }
        filled
    }

    /// Sends a frame that needs no answer: a heartbeat.
    pub(crate) fn send_fill(&mut self) {
        let station = self.drive.station();
        let heartbeat = station.client().heartbeat();
        station.send(&heartbeat);
    }

    /// Returns a random time with this mean, up to twice as long.
    fn spread(&mut self, mean: Duration) -> Duration {
        // Xorshift.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        let micros = mean.as_micros();
        Duration::from_micros(self.random % (2 * micros).max(1))
    }

    /// Lets time pass until `is_reached` returns true for a frame received since, at most `limit`. Returns whether it did.
    ///
    /// # Errors
    ///
    /// The transport failed.
    pub fn until(&mut self, limit: Duration, is_reached: impl Fn(&Received) -> bool) -> Result<bool, Failure> {
        let (end, first) = (self.now() + limit, self.recorder.frames.len());
        while self.step()? < end {
            if self.recorder.frames[first..].iter().any(&is_reached) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Sends bytes one after another, with a pause behind each, so that no buffer of the vehicle holds more than one.
    ///
    /// # Errors
    ///
    /// The transport failed.
    pub(crate) fn send_slowly(&mut self, bytes: &[u8], pause: Duration) -> Result<(), Failure> {
        let mut bytes: VecDeque<u8> = bytes.iter().copied().collect();
        let mut due = self.now();
        while let Some(byte) = bytes.front().copied() {
            if self.step()? >= due {
                bytes.pop_front();
                self.station().send_raw(&[byte]);
                due = self.now() + pause;
            }
        }
        Ok(())
    }
}

/// The bytes of a heartbeat.
pub(crate) const FILL_LEN: usize = 21;
