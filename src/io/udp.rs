//! Links over UDP, for any network stack: each ground station that sends to a socket gets a link of its own.
//!
//! Follows MAVLink's guide for UDP: a vehicle broadcasts until a station answers, and then sends to the address and
//! port from which the station sends. The network itself is left out: a [`DatagramSocket`] connects this module to
//! smoltcp, embassy-net, or `std`.

use crate::dialect::CommandLong;
use crate::frame::{STX_V1, STX_V2, cost_of_sending};
use crate::message::Message;
use crate::stack::{Declares, Stack};
use crate::time::{Duration, Instant};
use crate::types::{Allowance, LinkId};

/// The longest datagram that is received, in bytes: the payload of UDP over IPv4 in an Ethernet frame. A station may
/// put several MAVLink frames into one.
pub const MAX_DATAGRAM_LEN: usize = 1_472;

/// How long datagrams may exceed the budget before the surplus is dropped. A burst is handled completely within this time.
const PATIENCE: Duration = Duration::from_millis(100);

/// The cost of a received datagram besides its bytes: the headers of IPv4 and UDP, in bytes.
const HEADERS_LEN: usize = 28;

/// A UDP socket, bound to the vehicle's port, whose calls never wait.
pub trait DatagramSocket {
    /// An address and a port.
    type Endpoint: Copy + PartialEq;

    /// Removes the oldest received datagram and copies it into `buffer`, which is [`MAX_DATAGRAM_LEN`] bytes long.
    /// Returns its length and its sender; `None` if no datagram was received.
    ///
    /// A longer datagram may be truncated, as Linux does: the frames before the cut are handled. A socket that discards it
    /// returns the next one, or length 0, which is counted as [refused](UdpLinks::refused).
    fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, Self::Endpoint)>;

    /// Returns whether the socket accepts a datagram of [`MAX_FRAME_LEN`](crate::frame::MAX_FRAME_LEN) bytes. It must
    /// not depend on calls of [`receive`](Self::receive): while it returns false, nothing is received.
    fn is_ready(&mut self) -> bool;

    /// Sends a datagram, which is one frame. Returns whether it was accepted. If not, the frame is lost, and counted in
    /// [`write_errors`](crate::network::LinkCounters::write_errors).
    fn send(&mut self, datagram: &[u8], to: Self::Endpoint) -> bool;
}

/// How long a new station on an open link is limited, at least.
const PROBATION: Duration = Duration::from_secs(1);

/// A limited station gets this many bytes for each that it has sent (X-4).
const AMPLIFICATION: usize = 3;

/// The bytes that a limited station may save up: four of the longest frames.
const MAX_QUOTA: usize = 1_120;

/// With fewer bytes left, a limited station gets only HEARTBEATs. An acknowledgement is shorter, and so is a parameter.
const LEAST_QUOTA: usize = 80;

/// A sender behind a link.
#[derive(Clone, Copy, Debug)]
struct Station<E> {
    endpoint: E,
    /// When the link accepted its last frame, or when its first datagram was received.
    heard: Instant,
    standing: Standing,
    /// The bytes that it may get while it is limited, besides HEARTBEATs.
    quota: usize,
}

impl<E> Station<E> {
    const fn new(endpoint: E, heard: Instant, standing: Standing) -> Self {
        Self { endpoint, heard, standing, quota: 0 }
    }

    const fn is_remote(&self) -> bool {
        matches!(self.standing, Standing::Remote)
    }
}

/// What a sender has shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Standing {
    /// Nothing that the link accepts. It gets nothing, and another sender may take its link.
    Sender,
    /// The link has accepted a frame since then, which anyone may have sent in the name of this address. It is limited.
    Limited(Instant),
    /// It answers, or has signed.
    Proven,
    /// It is [configured](UdpLinks::set_remote).
    Remote,
}

