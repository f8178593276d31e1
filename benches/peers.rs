//! Measures the cost per frame of the peer table and of forwarding, by the number of peers.
//!
//! Each round is 1,000 frames from all peers in turn, so 1 ms means 1 µs per frame. `overflow` has four times as many senders as
//! the table has slots, so that no frame comes from a sender in the table.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use mavstack::__private::Declares;
use mavstack::config::StreamProfile;
use mavstack::dialect;
use mavstack::dialect::{Attitude, Heartbeat, MavResult, PlayTune};
use mavstack::frame::{MAX_FRAME_LEN, Version, encode};
use mavstack::prelude::*;
use std::hint::black_box;

const FRAMES: usize = 1_000;
/// The link of all peers.
const FROM: LinkId = LinkId(0);
/// The link to which all frames are forwarded.
const TO: LinkId = LinkId(1);
/// The peer on the other link.
const STATION: Address = Address::new(255, 190);

static PULSE: Pulse = Pulse::new();
const CONFIG: Config = Config::new(Address::new(254, 1), &PULSE);

struct Rover;

impl Vehicle for Rover {
    fn state(&self) -> Option<VehicleState> {
        None
    }
}

impl Commands for Rover {
    fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome {
        MavResult::UNSUPPORTED.into()
    }
}

/// Returns the address of peer number `peer` of a swarm with three components per system.
fn address(peer: usize) -> Address {
    Address::new((peer / 3 % 253 + 1) as u8, (peer % 3 + 1 + peer / 759 * 3) as u8)
}

fn frame<M: Message>(message: &M, from: Address, seq: usize) -> Vec<u8> {
    let mut bytes = vec![0; MAX_FRAME_LEN];
    let len = encode(message, Version::V2, from, seq as u8, &mut bytes).expect("the buffer fits any frame");
    bytes.truncate(len);
    bytes
}

/// A vehicle with the declaration `D`, and frames from all senders in turn.
struct Bench<D: Declares<Vehicle = Rover>> {
    stack: Box<Stack<D, 2>>,
    frames: Vec<Vec<u8>>,
    now: Instant,
}

impl<D: Declares<Vehicle = Rover>> Bench<D> {
    fn new(senders: usize, make: impl Fn(Address, usize) -> Vec<u8>) -> Self {
        let links = [LinkConfig::unlimited().with_streams(StreamProfile::Off); 2];
        let mut bench = Self {
            stack: Box::new(Stack::VACANT),
            frames: (0..FRAMES).map(|n| make(address(n % senders), n / senders)).collect(),
            now: Instant::from_millis(1),
        };
        bench.stack.begin(CONFIG, links);
        // The station is alive, so it is not evicted.
        let heartbeat = Heartbeat { r#type: dialect::MavType::GCS, mavlink_version: 3, ..Heartbeat::default() };
        bench.stack.transmit(bench.now, TO, &mut Rover);
        bench.stack.receive(bench.now, TO, &frame(&heartbeat, STATION, 0), &mut Rover);
        for address in (0..senders).map(address) {
            bench.pass(&frame(&Attitude::default(), address, 99));
        }
        bench
    }

    /// Receives one frame, and sends what was queued for the other link.
    fn pass(&mut self, frame: &[u8]) -> usize {
        // Slow enough for the duplicate filter to remember every frame.
        self.now += Duration::from_millis(10);
        self.stack.receive(self.now, FROM, black_box(frame), &mut Rover);
        let sent = self.stack.transmit(self.now, TO, &mut Rover).len();
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
        ($($peers:literal),+) => { $({
            // One slot is for the station.
            #[derive(Stack)]
            #[stack(vehicle: Rover, links: 2, peers: $peers + 1)]
            struct Plain;
            #[derive(Stack)]
            #[stack(vehicle: Rover, links: 2, peers: $peers + 1, forwarding)]
            struct Forwards;
            let mut bench = Bench::<Plain>::new($peers, attitude);
            group.bench_function(concat!("book/", $peers), |bencher| bencher.iter(|| assert_eq!(bench.round(), 0)));
            let mut bench = Bench::<Forwards>::new($peers, attitude);
            group.bench_function(concat!("broadcast/", $peers), |bencher| bencher.iter(|| assert!(bench.round() > 0)));
            let mut bench = Bench::<Forwards>::new($peers, tune);
            group.bench_function(concat!("addressed/", $peers), |bencher| bencher.iter(|| assert!(bench.round() > 0)));
            let mut bench = Bench::<Forwards>::new($peers * 4, attitude);
            group.bench_function(concat!("overflow/", $peers), |bencher| bencher.iter(|| assert!(bench.round() > 0)));
        })+ };
    }
    tables!(1, 16, 64, 255);
    group.finish();
}

criterion_group!(benches, peers);
criterion_main!(benches);
