//! Several vehicles that forward, the lines between them, and what hangs on these lines, in simulated time.

use super::{Rng, TestVehicle, millis};
use mavstack::{Address, Config, Duration, ForwardQueues, Instant, LinkConfig, LinkId, NoPlans, Pulse, Stack};
use std::collections::{BTreeMap, VecDeque};

/// Links of every vehicle, used or not.
const LINKS: usize = 6;

/// Who is at an end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// A vehicle, and which of its links that is.
    Vehicle(usize, LinkId),
    /// A leaf: what comes out is only recorded.
    Leaf,
}

/// One direction of a line.
#[derive(Debug, Default)]
struct Lane {
    /// Frames on their way, with the time of their arrival.
    in_flight: VecDeque<(Instant, Vec<u8>)>,
    /// Until then it is sending.
    busy_until: Instant,
}

/// A line between two ends.
#[derive(Debug)]
pub struct Line {
    pub ends: [End; 2],
    /// Bytes a millisecond, each way; 0 is infinitely fast.
    pub rate: u64,
    pub latency: Duration,
    /// The share of frames that get lost.
    pub loss: f64,
    /// Frames that arrived, by the end at which they came out, and how often.
    pub delivered: [BTreeMap<Vec<u8>, usize>; 2],
    lanes: [Lane; 2],
    /// What a leaf at each end is still to send.
    waiting: [VecDeque<Vec<u8>>; 2],
}

/// A vehicle.
#[derive(Debug)]
pub struct Node<const PEERS: usize> {
    pub stack: Box<Stack<LINKS, NoPlans, PEERS>>,
    pub vehicle: TestVehicle,
    pulse: &'static Pulse,
    used: u8,
}

/// Vehicles 1, 2, 3… and the lines between them.
#[derive(Debug)]
pub struct Network<const PEERS: usize> {
    pub nodes: Vec<Node<PEERS>>,
    pub lines: Vec<Line>,
    pub now: Instant,
    /// Whether the flight loops run, and heartbeats go out.
    pub has_heartbeats: bool,
    rng: Rng,
}

impl<const PEERS: usize> Network<PEERS> {
    /// So many vehicles, without a line, with links of `bytes_per_second`.
    pub fn new(vehicles: u8, bytes_per_second: u32, seed: u64) -> Self {
        let node = |system| {
            let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
            let link = LinkConfig { bytes_per_second, ..LinkConfig::unlimited() };
            let stack = Stack::with_capacities(Config::new(Address::new(system, 1), pulse), [link; LINKS]);
            let vehicle = TestVehicle { queues: Some(Box::new(ForwardQueues::new())), ..TestVehicle::new() };
            Node { stack: Box::new(stack), vehicle, pulse, used: 0 }
        };
        Self {
            nodes: (1..=vehicles).map(node).collect(),
            lines: Vec::new(),
            now: Instant::from_millis(1),
            has_heartbeats: false,
            rng: Rng::new(seed),
        }
    }

    /// Lays a line from the next free link of a vehicle to that of another one, or to a leaf; returns its number.
    pub fn join(&mut self, from: usize, to: Option<usize>, rate: u64, latency: Duration) -> usize {
        let mut end = |node: usize| {
            let link = LinkId(self.nodes[node].used);
            self.nodes[node].used += 1;
            End::Vehicle(node, link)
        };
        let ends = [end(from), to.map_or(End::Leaf, end)];
        self.lines.push(Line {
            ends,
            rate,
            latency,
            loss: 0.0,
            delivered: Default::default(),
            lanes: Default::default(),
            waiting: Default::default(),
        });
        self.lines.len() - 1
    }

    /// Has the leaf of a line send `frame`.
    pub fn send(&mut self, line: usize, frame: Vec<u8>) {
        self.lines[line].waiting[1].push_back(frame);
    }

    /// How often `frame` came out of each line, at each end.
    pub fn deliveries(&self, frame: &[u8]) -> Vec<[usize; 2]> {
        let of = |line: &Line| [0, 1].map(|end| line.delivered[end].get(frame).copied().unwrap_or(0));
        self.lines.iter().map(of).collect()
    }

    /// One pass of every flight loop.
    pub fn step(&mut self) {
        self.now = self.now.after(millis(1));
        let Self { nodes, lines, now, has_heartbeats, rng } = self;
        for node in nodes.iter_mut() {
            if *has_heartbeats {
                node.pulse.tick();
            }
            node.stack.poll(*now, &mut node.vehicle);
        }
        for line in lines.iter_mut() {
            line.step(*now, nodes, rng);
        }
    }

    /// Runs for `duration`.
    pub fn run_for(&mut self, duration: Duration) {
        for _ in 0..duration.as_millis() {
            self.step();
        }
    }

    /// Whether nothing is on its way.
    pub fn is_quiet(&self) -> bool {
        let is_quiet = |line: &Line| {
            line.waiting.iter().all(VecDeque::is_empty) && line.lanes.iter().all(|lane| lane.in_flight.is_empty())
        };
        self.lines.iter().all(is_quiet)
    }
}

impl Line {
    fn step<const PEERS: usize>(&mut self, now: Instant, nodes: &mut [Node<PEERS>], rng: &mut Rng) {
        for from in [0, 1] {
            let to = 1 - from;
            let lane = &mut self.lanes[from];
            while now >= lane.busy_until {
                let frame = match self.ends[from] {
                    End::Leaf => self.waiting[from].pop_front().unwrap_or_default(),
                    End::Vehicle(node, link) => {
                        let node = &mut nodes[node];
                        let frame = node.stack.transmit(now, link, &mut node.vehicle).to_vec();
                        node.stack.transmitted(link, frame.len());
                        frame
                    }
                };
                if frame.is_empty() {
                    break;
                }
                if let Some(micros) = (frame.len() as u64 * 1_000).checked_div(self.rate) {
                    lane.busy_until = lane.busy_until.max(now).after(Duration::from_micros(micros));
                }
                if !rng.chance(self.loss) {
                    lane.in_flight.push_back((lane.busy_until.max(now).after(self.latency), frame));
                }
            }
            while lane.in_flight.front().is_some_and(|(at, _)| *at <= now) {
                let Some((_, frame)) = lane.in_flight.pop_front() else { break };
                if let End::Vehicle(node, link) = self.ends[to] {
                    let node = &mut nodes[node];
                    let mut rest = &frame[..];
                    while !rest.is_empty() {
                        let taken = node.stack.receive(now, link, rest, &mut node.vehicle);
                        rest = &rest[taken..];
                    }
                }
                *self.delivered[to].entry(frame).or_default() += 1;
            }
            // What the budget of a poll left in the decoder.
            if let End::Vehicle(node, link) = self.ends[to] {
                nodes[node].stack.receive(now, link, &[], &mut nodes[node].vehicle);
            }
        }
    }
}
