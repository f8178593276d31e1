//! Links over UDP: which station gets what. The socket is simulated. Rules D-2, H-1, H-5, M-11, SEC-2, SEC-15.

use crate::support::*;
use mavstack::__private::Declares;
use mavstack::config::{PollBudget, StreamProfile};
use mavstack::dialect::*;
use mavstack::frame::{Decoder, Version, encode};
use mavstack::io::{DatagramSocket, MAX_DATAGRAM_LEN, UdpLinks};
use mavstack::message::Dialect;
use mavstack::{Config, Instant, LinkConfig, LinkId, Message, Pulse, Stack};
use std::collections::VecDeque;

/// A station's address and port.
type Endpoint = u16;
const BROADCAST: Endpoint = 0;
const A: Endpoint = 1;
const B: Endpoint = 2;
const C: Endpoint = 3;

/// A socket that accepts `room` datagrams, and loses those to `dead`. Of received datagrams it keeps 16, if `is_short`.
#[derive(Default)]
struct Socket {
    received: VecDeque<(Endpoint, Vec<u8>)>,
    sent: Vec<(Endpoint, Vec<u8>)>,
    room: Option<usize>,
    dead: Option<Endpoint>,
    is_short: bool,
}

impl Socket {
    fn arrive(&mut self, from: Endpoint, datagram: &[u8]) {
        if !self.is_short || self.received.len() < 16 {
            self.received.push_back((from, datagram.to_vec()));
        }
    }
}

impl DatagramSocket for Socket {
    type Endpoint = Endpoint;

    fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, Endpoint)> {
        assert_eq!(buffer.len(), MAX_DATAGRAM_LEN);
        let (from, datagram) = self.received.pop_front()?;
        // A longer datagram is truncated, as on Linux.
        let len = datagram.len().min(buffer.len());
        buffer[..len].copy_from_slice(&datagram[..len]);
        Some((len, from))
    }

    fn is_ready(&mut self) -> bool {
        self.room != Some(0)
    }

    fn send(&mut self, datagram: &[u8], to: Endpoint) -> bool {
        assert!(self.is_ready(), "a datagram that the socket does not accept");
        self.room = self.room.map(|room| room - 1);
        self.sent.push((to, datagram.to_vec()));
        self.dead != Some(to)
    }
}

/// A vehicle whose links 1 and 2 are those of a socket. Link 0 is a UART that is not connected.
struct Lab<D: Declares = Tested> {
    stack: Box<Stack<D, 3>>,
    vehicle: TestVehicle,
    udp: UdpLinks<Endpoint, 2>,
    socket: Socket,
    pulse: &'static Pulse,
    flies: bool,
    now: Instant,
    seq: u8,
}

const LINKS: [LinkId; 2] = [LinkId(1), LinkId(2)];

fn long(command: MavCmd) -> CommandLong {
    CommandLong { target_system: 1, target_component: 1, command, ..Default::default() }
}

impl Lab {
    fn new() -> Self {
        Self::with(|_| ())
    }

    fn with(change: impl FnOnce(&mut Config)) -> Self {
        Self::of(change, LinkConfig::uart(1_000_000))
    }
}

impl<D: Declares<Vehicle = TestVehicle>> Lab<D> {
    fn of(change: impl FnOnce(&mut Config), link: LinkConfig) -> Self {
        let pulse = Box::leak(Box::new(Pulse::new()));
        let mut config = Config::new(VEHICLE, pulse);
        change(&mut config);
        let mut udp = UdpLinks::new(LINKS);
        udp.set_broadcast(Some(BROADCAST));
        Self {
            stack: begun(config, [link; 3]),
            vehicle: TestVehicle::new(),
            udp,
            socket: Socket::default(),
            pulse,
            flies: true,
            now: Instant::ZERO,
            seq: 0,
        }
    }

    /// Runs one pass of the loop, one millisecond later.
    fn step(&mut self) {
        self.now += millis(1);
        if self.flies {
            self.pulse.tick();
        }
        self.stack.poll(self.now, &mut self.vehicle);
        self.stack.poll_udp(self.now, &mut self.udp, &mut self.socket, &mut self.vehicle);
    }

