//! A bounded model check of operator control: O-5, and C-5, J-2 and J-6 for senders that are not in control.
//!
//! Two ground stations (one is heard on both links), the companion computer, and a sender without heartbeats send requests,
//! releases, answers to the stack's questions, commands, sticks and setpoints, and time passes, in every order. The real stack runs
//! beside an independent reference model. The stack cannot be copied, so each sequence runs from the beginning.
//!
//! - [`every_order`] enumerates all sequences of a length, whatever state the model is in.
//! - [`every_state`] runs each action in each reachable state, after a shortest sequence: 420,000 states, until there are no more.
//!
//! A lost frame is an action that does not happen; a delayed frame, such as the owner's consent after another station took over, is an
//! action that happens later. The property test in `operator_control.rs` sends the other kinds of messages, in random sequences.

use crate::support::*;
use mavstack::dialect::*;
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::network::PeerInfo;
use mavstack::{Address, Command, Instant, LinkConfig, LinkId, Message, Peer, Stack};
use std::collections::{HashSet, VecDeque};

mavstack::message! {
    struct ControlStatus: CONTROL_STATUS = 512 {
        flags: u8,
        gcs_main: u8,
        gcs_secondary: [u8; 10],
    }
}

#[derive(mavstack::Stack)]
#[stack(vehicle: TestVehicle, links: 2, commands: { slots: 2 }, manual_control, operator_control)]
struct Controlled {
    setpoints: mavstack::setpoints::Setpoints,
}

const REQUEST_OPERATOR_CONTROL: MavCmd = MavCmd(32_100);

/// The time that passes in one action: every timeout is a multiple of it.
const TICK_MS: u64 = 500;
/// Ticks without a heartbeat after which a station is lost.
const LOST: u8 = 3;
/// Ticks for which sticks and setpoints are valid.
const VALID: u8 = 2;
/// Ticks between two notices to the owner.
const NOTICE: u8 = 6;

/// A sender on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Actor {
    /// A ground station, on each of the two links.
    First0,
    First1,
    /// Another ground station, on the second link.
    Second1,
    /// The companion computer on board, on the first link.
    Companion0,
    /// A sender without heartbeats, on the second link.
    Silent1,
}

use Actor::{Companion0, First0, First1, Second1, Silent1};

impl Actor {
    const fn peer(self) -> Peer {
        let (address, link) = match self {
            First0 => (STATION, 0),
            First1 => (STATION, 1),
            Second1 => (OTHER_STATION, 1),
            Companion0 => (Address::new(1, 191), 0),
            Silent1 => (Address::new(77, 190), 1),
        };
        Peer { address, link: LinkId(link) }
    }

    const fn system(self) -> u8 {
        self.peer().address.system.wire()
    }

    const fn link(self) -> usize {
        self.peer().link.0 as usize
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Action {
    Tick,
    Beat(Actor),
    /// Requests control, and says whether it allows a takeover.
    Request(Actor, bool),
    Release(Actor),
    /// Answers a notice.
    Answer(Actor),
    Command(Actor),
    Stick(Actor),
    Setpoint(Actor),
    /// The first link is lost, or found again.
    Cut,
    /// The firmware releases control.
    Failsafe,
}

use Action::{Answer, Beat, Cut, Failsafe, Release, Setpoint, Stick, Tick};

const ACTIONS: [Action; 28] = [
    Tick,
    Cut,
    Failsafe,
    Beat(First0),
    Beat(First1),
    Beat(Second1),
    Action::Request(First0, false),
    Action::Request(First0, true),
    Action::Request(Second1, false),
    Action::Request(Second1, true),
    Action::Request(Silent1, false),
    Action::Request(Companion0, true),
    Release(First1),
    Release(Second1),
    Answer(First1),
    Answer(Second1),
    Action::Command(First0),
    Action::Command(First1),
    Action::Command(Second1),
    Action::Command(Companion0),
    Action::Command(Silent1),
    Stick(First0),
    Stick(First1),
    Stick(Second1),
    Setpoint(First0),
    Setpoint(Second1),
    Setpoint(Companion0),
    Setpoint(Silent1),
];

impl Action {
    const fn actor(self) -> Option<Actor> {
        match self {
            Tick | Cut | Failsafe => None,
            Beat(actor)
            | Self::Request(actor, _)
            | Release(actor)
            | Answer(actor)
            | Self::Command(actor)
            | Stick(actor)
            | Setpoint(actor) => Some(actor),
        }
    }
}

/// What the owner is told about a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Notice {
    left: u8,
    link: usize,
    requester: u8,
    allows: bool,
}

/// A notice that was sent: its link, requester, whether that one would allow a takeover, and how often it was sent before.
type Sent = (usize, u8, bool, u8);

/// The sender of valid input, and its age in ticks.
type Input = Option<(Actor, u8)>;

/// The reference model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Model {
    /// Whether control is kept when its owner is lost.
    keeps: bool,
    /// Whether the first link is lost.
    is_cut: bool,
    /// The system in control.
    owner: Option<u8>,
    allows: bool,
    /// Ticks since the heartbeats of `First0`, `First1` and `Second1`.
    beats: [u8; 3],
    /// Which of `First0` and `First1` was heard first: it is told if both are alive.
    first: Option<Actor>,
    notice: Option<Notice>,
    /// Ticks until another notice may be sent, of whichever request.
    wait: u8,
    sticks: Input,
    setpoint: Input,
}

