//! What an open link may say in the name of a component that signs on another one: rule X-1.

use crate::support::signer::*;
use crate::support::*;
use mavstack::config::LinkClass;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::high_latency::HighLatency;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{
    Address, CommandClient, CommandReply, Config, Context, Instant, LinkConfig, LinkId, Message, OutgoingCommand,
    Pulse, Stack, StackOf, Telemetry,
};

const AUTHORISER: Address = Address::new(10, 1);
/// It requires signatures; the wire is open.
const RADIO: LinkId = LinkId(0);
const WIRE: LinkId = LinkId(1);

/// A vehicle that asks before it arms, and arms if the answer is ACCEPTED.
#[derive(Default)]
struct Asking {
    armed: u32,
    unanswered: u32,
}

plain_vehicle!(Asking);

impl Telemetry for Asking {}

impl CommandClient for Asking {
    fn command_for(&mut self, _: u16) -> Option<OutgoingCommand> {
        Some(OutgoingCommand::long(MavCmd::ARM_AUTHORIZATION_REQUEST, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    }

    fn command_answered(&mut self, _: &mut Context<'_>, _: u16, reply: CommandReply) {
        match reply {
            CommandReply::Done { result: MavResult::ACCEPTED, .. } => self.armed += 1,
            _ => self.unanswered += 1,
        }
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Asking, links: 2, command_client: { slots: 1 }, signing: { streams: 4 })]
struct Armed;

struct Field {
    stack: Box<StackOf<Armed>>,
    vehicle: Asking,
    now: Instant,
    pulse: &'static Pulse,
}

impl Field {
    fn new() -> Self {
        let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
        let links =
            [LinkSigning::REQUIRED, LinkSigning::OPEN].map(|signing| LinkConfig::uart(57_600).with_signing(signing));
        let mut stack: Box<Stack<Armed, 2>> = begun(Config::new(VEHICLE, pulse), links);
        let now = Instant::from_millis(5_000);
        stack.signing_mut().set_key(now, SigningKey::new(KEY), NOW);
        Self { stack, vehicle: Asking::default(), now, pulse }
    }

    /// Runs for 100 ms, and returns whether a command was sent on a link.
    fn run(&mut self) -> [bool; 2] {
        self.now += millis(100);
        self.pulse.tick();
        self.stack.poll(self.now, &mut self.vehicle);
        [RADIO, WIRE].map(|link| {
            let mut is_asked = false;
            loop {
                let frame = self.stack.transmit(self.now, link, &mut self.vehicle).to_vec();
                if frame.is_empty() {
                    return is_asked;
                }
                is_asked |= frame[7..10] == CommandLong::ID.to_le_bytes()[..3];
                self.stack.transmitted(link, frame.len());
            }
        })
    }

    fn receive(&mut self, link: LinkId, frame: &[u8]) {
        assert_eq!(self.stack.receive(self.now, link, frame, &mut self.vehicle), frame.len());
    }
}

/// the authoriser signs on its radio. An open wire sends HEARTBEATs and answers in its name: the command was sent there too, and the
/// wire's answer armed the vehicle. Now 0 of 20 do. The authoriser's own answers arm it 20 times of 20, though the wire answers first.
#[test]
fn an_unsigned_answer_on_another_link_authorises_nothing() {
    let mut field = Field::new();
    let (mut true_one, mut forger) = (Signer::new(KEY).of(AUTHORISER), Signer::new(KEY).of(AUTHORISER));
    let beat = Heartbeat { r#type: MavType::ONBOARD_CONTROLLER, ..Gcs::heartbeat() };
    let ack = CommandAck {
        command: MavCmd::ARM_AUTHORIZATION_REQUEST,
        target_system: VEHICLE.system.wire(),
        target_component: VEHICLE.component.wire(),
        ..CommandAck::UNKNOWN
    };
    for answers in [false, true] {
        for _ in 0..20 {
            let frame = true_one.frame(&beat);
            field.receive(RADIO, &frame);
            assert!(field.stack.send_command(AUTHORISER, 1));
            for _ in 0..60 {
                let [is_asked, is_forger_asked] = field.run();
                assert!(!is_forger_asked, "nobody is asked on the wire");
                for message in [forger.unsigned(Version::V2, &beat), forger.unsigned(Version::V2, &ack)] {
                    field.receive(WIRE, &message);
                }
                if is_asked && answers {
                    let frame = true_one.frame(&ack);
                    field.receive(RADIO, &frame);
                }
            }
        }
        let expected = if answers { (20, 20) } else { (0, 20) };
        assert_eq!((field.vehicle.armed, field.vehicle.unanswered), expected);
    }
}

/// on an open link, invented stations have settled in all places but those of newcomers, and go on inventing. A pilot who signs keeps
/// an entry among them. Before, the next newcomer took it after 5 s, again and again.
#[test]
fn a_signer_keeps_an_entry_among_those_who_do_not_sign() {
    let mut rig: Rig<1> = Rig::new([LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN)]);
    rig.set_key(KEY);
    let (mut pilot, mut missed) = (Signer::new(KEY), 0);
    let mut others: Vec<_> = (60..80).map(|system| Signer::new(KEY).of(Address::new(system, 190))).collect();
    for second in 0..100 {
        for (number, other) in others.iter_mut().enumerate() {
            // Six of eight places are for those who stay.
            if number < 6 || second >= 40 {
                let frame = other.unsigned(Version::V2, &Gcs::heartbeat());
                rig.receive(0, &frame);
            }
        }
        rig.run_for(millis(500));
        if second >= 40 {
            let frame = pilot.frame(&Gcs::heartbeat());
            rig.receive(0, &frame);
        }
        let is_there = rig.stack.peers(rig.now).any(|info| info.peer.address == STATION);
        missed += u32::from(second >= 55 && !is_there);
        rig.run_for(millis(500));
        let is_there = rig.stack.peers(rig.now).any(|info| info.peer.address == STATION);
        missed += u32::from(second >= 55 && !is_there);
    }
    assert_eq!(missed, 0);
}

/// A vehicle that one station controls, with a satellite link.
#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 3,
    plans: { mission: 4 },
    commands: { slots: 2 },
    forwarding,
    operator_control,
    signing: { streams: 4 },
)]
struct Controlled {
    high_latency: HighLatency,
}

