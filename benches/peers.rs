//! What one frame costs beside so many peers: to be booked in the table, and to be forwarded by it.
//!
//! Each round is 1,000 frames of all peers in turn, so 1 ms is 1 µs a frame. In `overflow` there are four times as many senders
//! as the table has places for, so that every frame comes from one that is not in it.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mavstack::dialect::{Attitude, Heartbeat, MavResult, MissionState, PlayTune};
use mavstack::*;
use std::hint::black_box;

const FRAMES: usize = 1_000;
/// The link that everybody is on, and the one that everything is forwarded to.
const FROM: LinkId = LinkId(0);
const TO: LinkId = LinkId(1);
/// Who is on the other link.
const STATION: Address = Address::new(255, 190);

static PULSE: Pulse = Pulse::new();
const CONFIG: Config = Config::new(Address::new(254, 1), &PULSE);

/// Forwards, or not.
struct Rover(Option<ForwardQueues<2>>);

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        None
    }

    fn forwarding(&mut self) -> Option<Forwarding<'_>> {
        self.0.as_mut().map(ForwardQueues::forwarding)
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

impl Plans for Rover {
    const MISSION_COMMANDS: &'static [CommandRule] = &[];

    fn plan_changed(&mut self, _: PlanChange<'_>) {}

    fn progress(&self) -> Progress {
        Progress { current: 0, state: MissionState::NOT_STARTED, in_mission_mode: false }
    }
}

impl Telemetry for Rover {}

impl Parameters for Rover {
    type Table = NoParams;
}

/// The address of number `peer` of a swarm: three components a system.
fn address(peer: usize) -> Address {
    Address::new((peer / 3 % 253 + 1) as u8, (peer % 3 + 1 + peer / 759 * 3) as u8)
}

fn frame<M: Message>(message: &M, from: Address, seq: usize) -> Vec<u8> {
    let mut bytes = vec![0; MAX_FRAME_LEN];
    let len = encode(message, Version::V2, from, seq as u8, &mut bytes).expect("it has room");
    bytes.truncate(len);
    bytes
}

/// A vehicle with a table of `PEERS` places, and frames of `senders` in turn.
struct Bench<const PEERS: usize> {
    stack: Box<Stack<2, NoPlans, PEERS>>,
    rover: Rover,
    frames: Vec<Vec<u8>>,
    now: Instant,
}

impl<const PEERS: usize> Bench<PEERS> {
    fn new(senders: usize, forwards: bool, make: impl Fn(Address, usize) -> Vec<u8>) -> Self {
        let links = [LinkConfig::unlimited().with_streams(StreamProfile::Off); 2];
        let mut bench = Self {
            stack: Box::new(Stack::with_capacities(CONFIG, links)),
            rover: Rover(forwards.then(ForwardQueues::new)),
            frames: (0..FRAMES).map(|n| make(address(n % senders), n / senders)).collect(),
            now: Instant::from_millis(1),
        };
        // The station is alive, so that it keeps its place.
        let heartbeat = Heartbeat { r#type: dialect::MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
        bench.stack.transmit(bench.now, TO, &mut bench.rover);
        bench.stack.receive(bench.now, TO, &frame(&heartbeat, STATION, 0), &mut bench.rover);
        for address in (0..senders).map(address) {
            bench.pass(&frame(&Attitude::default(), address, 99));
        }
        bench
    }

    /// One frame comes in; what it has put into the other link's queue goes out.
    fn pass(&mut self, frame: &[u8]) -> usize {
        // Slowly enough for every frame to be remembered.
        self.now = self.now.after(Duration::from_millis(10));
        self.stack.receive(self.now, FROM, black_box(frame), &mut self.rover);
        let sent = self.stack.transmit(self.now, TO, &mut self.rover).len();
        self.stack.transmitted(TO, sent);
        sent
    }

    fn round(&mut self) -> usize {
        let frames = core::mem::take(&mut self.frames);
        let sent = frames.iter().map(|frame| self.pass(frame)).sum();
        self.frames = frames;
        sent
    }
}

fn peers(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("peers");
    group.throughput(Throughput::Elements(FRAMES as u64));
    let attitude = |from, seq| frame(&Attitude { yaw: 1.0, ..Attitude::default() }, from, seq);
    let tune =
        |from, seq| frame(&PlayTune { target_system: 255, target_component: 190, ..PlayTune::default() }, from, seq);
    macro_rules! tables {
        ($($peers:literal),+) => { $(
            // One place is the station's.
            let mut bench = Bench::<{ $peers + 1 }>::new($peers, false, attitude);
            group.bench_function(concat!("book/", $peers), |bencher| bencher.iter(|| assert_eq!(bench.round(), 0)));
            let mut bench = Bench::<{ $peers + 1 }>::new($peers, true, attitude);
            group.bench_function(concat!("broadcast/", $peers), |bencher| bencher.iter(|| assert!(bench.round() > 0)));
            let mut bench = Bench::<{ $peers + 1 }>::new($peers, true, tune);
            group.bench_function(concat!("addressed/", $peers), |bencher| bencher.iter(|| assert!(bench.round() > 0)));
            let mut bench = Bench::<{ $peers + 1 }>::new($peers * 4, true, attitude);
            group.bench_function(concat!("overflow/", $peers), |bencher| bencher.iter(|| assert!(bench.round() > 0)));
        )+ };
    }
    tables!(1, 16, 64, 255);
    group.finish();
}

criterion_group!(benches, peers);
criterion_main!(benches);