/// What an action must cause.
#[derive(Debug, Default, PartialEq)]
struct Effects {
    /// The answer to a command.
    result: Option<MavResult>,
    /// The command that the vehicle carries out.
    command: Option<Peer>,
    notices: Vec<Sent>,
}

impl Model {
    const fn new(keeps: bool) -> Self {
        let (owner, first, notice, sticks, setpoint) = (None, None, None, None, None);
        Self { keeps, is_cut: false, owner, allows: false, beats: [LOST; 3], first, notice, wait: 0, sticks, setpoint }
    }

    /// Whether a frame of the action can be received.
    fn is_possible(&self, action: Action) -> bool {
        !self.is_cut || action.actor().is_none_or(|actor| actor.link() != 0)
    }

    fn is_alive(&self, actor: Actor) -> bool {
        self.beats.get(actor as usize).is_some_and(|&age| age < LOST)
    }

    /// The ground station of a system that is alive, the first that was heard.
    fn station(&self, system: u8) -> Option<Actor> {
        let stations = if self.first == Some(First1) { [First1, First0, Second1] } else { [First0, First1, Second1] };
        stations.into_iter().find(|station| station.system() == system && self.is_alive(*station))
    }

    fn may(&self, actor: Actor) -> bool {
        self.owner.is_none_or(|owner| owner == actor.system()) || actor.system() == VEHICLE.system.wire()
    }

    fn own(&mut self, owner: Option<u8>, allows: bool) {
        (self.owner, self.allows, self.notice) = (owner, allows, None);
    }

    /// A request, and the result that the sender gets.
    fn request(&mut self, actor: Actor, allows: bool) -> MavResult {
        let system = actor.system();
        if system == VEHICLE.system.wire() {
            return MavResult::DENIED;
        }
        let can_own = self.keeps || self.station(system).is_some();
        let is_free = self.allows || self.owner.is_none_or(|owner| owner == system);
        if can_own && is_free {
            self.own(Some(system), allows);
            // Who is not in control steers no longer.
            for input in [&mut self.sticks, &mut self.setpoint] {
                *input = input.filter(|(from, _)| [system, VEHICLE.system.wire()].contains(&from.system()));
            }
            return MavResult::ACCEPTED;
        }
        if can_own && let Some(to) = self.owner.and_then(|owner| self.station(owner)) {
            self.notice = Some(Notice { left: 3, link: to.link(), requester: system, allows });
        }
        MavResult::FAILED
    }

    fn tick(&mut self) {
        self.beats = self.beats.map(|age| LOST.min(age + 1));
        for input in [&mut self.sticks, &mut self.setpoint] {
            *input = input.map(|(from, age)| (from, age + 1)).filter(|&(_, age)| age < VALID);
        }
        self.wait = self.wait.saturating_sub(1);
        if self.owner.is_some_and(|owner| !self.keeps && self.station(owner).is_none()) {
            self.own(None, false);
        }
    }

