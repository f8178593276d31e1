//! The crane's custom messages on a link: received, streamed, requested, and announced by the firmware.

use example_own_message::{Crane, CraneControl, CraneHook, CraneReport, Known, Mavlink};
use mavstack::dialect::{CommandAck, CommandLong, MavCmd, MavResult};
use mavstack::frame::{Decoder, MAX_FRAME_LEN, Version, encode};
use mavstack::message::Dialect;
use mavstack::{Address, Config, Instant, LinkConfig, LinkId, Message, Pulse, StackOf};

const LINK: LinkId = LinkId(0);
const GCS: Address = Address::new(255, 190);

struct Bench {
    stack: StackOf<Mavlink>,
    crane: Crane,
    decoder: Decoder,
    now: Instant,
}

impl Bench {
    fn new() -> Self {
        let config = Config::new(Address::new(7, 1), Box::leak(Box::new(Pulse::new())));
        Self {
            stack: StackOf::<Mavlink>::new(config, [LinkConfig::uart(57_600)]),
            crane: Crane::default(),
            decoder: Decoder::default(),
            now: Instant::from_millis(1),
        }
    }

    fn receive<M: Message>(&mut self, message: &M) {
        let mut frame = [0; MAX_FRAME_LEN];
        let len = encode(message, Version::V2, GCS, 0, &mut frame).expect("the buffer fits any frame");
        self.stack.receive(self.now, LINK, &frame[..len], &mut self.crane);
    }

    /// Returns the messages of type `M` that the crane sends within `millis`.
    fn sent<M: Message>(&mut self, millis: u64) -> Vec<M> {
        self.frames(millis).iter().filter_map(Sent::get).collect()
    }

    fn frames(&mut self, millis: u64) -> Vec<Sent> {
        let mut sent = Vec::new();
        for _ in 0..millis {
            self.stack.poll(self.now, &mut self.crane);
            let bytes = self.stack.transmit(self.now, LINK, &mut self.crane).to_vec();
            self.stack.transmitted(LINK, bytes.len());
            let _ = self.decoder.push(&bytes, self.now);
            while let Some(frame) = self.decoder.next(self.now, Known::MESSAGES, &mut u32::MAX.clone(), |_| true) {
                sent.push(Sent { id: frame.id(), payload: frame.payload().to_vec() });
            }
            self.now += mavstack::Duration::from_millis(1);
        }
        sent
    }
}

/// A frame that the crane sent.
struct Sent {
    id: u32,
    payload: Vec<u8>,
}

impl Sent {
    fn get<M: Message>(&self) -> Option<M> {
        (self.id == M::ID).then(|| M::decode(&self.payload))
    }
}

fn control(speed: f32, target_system: u8) -> CraneControl {
    CraneControl { speed, target_system, target_component: 1 }
}

#[test]
fn commands_are_filtered_by_target_system() {
    let mut bench = Bench::new();
    bench.receive(&control(-0.5, 7));
    assert_eq!(bench.crane.speed, -0.5);
    bench.receive(&control(2.0, 8));
    assert_eq!(bench.crane.speed, -0.5);
    bench.receive(&control(0.25, 0));
    assert_eq!(bench.crane.speed, 0.25);
    assert_eq!(bench.stack.link_counters(LINK).map(|link| (link.unknown, link.not_ours)), Some((0, 1)));
}

#[test]
fn the_report_is_streamed() {
    let mut bench = Bench::new();
    bench.crane.line_out = 12.5;
    let reports = bench.sent::<CraneReport>(5_000);
    assert!((9..=11).contains(&reports.len()), "{} in 5 s at 2 per second", reports.len());
    assert!(reports.iter().all(|report| report.line_out == 12.5 && report.hook == CraneHook::CLOSED));
    assert!(reports.iter().all(|report| report.tension == i16::MAX), "not measured");
}

/// Sends a command about a message. Returns the result, and the number of reports within a second.
fn command(bench: &mut Bench, command: MavCmd, id: u32, param2: f32) -> (Option<MavResult>, usize) {
    let param1 = id as f32;
    bench.receive(&CommandLong {
        target_system: 7,
        target_component: 1,
        command,
        param1,
        param2,
        ..Default::default()
    });
    let frames = bench.frames(1_000);
    let result = frames.iter().find_map(|frame| frame.get::<CommandAck>()).map(|ack| ack.result);
    (result, frames.iter().filter_map(Sent::get::<CraneReport>).count())
}

#[test]
fn the_report_is_sent_on_request() {
    let mut bench = Bench::new();
    // Stop the stream first.
    command(&mut bench, MavCmd::SET_MESSAGE_INTERVAL, CraneReport::ID, -1.0);
    assert!(bench.sent::<CraneReport>(2_000).is_empty());
    let answer = command(&mut bench, MavCmd::REQUEST_MESSAGE, CraneReport::ID, 0.0);
    assert_eq!(answer, (Some(MavResult::ACCEPTED), 1));
    let (result, reports) = command(&mut bench, MavCmd::REQUEST_MESSAGE, CraneControl::ID, 0.0);
    assert!(
        result.is_some_and(|result| result != MavResult::ACCEPTED) && reports == 0,
        "{result:?}: the crane does not send it"
    );
}

#[test]
fn an_announced_report_is_sent_at_once() {
    let mut bench = Bench::new();
    bench.sent::<CraneReport>(600);
    bench.receive(&control(1.0, 7));
    assert_eq!(bench.sent::<CraneReport>(5).len(), 1, "by the vehicle, in a hook");
    bench.stack.announce::<CraneReport>();
    assert_eq!(bench.sent::<CraneReport>(5).len(), 1, "by the loop");
}
