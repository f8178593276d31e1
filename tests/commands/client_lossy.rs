//! Two stacks on a line that loses a fifth of all frames in each direction: one requests, the other one carries out. Rules K-1, K-3,
//! K-6, K-8 and C-12.
//!
//! However the frames are lost, each request has one end, and that is the truth: what was answered was carried out once, and what
//! timed out was carried out at most once.

use std::collections::BTreeMap;

use crate::support::*;
use mavstack::dialect::*;
use mavstack::{
    Address, CommandClient, CommandReply, Context, Duration, Fill, LinkConfig, LinkId, Message, OutgoingCommand,
    ParamAnswer, Peer, Stack, Telemetry, Text, Vehicle, VehicleState,
};

const SERVER: Address = Address::new(1, 154);
const LINK: LinkId = LinkId(0);
const SEEDS: u64 = 100;

/// A command that is carried out once.
const ONCE: MavCmd = MavCmd::DO_REPEAT_SERVO;
/// A command that takes its time.
const LONG: MavCmd = MavCmd::NAV_TAKEOFF;
/// Tokens from here on are for [`LONG`].
const LONGER: u16 = 100;
/// Tokens from here on request AUTOPILOT_VERSION.
const INFORM: u16 = 200;

/// A vehicle that requests things, and notes what it is told.
#[derive(Default)]
struct Asker {
    replies: Vec<(u16, CommandReply)>,
    params: Vec<(u16, Option<f32>)>,
    /// How often each message was filled.
    filled: BTreeMap<u16, u32>,
    /// The number of AUTOPILOT_VERSION received.
    informed: usize,
}

impl Vehicle for Asker {
    fn state(&self) -> Option<VehicleState> {
        TestVehicle::new().state
    }

    fn message(&mut self, _: &mut Context<'_>, frame: &mavstack::Frame<'_>, _: LinkId) -> bool {
        self.informed += usize::from(frame.id() == AutopilotVersion::ID);
        true
    }
}

without_commands!(Asker);

impl CommandClient for Asker {
    fn command_for(&mut self, token: u16) -> Option<OutgoingCommand> {
        Some(match token {
            INFORM.. => OutgoingCommand::request_message::<AutopilotVersion>(0),
            LONGER.. => OutgoingCommand::long(LONG, [0.0; 7]),
            _ => OutgoingCommand::long(ONCE, [1.0, 1_000.0 + f32::from(token), 3.0, 0.5, 0.0, 0.0, 0.0]),
        })
    }

    fn command_answered(&mut self, _: &mut Context<'_>, token: u16, reply: CommandReply) {
        self.replies.push((token, reply));
    }

    const READS_PARAMS: bool = true;

    fn param_for(&mut self, token: u16) -> Option<Text<16>> {
        Some(Text::new(if token == 0 { "CRUISE" } else { "NOTHING" }))
    }

    fn param_answered(&mut self, _: &mut Context<'_>, token: u16, answer: ParamAnswer<'_>) {
        let value = match answer {
            ParamAnswer::Value(value) => Some(value.param_value),
            ParamAnswer::Refused(error) => {
                assert_eq!((token, error), (1, MavParamError::DOES_NOT_EXIST));
                None
            }
            // Told apart from a refusal.
            ParamAnswer::TimedOut => Some(f32::INFINITY),
            answer => panic!("{answer:?}"),
        };
        self.params.push((token, value));
    }
}

impl Telemetry for Asker {
    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        assert_eq!(id, Tunnel::ID);
        *self.filled.entry(out.index()).or_default() += 1;
        out.put(&Tunnel {
            payload_type: MavTunnelPayloadType(out.index()),
            target_system: SERVER.system.wire(),
            target_component: SERVER.component.wire(),
            ..Tunnel::default()
        })
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: Asker, links: 1, messages, command_client: { slots: 2 })]
struct Asking;