const SATELLITE: LinkId = LinkId(2);
const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);

struct Flight {
    stack: Box<StackOf<Controlled>>,
    vehicle: TestVehicle,
    now: Instant,
    pulse: &'static Pulse,
}

impl Flight {
    /// The owner may be silent. The satellite link knows a station.
    fn new() -> Self {
        let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
        let [radio, wire] =
            [LinkSigning::REQUIRED, LinkSigning::OPEN].map(|signing| LinkConfig::uart(57_600).with_signing(signing));
        let satellite = wire.with_class(LinkClass::HighLatency);
        let mut stack: Box<StackOf<Controlled>> = begun(Config::new(VEHICLE, pulse), [radio, wire, satellite]);
        let now = Instant::from_millis(5_000);
        stack.signing_mut().set_key(now, SigningKey::new(KEY), NOW);
        stack.operator_control_mut().set_release_on_loss(false);
        let mut flight = Self { stack, vehicle: TestVehicle::new(), now, pulse };
        flight.exchange(SATELLITE, &Signer::new(KEY).unsigned(Version::V2, &Attitude::default()));
        flight
    }

    /// Receives a frame, and runs for 200 ms. Returns what is sent on that link and by satellite.
    fn exchange(&mut self, link: LinkId, frame: &[u8]) -> [Vec<Sent>; 2] {
        assert_eq!(self.stack.receive(self.now, link, frame, &mut self.vehicle), frame.len());
        let mut sent = [link, SATELLITE].map(|_| Vec::new());
        for _ in 0..10 {
            self.now += millis(20);
            self.pulse.tick();
            self.stack.poll(self.now, &mut self.vehicle);
            for (link, sent) in [link, SATELLITE].into_iter().zip(&mut sent) {
                loop {
                    let raw = self.stack.transmit(self.now, link, &mut self.vehicle).to_vec();
                    if raw.is_empty() {
                        break;
                    }
                    self.stack.transmitted(link, raw.len());
                    sent.push(Sent { raw });
                }
            }
        }
        sent
    }

    fn answer<M: Message>(&mut self, link: LinkId, frame: &[u8]) -> Option<M> {
        let [sent, _] = self.exchange(link, frame);
        sent.iter().filter(|sent| sent.id() == M::ID).find_map(Sent::decode)
    }

    fn result(&mut self, link: LinkId, frame: &[u8]) -> Option<MavResult> {
        self.answer::<CommandAck>(link, frame).map(|ack| ack.result)
    }

    /// Receives 15 commands for the station. Returns the number of those that are forwarded by satellite.
    fn forwarded(&mut self, link: LinkId, mut frame: impl FnMut(&CommandLong) -> Vec<u8>) -> usize {
        let (target_system, target_component) = (STATION.system.wire(), STATION.component.wire());
        let message = CommandLong { target_system, target_component, ..long(MavCmd::DO_SET_SERVO, 1.0) };
        let mut all = 0;
        for _ in 0..15 {
            let [_, sent] = self.exchange(link, &frame(&message));
            all += sent.iter().filter(|sent| sent.id() == CommandLong::ID).count();
        }
        all
    }
}