/// The links of a UDP socket, each with its station. `E` is the [endpoint](DatagramSocket::Endpoint) of the socket.
///
/// [`Stack::poll_udp`] moves datagrams between a socket and the links:
///
/// ```
/// # use mavstack::prelude::*;
/// # struct Rover;
/// # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
/// # impl Commands for Rover {
/// #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
/// #         mavstack::dialect::MavResult::UNSUPPORTED.into()
/// #     }
/// # }
/// # #[derive(Stack)]
/// # #[stack(vehicle: Rover, links: 3)]
/// # struct Mavlink;
/// use std::net::{SocketAddr, UdpSocket};
///
/// use mavstack::io::{DatagramSocket, UdpLinks};
///
/// /// A socket that is bound, permits broadcasts, and does not block.
/// struct Socket(UdpSocket);
///
/// impl DatagramSocket for Socket {
///     type Endpoint = SocketAddr;
///
///     fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
///         self.0.recv_from(buffer).ok()
///     }
///
///     fn is_ready(&mut self) -> bool {
///         true
///     }
///
///     fn send(&mut self, datagram: &[u8], to: SocketAddr) -> bool {
///         self.0.send_to(datagram, to).is_ok()
///     }
/// }
///
/// /// One pass of the loop, after `stack.poll`. Link 0 is a UART; links 1 and 2 belong to the socket.
/// fn pass(
///     now: Instant,
///     stack: &mut StackOf<Mavlink>,
///     rover: &mut Rover,
///     udp: &mut UdpLinks<SocketAddr, 2>,
///     socket: &mut Socket,
/// ) {
///     stack.poll_udp(now, udp, socket, rover);
/// }
///
/// let mut udp: UdpLinks<SocketAddr, 2> = UdpLinks::new([LinkId(1), LinkId(2)]);
/// udp.set_broadcast(Some("192.168.1.255:14550".parse().unwrap()));
/// # let _ = pass;
/// ```
///
/// # Stations
///
/// The first datagram of a sender takes a free link and [restarts](Stack::restart_link) it. The sender becomes a
/// station when the link accepts a frame from it: with a correct checksum and, if the link requires it, a correct
/// signature. From then on the link sends to the station's address and port, one frame per datagram, a HEARTBEAT first (H-17). After
/// [`peer_timeout`](crate::Config::peer_timeout) without an accepted frame the link is free again, whatever bytes are received (X-4).
///
/// On a link that accepts unsigned commands, anyone can send a datagram in the name of another address. So a new station gets
/// HEARTBEATs, and at most three times the bytes that it has sent, until the link accepts a frame of it a second or more after
/// the first. Then it gets all. What remains: two forged datagrams a second apart, and then one in each `peer_timeout`, direct
/// the traffic of a link to an address that has not asked for it. Where signatures are required, nothing does. A station with
/// a [configured](Self::set_remote) address is not limited, and keeps its link.
///
/// Before a sender is a station, nothing is sent to it, and heartbeats are still broadcast. If no link is free, the
/// next new sender takes its link.
///
/// With a link for each, stations share nothing: two copies of QGroundControl have the same ids, but each transfer is
/// answered on its own link. Stations receive each other's frames if the stack declares `forwarding`.
///
/// | | |
/// |---|---|
/// | no station is known | the first link's HEARTBEATs are broadcast, nothing else |
/// | a link has no station | its other frames are discarded, so that no text waits for a station that never appears |
/// | all links have stations | datagrams of further senders are dropped, and [counted](Self::refused) |
/// | a datagram does not begin with a frame | it is dropped and counted; its sender gets no link |
/// | a new station has less than 80 of its bytes left | it gets only HEARTBEATs, and its other frames stay pending; a longer frame than what is left is discarded |
/// | a station sends more than the budget of its link | the surplus stays pending; after 100 ms it is dropped and counted, until the station sends less |
///
/// Stream intervals belong to the link: the next station inherits the intervals of the last one.
pub struct UdpLinks<E, const N: usize> {
    links: [LinkId; N],
    stations: [Option<Station<E>>; N],
    broadcast: Option<E>,
    refused: u32,
    /// The last datagram. The stack has not taken `datagram[begin..end]`, which belongs to the station with index `of`.
    datagram: [u8; MAX_DATAGRAM_LEN],
    begin: usize,
    end: usize,
    of: usize,
    /// Since when datagrams have exceeded the budget in every poll.
    behind: Option<Instant>,
}

impl<E: Copy + PartialEq, const N: usize> UdpLinks<E, N> {
    /// Returns the links of a socket, without stations. At most `N` stations are served at the same time. `links` are
    /// the ids of links of the stack that nothing else uses. Nothing is broadcast until
    /// [`set_broadcast`](Self::set_broadcast).
    pub const fn new(links: [LinkId; N]) -> Self {
        const { assert!(N > 0, "a socket needs a link for each station: `UdpLinks::new([LinkId(0)])`") };
        Self {
            links,
            stations: [None; N],
            broadcast: None,
            refused: 0,
            datagram: [0; MAX_DATAGRAM_LEN],
            begin: 0,
            end: 0,
            of: 0,
            behind: None,
        }
    }

