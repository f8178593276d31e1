//! A vehicle that flies in one task and speaks MAVLink in another. Neither task waits for the other.
//!
//! ```text
//!   flight, 1 kHz, highest priority  ── State ──▶ snapshot ──▶  MAVLink: the stack and its vehicle
//!     sensors, control, motors      ◀── Decision ◀── queue ◀──    hooks read the state, and queue decisions
//! ```
//!
//! The firmwares `tasks-loop`, `tasks-rtic` and `tasks-embassy` in `examples/qemu` run it. Replace [`Flight`] by your own.
#![no_std]

use heapless::spsc::{Consumer, Producer, Queue};
use mavstack::dialect::commands::{ComponentArmDisarm, NavTakeoff};
use mavstack::dialect::{Attitude, MavCmd, MavResult, MavType, VfrHud};
use mavstack::telemetry::Motion;
use mavstack::{
    Address, Command, Commands, Config, Context, Duration, Fill, LinkConfig, Message, Outcome, Parameters, Pulse,
    Stack, StackOf, Stream, Telemetry, Vehicle, VehicleState, parameters,
};
use mavstack_snapshot::{Reader, Snapshot, Writer};

/// A telemetry radio, and a companion computer.
pub const LINKS: [LinkConfig; 2] = [LinkConfig::uart(115_200), LinkConfig::uart(921_600)];

/// The stack.
#[derive(Stack)]
#[stack(vehicle: Copter, links: 2, parameters: Tuning, streams, commands: { slots: 2 })]
pub struct Mavlink;

parameters! {
    /// The parameters.
    pub struct Tuning {
        /// Altitude of a takeoff that names none.
        TAKEOFF_ALT: f32 = 2.5, 1.0..=10.0, "m";
    }
}

/// What flight tells the MAVLink task, a thousand times a second. All parts of it are of the same pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Whether the motors may turn.
    pub armed: bool,
    /// Altitude above home (m).
    pub altitude: f32,
    /// Roll, pitch and yaw (rad).
    pub attitude: [f32; 3],
    /// Number of takeoffs that have ended, which wraps.
    pub takeoffs: u8,
    /// Whether the last of them reached its altitude.
    pub took_off: bool,
}

impl State {
    /// On the ground, disarmed. All zero bits, so that the snapshot takes no flash.
    pub const START: Self = Self { armed: false, altitude: 0.0, attitude: [0.0; 3], takeoffs: 0, took_off: false };

    const fn is_flying(&self) -> bool {
        self.altitude > 0.1
    }
}

/// What the MAVLink task asks of flight. Each one counts, so it travels in a queue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision {
    /// Arms or disarms.
    Arm(bool),
    /// Climbs to this altitude above home (m).
    TakeOff(f32),
}

/// Slots of the queue. It holds one decision less.
const SLOTS: usize = 4;

/// The memory between the two tasks. All zero bits.
pub struct Between {
    pulse: Pulse,
    state: Snapshot<State>,
    decisions: Queue<Decision, SLOTS>,
}

impl Between {
    /// Nothing written, nothing queued.
    pub const fn new() -> Self {
        Self { pulse: Pulse::new(), state: Snapshot::new(State::START), decisions: Queue::new() }
    }

    /// Returns the two sides, one for each task, and the configuration of the stack, which watches this flight's pulse.
    pub fn split(&'static mut self) -> (Flight, Copter, Config) {
        let pulse = &self.pulse;
        let (writer, reader) = self.state.split();
        let (producer, consumer) = self.decisions.split();
        (
            Flight { state: State::START, target: None, pulse, writer, decisions: consumer },
            Copter { state: State::START, takeoffs: 0, reader, decisions: producer },
            Config { r#type: MavType::QUADROTOR, ..Config::new(Address::new(1, 1), pulse) },
        )
    }
}

impl Default for Between {
    fn default() -> Self {
        Self::new()
    }
}

/// The flight task's side, here a simulation. It shares nothing that can be locked.
pub struct Flight {
    state: State,
    /// Altitude of a running takeoff.
    target: Option<f32>,
    /// Ticked by each pass.
    pulse: &'static Pulse,
    writer: Writer<'static, State>,
    decisions: Consumer<'static, Decision>,
}

impl Flight {
    /// Runs one pass, 1 ms after the last one. It is bounded: it takes at most one decision, and a second core cannot keep it busy.
    pub fn step(&mut self) {
        if let Some(decision) = self.decisions.dequeue() {
            self.decide(decision);
        }
        // Sensors, control and motors of a vehicle that climbs at 2 m/s.
        let state = &mut self.state;
        if let Some(target) = self.target {
            state.altitude = (state.altitude + 0.002).min(target);
            if state.altitude >= target {
                self.end_takeoff(true);
            }
        }
        self.writer.write(self.state);
        self.pulse.tick();
    }

