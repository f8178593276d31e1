//! A link that opens: its first frame is a HEARTBEAT of the autopilot. Rule H-17.

use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::message::ComponentId;
use mavstack::{
    Address, Component, Components, Config, Fill, Instant, LinkConfig, LinkId, Message, Pulse, StackOf, Stream,
    Telemetry, Vehicle, VehicleState,
};

/// A vehicle with something to send from the start: a stream, an event, a text, and another component.
#[derive(Default)]
struct Talker {
    has_fault: bool,
}

impl Vehicle for Talker {
    fn state(&self) -> Option<VehicleState> {
        (!self.has_fault).then(|| VehicleState::new(false))
    }
}

without_commands!(Talker);

impl Components for Talker {
    const COMPONENTS: &'static [Component] = &[Component::new(ComponentId::new(154), MavType::GIMBAL)];
}

impl Telemetry for Talker {
    const STREAMS: &'static [Stream] = &[Stream::of::<Attitude>().every(millis(20))];

    fn fill(&mut self, _: u32, out: &mut Fill<'_>) -> bool {
        out.put(&Attitude::default())
    }
}

mavstack::events! {
    struct OurEvents in "talker" {
        events { Turned(Info) {} = "Turned"; }
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Talker, links: 3, streams, components, events: { history: 8 }, forwarding)]
struct Open {
    time: mavstack::clock::Time,
}

const RADIO: LinkId = LinkId(0);
const USB: LinkId = LinkId(1);
const SATELLITE: LinkId = LinkId(2);
const HEARTBEAT: (u32, u8) = (Heartbeat::ID, 1);

struct Lab {
    stack: Box<StackOf<Open>>,
    vehicle: Talker,
    pulse: &'static Pulse,
    now: Instant,
    seq: u8,
    /// What each link has sent: when, the message and the component.
    sent: [Vec<(Instant, (u32, u8))>; 3],
    /// The sequence number of the autopilot's last frame on each link, since it was opened.
    last_seq: [Option<u8>; 3],
}

impl Lab {
    fn new() -> Self {
        let pulse: &Pulse = Box::leak(Box::new(Pulse::new()));
        let mut stack = Box::new(StackOf::<Open>::VACANT);
        let link = LinkConfig::unlimited();
        stack.begin(Config::new(VEHICLE, pulse), [link, link, link.with_class(LinkClass::HighLatency)]);
        let now = Instant::from_millis(4_000);
        stack.text(now, MavSeverity::INFO, "Hello");
        stack.event(now, &Turned {});
        let sent = [const { Vec::new() }; 3];
        let mut lab = Self { stack, vehicle: Talker::default(), pulse, now, seq: 0, sent, last_seq: [None; 3] };
        lab.stack.poll(now, &mut lab.vehicle);
        for link in [RADIO, USB] {
            assert_eq!(lab.stack.transmit(now, link, &mut lab.vehicle), [0_u8; 0], "it waits for a heartbeat");
        }
        lab.fill();
        lab
    }

    /// Peers send requests, and frames that are forwarded to the other link.
    fn fill(&mut self) {
        for (link, station) in [(RADIO, 250), (USB, 251)] {
            self.receive(link, station, &Gcs::heartbeat());
            self.receive(link, station, &Ping::default());
            self.receive(link, station, &CommandLong { target_system: 1, target_component: 1, ..Default::default() });
        }
    }