    /// Sets the destination of HEARTBEATs while no station is known: the broadcast address of the subnet, and the port
    /// of ground stations, 14550. Call it whenever the vehicle's address changes. `None` sends nothing.
    pub const fn set_broadcast(&mut self, to: Option<E>) {
        self.broadcast = to;
    }

    /// Sets the address of a station that has the link with this index in [`links`](Self::links) for good: it never times out,
    /// is not limited, and gets HEARTBEATs from the start. `None` removes it. An index of `N` or more does nothing.
    pub fn set_remote(&mut self, index: usize, remote: Option<E>) {
        if let Some(station) = self.stations.get_mut(index)
            && (remote.is_some() || station.is_some_and(|station| station.is_remote()))
        {
            *station = remote.map(|endpoint| Station::new(endpoint, Instant::ZERO, Standing::Remote));
        }
    }

    /// Returns the stations, each with its link.
    pub fn stations(&self) -> impl Iterator<Item = (LinkId, E)> {
        self.links.iter().enumerate().filter_map(|(index, link)| Some((*link, self.station(index)?)))
    }

    /// Returns the links of the socket.
    pub const fn links(&self) -> &[LinkId; N] {
        &self.links
    }

    /// Returns the number of datagrams that were dropped, in whole or in part: all links had stations, it did not begin with a
    /// frame, or its station sent more than the budget of its link for over 100 ms. Wraps.
    pub const fn refused(&self) -> u32 {
        self.refused
    }

    /// Frees the links of stations that have sent no accepted frame for `timeout`.
    fn forget_silent(&mut self, now: Instant, timeout: Duration) {
        for station in &mut self.stations {
            if station.is_some_and(|station| !station.is_remote() && now - station.heard >= timeout) {
                *station = None;
            }
        }
    }

    /// Assigns the received datagram to the link of its sender, or drops it. Returns the link if the sender is new.
    fn take(&mut self, now: Instant, len: usize, from: E) -> Option<LinkId> {
        (self.begin, self.end) = (0, 0);
        let known = self.stations.iter().position(|station| station.is_some_and(|station| station.endpoint == from));
        let is_frame = len > 0 && matches!(self.datagram, [STX_V1 | STX_V2, ..]);
        let free = || self.stations.iter().position(Option::is_none);
        let index = known.or_else(free).or_else(|| self.replaceable()).filter(|_| is_frame && len <= MAX_DATAGRAM_LEN);
        let Some((of, station)) = index.and_then(|index| Some((index, self.stations.get_mut(index)?))) else {
            self.count_refused();
            return None;
        };
        if known.is_none() {
            *station = Some(Station::new(from, now, Standing::Sender));
        }
        if let Some(station) = station {
            station.quota = station.quota.saturating_add(len.saturating_mul(AMPLIFICATION)).min(MAX_QUOTA);
        }
        (self.of, self.end) = (of, len);
        if known.is_some() { None } else { self.links.get(of).copied() }
    }

    /// Returns a link without a station. The sender of the last datagram loses its link last: its frame may wait for
    /// the budget.
    fn replaceable(&self) -> Option<usize> {
        let next = self.of.saturating_add(1);
        (next..N).chain(0..next).find(|index| self.station(*index).is_none())
    }

    /// Returns the station with this index; `None` if the link has none.
    fn station(&self, index: usize) -> Option<E> {
        self.stations.get(index)?.filter(|station| station.standing != Standing::Sender).map(|station| station.endpoint)
    }

    /// Notes that the link with this index has accepted a frame of its sender. `is_open`: of anyone. Returns whether that is a
    /// new station.
    fn accept(&mut self, now: Instant, index: usize, is_open: bool) -> bool {
        let Some(station) = self.stations.get_mut(index).and_then(Option::as_mut) else { return false };
        station.heard = now;
        let before = station.standing;
        station.standing = match before {
            Standing::Sender if is_open => Standing::Limited(now),
            Standing::Limited(since) if now - since < PROBATION => before,
            Standing::Sender | Standing::Limited(_) => Standing::Proven,
            Standing::Proven | Standing::Remote => before,
        };
        before == Standing::Sender
    }