fn long(command: MavCmd, param1: f32) -> CommandLong {
    CommandLong { param1, command, target_system: 1, target_component: 1, ..CommandLong::default() }
}

const PLAN: MissionCount = MissionCount { count: 1, target_system: 1, target_component: 1, ..MissionCount::UNKNOWN };

/// a station takes control with a signed frame. What an open wire sends in its name is not the owner's. Before, it landed the
/// vehicle, uploaded a plan, released control, and used the credits that are reserved for the owner.
#[test]
fn only_signed_frames_are_those_of_a_signed_owner() {
    let mut flight = Flight::new();
    let (mut owner, mut forger) = (Signer::new(KEY).of(OTHER_STATION), Signer::new(KEY).of(OTHER_STATION));
    let [take, release] = [1.0, 0.0].map(|action| long(REQUEST_OPERATOR_CONTROL, action));
    let land = long(MavCmd::NAV_LAND, 0.0);
    assert_eq!(flight.result(RADIO, &owner.frame(&take)), Some(MavResult::ACCEPTED));
    for (message, expected) in
        [(land, MavResult::NOT_IN_CONTROL), (take, MavResult::FAILED), (release, MavResult::FAILED)]
    {
        let frame = forger.unsigned(Version::V2, &message);
        assert_eq!(flight.result(WIRE, &frame), Some(expected), "{message:?}");
    }
    let refused = flight.answer::<MissionAck>(WIRE, &forger.unsigned(Version::V2, &PLAN));
    assert_eq!(refused.map(|ack| ack.r#type), Some(MavMissionResult::DENIED));
    let forwarded = flight.forwarded(WIRE, |message| forger.unsigned(Version::V2, message));
    assert_eq!(forwarded, 10, "the half of the burst that is for all");

    assert_eq!(flight.result(RADIO, &owner.frame(&land)), Some(MavResult::ACCEPTED));
    assert!(flight.answer::<MissionRequestInt>(RADIO, &owner.frame(&PLAN)).is_some());
    // A signed command is longer than what one credit pays for.
    assert_eq!(flight.forwarded(RADIO, |message| owner.frame(message)), 5, "the owner's half, two credits each");
    assert_eq!(flight.result(RADIO, &owner.frame(&release)), Some(MavResult::ACCEPTED));
}

/// X-1, O-5: a station that took control with a signed frame is lost. Heartbeats in its name from an open wire kept it in control; now
/// control is released as without them.
#[test]
fn forged_heartbeats_keep_no_signed_owner_in_control() {
    let mut flight = Flight::new();
    flight.stack.operator_control_mut().set_release_on_loss(true);
    let (mut owner, mut forger) = (Signer::new(KEY).of(OTHER_STATION), Signer::new(KEY).of(OTHER_STATION));
    flight.exchange(RADIO, &owner.frame(&Gcs::heartbeat()));
    let take = owner.frame(&long(REQUEST_OPERATOR_CONTROL, 1.0));
    assert_eq!(flight.result(RADIO, &take), Some(MavResult::ACCEPTED));
    for _ in 0..50 {
        flight.exchange(WIRE, &forger.unsigned(Version::V2, &Gcs::heartbeat()));
    }
    assert_eq!(flight.stack.operator(flight.now), None);
}

/// O-5: a station that has taken control on an open link goes on unsigned, and may sign too.
#[test]
fn an_unsigned_owner_goes_on() {
    let mut flight = Flight::new();
    let mut owner = Signer::new(KEY).of(OTHER_STATION);
    let [take, release] = [1.0, 0.0].map(|action| long(REQUEST_OPERATOR_CONTROL, action));
    let land = long(MavCmd::NAV_LAND, 0.0);
    for message in [take, land, take] {
        let frame = owner.unsigned(Version::V2, &message);
        assert_eq!(flight.result(WIRE, &frame), Some(MavResult::ACCEPTED), "{message:?}");
    }
    assert!(flight.answer::<MissionRequestInt>(WIRE, &owner.unsigned(Version::V2, &PLAN)).is_some());
    assert_eq!(flight.result(RADIO, &owner.frame(&land)), Some(MavResult::ACCEPTED));
    let forwarded = flight.forwarded(WIRE, |message| owner.unsigned(Version::V2, message));
    assert!(forwarded > 10, "{forwarded} of both halves");
    assert_eq!(flight.result(WIRE, &owner.unsigned(Version::V2, &release)), Some(MavResult::ACCEPTED));
}