    /// Returns the state of the last pass.
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// Flight has the last word: the state may have changed since the decision was queued.
    fn decide(&mut self, decision: Decision) {
        match decision {
            Decision::Arm(arm) if arm || !self.state.is_flying() => self.state.armed = arm,
            Decision::Arm(_) => {}
            Decision::TakeOff(altitude) if self.state.armed && self.target.is_none() => self.target = Some(altitude),
            Decision::TakeOff(_) => self.end_takeoff(false),
        }
    }

    fn end_takeoff(&mut self, took_off: bool) {
        self.target = None;
        self.state.takeoffs = self.state.takeoffs.wrapping_add(1);
        self.state.took_off = took_off;
    }
}

/// The MAVLink task's side: the vehicle that the stack sees.
pub struct Copter {
    /// As last read. The hooks of one pass see the same state.
    state: State,
    /// Number of takeoffs that were queued, which wraps.
    takeoffs: u8,
    reader: Reader<'static, State>,
    decisions: Producer<'static, Decision>,
}

impl Copter {
    /// Reads the newest state, and ends the commands that flight has ended. Call it in each pass, before `Mavlink::poll`.
    pub fn refresh(&mut self, stack: &mut StackOf<Mavlink>) {
        self.state = self.reader.read();
        if self.state.takeoffs == self.takeoffs {
            let result = if self.state.took_off { MavResult::ACCEPTED } else { MavResult::FAILED };
            // Returns false if none is running.
            stack.long_commands_mut().finish(MavCmd::NAV_TAKEOFF, result);
        }
    }

    /// Queues a decision. ACCEPTED means that flight will get it.
    fn decide(&mut self, decision: Decision) -> MavResult {
        match self.decisions.enqueue(decision) {
            Ok(()) => MavResult::ACCEPTED,
            Err(_) => MavResult::TEMPORARILY_REJECTED,
        }
    }

    fn arm(&mut self, ComponentArmDisarm { arm, .. }: ComponentArmDisarm) -> MavResult {
        if !arm && self.state.is_flying() { MavResult::DENIED } else { self.decide(Decision::Arm(arm)) }
    }

    fn take_off(&mut self, cx: &mut Context<'_>, NavTakeoff { location, .. }: NavTakeoff) -> Outcome {
        if !self.state.armed {
            return MavResult::DENIED.into();
        }
        let outcome = cx.start();
        if outcome.result != MavResult::IN_PROGRESS {
            return outcome;
        }
        let altitude = location.altitude.filter(|altitude| *altitude > 0.0);
        match self.decide(Decision::TakeOff(altitude.unwrap_or_else(|| cx.parameter(Tuning::TAKEOFF_ALT)))) {
            MavResult::ACCEPTED => {
                self.takeoffs = self.takeoffs.wrapping_add(1);
                outcome
            }
            refused => refused.into(),
        }
    }
}

impl Vehicle for Copter {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(self.state.armed))
    }
}

impl Commands for Copter {
    fn command(&mut self, cx: &mut Context<'_>, command: &Command) -> Outcome {
        if command.is_broadcast {
            return MavResult::DENIED.into();
        }
        let outcome = match command.id {
            MavCmd::COMPONENT_ARM_DISARM => command.decode().map(|arm| self.arm(arm).into()),
            MavCmd::NAV_TAKEOFF => command.decode().map(|takeoff| self.take_off(cx, takeoff)),
            _ => Err(MavResult::UNSUPPORTED),
        };
        outcome.unwrap_or_else(Outcome::from)
    }
}

impl Telemetry for Copter {
    const STREAMS: &'static [Stream] = &[
        Stream::of::<Attitude>().every(Duration::from_millis(50)),
        Stream::of::<VfrHud>().every(Duration::from_millis(250)),
    ];

    fn fill(&mut self, id: u32, out: &mut Fill<'_>) -> bool {
        let State { altitude: relative_altitude, attitude, .. } = self.state;
        let motion = Motion { relative_altitude, attitude, ..Motion::UNKNOWN };
        match id {
            Attitude::ID => out.put(&motion.attitude(out.now())),
            VfrHud::ID => out.put(&motion.vfr_hud()),
            _ => false,
        }
    }
}

impl Parameters for Copter {
    type Table = Tuning;
}