/// The two stacks and the line between them.
struct Pair {
    clock: Clock,
    ends: [Port; 2],
    asker: Asker,
    asking: Box<Stack<Asking, 1>>,
    server: TestVehicle,
    serving: Box<Stack<Tested, 1>>,
    pulses: [&'static mavstack::Pulse; 2],
}

impl Pair {
    fn new(seed: u64) -> Self {
        let clock = Clock::default();
        // Every other line is so slow that each request is repeated before its answer is received.
        let latency = if seed.is_multiple_of(2) { millis(20) } else { millis(400) };
        let line = Line::new(&clock, LineConfig::radio(57_600, latency), seed);
        let (near, far) = line.ends();
        let (a, b) = (Setup::<1>::new().config, Setup::<1>::new().config);
        let pulses = [a.pulse.unwrap(), b.pulse.unwrap()];
        let b = mavstack::Config {
            r#type: MavType::GIMBAL,
            address: mavstack::config::VehicleAddress::new(SERVER).unwrap(),
            ..b
        };
        let links = [LinkConfig::uart(57_600).with_own_system(true)];
        let mut pair = Self {
            clock,
            ends: [near, far],
            asker: Asker::default(),
            asking: begun(a, links),
            server: TestVehicle::new(),
            serving: begun(b, links),
            pulses,
        };
        pair.server.outcomes.insert(ONCE.0, MavResult::ACCEPTED.into());
        pair.server.outcomes.remove(&LONG.0);
        pair.server.long.insert(LONG.0);
        pair.server.handles.insert(Tunnel::ID);
        // They find each other while the line is good.
        pair.run(secs(3));
        line.set_up(|wire| wire.faults = Faults::frames(0.2, 0.0));
        line.set_down(|wire| wire.faults = Faults::frames(0.2, 0.0));
        pair
    }

    fn run(&mut self, duration: Duration) {
        let end = self.clock.now() + duration;
        while self.clock.now() < end {
            let now = self.clock.now() + millis(10);
            self.clock.set(now);
            self.pulses.iter().for_each(|pulse| pulse.tick());
            self.asking.poll(now, &mut self.asker);
            self.serving.poll(now, &mut self.server);
            self.asking.poll_link(now, LINK, &mut self.ends[0], &mut self.asker).unwrap();
            self.serving.poll_link(now, LINK, &mut self.ends[1], &mut self.server).unwrap();
        }
    }

    /// Returns the final replies to a token.
    fn ends_of(&self, token: u16) -> Vec<CommandReply> {
        let replies = self.asker.replies.iter().filter(|(of, _)| *of == token).map(|(_, reply)| *reply);
        replies.filter(|reply| !matches!(reply, CommandReply::InProgress(_))).collect()
    }

    /// Returns the only final reply to a token.
    fn end_of(&self, token: u16) -> CommandReply {
        let ends = self.ends_of(token);
        assert_eq!(ends.len(), 1, "{token}: {ends:?}");
        ends[0]
    }

