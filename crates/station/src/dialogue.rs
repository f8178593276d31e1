//! Dialogues with a vehicle, and what drives them.

use crate::station::Sender;
use crate::{Client, Failure, Received, Seen, Station};
use mavstack::{Address, Duration, Instant, Message};

/// How long [`Drive::run`] waits for the text with the reason of a refusal: the answer is sent first.
const TEXT_WITHIN: Duration = Duration::from_millis(500);

/// A dialogue with a vehicle: a state machine that sends, times out and retries.
///
/// [`poll`](Self::poll) is called first, then in turn with [`receive`](Self::receive) until it returns a result.
pub trait Dialogue {
    /// What it ends with.
    type Output;

    /// Sends what is due. Returns the result once the dialogue has ended; it is not called again then.
    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Self::Output, Failure>>;

    /// Takes a received frame, of any sender.
    fn receive(&mut self, io: &mut Io<'_>, frame: &Received);
}

impl<D: Dialogue + ?Sized> Dialogue for &mut D {
    type Output = D::Output;

    fn poll(&mut self, io: &mut Io<'_>) -> Option<Result<Self::Output, Failure>> {
        (**self).poll(io)
    }

    fn receive(&mut self, io: &mut Io<'_>, frame: &Received) {
        (**self).receive(io, frame);
    }
}

/// The station as a dialogue sees it.
#[derive(Debug)]
pub struct Io<'a> {
    now: Instant,
    sender: &'a mut Sender,
    seen: &'a Seen,
}

impl<'a> Io<'a> {
    pub(crate) fn new(now: Instant, sender: &'a mut Sender, seen: &'a Seen) -> Self {
        Self { now, sender, seen }
    }

    /// Returns the time.
    pub fn now(&self) -> Instant {
        self.now
    }

    /// Returns the client that the station behaves as.
    pub fn client(&self) -> Client {
        self.sender.client
    }

    /// Returns the station's own address.
    pub fn address(&self) -> Address {
        self.sender.address
    }

    /// Returns the vehicle that the station speaks with; component 1 of system 1 as long as none was heard.
    pub fn target(&self) -> Address {
        self.sender.target.unwrap_or(Address::new(1, 1))
    }

    /// Returns what was received.
    pub fn seen(&self) -> &'a Seen {
        self.seen
    }

    /// Sends a message.
    pub fn send<M: Message>(&mut self, message: &M) {
        self.sender.send(self.now, message);
    }

    /// Sets the key with which frames are signed from now on, see [`Station::set_signing`].
    pub fn set_signing(&mut self, key: Option<([u8; 32], u64)>) {
        self.sender.set_signing(self.now, key);
    }

    /// Returns the session and the number of pymavlink's next packet of MAVLink FTP.
    pub(crate) fn file_session(&self) -> (u8, u16) {
        self.sender.file_session
    }

    pub(crate) fn set_file_session(&mut self, session: u8, number: u16) {
        self.sender.file_session = (session, number);
    }

    /// Whether a message with these target fields is for this station: addressed to it, or to all.
    pub fn is_for_us(&self, target_system: u8, target_component: u8) -> bool {
        let Address { system, component } = self.sender.address;
        [0, system.wire()].contains(&target_system) && [0, component.wire()].contains(&target_component)
    }
}

/// Something that connects a [`Station`] with a vehicle: the kit's rig, or a program with a serial port.
///
/// ```no_run
/// use std::io::{ErrorKind, Read, Write};
/// use std::net::TcpStream;
/// use mavstack::Instant;
/// use mavstack_station::{Client, Drive, Failure, GroundStation, Station};
///
/// struct Tcp {
///     /// It does not block.
///     stream: TcpStream,
///     station: Station,
///     started: std::time::Instant,
/// }
///
/// impl Drive for Tcp {
///     fn station(&mut self) -> &mut Station {
///         &mut self.station
///     }
///
///     fn step(&mut self) -> Result<Instant, Failure> {
///         std::thread::sleep(std::time::Duration::from_millis(2));
///         let now = Instant::ZERO + self.started.elapsed().into();
///         let failed = |error: std::io::Error| Failure::Transport(error.to_string());
///         self.stream.write_all(&self.station.take_output()).map_err(failed)?;
///         let mut bytes = [0; 1024];
///         match self.stream.read(&mut bytes) {
///             Ok(len) => self.station.receive(now, &bytes[..len]),
///             Err(error) if error.kind() == ErrorKind::WouldBlock => {}
///             Err(error) => return Err(failed(error)),
///         }
///         self.station.poll(now);
///         Ok(now)
///     }
/// }
///
/// let stream = TcpStream::connect("127.0.0.1:5760")?;
/// stream.set_nonblocking(true)?;
/// let station = Station::new(Client::Mavsdk);
/// let mut tcp = Tcp { stream, station, started: std::time::Instant::now() };
/// println!("{} parameters", tcp.parameters()?.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Drive {
    /// Returns the station.
    fn station(&mut self) -> &mut Station;

    /// Lets a little time pass: sends [`take_output`](Station::take_output), hands what arrived to
    /// [`receive`](Station::receive), and calls [`poll`](Station::poll). Returns the new time.
    ///
    /// # Errors
    ///
    /// The transport failed.
    fn step(&mut self) -> Result<Instant, Failure>;

    /// Runs a dialogue to its end. A refusal waits up to 500 ms for the vehicle's text with the reason.
    ///
    /// # Errors
    ///
    /// See [`Failure`].
    fn run<D: Dialogue>(&mut self, mut dialogue: D) -> Result<D::Output, Failure>
    where
        Self: Sized,
    {
        let station = self.station();
        station.forget_inbox();
        let (mark, mut now) = (station.seen().text_mark(), station.now());
        loop {
            match self.station().advance(now, &mut dialogue) {
                Some(Ok(output)) => return Ok(output),
                Some(Err(failure)) => return Err(explained(self, failure, mark)),
                None => now = self.step()?,
            }
        }
    }
}

impl<T: Drive> Drive for &mut T {
    fn station(&mut self) -> &mut Station {
        (**self).station()
    }

    fn step(&mut self) -> Result<Instant, Failure> {
        (**self).step()
    }
}

/// Adds the vehicle's text to a refusal, which may come after the answer.
fn explained<T: Drive>(drive: &mut T, mut failure: Failure, mark: usize) -> Failure {
    let Some(text @ None) = failure.text_mut() else { return failure };
    let end = drive.station().now() + TEXT_WITHIN;
    loop {
        *text = drive.station().seen().reason_since(mark);
        if text.is_some() || !matches!(drive.step(), Ok(now) if now < end) {
            return failure;
        }
    }
}
