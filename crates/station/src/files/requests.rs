//! Requests that wait for their answers.

use super::packet::Packet;
use super::rules::{Abort, Repeat, RoundTrip, Step};
use crate::{Client, Failure, Io};
use mavstack::dialect::{MavFtpErr, MavFtpOpcode};
use mavstack::{Duration, Instant};

/// When a request that is repeated without an end is given up: no client does, but its user.
const HOPELESS: Duration = Duration::from_secs(60);

/// How long MAVSDK waits for a free session.
const NO_SESSION: Duration = Duration::from_secs(3);

/// The requests of one dialogue: numbers, repetitions, and which answer belongs to which.
#[derive(Debug)]
pub(super) struct Requests {
    client: Client,
    /// What the requests are about, for failures.
    path: String,
    /// The number of the next request.
    next: u16,
    session: u8,
    /// Whether a file was opened, or should have been.
    has_file: bool,
    trip: RoundTrip,
    pending: Vec<Pending>,
    /// The number of packets sent.
    sent: u64,
    /// When the last packet was received.
    heard: Instant,
}

#[derive(Debug)]
struct Pending {
    step: Step,
    packet: Packet,
    repeat: Repeat,
    sends: u32,
    /// Its place among all packets that were sent.
    place: u64,
    due: Instant,
}

/// A request that was answered.
#[derive(Debug)]
pub(super) struct Answered {
    pub(super) step: Step,
    pub(super) request: Packet,
    /// How often it was sent.
    pub(super) sends: u32,
}

impl Requests {
    /// Begins with a session and a number as the client would now.
    pub(super) fn begin(io: &Io<'_>, path: &str) -> Self {
        // A client that has been running for a while has used others before, so the time decides. pymavlink's object counts from 0.
        let elapsed = io.now().as_millis() / 4;
        let (session, next) = match io.client() {
            Client::QGroundControl => (0, (elapsed << 1) as u16 | 1),
            Client::Mavsdk => (0, 0),
            Client::MavProxy => (elapsed as u8, 0),
            Client::Pymavlink => io.file_session(),
        };
        Self {
            client: io.client(),
            path: path.to_owned(),
            next,
            session,
            has_file: false,
            trip: RoundTrip::default(),
            pending: Vec::new(),
            sent: 0,
            heard: io.now(),
        }
    }

    pub(super) fn client(&self) -> Client {
        self.client
    }

    /// Returns the number of requests of a kind that wait.
    pub(super) fn waiting(&self, step: Step) -> usize {
        self.pending.iter().filter(|pending| pending.step == step).count()
    }

    /// Drops the requests that wait.
    pub(super) fn clear(&mut self) {
        self.pending.clear();
    }

    fn fresh_number(&mut self) -> u16 {
        let number = self.next;
        self.next = match self.client {
            // The number between is that of the answer.
            Client::QGroundControl => number.wrapping_add(2),
            Client::MavProxy => number.wrapping_add(1) % 256,
            Client::Mavsdk | Client::Pymavlink => number.wrapping_add(1),
        };
        number
    }

    /// Sends a request, and waits for its answer.
    pub(super) fn send(&mut self, io: &mut Io<'_>, step: Step, packet: Packet) {
        let packet = self.transmit(io, packet);
        self.has_file |= matches!(step, Step::Open | Step::Create);
        self.trip.sent(packet.number, io.now());
        self.sent += 1;
        let (due, repeat, place) = (io.now() + self.timeout(step), self.client.ftp_repeat(step), self.sent);
        self.pending.push(Pending { step, packet, repeat, sends: 1, place, due });
    }

    /// Sends a request whose answer is not awaited.
    pub(super) fn send_and_forget(&mut self, io: &mut Io<'_>, packet: Packet) {
        self.transmit(io, packet);
    }

    fn transmit(&mut self, io: &mut Io<'_>, packet: Packet) -> Packet {
        let packet = Packet { number: self.fresh_number(), session: self.session, ..packet };
        io.send(&packet.message(io.target()));
        // pymavlink counts the sessions that it has ended.
        let has_ended = packet.opcode == MavFtpOpcode::TERMINATESESSION;
        io.set_file_session(self.session.wrapping_add(u8::from(has_ended)), self.next);
        packet
    }

    /// Returns how long an answer is awaited now.
    pub(super) fn timeout(&self, step: Step) -> Duration {
        self.trip.timeout(self.client.ftp_patience(step).timeout)
    }

    /// Repeats what was not answered in time. Returns the failure once it was sent often enough.
    pub(super) fn repeat_overdue(&mut self, io: &mut Io<'_>) -> Result<(), Gone> {
        let now = io.now();
        for index in 0..self.pending.len() {
            if now < self.pending[index].due {
                continue;
            }
            let Pending { step, sends, repeat, .. } = self.pending[index];
            if sends >= self.client.ftp_patience(step).sends || now > self.heard + HOPELESS {
                return Err(Gone { step, sends });
            }
            if repeat == Repeat::NewNumber {
                self.pending[index].packet.number = self.fresh_number();
            }
            self.sent += 1;
            let (due, place) = (now + self.timeout(step), self.sent);
            let pending = &mut self.pending[index];
            (pending.sends, pending.due, pending.place) = (sends.saturating_add(1), due, place);
            self.trip.repeated(pending.packet.number);
            io.send(&pending.packet.message(io.target()));
        }
        Ok(())
    }