    /// Returns how often the server carried out the command of a token.
    fn runs_of(&self, token: u16) -> usize {
        let param2 = 1_000.0 + f32::from(token);
        self.server.commands().iter().filter(|command| command.id == ONCE && command.params[1] == param2).count()
    }
}

const fn done(result: MavResult) -> CommandReply {
    CommandReply::Done { result, result_param2: 0 }
}

/// K-1, K-2, C-12: each command has one end. If that is ACCEPTED, it was carried out exactly once. Of five transmissions one
/// gets through and is answered in 99.4 % of all cases, and of the four that can be answered in time on a slow line in 98.3 %.
#[test]
fn commands_are_carried_out_once() {
    let (mut answered, mut timed_out) = (0, 0);
    for seed in 0..SEEDS {
        let mut pair = Pair::new(seed);
        // The server remembers as many.
        for token in 0..3 {
            assert!(pair.asking.send_command(SERVER, token));
        }
        pair.run(secs(20));
        for token in 0..3 {
            let (end, runs) = (pair.end_of(token), pair.runs_of(token));
            match end {
                CommandReply::Done { result: MavResult::ACCEPTED, .. } if runs == 1 => answered += 1,
                CommandReply::TimedOut if runs <= 1 => timed_out += 1,
                _ => panic!("seed {seed}, {token}: {end:?}, carried out {runs} times"),
            }
        }
    }
    assert!(timed_out * 25 <= answered, "{answered} answered, {timed_out} timed out");
}

/// K-3: a command that takes its time has one end too. It is the right one, unless the final answer was lost, which nobody
/// repeats: then it times out.
#[test]
fn long_commands_end_once() {
    let (mut answered, mut timed_out) = (0, 0);
    for seed in 0..SEEDS {
        let mut pair = Pair::new(seed);
        assert!(pair.asking.send_command(SERVER, LONGER));
        pair.run(secs(4));
        pair.serving.long_commands_mut().finish(LONG, MavResult::FAILED);
        pair.run(secs(40)); // Silence ends it after 30 s.
        let runs = pair.server.commands().len();
        match pair.end_of(LONGER) {
            end if end == done(MavResult::FAILED) && runs == 1 => answered += 1,
            CommandReply::TimedOut if runs <= 1 => timed_out += 1,
            end => panic!("seed {seed}: {end:?}, carried out {runs} times"),
        }
    }
    assert!(answered * 2 > timed_out * 5, "{answered} answered, {timed_out} timed out");
}

/// K-3, C-23: a cancelled command has one end, and the vehicle that carries it out is told once to stop. Its final answer is not
/// repeated either: a COMMAND_CANCEL for a command that does not run is ignored.
#[test]
fn cancelled_commands_end_once() {
    let (mut cancelled, mut timed_out) = (0, 0);
    for seed in 0..SEEDS {
        let mut pair = Pair::new(seed);
        assert!(pair.asking.send_command(SERVER, LONGER));
        pair.run(secs(2));
        assert!(pair.asking.cancel_sent_command(LONGER));
        pair.run(secs(40)); // Silence ends it after 30 s.
        let stops = pair.server.calls.iter().filter(|call| matches!(call, Call::CancelCommand(..))).count();
        match pair.end_of(LONGER) {
            end if end == done(MavResult::CANCELLED) && stops == 1 => cancelled += 1,
            CommandReply::TimedOut if stops <= 1 => timed_out += 1,
            end => panic!("seed {seed}: {end:?}, told {stops} times to stop"),
        }
        assert!(pair.server.commands().len() <= 1);
    }
    assert!(cancelled * 2 > timed_out * 5, "{cancelled} cancelled, {timed_out} timed out");
}

/// K-6: a parameter that is read is answered once, with its value or with the reason why there is none.
#[test]
fn parameters_are_answered_once() {
    let mut timed_out = 0;
    for seed in 0..SEEDS {
        let mut pair = Pair::new(seed);
        assert!(pair.asking.read_param(SERVER, 0) && pair.asking.read_param(SERVER, 1));
        pair.run(secs(8));
        pair.asker.params.sort_by_key(|(token, _)| *token);
        let [(0, cruise), (1, nothing)] = pair.asker.params[..] else { panic!("seed {seed}: {:?}", pair.asker.params) };
        for (value, expected) in [(cruise, Some(5.0)), (nothing, None)] {
            assert!([expected, Some(f32::INFINITY)].contains(&value), "seed {seed}: {value:?}");
            timed_out += u64::from(value == Some(f32::INFINITY));
        }
    }
    assert!(timed_out * 25 <= 2 * SEEDS, "{timed_out} timed out");
}

/// K-1, Q-3: a request for a message is answered once. The message may be lost even if the request is answered.
#[test]
fn requests_for_messages_are_answered_once() {
    let mut informed = 0;
    for seed in 0..SEEDS {
        let mut pair = Pair::new(seed);
        assert!(pair.asking.send_command(SERVER, INFORM));
        pair.run(secs(8));
        let end = pair.end_of(INFORM);
        assert!([done(MavResult::ACCEPTED), CommandReply::TimedOut].contains(&end), "seed {seed}: {end:?}");
        informed += u64::from(pair.asker.informed > 0);
    }
    assert!(informed * 10 > SEEDS * 7, "{informed} of {SEEDS}");
}

/// K-8: a message to a peer is made once and sent once. A fifth of them is lost, and the others are received once each, in order.
#[test]
fn messages_to_a_peer_are_sent_once() {
    let mut received = 0;
    for seed in 0..SEEDS / 5 {
        let mut pair = Pair::new(seed);
        let peer = Peer { address: SERVER, link: LINK };
        for index in 0..50 {
            assert!(pair.asking.send::<Tunnel>(peer, index), "{index}");
            pair.run(millis(100));
        }
        pair.run(secs(1));
        assert!(pair.asker.filled.len() == 50 && pair.asker.filled.values().all(|times| *times == 1));
        let index = |call: &Call| match call {
            Call::Message { id: Tunnel::ID, payload, .. } => Some(Tunnel::decode(payload).payload_type.0),
            _ => None,
        };
        let indices: Vec<_> = pair.server.calls.iter().filter_map(index).collect();
        assert!(indices.is_sorted_by(|before, after| before < after), "seed {seed}: {indices:?}");
        received += indices.len() as u64;
    }
    let sent = 50 * (SEEDS / 5);
    assert!((sent * 7..sent * 9).contains(&(received * 10)), "{received} of {sent}");
}