    fn run_for(&mut self, time: mavstack::Duration) {
        let end = self.now + time;
        while self.now < end {
            self.step();
        }
    }

    fn frame<M: Message>(&mut self, message: &M) -> Vec<u8> {
        let mut bytes = [0; mavstack::frame::MAX_FRAME_LEN];
        let len = encode(message, Version::V2, STATION, self.seq, &mut bytes).unwrap();
        self.seq = self.seq.wrapping_add(1);
        bytes[..len].to_vec()
    }

    /// A station sends a message in a datagram of its own. All stations have the same ids.
    fn send<M: Message>(&mut self, from: Endpoint, message: &M) {
        let frame = self.frame(message);
        self.socket.arrive(from, &frame);
    }

    fn heartbeat(&mut self, from: Endpoint) {
        self.send(from, &Gcs::heartbeat());
    }

    /// A station sends a command.
    fn command(&mut self, from: Endpoint, command: MavCmd) {
        self.send(from, &long(command));
    }

    /// Returns the commands whose acknowledgements were sent to an endpoint since the last call.
    fn acks(&mut self, to: Endpoint) -> Vec<MavCmd> {
        self.take::<CommandAck>(to).into_iter().map(|ack| ack.command).collect()
    }

    /// Removes and returns the messages that were sent to an endpoint. Each datagram is one frame.
    fn take<M: Message>(&mut self, to: Endpoint) -> Vec<M> {
        let mut taken = Vec::new();
        self.socket.sent.retain(|(endpoint, datagram)| {
            let mut decoder = Decoder::new(secs(1));
            assert_eq!(decoder.push(datagram, Instant::ZERO), datagram.len());
            let frame = decoder.next(Instant::ZERO, Common::MESSAGES, &mut 100_000, |_| true).expect("a frame");
            assert_eq!(frame.raw(), datagram, "a datagram is one frame");
            let is_wanted = *endpoint == to && frame.id() == M::ID;
            let message = is_wanted.then(|| M::decode(frame.payload()));
            let is_other = message.is_none();
            taken.extend(message);
            is_other
        });
        taken
    }

    fn stations(&self) -> Vec<(LinkId, Endpoint)> {
        self.udp.stations().collect()
    }
}

/// H-1: without a station, heartbeats are broadcast, and nothing else is. The first datagram of a station ends that.
#[test]
fn heartbeats_are_broadcast_until_a_station_answers() {
    let mut lab = Lab::new();
    lab.stack.text(lab.now, MavSeverity::INFO, "nobody reads this");
    lab.run_for(millis(3_500));
    assert_eq!(lab.socket.sent.len(), 4);
    assert_eq!(lab.take::<Heartbeat>(BROADCAST).len(), 4);

    lab.heartbeat(A);
    lab.run_for(secs(4));
    assert_eq!(lab.stations(), [(LinkId(1), A)]);
    assert_eq!(lab.take::<Heartbeat>(BROADCAST).len(), 0);
    assert!(lab.take::<Heartbeat>(A).len() >= 4);
    assert_eq!(lab.take::<Statustext>(A).len(), 0, "the text is older than the station");

    // The station was silent for the time after which a peer has timed out.
    lab.run_for(secs(4));
    assert_eq!(lab.stations(), []);
    assert_eq!(lab.take::<Heartbeat>(BROADCAST).len(), 3);
}