    /// Returns the station with this index, if it is limited.
    fn limited(&mut self, index: usize) -> Option<&mut Station<E>> {
        let station = self.stations.get_mut(index)?.as_mut();
        station.filter(|station| matches!(station.standing, Standing::Limited(_)))
    }

    /// Whether the station with this index gets only HEARTBEATs.
    fn is_short(&mut self, index: usize) -> bool {
        self.limited(index).is_some_and(|station| station.quota < LEAST_QUOTA)
    }

    /// Takes a frame from what a limited station may get. Returns false if it is too long.
    fn may_get(&mut self, index: usize, frame: &[u8]) -> bool {
        let Some(station) = self.limited(index).filter(|_| !is_heartbeat(frame)) else { return true };
        let left = station.quota.checked_sub(frame.len());
        station.quota = left.unwrap_or(station.quota);
        left.is_some()
    }

    const fn count_refused(&mut self) {
        self.refused = self.refused.wrapping_add(1);
    }

    /// Whether datagrams have exceeded the budget for so long that the surplus is dropped.
    fn is_flooded(&mut self, now: Instant) -> bool {
        now - (*self.behind.get_or_insert(now)) >= PATIENCE
    }

    /// Returns the destination of `frame` on the link with this index; `None` if it is not sent.
    fn destination(&self, index: usize, frame: &[u8]) -> Option<E> {
        match self.station(index) {
            station @ Some(_) => station,
            None if index == 0 && is_heartbeat(frame) && self.stations().next().is_none() => self.broadcast,
            None => None,
        }
    }

    fn rest(&self) -> &[u8] {
        self.datagram.get(self.begin..self.end).unwrap_or_default()
    }
}

/// Omits the received bytes: a key may be among them (SEC-15).
impl<E: Copy + PartialEq + core::fmt::Debug, const N: usize> core::fmt::Debug for UdpLinks<E, N> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { links, stations, broadcast, .. } = self;
        let mut debug = f.debug_struct("UdpLinks");
        debug.field("links", links).field("stations", stations).field("broadcast", broadcast).finish_non_exhaustive()
    }
}

/// Whether a frame is a HEARTBEAT: message id 0, in either version.
const fn is_heartbeat(frame: &[u8]) -> bool {
    matches!(frame, [STX_V2, _, _, _, _, _, _, 0, 0, 0, ..] | [STX_V1, _, _, _, _, 0, ..])
}

