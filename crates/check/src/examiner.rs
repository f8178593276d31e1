//! Drives the station, records what it receives, and measures.

use std::collections::VecDeque;

use mavstack::{Address, Duration, Instant};
use mavstack_station::{Client, Dialogue, Drive, Failure, GroundStation, Io, Received, Sending, Station};

use crate::echo::Echo;
use crate::trace::{Probe, Trace, wire_len};

/// How old the last heartbeat may be when something is changed.
const FRESH: Duration = Duration::from_secs(2);
/// How long a fresh heartbeat is awaited, and how old the last one may be when a request is sent.
const HEARTBEAT_PATIENCE: Duration = Duration::from_secs(10);

/// Keeps the frames of the vehicle, and of all components as long as it is not known.
#[derive(Debug, Default)]
struct Recorder {
    vehicle: Option<Address>,
    frames: Vec<Received>,
    /// The bytes of other frames, which take their share of the line.
    other_bytes: usize,
}

impl Recorder {
    /// Keeps the frames of this vehicle alone.
    fn keep(&mut self, vehicle: Option<Address>) {
        if let Some(address) = vehicle.filter(|_| vehicle != self.vehicle) {
            self.frames.retain(|frame| frame.source() == address);
            self.vehicle = vehicle;
        }
    }
}

impl Dialogue for Recorder {
    type Output = ();

    fn poll(&mut self, _: &mut Io<'_>) -> Option<Result<(), Failure>> {
        None
    }

    fn receive(&mut self, _: &mut Io<'_>, frame: &Received) {
        if self.vehicle.is_none_or(|vehicle| vehicle == frame.source()) {
            self.frames.push(frame.clone());
        } else {
            self.other_bytes += wire_len(frame);
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
    pub fn idle(time: Duration) -> Self {
        Self { time, probe_every: Duration::from_millis(100), patience: Duration::MAX, fill: 0.0 }
    }
}

/// Moves an examination forward: a [`Drive`] that keeps the vehicle's frames, with which the checks measure.
///
/// It sends nothing until [`begin`](Self::begin), and nothing more once a heartbeat says that a vehicle is armed: every step
/// then fails with [`Failure::Armed`].
#[derive(Debug)]
pub struct Examiner<'a, T> {
    drive: &'a mut T,
    recorder: Recorder,
    /// When it sends; [`Sending::Never`] before it begins.
    sending: Sending,
    /// The frames that the recorder has seen, see [`Station::overhear`].
    heard: u64,
    /// How long an answer may take, by the first one.
    pub(crate) patience: Duration,
    /// When it has begun to send.
    begun: Instant,
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
        let station = self.drive.station();
        self.recorder.keep(station.target());
        let _ = station.overhear(now, &mut self.recorder, &mut self.heard);
        let is_armed = station.is_any_armed();
        let silence = now - self.last_heartbeat().unwrap_or(self.begun).max(self.begun);
        match self.sending {
            Sending::Always | Sending::Never => Ok(now),
            _ if is_armed => Err(self.stop(Failure::Armed)),
            Sending::WhileDisarmed if silence > HEARTBEAT_PATIENCE => Err(self.stop(Failure::NoVehicle)),
            Sending::WhileDisarmed | Sending::UnlessArmed => Ok(now),
        }
    }
}