    fn receive<M: Message>(&mut self, link: LinkId, station: u8, message: &M) {
        let mut bytes = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, Address::new(station, 190), self.seq, &mut bytes).unwrap();
        self.seq = self.seq.wrapping_add(1);
        assert_eq!(self.stack.receive(self.now, link, &bytes[..len], &mut self.vehicle), len);
    }

    /// Opens a link again.
    fn restart(&mut self, link: LinkId) {
        self.stack.restart_link(link);
        self.last_seq[usize::from(link.0)] = None;
    }

    /// Runs one pass, in which the flight loop ticks or not. Looks whether a driver that sleeps would be woken for each frame.
    fn pass(&mut self, ticks: bool) {
        self.now += millis(1);
        if ticks {
            self.pulse.tick();
        }
        self.stack.poll(self.now, &mut self.vehicle);
        for (link, sent) in (0..).map(LinkId).zip(&mut self.sent) {
            loop {
                let deadline = self.stack.link_deadline(self.now, link);
                let frame = self.stack.transmit(self.now, link, &mut self.vehicle);
                let [_, _, _, _, seq, _, component, a, b, c, ..] = *frame else { break };
                assert_eq!(deadline, self.now, "a frame is sent, so the driver must be awake");
                if component == 1 {
                    let last = self.last_seq[usize::from(link.0)].replace(seq);
                    assert!(last.is_none_or(|last| seq == last.wrapping_add(1)), "{seq} follows {last:?}");
                }
                sent.push((self.now, (u32::from_le_bytes([a, b, c, 0]), component)));
                let len = frame.len();
                self.stack.transmitted(link, len);
            }
        }
    }

    /// Asserts that the normal links have sent a HEARTBEAT first, and then everything that was pending.
    fn assert_heartbeat_is_first(&self, at: Instant, what: &str) {
        for sent in &self.sent[..2] {
            assert_eq!(sent.first(), Some(&(at, HEARTBEAT)), "{what}");
            for id in [Heartbeat::ID, Ping::ID, CommandAck::ID, Statustext::ID, Event::ID, Attitude::ID] {
                assert!(sent.iter().any(|(_, (sent, _))| *sent == id), "{what}: no message {id}");
            }
            let gimbal = sent.iter().position(|(_, frame)| *frame == (Heartbeat::ID, 154));
            let forwarded = sent.iter().position(|(_, frame)| *frame == (Heartbeat::ID, 190));
            assert!(gimbal > Some(0) && forwarded > Some(0), "{what}: {gimbal:?}, {forwarded:?}");
        }
    }
}

/// H-17: whenever the flight loop begins to tick, up to `max_loop_gap` after the link has opened, the first frame of each normal
/// link is the autopilot's HEARTBEAT: before answers, texts, events, streams, forwarded frames and other heartbeats. Then
/// everything that was pending is sent.
#[test]
fn heartbeat_is_the_first_frame_of_a_link() {
    for late in [0, 1, 3, 100, 498] {
        let mut lab = Lab::new();
        for _ in 0..late {
            lab.pass(false);
            assert!(lab.sent[..2].iter().all(Vec::is_empty), "{late} ms late");
        }
        lab.pass(true);
        let at = lab.now;
        for _ in 0..100 {
            lab.pass(true);
        }
        lab.assert_heartbeat_is_first(at, &format!("{late} ms late"));
    }
}

/// H-17: without a flight loop, everything else is sent after `max_loop_gap`. A driver that sleeps is woken then.
#[test]
fn other_frames_wait_no_longer_than_max_loop_gap() {
    let mut lab = Lab::new();
    let opened = lab.now;
    for _ in 0..499 {
        lab.pass(false);
        let deadline = lab.stack.link_deadline(lab.now, RADIO);
        assert!(deadline > lab.now && deadline <= opened + millis(500), "{deadline:?} at {:?}", lab.now);
        assert!(lab.sent[..2].iter().all(Vec::is_empty));
    }
    lab.pass(false);
    for sent in &lab.sent[..2] {
        assert_eq!(sent.first().map(|(at, _)| *at), Some(opened + millis(500)));
        assert!(sent.len() > 4 && sent.iter().all(|(_, frame)| *frame != HEARTBEAT));
    }
}

