//! Commands become decisions of flight, and what flight reports becomes their answer. Rules C-20, H-5.

use mavstack::dialect::{CommandAck, CommandLong, Common, Heartbeat, MavCmd, MavModeFlag, MavResult};
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Duration, Instant, LinkId, Message, StackOf};
use mavstack_tasks::{Between, Copter, Flight, LINKS, Mavlink};

const LINK: LinkId = LinkId(0);
const GCS: Address = Address::new(255, 190);

struct Bench {
    flight: Flight,
    copter: Copter,
    stack: Box<StackOf<Mavlink>>,
    decoder: Decoder,
    now: Instant,
    sequence: u8,
}

impl Bench {
    fn new() -> Self {
        let (flight, copter, config) = Box::leak(Box::new(Between::new())).split();
        let stack = Box::new(StackOf::<Mavlink>::new(config, LINKS));
        let now = Instant::from_millis(1);
        let mut bench = Self { flight, copter, stack, decoder: Decoder::default(), now, sequence: 0 };
        // Answers wait for the first HEARTBEAT of a link that opens (H-17).
        assert_eq!(bench.run(1).0, Some(false));
        bench
    }

    /// Sends a command, and returns the answer within the same pass of the MAVLink task. Flight does not run.
    fn command(&mut self, command: MavCmd, param1: f32, param7: f32) -> Option<MavResult> {
        let (target_system, target_component) = (1, 1);
        let message = CommandLong { command, param1, param7, target_system, target_component, ..Default::default() };
        let mut frame = [0; MAX_FRAME_LEN];
        self.sequence += 1;
        let len = encode(&message, Version::V2, GCS, self.sequence, &mut frame).expect("the buffer fits any frame");
        self.stack.receive(self.now, LINK, &frame[..len], &mut self.copter);
        self.mavlink().1
    }

    /// A pass of the MAVLink task. Returns whether a heartbeat said that the vehicle is armed, and the last answer to a command.
    fn mavlink(&mut self) -> (Option<bool>, Option<MavResult>) {
        self.copter.refresh(&mut self.stack);
        self.stack.poll(self.now, &mut self.copter);
        let (mut armed, mut result) = (None, None);
        for _ in 0..20 {
            self.now += Duration::from_micros(50);
            let bytes = self.stack.transmit(self.now, LINK, &mut self.copter).to_vec();
            self.stack.transmitted(LINK, bytes.len());
            let _ = self.decoder.push(&bytes, self.now);
            while let Some(frame) = self.decoder.next(self.now, Common::MESSAGES, &mut u32::MAX.clone(), |_| true) {
                match frame.id() {
                    Heartbeat::ID => {
                        let mode = Heartbeat::decode(frame.payload()).base_mode;
                        armed = Some(mode.contains(MavModeFlag::SAFETY_ARMED));
                    }
                    CommandAck::ID => result = Some(CommandAck::decode(frame.payload()).result),
                    _ => {}
                }
            }
        }
        (armed, result)
    }

    /// Runs both tasks. Returns what was said last.
    fn run(&mut self, millis: u32) -> (Option<bool>, Option<MavResult>) {
        let (mut armed, mut result) = (None, None);
        for _ in 0..millis {
            self.flight.step();
            let said = self.mavlink();
            (armed, result) = (said.0.or(armed), said.1.or(result));
        }
        (armed, result)
    }

    fn arm(&mut self) {
        assert_eq!(self.command(MavCmd::COMPONENT_ARM_DISARM, 1.0, 0.0), Some(MavResult::ACCEPTED));
        assert_eq!(self.run(1_500).0, Some(true));
    }
}

/// The command is accepted when flight is certain to get it. The heartbeat shows what flight has done.
#[test]
fn arming_is_queued_and_reported() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(1_500).0, Some(false));
    bench.arm();
}

/// While the queue is full, commands are refused, and none is lost that was accepted.
#[test]
fn a_full_queue_rejects_commands() {
    let mut bench = Bench::new();
    let answers = [1.0, 0.0, 1.0, 0.0].map(|arm| bench.command(MavCmd::COMPONENT_ARM_DISARM, arm, 0.0));
    assert_eq!(answers[..3], [Some(MavResult::ACCEPTED); 3]);
    assert_eq!(answers[3], Some(MavResult::TEMPORARILY_REJECTED));
    assert_eq!(bench.run(1_500).0, Some(true), "the last accepted command");
}

/// C-20: a takeoff is in progress until flight reports its end.
#[test]
fn a_takeoff_ends_when_flight_reports_it() {
    let mut bench = Bench::new();
    assert_eq!(bench.command(MavCmd::NAV_TAKEOFF, 0.0, 3.0), Some(MavResult::DENIED), "not armed");
    bench.arm();
    assert_eq!(bench.command(MavCmd::NAV_TAKEOFF, 0.0, 3.0), Some(MavResult::IN_PROGRESS));
    // 3 m at 2 m/s.
    assert_eq!(bench.run(1_400).1, Some(MavResult::IN_PROGRESS));
    assert_eq!(bench.run(150).1, Some(MavResult::ACCEPTED));
    assert_eq!(bench.command(MavCmd::COMPONENT_ARM_DISARM, 0.0, 0.0), Some(MavResult::DENIED), "in the air");
}

/// C-20: flight refuses a takeoff that was queued after the last state was read.
#[test]
fn flight_has_the_last_word() {
    let mut bench = Bench::new();
    bench.arm();
    assert_eq!(bench.command(MavCmd::COMPONENT_ARM_DISARM, 0.0, 0.0), Some(MavResult::ACCEPTED));
    assert_eq!(bench.command(MavCmd::NAV_TAKEOFF, 0.0, 3.0), Some(MavResult::IN_PROGRESS));
    assert_eq!(bench.run(10).1, Some(MavResult::FAILED));
}

/// H-5: the pulse is flight's, so the heartbeats stop with it, although the MAVLink task runs on.
#[test]
fn heartbeats_stop_with_flight() {
    let mut bench = Bench::new();
    assert!(bench.run(1_500).0.is_some());
    let said: Vec<_> = (0..5_000).map(|_| bench.mavlink().0).collect();
    assert!(said[600..].iter().all(Option::is_none), "500 ms after the last tick");
    assert!(bench.run(1_500).0.is_some());
}