/// The rest of a link's budget in one poll.
struct Left {
    allowance: Allowance,
    tx_bytes: usize,
}

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Moves datagrams between the links of `udp` and their socket: receives, handles the received frames, and sends, one frame
    /// per datagram. It replaces [`poll_link`](Self::poll_link) for these links. It never waits.
    ///
    /// Each datagram is answered before the next one is received. While the socket accepts no datagram, none is
    /// received. Each link has the [budget](crate::Config::budget) of one `poll_link`. One call receives at most
    /// `rx_bytes` on all links, plus one datagram, and counts 28 bytes for the headers of each. Frames that exceed the
    /// budget of their link stay pending, in the link and in the socket. If every call for 100 ms leaves frames
    /// pending, a station floods: the surplus is dropped, so that other stations are received.
    pub fn poll_udp<S: DatagramSocket, const N: usize>(
        &mut self,
        now: Instant,
        udp: &mut UdpLinks<S::Endpoint, N>,
        socket: &mut S,
        vehicle: &mut D::Vehicle,
    ) {
        if !self.is_begun() {
            return;
        }
        let time = self.enter(now);
        udp.forget_silent(time, self.config().peer_timeout);
        let budget = self.config().budget;
        let mut left = [(); N].map(|()| Left { allowance: budget.allowance(), tx_bytes: length(budget.tx_bytes) });
        // Frames of earlier polls, which wait for budget or for silence.
        for (index, (link, left)) in udp.links.into_iter().zip(&mut left).enumerate() {
            self.receive_within(now, link, &[], vehicle, &mut left.allowance);
            self.note_accepted(time, udp, index);
        }
        self.receive_datagrams(now, udp, socket, vehicle, &mut left);
        for (index, left) in left.iter_mut().enumerate() {
            self.send_datagrams(now, (udp, index), socket, vehicle, left);
        }
    }

    fn receive_datagrams<S: DatagramSocket, const N: usize>(
        &mut self,
        now: Instant,
        udp: &mut UdpLinks<S::Endpoint, N>,
        socket: &mut S,
        vehicle: &mut D::Vehicle,
        left: &mut [Left; N],
    ) {
        let time = self.enter(now);
        let mut rx_bytes = length(self.config().budget.rx_bytes);
        let mut is_behind = false;
        // The next requests need the memory for the answers to the last ones.
        while socket.is_ready() {
            if udp.begin >= udp.end {
                if rx_bytes == 0 {
                    break;
                }
                let Some((len, from)) = socket.receive(&mut udp.datagram) else { break };
                rx_bytes = rx_bytes.saturating_sub(len.saturating_add(HEADERS_LEN));
                if let Some(link) = udp.take(time, len, from) {
                    self.reset_link(link);
                }
            }
            let (index, rest) = (udp.of, udp.rest());
            let (Some(&link), Some(left)) = (udp.links.get(index), left.get_mut(index)) else { break };
            // A link that the stack lacks takes nothing: drop the datagram.
            if rest.is_empty() || self.counters_mut(link).is_none() {
                udp.begin = udp.end;
                continue;
            }
            // The first frame of a new sender waits in the decoder, not here, where it would delay others.
            if left.allowance.may_handle() || udp.station(index).is_none() {
                let taken = self.receive_within(now, link, rest, vehicle, &mut left.allowance);
                udp.begin = udp.begin.saturating_add(taken);
                self.note_accepted(time, udp, index);
                if !self.send_datagrams(now, (udp, index), socket, vehicle, left) {
                    // Its next requests wait until these are answered; those of other links do not.
                    left.allowance.frames = 0;
                }
            }
            // A socket that accepts nothing is not the station's fault.
            if udp.begin < udp.end && socket.is_ready() {
                if udp.station(index).is_some() {
                    is_behind = true;
                    if !udp.is_flooded(time) {
                        // No deadline says that a datagram is pending.
                        self.poll_again();
                        break;
                    }
                }
                udp.count_refused();
                udp.begin = udp.end;
            }
        }
        if !is_behind {
            udp.behind = None;
        }
    }

    /// Makes the sender with this index a station if its link has accepted a frame. A new station gets a HEARTBEAT first (H-17).
    fn note_accepted<E: Copy + PartialEq, const N: usize>(
        &mut self,
        now: Instant,
        udp: &mut UdpLinks<E, N>,
        index: usize,
    ) {
        if let Some(&link) = udp.links.get(index)
            && self.has_accepted_again(link)
            && udp.accept(now, index, self.accepts_unsigned(link, CommandLong::ID))
        {
            self.greet(link);
        }
    }

    /// Returns whether nothing is left to send.
    fn send_datagrams<S: DatagramSocket, const N: usize>(
        &mut self,
        now: Instant,
        (udp, index): (&mut UdpLinks<S::Endpoint, N>, usize),
        socket: &mut S,
        vehicle: &mut D::Vehicle,
        left: &mut Left,
    ) -> bool {
        let Some(&link) = udp.links.get(index) else { return true };
        while left.tx_bytes > 0 && left.allowance.may_send() {
            // The socket is asked first: a frame is not made before it can be sent (H-5).
            let is_ready = socket.is_ready();
            self.note_transport(link, is_ready);
            if !is_ready {
                return false;
            }
            if !self.allow_only_heartbeat(link, udp.is_short(index)) {
                return true;
            }
            let frame = self.transmit(now, link, vehicle);
            if frame.is_empty() {
                return true;
            }
            let len = frame.len();
            left.allowance.send(cost_of_sending(frame));
            let to = if udp.may_get(index, frame) { udp.destination(index, frame) } else { None };
            let is_lost = to.is_some_and(|to| !socket.send(frame, to));
            self.transmitted(link, len);
            left.tx_bytes = left.tx_bytes.saturating_sub(len);
            if is_lost && let Some(counters) = self.counters_mut(link) {
                counters.write_errors = counters.write_errors.wrapping_add(1);
            }
        }
        false
    }
}

/// Converts a number of bytes.
fn length(bytes: u32) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}