/// H-17: a link that is opened again begins with a HEARTBEAT too, at once, whether or not one is due, and whether or not a frame
/// was cut off. Other links go on as they were.
#[test]
fn heartbeat_is_the_first_frame_of_a_link_that_opens_again() {
    for cut in [false, true] {
        let mut lab = Lab::new();
        for _ in 0..300 {
            lab.pass(true);
        }
        lab.sent = [const { Vec::new() }; 3];
        lab.stack.text(lab.now, MavSeverity::INFO, "Again");
        lab.receive(RADIO, 250, &Ping::default());
        if cut {
            let frame = lab.stack.transmit(lab.now, RADIO, &mut lab.vehicle);
            assert_eq!(frame[7..10], [4, 0, 0], "PING");
            lab.stack.transmitted(RADIO, 5);
        }
        lab.restart(RADIO);
        lab.receive(RADIO, 250, &Ping::default());
        for _ in 0..100 {
            lab.pass(true);
        }
        assert_eq!(lab.sent[0][0].1, HEARTBEAT);
        assert_eq!(lab.sent[0].iter().filter(|(_, frame)| *frame == HEARTBEAT).count(), 1, "in 100 ms");
        assert!(lab.sent[0].iter().any(|(_, (id, _))| *id == Statustext::ID));
        let pings = lab.sent[0].iter().filter(|(_, (id, _))| *id == Ping::ID).count();
        assert_eq!(pings, 2, "the frame that was cut off is sent again");
        assert_ne!(lab.sent[1][0].1, HEARTBEAT, "it was not opened again");
    }
}

/// H-17: also on a transport that takes no byte for longer than `max_loop_gap` after it has opened, as USB until the host opens
/// the port, the HEARTBEAT precedes the frame that was cut off.
#[test]
fn heartbeat_is_the_first_frame_of_a_transport_that_is_ready_late() {
    for late in [400, 600, 5_300] {
        let mut lab = Lab::new();
        for _ in 0..300 {
            lab.pass(true);
        }
        lab.receive(RADIO, 250, &Ping::default());
        assert_eq!(lab.stack.transmit(lab.now, RADIO, &mut lab.vehicle)[7..10], [4, 0, 0], "PING");
        lab.stack.transmitted(RADIO, 5);
        lab.restart(RADIO);
        lab.sent = [const { Vec::new() }; 3];
        for _ in 0..late {
            lab.now += millis(1);
            lab.pulse.tick();
            lab.stack.poll(lab.now, &mut lab.vehicle);
        }
        lab.pass(true);
        assert_eq!(lab.sent[0][0].1, HEARTBEAT, "{late} ms late");
        assert_eq!(lab.sent[0][1].1, (Ping::ID, 1), "{late} ms late");
    }
}

/// H-17: a frame that was cut off is sent from its start again, also without a heartbeat: nothing waits for one while the vehicle is in a
/// fault.
#[test]
fn frame_that_was_cut_off_is_sent_again_without_a_heartbeat() {
    let mut lab = Lab::new();
    for _ in 0..300 {
        lab.pass(true);
    }
    lab.vehicle.has_fault = true;
    lab.receive(RADIO, 250, &Ping::default());
    let frame = lab.stack.transmit(lab.now, RADIO, &mut lab.vehicle).to_vec();
    lab.stack.transmitted(RADIO, 5);
    lab.restart(RADIO);
    lab.now += millis(1);
    lab.stack.poll(lab.now, &mut lab.vehicle);
    assert_eq!(lab.stack.transmit(lab.now, RADIO, &mut lab.vehicle), frame);
}

/// H-17, H-7: a high-latency link carries no heartbeats, so nothing waits for one there.
#[test]
fn nothing_waits_on_a_high_latency_link() {
    let mut lab = Lab::new();
    for opened in 0..2 {
        lab.receive(SATELLITE, 250, &CommandLong { target_system: 1, target_component: 1, ..Default::default() });
        lab.pass(false);
        assert_eq!(lab.sent[2].len(), opened + 1);
        assert_eq!(lab.sent[2][opened].1, (CommandAck::ID, 1));
        lab.restart(SATELLITE);
    }
}