    /// Whether a packet belongs to the session, as the client sees it.
    pub(super) fn is_ours(&self, packet: &Packet) -> bool {
        let opens = [MavFtpOpcode::OPENFILERO, MavFtpOpcode::CREATEFILE].contains(&packet.request);
        let transfers = [MavFtpOpcode::READFILE, MavFtpOpcode::BURSTREADFILE, MavFtpOpcode::WRITEFILE];
        let is_checked = match self.client {
            Client::QGroundControl => transfers.contains(&packet.request),
            Client::Mavsdk => false,
            Client::MavProxy => true,
            Client::Pymavlink => !(opens && packet.opcode == MavFtpOpcode::ACK),
        };
        !is_checked || packet.session == self.session
    }

    /// Takes an answer. Returns the request that it answers, which then waits no longer.
    pub(super) fn answer(&mut self, io: &Io<'_>, packet: &Packet) -> Option<Answered> {
        if !self.is_ours(packet) {
            return None;
        }
        self.heard = io.now();
        let mask = if self.client == Client::MavProxy { 0xFF } else { u16::MAX };
        let expected = packet.number.wrapping_sub(1) & mask;
        let matches =
            |pending: &Pending| pending.packet.opcode == packet.request && pending.packet.number & mask == expected;
        let index = self.pending.iter().position(matches)?;
        self.trip.answered(expected, io.now());
        if packet.error() == Some(MavFtpErr::NOSESSIONSAVAILABLE) && self.waits_for_session(io.now(), index) {
            return None;
        }
        let Pending { step, packet: request, sends, place, .. } = self.pending.remove(index);
        if step == Step::Write && self.client.ftp_window() > 1 {
            // A server works in order, so those that were sent before were lost.
            self.pending.iter_mut().filter(|other| other.place < place).for_each(|lost| lost.due = io.now());
        }
        let opened = matches!(step, Step::Open | Step::Create) && packet.error().is_none();
        if opened && matches!(self.client, Client::QGroundControl | Client::Pymavlink) {
            self.session = packet.session;
        }
        Some(Answered { step, request, sends })
    }

    /// Sends the request later if the client waits for a free session.
    fn waits_for_session(&mut self, now: Instant, index: usize) -> bool {
        let step = self.pending[index].step;
        let wait = match (self.client, step) {
            (Client::Mavsdk, Step::Open) => NO_SESSION,
            (Client::MavProxy, _) => self.timeout(step),
            _ => return false,
        };
        let pending = &mut self.pending[index];
        pending.due = now + wait;
        if self.client == Client::MavProxy {
            (pending.sends, pending.repeat) = (1, Repeat::NewNumber);
        }
        true
    }

    /// Notes a packet of a burst. QGroundControl and pymavlink go on with the numbers behind it.
    pub(super) fn follow(&mut self, io: &Io<'_>, packet: &Packet) {
        self.heard = io.now();
        let behind = packet.number.wrapping_add(if packet.is_last { 1 } else { 2 });
        match self.client {
            Client::QGroundControl => self.next = behind,
            Client::Pymavlink if packet.number.wrapping_sub(self.next) < 0x8000 => {
                self.next = packet.number.wrapping_add(1);
            }
            _ => {}
        }
    }

    /// Whether a packet of a burst is the one that comes next by its number: QGroundControl looks at it.
    pub(super) fn is_in_order(&self, packet: &Packet) -> bool {
        packet.number.wrapping_add(1) == self.next
    }

    /// Whether a packet of a burst belongs to an earlier request by its number: QGroundControl ignores it.
    pub(super) fn is_old(&self, packet: &Packet) -> bool {
        self.client == Client::QGroundControl && packet.number.wrapping_add(1).wrapping_sub(self.next) >= 0x8000
    }

    /// Takes back the last number: QGroundControl repeats a burst with it, whatever has arrived since.
    pub(super) fn reuse_number(&mut self) {
        self.next = self.next.wrapping_sub(2);
    }

    /// Returns a failure because nothing was heard for so long that a user would give up.
    pub(super) fn is_hopeless(&self, now: Instant) -> bool {
        now > self.heard + HOPELESS
    }

    /// Returns the failure of a refused request.
    pub(super) fn refusal(&self, error: MavFtpErr) -> Failure {
        Failure::File { path: self.path.clone(), error, text: None }
    }

    /// Returns the failure of a request that was not answered.
    pub(super) fn timed_out(&self, gone: Gone) -> Failure {
        Failure::timeout(format!("{:?} of {:?} by FTP", gone.step, self.path), gone.sends)
    }

    /// Ends after a failure as the client does: many leave the session open.
    pub(super) fn abort(&mut self, io: &mut Io<'_>, failure: Failure) -> Failure {
        self.clear();
        let is_refusal = matches!(failure, Failure::File { .. });
        let terminates = match self.client.ftp_abort() {
            Abort::Never => false,
            Abort::AfterRefusal => is_refusal,
            Abort::OfFile => self.has_file,
            Abort::Always => true,
        };
        if terminates {
            self.send_and_forget(io, Packet::request(MavFtpOpcode::TERMINATESESSION, 0, &[]));
        }
        failure
    }
}

/// A request was sent as often as the client does, without an answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gone {
    pub(super) step: Step,
    pub(super) sends: u32,
}