    fn on(&mut self, action: Action) -> Effects {
        let mut effects = Effects::default();
        if let Some(actor @ (First0 | First1)) = action.actor() {
            self.first = self.first.or(Some(actor));
        }
        match action {
            Tick => self.tick(),
            Cut => self.is_cut = !self.is_cut,
            Failsafe => self.own(None, false),
            Beat(actor) => self.beats[actor as usize] = 0,
            Action::Request(actor, allows) => effects.result = Some(self.request(actor, allows)),
            Release(actor) => {
                let is_owner = self.owner.is_none_or(|owner| owner == actor.system());
                effects.result = Some(if is_owner { MavResult::ACCEPTED } else { MavResult::FAILED });
                if is_owner {
                    self.own(None, false);
                }
            }
            Answer(actor) if self.owner == Some(actor.system()) => self.notice = None,
            Answer(_) => {}
            Action::Command(actor) => {
                let may = self.may(actor);
                effects.result = Some(if may { MavResult::ACCEPTED } else { MavResult::NOT_IN_CONTROL });
                effects.command = may.then(|| actor.peer());
            }
            Stick(actor) | Setpoint(actor) => {
                let may = self.may(actor);
                let input = if matches!(action, Stick(_)) { &mut self.sticks } else { &mut self.setpoint };
                // One sender at a time.
                if may && input.is_none_or(|(from, _)| from == actor) {
                    *input = Some((actor, 0));
                }
            }
        }
        let (is_cut, may_send) = (self.is_cut, self.wait == 0);
        if let Some(notice) = self.notice.as_mut().filter(|notice| may_send && !(is_cut && notice.link == 0)) {
            let Notice { left, link, requester, allows, .. } = *notice;
            effects.notices.push((link, requester, allows, 3 - left));
            (notice.left, self.wait) = (left - 1, NOTICE);
            self.notice = self.notice.filter(|notice| notice.left > 0);
        }
        effects
    }
}

/// The stack, and the model beside it.
struct Pair {
    stack: Box<Stack<Controlled, 2>>,
    vehicle: TestVehicle,
    now: u64,
    seqs: [u8; 5],
    /// The last CONTROL_STATUS on each link.
    statuses: [Option<(u8, u8)>; 2],
    model: Model,
}

impl Pair {
    fn new(keeps: bool, config: mavstack::Config) -> Self {
        let config = mavstack::Config { peer_timeout: millis(TICK_MS * u64::from(LOST)), ..config };
        let mut stack: Box<Stack<Controlled, 2>> = begun(config, [LinkConfig::unlimited().with_own_system(true); 2]);
        let (source, valid) = (
            ControlSource::Systems { first: SystemId::new(1), last: SystemId::new(255) },
            millis(TICK_MS * u64::from(VALID)),
        );
        stack.manual_input_mut().set_source(source);
        stack.manual_input_mut().set_timeout(valid);
        stack.setpoints.set_source(source);
        stack.setpoints.set_timeout(valid);
        stack.operator_control_mut().set_release_on_loss(!keeps);
        let (mut vehicle, model) = (TestVehicle::new(), Model::new(keeps));
        // The links wait for a heartbeat from the first frame that they are asked for, and no longer when the test begins (H-17).
        stack.poll(Instant::ZERO, &mut vehicle);
        for link in [LinkId(0), LinkId(1)] {
            assert!(stack.transmit(Instant::ZERO, link, &mut vehicle).is_empty());
        }
        Self { stack, vehicle, now: 1_000, seqs: [0; 5], statuses: [None; 2], model }
    }

