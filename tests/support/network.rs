//! Several vehicles that forward, the lines between them, and leaves at these lines, in simulated time.

use super::{Forwarded, Rng, TestVehicle, Tested, millis};
use mavstack::__private::NoPlans;
use mavstack::{Address, Config, Duration, Instant, LinkConfig, LinkId, Pulse, Stack};
use std::collections::{BTreeMap, VecDeque};

/// Number of links of every vehicle, used or not.
const LINKS: usize = 6;

/// An end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// A vehicle and its link.
    Vehicle(usize, LinkId),
    /// A leaf, which only records received frames.
    Leaf,
}

/// One direction of a line.
#[derive(Debug, Default)]
struct Lane {
    /// Frames in transit, with their times of arrival.
    in_flight: VecDeque<(Instant, Vec<u8>)>,
    /// The line is busy until this time.
    busy_until: Instant,
}

/// A line between two ends.
#[derive(Debug)]
pub struct Line {
    pub ends: [End; 2],
    /// Bytes per millisecond in each direction; 0 is infinitely fast.
    pub rate: u64,
    pub latency: Duration,
    /// Probability that a frame is lost.
    pub loss: f64,
    /// Frames delivered at each end, with their counts.
    pub delivered: [BTreeMap<Vec<u8>, usize>; 2],
    lanes: [Lane; 2],
    /// Frames that a leaf at each end has yet to send.
    waiting: [VecDeque<Vec<u8>>; 2],
}

/// A vehicle.
#[derive(Debug)]
pub struct Node<const PEERS: usize> {
    pub stack: Box<Stack<Tested<NoPlans, PEERS, Forwarded>, LINKS>>,
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
    /// Whether the flight loops run, so that heartbeats are sent.
    pub has_heartbeats: bool,
    rng: Rng,
}

impl<const PEERS: usize> Network<PEERS> {
    /// Creates vehicles without lines, with links of `bytes_per_second`.
    pub fn new(vehicles: u8, bytes_per_second: u32, seed: u64) -> Self {
        let node = |system| {
            let pulse: &'static Pulse = Box::leak(Box::new(Pulse::new()));
            let link = LinkConfig { bytes_per_second, ..LinkConfig::unlimited() };
            let mut stack: Box<Stack<Tested<NoPlans, PEERS, Forwarded>, LINKS>> = Box::new(Stack::VACANT);
            stack.begin(Config::new(Address::new(system, 1), pulse), [link; LINKS]);
            Node { stack, vehicle: TestVehicle::new(), pulse, used: 0 }
        };
        Self {
            nodes: (1..=vehicles).map(node).collect(),
            lines: Vec::new(),
            now: Instant::from_millis(1),
            has_heartbeats: false,
            rng: Rng::new(seed),
        }
    }

    /// Connects the next free link of a vehicle to that of another vehicle, or to a leaf. Returns the index of the line.
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

    /// Sends `frame` from the leaf of a line.
    pub fn send(&mut self, line: usize, frame: Vec<u8>) {
        self.lines[line].waiting[1].push_back(frame);
    }

    /// Returns how often `frame` was delivered by each line, at each end.
    pub fn deliveries(&self, frame: &[u8]) -> Vec<[usize; 2]> {
        let of = |line: &Line| [0, 1].map(|end| line.delivered[end].get(frame).copied().unwrap_or(0));
        self.lines.iter().map(of).collect()
    }

    /// Runs one pass of every flight loop.
    pub fn step(&mut self) {
        self.now += millis(1);
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

    /// Whether no frame is in transit.
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
                    lane.busy_until = lane.busy_until.max(now) + Duration::from_micros(micros);
                }
                if !rng.chance(self.loss) {
                    lane.in_flight.push_back((lane.busy_until.max(now) + self.latency, frame));
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
            // Frames may be pending in the decoder that exceeded the budget of a call.
            if let End::Vehicle(node, link) = self.ends[to] {
                nodes[node].stack.receive(now, link, &[], &mut nodes[node].vehicle);
            }
        }
    }
}
