//! What an open link may say in the name of a component that signs on another one: rule X-1.

use crate::support::signer::*;
use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::Version;
use mavstack::signing::{LinkSigning, SigningKey};
use mavstack::{
    Address, Command, CommandClient, CommandReply, Commands, Config, Context, Instant, LinkConfig, LinkId, Message,
    Outcome, OutgoingCommand, Pulse, Stack, StackOf, Telemetry, Vehicle, VehicleState,
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

impl Vehicle for Asking {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }
}

impl Commands for Asking {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

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