    fn receive<M: Message>(&mut self, actor: Actor, message: &M) {
        let (seq, from) = (&mut self.seqs[actor as usize], actor.peer());
        let mut frame = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, from.address, *seq, &mut frame).expect("every message fits");
        *seq = seq.wrapping_add(1);
        let now = Instant::from_millis(self.now);
        assert_eq!(self.stack.receive(now, from.link, &frame[..len], &mut self.vehicle), len);
    }

    fn act(&mut self, action: Action) {
        let (target_system, target_component) = (1, 1);
        let long = |command, param1, param2| CommandLong {
            command,
            param1,
            param2,
            target_system,
            target_component,
            ..Default::default()
        };
        match action {
            Tick => {
                self.now += TICK_MS;
                self.stack.poll(Instant::from_millis(self.now), &mut self.vehicle);
            }
            Cut => {}
            Failsafe => self.stack.operator_control_mut().release(),
            Beat(actor) => self.receive(actor, &Gcs::heartbeat()),
            Action::Request(actor, allows) => {
                self.receive(actor, &long(REQUEST_OPERATOR_CONTROL, 1.0, f32::from(u8::from(allows))));
            }
            Release(actor) => self.receive(actor, &long(REQUEST_OPERATOR_CONTROL, 0.0, 0.0)),
            Answer(actor) => {
                let command = REQUEST_OPERATOR_CONTROL;
                self.receive(actor, &CommandAck { command, target_system, target_component, ..Default::default() });
            }
            Action::Command(actor) => self.receive(actor, &long(MavCmd::NAV_LAND, 0.0, 0.0)),
            Stick(actor) => self.receive(actor, &ManualControl { target: 1, x: 100, z: 500, ..Default::default() }),
            Setpoint(actor) => self
                .receive(actor, &SetPositionTargetLocalNed { target_system, target_component, ..Default::default() }),
        }
    }

    /// Takes what the stack sends on the links that are there.
    fn drain(&mut self, effects: &mut Effects) {
        let now = Instant::from_millis(self.now);
        let is_cut = self.model.is_cut;
        for link in (0..2).filter(|link| !is_cut || *link != 0) {
            let mut sent = Vec::new();
            loop {
                let bytes = self.stack.transmit(now, LinkId(link as u8), &mut self.vehicle);
                let len = bytes.len();
                if len == 0 {
                    break;
                }
                sent.extend_from_slice(bytes);
                self.stack.transmitted(LinkId(link as u8), len);
            }
            let mut rest = &sent[..];
            while let [0xFD, len, _, _, _, _, _, a, b, c, frame @ ..] = rest {
                let (payload, after) = frame.split_at(usize::from(*len));
                rest = &after[2..];
                match u32::from_le_bytes([*a, *b, *c, 0]) {
                    ControlStatus::ID => {
                        let status = ControlStatus::decode(payload);
                        self.statuses[link] = Some((status.flags, status.gcs_main));
                    }
                    CommandAck::ID => {
                        assert_eq!(effects.result, None, "a second answer");
                        effects.result = Some(CommandAck::decode(payload).result);
                    }
                    CommandLong::ID => {
                        let notice = CommandLong::decode(payload);
                        assert_eq!((notice.command, notice.param1), (REQUEST_OPERATOR_CONTROL, 1.0));
                        assert_eq!(Some(notice.target_system), self.model.owner, "only the owner is told");
                        effects.notices.push((link, notice.param4 as u8, notice.param2 == 1.0, notice.confirmation));
                    }
                    // Some refusals are explained.
                    Statustext::ID => {}
                    id => panic!("message {id}"),
                }
            }
            assert!(rest.is_empty(), "{rest:?}");
        }
    }

    /// Runs an action on both, and compares them.
    fn on(&mut self, action: Action) {
        let owner_before = self.stack.operator(Instant::from_millis(self.now));
        self.vehicle.calls.clear();
        self.act(action);
        let expected = self.model.on(action);
        let mut effects = Effects::default();
        self.drain(&mut effects);
        let commands: Vec<Command> = self.vehicle.commands();
        assert!(commands.len() <= 1, "{commands:?}");
        effects.command = commands.first().map(|command| command.from);
        // Independent of the model: who is not in control reaches no hook.
        if let (Some(owner), Some(from)) = (owner_before, effects.command) {
            assert!([owner, VEHICLE.system].contains(&from.address.system), "{from:?}");
        }
        assert!(self.vehicle.calls.iter().all(|call| matches!(call, Call::Peer(_) | Call::Command(_))));
        assert_eq!(effects, expected);
        let Model { owner, allows, is_cut, .. } = self.model;
        let allows = allows || owner.is_none();
        assert_eq!(
            (
                self.stack.operator(Instant::from_millis(self.now)).map(|owner| owner.wire()),
                self.stack.allows_takeover(Instant::from_millis(self.now))
            ),
            (owner, allows)
        );
        for (link, status) in self.statuses.into_iter().enumerate().filter(|(link, _)| !is_cut || *link != 0) {
            assert_eq!(status, Some((1 | u8::from(allows) << 1, owner.unwrap_or(0))), "CONTROL_STATUS on link {link}");
        }
        for actor in [First0, First1, Second1] {
            let is_it = |info: &PeerInfo| info.peer == actor.peer() && info.is_living_station();
            assert_eq!(
                self.stack.peers(Instant::from_millis(self.now)).any(|info| is_it(&info)),
                self.model.is_alive(actor),
                "{actor:?} is alive"
            );
        }
        let now = Instant::from_millis(self.now);
        let input = |input: Input| input.map(|(from, _)| from.peer());
        let sticks = self.stack.manual_input().manual_control(now).map(|sticks| sticks.from);
        let setpoint = self.stack.setpoints.current(now).map(|setpoint| setpoint.from);
        assert_eq!([sticks, setpoint], [input(self.model.sticks), input(self.model.setpoint)], "sticks, setpoint");
        assert_eq!([self.stack.manual_input().holder(now), self.stack.setpoints.owner(now)], [sticks, setpoint]);
    }
}

/// A state of the model, and what the stack remembers of operator control.
type State = (Model, String);