/// H-1: two vehicles hear each other's broadcasts. Neither becomes the station of the other, nor does a gimbal that broadcasts too.
#[test]
fn other_vehicles_are_no_stations() {
    let mut lab = Lab::new();
    let types = [(MavType::QUADROTOR, MavAutopilot::PX4), (MavType::GIMBAL, MavAutopilot::INVALID)];
    for (r#type, autopilot) in types.into_iter().cycle().take(6) {
        lab.send(A, &Heartbeat { r#type, autopilot, ..Default::default() });
        lab.run_for(secs(1));
    }
    assert_eq!(lab.stations(), []);
    assert!(lab.take::<Heartbeat>(BROADCAST).len() >= 6);
    lab.heartbeat(B);
    lab.run_for(secs(1));
    assert!(lab.stations().iter().map(|(_, station)| *station).eq([B]));
}

/// Without an address to broadcast to, nothing is sent.
#[test]
fn nothing_is_sent_without_a_station_and_a_broadcast_address() {
    let mut lab = Lab::new();
    lab.udp.set_broadcast(None);
    lab.run_for(secs(3));
    assert_eq!(lab.socket.sent, []);
}

/// M-11: two stations have the same ids. Each gets the answers to its own commands, and the texts and heartbeats of both.
#[test]
fn stations_with_the_same_ids_get_their_own_answers() {
    let mut lab = Lab::new();
    for _ in 0..50 {
        for (from, command) in [(A, MavCmd::NAV_TAKEOFF), (B, MavCmd::NAV_LAND)] {
            lab.heartbeat(from);
            lab.command(from, command);
        }
        lab.run_for(millis(100));
        assert_eq!(lab.acks(A), [MavCmd::NAV_TAKEOFF]);
        assert_eq!(lab.acks(B), [MavCmd::NAV_LAND]);
    }
    lab.stack.text(lab.now, MavSeverity::INFO, "to everyone");
    lab.run_for(millis(100));
    for station in [A, B] {
        assert_eq!(lab.take::<Statustext>(station).len(), 1);
        assert!(lab.take::<Heartbeat>(station).len() >= 5);
    }
    assert_eq!(lab.udp.refused(), 0);
}

/// A station that sends, even without heartbeats, keeps its link. A further one gets none until another falls silent, and then
/// finds nothing of its predecessor.
#[test]
fn a_link_is_free_again_after_silence() {
    let mut lab = Lab::new();
    for _ in 0..30 {
        lab.command(A, MavCmd::NAV_LAND);
        lab.command(B, MavCmd::NAV_LAND);
        lab.command(C, MavCmd::NAV_LAND);
        lab.run_for(millis(500));
    }
    assert_eq!((lab.acks(A).len(), lab.acks(B).len(), lab.acks(C).len()), (30, 30, 0));
    assert_eq!(lab.udp.refused(), 30);
    assert_eq!(lab.stations(), [(LinkId(1), A), (LinkId(2), B)]);

    // B falls silent within a frame.
    let frame = lab.frame(&long(MavCmd::NAV_LAND));
    lab.socket.received.push_back((B, frame[..20].to_vec()));
    for _ in 0..11 {
        lab.command(A, MavCmd::NAV_LAND);
        lab.run_for(millis(500));
    }
    assert_eq!(lab.stations(), [(LinkId(1), A)]);
    lab.command(C, MavCmd::NAV_TAKEOFF);
    lab.run_for(millis(10));
    assert_eq!(lab.stations(), [(LinkId(1), A), (LinkId(2), C)]);
    assert_eq!(lab.acks(C), [MavCmd::NAV_TAKEOFF]);
}

/// SEC-2: a datagram that does not begin with a frame takes no link.
#[test]
fn other_datagrams_take_no_link() {
    let mut lab = Lab::new();
    for datagram in [&b""[..], b"GET / HTTP/1.1", &[0; 1_472]] {
        lab.socket.received.push_back((C, datagram.to_vec()));
    }
    lab.run_for(millis(100));
    assert_eq!((lab.stations(), lab.udp.refused()), (vec![], 3));
}

/// SEC-2: of a datagram that the socket truncates, the frames before the cut are handled. The next datagram is not damaged.
#[test]
fn truncated_datagrams_lose_only_their_end() {
    let mut lab = Lab::new();
    let mut datagram = Vec::new();
    while datagram.len() <= MAX_DATAGRAM_LEN {
        let frame = lab.frame(&long(MavCmd::NAV_LAND));
        datagram.extend_from_slice(&frame);
    }
    let whole = MAX_DATAGRAM_LEN / lab.frame(&long(MavCmd::NAV_LAND)).len();
    lab.socket.arrive(A, &datagram);
    lab.command(A, MavCmd::NAV_TAKEOFF);
    lab.run_for(secs(1));
    assert_eq!(lab.stations(), [(LinkId(1), A)]);
    assert_eq!(lab.acks(A), [vec![MavCmd::NAV_LAND; whole], vec![MavCmd::NAV_TAKEOFF]].concat());
}

/// What begins with a start byte and is no frame: one byte, a frame with a wrong checksum, and the beginning of one.
fn junk(lab: &mut Lab) -> [Vec<u8>; 4] {
    let mut damaged = lab.frame(&Gcs::heartbeat());
    *damaged.last_mut().unwrap() ^= 1;
    let begun = lab.frame(&long(MavCmd::NAV_LAND))[..20].to_vec();
    [vec![0xFD], damaged, begun, vec![0xFD; MAX_DATAGRAM_LEN]]
}

/// H-1, SEC-2: senders of anything but frames are no stations, however many ports they use. Heartbeats are still broadcast, and a
/// station that comes gets a link and its answers.
#[test]
fn junk_from_many_ports_locks_nobody_out() {
    let mut lab = Lab::new();
    for second in 0..20 {
        for port in 0..40 {
            let junk = junk(&mut lab);
            lab.socket.arrive(100 + port, &junk[usize::from(port) % junk.len()]);
            lab.run_for(millis(25));
        }
        assert_eq!(lab.stations(), [], "second {second}");
    }
    assert!((19..=21).contains(&lab.take::<Heartbeat>(BROADCAST).len()));
    assert_eq!(lab.socket.sent, [], "nothing is sent to them");

    for _ in 0..20 {
        for port in 0..10 {
            let junk = junk(&mut lab);
            lab.socket.arrive(100 + port, &junk[usize::from(port) % junk.len()]);
            if port == 7 {
                // Behind a long datagram of the others.
                lab.command(A, MavCmd::NAV_LAND);
                lab.run_for(millis(3));
                assert_eq!(lab.acks(A), [MavCmd::NAV_LAND]);
            } else if port == 8 {
                lab.command(B, MavCmd::NAV_TAKEOFF);
            }
            lab.run_for(millis(25));
        }
    }
    assert_eq!(lab.acks(B).len(), 20);
    let mut stations: Vec<Endpoint> = lab.stations().iter().map(|(_, station)| *station).collect();
    stations.sort_unstable();
    assert_eq!(stations, [A, B]);
    lab.take::<Heartbeat>(BROADCAST);
    lab.run_for(secs(2));
    assert_eq!(lab.take::<Heartbeat>(BROADCAST).len(), 0);
    assert!(lab.socket.sent.iter().all(|(to, _)| [A, B].contains(to)), "nothing is sent to the others");
}

/// SEC-2: on links that require signatures, unsigned frames make no station.
#[cfg(feature = "signing")]
#[test]
fn unsigned_frames_make_no_station_where_signatures_are_required() {
    let mut lab = Lab::new();
    let config = Config::new(VEHICLE, lab.pulse);
    lab.stack = begun(config, [LinkConfig::uart(1_000_000).with_signing(mavstack::signing::LinkSigning::REQUIRED); 3]);
    for port in 0..50 {
        lab.heartbeat(100 + port);
        lab.run_for(millis(100));
        assert_eq!(lab.stations(), []);
    }
    assert!(lab.take::<Heartbeat>(BROADCAST).len() >= 5);
    assert_eq!(lab.socket.sent, []);
}

/// D-2, SEC-2: a station that floods neither takes the link of another nor delays its commands: what exceeds the budget of its link is
/// dropped and counted. A poll still handles no more than the budget.
#[test]
fn flooding_station_does_not_stop_a_quiet_one() {
    for (datagrams, frames) in [(8, 1), (1, 12)] {
        let mut lab = Lab::with(|config| {
            config.budget = PollBudget { rx_bytes: 1_000, work: 3_000, frames: 4, tx_bytes: 280 };
        });
        lab.socket.is_short = true;
        lab.heartbeat(B);
        lab.heartbeat(A);
        lab.step();
        assert_eq!(lab.stations().len(), 2);
        let (mut asked, mut answered) = (0, 0);
        for pass in 0..10_000 {
            for _ in 0..datagrams {
                let datagram: Vec<u8> = (0..frames).flat_map(|_| lab.frame(&long(MavCmd::NAV_TAKEOFF))).collect();
                lab.socket.arrive(A, &datagram);
            }
            if pass % 500 == 250 {
                lab.command(B, MavCmd::NAV_LAND);
                asked += 1;
            }
            let before = lab.vehicle.commands().len();
            lab.step();
            assert!(lab.vehicle.commands().len() - before <= 8, "the budgets of two links");
            answered += lab.acks(B).len();
            lab.acks(A);
        }
        assert_eq!((asked, answered), (20, 20), "{datagrams} datagrams of {frames} frames");
        assert_eq!(lab.stations().len(), 2);
        assert!(lab.udp.refused() > 1_000);

        // When the flood ends, nothing of it remains.
        lab.run_for(millis(200));
        lab.take::<Heartbeat>(A);
        let refused = lab.udp.refused();
        for _ in 0..20 {
            lab.acks(A);
            lab.command(A, MavCmd::NAV_LAND);
            lab.run_for(millis(50));
            assert_eq!(lab.acks(A), [MavCmd::NAV_LAND]);
        }
        assert_eq!(lab.udp.refused(), refused);
    }
}

/// D-2, SEC-2: a poll receives and handles no more than its budget. What exceeds it stays pending, and nothing is lost. A station
/// that floods does not delay the heartbeats of the other.
#[test]
fn datagrams_with_many_frames_are_handled_within_the_budget() {
    let mut lab = Lab::with(|config| {
        config.budget = PollBudget { rx_bytes: 300, work: 3_000, frames: 4, tx_bytes: 560 };
    });
    lab.heartbeat(B);
    lab.step();
    const COUNT: usize = 200;
    let frame_len = lab.frame(&long(MavCmd::NAV_LAND)).len();
    let per_datagram = MAX_DATAGRAM_LEN / frame_len;
    for _ in 0..COUNT / per_datagram {
        let datagram: Vec<u8> = (0..per_datagram).flat_map(|_| lab.frame(&long(MavCmd::NAV_LAND))).collect();
        lab.socket.arrive(A, &datagram);
    }
    let sent = COUNT / per_datagram * per_datagram;
    while lab.vehicle.commands().len() < sent {
        let (before, waiting) = (lab.vehicle.commands().len(), lab.socket.received.len());
        lab.step();
        assert!(lab.vehicle.commands().len() - before <= 4, "more frames than the budget");
        assert!(waiting - lab.socket.received.len() <= 1, "more bytes than the budget");
        assert!(lab.now < Instant::from_millis(5_000), "{} of {sent} commands", lab.vehicle.commands().len());
    }
    lab.run_for(millis(10));
    assert_eq!(lab.acks(A).len(), sent);
    assert!(lab.now < Instant::from_millis(500), "B has not timed out");
    assert!(!lab.take::<Heartbeat>(B).is_empty());
    let counters = lab.stack.rx_counters(LinkId(1)).unwrap();
    assert_eq!((counters.checksum, counters.skipped), (0, 0));
}

/// D-3: a burst of datagrams needs more memory for answers than the stack has. Each is answered before the next one is received, also
/// if the socket accepts few datagrams at a time.
#[test]
fn a_burst_of_requests_is_answered() {
    let mut lab = Lab::with(|config| config.budget = PollBudget::for_link(10_000_000, millis(1)));
    lab.heartbeat(A);
    lab.step();
    for _ in 0..100 {
        lab.command(A, MavCmd::NAV_LAND);
    }
    for room in (0..4).cycle() {
        lab.socket.room = Some(room);
        lab.step();
        if lab.socket.received.is_empty() {
            break;
        }
    }
    lab.socket.room = None;
    lab.run_for(millis(5));
    assert_eq!(lab.acks(A).len(), 100);
    assert_eq!(lab.stack.link_counters(LinkId(1)).unwrap().no_answer_slot, 0);
}

/// H-5: while the socket accepts nothing, no frame is made that is out of date when it is sent.
#[test]
fn no_heartbeat_waits_for_the_socket() {
    let mut lab = Lab::new();
    lab.socket.room = Some(0);
    lab.run_for(secs(2));
    // Flight stops, and then the socket accepts datagrams again.
    lab.flies = false;
    lab.run_for(secs(1));
    lab.socket.room = None;
    lab.run_for(secs(3));
    assert_eq!(lab.take::<Heartbeat>(BROADCAST).len(), 0);
}

/// A datagram that the socket loses is counted, and the other station's are sent.
#[test]
fn lost_datagrams_are_counted() {
    let mut lab = Lab::new();
    lab.heartbeat(A);
    lab.heartbeat(B);
    lab.socket.dead = Some(A);
    lab.run_for(millis(4_500));
    let errors = |link| lab.stack.link_counters(link).unwrap().write_errors;
    assert_eq!(
        (errors(LinkId(1)), errors(LinkId(2))),
        (lab.socket.sent.iter().filter(|sent| sent.0 == A).count() as u32, 0)
    );
    assert!(lab.take::<Heartbeat>(B).len() >= 4);
}

/// The datagrams of a link that the stack lacks are dropped, and the others are handled.
#[test]
fn a_link_that_does_not_exist_takes_nothing() {
    let mut lab = Lab::new();
    lab.udp = UdpLinks::new([LinkId(7), LinkId(1)]);
    for _ in 0..3 {
        lab.command(A, MavCmd::NAV_LAND);
        lab.command(B, MavCmd::NAV_LAND);
    }
    lab.run_for(millis(50));
    assert_eq!((lab.acks(A).len(), lab.acks(B).len()), (0, 3));
}

/// SEC-15: received bytes, which may contain a key, are not printed.
#[test]
fn debug_omits_the_datagram() {
    let mut lab = Lab::new();
    lab.socket.received.push_back((A, vec![0xFD; 8]));
    lab.step();
    let text = format!("{:?}", lab.udp);
    assert!(text.contains("stations") && !text.contains("253"), "{text}");
}

/// H-17: the first datagram to each new station is a HEARTBEAT, whatever the station has sent first, and also to one that comes
/// back after it was silent, or that takes the link of another. What else is pending follows.
#[test]
fn new_station_gets_a_heartbeat_first() {
    let mut lab = Lab::new();
    lab.run_for(millis(1_300));
    lab.stack.text(lab.now, MavSeverity::INFO, "Hello");
    for (round, station) in [A, B, A, C, B].into_iter().enumerate() {
        lab.socket.sent.clear();
        lab.command(station, MavCmd::NAV_LAND);
        lab.run_for(millis(50));
        let ids: Vec<u8> = lab.socket.sent.iter().filter(|(to, _)| *to == station).map(|(_, sent)| sent[7]).collect();
        assert_eq!(ids[..2], [Heartbeat::ID as u8, CommandAck::ID as u8], "round {round}");
        if round > 0 {
            // Both links are free again.
            lab.run_for(secs(6));
        }
    }
    // Without a flight loop the answer waits for `max_loop_gap`.
    lab.flies = false;
    lab.run_for(secs(2));
    lab.socket.sent.clear();
    lab.command(A, MavCmd::NAV_LAND);
    lab.run_for(millis(500));
    assert_eq!(lab.socket.sent.len(), 0);
    lab.run_for(millis(2));
    assert_eq!(lab.socket.sent.iter().map(|(to, sent)| (*to, sent[7])).collect::<Vec<_>>(), [(A, 77)]);
}

/// bytes from the addresses of stations that are gone keep their links for nobody: a new station joins after the time in
/// which a peer times out. Without accepted frames as the only sign of life it never joined.
#[test]
fn a_byte_keeps_nobody() {
    let mut lab = Lab::new();
    lab.heartbeat(A);
    lab.heartbeat(B);
    lab.run_for(secs(1));
    assert_eq!(lab.stations(), [(LinkId(1), A), (LinkId(2), B)]);
    let joined = |lab: &Lab| lab.stations().iter().any(|(_, station)| *station == C);
    for _ in 0..12 {
        lab.socket.arrive(A, &[0xFD]);
        lab.socket.arrive(B, &junk(&mut Lab::new())[1]);
        lab.heartbeat(C);
        lab.run_for(millis(500));
    }
    assert!(lab.now <= Instant::from_millis(7_000) && joined(&lab));
    for _ in 0..20 {
        lab.socket.arrive(A, &[0xFD]);
        lab.heartbeat(C);
        lab.run_for(millis(500));
        assert!(joined(&lab));
    }
}

/// the same on links that require signatures, where the address of the true station may change.
#[cfg(feature = "signing")]
#[test]
fn a_byte_keeps_nobody_where_signatures_are_required() {
    use mavstack::signing::{LinkSigning, SigningKey};
    let key = SigningKey::new([7; 32]);
    let link = LinkConfig::uart(1_000_000).with_signing(LinkSigning::REQUIRED);
    let mut lab = Lab::<Tested<mavstack::__private::NoPlans, 8, Signed>>::of(|_| (), link);
    lab.stack.signing_mut().set_key(lab.now, key.clone(), 37_000_000_000_000);
    let mut timestamp = 37_000_000_000_000;
    let mut signed = |link_id: u8| {
        let mut out = [0; mavstack::frame::MAX_FRAME_LEN];
        timestamp += 50_000;
        let len = mavstack::frame::encode_signed(&Gcs::heartbeat(), STATION, 0, &key, link_id, timestamp, &mut out);
        out[..len.unwrap()].to_vec()
    };
    for (endpoint, link_id) in [(A, 1), (B, 2)] {
        lab.socket.arrive(endpoint, &signed(link_id));
        lab.run_for(millis(100));
    }
    assert_eq!(lab.stations(), [(LinkId(1), A), (LinkId(2), B)]);
    for _ in 0..12 {
        for gone in [A, B] {
            lab.socket.arrive(gone, &[0xFD]);
        }
        lab.socket.arrive(C, &signed(3));
        lab.run_for(millis(500));
    }
    assert_eq!(lab.stations(), [(LinkId(1), C)]);
}

/// one forged datagram of 153 bytes: nine HEARTBEATs of MAVLink 1. Its supposed sender got all streams until it timed out,
/// 12,553 bytes here. Now it gets at most three times as much, and HEARTBEATs.
#[test]
fn reflection() {
    for asks in [false, true] {
        let link = LinkConfig::uart(1_000_000).with_streams(StreamProfile::Onboard);
        let mut lab = Lab::<Tested>::of(|_| (), link);
        let mut datagram = Vec::new();
        if asks {
            for message in [MavCmd::REQUEST_AUTOPILOT_CAPABILITIES, MavCmd::NAV_LAND] {
                datagram.extend(lab.frame(&long(message)));
            }
            let list = ParamRequestList { target_system: 1, target_component: 1 };
            datagram.extend(lab.frame(&list));
        }
        while datagram.len() < 153 - 21 {
            datagram.extend(lab.frame(&Gcs::heartbeat()));
        }
        lab.socket.arrive(A, &datagram);
        lab.run_for(secs(20));
        let heartbeats = lab.take::<Heartbeat>(A).len();
        assert!((4..=6).contains(&heartbeats), "{heartbeats} HEARTBEATs");
        let bytes: usize = lab.socket.sent.iter().filter(|sent| sent.0 == A).map(|sent| sent.1.len()).sum();
        assert!(bytes <= 3 * datagram.len(), "{bytes} bytes for {}", datagram.len());
        assert_eq!(lab.stations(), []);
        if asks {
            assert_eq!(lab.acks(A).len(), 2, "commands are answered at once");
        }
    }
}

/// a station gets everything from its second frame on, if that is a second or more later; also one that mostly listens, with
/// a HEARTBEAT in four seconds.
#[test]
fn second_frame_unlimits_a_station() {
    for (period, limited) in [(millis(1_000), 900), (millis(4_000), 3_900)] {
        let link = LinkConfig::uart(1_000_000).with_streams(StreamProfile::Onboard);
        let mut lab = Lab::<Tested>::of(|_| (), link);
        lab.heartbeat(A);
        lab.run_for(millis(limited));
        assert_eq!(lab.take::<Attitude>(A).len(), 0);
        for _ in 0..3 {
            lab.run_for(period - millis(limited));
            lab.heartbeat(A);
            lab.run_for(millis(limited));
            let received = lab.take::<Attitude>(A).len() as u64;
            assert!(received >= limited / 20 - 2, "{received} in {limited} ms");
        }
        assert_eq!(lab.stations(), [(LinkId(1), A)]);
    }
}

/// an antenna tracker that has asked for telemetry sends HEARTBEATs only, of its own type: they keep its link. Before, it lost it after
/// 5 s.
#[test]
fn heartbeats_of_any_type_keep_a_station() {
    let link = LinkConfig::uart(1_000_000).with_streams(StreamProfile::Onboard);
    let mut lab = Lab::<Tested>::of(|_| (), link);
    for second in 0..30 {
        lab.send(A, &Heartbeat { r#type: MavType::ANTENNA_TRACKER, ..Heartbeat::default() });
        if second < 2 {
            lab.send(
                A,
                &RequestDataStream { req_message_rate: 4, start_stop: 1, target_system: 1, ..Default::default() },
            );
        }
        lab.run_for(secs(1));
    }
    assert_eq!(lab.stations(), [(LinkId(1), A)]);
}

/// in a fault there are no HEARTBEATs, and a limited station gets no more than its bytes all the same. The loop sleeps.
#[test]
fn limit_holds_in_a_fault() {
    let link = LinkConfig::uart(1_000_000).with_streams(StreamProfile::Onboard);
    let mut lab = Lab::<Tested>::of(|_| (), link);
    lab.vehicle.state = None;
    lab.run_for(secs(1));
    lab.heartbeat(A);
    lab.run_for(secs(3));
    let bytes: usize = lab.socket.sent.iter().map(|sent| sent.1.len()).sum();
    assert!(bytes <= 63, "{bytes} bytes");
    assert!(lab.stack.link_deadline(lab.now, LinkId(1)) > lab.now);
}

/// a configured remote needs to send nothing, is not limited, and keeps its link, whoever else sends.
#[test]
fn configured_remote_keeps_its_link() {
    let link = LinkConfig::uart(1_000_000).with_streams(StreamProfile::Onboard);
    let mut lab = Lab::<Tested>::of(|_| (), link);
    lab.udp.set_remote(0, Some(C));
    lab.udp.set_remote(7, Some(A));
    for _ in 0..14 {
        lab.heartbeat(A);
        lab.heartbeat(B);
        lab.run_for(millis(500));
    }
    assert_eq!(lab.stations(), [(LinkId(1), C), (LinkId(2), A)]);
    assert!(lab.take::<Heartbeat>(C).len() >= 6);
    assert!(lab.take::<Attitude>(C).len() >= 300);
    // Its commands are answered at once.
    lab.command(C, MavCmd::NAV_LAND);
    lab.run_for(millis(5));
    assert_eq!(lab.acks(C), [MavCmd::NAV_LAND]);
    lab.udp.set_remote(0, None);
    lab.udp.set_remote(1, None);
    assert_eq!(lab.stations(), [(LinkId(2), A)], "only a remote is removed");
}