impl<'a, T: Drive> Examiner<'a, T> {
    /// Takes over what drives the station.
    pub fn new(drive: &'a mut T) -> Self {
        let heard = drive.station().frames_heard();
        drive.station().set_sending(Sending::Never);
        Self {
            drive,
            recorder: Recorder::default(),
            sending: Sending::Never,
            begun: Instant::ZERO,
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

    /// Returns all frames of the vehicle recorded so far.
    pub fn frames(&self) -> &[Received] {
        &self.recorder.frames
    }

    /// Returns the frames of the vehicle recorded after the first `count`.
    pub(crate) fn frames_after(&self, count: usize) -> &[Received] {
        self.recorder.frames.get(count..).unwrap_or_default()
    }

    /// Sends from now on, while `sending` allows it.
    pub fn begin(&mut self, sending: Sending) {
        (self.sending, self.begun) = (sending, self.now());
        self.station().set_sending(sending);
    }

    /// Sends nothing from now on. Returns `failure`, with which the examination ends.
    fn stop(&mut self, failure: Failure) -> Failure {
        self.station().set_sending(Sending::Never);
        failure
    }

    /// Returns when the vehicle's last heartbeat was received, if this client has heard one.
    pub(crate) fn last_heartbeat(&mut self) -> Option<Instant> {
        let target = self.target();
        self.drive.station().seen().component(target).and_then(|vehicle| vehicle.heartbeats.last().copied())
    }

    /// Waits until a heartbeat of the last two seconds says that the vehicle is disarmed. Call it before everything that changes the
    /// vehicle.
    ///
    /// # Errors
    ///
    /// [`Failure::Armed`], [`Failure::NoVehicle`] if no heartbeat came, or the transport failed.
    pub fn ensure_disarmed(&mut self) -> Result<(), Failure> {
        let end = self.now() + HEARTBEAT_PATIENCE;
        loop {
            let now = self.step()?;
            if self.last_heartbeat().is_some_and(|at| now - at <= FRESH) {
                return Ok(());
            }
            if now >= end {
                return Err(self.stop(Failure::NoVehicle));
            }
        }
    }

    /// Behaves as another client from now on, and waits for the vehicle's heartbeat. It leaves the streams alone.
    ///
    /// # Errors
    ///
    /// As [`ensure_disarmed`](Self::ensure_disarmed).
    pub fn become_client(&mut self, client: Client) -> Result<(), Failure> {
        // What the last client has said to the end is sent.
        self.wait(Duration::from_millis(50))?;
        let (now, target) = (self.now(), self.target());
        let mut station = Station::new(client).with_target(target).without_stream_requests();
        // Its dialogues begin now.
        station.receive(now, &[]);
        *self.drive.station() = station;
        self.heard = 0;
        self.begin(self.sending);
        self.ensure_disarmed()
    }

    /// Runs `part`. Returns a trace of what was received meanwhile, and the result of `part`, which may have ended early.
    pub fn trace(
        &mut self,
        part: impl FnOnce(&mut Self, &mut Vec<Probe>) -> Result<(), Failure>,
    ) -> (Trace, Result<(), Failure>) {
        let (began, first, before) = (self.now(), self.recorder.frames.len(), self.station().counters());
        let (mut probes, others) = (Vec::new(), self.recorder.other_bytes);
        let result = part(self, &mut probes);
        let frames = self.frames_after(first).to_vec();
        let mut trace = Trace { began, ended: self.now(), frames, probes, ..Trace::default() };
        trace.other_bytes = self.recorder.other_bytes - others;
        trace.add_damage(before, self.station().counters());
        (trace, result)
    }

    /// Listens, and sends nothing besides what the station sends by itself.
    pub fn listen(&mut self, time: Duration) -> (Trace, Result<(), Failure>) {
        self.trace(|examiner, _| examiner.wait(time))
    }

    /// Lets time pass, and sends probes and other frames meanwhile. Returns what was received, and whether it ended early.
    pub fn measure(&mut self, load: Load) -> (Trace, Result<(), Failure>) {
        self.trace(|examiner, probes| examiner.probe(load, probes))
    }

    /// Sends a probe whenever one is due and the last one was answered or given up.
    pub(crate) fn probe(&mut self, load: Load, probes: &mut Vec<Probe>) -> Result<(), Failure> {
        let (began, target) = (self.now(), self.target());
        let end = began + load.time;
        let (mut due, mut filled) = (began, 0.0);
        let (mut read, mut is_open) = (self.recorder.frames.len(), false);
        loop {
            let now = self.step()?;
            let was_open = is_open;
            is_open = self.answer(probes, &mut read, now, load.patience.min(self.patience));
            if was_open && !is_open {
                due = now + self.spread(load.probe_every);
            }
            if now >= end && !is_open {
                return Ok(());
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
        let new = self.frames_after(*read);
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
            if self.frames_after(first).iter().any(&is_reached) {
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