/// Returns what the stack remembers of operator control, as text: without its counters, and with times from now. States of the
/// model alone are not enough: an action that must have no effect, but has one that shows later, would seem to lead back.
fn remembered(pair: &Pair) -> String {
    let text = format!("{:?}", pair.stack.operator_control());
    let part = |from: &str, to: &str| {
        let (_, rest) = text.split_once(from).unwrap_or_else(|| panic!("no {from} in {text}"));
        rest.split_once(to).unwrap_or_else(|| panic!("no {to} in {text}")).0
    };
    let control = part("owner: ", ", changes: ");
    let (left, notice) = (part("left: ", ","), part("to: ", ", at: "));
    // It means nothing when none is left.
    if left == "0" {
        return control.to_owned();
    }
    let at: String = part(", at: ", "}").chars().filter(char::is_ascii_digit).collect();
    let at: u64 = at.parse().expect("microseconds");
    format!("{control}, {left} {notice} in {}", at.saturating_sub(pair.now * 1_000))
}

/// Runs a sequence from the beginning. Returns the state at its end; `None` if an action is not possible in it.
fn run(keeps: bool, config: mavstack::Config, actions: &[Action]) -> Option<Pair> {
    let run = || {
        let mut pair = Pair::new(keeps, config);
        for &action in actions {
            if !pair.model.is_possible(action) {
                return None;
            }
            pair.on(action);
        }
        Some(pair)
    };
    // The sequence is the counterexample.
    std::panic::catch_unwind(run).unwrap_or_else(|fault| {
        println!("kept when lost: {keeps}; {actions:?}");
        std::panic::resume_unwind(fault)
    })
}

/// Runs all sequences of `len` actions.
fn every_order(len: u32) {
    let config = Setup::<2>::new().config;
    let count = ACTIONS.len().pow(len);
    for keeps in [false, true] {
        let mut possible = 0;
        for number in 0..count {
            let mut rest = number;
            let actions: Vec<_> = (0..len)
                .map(|_| {
                    let action = ACTIONS[rest % ACTIONS.len()];
                    rest /= ACTIONS.len();
                    action
                })
                .collect();
            possible += usize::from(run(keeps, config, &actions).is_some());
        }
        println!("{possible} of {count} sequences of {len} actions are possible; kept when lost: {keeps}");
    }
}

/// Runs every action in every state of the model that is reached by at most `depth` - 1 actions after `start`.
fn every_state(start: &[Action], depth: usize) {
    let config = Setup::<2>::new().config;
    let after = |keeps, actions: &[Action]| -> State {
        let pair = run(keeps, config, actions).expect("each action is possible");
        (pair.model, remembered(&pair))
    };
    for keeps in [false, true] {
        let first = after(keeps, start);
        let mut left = VecDeque::from([(first.0, start.to_vec())]);
        let mut seen = HashSet::from([first]);
        let (mut steps, mut deepest) = (0, 0);
        while let Some((model, path)) = left.pop_front() {
            if path.len() == depth.saturating_add(start.len()) {
                continue;
            }
            deepest = deepest.max(path.len());
            for action in ACTIONS.into_iter().filter(|action| model.is_possible(*action)) {
                let path: Vec<_> = path.iter().copied().chain([action]).collect();
                let next = after(keeps, &path);
                steps += 1;
                let model = next.0;
                if seen.insert(next) {
                    left.push_back((model, path));
                }
            }
        }
        let states = seen.len();
        println!(
            "{states} states, {steps} steps in sequences of up to {} actions; kept when lost: {keeps}",
            deepest + 1
        );
    }
}

/// O-5, C-5, J-2, J-6: all sequences of three actions.
#[test]
fn only_the_owner_is_obeyed_in_every_order() {
    every_order(3);
}

/// O-5, C-5, J-2, J-6: all sequences of five actions.
#[test]
#[ignore = "a minute in a release build: `cargo measure nightly operator-control`"]
fn only_the_owner_is_obeyed_in_every_longer_order() {
    every_order(5);
}

/// O-5, C-5, J-2, J-6: every action in every state that is a few actions from the beginning.
#[test]
fn only_the_owner_is_obeyed_in_every_near_state() {
    every_state(&[], 5);
}

/// O-5: every action in every state a few actions away from a refused request that the owner is told of.
#[test]
fn only_the_owner_consents_in_every_near_state() {
    let refused = [Beat(First0), Beat(Second1), Action::Request(First0, false), Action::Request(Second1, false)];
    every_state(&refused, 4);
}

/// O-5, C-5, J-2, J-6: every action in every state.
#[test]
#[ignore = "a minute in a release build: `cargo measure nightly operator-control`"]
fn only_the_owner_is_obeyed_in_every_state() {
    every_state(&[], usize::MAX);
}
